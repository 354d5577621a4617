//! Boxes of objects in the form that detectors are trained and measured with: COCO's tables, with the 3D fields that Omni3D
//! and ScanNet's boxes have.

use crate::catalogue::{Catalogue, Object};
use crate::input::ObjectInput;
use serde_json::{Value, json};

/// The scene among `images`, of which there is one.
const IMAGE: u32 = 1;

/// The boxes of a catalogue: `info`, `images` (the scene), `categories` (all names of `input`, by row) and `annotations`, one
/// an object.
///
/// `bbox3D` is center, length, width, height in meters of the upright frame, and yaw, radians about +z, from the x axis to the
/// length; what ends in `_scene` is in the frame and unit of the scene. `info` has the `upright` matrix and `metres_per_unit`
/// that bring a place p of the scene to `upright · p · metres_per_unit`.
pub fn json(catalogue: &Catalogue, input: &ObjectInput<'_>, file_name: &str) -> Value {
    let name = |(id, name): (usize, &String)| json!({ "id": id, "name": name });
    let categories: Vec<Value> = input.names.iter().enumerate().map(name).collect();
    let annotations: Vec<Value> = catalogue.objects.iter().map(|o| annotation(o, input)).collect();
    json!({
        "info": {
            "description": "boxes of the objects of a scene of 3D Gaussians",
            "version": "1",
            "metres_per_unit": input.metres_per_unit,
            "upright": input.upright,
        },
        "images": [{ "id": IMAGE, "file_name": file_name }],
        "categories": categories,
        "annotations": annotations,
    })
}

fn annotation(o: &Object, input: &ObjectInput<'_>) -> Value {
    let ([x, y, z], [length, width, height]) = (o.bounds.center, o.bounds.size);
    let mut made = json!({
        "id": o.id,
        "image_id": IMAGE,
        "category_id": o.label,
        "category_name": o.class,
        "count": o.count,
        "bbox3D": [x, y, z, length, width, height, o.bounds.yaw],
        "center_scene": o.position,
        "dimensions_scene": o.bounds.size.map(|v| v / input.metres_per_unit),
        "R_scene": axes(o, input),
        "bbox3D_scene": o.corners,
    });
    // What has no score is the truth to those who read such files; a null would be neither.
    if let Some(score) = o.score {
        made["score"] = score.into();
    }
    made
}

/// The rotation from the axes of a box to those of the scene, row by row: its columns are the directions of length, width and
/// height.
fn axes(o: &Object, input: &ObjectInput<'_>) -> [[f64; 3]; 3] {
    let (s, c) = o.bounds.yaw.sin_cos();
    let own = [[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]];
    // Directions have no unit.
    let in_scene = ObjectInput { metres_per_unit: 1.0, ..*input };
    let own = own.map(|axis| in_scene.to_scene(axis));
    [0, 1, 2].map(|row| own.map(|axis| axis[row]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::made::{catalogue, input, object};
    use crate::{ObjectSettings, UprightBox, find_objects};
    use scenesplat_scene::GaussianScene;

    /// A bar of points, 2 m long, 1 m wide and 0.5 m high, its length a quarter turn from y of a scene in half meters whose up is −y.
    fn scene() -> GaussianScene {
        let steps = |n: i32| (0..=n).map(move |i| f64::from(i) / f64::from(n) - 0.5);
        let places = steps(20).flat_map(|u| {
            steps(10).flat_map(move |v| steps(5).map(move |w| [2.0 * u, v, 0.5 * w]))
        });
        let (s, c) = 0.3f64.sin_cos();
        // Upright (x, y, z) is (x, −z, y) of the scene.
        let place = |[u, v, w]: [f64; 3]| {
            let upright = [3.0 + c * u - s * v, 1.0 + s * u + c * v, 0.75 + w];
            [upright[0], -upright[2], upright[1]].map(|v| (2.0 * v) as f32)
        };
        GaussianScene { coord: places.map(place).collect(), ..GaussianScene::default() }
    }

    #[test]
    fn both_forms_of_a_box_are_the_same_box() {
        let scene = scene();
        let labels = vec![1; scene.len()];
        let names = ["wall", "a \"bench\"\n"].map(str::to_owned);
        let input = ObjectInput {
            upright: [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]],
            metres_per_unit: 0.5,
            ..input(&scene, &labels, &names)
        };
        let settings = ObjectSettings { gap: Some(0.3), ..ObjectSettings::default() };
        let found = find_objects(&input, &settings).unwrap();
        let file = json(&found, &input, "room.ply");
        assert_eq!(file["images"], json!([{ "id": 1, "file_name": "room.ply" }]));
        assert_eq!(file["categories"][1], json!({ "id": 1, "name": "a \"bench\"\n" }));
        let all = file["annotations"].as_array().unwrap();
        assert_eq!(all.len(), 1);
        let of = |name: &str| -> Vec<f64> { serde_json::from_value(all[0][name].clone()).unwrap() };
        let table =
            |name: &str| -> Vec<[f64; 3]> { serde_json::from_value(all[0][name].clone()).unwrap() };
        let near = |a: &[f64], b: &[f64]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 0.02);
        assert!(near(&of("bbox3D"), &[3.0, 1.0, 0.75, 2.0, 1.0, 0.5, 0.3]), "{}", all[0]);
        // Twice as many units as meters.
        assert!(near(&of("dimensions_scene"), &[4.0, 2.0, 1.0]));
        assert!(near(&of("center_scene"), &[6.0, -1.5, 2.0]));
        // The corners are where center, sides and rotation say, in the order of `UprightBox::corners`.
        let (center, size, r) = (of("center_scene"), of("dimensions_scene"), table("R_scene"));
        let plan = [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)];
        for (i, corner) in table("bbox3D_scene").iter().enumerate() {
            let (u, v) = plan[i % 4];
            let own = [u * size[0], v * size[1], [-0.5, 0.5][i / 4] * size[2]];
            for a in 0..3 {
                let place = center[a] + (0..3).map(|k| r[a][k] * own[k]).sum::<f64>();
                assert!((place - corner[a]).abs() < 1e-9, "{i}: {place} {corner:?}");
            }
        }
        // Labels without scores have boxes without scores.
        assert!(all[0].get("score").is_none());
    }

    #[test]
    fn numbers_stand_where_the_form_has_them() {
        let (scene, names) = (GaussianScene::default(), ["wall", "chair"].map(str::to_owned));
        let input = input(&scene, &[], &names);
        let mut chair = object(1, 0..40);
        chair.bounds = UprightBox {
            center: [1.0, 2.0, 3.0],
            size: [4.0, 2.0, 6.0],
            yaw: std::f64::consts::FRAC_PI_2,
        };
        (chair.id, chair.class, chair.score) = (7, "chair".to_owned(), Some(0.25));
        (chair.position, chair.corners) = (chair.bounds.center, chair.bounds.corners());
        let file = json(&catalogue(vec![chair], 40), &input, "a.ply");
        let one = &file["annotations"][0];
        assert_eq!(
            [&one["id"], &one["image_id"], &one["category_id"], &one["count"], &one["score"]],
            [&json!(7), &json!(1), &json!(1), &json!(40), &json!(0.25)]
        );
        assert_eq!(one["category_name"], "chair");
        assert_eq!(
            one["bbox3D"],
            json!([1.0, 2.0, 3.0, 4.0, 2.0, 6.0, std::f64::consts::FRAC_PI_2])
        );
        // Its length lies along y, its width along −x.
        let r: [[f64; 3]; 3] = serde_json::from_value(one["R_scene"].clone()).unwrap();
        let want = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]];
        let far = r.as_flattened().iter().zip(want.as_flattened()).map(|(a, b)| (a - b).abs());
        assert!(far.fold(0.0, f64::max) < 1e-12, "{r:?}");
        assert_eq!(file["info"]["metres_per_unit"], 1.0);
    }
}
