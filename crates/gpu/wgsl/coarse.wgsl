// Cells of chosen rows without the last `shift` bits of their scene, or with CODES their codes without 3·shift bits.

struct Params {
  rows: u32,
  scenes: u32,
}

@group(0) @binding(0) var<uniform> p: Params;
@group(0) @binding(1) var<storage, read> offsets: array<u32>;
@group(0) @binding(2) var<storage, read> shifts: array<u32>;
@group(0) @binding(3) var<storage, read> list: array<u32>;
//#if CODES
@group(0) @binding(4) var<storage, read> low: array<u32>;
@group(0) @binding(5) var<storage, read> high: array<u32>;
@group(0) @binding(6) var<storage, read_write> to_low: array<u32>;
@group(0) @binding(7) var<storage, read_write> to_high: array<u32>;
//#else
@group(0) @binding(4) var<storage, read> cells: array<i32>;
@group(0) @binding(5) var<storage, read_write> to_cells: array<i32>;
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
  let row = list[at];
  let shift = shifts[scene_of(row)];
//#if CODES
  let code = shift_code(vec2<u32>(low[row], high[row]), 3u * shift);
  to_low[at] = code.x;
  to_high[at] = code.y;
//#else
  for (var axis = 0u; axis < 3u; axis++) {
    to_cells[at * 3u + axis] = cells[row * 3u + axis] >> shift;
  }
//#endif
}
