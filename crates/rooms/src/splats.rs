//! From surfaces to Gaussians that look as captures do.

use crate::dice::{between, chance, noise};
use crate::model::{OfPiece, Surface};
use crate::place::{Footprint, Pose};
use crate::shape::SurfacePoint;
use crate::vector::{V3, add_times, basis, cross, dot, times, unit_or};
use scenesplat_kernels::random::{SampleRng, direction, unit};
use scenesplat_scene::GaussianScene;
use scenesplat_scene::gaussian_scene::u8_to_dc;
use scenesplat_scene::quaternion::quat_from_z_to;

/// Gaussians stray from their surface by at most this much, metres.
pub(crate) const MAX_STRAY: f64 = 0.03;

/// How the Gaussians of a room came about; drawn once per room.
#[derive(Debug, Clone)]
pub(crate) struct Look {
    /// Converted from points of a mesh instead of trained on pictures.
    pub(crate) is_points: bool,
    /// Factor of all scales: below 1, as if a denser scene had been thinned out.
    pub(crate) shrink: f64,
    /// Largest scale over 1/√(Gaussians per area): logarithm of the median, and its spread.
    pub(crate) largest: [f64; 2],
    /// Opacity before the sigmoid: mean and spread.
    pub(crate) opacity: [f64; 2],
    /// Noise of positions along the normal, metres; and the share that is far off.
    pub(crate) rough: f64,
    pub(crate) strays: f64,
    /// Noise of normals.
    pub(crate) tilt: f64,
    /// Noise of colours, 0..=255: common to the channels, and of each.
    pub(crate) grit: [f64; 2],
    /// Towards the light, unit; and the light without it, 0..1.
    pub(crate) light: V3,
    pub(crate) ambient: f64,
    /// Exposure and white balance.
    pub(crate) gain: V3,
    /// Share of floaters.
    pub(crate) floaters: f64,
    /// Balls in which the capture saw little.
    pub(crate) holes: Vec<(V3, f64)>,
    /// Whether any of the 24 pairs of sizes and quaternion may stand for an ellipsoid.
    pub(crate) is_spelled_anyhow: bool,
}

impl Look {
    pub(crate) fn new(is_points: bool, size: V3, rng: &mut SampleRng) -> Self {
        // Four in five rooms as if up to 16 times as dense: half to a quarter of the scale.
        let shrink = [1.0, 0.8, 0.62, 0.5, 0.37, 0.25][super::dice::whole(rng, 0, 5) as usize];
        let mut up = direction(rng);
        up[2] = up[2].abs() + 0.3;
        let exposure = between(rng, 0.78, 1.12);
        let holes = if is_points { 0 } else { super::dice::whole(rng, 0, 5) };
        Self {
            is_points,
            shrink,
            largest: [between(rng, -0.5, 0.3), between(rng, 0.5, 0.75)],
            opacity: [between(rng, -1.0, 3.4), between(rng, 1.3, 2.0)],
            rough: between(rng, 0.001, 0.006),
            strays: between(rng, 0.0, 0.05),
            tilt: between(rng, 0.02, 0.12),
            grit: [between(rng, 2.0, 9.0), between(rng, 1.0, 4.0)],
            light: unit_or(up, [0.0, 0.0, 1.0]),
            ambient: if is_points && chance(rng, 0.7) { 1.0 } else { between(rng, 0.6, 0.92) },
            gain: std::array::from_fn(|_| exposure * between(rng, 0.95, 1.05)),
            floaters: if is_points { 0.0 } else { between(rng, 0.0005, 0.006) },
            holes: (0..holes)
                .map(|_| {
                    let centre = size.map(|s| s * unit(rng));
                    (centre, between(rng, 0.15, 0.7))
                })
                .collect(),
            is_spelled_anyhow: false,
        }
    }

    fn is_in_hole(&self, p: V3) -> bool {
        self.holes.iter().any(|(centre, radius)| {
            let d: V3 = std::array::from_fn(|i| p[i] - centre[i]);
            dot(d, d) < radius * radius
        })
    }

    /// Light on a surface with this normal; a little even where it looks away.
    fn shade(&self, normal: V3) -> f64 {
        let facing = dot(normal, self.light);
        self.ambient + (1.0 - self.ambient) * (0.5 + 0.5 * facing) * 1.5
    }
}

/// Gaussians in the making: arrays of one length.
#[derive(Debug, Default)]
pub(crate) struct Rows {
    pub(crate) scene: GaussianScene,
    pub(crate) normal: Vec<[f32; 3]>,
    pub(crate) segment: Vec<i32>,
    pub(crate) instance: Vec<i32>,
}

/// Whom Gaussians belong to and where they stand.
#[derive(Clone, Copy)]
pub(crate) struct Owner<'a> {
    pub(crate) pose: &'a Pose,
    pub(crate) segment: i32,
    pub(crate) instance: i32,
    /// What stands on it and takes its light: only for floors.
    pub(crate) shadows: &'a [Footprint],
    /// Logarithm of what its Gaussians are larger by than their density says.
    pub(crate) ln_size: f64,
    /// Whether its surfaces are of one colour each.
    pub(crate) is_plain: bool,
}

struct Splat {
    coord: V3,
    log_scale: [f64; 3],
    quat: [f64; 4],
    normal: V3,
    opacity_logit: f64,
    color: V3,
}

impl Rows {
    pub(crate) fn with_capacity(n: usize) -> Self {
        let mut rows = Self::default();
        rows.reserve(n);
        rows
    }

    fn reserve(&mut self, n: usize) {
        self.scene.coord.reserve(n);
        self.scene.log_scale.reserve(n);
        self.scene.quat.reserve(n);
        self.scene.opacity_logit.reserve(n);
        self.scene.sh_dc.reserve(n);
        self.normal.reserve(n);
        self.segment.reserve(n);
        self.instance.reserve(n);
    }

    /// The scene, with all labels.
    pub(crate) fn into_scene(self) -> GaussianScene {
        GaussianScene {
            normal: Some(self.normal),
            segment: Some(self.segment),
            instance: Some(self.instance),
            ..self.scene
        }
    }

    pub(crate) fn append(&mut self, other: &mut Self) {
        self.scene.coord.append(&mut other.scene.coord);
        self.scene.log_scale.append(&mut other.scene.log_scale);
        self.scene.quat.append(&mut other.scene.quat);
        self.scene.opacity_logit.append(&mut other.scene.opacity_logit);
        self.scene.sh_dc.append(&mut other.scene.sh_dc);
        self.normal.append(&mut other.normal);
        self.segment.append(&mut other.segment);
        self.instance.append(&mut other.instance);
    }

    /// Scatters `count` Gaussians over a surface, as many per area as `spacing` metres say.
    pub(crate) fn scatter(
        &mut self,
        surface: &Surface,
        count: usize,
        owner: &Owner<'_>,
        look: &Look,
        rng: &mut SampleRng,
    ) {
        let draw = |rng: &mut SampleRng| {
            let point = surface.shape.sample(rng);
            let material = &surface.material;
            let color = if owner.is_plain { material.base } else { material.color_at(point.st) };
            (point, color)
        };
        self.scatter_by(surface.shape.area(), count, owner, look, draw, rng);
    }

    /// As [`scatter`](Self::scatter), over a piece of a catalogue: nothing but its shape and colours tells it
    /// from other surfaces.
    pub(crate) fn scatter_piece(
        &mut self,
        of: &OfPiece,
        count: usize,
        owner: &Owner<'_>,
        look: &Look,
        rng: &mut SampleRng,
    ) {
        let draw = |rng: &mut SampleRng| of.sample(look.is_points, rng);
        self.scatter_by(of.area(look.is_points), count, owner, look, draw, rng);
    }

    fn scatter_by(
        &mut self,
        area: f64,
        count: usize,
        owner: &Owner<'_>,
        look: &Look,
        draw: impl Fn(&mut SampleRng) -> (SurfacePoint, V3),
        rng: &mut SampleRng,
    ) {
        let spacing = (area / count.max(1) as f64).sqrt().max(1e-4);
        let ln_spacing = rounded_ln(spacing) + owner.ln_size;
        for _ in 0..count {
            let (mut point, mut color) = draw(rng);
            let mut coord = owner.pose.point(point.coord);
            // What fell into a hole is drawn again, so that the number of Gaussians stays.
            for _ in 0..3 {
                if !look.is_in_hole(coord) || chance(rng, 0.15) {
                    break;
                }
                (point, color) = draw(rng);
                coord = owner.pose.point(point.coord);
            }
            let normal = owner.pose.vector(point.normal);
            let light = look.shade(normal) * contact(coord, owner.shadows);
            color = std::array::from_fn(|i| color[i] * light * look.gain[i]);
            let splat = if look.is_points {
                from_point(coord, normal, color, ln_spacing, look, rng)
            } else {
                let tangent = owner.pose.vector(point.tangent);
                let along = Along { tangent, edge: point.edge };
                trained(coord, normal, &along, color, ln_spacing, look, rng)
            };
            self.push(&splat, owner.segment, owner.instance);
        }
    }

    pub(crate) fn push_floater(&mut self, size: V3, ln_spacing: f64, rng: &mut SampleRng) {
        let normal = direction(rng);
        let [u, v] = basis(normal);
        let grey = between(rng, 60.0, 200.0);
        let splat = Splat {
            coord: size.map(|s| s * unit(rng)),
            log_scale: std::array::from_fn(|_| ln_spacing - 0.2 + 0.6 * noise(rng)),
            quat: quat_of([u, v, normal]),
            normal,
            opacity_logit: -2.5 + 1.2 * noise(rng),
            color: std::array::from_fn(|_| grey + 25.0 * noise(rng)),
        };
        self.push(&splat, -1, -1);
    }

    /// What a scan leaves below a floor: mirror images in polished stone, and what a camera did not see.
    pub(crate) fn push_below(&mut self, size: V3, deep: f64, ln_spacing: f64, rng: &mut SampleRng) {
        let normal = direction(rng);
        let [u, v] = basis(normal);
        let grey = between(rng, 40.0, 220.0);
        let down = unit(rng);
        let splat = Splat {
            coord: [size[0] * unit(rng), size[1] * unit(rng), -deep * down * down],
            log_scale: std::array::from_fn(|_| ln_spacing - 0.2 + 0.6 * noise(rng)),
            quat: quat_of([u, v, normal]),
            normal,
            opacity_logit: -0.5 + 1.8 * noise(rng),
            color: std::array::from_fn(|_| grey + 25.0 * noise(rng)),
        };
        self.push(&splat, -1, -1);
    }

    fn push(&mut self, splat: &Splat, segment: i32, instance: i32) {
        let scene = &mut self.scene;
        scene.coord.push(splat.coord.map(|v| v as f32));
        scene.log_scale.push(splat.log_scale.map(|v| v.clamp(-9.2, -0.7) as f32));
        let sign = if splat.quat[0] < 0.0 { -1.0 } else { 1.0 };
        scene.quat.push(splat.quat.map(|v| (sign * v) as f32));
        scene.opacity_logit.push(splat.opacity_logit as f32);
        scene.sh_dc.push(splat.color.map(|c| u8_to_dc(c.clamp(0.0, 255.0) as u8)));
        self.normal.push(splat.normal.map(|v| v as f32));
        self.segment.push(segment);
        self.instance.push(instance);
    }
}

/// Less light under and beside what stands on a floor.
fn contact([x, y, _]: V3, shadows: &[Footprint]) -> f64 {
    let nearest = shadows.iter().fold(1.0, |d: f64, f| d.min(f.distance_squared([x, y])));
    0.68 + 0.32 * nearest
}

/// As `from_points` makes them: a disc as wide as the spacing, a tenth as thick.
fn from_point(
    coord: V3,
    normal: V3,
    color: V3,
    ln_spacing: f64,
    look: &Look,
    rng: &mut SampleRng,
) -> Splat {
    // Mean distance to the 3 nearest of random points: 0.729 / √density, ± 27 %; a tenth less in
    // rooms, where faces of thin boards are neighbours too (the test with the converter shows it).
    let wide = ln_spacing - 0.42 + 0.27 * noise(rng) + rounded_ln(look.shrink);
    // Opacity 0.95.
    let opacity_logit = 2.944_438_979;
    let log_scale = [wide, wide, wide - std::f64::consts::LN_10];
    Splat { coord, log_scale, quat: quat_from_z_to(normal), normal, opacity_logit, color }
}

struct Along {
    tangent: V3,
    edge: f64,
}

/// As training on pictures leaves them.
fn trained(
    coord: V3,
    normal: V3,
    along: &Along,
    color: V3,
    ln_spacing: f64,
    look: &Look,
    rng: &mut SampleRng,
) -> Splat {
    let far = chance(rng, look.strays);
    let off = noise(rng) * if far { 0.015 } else { look.rough };
    let normal = unit_or(std::array::from_fn(|i| normal[i] + look.tilt * noise(rng)), normal);
    let tangent =
        unit_or(add_times(along.tangent, normal, -dot(along.tangent, normal)), basis(normal)[0]);
    let other = cross(normal, tangent);
    // Long pieces lie along edges; elsewhere in any direction.
    let (a, b) = if along.edge < 0.03 && chance(rng, 0.8) {
        (tangent, other)
    } else {
        let [c, s] = scenesplat_kernels::random::cos_sin(rng);
        let a = add_times(times(tangent, c), other, s);
        (a, cross(normal, a))
    };
    let largest =
        ln_spacing + look.largest[0] + look.largest[1] * noise(rng) + rounded_ln(look.shrink);
    let (u, v) = (unit(rng), unit(rng));
    // Middle over largest, and smallest over middle, as measured: see the module's head.
    let middle = largest + rounded_ln(0.05 + 0.85 * u * u.sqrt());
    let smallest = middle + rounded_ln(0.01 + 0.8 * v * v * v.sqrt().sqrt());
    let axes = [a, b, normal];
    let scales = [largest, middle, smallest];
    // Which axis is the short one is chance in a trained scene.
    let shift = super::dice::whole(rng, 0, 2) as usize;
    let turned = |i: usize| (i + shift) % 3;
    let (axes, scales) = match look.is_spelled_anyhow {
        true => respelled(axes, scales, rng),
        false => (axes, scales),
    };
    Splat {
        coord: add_times(coord, normal, off.clamp(-MAX_STRAY, MAX_STRAY)),
        log_scale: std::array::from_fn(|i| scales[turned(i)]),
        quat: quat_of(std::array::from_fn(|i| axes[turned(i)])),
        normal,
        opacity_logit: (look.opacity[0] + look.opacity[1] * noise(rng)).clamp(-4.6, 5.6),
        color: {
            let common = look.grit[0] * noise(rng);
            std::array::from_fn(|i| color[i] + common + look.grit[1] * noise(rng))
        },
    }
}

/// The same ellipsoid, two of its axes exchanged or turned round; with the shift by one or two, each of 24
/// ways is as likely.
fn respelled([a, b, c]: [V3; 3], [s, t, u]: V3, rng: &mut SampleRng) -> ([V3; 3], V3) {
    let minus = |v| times(v, -1.0);
    match super::dice::whole(rng, 0, 7) {
        0 => ([a, b, c], [s, t, u]),
        1 => ([minus(a), minus(b), c], [s, t, u]),
        2 => ([minus(a), b, minus(c)], [s, t, u]),
        3 => ([a, minus(b), minus(c)], [s, t, u]),
        4 => ([b, minus(a), c], [t, s, u]),
        5 => ([minus(b), a, c], [t, s, u]),
        6 => ([b, a, minus(c)], [t, s, u]),
        _ => ([minus(b), minus(a), minus(c)], [t, s, u]),
    }
}

/// The natural logarithm in steps of 1/1024: libraries disagree about its last bit.
pub(crate) fn rounded_ln(value: f64) -> f64 {
    (value.ln() * 1024.0).round() / 1024.0
}

/// The opacity of a Gaussian in steps of 1/65536, and its sizes in steps of 1/16777216 m: libraries disagree
/// about the last bit of exponentials, and choices hang on these.
pub(crate) fn opacity(scene: &GaussianScene, row: usize) -> f64 {
    (f64::from(scene.opacity(row)) * 65536.0).round() / 65536.0
}

/// See [`opacity`].
pub(crate) fn sizes(scene: &GaussianScene, row: usize) -> V3 {
    scene.scale(row).map(|s| (f64::from(s) * 16_777_216.0).round().max(1.0) / 16_777_216.0)
}

/// The unit quaternion `w, x, y, z` whose matrix has these columns, which are a rotation.
fn quat_of([a, b, c]: [V3; 3]) -> [f64; 4] {
    // Each of the four is half the root of a sum; the largest gives the others without loss.
    let squares = [
        1.0 + a[0] + b[1] + c[2],
        1.0 + a[0] - b[1] - c[2],
        1.0 - a[0] + b[1] - c[2],
        1.0 - a[0] - b[1] + c[2],
    ];
    let (x, y, z) = (b[2] - c[1], c[0] - a[2], a[1] - b[0]);
    let (xy, xz, yz) = (b[0] + a[1], c[0] + a[2], c[1] + b[2]);
    let best = (1..4).fold(0, |best, i| if squares[i] > squares[best] { i } else { best });
    let q = match best {
        0 => [squares[0], x, y, z],
        1 => [x, squares[1], xy, xz],
        2 => [y, xy, squares[2], yz],
        _ => [z, xz, yz, squares[3]],
    };
    let norm = q.iter().map(|v| v * v).sum::<f64>().sqrt();
    q.map(|v| v / norm)
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat_kernels::random::sample_rng;

    #[test]
    fn quaternions_have_the_axes_as_columns() {
        let mut rng = sample_rng(1, 0, 0);
        for i in 0..500 {
            let w = direction(&mut rng);
            let [u, v] = basis(w);
            let mut axes = [u, v, w];
            axes.rotate_left(i % 3);
            let [w, x, y, z] = quat_of(axes);
            let columns = [
                [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)],
                [2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)],
                [2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)],
            ];
            for (column, axis) in columns.iter().zip(&axes) {
                for i in 0..3 {
                    assert!((column[i] - axis[i]).abs() < 1e-9, "{columns:?} {axes:?}");
                }
            }
        }
    }
}
