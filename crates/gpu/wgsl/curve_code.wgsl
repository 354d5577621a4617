// Codes along space-filling curves: words of 32 bits, the low one first.

// Moves bit i of a 10-bit number to bit 3i.
fn spread(value: u32) -> u32 {
  var v = value & 0x3ffu;
  v = (v | (v << 16u)) & 0x030000ffu;
  v = (v | (v << 8u)) & 0x0300f00fu;
  v = (v | (v << 4u)) & 0x030c30c3u;
  return (v | (v << 2u)) & 0x09249249u;
}

// Ten bits of each axis from bit `first` on, interleaved; x is the most significant.
fn interleave(x: u32, y: u32, z: u32, first: u32) -> u32 {
  return (spread(x >> first) << 2u) | (spread(y >> first) << 1u) | spread(z >> first);
}

// `bits` bits of each axis, at most 21.
fn morton_code(x: u32, y: u32, z: u32, bits: u32) -> vec2<u32> {
  let cut = (1u << bits) - 1u;
  let lower = interleave(x & cut, y & cut, z & cut, 0u);
  let middle = interleave(x & cut, y & cut, z & cut, 10u);
  let upper = interleave(x & cut, y & cut, z & cut, 20u);
  return vec2<u32>(lower | (middle << 30u), (middle >> 2u) | (upper << 28u));
}
