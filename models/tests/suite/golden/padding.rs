//! Group d: how scenes are cut into patches.

use crate::support::Tensors;
use scenesplat_kernels::patches::cut;
use scenesplat_test_support::Golden;

#[test]
fn padding_tables() {
    let Some(g) = Golden::network("d_patch_padding") else { return };
    for case in 0..16 {
        let name = |what: &str| format!("case{case:02}.{what}");
        let mut offsets = vec![0];
        for n in g.ints::<usize>(&name("counts")) {
            offsets.push(offsets[offsets.len() - 1] + n);
        }
        let patches = cut(&offsets, g.ints(&name("K"))[0]);
        g.compare_ints(&name("pad"), patches.pad());
        g.compare_ints(&name("unpad"), patches.unpad());
        let boundaries: Vec<i64> = patches.boundaries().iter().map(|b| *b as i64).collect();
        g.compare_ints(&name("cu_seqlens"), &boundaries);
    }
}
