//! The arrays of a scene, filled block by block in parallel.

use super::memory::in_large_pages;
use crate::GaussianScene;
use crate::gaussian_scene::sh_rest_len;
use rayon::prelude::*;

/// Rows that one task of a parallel read handles; smaller scenes are read by the calling thread.
pub(crate) const ROWS_PER_BLOCK: usize = 4096;

/// Some rows of a scene, to be filled. Every slice has the same number of rows.
pub(crate) struct SceneBlock<'a> {
    /// The first of them.
    pub(crate) first_row: usize,
    pub(crate) coord: &'a mut [[f32; 3]],
    pub(crate) log_scale: &'a mut [[f32; 3]],
    pub(crate) quat: &'a mut [[f32; 4]],
    pub(crate) opacity_logit: &'a mut [f32],
    pub(crate) sh_dc: &'a mut [[f32; 3]],
    /// `[rows, K, 3]` flattened.
    pub(crate) sh_rest: &'a mut [f32],
}

/// A scene of zeros. The memory comes from the system untouched, so tasks that fill it are the first to
/// write to it.
///
/// The caller has checked `rows` against the length of the file.
pub(crate) fn zero_scene(rows: usize, sh_degree: u8) -> GaussianScene {
    GaussianScene {
        coord: in_large_pages(vec![[0.0; 3]; rows]),
        log_scale: in_large_pages(vec![[0.0; 3]; rows]),
        quat: in_large_pages(vec![[0.0; 4]; rows]),
        opacity_logit: in_large_pages(vec![0.0; rows]),
        sh_dc: in_large_pages(vec![[0.0; 3]; rows]),
        sh_rest: in_large_pages(vec![0.0; rows * sh_rest_len(sh_degree) * 3]),
        sh_degree,
        ..GaussianScene::default()
    }
}

/// A scene of `rows` Gaussians whose blocks `fill` has filled; what it leaves alone is 0.
///
/// The caller has checked `rows` against the length of the file.
pub(crate) fn fill_scene(
    rows: usize,
    sh_degree: u8,
    fill: impl Fn(SceneBlock<'_>) + Send + Sync,
) -> GaussianScene {
    let mut scene = zero_scene(rows, sh_degree);
    let width = scene.sh_rest_len() * 3;
    let mut coord = scene.coord.chunks_mut(ROWS_PER_BLOCK);
    let mut log_scale = scene.log_scale.chunks_mut(ROWS_PER_BLOCK);
    let mut quat = scene.quat.chunks_mut(ROWS_PER_BLOCK);
    let mut opacity_logit = scene.opacity_logit.chunks_mut(ROWS_PER_BLOCK);
    let mut sh_dc = scene.sh_dc.chunks_mut(ROWS_PER_BLOCK);
    // Without coefficients there are no chunks, and every block gets an empty slice.
    let mut sh_rest = scene.sh_rest.chunks_mut(ROWS_PER_BLOCK * width.max(1));
    let mut blocks = Vec::with_capacity(rows.div_ceil(ROWS_PER_BLOCK));
    for first_row in (0..rows).step_by(ROWS_PER_BLOCK) {
        blocks.push(SceneBlock {
            first_row,
            coord: coord.next().unwrap_or_default(),
            log_scale: log_scale.next().unwrap_or_default(),
            quat: quat.next().unwrap_or_default(),
            opacity_logit: opacity_logit.next().unwrap_or_default(),
            sh_dc: sh_dc.next().unwrap_or_default(),
            sh_rest: sh_rest.next().unwrap_or_default(),
        });
    }
    if blocks.len() == 1 {
        blocks.into_iter().for_each(fill);
    } else {
        blocks.into_par_iter().for_each(fill);
    }
    scene
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_row_is_filled_once() {
        for (rows, degree) in [(1, 0), (4096, 1), (4097, 2), (10_000, 0)] {
            let scene = fill_scene(rows, degree, |block| {
                for (i, coord) in block.coord.iter_mut().enumerate() {
                    coord[0] += (block.first_row + i) as f32;
                }
                block.quat.fill([1.0; 4]);
                block.log_scale.fill([1.0; 3]);
                block.sh_dc.fill([1.0; 3]);
                block.opacity_logit.fill(1.0);
                block.sh_rest.fill(1.0);
            });
            scene.check_rows().unwrap();
            assert!(scene.coord.iter().enumerate().all(|(i, c)| c[0] == i as f32));
            assert!(scene.sh_rest.iter().chain(scene.quat.as_flattened()).all(|&v| v == 1.0));
        }
    }
}
