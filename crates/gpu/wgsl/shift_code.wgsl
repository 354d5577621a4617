// A code without its last bits, below 64 of them.
fn shift_code(code: vec2<u32>, by: u32) -> vec2<u32> {
  if (by == 0u) {
    return code;
  }
  if (by < 32u) {
    return vec2<u32>((code.x >> by) | (code.y << (32u - by)), code.y >> by);
  }
  return vec2<u32>(code.y >> (by - 32u), 0u);
}
