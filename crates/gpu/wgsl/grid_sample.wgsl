// Cell of each point: on each axis, the number of bounds that its coordinate has reached.

struct Params {
  rows: u32,
  x_end: u32,  // bounds of x are 0..x_end, those of y and z follow
  y_end: u32,
  z_end: u32,
}

@group(0) @binding(0) var<uniform> p: Params;
@group(0) @binding(1) var<storage, read> coord: array<u32>;
// The smallest coordinate of each cell but the first, as ordered numbers.
@group(0) @binding(2) var<storage, read> bounds: array<u32>;
@group(0) @binding(3) var<storage, read_write> cells: array<i32>;

// Bounds of begin..end that are not above a number.
fn reached(value: u32, begin: u32, end: u32) -> i32 {
  var low = begin;
  var high = end;
  while (low < high) {
    let middle = (low + high) / 2u;
    if (bounds[middle] <= value) {
      low = middle + 1u;
    } else {
      high = middle;
    }
  }
  return i32(low - begin);
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
  let at = row * 3u;
  cells[at] = reached(ordered(coord[at]), 0u, p.x_end);
  cells[at + 1u] = reached(ordered(coord[at + 1u]), p.x_end, p.y_end);
  cells[at + 2u] = reached(ordered(coord[at + 2u]), p.y_end, p.z_end);
}
