// Codes of cells along a curve: Morton, or with HILBERT Hilbert. EXCHANGED: with the first two axes exchanged.

struct Params {
  rows: u32,
  scenes: u32,
}

@group(0) @binding(0) var<uniform> p: Params;
@group(0) @binding(1) var<storage, read> offsets: array<u32>;
@group(0) @binding(2) var<storage, read> depths: array<u32>;
@group(0) @binding(3) var<storage, read> cells: array<i32>;
@group(0) @binding(4) var<storage, read_write> low: array<u32>;
@group(0) @binding(5) var<storage, read_write> high: array<u32>;

// All ones where the bit is set, else zero.
fn bit_mask(value: u32, bit: u32) -> u32 {
  return 0u - ((value >> bit) & 1u);
}

// Flips the lower bits of x where `other` has the level's bit, else exchanges those of the two: [x, other].
fn turn(x: u32, other: u32, level: u32, lower: u32) -> vec2<u32> {
  let there = bit_mask(other, level);
  let exchange = (x ^ other) & lower & ~there;
  return vec2<u32>(x ^ (exchange | (lower & there)), other ^ exchange);
}

// Skilling's transform.
fn hilbert_code(cell: vec3<u32>, bits: u32) -> vec2<u32> {
  var c = cell;
  for (var i = 0u; i < bits; i++) {
    let level = bits - 1u - i;
    let lower = (1u << level) - 1u;
    c.x ^= lower & bit_mask(c.x, level);
    let y = turn(c.x, c.y, level, lower);
    let z = turn(y.x, c.z, level, lower);
    c = vec3<u32>(z.x, y.y, z.y);
  }
  // The Gray code of the code, of which a bit is the parity of these from the top down to it.
  var code = morton_code(c.x, c.y, c.z, bits);
  for (var step = 1u; step < 32u; step *= 2u) {
    code ^= vec2<u32>((code.x >> step) | (code.y << (32u - step)), code.y >> step);
  }
  code.x ^= code.y;
  return code;
}

@compute @workgroup_size(256)
fn main(
  @builtin(workgroup_id) id: vec3<u32>,
  @builtin(num_workgroups) count: vec3<u32>,
  @builtin(local_invocation_index) thread: u32,
) {
  let row = (id.y * count.x + id.x) * 256u + thread;
  if (row >= p.rows) {
    return;
  }
  let depth = depths[scene_of(row)];
  var cell = vec3<u32>(u32(cells[row * 3u]), u32(cells[row * 3u + 1u]), u32(cells[row * 3u + 2u]));
//#if EXCHANGED
  cell = cell.yxz;
//#endif
//#if HILBERT
  let code = hilbert_code(cell, depth);
//#else
  let code = morton_code(cell.x, cell.y, cell.z, depth);
//#endif
  low[row] = code.x;
  high[row] = code.y;
}
