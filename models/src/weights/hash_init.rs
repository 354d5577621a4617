//! Weights from an integer hash: the same on every machine, and the same as those the reference
//! numbers were computed with. They mean nothing; they serve tests and benchmarks.

use candle_core::{DType, Device, Result, Tensor};

/// FNV-1a, 64 bits.
pub fn name_hash(name: &str) -> u64 {
    name.bytes()
        .fold(0xcbf2_9ce4_8422_2325, |h, b| (h ^ u64::from(b)).wrapping_mul(0x100_0000_01b3))
}

/// `len` numbers in −1..1, multiples of 2⁻²³, from a name and a seed.
pub fn unit(name: &str, len: usize, seed: u64) -> Vec<f32> {
    let start = name_hash(name) ^ seed.wrapping_mul(0xd6e8_feb8_6659_fd93);
    (1..=len as u64)
        .map(|i| {
            let mut z = start.wrapping_add(i.wrapping_mul(0x9e37_79b9_7f4a_7c15));
            z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
            z ^= z >> 31;
            ((z >> 40) as i64 - 8_388_608) as f32 * 2f32.powi(-23)
        })
        .collect()
}

/// The value of a parameter: spread like a trained network's by the kind that its name tells.
///
/// # Errors
/// If candle cannot hold the shape.
pub fn hashed_parameter(name: &str, shape: &[usize], seed: u64) -> Result<Tensor> {
    if name.ends_with("num_batches_tracked") {
        return Tensor::zeros(shape, DType::I64, &Device::Cpu);
    }
    let mut values = unit(name, shape.iter().product(), seed);
    let (offset, factor) = if name.ends_with("running_mean") {
        (0.0, 0.125)
    } else if name.ends_with("running_var") {
        (1.0, 0.5)
    } else if shape.len() == 1 && name.ends_with("weight") {
        (1.0, 0.25)
    } else if shape.len() == 1 {
        (0.0, 0.125)
    } else {
        let fan_in: usize = shape.iter().skip(1).product();
        let bound = (3.0 / fan_in.max(1) as f64).sqrt() as f32;
        (0.0, if name.ends_with("qkv.weight") { bound * 2.0 } else { bound })
    };
    for v in &mut values {
        // Two roundings, as in the definition: no fused multiply–add.
        *v *= factor;
        *v += offset;
    }
    Tensor::from_vec(values, shape, &Device::Cpu)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn published_values() {
        let at = |name: &str, shape: &[usize], i: usize, seed| -> f32 {
            hashed_parameter(name, shape, seed)
                .unwrap()
                .flatten_all()
                .unwrap()
                .to_vec1::<f32>()
                .unwrap()[i]
        };
        let qkv = "enc.enc0.block0.attn.qkv.weight";
        assert_eq!(at(qkv, &[96, 32], 0, 20240), 0.577_410_64);
        assert_eq!(at(qkv, &[96, 32], 3071, 20240), -0.283_237_28);
        assert_eq!(
            at("embedding.stem.conv.weight", &[32, 5, 5, 5, 11], 12345, 20240),
            -0.039_594_013
        );
        assert_eq!(at("embedding.stem.norm.running_var", &[32], 7, 20240), 0.706_386_4);
        assert_eq!(at("dec.dec0.block1.mlp.0.fc2.bias", &[768], 767, 20240), 0.041_553_57);
        assert_eq!(at("R", &[10, 10], 99, 501), 0.444_039_05);
        assert_eq!(unit("R", 100, 501)[99], 0.810_700_65);
    }
}
