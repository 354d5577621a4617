// Bounds of coordinates, as ordered numbers: the complements of the smallest x, y, z, the largest, and whether one is not
// finite. All seven begin with 0 and rise, in any order.

const BLOCK: u32 = 2048u;

struct Params {
  rows: u32,
}

@group(0) @binding(0) var<uniform> p: Params;
@group(0) @binding(1) var<storage, read> coord: array<u32>;
@group(0) @binding(2) var<storage, read_write> bounds: array<atomic<u32>>;

var<workgroup> most: array<atomic<u32>, 7>;

@compute @workgroup_size(256)
fn main(
  @builtin(workgroup_id) id: vec3<u32>,
  @builtin(num_workgroups) count: vec3<u32>,
  @builtin(local_invocation_index) thread: u32,
) {
  let start = (id.y * count.x + id.x) * BLOCK;
  if (start >= p.rows) {
    return;
  }
  if (thread < 7u) {
    atomicStore(&most[thread], 0u);
  }
  workgroupBarrier();
  var low = vec3<u32>(0u);
  var high = vec3<u32>(0u);
  var not_finite = 0u;
  for (var row = start + thread; row < min(start + BLOCK, p.rows); row += 256u) {
    for (var axis = 0u; axis < 3u; axis++) {
      let bits = coord[row * 3u + axis];
      if ((bits & 0x7f800000u) == 0x7f800000u) {
        not_finite = 1u;
      }
      let value = ordered(bits);
      low[axis] = max(low[axis], ~value);
      high[axis] = max(high[axis], value);
    }
  }
  for (var axis = 0u; axis < 3u; axis++) {
    atomicMax(&most[axis], low[axis]);
    atomicMax(&most[3u + axis], high[axis]);
  }
  atomicMax(&most[6], not_finite);
  workgroupBarrier();
  if (thread < 7u) {
    atomicMax(&bounds[thread], atomicLoad(&most[thread]));
  }
}
