//! An object in its own frame: x to the right, +y to the front, z up from where it stands.

use crate::catalogue::Piece;
use crate::classes::ClassId;
use crate::material::{ColorName, Material};
use crate::shape::{Block, Shape, SurfacePoint, Wave};
use crate::variation::{Variation, varied};
use crate::vector::{V3, Z, add, add_times, basis, cross, sub, times, unit_or};
use scenesplat_kernels::random::SampleRng;
use std::sync::Arc;

/// Draws an object.
pub(crate) type Build = fn(&mut SampleRng) -> Model;

/// Right and left, or front and back, of what is alike on both sides.
pub(crate) const SIDES: [f64; 2] = [-1.0, 1.0];

/// The corners of what is alike on all sides.
pub(crate) const CORNERS: [[f64; 2]; 4] = [[-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]];

/// The four strips between two rectangles with half sides `outer` and `inner`, each by its two corners.
pub(crate) fn strips([x, y]: [f64; 2], [w, h]: [f64; 2]) -> [[[f64; 2]; 2]; 4] {
    [[[-x, -y], [x, -h]], [[-x, h], [x, y]], [[-x, -h], [-w, h]], [[w, -h], [x, h]]]
}

/// A piece of surface with what it is made of.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Surface {
    pub(crate) shape: Shape,
    pub(crate) material: Material,
    /// Gaussians per area, relative to a plain wall.
    pub(crate) density: f64,
    /// Whether no camera saw it: undersides, backs toward a wall. Points sampled from a mesh have
    /// them, captures do not.
    pub(crate) hidden: bool,
}

/// A level place where things can stand.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Support {
    pub(crate) low: [f64; 2],
    pub(crate) high: [f64; 2],
    pub(crate) z: f64,
    /// Height of what fits, meters.
    pub(crate) clearance: f64,
}

/// A piece of a catalogue that an object is made of.
#[derive(Debug, Clone)]
pub(crate) struct OfPiece {
    pub(crate) piece: Arc<Piece>,
    /// What its name is.
    pub(crate) name: Arc<str>,
    /// Height above the floor that its library gives it, meters.
    pub(crate) elevation: f64,
    /// Where its origin is in the frame of the object.
    pub(crate) at: V3,
    /// Gaussians per area, relative to a plain wall.
    pub(crate) density: f64,
    /// How it differs from the model.
    pub(crate) variation: Option<Variation>,
}

impl OfPiece {
    pub(crate) fn bounds(&self) -> Block {
        varied(self.piece.bounds, self.variation.as_ref()).moved(self.at)
    }

    /// Area with everything inside, or of what is seen from outside, square meters.
    pub(crate) fn area(&self, with_hidden: bool) -> f64 {
        match &self.variation {
            None => self.piece.area(with_hidden),
            Some(by) => self.piece.area_by(with_hidden, |normal| by.growth(normal)),
        }
    }

    /// A random point of the surface in the frame of the object, and its color.
    pub(crate) fn sample(&self, with_hidden: bool, rng: &mut SampleRng) -> (SurfacePoint, V3) {
        let (point, color) = self.piece.sample(with_hidden, rng);
        let (point, color) = match &self.variation {
            None => (point, color),
            Some(by) => (by.point(point), by.color(color)),
        };
        (SurfacePoint { coord: add(point.coord, self.at), ..point }, color)
    }
}

/// An object made of surfaces.
#[derive(Debug, Clone)]
pub(crate) struct Model {
    /// None of a thing that has a name alone.
    pub(crate) class: Option<ClassId>,
    pub(crate) color: ColorName,
    pub(crate) surfaces: Vec<Surface>,
    /// A piece of a catalogue, mostly instead of surfaces.
    pub(crate) piece: Option<Box<OfPiece>>,
    /// Where nothing else may be; the box around all surfaces if none is set.
    pub(crate) solids: Vec<Block>,
    pub(crate) supports: Vec<Support>,
    /// Gaussians per area of the surfaces added next.
    pub(crate) density: f64,
}

impl Model {
    pub(crate) fn new(class: ClassId, color: ColorName, density: f64) -> Self {
        Self {
            class: Some(class),
            color,
            surfaces: Vec::new(),
            piece: None,
            solids: Vec::new(),
            supports: Vec::new(),
            density,
        }
    }

    pub(crate) fn add(&mut self, shape: Shape, material: Material) {
        self.surfaces.push(Surface { shape, material, density: self.density, hidden: false });
    }

    /// A surface that no camera sees.
    pub(crate) fn add_hidden(&mut self, shape: Shape, material: Material) {
        self.surfaces.push(Surface { shape, material, density: self.density, hidden: true });
    }

    /// A parallelogram that looks along `u × v`.
    pub(crate) fn face(&mut self, corner: V3, u: V3, v: V3, material: Material) {
        self.add(Shape::flat(corner, u, v), material);
    }

    /// A surface between four corners (at 0 0, 1 0, 0 1, 1 1), flat or in folds.
    pub(crate) fn patch(&mut self, corners: [V3; 4], wave: Option<Wave>, material: Material) {
        self.add(Shape::Patch { corners, bulge: 0.0, wave }, material);
    }

    /// An ellipse with half axes `u` and `v` and a hole of this share of its radius.
    pub(crate) fn disc(&mut self, centre: V3, u: V3, v: V3, hole: f64, material: Material) {
        self.add(Shape::Disc { centre, u, v, hole }, material);
    }

    /// A level disc that looks up.
    pub(crate) fn level_disc(&mut self, centre: V3, r: f64, material: Material) {
        self.disc(centre, [r, 0.0, 0.0], [0.0, r, 0.0], 0.0, material);
    }

    /// A rod bent around the ellipse with half axes `u` and `v`.
    pub(crate) fn ring(&mut self, centre: V3, u: V3, v: V3, rod: f64, material: Material) {
        self.add(Shape::Ring { centre, u, v, rod, half: false }, material);
    }

    /// A rod bent around the half of an ellipse toward `v`.
    pub(crate) fn arc(&mut self, centre: V3, u: V3, v: V3, rod: f64, material: Material) {
        self.add(Shape::Ring { centre, u, v, rod, half: true }, material);
    }

    /// A tube or a cone without ends.
    pub(crate) fn cone(&mut self, from: V3, to: V3, bottom: f64, top: f64, material: Material) {
        self.add(Shape::cone(from, to, bottom, top), material);
    }

    /// A box between two opposite corners, in any order.
    pub(crate) fn block_between(&mut self, a: V3, b: V3, material: Material) {
        let Block { low, high } = Block::at(a).join(Block::at(b));
        self.block(low, high, material);
    }

    /// The faces of a box; the underside is hidden if it stands on something or nearly.
    pub(crate) fn block(&mut self, low: V3, high: V3, material: Material) {
        self.soft_block(low, high, 0.0, material);
    }

    /// A box whose top and sides stand out in the middle by `bulge` meters.
    pub(crate) fn soft_block(&mut self, low: V3, high: V3, bulge: f64, material: Material) {
        let d = sub(high, low);
        let (x, y, z) = ([d[0], 0.0, 0.0], [0.0, d[1], 0.0], [0.0, 0.0, d[2]]);
        let minus = |v: V3| times(v, -1.0);
        let faces = [
            // `u × v` points outwards.
            (high, minus(x), minus(y)),
            (high, minus(z), minus(x)),
            (high, minus(y), minus(z)),
            (low, x, z),
            (low, z, y),
        ];
        for (corner, u, v) in faces {
            self.add(Shape::bulging(corner, u, v, bulge), material);
        }
        let bottom = Shape::flat(low, y, x);
        if low[2] < 0.3 { self.add_hidden(bottom, material) } else { self.add(bottom, material) }
    }

    /// A box of the given extent whose middle is at `centre`.
    pub(crate) fn centred(&mut self, centre: V3, extent: V3, material: Material) {
        let half = times(extent, 0.5);
        self.block(sub(centre, half), add(centre, half), material);
    }

    /// A round rod with ends.
    pub(crate) fn rod(&mut self, from: V3, to: V3, radius: f64, material: Material) {
        self.taper(from, to, radius, radius, material);
    }

    /// A round piece with ends, of two radii.
    pub(crate) fn taper(&mut self, from: V3, to: V3, bottom: f64, top: f64, material: Material) {
        self.cone(from, to, bottom, top, material);
        let w = unit_or(sub(to, from), Z);
        let [u, v] = basis(w);
        for (centre, radius, side) in [(from, bottom, -1.0), (to, top, 1.0)] {
            if radius > 0.012 {
                let (u, v) = (times(u, radius), times(v, radius * side));
                self.disc(centre, u, v, 0.0, material);
            }
        }
    }

    /// A square rod between two points, of the given width.
    pub(crate) fn beam(&mut self, from: V3, to: V3, width: f64, material: Material) {
        let along = sub(to, from);
        let [u, v] = basis(unit_or(along, Z)).map(|e| times(e, width));
        let corner = add_times(add_times(from, u, -0.5), v, -0.5);
        for (corner, across) in [
            (corner, u),
            (add(corner, u), v),
            (add(add(corner, u), v), times(u, -1.0)),
            (add(corner, v), times(v, -1.0)),
        ] {
            self.face(corner, across, along, material);
        }
    }

    /// A thin plate seen from both sides: the face that looks along `u × v`, and its back.
    pub(crate) fn plate(&mut self, corner: V3, u: V3, v: V3, thick: f64, material: Material) {
        let back = times(unit_or(cross(u, v), Z), -thick);
        self.face(corner, u, v, material);
        self.face(add(corner, back), v, u, material);
    }

    /// A ball, or an ellipsoid along the axes.
    pub(crate) fn ball(&mut self, centre: V3, radii: V3, boxy: f64, material: Material) {
        self.dome(centre, radii, [-1.0, 1.0], boxy, false, material);
    }

    /// The part of an ellipsoid between two heights, in units of its half height.
    pub(crate) fn dome(
        &mut self,
        centre: V3,
        [a, b, c]: V3,
        [from, to]: [f64; 2],
        boxy: f64,
        inward: bool,
        material: Material,
    ) {
        let axes = [[a, 0.0, 0.0], [0.0, b, 0.0], [0.0, 0.0, c]];
        self.add(Shape::Ellipsoid { centre, axes, from, to, boxy, inward }, material);
    }

    /// Where nothing else may be, between two opposite corners.
    pub(crate) fn solid(&mut self, low: V3, high: V3) {
        self.solids.push(Block::at(low).join(Block::at(high)));
    }

    /// A place where things can stand.
    pub(crate) fn support(&mut self, low: [f64; 2], high: [f64; 2], z: f64, clearance: f64) {
        self.supports.push(Support { low, high, z, clearance });
    }

    /// The box around all surfaces.
    pub(crate) fn bounds(&self) -> Block {
        let pieces = self.piece.iter().map(|of| of.bounds());
        let all = self.surfaces.iter().map(|s| s.shape.bounds()).chain(pieces).reduce(Block::join);
        all.unwrap_or(Block::at([0.0; 3]))
    }

    /// The box around all surfaces and solids.
    pub(crate) fn extent(&self) -> Block {
        self.solids.iter().copied().fold(self.bounds(), Block::join)
    }

    /// The object's class, if it is this one.
    pub(crate) fn is(&self, class: ClassId) -> bool {
        self.class == Some(class)
    }

    /// The solids, or the box around all surfaces.
    pub(crate) fn occupied(&self) -> Vec<Block> {
        if self.solids.is_empty() { vec![self.bounds()] } else { self.solids.clone() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat_kernels::random::sample_rng;

    #[test]
    fn faces_of_a_box_look_outwards() {
        let mut model = Model::new(ClassId::Box, ColorName::Red, 1.0);
        let (low, high) = ([0.1, 0.2, 0.3], [0.5, 0.7, 0.9]);
        model.block(low, high, Material::plain([0.0; 3]));
        model.beam([0.1, 0.2, 0.3], [0.1, 0.2, 0.9], 0.1, Material::plain([0.0; 3]));
        let centre: V3 = std::array::from_fn(|i| (low[i] + high[i]) / 2.0);
        let mut rng = sample_rng(0, 0, 0);
        assert_eq!(model.surfaces.len(), 10);
        for (i, surface) in model.surfaces.iter().enumerate() {
            let centre = if i < 6 { centre } else { [0.1, 0.2, 0.6] };
            for _ in 0..20 {
                let p = surface.shape.sample(&mut rng);
                let out: f64 = (0..3).map(|a| (p.coord[a] - centre[a]) * p.normal[a]).sum();
                assert!(out > 0.04, "{i} {out}");
            }
        }
        let area: f64 = model.surfaces[..6].iter().map(|s| s.shape.area()).sum();
        assert!((area - 2.0 * (0.2 + 0.24 + 0.3)).abs() < 1e-12);
        let high = model.occupied()[0].high;
        assert!((high[0] - 0.5).abs() < 1e-12 && (high[2] - 0.9).abs() < 1e-12, "{high:?}");
    }
}
