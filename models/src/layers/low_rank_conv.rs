//! A convolution of low rank: its taps lead to few channels, a linear layer leads on from there.

use super::Linear;
use crate::{Compute, ops};
use candle_core::{Result, Tensor, bail};
use scenesplat_kernels::gemm::{Epilogue, PackedMatrix, gemm, gemm_tn};
use scenesplat_kernels::kernel_map::KernelMap;
use scenesplat_kernels::sparse_conv::PackedConv;
use scenesplat_kernels::symmetric_eigen::symmetric_eigen;

/// The weights of a frozen convolution, kept until there is an example of its input.
#[derive(Debug)]
pub(crate) struct PlainConv {
    /// `[cout, taps, cin]`
    pub(crate) weight: Vec<f32>,
    /// `[cout]`
    pub(crate) bias: Vec<f32>,
    /// Input and output channels, taps.
    pub(crate) shape: [usize; 3],
    /// How the factors compute.
    pub(crate) compute: Compute,
}

/// Taps of `cin → rank` channels, then `rank → cout`.
#[derive(Debug, Clone)]
pub(crate) struct LowRankConv {
    taps: PackedConv,
    up: Linear,
}

impl PlainConv {
    /// The factors that keep most of what the convolution makes of `x`, and the part of its variance
    /// that they keep, 0..=1.
    ///
    /// Of all convolutions whose stacked taps `[taps · cin, cout]` have this rank, it is the one with
    /// the least squared error on these rows: outputs, less their mean, are projected onto the
    /// directions in which they vary most. Those are the right singular vectors of the stacked taps
    /// weighted by the second moments of what the taps read, so no such moments (`taps · cin` squared
    /// of them) are ever formed. The mean goes into the bias.
    ///
    /// # Shapes
    /// `x`: `[N, cin]`, N > 0
    ///
    /// # Errors
    /// If the input does not fit, or the rank is not in 1..=cout.
    pub(crate) fn factor(
        &self,
        rank: usize,
        x: &Tensor,
        map: &KernelMap,
    ) -> Result<(LowRankConv, f64)> {
        let [cin, cout, taps] = self.shape;
        let n = x.dim(0)?;
        if n == 0 || !(1..=cout).contains(&rank) {
            bail!("sparse_conv: rank {rank} of {cout} channels from {n} rows");
        }
        let packed = PackedConv::new(&self.weight, cin, cout, taps);
        let y = ops::sparse_conv_frozen(x, &packed, None, map)?;
        drop(packed);
        let mut y = y.flatten_all()?.to_vec1::<f32>()?;
        let mut mean = vec![0f64; cout];
        for row in y.chunks_exact(cout) {
            mean.iter_mut().zip(row).for_each(|(m, v)| *m += f64::from(*v));
        }
        mean.iter_mut().for_each(|m| *m /= n as f64);
        for row in y.chunks_exact_mut(cout) {
            row.iter_mut().zip(&mean).for_each(|(v, m)| *v = (f64::from(*v) - m) as f32);
        }
        let mut moments = vec![0f32; cout * cout];
        gemm_tn(&y, cout, &y, cout, None, &mut moments);
        drop(y);
        let moments: Vec<f64> = moments.into_iter().map(f64::from).collect();
        let eigen = symmetric_eigen(&moments, cout, rank);
        let positive = |values: &[f64]| values.iter().map(|v| v.max(0.0)).sum::<f64>();
        let all = positive(&eigen.values);
        let kept = if all > 0.0 { positive(&eigen.values[..rank]) / all } else { 1.0 };

        let axes: Vec<f32> = eigen.vectors.iter().map(|v| *v as f32).collect();
        let stacked = PackedMatrix::from_strided(&self.weight, cout, taps * cin, taps * cin, 1);
        let mut narrow = vec![0f32; rank * taps * cin];
        gemm(&axes, &stacked, Epilogue::default(), &mut narrow);
        drop(stacked);
        let mut up = vec![0f32; cout * rank];
        let mut bias: Vec<f64> =
            self.bias.iter().zip(&mean).map(|(b, m)| f64::from(*b) + m).collect();
        for (r, axis) in eigen.vectors.chunks_exact(cout).enumerate() {
            let along: f64 = axis.iter().zip(&mean).map(|(a, m)| a * m).sum();
            for (o, value) in axis.iter().enumerate() {
                up[o * rank + r] = *value as f32;
                bias[o] -= along * value;
            }
        }
        let bias = bias.into_iter().map(|b| b as f32).collect();
        let taps = PackedConv::with_precision(self.compute.precision, &narrow, cin, rank, taps);
        let up = Linear::frozen(self.compute, &up, rank, cout, Some(bias));
        Ok((LowRankConv { taps, up }, kept))
    }
}

impl LowRankConv {
    /// `[N, cin] → [N, cout]`
    ///
    /// # Errors
    /// If the input does not fit the map.
    pub(crate) fn forward(&self, x: &Tensor, map: &KernelMap) -> Result<Tensor> {
        self.up.forward(&ops::sparse_conv_frozen(x, &self.taps, None, map)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::weights::unit;
    use candle_core::Device;
    use scenesplat_kernels::sparse_conv::forward;

    /// A slab of voxels, without every seventh.
    fn cells() -> Vec<[i32; 3]> {
        let all = (0..11 * 12 * 4).map(|i| [i % 11, i / 11 % 12, i / 132]);
        all.enumerate().filter(|(i, _)| i % 7 != 3).map(|(_, cell)| cell).collect()
    }

    struct Case {
        conv: PlainConv,
        map: KernelMap,
        x: Vec<f32>,
        /// What the convolution gives in f64, with its bias. `[N, cout]`
        y: Vec<f64>,
    }

    fn case(cin: usize, cout: usize) -> Case {
        let cells = cells();
        let map = KernelMap::build(&cells, &[0, cells.len()], 3).unwrap();
        // Inputs that vary much more in some directions than in others.
        let mut x = unit("x", cells.len() * cin, 1);
        for row in x.chunks_exact_mut(cin) {
            row.iter_mut().enumerate().for_each(|(i, v)| *v = 0.3 + *v / (1 + i * i) as f32);
        }
        let weight = unit("w", cout * 27 * cin, 2);
        let bias = unit("b", cout, 3);
        let mut y: Vec<f64> = Vec::new();
        cells.iter().for_each(|_| y.extend(bias.iter().map(|b| f64::from(*b))));
        for tap in 0..27 {
            let (from, to) = map.tap_pairs(tap);
            for (&from, &to) in from.iter().zip(&to) {
                for o in 0..cout {
                    for i in 0..cin {
                        y[to as usize * cout + o] += f64::from(weight[(o * 27 + tap) * cin + i])
                            * f64::from(x[from as usize * cin + i]);
                    }
                }
            }
        }
        let compute = Compute::default();
        Case { conv: PlainConv { weight, bias, shape: [cin, cout, 27], compute }, map, x, y }
    }

    impl Case {
        fn run(&self, rank: usize) -> (Vec<f32>, f64) {
            let [cin, cout, _] = self.conv.shape;
            let x = Tensor::from_slice(&self.x, (self.x.len() / cin, cin), &Device::Cpu).unwrap();
            let (low, kept) = self.conv.factor(rank, &x, &self.map).unwrap();
            assert_eq!(low.taps.cout(), rank.min(cout));
            (low.forward(&x, &self.map).unwrap().flatten_all().unwrap().to_vec1().unwrap(), kept)
        }
    }

    #[test]
    fn full_rank_is_the_convolution_to_rounding() {
        for (cin, cout) in [(5, 7), (16, 16), (20, 33)] {
            let case = case(cin, cout);
            let (out, kept) = case.run(cout);
            assert!((kept - 1.0).abs() < 1e-9, "{kept}");
            let largest = case.y.iter().fold(0.0f64, |a, v| a.max(v.abs()));
            for (got, want) in out.iter().zip(&case.y) {
                assert!((f64::from(*got) - want).abs() < 3e-6 * largest, "{got} {want}");
            }
        }
    }

    /// Eckart and Young: no matrix of this rank does better than the one whose squared error is the
    /// sum of the eigenvalues that are left out.
    #[test]
    fn lower_ranks_lose_what_they_say_and_no_more() {
        let case = case(12, 20);
        let n = case.y.len() / 20;
        let mean: Vec<f64> =
            (0..20).map(|o| case.y.iter().skip(o).step_by(20).sum::<f64>() / n as f64).collect();
        let mut moments = vec![0.0; 400];
        for row in case.y.chunks_exact(20) {
            let away: Vec<f64> = row.iter().zip(&mean).map(|(v, m)| v - m).collect();
            for (a, x) in away.iter().enumerate() {
                away.iter().enumerate().for_each(|(b, y)| moments[a * 20 + b] += x * y);
            }
        }
        let values = symmetric_eigen(&moments, 20, 0).values;
        let all: f64 = values.iter().sum();
        let mut before = f64::INFINITY;
        for rank in [1, 2, 5, 12, 19] {
            let (out, kept) = case.run(rank);
            let error: f64 =
                out.iter().zip(&case.y).map(|(g, w)| (f64::from(*g) - w).powi(2)).sum();
            let least: f64 = values[rank..].iter().sum();
            assert!((error - least).abs() < 1e-5 * all, "rank {rank}: {error}, at best {least}");
            assert!((kept - (1.0 - least / all)).abs() < 1e-5, "rank {rank}: {kept}");
            assert!(error < before);
            before = error;
        }
    }

    #[test]
    fn what_cannot_be_factored_is_refused() {
        let case = case(4, 6);
        let x = Tensor::from_slice(&case.x, (case.x.len() / 4, 4), &Device::Cpu).unwrap();
        for rank in [0, 7] {
            let error = case.conv.factor(rank, &x, &case.map).unwrap_err().to_string();
            assert!(error.contains(&format!("rank {rank} of 6")), "{error}");
        }
        // One voxel alone does not vary: its mean is all there is.
        let map = KernelMap::build(&[[0; 3]], &[0, 1], 3).unwrap();
        let one = x.narrow(0, 0, 1).unwrap();
        let (low, kept) = case.conv.factor(2, &one, &map).unwrap();
        assert_eq!(kept, 1.0);
        let packed = PackedConv::new(&case.conv.weight, 4, 6, 27);
        let mut want = vec![0.0; 6];
        forward(&map, &case.x[..4], &packed, Some(&case.conv.bias), &mut want);
        let got: Vec<f32> =
            low.forward(&one, &map).unwrap().flatten_all().unwrap().to_vec1().unwrap();
        for (got, want) in got.iter().zip(&want) {
            assert!((got - want).abs() < 1e-5, "{got} {want}");
        }
    }
}
