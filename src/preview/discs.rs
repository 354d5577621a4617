//! Discs with a depth buffer.

use super::Theme;
use rayon::prelude::*;
use scenesplat_scene::picture::RgbPicture;

/// A Gaussian as it is drawn.
#[derive(Clone, Copy)]
pub(super) struct Disc {
    pub(super) centre: [f32; 3],
    /// Standard deviation, meters.
    pub(super) radius: f32,
    pub(super) color: [u8; 3],
}

/// A camera.
pub(super) struct Lens {
    /// Directions of right, down and forward.
    pub(super) axes: [[f64; 3]; 3],
    pub(super) eye: [f64; 3],
    /// Half views per meter, at distance 1 if perspective.
    pub(super) scale: f64,
    pub(super) is_perspective: bool,
    /// Extent of what is shown, meters.
    pub(super) size: f64,
    /// What is nearer, meters, is not shown.
    pub(super) near: f64,
}

impl Lens {
    /// Depth from which on something is drawn. Nothing directly before the camera: it would hide everything.
    pub(super) fn least_depth(&self) -> f64 {
        self.near.max(0.02 * self.size)
    }

    /// Meters that a pixel covers, where that is one number.
    pub(super) fn metres_per_pixel(&self, view: u32) -> Option<f64> {
        let metres = 2.0 / (self.scale * f64::from(view));
        (!self.is_perspective && metres.is_finite()).then_some(metres)
    }

    /// Position in half views, depth in meters, and half views per meter there.
    fn project(&self, p: [f32; 3]) -> Option<[f64; 4]> {
        let offset: [f64; 3] = std::array::from_fn(|a| f64::from(p[a]) - self.eye[a]);
        let [x, y, depth] =
            self.axes.map(|a| a[0] * offset[0] + a[1] * offset[1] + a[2] * offset[2]);
        if depth.is_nan() || depth <= self.least_depth() {
            return None;
        }
        let scale = if self.is_perspective { self.scale / depth } else { self.scale };
        Some([x * scale, y * scale, depth, scale])
    }
}

/// Pixels per pixel of the result, along each side.
const SUPERSAMPLING: u32 = 2;

/// Rows of fine pixels that one task draws.
const BAND: usize = 48;

/// Radius of a disc in standard deviations: where a Gaussian has fallen to a quarter.
const DEVIATIONS: f64 = 1.65;

const EMPTY: f32 = f32::INFINITY;

/// α below which a rendered pixel is empty.
const FAINTEST: f32 = 0.02;

/// A square picture in the making.
pub(super) struct Canvas {
    /// Side in fine pixels.
    side: usize,
    depth: Vec<f32>,
    color: Vec<[u8; 3]>,
    /// How much of the light of a pixel is of its color; empty if all of it is.
    alpha: Vec<f32>,
    /// Extent of what is shown: the unit of depth differences.
    size: f64,
    theme: Theme,
}

/// A disc on the canvas, fine pixels.
struct Stamp {
    x: f32,
    y: f32,
    radius: f32,
    depth: f32,
    color: [u8; 3],
}

impl Canvas {
    pub(super) fn new(view: u32, theme: Theme) -> Self {
        let side = (view * SUPERSAMPLING) as usize;
        let (depth, color) = (vec![EMPTY; side * side], vec![[0; 3]; side * side]);
        Self { side, depth, color, alpha: Vec::new(), size: 1.0, theme }
    }

    /// Fine pixels along a side.
    pub(super) fn side(&self) -> usize {
        self.side
    }

    /// Takes a rendered picture of its size: color times α, α, and depth.
    pub(super) fn take(&mut self, rgb: &[f32], alpha: Vec<f32>, depth: &[f32], size: f64) {
        self.size = size;
        for (at, (rgb, (&alpha, &depth))) in
            rgb.as_chunks::<3>().0.iter().zip(alpha.iter().zip(depth)).enumerate()
        {
            if alpha < FAINTEST {
                continue;
            }
            self.depth[at] = depth;
            self.color[at] = rgb.map(|v| (255.0 * v / alpha).round().clamp(0.0, 255.0) as u8);
        }
        self.alpha = alpha;
    }

    /// Draws discs; the nearest wins, the first of equals.
    pub(super) fn draw(&mut self, discs: &[Disc], lens: &Lens) {
        self.size = lens.size;
        let half = self.side as f64 / 2.0;
        // At most a fortieth of the picture: one huge Gaussian must not be all there is to see,
        // unless there are hardly any others.
        let most = half / if discs.len() < 100 { 8.0 } else { 20.0 };
        let stamps: Vec<Stamp> = discs
            .par_iter()
            .with_min_len(4096)
            .filter_map(|disc| {
                let [x, y, depth, scale] = lens.project(disc.centre)?;
                let radius = (f64::from(disc.radius) * DEVIATIONS * scale * half).clamp(0.9, most);
                let (x, y) = (half + x * half, half + y * half);
                let reach = half + radius;
                ((x - half).abs() < reach && (y - half).abs() < reach).then_some(Stamp {
                    x: x as f32,
                    y: y as f32,
                    radius: radius as f32,
                    depth: depth as f32,
                    color: disc.color,
                })
            })
            .collect();
        let side = self.side;
        self.depth
            .par_chunks_mut(BAND * side)
            .zip(self.color.par_chunks_mut(BAND * side))
            .enumerate()
            .for_each(|(band, (depth, color))| {
                let top = (band * BAND) as f32;
                let bottom = top + (depth.len() / side) as f32;
                for stamp in &stamps {
                    if stamp.y + stamp.radius >= top && stamp.y - stamp.radius <= bottom {
                        stamp.draw(depth, color, side, top);
                    }
                }
            });
    }

    /// Writes the picture, shaded and scaled down, with its upper left corner at `left`, `top`.
    pub(super) fn copy_to(&self, picture: &mut RgbPicture, left: u32, top: u32) {
        let view = self.side as u32 / SUPERSAMPLING;
        let near = self.depth.iter().copied().fold(f32::INFINITY, f32::min);
        let lines: Vec<Vec<[u8; 3]>> = (0..view)
            .into_par_iter()
            .map(|y| (0..view).map(|x| self.pixel(x as usize, y as usize, near)).collect())
            .collect();
        for (y, line) in (top..).zip(lines) {
            for (x, color) in (left..).zip(line) {
                picture.set(x, y, color);
            }
        }
    }

    /// Mean of the fine pixels of one pixel.
    fn pixel(&self, x: usize, y: usize, near: f32) -> [u8; 3] {
        let n = SUPERSAMPLING as usize;
        let mut sum = [0.0; 3];
        for fine_y in y * n..(y + 1) * n {
            for fine_x in x * n..(x + 1) * n {
                let at = fine_y * self.side + fine_x;
                let shade = self.backdrop(fine_y);
                if self.depth[at] == EMPTY {
                    sum = std::array::from_fn(|c| sum[c] + shade[c]);
                } else {
                    let alpha = self.alpha.get(at).map_or(1.0, |a| a.min(1.0));
                    let light = alpha * self.light(fine_x, fine_y, near);
                    let own = |c: usize| f32::from(self.color[at][c]) * light;
                    sum = std::array::from_fn(|c| sum[c] + own(c) + shade[c] * (1.0 - alpha));
                }
            }
        }
        sum.map(|s| (s / (n * n) as f32).round().clamp(0.0, 255.0) as u8)
    }

    fn backdrop(&self, y: usize) -> [f32; 3] {
        let share = y as f32 / self.side as f32;
        let (above, change) = self.theme.backdrop();
        above.map(|v| v + change * share)
    }

    /// Brightness: lower behind the edges of what is in front, and slightly lower far away.
    fn light(&self, x: usize, y: usize, near: f32) -> f32 {
        let depth = self.depth[y * self.side + x];
        let mut behind = 0.0;
        for (step, weight) in [(2, 1.0_f32), (5, 0.5)] {
            for (dx, dy) in [(-1, 0), (1, 0), (0, -1), (0, 1)] {
                let at = |v: usize, d: isize| v.checked_add_signed(d * step);
                let (Some(nx), Some(ny)) = (at(x, dx), at(y, dy)) else { continue };
                if nx >= self.side || ny >= self.side {
                    continue;
                }
                let other = self.depth[ny * self.side + nx];
                let nearer = ((depth - other) / self.size as f32).clamp(0.0, 0.05);
                // The backdrop is infinitely far: nothing is behind it.
                behind += if other == EMPTY { 0.0 } else { weight * nearer };
            }
        }
        let edge = (-6.0 * behind).exp();
        let far = 1.0 - 0.22 * ((depth - near) / self.size as f32).clamp(0.0, 1.0);
        // Between Gaussians depth is rough, and their own light shows edges too.
        let darkest = if self.alpha.is_empty() { 0.35 } else { 0.75 };
        edge.max(darkest) * far
    }
}

impl Stamp {
    /// Draws into a band of the canvas whose first row is `top`.
    fn draw(&self, depth: &mut [f32], color: &mut [[u8; 3]], side: usize, top: f32) {
        let rows = depth.len() / side;
        let first = (self.y - self.radius - top).ceil().max(0.0) as usize;
        let last = (self.y + self.radius - top).floor().min(rows as f32 - 1.0);
        if last < 0.0 {
            return;
        }
        for row in first..=last as usize {
            let dy = row as f32 + top - self.y;
            let half = (self.radius * self.radius - dy * dy).max(0.0).sqrt();
            let left = (self.x - half).ceil().max(0.0) as usize;
            let right = (self.x + half).floor().min(side as f32 - 1.0);
            if right < 0.0 {
                continue;
            }
            for column in left..=right as usize {
                let at = row * side + column;
                if self.depth < depth[at] {
                    depth[at] = self.depth;
                    color[at] = self.color;
                }
            }
        }
    }
}
