//! Scales of a batch of voxels and their neighborhoods: what networks attend over that know points
//! and no space-filling curves.
//!
//! Everything belongs to one scene, and what could tie is settled by place: rows are sorted by x, y
//! and z, and of equally near neighbors the first in that order counts. That order is the same
//! wherever a scene or a tile begins, which an order along a curve is not.

use crate::row_order::{SortedRows, order_by};
use crate::{PointCloud, ops};
use candle_core::{Device, Result, Tensor, bail};
use scenesplat_kernels::neighbors::KdTree;
use scenesplat_kernels::segment::{Groups, Reduce};
use scenesplat_kernels::serialization::argsort;
use std::sync::Arc;

/// Voxels of a batch at one scale, sorted within each scene.
#[derive(Debug, Clone)]
pub(crate) struct Scale {
    /// Cells of this scale.
    cells: Vec<[i32; 3]>,
    /// Mean position of the voxels of a cell, in voxels of the input. `[N]`
    coord: Vec<[f32; 3]>,
    offsets: Vec<usize>,
    /// Neighborhoods that were asked for, by their size.
    found: Vec<(usize, Neighborhood)>,
}

/// The nearest rows of each row.
#[derive(Debug, Clone)]
pub(crate) struct Neighborhood {
    /// Edges of each query, nearest first.
    queries: Arc<Groups>,
    /// Edges of each source.
    sources: Arc<Groups>,
    /// Source minus query, in voxels of the input. `[E, 3]`
    pub relative: Tensor,
}

impl Scale {
    /// The finest scale.
    ///
    /// # Errors
    /// If offsets do not fit, or a voxel is out of range.
    pub fn new(points: &PointCloud) -> Result<(Self, SortedRows)> {
        let order = order_by(points, |cells| cells.iter().map(key).collect())?;
        let cells: Vec<[i32; 3]> =
            order.iter().map(|&row| points.grid_coord[row as usize]).collect();
        let coord = cells.iter().map(|c| c.map(|v| v as f32)).collect();
        let scale = Self { cells, coord, offsets: points.offsets.to_vec(), found: Vec::new() };
        Ok((scale, SortedRows::new(order)))
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.cells.len()
    }

    /// First row of each scene, and the end.
    pub fn offsets(&self) -> &[usize] {
        &self.offsets
    }

    /// The next coarser scale: cells of `edge³` cells of this one; and who went where.
    pub fn pool(&self, edge: usize) -> (Self, Arc<Groups>) {
        let edge = i32::try_from(edge).unwrap_or(i32::MAX);
        let above: Vec<[i32; 3]> = self.cells.iter().map(|c| c.map(|v| v / edge)).collect();
        let (mut rows, mut ends) = (Vec::with_capacity(above.len()), vec![0]);
        let (mut cells, mut coord, mut offsets) = (Vec::new(), Vec::new(), vec![0]);
        for scene in self.offsets.windows(2) {
            let keys: Vec<u64> = above[scene[0]..scene[1]].iter().map(key).collect();
            let order = argsort(&keys);
            for members in order.chunk_by(|&a, &b| keys[a as usize] == keys[b as usize]) {
                let mut sum = [0f64; 3];
                for &member in members {
                    let row = scene[0] + member as usize;
                    rows.push(row as u32);
                    let at = self.coord[row];
                    sum.iter_mut().zip(at).for_each(|(s, v)| *s += f64::from(v));
                }
                cells.push(above[scene[0] + members[0] as usize]);
                coord.push(sum.map(|s| (s / members.len() as f64) as f32));
                ends.push(rows.len() as u32);
            }
            offsets.push(cells.len());
        }
        let groups = Groups::new(rows, ends).expect("each voxel is in one cell");
        (Self { cells, coord, offsets, found: Vec::new() }, Arc::new(groups))
    }

    /// As [`pool`](Self::pool), with each cell where one of its voxels is: the one nearest to the
    /// mean of all.
    pub fn pool_to_voxels(&self, edge: usize) -> (Self, Arc<Groups>) {
        let (mut coarse, groups) = self.pool(edge);
        for (group, coord) in coarse.coord.iter_mut().enumerate() {
            let span = groups.offsets()[group] as usize..groups.offsets()[group + 1] as usize;
            let members = || groups.rows()[span.clone()].iter().map(|&r| self.coord[r as usize]);
            // From the first of them on: sums of voxel positions are exact then, and equal distances
            // stay equal wherever the scene is.
            let Some(from) = members().next() else { continue };
            let offset = |at: &[f32; 3]| [0, 1, 2].map(|a| f64::from(at[a]) - f64::from(from[a]));
            let mut sum = [0f64; 3];
            members().for_each(|at| sum.iter_mut().zip(offset(&at)).for_each(|(s, v)| *s += v));
            let count = span.len() as f64;
            let away = |at: &[f32; 3]| -> f64 {
                offset(at).iter().zip(sum).map(|(v, s)| (v * count - s).powi(2)).sum()
            };
            if let Some(near) = members().min_by(|a, b| away(a).total_cmp(&away(b))) {
                *coord = near;
            }
        }
        (coarse, groups)
    }

    /// The `k` nearest rows of each row, itself included; fewer in a scene of fewer rows.
    ///
    /// # Errors
    /// If there are 2³² edges or more.
    pub fn neighbors(&mut self, k: usize) -> Result<Neighborhood> {
        if let Some((_, found)) = self.found.iter().find(|(size, _)| *size == k) {
            return Ok(found.clone());
        }
        let found = Neighborhood::new(self, self, k)?;
        self.found.push((k, found.clone()));
        Ok(found)
    }
}

impl Neighborhood {
    /// The `k` nearest rows of `sources` around each row of `queries`, scene by scene.
    ///
    /// # Errors
    /// If there are 2³² edges or more.
    pub fn new(queries: &Scale, sources: &Scale, k: usize) -> Result<Self> {
        let total = queries.len().checked_mul(k).filter(|n| u32::try_from(*n).is_ok());
        if total.is_none() {
            bail!("neighbors: {} rows with {k} neighbors each are too many", queries.len());
        }
        let mut ends = vec![0];
        let mut source_of = Vec::new();
        let scenes = queries.offsets.windows(2).zip(sources.offsets.windows(2));
        for (of_queries, of_sources) in scenes {
            let tree = KdTree::of_rows(&sources.coord, of_sources[0]..of_sources[1])
                .map_err(candle_core::Error::wrap)?;
            let here = &queries.coord[of_queries[0]..of_queries[1]];
            let found: Vec<Vec<u32>> = tree.map_nearest(
                here,
                k,
                || (),
                |(), _, near| near.iter().map(|n| n.row).collect(),
            );
            for near in found {
                source_of.extend(near);
                ends.push(source_of.len() as u32);
            }
        }
        let edges = (0..source_of.len() as u32).collect();
        let by_query = Groups::new(edges, ends).expect("the edges of a query follow each other");
        let mut relative = Vec::with_capacity(3 * source_of.len());
        for (&source, &query) in source_of.iter().zip(by_query.inverse()) {
            let (a, b) = (sources.coord[source as usize], queries.coord[query as usize]);
            relative.extend(a.iter().zip(b).map(|(a, b)| a - b));
        }
        let relative = Tensor::from_vec(relative, (source_of.len(), 3), &Device::Cpu)?;
        let sources = Arc::new(grouped(&source_of, sources.len()));
        Ok(Self { queries: Arc::new(by_query), sources, relative })
    }

    /// Row of the source of each edge. `[S, C] → [E, C]`
    pub fn of_sources(&self, x: &Tensor) -> Result<Tensor> {
        ops::expand_groups(x, self.sources.clone())
    }

    /// Row of the query of each edge. `[Q, C] → [E, C]`
    pub fn of_queries(&self, x: &Tensor) -> Result<Tensor> {
        ops::expand_groups(x, self.queries.clone())
    }

    /// Joins the edges of each query. `[E, C] → [Q, C]`
    pub fn reduce(&self, edges: &Tensor, how: Reduce) -> Result<Tensor> {
        ops::segment_reduce(edges, self.queries.clone(), how)
    }

    /// Softmax over the edges of each query, channel by channel. `[E, C] → [E, C]`
    pub fn softmax(&self, logits: &Tensor) -> Result<Tensor> {
        // A shift changes nothing, so none of its gradient is needed.
        let top = self.reduce(&logits.detach(), Reduce::Max)?;
        let powers = (logits - self.of_queries(&top)?)?.exp()?;
        let sums = self.of_queries(&self.reduce(&powers, Reduce::Sum)?)?;
        powers / sums
    }

    /// Weights `1 / distance` of the edges, 1 in sum for each query, on a device. `[E, 1]`
    pub fn inverse_distances(&self, device: &Device) -> Result<Tensor> {
        // The smallest distance that counts: a source in the very place takes all.
        const NEAR: f64 = 1e-8;
        let rows = self.relative.to_vec2::<f32>()?;
        let distance = |d: &Vec<f32>| d.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt();
        let weights: Vec<f64> = rows.iter().map(|d| 1.0 / (distance(d) + NEAR)).collect();
        let mut out = Vec::with_capacity(weights.len());
        for span in self.queries.offsets().windows(2) {
            let own = &weights[span[0] as usize..span[1] as usize];
            let sum: f64 = own.iter().sum();
            out.extend(own.iter().map(|w| (w / sum) as f32));
        }
        let edges = out.len();
        Tensor::from_vec(out, (edges, 1), device)
    }
}

/// A cell of 21 bits an axis as a number that sorts by x, then y, then z.
fn key(cell: &[i32; 3]) -> u64 {
    cell.iter().fold(0, |key, &v| (key << 21) | v as u64)
}

/// Edges by the group that `inverse` names, in their order.
fn grouped(inverse: &[u32], groups: usize) -> Groups {
    let mut offsets = vec![0u32; groups + 1];
    inverse.iter().for_each(|&g| offsets[g as usize + 1] += 1);
    for group in 0..groups {
        offsets[group + 1] += offsets[group];
    }
    let mut next = offsets.clone();
    let mut rows = vec![0u32; inverse.len()];
    for (edge, &group) in inverse.iter().enumerate() {
        let at = &mut next[group as usize];
        rows[*at as usize] = edge as u32;
        *at += 1;
    }
    Groups::new(rows, offsets).expect("every edge has one source")
}
