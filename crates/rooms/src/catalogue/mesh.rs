//! OBJ models with their materials, as triangles in meters: x to the right, +y to the front, z up.

use super::Entry;
use super::package::{Package, beside};
use super::texture::Texture;
use crate::shape::Block;
use crate::vector::{V3, cross, length, sub};
use scenesplat_scene::picture::{Picture, decode_picture};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

/// Most triangles of a model.
pub(super) const MAX_TRIANGLES: usize = 500_000;

/// A material below this opacity is glass.
const GLASS: f64 = 0.5;

/// Below this opacity there is nothing to see.
const NOTHING: f64 = 0.02;

/// What a triangle is made of.
#[derive(Debug, Clone)]
pub(super) struct Paint {
    /// sRGB, 0..=255.
    pub(super) color: V3,
    pub(super) texture: Option<Arc<Texture>>,
    pub(super) is_glass: bool,
}

impl Paint {
    /// Whether nothing is seen through it.
    pub(super) fn hides(&self) -> bool {
        !self.is_glass && !self.texture.as_ref().is_some_and(|texture| texture.has_holes)
    }
}

/// A triangle of a model.
#[derive(Debug, Clone, Copy)]
pub(super) struct Triangle {
    pub(super) corners: [V3; 3],
    /// Places of the corners on the texture.
    pub(super) uv: Option<[[f64; 2]; 3]>,
    /// Index of its paint.
    pub(super) paint: u32,
}

impl Triangle {
    /// Twice the area, along the normal.
    pub(super) fn cross(&self) -> V3 {
        let [a, b, c] = self.corners;
        cross(sub(b, a), sub(c, a))
    }
}

/// Triangles and their paints.
#[derive(Debug)]
pub(super) struct Mesh {
    pub(super) triangles: Vec<Triangle>,
    pub(super) paints: Vec<Paint>,
}

/// Reads a model and brings it to the size that its library gives.
pub(super) fn read(entry: &Entry, package: &Package) -> Result<Mesh, String> {
    let bytes = package.read(&entry.model)?;
    let mtl = |name: &Path| {
        let file = beside(&entry.model, &name.to_string_lossy());
        // A model without its materials is gray.
        let text = package.read(&file).map(|bytes| latin1(&bytes)).unwrap_or_default();
        tobj::load_mtl_buf(&mut text.as_bytes())
    };
    let options = tobj::LoadOptions { triangulate: true, ..Default::default() };
    let (models, materials) = tobj::load_obj_buf(&mut latin1(&bytes).as_bytes(), &options, mtl)
        .map_err(|error| format!("{}: {error}", entry.model))?;
    // Materials that cannot be read are gray as well.
    let materials = materials.unwrap_or_default();
    let mut paints = paints(&materials, entry, package);
    let opacity: Vec<f64> = (materials.iter())
        .map(|m| m.dissolve.map_or(1.0, f64::from))
        .chain(std::iter::once(1.0))
        .collect();
    paints.push(Paint { color: [180.0; 3], texture: None, is_glass: false });

    let count: usize = models.iter().map(|model| model.mesh.indices.len() / 3).sum();
    if count > MAX_TRIANGLES {
        return Err(format!("has {count} triangles, more than {MAX_TRIANGLES}"));
    }
    let mut triangles = Vec::with_capacity(count);
    for mesh in models.iter().map(|model| &model.mesh) {
        let paint = mesh.material_id.filter(|&m| m < materials.len()).unwrap_or(materials.len());
        if opacity[paint] < NOTHING {
            continue;
        }
        let has_uv = mesh.texcoord_indices.len() == mesh.indices.len();
        for (at, corners) in mesh.indices.chunks_exact(3).enumerate() {
            let corner = |k: usize| -> Option<V3> {
                let start = corners[k] as usize * 3;
                let place = mesh.positions.get(start..start + 3)?;
                Some(std::array::from_fn(|i| f64::from(place[i])))
            };
            let uv = |k: usize| -> Option<[f64; 2]> {
                let start = *mesh.texcoord_indices.get(at * 3 + k)? as usize * 2;
                let place = mesh.texcoords.get(start..start + 2)?;
                Some(std::array::from_fn(|i| f64::from(place[i])))
            };
            let (Some(a), Some(b), Some(c)) = (corner(0), corner(1), corner(2)) else {
                return Err("a face names a corner that is not there".to_owned());
            };
            if [a, b, c].iter().flatten().any(|v| !v.is_finite()) {
                return Err("has corners that are no finite numbers".to_owned());
            }
            let uv = uv(0).zip(uv(1)).zip(uv(2)).filter(|_| has_uv);
            let uv = uv.map(|((a, b), c)| [a, b, c]);
            triangles.push(Triangle { corners: [a, b, c], uv, paint: paint as u32 });
        }
    }
    fit(&mut triangles, entry)?;
    triangles.retain(|triangle| length(triangle.cross()) > 1e-12);
    if triangles.is_empty() {
        return Err("has no area".to_owned());
    }
    Ok(Mesh { triangles, paints })
}

fn latin1(bytes: &[u8]) -> String {
    match std::str::from_utf8(bytes) {
        Ok(text) => text.to_owned(),
        Err(_) => bytes.iter().map(|&b| char::from(b)).collect(),
    }
}

/// Pictures that cannot be read leave the plain color.
fn paints(materials: &[tobj::Material], entry: &Entry, package: &Package) -> Vec<Paint> {
    let mut pictures: BTreeMap<String, Option<Picture>> = BTreeMap::new();
    let mut load = |mentioned: &str| -> Option<Picture> {
        let name = beside(&entry.model, mentioned);
        let picture = pictures.entry(name.clone()).or_insert_with(|| {
            let bytes = package.read(&name).ok()?;
            decode_picture(&bytes, Path::new(&name)).ok()
        });
        picture.clone()
    };
    let mut textures: BTreeMap<(String, Option<String>), Option<Arc<Texture>>> = BTreeMap::new();
    let mut paints = Vec::with_capacity(materials.len());
    for material in materials {
        let color = material.diffuse.unwrap_or([0.7; 3]);
        let texture = material.diffuse_texture.as_ref().and_then(|name| {
            let key = (name.clone(), material.dissolve_texture.clone());
            if let Some(known) = textures.get(&key) {
                return known.clone();
            }
            let opacity = material.dissolve_texture.as_ref().and_then(|name| load(name));
            let picture = load(name);
            let texture = picture.and_then(|picture| Texture::new(&picture, opacity.as_ref()));
            let texture = texture.map(Arc::new);
            textures.insert(key, texture.clone());
            texture
        });
        paints.push(Paint {
            color: color.map(|c| f64::from(c.clamp(0.0, 1.0)) * 255.0),
            texture,
            is_glass: material.dissolve.is_some_and(|d| f64::from(d) < GLASS),
        });
    }
    paints
}

/// Turns the model upright, scales each axis to the stated size, puts the middle of its underside at the
/// origin and lets it look to +y: what libraries have as x, y up, z to the front is −x, z, y here.
fn fit(triangles: &mut [Triangle], entry: &Entry) -> Result<(), String> {
    if let Some(m) = entry.rotation {
        for p in triangles.iter_mut().flat_map(|triangle| &mut triangle.corners) {
            *p = std::array::from_fn(|row| (0..3).map(|i| m[row * 3 + i] * p[i]).sum());
        }
    }
    let corners = triangles.iter().flat_map(|triangle| triangle.corners).map(Block::at);
    let bounds = corners.reduce(Block::join).ok_or("has no face")?;
    let [width, depth, height] = entry.size;
    let wanted = [width, height, depth];
    let extent = bounds.size();
    let largest = extent.iter().copied().fold(0.0, f64::max);
    let is_flat = |i: usize| extent[i] <= 1e-6 * largest;
    if (0..3).filter(|&i| is_flat(i)).count() >= 2 || largest <= 0.0 {
        return Err("is a line or a point: two of its extents are 0".to_owned());
    }
    // A flat axis has no scale: what lies in it stays in it.
    let scale: V3 = std::array::from_fn(|i| if is_flat(i) { 0.0 } else { wanted[i] / extent[i] });
    let middle = bounds.middle();
    let origin = [middle[0], bounds.low[1], middle[2]];
    for p in triangles.iter_mut().flat_map(|triangle| &mut triangle.corners) {
        let [x, y, z]: V3 = std::array::from_fn(|i| (p[i] - origin[i]) * scale[i]);
        *p = [-x, z, y];
    }
    Ok(())
}
