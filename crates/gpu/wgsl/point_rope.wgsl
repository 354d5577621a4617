// Turns queries and keys by the angles of their voxels, in place; values stay.
//
// A head is [u_x v_x u_y v_y u_z v_z], each THIRD long. `pairs` has cosine and sine of each pair, axis after axis, for
// every row; `list` says which row stands in each slot.
// Constants: DIM (channels of a head), THIRD (DIM / 6).

struct Params {
  slots: u32,
  heads: u32,
  first: u32,  // entry of the list that belongs to slot 0
}

@group(0) @binding(0) var<uniform> p: Params;
@group(0) @binding(1) var<storage, read_write> qkv: array<stored>;
@group(0) @binding(2) var<storage, read> pairs: array<vec2<f32>>;
@group(0) @binding(3) var<storage, read> list: array<u32>;

@compute @workgroup_size(256)
fn main(
  @builtin(workgroup_id) id: vec3<u32>,
  @builtin(num_workgroups) count: vec3<u32>,
  @builtin(local_invocation_index) thread: u32,
) {
  // One pair of channels of a query or key.
  let at = (id.y * count.x + id.x) * 256u + thread;
  let pair = at % (DIM / 2u);
  let head = at / (DIM / 2u) % (2u * p.heads);
  let slot = at / (DIM / 2u) / (2u * p.heads);
  if (slot >= p.slots) {
    return;
  }
  let turn = pairs[list[p.first + slot] * (DIM / 2u) + pair];
  let u_at = slot * 3u * p.heads * DIM + head * DIM + pair / THIRD * 2u * THIRD + pair % THIRD;
  let u = f32(qkv[u_at]);
  let v = f32(qkv[u_at + THIRD]);
  qkv[u_at] = stored(u * turn.x - v * turn.y);
  qkv[u_at + THIRD] = stored(v * turn.x + u * turn.y);
}
