//! Blocks of a fine stage on the voxels of the next coarser scale, and their way back.

use crate::ops;
use candle_core::{Result, Tensor, bail};
use rayon::prelude::*;
use scenesplat_kernels::segment::Groups;
use scenesplat_kernels::serialized_cloud::SerializedCloud;

/// Coarse cells around a voxel: eight centers are the corners of the cube that it lies in.
const CORNERS: usize = 8;
/// Rows of one task.
const ROWS: usize = 256;

/// Which coarse cells a voxel lies between, and how near it is to each.
#[derive(Debug)]
pub(super) struct Between {
    /// Coarse rows; where there is no cell the weight is 0. `[N]`
    cells: Vec<[u32; CORNERS]>,
    /// Sum 1. `[N]`
    weights: Vec<[f32; CORNERS]>,
    coarse: usize,
}

impl Between {
    /// The occupied ones of the eight nearest cells with trilinear weights, by the centers of voxels
    /// and cells.
    ///
    /// # Errors
    /// If the coarse cells are out of range.
    pub(super) fn new(
        fine: &SerializedCloud,
        coarse: &SerializedCloud,
        groups: &Groups,
    ) -> Result<Self> {
        // Neighbors of each coarse cell, among 3³.
        let map = coarse.kernel_map(3).map_err(candle_core::Error::wrap)?;
        let taps = map.taps();
        const NONE: u32 = u32::MAX;
        let mut near = vec![NONE; coarse.len() * taps];
        for tap in 0..taps {
            let (from, to) = map.tap_pairs(tap);
            from.iter().zip(&to).for_each(|(&from, &to)| near[to as usize * taps + tap] = from);
        }
        let scene = fine.scene_of_rows();
        let (mut cells, mut weights) = (Vec::new(), Vec::new());
        (0..fine.len())
            .into_par_iter()
            .map(|row| {
                let parent = groups.inverse()[row] as usize;
                let at = scene[row] as usize;
                let bits = fine.depth()[at] - coarse.depth()[at];
                let edge = f64::from(1u32 << bits);
                // From the center of its cell, in cells: within ±½.
                let away: [f64; 3] = std::array::from_fn(|axis| {
                    let first = i64::from(coarse.grid_coord()[parent][axis]) << bits;
                    let within = i64::from(fine.grid_coord()[row][axis]) - first;
                    (within as f64 + 0.5) / edge - 0.5
                });
                let mut ids = [parent as u32; CORNERS];
                let mut parts = [0f64; CORNERS];
                for corner in 0..CORNERS {
                    let (mut tap, mut part) = (0, 1.0);
                    for (axis, away) in away.into_iter().enumerate() {
                        let other = corner >> axis & 1 == 1;
                        let step = if !other {
                            1
                        } else if away < 0.0 {
                            0
                        } else {
                            2
                        };
                        tap = tap * 3 + step;
                        part *= if other { away.abs() } else { 1.0 - away.abs() };
                    }
                    let id = near[parent * taps + tap];
                    if id != NONE {
                        (ids[corner], parts[corner]) = (id, part);
                    }
                }
                let sum: f64 = parts.iter().sum();
                (ids, parts.map(|part| (part / sum) as f32))
            })
            .unzip_into_vecs(&mut cells, &mut weights);
        Ok(Self { cells, weights, coarse: coarse.len() })
    }

    /// `base + Σ weight · x[cell]`. `x`: `[M, C]`, `base`: `[N, C]` → `[N, C]`
    ///
    /// # Errors
    /// If the rows do not fit, or a tensor wants a gradient.
    pub(super) fn add_to(&self, x: &Tensor, base: &Tensor) -> Result<Tensor> {
        let (m, c) = x.dims2()?;
        if m != self.coarse || base.dims() != [self.cells.len(), c] {
            bail!(
                "last stage: expected [{}, C] and [{}, C], got {:?} and {:?}",
                self.coarse,
                self.cells.len(),
                x.shape(),
                base.shape()
            );
        }
        // SAFETY: it copies the base before it adds.
        unsafe {
            ops::frozen("last_stage", x, Some(base), base.shape(), |x, base, out| {
                self.blend(x, base.unwrap_or_default(), c, out);
            })
        }
    }

    fn blend(&self, x: &[f32], base: &[f32], c: usize, out: &mut [f32]) {
        if c == 0 {
            return;
        }
        out.copy_from_slice(base);
        out.par_chunks_mut(ROWS * c).enumerate().for_each(|(task, out)| {
            for (i, out) in out.chunks_exact_mut(c).enumerate() {
                let row = task * ROWS + i;
                for (&cell, &weight) in self.cells[row].iter().zip(&self.weights[row]) {
                    if weight > 0.0 {
                        let from = &x[cell as usize * c..][..c];
                        out.iter_mut().zip(from).for_each(|(o, v)| *o += weight * v);
                    }
                }
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::Device;
    use scenesplat_kernels::serialization::Curve;
    use scenesplat_kernels::serialized_cloud::CurveDepth;

    fn cloud(cells: Vec<[i32; 3]>, offsets: Vec<usize>) -> SerializedCloud {
        SerializedCloud::new(cells, offsets, &[Curve::Z], CurveDepth::PerScene).unwrap()
    }

    #[test]
    fn values_that_rise_evenly_come_back() {
        // A full block: inside it, trilinear weights reproduce what is linear in the position.
        let side = 12;
        let cells: Vec<[i32; 3]> =
            (0..side * side * side).map(|i| [i % side, i / side % side, i / side / side]).collect();
        for shift in [1, 2] {
            let fine = cloud(cells.clone(), vec![0, cells.len()]);
            let (coarse, groups) = fine.pool(shift);
            let between = Between::new(&fine, &coarse, &groups).unwrap();
            let edge = f64::from(1 << shift);
            let value = |[x, y, z]: [f64; 3]| 2.0 * x - 3.0 * y + 0.5 * z;
            let at: Vec<f32> = coarse
                .grid_coord()
                .iter()
                .map(|c| value(c.map(|v| (f64::from(v) + 0.5) * edge)) as f32)
                .collect();
            let x = Tensor::from_vec(at, (coarse.len(), 1), &Device::Cpu).unwrap();
            let base = Tensor::full(1f32, (fine.len(), 1), &Device::Cpu).unwrap();
            let out = between.add_to(&x, &base).unwrap().flatten_all().unwrap();
            let last = side - (1 << shift) / 2;
            for (cell, got) in cells.iter().zip(out.to_vec1::<f32>().unwrap()) {
                if cell.iter().all(|v| *v >= (1 << shift) / 2 && *v < last) {
                    let want = 1.0 + value(cell.map(|v| f64::from(v) + 0.5));
                    assert!((f64::from(got) - want).abs() < 1e-4, "{cell:?}: {got} {want}");
                }
            }
        }
    }

    #[test]
    fn only_occupied_cells_of_the_own_scene_count() {
        // Two scenes with the same cells; the second has one cell less, and one that is alone.
        let first = [[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]];
        let cells = [&first[..], &[[0, 0, 0], [1, 0, 0], [9, 9, 9]]].concat();
        let fine = cloud(cells, vec![0, 4, 7]);
        let (coarse, groups) = fine.pool(1);
        let between = Between::new(&fine, &coarse, &groups).unwrap();
        let x: Vec<f32> = (0..coarse.len()).map(|i| 10f32.powi(i as i32)).collect();
        let x = Tensor::from_vec(x, (coarse.len(), 1), &Device::Cpu).unwrap();
        let base = Tensor::zeros((7, 1), candle_core::DType::F32, &Device::Cpu).unwrap();
        let out: Vec<f32> =
            between.add_to(&x, &base).unwrap().flatten_all().unwrap().to_vec1().unwrap();
        // A quarter of a cell toward the other one: ¾ and ¼; else the own cell alone.
        for (got, want) in out.iter().zip([1.0, 3.25, 7.75, 10.0, 100.0, 100.0, 1000.0]) {
            assert!((got - want).abs() < 1e-4, "{out:?}");
        }
        for weights in &between.weights {
            assert!((weights.iter().sum::<f32>() - 1.0).abs() < 1e-6);
        }
        assert!(between.add_to(&base, &x).is_err());
    }

    #[test]
    fn a_scene_too_small_to_be_pooled_keeps_its_rows() {
        let fine = cloud(vec![[0, 0, 0]], vec![0, 1]);
        let (coarse, groups) = fine.pool(1);
        let between = Between::new(&fine, &coarse, &groups).unwrap();
        let x = Tensor::full(5f32, (1, 2), &Device::Cpu).unwrap();
        let out = between.add_to(&x, &x).unwrap().to_vec2::<f32>().unwrap();
        assert_eq!(out, [[10.0, 10.0]]);
    }
}
