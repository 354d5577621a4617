//! A picture of a scene with the numbered boxes of its objects.

use crate::preview::{
    BACKGROUND, INK, Orbit, SceneRows, UNLABELLED_COLOR, class_color, fill, picture_of, text,
};
use scenesplat_objects::{Catalogue, is_building, is_kind};
use scenesplat_rasterizer::{Gaussians, RasterError, RasterSettings, RenderRequest, View, render};
use scenesplat_scene::gaussian_scene::SH_C0;
use scenesplat_scene::picture::RgbPicture;
use scenesplat_scene::{Camera, GaussianScene, Up};

/// The view, pixels, and the list beside it.
const VIEW: [u32; 2] = [1080, 860];
const LIST: u32 = 260;
/// Most columns of the list.
const COLUMNS: usize = 3;
/// Height of a line of the list, pixels, and lines of a column.
const LINE: u32 = 20;
const LINES: usize = ((VIEW[1] - 16) / LINE) as usize;
/// Larger standard deviations than this part of the scene are haze before the camera.
const HAZE: f64 = 0.5;
const EDGES: [(usize, usize); 12] = [
    (0, 1),
    (1, 2),
    (2, 3),
    (3, 0),
    (4, 5),
    (5, 6),
    (6, 7),
    (7, 4),
    (0, 4),
    (1, 5),
    (2, 6),
    (3, 7),
];
/// Draws a scene from above one of its corners, without its ceiling and near walls, each object in a color of its own,
/// with the numbers of the catalogue and a list of them. Walls, floors and ceilings have no box.
///
/// # Errors
/// If the scene cannot be rendered.
pub fn object_picture(
    scene: &GaussianScene,
    catalogue: &Catalogue,
    up: Up,
) -> Result<RgbPicture, RasterError> {
    let instances = catalogue.instances();
    let plain: Vec<[u8; 3]> = (0..scene.len()).map(|row| scene.color_u8(row)).collect();
    // Light of the scene keeps the sides of a thing apart.
    let colors: Vec<[u8; 3]> = (instances.iter().zip(&plain))
        .map(|(&id, rgb)| {
            let light = rgb.iter().map(|&v| f32::from(v)).sum::<f32>() / 765.0;
            let own = usize::try_from(id).map_or(UNLABELLED_COLOR, class_color);
            own.map(|v| (f32::from(v) * (0.55 + 0.55 * light)).min(255.0) as u8)
        })
        .collect();
    let shapes = SceneRows::of(scene);
    let orbit = Orbit::around(&shapes.rows(scene, &colors), up, 1, VIEW);
    // Boxes of the building would hide all others.
    let listed: Vec<usize> = (0..catalogue.objects.len())
        .filter(|&i| !is_building(&catalogue.objects[i].class))
        .collect();
    let columns = listed.len().div_ceil(LINES).clamp(1, COLUMNS) as u32;
    let mut picture = RgbPicture::filled(VIEW[0] + columns * LIST, VIEW[1], BACKGROUND);
    let Some(camera) = orbit.cameras.first() else { return Ok(picture) };
    // Where walls are known, they are left out before the camera, and nothing else.
    let walls: Vec<bool> = catalogue.objects.iter().map(|o| is_kind(&o.class, "wall")).collect();
    let is_wall = |id: &i32| usize::try_from(*id).is_ok_and(|id| walls[id]);
    let walls = walls.contains(&true).then(|| instances.iter().map(is_wall).collect::<Vec<_>>());
    let drawn = draw_scene(scene, &colors, &orbit, camera, walls.as_deref())?;
    let Some(view) = drawn else { return Ok(picture) };
    for (x, y, color) in view.enumerate() {
        picture.set(x, y, color);
    }
    let mut labels = Vec::new();
    for &i in &listed {
        let (object, color) = (&catalogue.objects[i], class_color(i));
        draw_box(&mut picture, camera, &object.corners, color);
        labels.extend(camera.project(object.position).map(|at| (at, object.id.to_string(), color)));
    }
    for (at, number, color) in labels {
        badge(&mut picture, at, &number, color);
    }
    list(&mut picture, catalogue, &listed);
    Ok(picture)
}

/// The scene without its ceiling, near walls and haze; `None` if nothing of it is left. `walls`: whether each Gaussian is of a
/// wall; without, all that is near is left out.
fn draw_scene(
    scene: &GaussianScene,
    colors: &[[u8; 3]],
    orbit: &Orbit,
    camera: &Camera,
    walls: Option<&[bool]>,
) -> Result<Option<RgbPicture>, RasterError> {
    let size = (0..3).map(|a| camera.centre()[a].powi(2)).sum::<f64>().sqrt().max(1.0);
    let is_drawn = |&row: &usize| {
        let c = scene.coord[row];
        let is_before = |near: f64| camera.to_camera(c.map(f64::from))[2] < near;
        let is_near_wall =
            walls.is_some_and(|walls| walls[row]) && orbit.near.is_some_and(is_before);
        let hidden = is_near_wall || orbit.ceiling.as_ref().is_some_and(|ceiling| ceiling.hides(c));
        let haze = scene.scale(row).iter().any(|&s| f64::from(s) > HAZE * size);
        c.iter().all(|v| v.is_finite()) && !hidden && !haze
    };
    let kept: Vec<usize> = (0..scene.len()).filter(is_drawn).collect();
    let drawn = scene.select_rows(&kept).ok();
    let Some(drawn) = drawn.filter(|s| !s.is_empty()) else { return Ok(None) };
    let mut gaussians =
        Gaussians::from_scene(&GaussianScene { sh_rest: Vec::new(), sh_degree: 0, ..drawn })?;
    let dc = |&row: &usize| colors[row].map(|c| (f32::from(c) / 255.0 - 0.5) / SH_C0);
    gaussians.sh = kept.iter().flat_map(dc).collect();
    gaussians.sh_degree = 0;
    let mut settings = RasterSettings {
        far: f32::INFINITY,
        antialiased: scene.antialiased,
        ..RasterSettings::gsplat_1_6()
    };
    if let Some(near) = orbit.near.filter(|_| walls.is_none()) {
        settings.near = near.max(1e-6) as f32;
    }
    settings.background = Some(BACKGROUND.map(|v| f32::from(v) / 255.0));
    let rendered =
        render(&gaussians, &View::from_camera(camera)?, &settings, &RenderRequest::rgb())?;
    Ok(rendered.rgb.and_then(|rgb| picture_of(&rgb, VIEW[0], VIEW[1])))
}

fn draw_box(picture: &mut RgbPicture, camera: &Camera, corners: &[[f64; 3]; 8], color: [u8; 3]) {
    for (a, b) in EDGES {
        // Short steps: an edge may pass behind the camera.
        let at = |t: f64| {
            camera.project([0, 1, 2].map(|k| corners[a][k] * (1.0 - t) + corners[b][k] * t))
        };
        let (Some(p), Some(q)) = (at(0.0), at(1.0)) else { continue };
        let steps = ((p[0] - q[0]).hypot(p[1] - q[1]).ceil() as usize).clamp(1, 4096);
        for step in 0..=steps {
            let t = step as f64 / steps as f64;
            let [x, y] = [0, 1].map(|k| p[k] * (1.0 - t) + q[k] * t);
            if x >= 0.0 && y >= 0.0 && x < f64::from(VIEW[0]) && y < f64::from(VIEW[1]) {
                picture.set(x as u32, y as u32, color);
            }
        }
    }
}

/// A number on a dark field, where it fits into the view.
fn badge(picture: &mut RgbPicture, [x, y]: [f64; 2], number: &str, color: [u8; 3]) {
    let wide = text::width(number, 1) + 6;
    let inside = x >= f64::from(wide) && y >= 8.0 && x + f64::from(wide) < f64::from(VIEW[0]);
    if !inside || y + 8.0 >= f64::from(VIEW[1]) {
        return;
    }
    let (left, top) = (x as u32 - wide / 2, y as u32 - 7);
    fill(picture, [left, top], [wide, 14], [16, 17, 20]);
    text::draw(picture, left + 3, top + 3, 1, color.map(|v| v.max(90)), number, wide);
}

/// Those objects, as many as fit into the columns.
fn list(picture: &mut RgbPicture, catalogue: &Catalogue, listed: &[usize]) {
    let fits = LINES * COLUMNS;
    for (place, &i) in listed.iter().enumerate().take(fits) {
        let left = VIEW[0] + 12 + (place / LINES) as u32 * LIST;
        let top = 12 + (place % LINES) as u32 * LINE;
        if place + 1 == fits && listed.len() > fits {
            let more = format!("and {} more", listed.len() - fits + 1);
            text::draw(picture, left + 18, top + 2, 1, INK, &more, LIST - 36);
            break;
        }
        let object = &catalogue.objects[i];
        let name =
            format!("{:>3} {}", object.id, object.class.chars().take(40).collect::<String>());
        fill(picture, [left, top], [12, 12], class_color(i));
        text::draw(picture, left + 18, top + 2, 1, INK, &name, LIST - 36);
    }
}
