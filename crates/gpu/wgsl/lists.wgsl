// Lists of numbers. Flags: COUNT (0, 1, 2, …), INVERT (out[list[i]] = i), COMPOSE (out[i] = values[list[i]]).

struct Params {
  len: u32,
}

@group(0) @binding(0) var<uniform> p: Params;
@group(0) @binding(1) var<storage, read_write> out: array<u32>;
//#if INVERT
@group(0) @binding(2) var<storage, read> list: array<u32>;
//#endif
//#if COMPOSE
@group(0) @binding(2) var<storage, read> list: array<u32>;
@group(0) @binding(3) var<storage, read> values: array<u32>;
//#endif

@compute @workgroup_size(256)
fn main(
  @builtin(workgroup_id) id: vec3<u32>,
  @builtin(num_workgroups) count: vec3<u32>,
  @builtin(local_invocation_index) thread: u32,
) {
  let at = (id.y * count.x + id.x) * 256u + thread;
  if (at >= p.len) {
    return;
  }
//#if COUNT
  out[at] = at;
//#endif
//#if INVERT
  out[list[at]] = at;
//#endif
//#if COMPOSE
  out[at] = values[list[at]];
//#endif
}
