//! The network written from its formulas: f64, plain loops, one row after the other; coarse rows
//! ascend by scene and cell. Nothing of it is shared with the network but the bit-by-bit curve
//! codes.

use scenesplat_kernels::reference::{hilbert_code, morton_code};
use scenesplat_models::LitePtConfig;
use scenesplat_models::weights::hashed_parameter;
use scenesplat_test_support::reference::gelu;
use std::cell::RefCell;
use std::collections::BTreeMap;

/// Values by name, made when they are asked for; so what was asked for can be compared with what
/// the network has.
#[derive(Default)]
pub struct Values(RefCell<BTreeMap<String, Shaped>>);

/// Shape and values.
type Shaped = (Vec<usize>, Vec<f64>);

impl Values {
    fn get(&self, name: &str, shape: &[usize]) -> Vec<f64> {
        let mut all = self.0.borrow_mut();
        let (known, values) = all.entry(name.to_owned()).or_insert_with(|| {
            let hashed = hashed_parameter(name, shape, super::scenes::SEED).unwrap();
            let values = super::scenes::flat(&hashed).into_iter().map(f64::from).collect();
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
struct Rows {
    /// Scene and voxel.
    cells: Vec<(usize, [i32; 3])>,
    /// First row of a voxel.
    at: BTreeMap<(usize, [i32; 3]), usize>,
}

impl Rows {
    fn new(cells: Vec<(usize, [i32; 3])>) -> Self {
        let mut at = BTreeMap::new();
        cells.iter().enumerate().for_each(|(row, cell)| _ = at.entry(*cell).or_insert(row));
        Self { cells, at }
    }
}

/// Rows, features, cell of each row, permutation of the curves.
type Finer = (Rows, Vec<f64>, Vec<usize>, Vec<usize>);

pub struct Reference<'a> {
    pub config: &'a LitePtConfig,
    pub values: Values,
    /// Whether batch norms take the statistics of the batch.
    pub train: bool,
    /// Which curve of the list stands at each place of it, scale with attention by scale.
    pub orders: Option<Vec<Vec<usize>>>,
}

impl Reference<'_> {
    pub fn forward(&self, scenes: &[&super::scenes::Scene]) -> Vec<f64> {
        let cells = scenes.iter().enumerate();
        let cells = cells.flat_map(|(i, s)| s.cells.iter().map(move |c| (i, *c))).collect();
        let feat = scenes.iter().flat_map(|s| s.feat.iter().map(|v| f64::from(*v))).collect();
        let c = self.config;
        let mut rows = Rows::new(cells);
        let channels = &c.enc_channels;
        let stem = "embedding.stem";
        let x: Vec<f64> = feat;
        let x =
            self.conv(&x, &rows, [c.in_channels, channels[0], 5], &format!("{stem}.conv"), false);
        let mut x = self.norm_gelu(&x, channels[0], &format!("{stem}.norm"));
        let mut attending = 0;
        let mut finer: Vec<Finer> = Vec::new();
        let mut permutation = self.permutation(0, &mut attending);
        for stage in 0..channels.len() {
            let name = format!("enc.enc{stage}");
            if stage > 0 {
                let stride = c.stride[stage - 1] as i32;
                let cell = |(scene, v): &(usize, [i32; 3])| (*scene, v.map(|v| v / stride));
                let mut coarse: Vec<_> = rows.cells.iter().map(cell).collect();
                let members = coarse.clone();
                coarse.sort_unstable();
                coarse.dedup();
                let of: Vec<usize> =
                    members.iter().map(|m| coarse.binary_search(m).unwrap()).collect();
                let (i, o) = (channels[stage - 1], channels[stage]);
                let wide = self.linear(&x, i, o, &format!("{name}.down.proj"));
                let mut most = vec![f64::NEG_INFINITY; coarse.len() * o];
                for (row, &group) in of.iter().enumerate() {
                    for j in 0..o {
                        let to = &mut most[group * o + j];
                        *to = to.max(wide[row * o + j]);
                    }
                }
                let pooled = self.norm_gelu(&most, o, &format!("{name}.down.norm.0"));
                let next = self.permutation(stage, &mut attending);
                finer.push((
                    std::mem::replace(&mut rows, Rows::new(coarse)),
                    std::mem::replace(&mut x, pooled),
                    of,
                    std::mem::replace(&mut permutation, next),
                ));
            }
            let shape = [channels[stage], c.enc_num_head[stage], c.enc_patch_size[stage]];
            for i in 0..c.enc_depths[stage] {
                let kind = c.enc_blocks[stage];
                let curve = permutation[i % c.order.len()];
                let parts = [kind.has_convolution(), kind.has_attention()];
                x = self.block(&x, &rows, shape, parts, curve, &format!("{name}.block{i}"));
            }
        }
        let mut below = channels[channels.len() - 1];
        for stage in (0..c.dec_channels.len()).rev() {
            let (fine, skip, of, permutation) = finer.pop().unwrap();
            let (name, o) = (format!("dec.dec{stage}"), c.dec_channels[stage]);
            let up = |x: &[f64], i: usize, part: &str| {
                let wide = self.linear(x, i, o, &format!("{name}.up.{part}.0"));
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
            for i in 0..c.dec_depths[stage] {
                let kind = c.dec_blocks[stage];
                let curve = permutation[i % c.order.len()];
                let parts = [kind.has_convolution(), kind.has_attention()];
                x = self.block(&x, &rows, shape, parts, curve, &format!("{name}.block{i}"));
            }
            below = o;
        }
        x
    }

    fn permutation(&self, scale: usize, attending: &mut usize) -> Vec<usize> {
        let c = self.config;
        let there = |depths: &[usize], kinds: &[scenesplat_models::litept::BlockKind]| {
            depths.get(scale).is_some_and(|d| *d > 0) && kinds[scale].has_attention()
        };
        if !there(&c.enc_depths, &c.enc_blocks) && !there(&c.dec_depths, &c.dec_blocks) {
            return (0..c.order.len()).collect();
        }
        let found = self.orders.as_ref().map(|orders| orders[*attending].clone());
        *attending += 1;
        found.unwrap_or_else(|| (0..c.order.len()).collect())
    }

    fn linear(&self, x: &[f64], i: usize, o: usize, name: &str) -> Vec<f64> {
        let weight = self.values.get(&format!("{name}.weight"), &[o, i]);
        let bias = self.values.get(&format!("{name}.bias"), &[o]);
        let mut out = Vec::new();
        for row in x.chunks_exact(i) {
            for j in 0..o {
                let product: f64 = (0..i).map(|k| row[k] * weight[j * i + k]).sum();
                out.push(product + bias[j]);
            }
        }
        out
    }

    /// Sum over the occupied voxels around each; at its own place a row finds itself, elsewhere the
    /// first row of the voxel.
    fn conv(
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

    fn norm_gelu(&self, x: &[f64], c: usize, name: &str) -> Vec<f64> {
        let named = |part: &str| self.values.get(&format!("{name}.{part}"), &[c]);
        let (weight, bias) = (named("weight"), named("bias"));
        let (mut mean, mut var) = (named("running_mean"), named("running_var"));
        let n = x.len() / c;
        if self.train && n > 1 {
            for j in 0..c {
                let column = || (0..n).map(|r| x[r * c + j]);
                mean[j] = column().sum::<f64>() / n as f64;
                var[j] = column().map(|v| (v - mean[j]).powi(2)).sum::<f64>() / n as f64;
            }
        }
        let unit = |(at, v): (usize, &f64)| {
            let j = at % c;
            gelu((v - mean[j]) / (var[j] + 1e-3).sqrt() * weight[j] + bias[j])
        };
        x.iter().enumerate().map(unit).collect()
    }

    fn layer_norm(&self, x: &[f64], c: usize, name: &str) -> Vec<f64> {
        let weight = self.values.get(&format!("{name}.weight"), &[c]);
        let bias = self.values.get(&format!("{name}.bias"), &[c]);
        let mut out = Vec::new();
        for row in x.chunks_exact(c) {
            let mean = row.iter().sum::<f64>() / c as f64;
            let var = row.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / c as f64;
            out.extend((0..c).map(|j| (row[j] - mean) / (var + 1e-5).sqrt() * weight[j] + bias[j]));
        }
        out
    }

    fn block(
        &self,
        x: &[f64],
        rows: &Rows,
        shape: [usize; 3],
        [convolution, attention]: [bool; 2],
        curve: usize,
        name: &str,
    ) -> Vec<f64> {
        let c = shape[0];
        let add = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a + b).collect::<Vec<_>>();
        let mut x = if convolution {
            let y = self.conv(x, rows, [c, c, 3], &format!("{name}.conv.0"), true);
            let y = self.linear(&y, c, c, &format!("{name}.conv.1"));
            add(x, &self.layer_norm(&y, c, &format!("{name}.conv.2")))
        } else {
            self.layer_norm(x, c, &format!("{name}.norm0.0"))
        };
        if attention {
            let y = self.layer_norm(&x, c, &format!("{name}.norm1.0"));
            let y = self.attention(&y, rows, shape, curve, &format!("{name}.attn"));
            x = add(&x, &y);
            let y = self.layer_norm(&x, c, &format!("{name}.norm2.0"));
            let hidden = self.config.mlp_ratio * c;
            let y = self.linear(&y, c, hidden, &format!("{name}.mlp.0.fc1"));
            let y: Vec<f64> = y.into_iter().map(gelu).collect();
            x = add(&x, &self.linear(&y, hidden, c, &format!("{name}.mlp.0.fc2")));
        }
        x
    }

    fn attention(
        &self,
        x: &[f64],
        rows: &Rows,
        [c, heads, patch]: [usize; 3],
        curve: usize,
        name: &str,
    ) -> Vec<f64> {
        let mut qkv = self.linear(x, c, 3 * c, &format!("{name}.qkv"));
        let (dim, third) = (c / heads, c / heads / 6);
        for (row, (_, cell)) in rows.cells.iter().enumerate() {
            for part in 0..2 {
                for head in 0..heads {
                    for axis in 0..3 {
                        for i in 0..third {
                            let angle = f64::from(cell[axis])
                                * self.config.rope_base.powf(-(i as f64) / third as f64);
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
        let code = |[x, y, z]: [u32; 3]| match self.config.order[curve].as_str() {
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
}
