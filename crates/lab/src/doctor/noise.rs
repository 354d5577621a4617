//! Numbers without a pattern, the same in every run.

/// Splitmix64.
pub(super) struct Noise(u64);

impl Noise {
    pub(super) fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ 0x1234_5678)
    }

    pub(super) fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// −1..1.
    pub(super) fn float(&mut self) -> f32 {
        (self.next() >> 40) as f32 / 8_388_608.0 - 1.0
    }

    /// Puts a list in no order.
    pub(super) fn shuffle<T>(&mut self, list: &mut [T]) {
        for i in (1..list.len()).rev() {
            list.swap(i, self.below(i + 1));
        }
    }

    /// 0..n.
    pub(super) fn below(&mut self, n: usize) -> usize {
        (self.next() % n.max(1) as u64) as usize
    }
}

/// So many numbers of −1..1 times `size`.
pub(super) fn noise(n: usize, seed: u64, size: f32) -> Vec<f32> {
    let mut rng = Noise::new(seed);
    (0..n).map(|_| rng.float() * size).collect()
}

/// So many points in a cube of that half side.
pub(super) fn points(n: usize, seed: u64, half: f32) -> Vec<[f32; 3]> {
    let mut rng = Noise::new(seed);
    (0..n).map(|_| [(); 3].map(|()| rng.float() * half)).collect()
}
