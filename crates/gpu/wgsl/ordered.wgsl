// A whole number that orders the bits of finite floating-point numbers as these; both zeros have one. Whole numbers, since a
// driver may take tiny floating-point numbers for 0.
fn ordered(bits: u32) -> u32 {
  if (bits == 0x80000000u) {
    return bits;
  }
  if ((bits & 0x80000000u) != 0u) {
    return ~bits;
  }
  return bits | 0x80000000u;
}
