//! Joins rows of numbers into at most so many centroids, by a tree of k-means.
//!
//! A node with more than 256 centroids to give is split into up to 256 children first; each gets as
//! many as its share of the squared error. Comparing a row with 256 centroids a level, instead of
//! with all 65,536, is what makes a million rows a matter of seconds. Sums have a fixed order, so
//! the result does not depend on the number of threads.

use super::ticker::Ticker;
use crate::SceneError;
use rayon::prelude::*;

/// Most centroids that a row is compared with at a time.
const FAN_OUT: usize = 256;
/// Rows for each centroid that its place is learned from.
const ROWS_PER_CENTROID: usize = 64;
/// Rounds of moving centroids to the mean of their rows.
const ROUNDS: usize = 5;
/// Rows that one task compares.
const ROWS_PER_TASK: usize = 2048;
/// Rows that are compared between two calls of the progress function.
const ROWS_PER_TICK: usize = 32 * ROWS_PER_TASK;
/// Multiplications between two calls of the progress function, where small nodes go together.
const WORK_PER_TICK: usize = 400_000_000;
/// Centroids that are compared at the same time, a few registers of numbers.
const LANES: usize = 16;

/// Rows of numbers, the first `width` of each `stride`.
pub(super) struct Rows<'a> {
    pub(super) values: &'a [f32],
    pub(super) stride: usize,
    pub(super) width: usize,
}

impl Rows<'_> {
    /// How many.
    pub(super) fn len(&self) -> usize {
        self.values.len() / self.stride
    }

    /// One of them.
    pub(super) fn row(&self, row: u32) -> &[f32] {
        &self.values[row as usize * self.stride..][..self.width]
    }
}

/// Centroids, each of at least one row, and the centroid of each row.
pub(super) struct Clusters {
    /// `[k, width]`
    pub(super) centroids: Vec<f32>,
    pub(super) labels: Vec<u32>,
}

/// Rows that share `centroids` centroids.
struct Node {
    rows: Vec<u32>,
    centroids: usize,
}

/// What became of a node.
enum Done {
    /// Its centroids, and the rows of each.
    Leaf(Vec<(Vec<f32>, Vec<u32>)>),
    Split(Vec<Node>),
}

/// Joins rows into at most `most` centroids.
pub(super) fn cluster(
    rows: &Rows<'_>,
    most: usize,
    ticker: &mut Ticker<'_>,
) -> Result<Clusters, SceneError> {
    let mut out = Clusters { centroids: Vec::new(), labels: vec![0; rows.len()] };
    let mut nodes = vec![Node { rows: (0..rows.len() as u32).collect(), centroids: most }];
    let mut finished = 0;
    while !nodes.is_empty() {
        let mut next = Vec::new();
        let mut level = nodes.into_iter().peekable();
        while let Some(node) = level.next() {
            let fraction = finished as f64 / rows.len() as f64;
            let done = if node.work(rows.width) > WORK_PER_TICK {
                vec![node.process(rows, &mut || ticker.tick(fraction))?]
            } else {
                let (mut batch, mut work) = (vec![node], 0);
                while work < WORK_PER_TICK
                    && let Some(node) = level.next_if(|n| n.work(rows.width) <= WORK_PER_TICK)
                {
                    work += node.work(rows.width);
                    batch.push(node);
                }
                ticker.tick(fraction)?;
                let all = batch.into_par_iter().map(|node| node.process(rows, &mut || Ok(())));
                all.collect::<Result<Vec<Done>, SceneError>>()?
            };
            for node in done {
                match node {
                    Done::Split(children) => next.extend(children),
                    Done::Leaf(parts) => {
                        for (centroid, members) in parts {
                            let label = (out.centroids.len() / rows.width) as u32;
                            out.centroids.extend(centroid);
                            finished += members.len();
                            members.iter().for_each(|&row| out.labels[row as usize] = label);
                        }
                    }
                }
            }
        }
        nodes = next;
    }
    Ok(out)
}

impl Node {
    /// About how many multiplications it takes.
    fn work(&self, width: usize) -> usize {
        let learned_from = self.rows.len().min(self.fan_out() * ROWS_PER_CENTROID);
        let compared = self.rows.len() + learned_from * ROUNDS;
        compared.saturating_mul(self.fan_out() * width)
    }

    /// Into how many parts it is split at once.
    fn fan_out(&self) -> usize {
        if self.centroids <= FAN_OUT {
            self.centroids
        } else {
            // Two levels of the same width if they suffice.
            self.centroids.isqrt().clamp(2, FAN_OUT)
        }
    }

    fn process(
        self,
        rows: &Rows<'_>,
        tick: &mut dyn FnMut() -> Result<(), SceneError>,
    ) -> Result<Done, SceneError> {
        if self.centroids >= self.rows.len() {
            let single = |row: u32| (rows.row(row).to_vec(), vec![row]);
            return Ok(Done::Leaf(self.rows.into_iter().map(single).collect()));
        }
        let centroids = learn(rows, &self.rows, self.fan_out(), tick)?;
        let mut nearest = vec![(0u32, 0f32); self.rows.len()];
        for (start, out) in nearest.chunks_mut(ROWS_PER_TICK).enumerate() {
            let start = start * ROWS_PER_TICK;
            centroids.assign(rows, &self.rows[start..start + out.len()], out);
            tick()?;
        }
        let mut parts: Vec<(Vec<u32>, f64)> = vec![(Vec::new(), 0.0); centroids.len()];
        for (&row, &(label, distance)) in self.rows.iter().zip(&nearest) {
            let part = &mut parts[label as usize];
            part.0.push(row);
            part.1 += f64::from(distance);
        }
        parts.retain(|(members, _)| !members.is_empty());
        // Rows that cannot be told apart end here, whatever centroids are left.
        if self.centroids <= FAN_OUT || parts.len() == 1 {
            let leaf = |(members, _): (Vec<u32>, f64)| (mean(rows, &members), members);
            return Ok(Done::Leaf(parts.into_par_iter().map(leaf).collect()));
        }
        let shares = share_out(self.centroids, &parts);
        let node = |((rows, _), centroids)| Node { rows, centroids };
        Ok(Done::Split(parts.into_iter().zip(shares).map(node).collect()))
    }
}

/// Centroids for each part: one, and of the others by the squared error; never more than rows.
fn share_out(centroids: usize, parts: &[(Vec<u32>, f64)]) -> Vec<usize> {
    let mut shares = vec![1usize; parts.len()];
    // Parts that are full leave their share to the others in the next round.
    for _ in 0..4 {
        let left = centroids.saturating_sub(shares.iter().sum());
        let open = |i: usize, shares: &[usize]| shares[i] < parts[i].0.len();
        let error: f64 = (0..parts.len()).filter(|&i| open(i, &shares)).map(|i| parts[i].1).sum();
        if left == 0 || error.is_nan() || error <= 0.0 {
            break;
        }
        for i in 0..parts.len() {
            if open(i, &shares) {
                let share = (left as f64 * parts[i].1 / error) as usize;
                shares[i] = (shares[i] + share).min(parts[i].0.len());
            }
        }
    }
    shares
}

/// Centroids in blocks of [`LANES`], the values of a block one dimension after the other.
struct Centroids {
    width: usize,
    /// `[k, width]`
    rows: Vec<f32>,
    /// `[blocks, width, LANES]`
    blocks: Vec<f32>,
    /// Half of the squared norm; infinite where a block has no centroid.
    half_norms: Vec<f32>,
}

impl Centroids {
    fn new(rows: Vec<f32>, width: usize) -> Self {
        let count = rows.len() / width;
        let num_blocks = count.div_ceil(LANES);
        let mut blocks = vec![0.0; num_blocks * width * LANES];
        let mut half_norms = vec![f32::INFINITY; num_blocks * LANES];
        for (i, row) in rows.chunks_exact(width).enumerate() {
            let (block, lane) = (i / LANES, i % LANES);
            for (d, &v) in row.iter().enumerate() {
                blocks[(block * width + d) * LANES + lane] = v;
            }
            half_norms[i] = 0.5 * row.iter().map(|v| v * v).sum::<f32>();
        }
        Self { width, rows, blocks, half_norms }
    }

    fn len(&self) -> usize {
        self.rows.len() / self.width
    }

    /// The nearest centroid of each row, and the squared distance.
    fn assign(&self, rows: &Rows<'_>, which: &[u32], out: &mut [(u32, f32)]) {
        let tasks = which.par_chunks(ROWS_PER_TASK).zip(out.par_chunks_mut(ROWS_PER_TASK));
        tasks.for_each(|(which, out)| {
            let mut pairs = which.chunks_exact(2).zip(out.chunks_exact_mut(2));
            for (pair, out) in &mut pairs {
                let two = self.nearest([rows.row(pair[0]), rows.row(pair[1])]);
                out.copy_from_slice(&two);
            }
            if which.len() % 2 == 1 {
                let last = which.len() - 1;
                [out[last]] = self.nearest([rows.row(which[last])]);
            }
        });
    }

    /// Several rows at once use each centroid in the registers several times.
    fn nearest<const R: usize>(&self, rows: [&[f32]; R]) -> [(u32, f32); R] {
        let mut best = [(0u32, f32::INFINITY); R];
        let blocks = self.blocks.chunks_exact(self.width * LANES);
        for (number, (block, norms)) in
            blocks.zip(self.half_norms.as_chunks::<LANES>().0).enumerate()
        {
            // |x − c|² / 2 less |x|² / 2, which is the same for all centroids.
            let mut scores = [*norms; R];
            for (d, values) in block.as_chunks::<LANES>().0.iter().enumerate() {
                for (row, score) in rows.iter().zip(&mut scores) {
                    let x = row[d];
                    for (score, value) in score.iter_mut().zip(values) {
                        *score -= x * value;
                    }
                }
            }
            for (best, score) in best.iter_mut().zip(&scores) {
                for (lane, &score) in score.iter().enumerate() {
                    if score < best.1 {
                        *best = ((number * LANES + lane) as u32, score);
                    }
                }
            }
        }
        for (row, best) in rows.iter().zip(&mut best) {
            let norm: f32 = row[..self.width].iter().map(|v| v * v).sum();
            best.1 = (norm + 2.0 * best.1).max(0.0);
        }
        best
    }
}

/// Learns centroids from rows evenly spread over the given ones.
fn learn(
    rows: &Rows<'_>,
    which: &[u32],
    count: usize,
    tick: &mut dyn FnMut() -> Result<(), SceneError>,
) -> Result<Centroids, SceneError> {
    let sample = evenly(which, count * ROWS_PER_CENTROID);
    let first = evenly(&sample, count);
    let values = first.iter().flat_map(|&row| rows.row(row)).copied().collect();
    let mut centroids = Centroids::new(values, rows.width);
    let mut nearest = vec![(0u32, 0f32); sample.len()];
    for _ in 0..ROUNDS {
        centroids.assign(rows, &sample, &mut nearest);
        centroids = moved(rows, &sample, &nearest, &centroids);
        tick()?;
    }
    Ok(centroids)
}

/// So many of the rows, at equal distances; all of them if there are no more.
fn evenly(rows: &[u32], count: usize) -> Vec<u32> {
    if count >= rows.len() {
        return rows.to_vec();
    }
    // In 64 bits: the products of large scenes do not fit into the 32 of WebAssembly.
    let at = |i: usize| (2 * i as u64 + 1) * rows.len() as u64 / (2 * count as u64);
    (0..count).map(|i| rows[at(i) as usize]).collect()
}

/// Each centroid in the middle of its rows; those without any go to the rows that are farthest
/// from theirs.
fn moved(rows: &Rows<'_>, which: &[u32], nearest: &[(u32, f32)], old: &Centroids) -> Centroids {
    let (width, count) = (rows.width, old.len());
    let partial: Vec<(Vec<f64>, Vec<u32>)> = which
        .par_chunks(ROWS_PER_TASK)
        .zip(nearest.par_chunks(ROWS_PER_TASK))
        .map(|(which, nearest)| {
            let (mut sums, mut counts) = (vec![0.0; count * width], vec![0; count]);
            for (&row, &(label, _)) in which.iter().zip(nearest) {
                let label = label as usize;
                counts[label] += 1;
                let sums = &mut sums[label * width..(label + 1) * width];
                for (sum, &v) in sums.iter_mut().zip(rows.row(row)) {
                    *sum += f64::from(v);
                }
            }
            (sums, counts)
        })
        .collect();
    let (mut sums, mut counts) = (vec![0.0; count * width], vec![0u32; count]);
    for (part, part_counts) in &partial {
        sums.iter_mut().zip(part).for_each(|(a, b)| *a += b);
        counts.iter_mut().zip(part_counts).for_each(|(a, b)| *a += b);
    }
    let mut values = old.rows.clone();
    let mut empty = Vec::new();
    for (i, out) in values.chunks_exact_mut(width).enumerate() {
        if counts[i] == 0 {
            empty.push(i);
        }
        for (out, &sum) in out.iter_mut().zip(&sums[i * width..]).filter(|_| counts[i] > 0) {
            *out = (sum / f64::from(counts[i])) as f32;
        }
    }
    if !empty.is_empty() {
        let mut far: Vec<usize> = (0..which.len()).collect();
        far.sort_unstable_by(|&a, &b| nearest[b].1.total_cmp(&nearest[a].1).then(a.cmp(&b)));
        for (&i, &at) in empty.iter().zip(&far) {
            values[i * width..(i + 1) * width].copy_from_slice(rows.row(which[at]));
        }
    }
    Centroids::new(values, width)
}

fn mean(rows: &Rows<'_>, members: &[u32]) -> Vec<f32> {
    let mut sums = vec![0.0f64; rows.width];
    for &row in members {
        sums.iter_mut().zip(rows.row(row)).for_each(|(sum, &v)| *sum += f64::from(v));
    }
    sums.iter().map(|sum| (sum / members.len() as f64) as f32).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rows around so many places.
    fn rows_of(count: usize, places: usize, width: usize) -> Vec<f32> {
        let noise = |i: usize| {
            let mixed = (i as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            ((mixed ^ mixed >> 29).wrapping_mul(0xbf58_476d_1ce4_e5b9) >> 40) as f32 / 16_777_216.0
        };
        let value = |i: usize| {
            let (row, d) = (i / width, i % width);
            noise((row % places) * width + d + 1_000_000) + noise(i) * 0.01
        };
        (0..count * width).map(value).collect()
    }

    #[test]
    fn the_nearest_of_any_number_of_centroids() {
        for (count, width) in [(1, 9), (15, 3), (16, 9), (17, 45), (256, 24)] {
            let values = rows_of(count, count, width);
            let centroids = Centroids::new(values.clone(), width);
            let queries = rows_of(101, 50, width);
            let rows = Rows { values: &queries, stride: width, width };
            let which: Vec<u32> = (0..101).collect();
            let mut out = vec![(0, 0.0); 101];
            centroids.assign(&rows, &which, &mut out);
            for (row, &(label, distance)) in out.iter().enumerate() {
                let to = |c: &[f32]| -> f32 {
                    rows.row(row as u32).iter().zip(c).map(|(a, b)| (a - b).powi(2)).sum()
                };
                let least = values.chunks_exact(width).map(to).fold(f32::INFINITY, f32::min);
                let got = to(&values[label as usize * width..][..width]);
                assert!(got <= least + 1e-4 && (got - distance).abs() < 1e-4, "{got} {least}");
            }
        }
    }

    #[test]
    fn twice_as_many_centroids_as_places_find_nearly_all() {
        let (count, places, width) = (6000, 500, 9);
        let values = rows_of(count, places, width);
        let rows = Rows { values: &values, stride: width, width };
        let mut go_on = |_: f64| true;
        let found = cluster(&rows, 1024, &mut Ticker::new(&mut go_on)).unwrap();
        let centroids = found.centroids.len() / width;
        assert!(centroids <= 1024 && centroids > 400, "{centroids}");
        let mut used = vec![0; centroids];
        let mut squared = 0.0;
        for (row, &label) in found.labels.iter().enumerate() {
            used[label as usize] += 1;
            let centroid = &found.centroids[label as usize * width..][..width];
            let parts = rows.row(row as u32).iter().zip(centroid);
            squared += parts.map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>();
        }
        assert!(used.iter().all(|&n| n > 0));
        // Places are 1/√12 apart in each direction; all but a few have a centroid of their own.
        let error = (squared / (count * width) as f64).sqrt();
        assert!(error < 0.15 / 12f64.sqrt(), "{error}");
        let mut stop = |_: f64| false;
        assert!(cluster(&rows, 1024, &mut Ticker::new(&mut stop)).is_err());
    }

    #[test]
    fn shares_follow_the_error_and_are_no_more_than_rows() {
        let part = |rows: u32, error: f64| ((0..rows).collect::<Vec<u32>>(), error);
        let shares =
            share_out(100, &[part(1000, 1.0), part(1000, 3.0), part(5, 10.0), part(9, 0.0)]);
        assert_eq!((shares[2], shares[3]), (5, 1));
        assert!(shares.iter().sum::<usize>() <= 100 && shares[1] > 2 * shares[0], "{shares:?}");
        assert!(shares[0] + shares[1] > 85, "{shares:?}");
    }
}
