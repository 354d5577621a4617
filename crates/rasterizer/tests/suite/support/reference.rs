//! The slow, obvious version in f64: every Gaussian at every pixel, matrices of the textbook. Nothing is shared
//! with the crate but its parameters.

use glam::{DMat3, DQuat, DVec2, DVec3};
use scenesplat_rasterizer::{Gaussians, RasterSettings, View};

/// Parameters, one row per Gaussian; colors are the harmonics `[K][3]`, flattened.
#[derive(Debug, Clone, Default)]
pub struct Params {
    pub means: Vec<[f64; 3]>,
    pub quats: Vec<[f64; 4]>,
    pub scales: Vec<[f64; 3]>,
    pub opacities: Vec<f64>,
    pub sh: Vec<Vec<f64>>,
    pub features: Vec<Vec<f64>>,
}

impl From<&Gaussians> for Params {
    fn from(g: &Gaussians) -> Self {
        let sh = g.sh.chunks_exact(3 * g.sh_len());
        Self {
            means: g.means.iter().map(|r| r.map(f64::from)).collect(),
            quats: g.quats.iter().map(|r| r.map(f64::from)).collect(),
            scales: g.scales.iter().map(|r| r.map(f64::from)).collect(),
            opacities: g.opacities.iter().map(|&v| v.into()).collect(),
            sh: sh.map(|row| row.iter().map(|&v| v.into()).collect()).collect(),
            features: Vec::new(),
        }
    }
}

/// The gradient that comes from above, per pixel.
#[derive(Debug, Clone, Default)]
pub struct Upstream {
    pub rgb: Vec<[f64; 3]>,
    pub alpha: Vec<f64>,
    pub depth_accumulated: Vec<f64>,
    pub depth_expected: Vec<f64>,
    pub features: Vec<Vec<f64>>,
}

/// A Gaussian at one pixel: `α`, and `T` before it.
#[derive(Debug, Clone, Copy)]
struct Hit {
    gaussian: usize,
    alpha: f64,
    before: f64,
    exp: f64,
    offset: DVec2,
}

/// What is drawn, and per pixel who took part: the decisions that carry no gradient.
#[derive(Default)]
pub struct Picture {
    hits: Vec<Vec<Hit>>,
    pub rgb: Vec<DVec3>,
    pub alpha: Vec<f64>,
    pub depth: Vec<f64>,
    pub features: Vec<Vec<f64>>,
    /// Whether a decision of the pixel is within float noise.
    pub doubtful: Vec<bool>,
    drawn: Vec<Option<Drawn>>,
}

/// Who takes part at each pixel, front to back.
pub type Decisions = Vec<Vec<usize>>;

impl Picture {
    pub fn decisions(&self) -> Decisions {
        self.hits.iter().map(|p| p.iter().map(|h| h.gaussian).collect()).collect()
    }
}

fn from_rows(rows: [[f64; 3]; 3]) -> DMat3 {
    DMat3::from_cols_array_2d(&rows).transpose()
}

/// A camera in f64.
struct Camera {
    rotation: DMat3,
    translation: DVec3,
    focal: DVec2,
    center: DVec2,
    size: DVec2,
}

impl From<&View> for Camera {
    fn from(view: &View) -> Self {
        let rows = view.world_to_camera.map(|row| row.map(f64::from));
        Self {
            rotation: from_rows(rows.map(|[x, y, z, _]| [x, y, z])),
            translation: DVec3::from(rows.map(|row| row[3])),
            focal: DVec2::new(view.fx.into(), view.fy.into()),
            center: DVec2::new(view.cx.into(), view.cy.into()),
            size: DVec2::new(view.width.into(), view.height.into()),
        }
    }
}

/// A quaternion's rotation and its length; 1 for one that is used as it is.
fn turn([w, x, y, z]: [f64; 4], settings: &RasterSettings) -> (DQuat, f64) {
    let quat = DQuat::from_xyzw(x, y, z, w);
    let length = if settings.normalize_quats { quat.length() } else { 1.0 };
    (quat / length, length)
}

/// One Gaussian on the picture plane, with everything that the backward pass needs again.
#[derive(Debug, Clone)]
struct Drawn {
    camera: DVec3,
    at: DVec2,
    conic: [f64; 3],
    jacobian: DMat3,
    tangent: DVec2,
    inside: [bool; 2],
    camera_covariance: DMat3,
    m: DMat3,
    rotation: DMat3,
    rho: f64,
    color: DVec3,
    lit: [bool; 3],
    direction: DVec3,
    distance: f64,
}

fn draw(p: &Params, i: usize, cam: &Camera, settings: &RasterSettings) -> Option<Drawn> {
    let mean = DVec3::from(p.means[i]);
    let camera = cam.rotation * mean + cam.translation;
    if camera.z < settings.near.into() {
        return None;
    }
    let rotation = DMat3::from_quat(turn(p.quats[i], settings).0);
    let m = rotation * DMat3::from_diagonal(p.scales[i].into());
    let camera_covariance = cam.rotation * (m * m.transpose()) * cam.rotation.transpose();
    let margin = 0.15 * cam.size / cam.focal;
    let (low, high) =
        (-cam.center / cam.focal - margin, (cam.size - cam.center) / cam.focal + margin);
    let own = camera.truncate() / camera.z;
    let inside = own.cmpge(low) & own.cmple(high);
    let tangent = camera.z * own.clamp(low, high);
    let (f, z) = (cam.focal, camera.z);
    let third = -f * tangent / (z * z);
    let jacobian = from_rows([[f.x / z, 0.0, third.x], [0.0, f.y / z, third.y], [0.0; 3]]);
    let flat = jacobian * camera_covariance * jacobian.transpose();
    let (a, b, c) = (flat.x_axis.x, flat.x_axis.y, flat.y_axis.y);
    let eps = f64::from(settings.eps2d);
    let (s11, s22) = (a + eps, c + eps);
    let det = s11 * s22 - b * b;
    let floor = f64::from(settings.antialias_floor);
    let sharp = ((a * c - b * b) / det).max(floor * floor).sqrt();
    let (basis, direction, distance) = {
        let to = mean + cam.rotation.transpose() * cam.translation;
        (basis(to.normalize()), to.normalize(), to.length())
    };
    let raw = [0, 1, 2].map(|ch| {
        0.5 + (0..p.sh[i].len() / 3).map(|k| basis[k] * p.sh[i][3 * k + ch]).sum::<f64>()
    });
    Some(Drawn {
        camera,
        at: f * own + cam.center,
        conic: [s22 / det, -b / det, s11 / det],
        jacobian,
        tangent,
        inside: inside.into(),
        camera_covariance,
        m,
        rotation,
        rho: if settings.antialiased { sharp } else { 1.0 },
        color: DVec3::from(raw).max(DVec3::ZERO),
        lit: raw.map(|v| v >= 0.0),
        direction,
        distance,
    })
}

/// Real spherical harmonics up to degree 3.
fn basis(DVec3 { x, y, z }: DVec3) -> [f64; 16] {
    let (xx, yy, zz) = (x * x, y * y, z * z);
    [
        0.2820947917738781,
        -0.48860251190292 * y,
        0.48860251190292 * z,
        -0.48860251190292 * x,
        1.092548430592079 * x * y,
        -1.092548430592079 * y * z,
        0.9461746957575601 * zz - 0.3153915652525201,
        -1.092548430592079 * x * z,
        0.5462742152960395 * (xx - yy),
        -0.5900435899266435 * y * (3.0 * xx - yy),
        2.890611442640554 * x * y * z,
        y * (0.4570457994644658 - 2.285228997322329 * zz),
        z * (1.865881662950577 * zz - 1.119528997770346),
        x * (0.4570457994644658 - 2.285228997322329 * zz),
        1.445305721320277 * z * (xx - yy),
        -0.5900435899266435 * x * (xx - 3.0 * yy),
    ]
}

/// Draws; with `decisions`, exactly those Gaussians at each pixel that it names.
pub fn forward(
    p: &Params,
    view: &View,
    settings: &RasterSettings,
    decisions: Option<&Decisions>,
) -> Picture {
    let cam = Camera::from(view);
    let drawn: Vec<Option<Drawn>> =
        (0..p.means.len()).map(|i| draw(p, i, &cam, settings)).collect();
    let mut order: Vec<usize> = (0..p.means.len()).filter(|i| drawn[*i].is_some()).collect();
    // As f32, so that depths that are equal there keep their order.
    let depth = |i: &usize| drawn[*i].as_ref().map_or(0.0, |d| d.camera.z as f32);
    order.sort_by(|a, b| depth(a).total_cmp(&depth(b)));
    let mut out = Picture::default();
    for pixel in 0..view.pixels() {
        let candidates = decisions.map_or(&order, |d| &d[pixel]);
        draw_pixel(p, view, settings, &drawn, (pixel, candidates, decisions.is_some()), &mut out);
    }
    out.drawn = drawn;
    out
}

/// Adds one pixel: its number, the Gaussians that may be in it, and whether all of them are.
fn draw_pixel(
    p: &Params,
    view: &View,
    settings: &RasterSettings,
    drawn: &[Option<Drawn>],
    (pixel, candidates, all): (usize, &[usize], bool),
    out: &mut Picture,
) {
    let width = view.width as usize;
    let at = DVec2::new((pixel % width) as f64, (pixel / width) as f64) + 0.5;
    let (cut, stop) = (f64::from(settings.alpha_cut), f64::from(settings.stop));
    let (mut t, mut rgb, mut depth, mut doubtful) = (1.0, DVec3::ZERO, 0.0, false);
    let mut features = vec![0.0; p.features.first().map_or(0, Vec::len)];
    let mut hits = Vec::new();
    for &i in candidates {
        let Some(g) = &drawn[i] else { continue };
        let offset = g.at - at;
        let ([a, b, c], DVec2 { x, y }) = (g.conic, offset);
        let exp = (-(0.5 * (a * x * x + c * y * y) + b * x * y)).exp();
        let alpha = (p.opacities[i] * g.rho * exp).min(settings.alpha_max.into());
        let after = t * (1.0 - alpha);
        if !all {
            doubtful |= (alpha / cut - 1.0).abs() < 2e-3;
            if alpha < cut {
                continue;
            }
            doubtful |= (after / stop - 1.0).abs() < 2e-3;
            if after <= stop {
                break;
            }
        }
        let weight = alpha * t;
        rgb += weight * g.color;
        depth += weight * g.camera.z;
        for (sum, f) in features.iter_mut().zip(p.features.get(i).into_iter().flatten()) {
            *sum += weight * f;
        }
        hits.push(Hit { gaussian: i, alpha, before: t, exp, offset });
        t = after;
    }
    out.rgb.push(rgb + t * background(settings));
    out.alpha.push(1.0 - t);
    out.depth.push(depth);
    out.features.push(features);
    out.doubtful.push(doubtful);
    out.hits.push(hits);
}

fn background(settings: &RasterSettings) -> DVec3 {
    DVec3::from(settings.background.unwrap_or_default().map(f64::from))
}

/// `Σ upstream · picture`
pub fn loss(picture: &Picture, up: &Upstream) -> f64 {
    let mut sum = 0.0;
    for pixel in 0..picture.alpha.len() {
        let (alpha, depth) = (picture.alpha[pixel], picture.depth[pixel]);
        sum += up.rgb.get(pixel).map_or(0.0, |v| picture.rgb[pixel].dot((*v).into()));
        sum += up.alpha.get(pixel).map_or(0.0, |v| v * alpha);
        sum += up.depth_accumulated.get(pixel).map_or(0.0, |v| v * depth);
        sum += up.depth_expected.get(pixel).map_or(0.0, |v| v * depth / alpha.max(1e-10));
        if let Some(v) = up.features.get(pixel) {
            sum += v.iter().zip(&picture.features[pixel]).map(|(v, f)| v * f).sum::<f64>();
        }
    }
    sum
}

/// Gradients on the picture plane, of one Gaussian.
#[derive(Debug, Clone, Default)]
struct Flat {
    at: DVec2,
    conic: [f64; 3],
    opacity: f64,
    depth: f64,
    color: DVec3,
}

/// Gradients of [`loss`]; `through_direction` says whether color moves the means.
pub fn backward(
    p: &Params,
    view: &View,
    settings: &RasterSettings,
    picture: &Picture,
    up: &Upstream,
    through_direction: bool,
) -> Params {
    let n = p.means.len();
    let mut flat = vec![Flat::default(); n];
    let mut out = Params {
        means: vec![[0.0; 3]; n],
        quats: vec![[0.0; 4]; n],
        scales: vec![[0.0; 3]; n],
        opacities: vec![0.0; n],
        sh: p.sh.iter().map(|s| vec![0.0; s.len()]).collect(),
        features: p.features.iter().map(|f| vec![0.0; f.len()]).collect(),
    };
    for pixel in 0..picture.hits.len() {
        backward_pixel(p, settings, picture, up, pixel, &mut flat, &mut out.features);
    }
    let cam = Camera::from(view);
    for i in 0..n {
        if let Some(g) = &picture.drawn[i] {
            geometry(p, i, &cam, settings, g, &flat[i], &mut out);
            color(p, i, g, flat[i].color, through_direction, &mut out);
        }
    }
    out
}

fn backward_pixel(
    p: &Params,
    settings: &RasterSettings,
    picture: &Picture,
    up: &Upstream,
    pixel: usize,
    flat: &mut [Flat],
    of_features: &mut [Vec<f64>],
) {
    let v_rgb = DVec3::from(up.rgb.get(pixel).copied().unwrap_or_default());
    let of = |plane: &[f64]| plane.get(pixel).copied().unwrap_or(0.0);
    let alpha = picture.alpha[pixel].max(1e-10);
    let v_expected = of(&up.depth_expected);
    let v_depth = of(&up.depth_accumulated) + v_expected / alpha;
    let v_alpha = of(&up.alpha) - v_expected * picture.depth[pixel] / (alpha * alpha);
    // What is behind, in units of the loss.
    let mut behind = (1.0 - picture.alpha[pixel]) * (v_rgb.dot(background(settings)) - v_alpha);
    for hit in picture.hits[pixel].iter().rev() {
        let i = hit.gaussian;
        let Some(g) = &picture.drawn[i] else { continue };
        let weight = hit.alpha * hit.before;
        let mut value = v_depth * g.camera.z + v_rgb.dot(g.color);
        flat[i].depth += weight * v_depth;
        flat[i].color += weight * v_rgb;
        for (d, v) in up.features.get(pixel).into_iter().flatten().enumerate() {
            value += v * p.features[i][d];
            of_features[i][d] += weight * v;
        }
        let of_alpha = hit.before * value - behind / (1.0 - hit.alpha);
        behind += weight * value;
        let opacity = p.opacities[i] * g.rho;
        if opacity * hit.exp > settings.alpha_max.into() {
            continue;
        }
        let of_sigma = -opacity * hit.exp * of_alpha;
        let (DVec2 { x, y }, [a, b, c]) = (hit.offset, g.conic);
        flat[i].opacity += hit.exp * of_alpha;
        flat[i].conic[0] += 0.5 * of_sigma * x * x;
        flat[i].conic[1] += of_sigma * x * y;
        flat[i].conic[2] += 0.5 * of_sigma * y * y;
        flat[i].at += of_sigma * DVec2::new(a * x + b * y, b * x + c * y);
    }
}

fn geometry(
    p: &Params,
    i: usize,
    cam: &Camera,
    settings: &RasterSettings,
    g: &Drawn,
    flat: &Flat,
    out: &mut Params,
) {
    let [a, b, c] = g.conic;
    let inverse = from_rows([[a, b, 0.0], [b, c, 0.0], [0.0; 3]]);
    let [h0, h1, h2] = flat.conic;
    let half = from_rows([[h0, 0.5 * h1, 0.0], [0.5 * h1, h2, 0.0], [0.0; 3]]);
    let mut of_flat = -(inverse * half * inverse);
    out.opacities[i] = g.rho * flat.opacity;
    if settings.antialiased && g.rho > settings.antialias_floor.into() {
        let identity = DMat3::from_diagonal(DVec3::new(1.0, 1.0, 0.0));
        let slope = (1.0 - g.rho * g.rho) * inverse
            - f64::from(settings.eps2d) * (a * c - b * b) * identity;
        of_flat += p.opacities[i] * flat.opacity / (2.0 * g.rho) * slope;
    }
    let (j, covariance) = (g.jacobian, g.camera_covariance);
    let of_camera_covariance = j.transpose() * of_flat * j;
    let of_jacobian = of_flat * j * covariance.transpose() + of_flat.transpose() * j * covariance;
    let (f, z) = (cam.focal, g.camera.z);
    let (z2, z3) = (z * z, z * z * z);
    let of_at = f / z * flat.at;
    let mut of_camera = of_at.extend(flat.depth - of_at.dot(g.camera.truncate()) / z);
    for axis in 0..2 {
        let (own, third) = (of_jacobian.col(axis)[axis], of_jacobian.z_axis[axis]);
        if g.inside[axis] {
            of_camera[axis] -= f[axis] / z2 * third;
        } else {
            of_camera.z -= f[axis] / z3 * third * g.tangent[axis];
        }
        of_camera.z += -f[axis] / z2 * own + 2.0 * f[axis] * g.tangent[axis] / z3 * third;
    }
    out.means[i] = (cam.rotation.transpose() * of_camera).into();
    let of_covariance = cam.rotation.transpose() * of_camera_covariance * cam.rotation;
    let of_m = (of_covariance + of_covariance.transpose()) * g.m;
    out.scales[i] = [0, 1, 2].map(|k| g.rotation.col(k).dot(of_m.col(k)));
    out.quats[i] = of_quat(p.quats[i], of_m * DMat3::from_diagonal(p.scales[i].into()), settings);
}

/// The gradient of a quaternion from that of its rotation.
fn of_quat(quat: [f64; 4], of_rotation: DMat3, settings: &RasterSettings) -> [f64; 4] {
    let m = of_rotation.transpose().to_cols_array_2d();
    let (DQuat { x, y, z, w }, length) = turn(quat, settings);
    let raw = [
        2.0 * (x * (m[2][1] - m[1][2]) + y * (m[0][2] - m[2][0]) + z * (m[1][0] - m[0][1])),
        2.0 * (-2.0 * x * (m[1][1] + m[2][2])
            + y * (m[1][0] + m[0][1])
            + z * (m[2][0] + m[0][2])
            + w * (m[2][1] - m[1][2])),
        2.0 * (x * (m[1][0] + m[0][1]) - 2.0 * y * (m[0][0] + m[2][2])
            + z * (m[2][1] + m[1][2])
            + w * (m[0][2] - m[2][0])),
        2.0 * (x * (m[2][0] + m[0][2]) + y * (m[2][1] + m[1][2]) - 2.0 * z * (m[0][0] + m[1][1])
            + w * (m[1][0] - m[0][1])),
    ];
    let unit = [w, x, y, z];
    let along: f64 =
        if settings.normalize_quats { (0..4).map(|k| raw[k] * unit[k]).sum() } else { 0.0 };
    [0, 1, 2, 3].map(|k| (raw[k] - along * unit[k]) / length)
}

fn color(
    p: &Params,
    i: usize,
    g: &Drawn,
    of_color: DVec3,
    through_direction: bool,
    out: &mut Params,
) {
    let here = basis(g.direction);
    let of_color = [0, 1, 2].map(|ch| if g.lit[ch] { of_color[ch] } else { 0.0 });
    let bands = p.sh[i].len() / 3;
    for k in 0..bands {
        for ch in 0..3 {
            out.sh[i][3 * k + ch] = here[k] * of_color[ch];
        }
    }
    if !through_direction {
        return;
    }
    // The slope of the basis along each axis, by differences: another way than the crate's.
    let step = 1e-5;
    let of_direction = DVec3::from(DVec3::AXES.map(|axis| {
        let (up, down) = (basis(g.direction + step * axis), basis(g.direction - step * axis));
        let value = |k: usize| (0..3).map(|ch| of_color[ch] * p.sh[i][3 * k + ch]).sum::<f64>();
        (0..bands).map(|k| (up[k] - down[k]) / (2.0 * step) * value(k)).sum()
    }));
    let across = of_direction.reject_from_normalized(g.direction) / g.distance;
    out.means[i] = (DVec3::from(out.means[i]) + across).into();
}
