// Keys of cells: (x, y, z) with as many bits for y and z as given, or with FNV the hash by which the original system orders
// voxels.

struct Params {
  rows: u32,
  y_bits: u32,
  z_bits: u32,
}

@group(0) @binding(0) var<uniform> p: Params;
@group(0) @binding(1) var<storage, read> cells: array<i32>;
@group(0) @binding(2) var<storage, read_write> low: array<u32>;
@group(0) @binding(3) var<storage, read_write> high: array<u32>;

//#if FNV
// h · 1099511628211, which is h · 2⁴⁰ + h · 435.
fn times_prime(h: vec2<u32>) -> vec2<u32> {
  let first = (h.x & 0xffffu) * 435u;
  let second = (h.x >> 16u) * 435u;
  let sum = first + (second << 16u);
  let carry = select(0u, 1u, sum < first);
  return vec2<u32>(sum, (second >> 16u) + carry + h.y * 435u + (h.x << 8u));
}
//#else
// `value` above the lowest `by` bits of a key, by at most 42.
fn lifted(value: u32, by: u32) -> vec2<u32> {
  if (by == 0u) {
    return vec2<u32>(value, 0u);
  }
  if (by < 32u) {
    return vec2<u32>(value << by, value >> (32u - by));
  }
  return vec2<u32>(0u, value << (by - 32u));
}
//#endif

@compute @workgroup_size(256)
fn main(
  @builtin(workgroup_id) id: vec3<u32>,
  @builtin(num_workgroups) count: vec3<u32>,
  @builtin(local_invocation_index) thread: u32,
) {
  let at = (id.y * count.x + id.x) * 256u + thread;
  if (at >= p.rows) {
    return;
  }
  let cell = vec3<u32>(u32(cells[at * 3u]), u32(cells[at * 3u + 1u]), u32(cells[at * 3u + 2u]));
//#if FNV
  var key = vec2<u32>(0x84222325u, 0xcbf29ce4u);
  for (var axis = 0u; axis < 3u; axis++) {
    key = times_prime(key);
    key.x ^= cell[axis];
  }
//#else
  let key = lifted(cell.x, p.y_bits + p.z_bits) | lifted(cell.y, p.z_bits) | lifted(cell.z, 0u);
//#endif
  low[at] = key.x;
  high[at] = key.y;
}
