//! Attention in patches.

use crate::support::{close, gpu, random, rows, stored};
use scenesplat_gpu::ops::Stored;
use scenesplat_gpu::ops::patch_attention::{items, patch_attention};
use scenesplat_gpu::ops::point_rope::{DeviceRotations, point_rope};
use scenesplat_kernels::patch_attention::Heads;
use scenesplat_kernels::patches::cut;
use scenesplat_kernels::point_rope::Rotations;
use scenesplat_test_support::reference;

#[test]
pub fn attention_follows_the_formula_in_whole_and_borrowed_patches() {
    let Some(gpu) = gpu() else { return };
    for (stored, rounding) in stored(&gpu) {
        for (scenes, patch, heads) in [
            (vec![1], 4, Heads { count: 1, dim: 1 }),
            (vec![5, 130], 64, Heads { count: 2, dim: 16 }),
            (vec![70, 3], 48, Heads { count: 3, dim: 18 }),
            (vec![90], 200, Heads { count: 1, dim: 48 }),
            (vec![33], 16, Heads { count: 1, dim: 64 }),
        ] {
            let mut offsets = vec![0];
            scenes.iter().for_each(|n| offsets.push(offsets[offsets.len() - 1] + n));
            let patches = cut(&offsets, patch);
            let c = heads.channels();
            let of_rows = random(offsets[offsets.len() - 1] * 3 * c, 1);
            // Rows of slots, as the layer before makes them.
            let slots: Vec<f32> = patches
                .pad()
                .iter()
                .flat_map(|p| of_rows[*p as usize * 3 * c..][..3 * c].to_vec())
                .collect();
            let mut commands = gpu.commands();
            let list = gpu.upload("items", &items(patches.patches(), 0).unwrap()).unwrap();
            let input = rows(&gpu, &slots, 3 * c, stored);
            let out = patch_attention(&mut commands, &input, heads, &list).unwrap();
            let got = out.read(&mut commands).unwrap();
            for p in patches.patches() {
                let seen: Vec<usize> =
                    patches.pad()[p.start..p.start + p.len].iter().map(|p| *p as usize).collect();
                let want = reference::attention_segment(&of_rows, heads.count, heads.dim, &seen);
                let own = p.start * c..(p.start + p.own) * c;
                close("attention", &got[own], &want[..p.own * c], rounding * 4.0);
            }
        }
    }
}

#[test]
fn large_scores_stay_finite_and_a_bad_patch_spoils_no_other() {
    let Some(gpu) = gpu() else { return };
    let heads = Heads { count: 1, dim: 8 };
    let patches = cut(&[0, 64], 32);
    let mut qkv = random(64 * 24, 1);
    // Scores of thousands: one key takes all the weight.
    qkv.iter_mut().enumerate().filter(|(i, _)| i % 24 < 16).for_each(|(_, v)| *v *= 100.0);
    let list = gpu.upload("items", &items(patches.patches(), 0).unwrap()).unwrap();
    let run = |qkv: &[f32]| {
        let mut commands = gpu.commands();
        let input = rows(&gpu, qkv, 24, Stored::F32);
        patch_attention(&mut commands, &input, heads, &list).unwrap().read(&mut commands).unwrap()
    };
    let got = run(&qkv);
    let want = reference::attention_segment(&qkv, 1, 8, &(0..32).collect::<Vec<_>>());
    close("large scores", &got[..32 * 8], &want, 1e-3);
    let mut spoiled = qkv.clone();
    spoiled[40 * 24 + 9] = f32::NAN;
    let other = run(&spoiled);
    assert_eq!(other[..32 * 8], got[..32 * 8]);
    assert!(
        other[32 * 8..].iter().all(|v| v.is_nan()),
        "a key that is NaN reaches all of its patch"
    );
}

#[test]
fn heads_too_wide_and_rows_of_another_width_are_errors() {
    let Some(gpu) = gpu() else { return };
    let list = gpu.upload("items", &items(cut(&[0, 4], 4).patches(), 0).unwrap()).unwrap();
    let mut commands = gpu.commands();
    let input = rows(&gpu, &random(4 * 24, 1), 24, Stored::F32);
    let heads = |count, dim| Heads { count, dim };
    assert!(patch_attention(&mut commands, &input, heads(2, 8), &list).is_err());
    let wide = rows(&gpu, &random(4 * 195, 1), 195, Stored::F32);
    let error = patch_attention(&mut commands, &wide, heads(1, 65), &list).unwrap_err();
    assert!(error.to_string().contains("at most 64"), "{error}");
}

#[test]
pub fn queries_and_keys_turn_with_their_voxels() {
    let Some(gpu) = gpu() else { return };
    for (stored, rounding) in stored(&gpu) {
        for (count, dim) in [(1, 6), (2, 18), (3, 48)] {
            let (heads, n) = (Heads { count, dim }, 37);
            let c = heads.channels();
            let places: Vec<[i32; 3]> = (0..n).map(|i| [i * 37 % 211, (1 << 20) - i, i]).collect();
            // Two entries in front belong to other slots.
            let list: Vec<u32> = [0, 1].into_iter().chain((0..n as u32).rev()).collect();
            let qkv = random(n as usize * 3 * c, 1);
            let rotations = Rotations::new(&places, dim, 100.0);
            let device = DeviceRotations::upload(&gpu, &rotations).unwrap();
            let input = rows(&gpu, &qkv, 3 * c, stored);
            let slots = gpu.upload("list", &list).unwrap();
            let mut commands = gpu.commands();
            point_rope(&mut commands, &input, heads, &device, &slots, 2).unwrap();
            let of_slots: Vec<[i32; 3]> =
                list[2..].iter().map(|row| places[*row as usize]).collect();
            let want = reference::point_rope(&qkv, &of_slots, count, dim, 100.0);
            let got = input.read(&mut commands).unwrap();
            close("rotary embedding", &got, &want, rounding * 2.0);
            for (row, before) in got.chunks_exact(3 * c).zip(qkv.chunks_exact(3 * c)) {
                assert_eq!(row[2 * c..], before[2 * c..], "values do not turn");
            }
            let other = Heads { count: 3 * count, dim: dim / 3 };
            assert!(point_rope(&mut commands, &input, other, &device, &slots, 2).is_err());
        }
    }
}
