//! The network written from its formulas: f64, plain loops, one row after the other; coarse rows
//! ascend by scene and cell. Nothing of it is shared with the network but the bit-by-bit curve
//! codes.

use crate::gradients::slow;
use crate::support::{SEED, Scene, flat};
use scenesplat_kernels::reference::{hilbert_code, morton_code};
use scenesplat_models::LitePtConfig;
use scenesplat_models::litept::BlockKind;
use scenesplat_models::weights::hashed_parameter;
use std::cell::RefCell;
use std::collections::BTreeMap;

/// Values by name, made when they are asked for; so what was asked for can be compared with what
/// the network has.
#[derive(Default)]
pub struct Values(RefCell<BTreeMap<String, Shaped>>);

/// Shape and values.
type Shaped = (Vec<usize>, Vec<f64>);

impl Values {
    pub fn get(&self, name: &str, shape: &[usize]) -> Vec<f64> {
        let mut all = self.0.borrow_mut();
        let (known, values) = all.entry(name.to_owned()).or_insert_with(|| {
            let hashed = hashed_parameter(name, shape, SEED).unwrap();
            let values = flat(&hashed).into_iter().map(f64::from).collect();
            (shape.to_vec(), values)
        });
        assert_eq!(known, shape, "{name}");
        values.clone()
    }

    /// Adds a multiple of a direction to one of them.
    pub fn shift(&self, name: &str, by: f64, along: &[f64]) {
        let mut all = self.0.borrow_mut();
        let (_, values) = all.get_mut(name).unwrap();
        values.iter_mut().zip(along).for_each(|(v, d)| *v += by * d);
    }

    pub fn shapes(&self) -> BTreeMap<String, Vec<usize>> {
        self.0.borrow().iter().map(|(name, (shape, _))| (name.clone(), shape.clone())).collect()
    }
}

/// One scale of a batch.
pub struct Rows {
    /// Scene and voxel.
    pub cells: Vec<(usize, [i32; 3])>,
    /// First row of a voxel.
    at: BTreeMap<(usize, [i32; 3]), usize>,
}

impl Rows {
    pub fn new(cells: Vec<(usize, [i32; 3])>) -> Self {
        let mut at = BTreeMap::new();
        cells.iter().enumerate().for_each(|(row, cell)| _ = at.entry(*cell).or_insert(row));
        Self { cells, at }
    }

    /// Cells of so many voxels an axis, and the cell of each row.
    pub fn coarser(&self, stride: usize) -> (Self, Vec<usize>) {
        let cell = |(scene, v): &(usize, [i32; 3])| (*scene, v.map(|v| v / stride as i32));
        let members: Vec<_> = self.cells.iter().map(cell).collect();
        let mut cells = members.clone();
        cells.sort_unstable();
        cells.dedup();
        let of = members.iter().map(|m| cells.binary_search(m).unwrap()).collect();
        (Self::new(cells), of)
    }
}

/// Rows, features, cell of each row, permutation of the curves.
type Finer = (Rows, Vec<f64>, Vec<usize>, Vec<usize>);

/// The largest of each group's rows, channel by channel.
pub fn largest(x: &[f64], c: usize, group_of: &[usize], groups: usize) -> Vec<f64> {
    let mut most = vec![f64::NEG_INFINITY; groups * c];
    for (row, &group) in x.chunks_exact(c).zip(group_of) {
        most[group * c..][..c].iter_mut().zip(row).for_each(|(m, v)| *m = m.max(*v));
    }
    most
}

/// Layers of networks of voxels.
pub struct Formulas {
    pub values: Values,
    pub order: Vec<String>,
    pub mlp_ratio: usize,
    /// Base of the angles by which queries and keys are turned, if they are.
    pub rope_base: Option<f64>,
}

pub struct Reference<'a> {
    pub config: &'a LitePtConfig,
    pub layers: Formulas,
    /// Whether batch norms take the statistics of the batch.
    pub train: bool,
    /// Which curve of the list stands at each place of it, scale with attention by scale.
    pub orders: Option<Vec<Vec<usize>>>,
}

impl Reference<'_> {
    pub fn forward(&self, scenes: &[&Scene]) -> Vec<f64> {
        let cells = scenes.iter().enumerate();
        let cells = cells.flat_map(|(i, s)| s.cells.iter().map(move |c| (i, *c))).collect();
        let feat = scenes.iter().flat_map(|s| s.feat.iter().map(|v| f64::from(*v))).collect();
        let c = self.config;
        let mut rows = Rows::new(cells);
        let channels = &c.enc_channels;
        let feat: Vec<f64> = feat;
        let shape = [c.in_channels, channels[0], 5];
        let x = self.layers.conv(&feat, &rows, shape, "embedding.stem.conv", false);
        let mut x = self.norm_gelu(&x, channels[0], "embedding.stem.norm");
        let mut attending = 0;
        let mut finer: Vec<Finer> = Vec::new();
        let mut permutation = self.permutation(0, &mut attending);
        for stage in 0..channels.len() {
            let name = format!("enc.enc{stage}");
            if stage > 0 {
                let (coarse, pooled, of) = self.pooled(&x, &rows, stage);
                let next = self.permutation(stage, &mut attending);
                finer.push((
                    std::mem::replace(&mut rows, coarse),
                    std::mem::replace(&mut x, pooled),
                    of,
                    std::mem::replace(&mut permutation, next),
                ));
            }
            let shape = [channels[stage], c.enc_num_head[stage], c.enc_patch_size[stage]];
            let (depth, kind) = (c.enc_depths[stage], c.enc_blocks[stage]);
            x = self.blocks(x, &rows, shape, (depth, kind), &permutation, &name);
        }
        let mut below = channels[channels.len() - 1];
        for stage in (0..c.dec_channels.len()).rev() {
            let (fine, skip, of, permutation) = finer.pop().unwrap();
            let (name, o) = (format!("dec.dec{stage}"), c.dec_channels[stage]);
            let up = |x: &[f64], i: usize, part: &str| {
                let wide = self.layers.linear(x, i, o, &format!("{name}.up.{part}.0"));
                self.norm_gelu(&wide, o, &format!("{name}.up.{part}.1"))
            };
            let coarse = up(&x, below, "proj");
            x = up(&skip, channels[stage], "proj_skip");
            for (row, group) in of.iter().enumerate() {
                for j in 0..o {
                    x[row * o + j] += coarse[group * o + j];
                }
            }
            rows = fine;
            let shape = [o, c.dec_num_head[stage], c.dec_patch_size[stage]];
            let (depth, kind) = (c.dec_depths[stage], c.dec_blocks[stage]);
            x = self.blocks(x, &rows, shape, (depth, kind), &permutation, &name);
            below = o;
        }
        x
    }

    /// The cells of a stage, their rows, and the cell of each row of the stage before.
    fn pooled(&self, x: &[f64], rows: &Rows, stage: usize) -> (Rows, Vec<f64>, Vec<usize>) {
        let c = self.config;
        let (coarse, of) = rows.coarser(c.stride[stage - 1]);
        let (i, o) = (c.enc_channels[stage - 1], c.enc_channels[stage]);
        let wide = self.layers.linear(x, i, o, &format!("enc.enc{stage}.down.proj"));
        let most = largest(&wide, o, &of, coarse.cells.len());
        let pooled = self.norm_gelu(&most, o, &format!("enc.enc{stage}.down.norm.0"));
        (coarse, pooled, of)
    }

    fn blocks(
        &self,
        mut x: Vec<f64>,
        rows: &Rows,
        shape: [usize; 3],
        (depth, kind): (usize, BlockKind),
        permutation: &[usize],
        name: &str,
    ) -> Vec<f64> {
        for i in 0..depth {
            let curve = permutation[i % self.config.order.len()];
            x = self.block(&x, rows, shape, kind, curve, &format!("{name}.block{i}"));
        }
        x
    }

    fn permutation(&self, scale: usize, attending: &mut usize) -> Vec<usize> {
        let c = self.config;
        let there = |depths: &[usize], kinds: &[BlockKind]| {
            depths.get(scale).is_some_and(|d| *d > 0) && kinds[scale].has_attention()
        };
        if !there(&c.enc_depths, &c.enc_blocks) && !there(&c.dec_depths, &c.dec_blocks) {
            return (0..c.order.len()).collect();
        }
        let found = self.orders.as_ref().map(|orders| orders[*attending].clone());
        *attending += 1;
        found.unwrap_or_else(|| (0..c.order.len()).collect())
    }

    fn norm_gelu(&self, x: &[f64], c: usize, name: &str) -> Vec<f64> {
        let named = |part: &str| self.layers.values.get(&format!("{name}.{part}"), &[c]);
        let (mean, var) = (named("running_mean"), named("running_var"));
        let given = (!self.train || x.len() == c).then_some((mean.as_slice(), var.as_slice()));
        slow::gelu(&slow::batch_norm(x, &named("weight"), &named("bias"), given))
    }

    fn block(
        &self,
        x: &[f64],
        rows: &Rows,
        shape: [usize; 3],
        kind: BlockKind,
        curve: usize,
        name: &str,
    ) -> Vec<f64> {
        let c = shape[0];
        let mut x = if kind.has_convolution() {
            let y = self.layers.conv(x, rows, [c, c, 3], &format!("{name}.conv.0"), true);
            let y = self.layers.linear(&y, c, c, &format!("{name}.conv.1"));
            slow::add(x, &self.layers.layer_norm(&y, c, &format!("{name}.conv.2")))
        } else {
            self.layers.layer_norm(x, c, &format!("{name}.norm0.0"))
        };
        if kind.has_attention() {
            x = self.layers.attention_mlp(x, rows, shape, curve, name);
        }
        x
    }
}

impl Formulas {
    pub fn linear(&self, x: &[f64], i: usize, o: usize, name: &str) -> Vec<f64> {
        let weight = self.values.get(&format!("{name}.weight"), &[o, i]);
        slow::linear(x, i, &weight, Some(&self.values.get(&format!("{name}.bias"), &[o])))
    }

    /// Sum over the occupied voxels around each; at its own place a row finds itself, elsewhere the
    /// first row of the voxel.
    pub fn conv(
        &self,
        x: &[f64],
        rows: &Rows,
        [i, o, k]: [usize; 3],
        name: &str,
        biased: bool,
    ) -> Vec<f64> {
        let weight = self.values.get(&format!("{name}.weight"), &[o, k, k, k, i]);
        let bias =
            if biased { self.values.get(&format!("{name}.bias"), &[o]) } else { vec![0.0; o] };
        let half = k as i32 / 2;
        let mut out = Vec::new();
        for (row, (scene, cell)) in rows.cells.iter().enumerate() {
            let mut sum = bias.clone();
            for tap in 0..k * k * k {
                let step = [tap / (k * k), tap / k % k, tap % k].map(|d| d as i32 - half);
                let place = std::array::from_fn(|a| cell[a] + step[a]);
                let from = if step == [0; 3] {
                    row
                } else {
                    match rows.at.get(&(*scene, place)) {
                        Some(from) => *from,
                        None => continue,
                    }
                };
                for (j, sum) in sum.iter_mut().enumerate() {
                    for p in 0..i {
                        *sum += weight[(j * k * k * k + tap) * i + p] * x[from * i + p];
                    }
                }
            }
            out.extend(sum);
        }
        out
    }

    pub fn layer_norm(&self, x: &[f64], c: usize, name: &str) -> Vec<f64> {
        let named = |part: &str| self.values.get(&format!("{name}.{part}"), &[c]);
        slow::layer_norm(x, &named("weight"), &named("bias"))
    }

    pub fn attention(
        &self,
        x: &[f64],
        rows: &Rows,
        [c, heads, patch]: [usize; 3],
        curve: usize,
        name: &str,
    ) -> Vec<f64> {
        let mut qkv = self.linear(x, c, 3 * c, &format!("{name}.qkv"));
        let (dim, third) = (c / heads, c / heads / 6);
        let turned = self.rope_base.map(|base| rows.cells.iter().map(move |cell| (base, cell)));
        for (row, (base, (_, cell))) in turned.into_iter().flatten().enumerate() {
            for part in 0..2 {
                for head in 0..heads {
                    for axis in 0..3 {
                        for i in 0..third {
                            let angle =
                                f64::from(cell[axis]) * base.powf(-(i as f64) / third as f64);
                            let u = row * 3 * c + part * c + head * dim + axis * 2 * third + i;
                            let (a, b) = (qkv[u], qkv[u + third]);
                            qkv[u] = a * angle.cos() - b * angle.sin();
                            qkv[u + third] = b * angle.cos() + a * angle.sin();
                        }
                    }
                }
            }
        }
        let mut out = vec![0.0; rows.cells.len() * c];
        let scenes = rows.cells.iter().map(|(scene, _)| scene + 1).max().unwrap_or(0);
        for scene in 0..scenes {
            let sequence = self.sequence(rows, scene, curve);
            for (place, &query) in sequence.iter().enumerate() {
                let n = sequence.len();
                // The last patch is the last ones of the sequence, as many as any other.
                let first = place / patch * patch;
                let first = if first + patch > n { n.saturating_sub(patch) } else { first };
                let keys = &sequence[first..n.min(first + patch)];
                for head in 0..heads {
                    let at = |row: usize, part: usize, d: usize| {
                        qkv[row * 3 * c + part * c + head * dim + d]
                    };
                    let score = |key: usize| {
                        let product: f64 = (0..dim).map(|d| at(query, 0, d) * at(key, 1, d)).sum();
                        product / (dim as f64).sqrt()
                    };
                    let scores: Vec<f64> = keys.iter().map(|key| score(*key)).collect();
                    let top = scores.iter().copied().fold(f64::NEG_INFINITY, f64::max);
                    let sum: f64 = scores.iter().map(|s| (s - top).exp()).sum();
                    for (key, score) in keys.iter().zip(&scores) {
                        for d in 0..dim {
                            out[query * c + head * dim + d] +=
                                (score - top).exp() / sum * at(*key, 2, d);
                        }
                    }
                }
            }
        }
        self.linear(&out, c, c, &format!("{name}.proj"))
    }

    /// Rows of a scene along a curve.
    fn sequence(&self, rows: &Rows, scene: usize, curve: usize) -> Vec<usize> {
        let mine = rows.cells.iter().enumerate().filter(|(_, cell)| cell.0 == scene);
        let most = mine.clone().flat_map(|(_, cell)| cell.1).max().unwrap_or(0);
        let depth = u32::BITS - (most as u32 + 1).leading_zeros();
        let code = |[x, y, z]: [u32; 3]| match self.order[curve].as_str() {
            "z" => morton_code([x, y, z], depth),
            "z-trans" => morton_code([y, x, z], depth),
            "hilbert" => hilbert_code([x, y, z], depth),
            _ => hilbert_code([y, x, z], depth),
        };
        let mut coded: Vec<(u64, usize)> =
            mine.map(|(row, cell)| (code(cell.1.map(|v| v as u32)), row)).collect();
        coded.sort_unstable();
        coded.into_iter().map(|(_, row)| row).collect()
    }

    /// Attention and MLP of normalized rows, each beside what goes in.
    pub fn attention_mlp(
        &self,
        mut x: Vec<f64>,
        rows: &Rows,
        shape: [usize; 3],
        curve: usize,
        name: &str,
    ) -> Vec<f64> {
        let c = shape[0];
        let y = self.layer_norm(&x, c, &format!("{name}.norm1.0"));
        let y = self.attention(&y, rows, shape, curve, &format!("{name}.attn"));
        x = slow::add(&x, &y);
        let y = self.layer_norm(&x, c, &format!("{name}.norm2.0"));
        let hidden = self.mlp_ratio * c;
        let y = self.linear(&y, c, hidden, &format!("{name}.mlp.0.fc1"));
        x = slow::add(&x, &self.linear(&slow::gelu(&y), hidden, c, &format!("{name}.mlp.0.fc2")));
        x
    }
}
