//! From surfaces to Gaussians that look as captures do.

use crate::dice::{between, chance, noise, whole};
use crate::model::{OfPiece, Surface};
use crate::place::{Footprint, Pose};
use crate::shape::SurfacePoint;
use crate::vector::{V3, add_times, basis, cross, dot, times, unit_or};
use scenesplat_kernels::random::{SampleRng, cos_sin, direction, unit};
use scenesplat_scene::GaussianScene;
use scenesplat_scene::gaussian_scene::u8_to_dc;
use scenesplat_scene::quaternion::quat_from_z_to;

/// Gaussians stray from their surface by at most this much, meters.
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
    /// Noise of positions along the normal, meters; and the share that is far off.
    pub(crate) rough: f64,
    pub(crate) strays: f64,
    /// Noise of normals.
    pub(crate) tilt: f64,
    /// Noise of colors, 0..=255: common to the channels, and of each.
    pub(crate) grit: [f64; 2],
    /// Toward the light, unit; and the light without it, 0..1.
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
        let shrink = [1.0, 0.8, 0.62, 0.5, 0.37, 0.25][whole(rng, 0, 5) as usize];
        let mut up = direction(rng);
        up[2] = up[2].abs() + 0.3;
        let exposure = between(rng, 0.78, 1.12);
        let holes = if is_points { 0 } else { whole(rng, 0, 5) };
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
            holes: holes_in(size, holes, 0.7, rng),
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

/// So many balls anywhere in the room, of radii from 0.15 m to `largest`.
pub(crate) fn holes_in(size: V3, count: u32, largest: f64, rng: &mut SampleRng) -> Vec<(V3, f64)> {
    let mut hole = || (size.map(|s| s * unit(rng)), between(rng, 0.15, largest));
    (0..count).map(|_| hole()).collect()
}

/// A Gaussian as it is stored.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Row {
    coord: [f32; 3],
    log_scale: [f32; 3],
    quat: [f32; 4],
    opacity_logit: f32,
    sh_dc: [f32; 3],
    normal: [f32; 3],
    segment: i32,
    instance: i32,
}

/// The scene of these rows, with all labels.
pub(crate) fn scene(rows: &[Row]) -> GaussianScene {
    GaussianScene {
        coord: rows.iter().map(|row| row.coord).collect(),
        log_scale: rows.iter().map(|row| row.log_scale).collect(),
        quat: rows.iter().map(|row| row.quat).collect(),
        opacity_logit: rows.iter().map(|row| row.opacity_logit).collect(),
        sh_dc: rows.iter().map(|row| row.sh_dc).collect(),
        normal: Some(rows.iter().map(|row| row.normal).collect()),
        segment: Some(rows.iter().map(|row| row.segment).collect()),
        instance: Some(rows.iter().map(|row| row.instance).collect()),
        ..GaussianScene::default()
    }
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
    /// Whether its surfaces are of one color each.
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

impl Splat {
    fn row(&self, segment: i32, instance: i32) -> Row {
        let sign = if self.quat[0] < 0.0 { -1.0 } else { 1.0 };
        Row {
            coord: self.coord.map(|v| v as f32),
            log_scale: self.log_scale.map(|v| v.clamp(-9.2, -0.7) as f32),
            quat: self.quat.map(|v| (sign * v) as f32),
            opacity_logit: self.opacity_logit as f32,
            sh_dc: self.color.map(|c| u8_to_dc(c.clamp(0.0, 255.0) as u8)),
            normal: self.normal.map(|v| v as f32),
            segment,
            instance,
        }
    }
}

impl Owner<'_> {
    /// Scatters `count` Gaussians over a surface.
    pub(crate) fn scatter(
        &self,
        surface: &Surface,
        count: usize,
        look: &Look,
        rng: &mut SampleRng,
        rows: &mut Vec<Row>,
    ) {
        let draw = |rng: &mut SampleRng| {
            let point = surface.shape.sample(rng);
            let material = &surface.material;
            let color = if self.is_plain { material.base } else { material.color_at(point.st) };
            (point, color)
        };
        rows.extend(self.scattered(surface.shape.area(), count, look, draw, rng));
    }

    /// As [`scatter`](Self::scatter), over a piece of a catalogue: nothing but its shape and colors tells it
    /// from other surfaces.
    pub(crate) fn scatter_piece(
        &self,
        of: &OfPiece,
        count: usize,
        look: &Look,
        rng: &mut SampleRng,
        rows: &mut Vec<Row>,
    ) {
        let draw = |rng: &mut SampleRng| of.sample(look.is_points, rng);
        rows.extend(self.scattered(of.area(look.is_points), count, look, draw, rng));
    }

    fn scattered(
        &self,
        area: f64,
        count: usize,
        look: &Look,
        draw: impl Fn(&mut SampleRng) -> (SurfacePoint, V3),
        rng: &mut SampleRng,
    ) -> impl Iterator<Item = Row> {
        let spacing = (area / count.max(1) as f64).sqrt().max(1e-4);
        let ln_spacing = rounded_ln(spacing) + self.ln_size;
        (0..count).map(move |_| {
            let (mut point, mut color) = draw(rng);
            let mut coord = self.pose.point(point.coord);
            // What fell into a hole is drawn again: the number of Gaussians is exact.
            for _ in 0..3 {
                if !look.is_in_hole(coord) || chance(rng, 0.15) {
                    break;
                }
                (point, color) = draw(rng);
                coord = self.pose.point(point.coord);
            }
            let normal = self.pose.vector(point.normal);
            let light = look.shade(normal) * contact(coord, self.shadows);
            color = std::array::from_fn(|i| color[i] * light * look.gain[i]);
            let splat = if look.is_points {
                from_point(coord, normal, color, ln_spacing, look, rng)
            } else {
                let along = (self.pose.vector(point.tangent), point.edge);
                trained(coord, normal, along, color, ln_spacing, look, rng)
            };
            splat.row(self.segment, self.instance)
        })
    }
}

/// A Gaussian that is part of no object, anywhere in the room.
pub(crate) fn floater(size: V3, ln_spacing: f64, rng: &mut SampleRng) -> Row {
    let place = |rng: &mut SampleRng| size.map(|s| s * unit(rng));
    unlabelled([60.0, 200.0], [-2.5, 1.2], ln_spacing, place, rng)
}

/// What a scan has below a floor: mirror images in polished stone, and what no camera saw.
pub(crate) fn below_floor(size: V3, deep: f64, ln_spacing: f64, rng: &mut SampleRng) -> Row {
    let place = |rng: &mut SampleRng| {
        let down = unit(rng);
        [size[0] * unit(rng), size[1] * unit(rng), -deep * down * down]
    };
    unlabelled([40.0, 220.0], [-0.5, 1.8], ln_spacing, place, rng)
}

/// A Gaussian in any direction, of a gray in this range, with this mean and spread of the opacity logit.
fn unlabelled(
    grey: [f64; 2],
    opacity: [f64; 2],
    ln_spacing: f64,
    place: impl FnOnce(&mut SampleRng) -> V3,
    rng: &mut SampleRng,
) -> Row {
    let normal = direction(rng);
    let [u, v] = basis(normal);
    let grey = between(rng, grey[0], grey[1]);
    let splat = Splat {
        coord: place(rng),
        log_scale: std::array::from_fn(|_| ln_spacing - 0.2 + 0.6 * noise(rng)),
        quat: quat_of([u, v, normal]),
        normal,
        opacity_logit: opacity[0] + opacity[1] * noise(rng),
        color: std::array::from_fn(|_| grey + 25.0 * noise(rng)),
    };
    splat.row(-1, -1)
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
    // rooms, where faces of thin boards are neighbors too (the test with the converter shows it).
    let wide = ln_spacing - 0.42 + 0.27 * noise(rng) + rounded_ln(look.shrink);
    // Opacity 0.95.
    let opacity_logit = 2.944_438_979;
    let log_scale = [wide, wide, wide - std::f64::consts::LN_10];
    Splat { coord, log_scale, quat: quat_from_z_to(normal), normal, opacity_logit, color }
}

/// As training on pictures leaves them; `along` is the tangent and the distance from the nearest edge.
fn trained(
    coord: V3,
    normal: V3,
    (tangent, edge): (V3, f64),
    color: V3,
    ln_spacing: f64,
    look: &Look,
    rng: &mut SampleRng,
) -> Splat {
    let far = chance(rng, look.strays);
    let off = noise(rng) * if far { 0.015 } else { look.rough };
    let normal = unit_or(std::array::from_fn(|i| normal[i] + look.tilt * noise(rng)), normal);
    let tangent = unit_or(add_times(tangent, normal, -dot(tangent, normal)), basis(normal)[0]);
    let other = cross(normal, tangent);
    // Long pieces lie along edges; elsewhere in any direction.
    let (a, b) = if edge < 0.03 && chance(rng, 0.8) {
        (tangent, other)
    } else {
        let [c, s] = cos_sin(rng);
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
    let shift = whole(rng, 0, 2) as usize;
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
    match whole(rng, 0, 7) {
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
    use scenesplat_scene::vector::rotation;

    #[test]
    fn quaternions_have_the_axes_as_columns() {
        let mut rng = sample_rng(1, 0, 0);
        for i in 0..500 {
            let w = direction(&mut rng);
            let [u, v] = basis(w);
            let mut axes = [u, v, w];
            axes.rotate_left(i % 3);
            let turn = rotation(quat_of(axes));
            for (k, axis) in axes.iter().enumerate() {
                for i in 0..3 {
                    assert!((turn[i][k] - axis[i]).abs() < 1e-9, "{turn:?} {axes:?}");
                }
            }
        }
    }
}
