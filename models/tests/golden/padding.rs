//! Group d: how scenes are cut into patches.

use crate::support::Golden;
use scenesplat_kernels::patches::cut;

#[test]
fn padding_tables() {
    let Some(g) = Golden::open("d_patch_padding.safetensors") else { return };
    for case in 0..16 {
        let name = |what: &str| format!("case{case:02}.{what}");
        let mut offsets = vec![0];
        for n in g.ints(&name("counts")) {
            offsets.push(offsets[offsets.len() - 1] + n as usize);
        }
        let patches = cut(&offsets, g.ints(&name("K"))[0] as usize);
        g.compare_ints(&name("pad"), patches.pad());
        g.compare_ints(&name("unpad"), patches.unpad());
        let boundaries: Vec<i64> = patches.boundaries().iter().map(|b| *b as i64).collect();
        g.compare_ints(&name("cu_seqlens"), &boundaries);
    }
}
