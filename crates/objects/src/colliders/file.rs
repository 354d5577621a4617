//! Hulls as a binary glTF file of meshes.

use super::Collider;
use scenesplat_scene::Frame;
use scenesplat_scene::bounds::bounding_box;
use scenesplat_scene::formats::gltf::glb_head;
use serde_json::{Value, json};

/// Codes of glTF.
const FLOAT: u32 = 5126;
const UNSIGNED: u32 = 5125;
const CORNERS: u32 = 34962;
const TRIANGLES: u32 = 34963;

/// A `.glb` file with a mesh and a node for each hull, named `003-chair`, with `id` and `class` as extras; in glTF's frame and
/// the unit of the scene, so that it lies over the scene that was written as `.glb`. `origin`: that of the scene.
///
/// `None` if the file would exceed 4 GiB.
pub fn colliders_glb(colliders: &[Collider], origin: [f64; 3]) -> Option<Vec<u8>> {
    let bytes = |hull: &Collider| 12 * (hull.positions.len() + hull.triangles.len()) as u64;
    if colliders.iter().map(bytes).sum::<u64>() > u64::from(u32::MAX) {
        return None;
    }
    let to_file = Frame::CANONICAL.matrix_to(Frame::LUF);
    let moved =
        |p: [f64; 3]| to_file.map(|row| row[0] * p[0] + row[1] * p[1] + row[2] * p[2] + 0.0);
    // As nodes of other programs have it: places near 0, far ones in the node.
    let translation = moved(origin);
    let (mut binary, mut views, mut accessors) = (Vec::new(), Vec::new(), Vec::new());
    let (mut meshes, mut nodes) = (Vec::new(), Vec::new());
    for (number, hull) in colliders.iter().enumerate() {
        let turned = |p: &[f32; 3]| moved(p.map(f64::from)).map(|v| v as f32);
        let positions: Vec<[f32; 3]> = hull.positions.iter().map(turned).collect();
        let (low, high) = bounding_box(positions.iter().copied());
        let start = binary.len();
        binary.extend(positions.iter().flatten().flat_map(|v| v.to_le_bytes()));
        views.push(view(start, binary.len(), CORNERS));
        accessors.push(json!({ "bufferView": 2 * number, "componentType": FLOAT, "type": "VEC3",
            "count": positions.len(), "min": low, "max": high }));
        let start = binary.len();
        binary.extend(hull.triangles.iter().flatten().flat_map(|v| v.to_le_bytes()));
        views.push(view(start, binary.len(), TRIANGLES));
        accessors.push(
            json!({ "bufferView": 2 * number + 1, "componentType": UNSIGNED, "type": "SCALAR",
            "count": 3 * hull.triangles.len() }),
        );
        let name = format!("{:03}-{}", hull.id, hull.class);
        meshes.push(json!({ "name": name, "primitives": [{ "mode": 4,
            "attributes": { "POSITION": 2 * number }, "indices": 2 * number + 1 }] }));
        let mut node = json!({ "name": name, "mesh": number,
            "extras": { "id": hull.id, "class": hull.class } });
        if origin != [0.0; 3] {
            node["translation"] = json!(translation);
        }
        nodes.push(node);
    }
    let mut document = json!({
        "asset": { "version": "2.0", "generator": "scenesplat" },
        "scene": 0,
        "scenes": [{ "name": "colliders" }],
    });
    // Empty lists are not allowed.
    if !nodes.is_empty() {
        document["scenes"][0]["nodes"] = (0..nodes.len()).collect();
        document["nodes"] = nodes.into();
        document["meshes"] = meshes.into();
        document["accessors"] = accessors.into();
        document["bufferViews"] = views.into();
        document["buffers"] = json!([{ "byteLength": binary.len() }]);
    }
    let mut file = glb_head(&document, binary.len() as u64)?;
    file.append(&mut binary);
    Some(file)
}

fn view(start: usize, end: usize, target: u32) -> Value {
    json!({ "buffer": 0, "byteOffset": start, "byteLength": end - start, "target": target })
}
