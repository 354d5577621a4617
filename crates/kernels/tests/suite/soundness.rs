//! Safe code cannot make the kernels read or write outside of what it gave them: sizes that lie, wrap
//! around or contradict each other end in an error or a panic at the entry, in release builds too.
#![forbid(unsafe_code)]

use scenesplat_kernels::gemm::{Epilogue, PackedMatrix, gemm, gemm_tn, mlp};
use scenesplat_kernels::kernel_map::KernelMap;
use scenesplat_kernels::patch_attention::{Heads, backward, forward};
use scenesplat_kernels::patches::cut;
use scenesplat_kernels::permute::gather_rows;
use scenesplat_kernels::segment::{Groups, Reduce, reduce, reduce_backward};
use scenesplat_kernels::sparse_conv::{self, PackedConv};
use scenesplat_kernels::{KernelError, Precision};
use std::panic::{AssertUnwindSafe, catch_unwind};

/// What a panic said.
fn refusal(run: impl FnOnce()) -> String {
    let error = catch_unwind(AssertUnwindSafe(run)).expect_err("sizes that lie were believed");
    let text = error.downcast_ref::<String>().cloned();
    text.or_else(|| error.downcast_ref::<&str>().map(|s| (*s).to_owned())).unwrap()
}

fn voxels(n: i32) -> Vec<[i32; 3]> {
    (0..n).map(|i| [i, 0, 0]).collect()
}

/// `2⁶⁰ + 1`: times 16 it is 16 again in 64 bits.
const WRAPS: usize = (1 << 60) + 1;

#[test]
fn weight_gradients_of_wrapping_channels() {
    let map = KernelMap::build(&voxels(16), &[0, 16], 1).unwrap();
    let (x, grad) = (vec![1.0; 256], vec![1.0; 16]);
    let mut dw = vec![0.0; 16];
    // 16 rows of 2⁶⁰ + 1 channels are 16 values, if nobody looks.
    let said = refusal(|| {
        sparse_conv::backward_weight(Precision::F32, &map, &x, &grad, 16, WRAPS, &mut dw);
    });
    assert!(said.contains("overflow"), "{said}");
}

#[test]
fn input_gradients_and_convolutions_of_wrapping_channels() {
    let map = KernelMap::build(&voxels(16), &[0, 16], 1).unwrap();
    let (grad, weight) = (vec![1.0; 16], vec![1.0; 16]);
    let mut dx = vec![0.0; 256];
    refusal(|| {
        sparse_conv::backward_input(Precision::F32, &map, &grad, &weight, 16, WRAPS, &mut dx);
    });
    refusal(|| drop(PackedConv::new(&weight, 16, WRAPS, 1)));
    // Weights of another shape than the gradient's.
    let said = refusal(|| {
        sparse_conv::backward_input(Precision::F32, &map, &grad, &weight[..8], 16, 1, &mut dx);
    });
    assert!(said.contains("weight length"), "{said}");
}

#[test]
fn attention_with_wrapping_heads() {
    let patches = cut(&[0, 4], 4);
    let order = [0, 1, 2, 3];
    let heads = Heads { count: 1 << 32, dim: 1 << 32 };
    assert!(refusal(|| forward(&[], heads, &patches, &order, &mut [])).contains("overflow"));
    let heads = Heads { count: WRAPS, dim: 16 };
    let (qkv, mut out) = (vec![0.0; 4 * 48], vec![0.0; 4 * 16]);
    assert!(refusal(|| forward(&qkv, heads, &patches, &order, &mut out)).contains("overflow"));
    let mut d = vec![0.0; qkv.len()];
    refusal(|| backward(&qkv, heads, &patches, &order, &out, &mut d));
}

#[test]
fn attention_with_another_sequence_than_its_patches() {
    let heads = Heads { count: 1, dim: 16 };
    let (qkv, mut out) = (vec![0.0; 4 * 48], vec![0.0; 4 * 16]);
    for (patches, order) in [
        // Patches of more positions, of fewer, rows twice, rows that are not there.
        (cut(&[0, 5], 4), [0, 1, 2, 3]),
        (cut(&[0, 3], 4), [0, 1, 2, 3]),
        (cut(&[0, 4], 4), [0, 1, 1, 3]),
        (cut(&[0, 4], 4), [0, 1, 2, 4]),
    ] {
        refusal(|| forward(&qkv, heads, &patches, &order, &mut out));
        let mut d = vec![0.0; qkv.len()];
        refusal(|| backward(&qkv, heads, &patches, &order, &out, &mut d));
    }
    // No row and no channel are no work, however wide the heads claim to be.
    forward(&[], Heads { count: 1, dim: usize::MAX / 3 }, &cut(&[0], 4), &[], &mut []);
    forward(&[], Heads { count: 0, dim: 4 }, &cut(&[0, 4], 4), &[0, 1, 2, 3], &mut []);
    forward(&[], Heads { count: 2, dim: 0 }, &cut(&[0, 4], 4), &[0, 1, 2, 3], &mut []);
}

#[test]
fn patches_of_offsets_that_are_none() {
    for offsets in [&[][..], &[1, 4], &[0, 5, 3], &[0, usize::MAX], &[0, usize::MAX - 5, 4]] {
        refusal(|| drop(cut(offsets, 4)));
    }
    // A patch longer than any scene is one patch.
    assert_eq!(cut(&[0, 3], usize::MAX).boundaries(), [0, 3]);
    assert_eq!(cut(&[0], 4).boundaries(), [0]);
}

#[test]
fn products_of_wrapping_shapes() {
    let values = [1.0; 64];
    for (k, n, k_stride, n_stride) in [
        (1 << 60, 16, 0, 1),
        (WRAPS, 16, 0, 1),
        (4, usize::MAX, 1, 0),
        (2, 2, usize::MAX, 1),
        (2, 2, 1, usize::MAX),
        (65, 1, 1, 1),
    ] {
        refusal(|| drop(PackedMatrix::from_strided(&values, k, n, k_stride, n_stride)));
    }
    let b = PackedMatrix::from_strided(&values, 4, 16, 16, 1);
    refusal(|| gemm(&[1.0; 9], &b, Epilogue::default(), &mut [0.0; 32]));
    refusal(|| gemm(&[1.0; 8], &b, Epilogue::default(), &mut [0.0; 33]));
    let bias = Some(&values[..15]);
    refusal(|| gemm(&[1.0; 8], &b, Epilogue { bias, ..Epilogue::default() }, &mut [0.0; 32]));
    let second = PackedMatrix::from_strided(&values, 16, 4, 4, 1);
    let hidden = (&b, &values[..16]);
    refusal(|| mlp(&[1.0; 8], hidden, &second, Epilogue::default(), &mut [0.0; 9]));
    refusal(|| gemm_tn(&[1.0; 16], WRAPS, &[1.0; 16], 16, None, &mut [0.0; 16]));
    let pairs = Some((&[0, 1][..], &[0, 2][..]));
    refusal(|| gemm_tn(&[1.0; 32], 16, &[1.0; 32], 16, pairs, &mut [0.0; 256]));
}

#[test]
fn groups_are_what_they_say() {
    for (rows, offsets) in [
        (vec![0, 1, 2], vec![]),
        (vec![0, 1, 2], vec![1, 3]),
        (vec![0, 1, 2], vec![0, 2]),
        (vec![0, 1, 2], vec![0, 3, 2, 3]),
        (vec![0, 1, 1], vec![0, 3]),
        (vec![0, 1, 3], vec![0, 3]),
    ] {
        let error = Groups::new(rows, offsets).unwrap_err();
        assert!(matches!(error, KernelError::Groups { .. }), "{error}");
    }
    let groups = Groups::new(vec![2, 0, 1], vec![0, 2, 2, 3]).unwrap();
    assert_eq!(groups.inverse(), [0, 2, 0]);
    assert_eq!(groups.len(), 3);
    let (x, mut out) = ([1.0; 6], [0.0; 6]);
    reduce(&x, 2, &groups, Reduce::Sum, &mut out);
    assert_eq!(out, [2.0, 2.0, 0.0, 0.0, 1.0, 1.0]);
    for (x, out) in [(5, 6), (6, 5), (6, 8)] {
        let (x, mut out) = (vec![1.0; x], vec![0.0; out]);
        refusal(|| reduce(&x, 2, &groups, Reduce::Mean, &mut out));
        for how in [Reduce::Max, Reduce::Sum] {
            let mut dx = vec![0.0; x.len()];
            refusal(|| reduce_backward(&x, 2, &groups, how, &out, &mut dx));
        }
    }
    refusal(|| gather_rows(&[1.0; 6], 2, &[0, 3], &mut [0.0; 4]));
    refusal(|| gather_rows(&[1.0; 6], 2, &[0, 1], &mut [0.0; 6]));
}

/// No memory is reached past its end here either way, but a part of a result would be left as it was.
#[test]
fn norms_of_arrays_that_do_not_fit() {
    use scenesplat_kernels::{activation, batch_norm, layer_norm};
    let (x, mut short, mut out) = ([1.0; 6], [0.0; 4], [0.0; 6]);
    refusal(|| layer_norm::forward(&x, None, &[1.0; 2], &[0.0; 2], 1e-5, &mut short));
    refusal(|| layer_norm::forward(&x, None, &[1.0; 4], &[0.0; 4], 1e-5, &mut out));
    refusal(|| layer_norm::forward(&x, None, &[1.0; 2], &[0.0; 3], 1e-5, &mut out));
    refusal(|| drop(layer_norm::backward(&x, &x[..4], &[1.0; 2], 1e-5, &mut out)));
    refusal(|| batch_norm::apply(&x, &[1.0; 2], &[0.0; 2], false, &mut short));
    refusal(|| batch_norm::apply(&x, &[1.0; 2], &[0.0; 1], false, &mut out));
    let (mean, inverse) = ([0.0; 2], [1.0; 2]);
    refusal(|| {
        drop(batch_norm::backward(&x, &x[..4], &[1.0; 2], &mean, &inverse, true, &mut out));
    });
    refusal(|| activation::gelu_forward(&x, &mut short));
    refusal(|| activation::gelu_backward(&x, &x[..4], &mut out));
}

#[test]
fn orders_of_a_cloud_are_only_rearranged() {
    use scenesplat_kernels::serialization::Curve;
    use scenesplat_kernels::serialized_cloud::{CurveDepth, SerializedCloud};
    let new = || SerializedCloud::new(voxels(5), vec![0, 5], &Curve::ALL, CurveDepth::PerScene);
    for permutation in [&[0, 1, 2][..], &[0, 1, 1, 3], &[0, 1, 2, 4]] {
        refusal(|| new().unwrap().permute_orders(permutation));
    }
    new().unwrap().permute_orders(&[3, 1, 0, 2]);
}
