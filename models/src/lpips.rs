//! Perceptual distance of two pictures (LPIPS) with AlexNet or VGG16.
//!
//! The weights cannot be derived and are not part of this project: they are read from one local
//! file. To make it once, save the `features.*` of torchvision's network and the `lin*` of the
//! `lpips` package under their names as one safetensors file.

use crate::weights::WeightFile;
use candle_core::{Device, Result, Tensor, bail};
use std::path::Path;

/// What pictures are shifted and scaled by, per channel, once their values span −1 to 1.
const SHIFT: [f32; 3] = [-0.030, -0.088, -0.188];
const SCALE: [f32; 3] = [0.458, 0.448, 0.450];

/// Added to the norm of a pixel's channels.
const EPS: f64 = 1e-10;

/// The network whose layers compare the pictures.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LpipsNet {
    /// 5 convolutions, 10 MB: what most reported numbers are of.
    Alex,
    /// 13 convolutions, 59 MB.
    Vgg,
}

/// A convolution and what follows it.
struct Stage {
    /// Its number among torchvision's `features`.
    index: usize,
    /// Side, input and output channels of the kernel.
    shape: [usize; 3],
    stride: usize,
    padding: usize,
    /// Side and stride of the maximum before the convolution.
    pool: Option<[usize; 2]>,
    /// Whether the pictures are compared after it.
    tap: bool,
}

impl LpipsNet {
    /// Its name in files and tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Alex => "alex",
            Self::Vgg => "vgg",
        }
    }

    /// Smallest side of a picture, pixels: what is left one pixel wide by the last layer.
    pub fn least_side(self) -> usize {
        match self {
            Self::Alex => 31,
            Self::Vgg => 16,
        }
    }

    fn stages(self) -> Vec<Stage> {
        match self {
            Self::Alex => {
                let rows = [
                    (0, [11, 3, 64], 4, 2, None),
                    (3, [5, 64, 192], 1, 2, Some([3, 2])),
                    (6, [3, 192, 384], 1, 1, Some([3, 2])),
                    (8, [3, 384, 256], 1, 1, None),
                    (10, [3, 256, 256], 1, 1, None),
                ];
                let stage = |(index, shape, stride, padding, pool)| Stage {
                    index,
                    shape,
                    stride,
                    padding,
                    pool,
                    tap: true,
                };
                rows.into_iter().map(stage).collect()
            }
            Self::Vgg => {
                // Index, channels in and out; a block ends where the next index skips a maximum.
                let rows = [
                    (0, 3, 64),
                    (2, 64, 64),
                    (5, 64, 128),
                    (7, 128, 128),
                    (10, 128, 256),
                    (12, 256, 256),
                    (14, 256, 256),
                    (17, 256, 512),
                    (19, 512, 512),
                    (21, 512, 512),
                    (24, 512, 512),
                    (26, 512, 512),
                    (28, 512, 512),
                ];
                let stage = |(k, &(index, from, to)): (usize, &(usize, usize, usize))| Stage {
                    index,
                    shape: [3, from, to],
                    stride: 1,
                    padding: 1,
                    pool: (k > 0 && index - rows[k - 1].0 == 3).then_some([2, 2]),
                    tap: rows.get(k + 1).is_none_or(|next| next.0 - index == 3),
                };
                rows.iter().enumerate().map(stage).collect()
            }
        }
    }
}

/// LPIPS with its weights.
pub struct Lpips {
    net: LpipsNet,
    stages: Vec<(Stage, Tensor, Tensor)>,
    /// One weight per channel of each tap, `[1, C, 1, 1]`.
    lins: Vec<Tensor>,
}

impl std::fmt::Debug for Lpips {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Lpips").field("net", &self.net).finish_non_exhaustive()
    }
}

impl Lpips {
    /// Reads the weights; the file says which network it is for.
    ///
    /// Names: `features.I.weight`, `features.I.bias` with torchvision's numbers, and
    /// `linK.model.1.weight` `[1, C, 1, 1]`, K = 0 to 4.
    ///
    /// # Errors
    /// If the file cannot be read, a name is missing, or a shape is another.
    pub fn load(path: &Path) -> Result<Self> {
        let file = WeightFile::open(path)?;
        let net = match file.entries().contains_key("features.28.weight") {
            true => LpipsNet::Vgg,
            false => LpipsNet::Alex,
        };
        let read = |name: &str, shape: &[usize]| {
            let Some(entry) = file.entries().get(name) else {
                bail!("{}: has no {name:?}, which LPIPS with {} needs", path.display(), net.name());
            };
            if entry.shape != shape {
                let got = &entry.shape;
                bail!("{}: {name}: expected {shape:?}, got {got:?}", path.display());
            }
            file.read(name)
        };
        let mut stages = Vec::new();
        let mut lins = Vec::new();
        for stage in net.stages() {
            let [side, from, to] = stage.shape;
            let name = format!("features.{}", stage.index);
            let weight = read(&format!("{name}.weight"), &[to, from, side, side])?;
            let bias = read(&format!("{name}.bias"), &[to])?.reshape((1, to, 1, 1))?;
            if stage.tap {
                lins.push(read(&format!("lin{}.model.1.weight", lins.len()), &[1, to, 1, 1])?);
            }
            stages.push((stage, weight, bias));
        }
        Ok(Self { net, stages, lins })
    }

    /// The network that the weights are for.
    pub fn net(&self) -> LpipsNet {
        self.net
    }

    /// Distance of two pictures of the same size: 0 for identical ones, about 1 for unrelated.
    ///
    /// Both `[height, width, 3]`, sRGB in 0..=1, which is mapped to −1..1. No resize.
    ///
    /// # Errors
    /// If the number of values is not `width × height × 3`, a value is not finite, or a side is
    /// below [`LpipsNet::least_side`].
    ///
    /// # Source
    /// `lpips` 0.1.4, version 0.1 of its weights. Differs: VGG pictures are mapped to −1..1 too,
    /// where gsplat's trainer leaves that out to match Inria's numbers.
    pub fn distance(&self, a: &[f32], b: &[f32], width: usize, height: usize) -> Result<f64> {
        let (mut a, mut b) = (self.input(a, width, height)?, self.input(b, width, height)?);
        let mut sum = 0.0;
        let mut lins = self.lins.iter();
        for (stage, weight, bias) in &self.stages {
            a = stage.forward(&a, weight, bias)?;
            b = stage.forward(&b, weight, bias)?;
            if stage.tap {
                let lin = lins.next().expect("one was read for each tap");
                let difference = (unit(&a)? - unit(&b)?)?.sqr()?;
                let weighted = difference.broadcast_mul(lin)?.sum(1)?;
                sum += f64::from(weighted.mean_all()?.to_scalar::<f32>()?);
            }
        }
        Ok(sum)
    }

    /// `[1, 3, H, W]`, shifted and scaled.
    fn input(&self, picture: &[f32], width: usize, height: usize) -> Result<Tensor> {
        let least = self.net.least_side();
        if width < least || height < least {
            let net = self.net.name();
            bail!(
                "LPIPS with {net} needs at least {least} × {least} pixels, got {width} × {height}"
            );
        }
        if Some(picture.len()) != width.checked_mul(height).and_then(|v| v.checked_mul(3)) {
            bail!("LPIPS: {width} × {height} × 3 are not {} values", picture.len());
        }
        if let Some(at) = picture.iter().position(|v| !v.is_finite()) {
            let (pixel, value) = (at / 3, picture[at]);
            bail!("LPIPS: pixel ({}, {}) is {value}", pixel % width, pixel / width);
        }
        let pixels = width * height;
        let planes: Vec<f32> = (0..3 * pixels)
            .map(|i| {
                let (c, pixel) = (i / pixels, i % pixels);
                (2.0 * picture[3 * pixel + c] - 1.0 - SHIFT[c]) / SCALE[c]
            })
            .collect();
        Tensor::from_vec(planes, (1, 3, height, width), &Device::Cpu)
    }
}

impl Stage {
    fn forward(&self, x: &Tensor, weight: &Tensor, bias: &Tensor) -> Result<Tensor> {
        let x = match self.pool {
            Some([side, stride]) => x.max_pool2d_with_stride(side, stride)?,
            None => x.clone(),
        };
        x.conv2d(weight, self.padding, self.stride, 1, 1)?.broadcast_add(bias)?.relu()
    }
}

/// The channels of each pixel scaled to norm 1.
fn unit(x: &Tensor) -> Result<Tensor> {
    let norm = (x.sqr()?.sum_keepdim(1)?.sqrt()? + EPS)?;
    x.broadcast_div(&norm)
}
