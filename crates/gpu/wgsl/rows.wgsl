// Copies of rows by a list: out[r] = x[list[r]], or, with ADD, x[r] + y[list[r]].

struct Params {
  rows: u32,
  channels: u32,
}

@group(0) @binding(0) var<uniform> p: Params;
@group(0) @binding(1) var<storage, read> x: array<stored>;
@group(0) @binding(2) var<storage, read> list: array<u32>;
@group(0) @binding(3) var<storage, read_write> out: array<stored>;
//#if ADD
@group(0) @binding(4) var<storage, read> y: array<stored>;
//#endif

@compute @workgroup_size(256)
fn main(
  @builtin(workgroup_id) id: vec3<u32>,
  @builtin(num_workgroups) count: vec3<u32>,
  @builtin(local_invocation_index) thread: u32,
) {
  let at = (id.y * count.x + id.x) * 256u + thread;
  let row = at / p.channels;
  if (row >= p.rows) {
    return;
  }
  let source = list[row] * p.channels + at % p.channels;
//#if ADD
  out[at] = x[at] + y[source];
//#else
  out[at] = x[source];
//#endif
}
