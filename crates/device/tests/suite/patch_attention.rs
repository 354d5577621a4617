use crate::{Buffer, Grid, GridError};
use crate::{assert_near, bits_in_any_order, random, shuffled, values};
use scenesplat_device::Launcher;
use scenesplat_device::ops::patch_attention::{self as attention, Heads, Patch, Patches};
use scenesplat_kernels::{Precision, patch_attention as cpu, patches as cpu_patches};

crate::support::on_grid! {
    attention_and_its_gradient_at_every_width
    patches_of_the_usual_length
    large_scores_and_values_that_are_not_finite
    bf16_is_within_its_rounding
}

/// A batch of scenes cut into patches.
struct Case {
    scenes: Vec<usize>,
    patch_size: usize,
    heads: cpu::Heads,
}

impl Case {
    fn of(scenes: &[usize], patch_size: usize, count: usize, dim: usize) -> Self {
        Self { scenes: scenes.to_vec(), patch_size, heads: cpu::Heads { count, dim } }
    }

    fn patches(&self) -> cpu_patches::Patches {
        let mut offsets = vec![0];
        for scene in &self.scenes {
            offsets.push(offsets[offsets.len() - 1] + scene);
        }
        cpu_patches::cut(&offsets, self.patch_size)
    }

    fn rows(&self) -> usize {
        self.scenes.iter().sum()
    }

    /// Any permutation inside each scene.
    fn order(&self) -> Vec<u32> {
        let mut order = Vec::new();
        for (i, &scene) in self.scenes.iter().enumerate() {
            let first = order.len() as u32;
            order.extend(shuffled(scene, i as u64).iter().map(|r| r + first));
        }
        order
    }

    fn device_heads(&self) -> Heads {
        Heads { count: self.heads.count as u32, dim: self.heads.dim as u32 }
    }

    fn upload(&self, l: &Grid) -> Result<Patches<Buffer>, GridError> {
        let patches = self.patches();
        let list: Vec<Patch> = patches
            .patches()
            .iter()
            .map(|p| Patch { start: p.start as u32, len: p.len as u32, own: p.own as u32 })
            .collect();
        Patches::upload(l, &list, patches.pad())
    }

    fn what(&self) -> String {
        format!("scenes {:?}, patches of {}, {:?}", self.scenes, self.patch_size, self.heads)
    }

    fn check(&self, qkv: &[f32], bound: f64) {
        let (n, c) = (self.rows(), self.heads.channels());
        let (patches, order) = (self.patches(), self.order());
        let mut want = vec![0.0; n * c];
        cpu::forward(qkv, self.heads, &patches, &order, &mut want);
        let grad = random(n * c, 9);
        let mut want_dqkv = vec![0.0; qkv.len()];
        cpu::backward(qkv, self.heads, &patches, &order, &grad, &mut want_dqkv);
        let got = bits_in_any_order(|l| {
            let (qkv_in, order) = (l.upload_values(qkv)?, l.upload_values(&order)?);
            let patches = self.upload(l)?;
            let heads = self.device_heads();
            let attended = attention::forward(l, &qkv_in, heads, &patches, &order)?;
            let mut dqkv = l.alloc_values::<f32>(qkv.len())?;
            let grad = l.upload_values(&grad)?;
            attention::backward(l, &qkv_in, heads, &patches, &order, &attended, &grad, &mut dqkv)?;
            Ok([values(l, &attended.out, n * c)?, values(l, &dqkv, qkv.len())?].concat())
        });
        assert_near(&got[..n * c], &want, bound, &self.what());
        assert_near(&got[n * c..], &want_dqkv, bound, &format!("gradient, {}", self.what()));
    }
}

fn attention_and_its_gradient_at_every_width() {
    // One and two rows, a patch and one row more and less, three patches of which the last borrows.
    for (scenes, patch) in [
        (&[0][..], 64),
        (&[1], 64),
        (&[2, 0, 1], 64),
        (&[63, 64, 65], 64),
        (&[130, 5], 64),
        (&[100, 47], 48),
    ] {
        for dim in [16, 18] {
            let case = Case::of(scenes, patch, 2, dim);
            case.check(&random(case.rows() * 6 * dim, 1), 1e-5);
        }
    }
    for dim in [1, 24, 32, 40, 48, 64] {
        let case = Case::of(&[75, 20], 70, 1, dim);
        case.check(&random(case.rows() * 3 * dim, 2), 1e-5);
    }
}

fn patches_of_the_usual_length() {
    for n in [1023, 1024, 1025] {
        let case = Case::of(&[n], 1024, 1, 16);
        case.check(&random(case.rows() * 48, 3), 1e-5);
    }
}

fn large_scores_and_values_that_are_not_finite() {
    let case = Case::of(&[150, 40], 64, 2, 16);
    // Scores of thousands: their last bits are a thousandth of a weight.
    let qkv: Vec<f32> = random(190 * 96, 4).iter().map(|v| v * 30.0).collect();
    case.check(&qkv, 3e-3);
    // Keys that are all the same, and scores far apart.
    let mut same = random(190 * 96, 5);
    for row in same.chunks_exact_mut(96) {
        row[32..64].fill(0.25);
    }
    case.check(&same, 1e-5);
    // Only the second scene notices.
    let mut bad = random(190 * 96, 6);
    bad[170 * 96 + 3] = f32::NAN;
    let mut want = vec![0.0; 190 * 32];
    cpu::forward(&bad, case.heads, &case.patches(), &case.order(), &mut want);
    assert!(want[..150 * 32].iter().all(|v| v.is_finite()));
    let got = bits_in_any_order(|l| {
        let (qkv, order) = (l.upload_values(&bad)?, l.upload_values(&case.order())?);
        let heads = case.device_heads();
        let attended = attention::forward(l, &qkv, heads, &case.upload(l)?, &order)?;
        values(l, &attended.out, 190 * 32)
    });
    assert_near(&got, &want, 1e-5, "a NaN among the queries");
}

fn bf16_is_within_its_rounding() {
    let round = |v: f32| (v.to_bits() + 0x7fff + (v.to_bits() >> 16 & 1)) >> 16;
    for (scenes, patch, count, dim) in [
        (&[0][..], 64, 1, 16),
        (&[1], 64, 1, 16),
        (&[2], 64, 3, 18),
        (&[65, 130], 64, 2, 18),
        (&[100, 47], 48, 2, 32),
        (&[70], 128, 1, 48),
        (&[70], 128, 1, 64),
        (&[1025], 1024, 1, 16),
    ] {
        let case = Case::of(scenes, patch, count, dim);
        let (n, c) = (case.rows(), count * dim);
        let words: Vec<u16> = random(n * 3 * c, 7).iter().map(|v| round(*v) as u16).collect();
        let qkv: Vec<f32> = words.iter().map(|w| f32::from_bits(u32::from(*w) << 16)).collect();
        let mut want = vec![0.0; n * c];
        let (patches, order) = (case.patches(), case.order());
        cpu::forward_with(Precision::Bf16, &qkv, case.heads, &patches, &order, &mut want);
        let mut exact = vec![0.0; n * c];
        cpu::forward(&qkv, case.heads, &patches, &order, &mut exact);
        let got = bits_in_any_order(|l| {
            let (qkv, order) = (l.upload_values(&words)?, l.upload_values(&order)?);
            let mut out = l.alloc_values::<u16>(n * c)?;
            let heads = case.device_heads();
            attention::forward_bf16(l, &qkv, heads, &case.upload(l)?, &order, &mut out)?;
            let words = l.download_values::<u16>(&out, n * c)?;
            Ok(words.iter().map(|w| f32::from_bits(u32::from(*w) << 16)).collect())
        });
        // Results are rounded too, which the CPU has in f32.
        assert_near(&got, &want, 1e-2, &format!("as in bf16 on the CPU: {}", case.what()));
        assert_near(&got, &exact, 1e-2, &format!("as in f32: {}", case.what()));
    }
}
