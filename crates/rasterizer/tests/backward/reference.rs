//! The slow, obvious version in f64: every pixel looks at every Gaussian, matrices are the
//! textbook's. Nothing is shared with the crate.

pub type Mat3 = [[f64; 3]; 3];

/// One pinhole camera.
#[derive(Debug, Clone)]
pub struct Camera {
    pub rotation: Mat3,
    pub translation: [f64; 3],
    pub focal: [f64; 2],
    pub centre: [f64; 2],
    pub size: [usize; 2],
}

/// Constants of a render.
#[derive(Debug, Clone)]
pub struct Rules {
    pub eps2d: f64,
    pub alpha_max: f64,
    pub floor: Option<f64>,
    pub normalize: bool,
    pub background: [f64; 3],
}

impl Rules {
    pub fn classic() -> Self {
        Self { eps2d: 0.3, alpha_max: 0.99, floor: None, normalize: true, background: [0.0; 3] }
    }
}

/// Parameters, one row per Gaussian; colours are the harmonics `[K][3]`, flattened.
#[derive(Debug, Clone, Default)]
pub struct Params {
    pub means: Vec<[f64; 3]>,
    pub quats: Vec<[f64; 4]>,
    pub scales: Vec<[f64; 3]>,
    pub opacities: Vec<f64>,
    pub sh: Vec<Vec<f64>>,
    pub features: Vec<Vec<f64>>,
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
    offset: [f64; 2],
}

/// What is drawn, and per pixel who took part: the decisions that carry no gradient.
pub struct Picture {
    hits: Vec<Vec<Hit>>,
    pub rgb: Vec<[f64; 3]>,
    pub alpha: Vec<f64>,
    pub depth: Vec<f64>,
    pub features: Vec<Vec<f64>>,
    drawn: Vec<Option<Drawn>>,
}

/// Who takes part at each pixel, front to back.
pub type Decisions = Vec<Vec<usize>>;

impl Picture {
    pub fn decisions(&self) -> Decisions {
        self.hits.iter().map(|p| p.iter().map(|h| h.gaussian).collect()).collect()
    }
}

fn mul<const R: usize, const K: usize, const C: usize>(
    a: &[[f64; K]; R],
    b: &[[f64; C]; K],
) -> [[f64; C]; R] {
    let mut out = [[0.0; C]; R];
    for i in 0..R {
        for j in 0..C {
            out[i][j] = (0..K).map(|k| a[i][k] * b[k][j]).sum();
        }
    }
    out
}

fn transpose<const R: usize, const C: usize>(a: &[[f64; C]; R]) -> [[f64; R]; C] {
    let mut out = [[0.0; R]; C];
    for i in 0..R {
        for j in 0..C {
            out[j][i] = a[i][j];
        }
    }
    out
}

fn add<const R: usize, const C: usize>(a: &[[f64; C]; R], b: &[[f64; C]; R]) -> [[f64; C]; R] {
    let mut out = *a;
    for i in 0..R {
        for j in 0..C {
            out[i][j] += b[i][j];
        }
    }
    out
}

fn rotation([w, x, y, z]: [f64; 4]) -> Mat3 {
    [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
}

fn norm<const N: usize>(v: [f64; N]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// One Gaussian on the picture plane, with everything the backward pass looks at again.
#[derive(Debug, Clone)]
struct Drawn {
    camera: [f64; 3],
    at: [f64; 2],
    conic: [f64; 3],
    jacobian: [[f64; 3]; 2],
    tangent: [f64; 2],
    inside: [bool; 2],
    camera_covariance: Mat3,
    m: Mat3,
    rotation: Mat3,
    rho: f64,
    color: [f64; 3],
    lit: [bool; 3],
    direction: [f64; 3],
    distance: f64,
}

fn draw(p: &Params, i: usize, cam: &Camera, rules: &Rules) -> Option<Drawn> {
    let mean = p.means[i];
    let mut c = cam.translation;
    for a in 0..3 {
        c[a] += (0..3).map(|b| cam.rotation[a][b] * mean[b]).sum::<f64>();
    }
    if c[2] < 0.01 {
        return None;
    }
    let length = if rules.normalize { norm(p.quats[i]) } else { 1.0 };
    let rotation = rotation(p.quats[i].map(|q| q / length));
    let mut m = rotation;
    for row in &mut m {
        for k in 0..3 {
            row[k] *= p.scales[i][k];
        }
    }
    let covariance = mul(&m, &transpose(&m));
    let camera_covariance = mul(&mul(&cam.rotation, &covariance), &transpose(&cam.rotation));
    let (mut tangent, mut inside) = ([0.0; 2], [true; 2]);
    for a in 0..2 {
        let side = cam.size[a] as f64;
        let margin = 0.3 * side / (2.0 * cam.focal[a]);
        let high = (side - cam.centre[a]) / cam.focal[a] + margin;
        let low = -cam.centre[a] / cam.focal[a] - margin;
        let own = c[a] / c[2];
        inside[a] = own >= low && own <= high;
        tangent[a] = c[2] * own.clamp(low, high);
    }
    let z2 = c[2] * c[2];
    let jacobian = [
        [cam.focal[0] / c[2], 0.0, -cam.focal[0] * tangent[0] / z2],
        [0.0, cam.focal[1] / c[2], -cam.focal[1] * tangent[1] / z2],
    ];
    let flat = mul(&mul(&jacobian, &camera_covariance), &transpose(&jacobian));
    let det_flat = flat[0][0] * flat[1][1] - flat[0][1] * flat[1][0];
    let (s11, s22, s12) = (flat[0][0] + rules.eps2d, flat[1][1] + rules.eps2d, flat[0][1]);
    let det = s11 * s22 - s12 * s12;
    let rho = rules.floor.map_or(1.0, |floor| (det_flat / det).max(floor * floor).sqrt());
    let at = [0, 1].map(|a| cam.focal[a] * c[a] / c[2] + cam.centre[a]);

    let mut eye = [0.0; 3];
    for k in 0..3 {
        eye[k] = -(0..3).map(|a| cam.rotation[a][k] * cam.translation[a]).sum::<f64>();
    }
    let to = [0, 1, 2].map(|k| mean[k] - eye[k]);
    let distance = norm(to);
    let direction = to.map(|x| x / distance);
    let basis = basis(direction);
    let raw = [0, 1, 2].map(|ch| {
        0.5 + (0..p.sh[i].len() / 3).map(|k| basis[k] * p.sh[i][3 * k + ch]).sum::<f64>()
    });
    Some(Drawn {
        camera: c,
        at,
        conic: [s22 / det, -s12 / det, s11 / det],
        jacobian,
        tangent,
        inside,
        camera_covariance,
        m,
        rotation,
        rho,
        color: raw.map(|v| v.max(0.0)),
        lit: raw.map(|v| v >= 0.0),
        direction,
        distance,
    })
}

/// Real spherical harmonics up to degree 3.
fn basis([x, y, z]: [f64; 3]) -> [f64; 16] {
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
pub fn forward(p: &Params, cam: &Camera, rules: &Rules, decisions: Option<&Decisions>) -> Picture {
    let drawn: Vec<Option<Drawn>> = (0..p.means.len()).map(|i| draw(p, i, cam, rules)).collect();
    let mut order: Vec<usize> = (0..p.means.len()).filter(|i| drawn[*i].is_some()).collect();
    order.sort_by(|a, b| {
        let depth = |i: usize| drawn[i].as_ref().map_or(0.0, |d| d.camera[2]);
        depth(*a).total_cmp(&depth(*b))
    });
    let [w, h] = cam.size;
    let dim = p.features.first().map_or(0, Vec::len);
    let mut out = Picture {
        hits: Vec::new(),
        rgb: Vec::new(),
        alpha: Vec::new(),
        depth: Vec::new(),
        features: Vec::new(),
        drawn: Vec::new(),
    };
    for pixel in 0..w * h {
        let (x, y) = ((pixel % w) as f64 + 0.5, (pixel / w) as f64 + 0.5);
        let mut t = 1.0;
        let (mut rgb, mut depth, mut features) = ([0.0; 3], 0.0, vec![0.0; dim]);
        let mut hits = Vec::new();
        let candidates = decisions.map_or(&order, |d| &d[pixel]);
        for &i in candidates {
            let Some(g) = &drawn[i] else { continue };
            let offset = [g.at[0] - x, g.at[1] - y];
            let [a, b, c] = g.conic;
            let sigma = 0.5 * (a * offset[0] * offset[0] + c * offset[1] * offset[1])
                + b * offset[0] * offset[1];
            let exp = (-sigma).exp();
            let alpha = (p.opacities[i] * g.rho * exp).min(rules.alpha_max);
            let after = t * (1.0 - alpha);
            if decisions.is_none() {
                if alpha < 1.0 / 255.0 {
                    continue;
                }
                if after <= 1e-4 {
                    break;
                }
            }
            let weight = alpha * t;
            for ch in 0..3 {
                rgb[ch] += weight * g.color[ch];
            }
            depth += weight * g.camera[2];
            for d in 0..dim {
                features[d] += weight * p.features[i][d];
            }
            hits.push(Hit { gaussian: i, alpha, before: t, exp, offset });
            t = after;
        }
        for ch in 0..3 {
            rgb[ch] += t * rules.background[ch];
        }
        out.rgb.push(rgb);
        out.alpha.push(1.0 - t);
        out.depth.push(depth);
        out.features.push(features);
        out.hits.push(hits);
    }
    out.drawn = drawn;
    out
}

/// `Σ upstream · picture`
pub fn loss(picture: &Picture, up: &Upstream) -> f64 {
    let mut sum = 0.0;
    for pixel in 0..picture.alpha.len() {
        if let Some(v) = up.rgb.get(pixel) {
            sum += (0..3).map(|c| v[c] * picture.rgb[pixel][c]).sum::<f64>();
        }
        let (alpha, depth) = (picture.alpha[pixel], picture.depth[pixel]);
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
    at: [f64; 2],
    conic: [f64; 3],
    opacity: f64,
    depth: f64,
    color: [f64; 3],
}

/// Gradients of [`loss`]; `through_direction` says whether colour moves the means.
pub fn backward(
    p: &Params,
    cam: &Camera,
    rules: &Rules,
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
    for (pixel, hits) in picture.hits.iter().enumerate() {
        let v_rgb = up.rgb.get(pixel).copied().unwrap_or_default();
        let alpha = picture.alpha[pixel].max(1e-10);
        let v_expected = up.depth_expected.get(pixel).copied().unwrap_or(0.0);
        let v_depth = up.depth_accumulated.get(pixel).copied().unwrap_or(0.0) + v_expected / alpha;
        let v_alpha = up.alpha.get(pixel).copied().unwrap_or(0.0)
            - v_expected * picture.depth[pixel] / (alpha * alpha);
        // What is behind, in units of the loss.
        let last = 1.0 - picture.alpha[pixel];
        let mut behind =
            last * ((0..3).map(|c| v_rgb[c] * rules.background[c]).sum::<f64>() - v_alpha);
        for hit in hits.iter().rev() {
            let i = hit.gaussian;
            let Some(g) = &picture.drawn[i] else { continue };
            let weight = hit.alpha * hit.before;
            let mut value = v_depth * g.camera[2];
            flat[i].depth += weight * v_depth;
            for ch in 0..3 {
                value += v_rgb[ch] * g.color[ch];
                flat[i].color[ch] += weight * v_rgb[ch];
            }
            if let Some(v) = up.features.get(pixel) {
                for d in 0..v.len() {
                    value += v[d] * p.features[i][d];
                    out.features[i][d] += weight * v[d];
                }
            }
            let of_alpha = hit.before * value - behind / (1.0 - hit.alpha);
            behind += weight * value;
            let opacity = p.opacities[i] * g.rho;
            if opacity * hit.exp > rules.alpha_max {
                continue;
            }
            let of_sigma = -opacity * hit.exp * of_alpha;
            let ([dx, dy], [a, b, c]) = (hit.offset, g.conic);
            flat[i].opacity += hit.exp * of_alpha;
            flat[i].conic[0] += 0.5 * of_sigma * dx * dx;
            flat[i].conic[1] += of_sigma * dx * dy;
            flat[i].conic[2] += 0.5 * of_sigma * dy * dy;
            flat[i].at[0] += of_sigma * (a * dx + b * dy);
            flat[i].at[1] += of_sigma * (b * dx + c * dy);
        }
    }
    for i in 0..n {
        if let Some(g) = &picture.drawn[i] {
            geometry(p, i, cam, rules, g, &flat[i], &mut out);
            color(p, i, g, &flat[i], through_direction, &mut out);
        }
    }
    out
}

fn geometry(
    p: &Params,
    i: usize,
    cam: &Camera,
    rules: &Rules,
    g: &Drawn,
    flat: &Flat,
    out: &mut Params,
) {
    let [a, b, c] = g.conic;
    let inverse = [[a, b], [b, c]];
    let half = [[flat.conic[0], 0.5 * flat.conic[1]], [0.5 * flat.conic[1], flat.conic[2]]];
    let mut of_flat = mul(&mul(&inverse, &half), &inverse).map(|row| row.map(|x| -x));
    out.opacities[i] = g.rho * flat.opacity;
    if let Some(floor) = rules.floor
        && g.rho > floor
    {
        let k = p.opacities[i] * flat.opacity / (2.0 * g.rho);
        let det = a * c - b * b;
        for r in 0..2 {
            for s in 0..2 {
                let identity = if r == s { rules.eps2d * det } else { 0.0 };
                of_flat[r][s] += k * ((1.0 - g.rho * g.rho) * inverse[r][s] - identity);
            }
        }
    }
    let of_camera_covariance = mul(&mul(&transpose(&g.jacobian), &of_flat), &g.jacobian);
    let of_jacobian = add(
        &mul(&mul(&of_flat, &g.jacobian), &transpose(&g.camera_covariance)),
        &mul(&mul(&transpose(&of_flat), &g.jacobian), &g.camera_covariance),
    );
    let [x, y, z] = g.camera;
    let [fx, fy] = cam.focal;
    let (z2, z3) = (z * z, z * z * z);
    let mut of_camera = [
        fx / z * flat.at[0],
        fy / z * flat.at[1],
        -(fx * x * flat.at[0] + fy * y * flat.at[1]) / z2 + flat.depth,
    ];
    for axis in 0..2 {
        let f = cam.focal[axis];
        let (own, third) = (of_jacobian[axis][axis], of_jacobian[axis][2]);
        if g.inside[axis] {
            of_camera[axis] -= f / z2 * third;
        } else {
            of_camera[2] -= f / z3 * third * g.tangent[axis];
        }
        of_camera[2] += -f / z2 * own + 2.0 * f * g.tangent[axis] / z3 * third;
    }
    for k in 0..3 {
        out.means[i][k] = (0..3).map(|r| cam.rotation[r][k] * of_camera[r]).sum();
    }
    let of_covariance = mul(&mul(&transpose(&cam.rotation), &of_camera_covariance), &cam.rotation);
    let of_m = mul(&add(&of_covariance, &transpose(&of_covariance)), &g.m);
    for k in 0..3 {
        out.scales[i][k] = (0..3).map(|r| g.rotation[r][k] * of_m[r][k]).sum();
    }
    let mut m = of_m;
    for row in &mut m {
        for k in 0..3 {
            row[k] *= p.scales[i][k];
        }
    }
    let length = if rules.normalize { norm(p.quats[i]) } else { 1.0 };
    let unit = p.quats[i].map(|q| q / length);
    let [w, qx, qy, qz] = unit;
    let raw = [
        2.0 * (qx * (m[2][1] - m[1][2]) + qy * (m[0][2] - m[2][0]) + qz * (m[1][0] - m[0][1])),
        2.0 * (-2.0 * qx * (m[1][1] + m[2][2])
            + qy * (m[1][0] + m[0][1])
            + qz * (m[2][0] + m[0][2])
            + w * (m[2][1] - m[1][2])),
        2.0 * (qx * (m[1][0] + m[0][1]) - 2.0 * qy * (m[0][0] + m[2][2])
            + qz * (m[2][1] + m[1][2])
            + w * (m[0][2] - m[2][0])),
        2.0 * (qx * (m[2][0] + m[0][2]) + qy * (m[2][1] + m[1][2])
            - 2.0 * qz * (m[0][0] + m[1][1])
            + w * (m[1][0] - m[0][1])),
    ];
    let along: f64 = if rules.normalize { (0..4).map(|k| raw[k] * unit[k]).sum() } else { 0.0 };
    out.quats[i] = [0, 1, 2, 3].map(|k| (raw[k] - along * unit[k]) / length);
}

fn color(p: &Params, i: usize, g: &Drawn, flat: &Flat, through_direction: bool, out: &mut Params) {
    let basis_here = basis(g.direction);
    let of_color = [0, 1, 2].map(|ch| if g.lit[ch] { flat.color[ch] } else { 0.0 });
    for k in 0..p.sh[i].len() / 3 {
        for ch in 0..3 {
            out.sh[i][3 * k + ch] = basis_here[k] * of_color[ch];
        }
    }
    if !through_direction {
        return;
    }
    // The slope of the basis along each axis, by differences: another way than the crate's.
    let step = 1e-5;
    let mut of_direction = [0.0; 3];
    for axis in 0..3 {
        let (mut up, mut down) = (g.direction, g.direction);
        up[axis] += step;
        down[axis] -= step;
        let (up, down) = (basis(up), basis(down));
        for k in 0..p.sh[i].len() / 3 {
            let slope = (up[k] - down[k]) / (2.0 * step);
            of_direction[axis] +=
                slope * (0..3).map(|ch| of_color[ch] * p.sh[i][3 * k + ch]).sum::<f64>();
        }
    }
    let along: f64 = (0..3).map(|k| of_direction[k] * g.direction[k]).sum();
    for k in 0..3 {
        out.means[i][k] += (of_direction[k] - along * g.direction[k]) / g.distance;
    }
}
