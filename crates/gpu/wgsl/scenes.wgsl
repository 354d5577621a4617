// Flag LARGEST: the largest coordinate of each scene, where a negative one counts as larger than any other.
// Else: the scene of each row of a list.

struct Params {
  rows: u32,
  scenes: u32,
}

@group(0) @binding(0) var<uniform> p: Params;
@group(0) @binding(1) var<storage, read> offsets: array<u32>;
//#if LARGEST
@group(0) @binding(2) var<storage, read> cells: array<i32>;
@group(0) @binding(3) var<storage, read_write> largest: array<atomic<u32>>;

// Of the rows in the scene of the workgroup's first row. The largest is the same in any order.
var<workgroup> most: atomic<u32>;
//#else
@group(0) @binding(2) var<storage, read> list: array<u32>;
@group(0) @binding(3) var<storage, read_write> out: array<u32>;
//#endif

@compute @workgroup_size(256)
fn main(
  @builtin(workgroup_id) id: vec3<u32>,
  @builtin(num_workgroups) count: vec3<u32>,
  @builtin(local_invocation_index) thread: u32,
) {
//#if LARGEST
  let start = (id.y * count.x + id.x) * 2048u;
  if (start >= p.rows) {
    return;
  }
  if (thread == 0u) {
    atomicStore(&most, 0u);
  }
  workgroupBarrier();
  let here = scene_of(start);
  var own = 0u;
  for (var row = start + thread; row < min(start + 2048u, p.rows); row += 256u) {
    let scene = scene_of(row);
    let x = u32(cells[row * 3u]);
    let y = u32(cells[row * 3u + 1u]);
    let z = u32(cells[row * 3u + 2u]);
    let value = max(x, max(y, z));
    if (scene == here) {
      own = max(own, value);
    } else {
      atomicMax(&largest[scene], value);
    }
  }
  atomicMax(&most, own);
  workgroupBarrier();
  if (thread == 0u) {
    atomicMax(&largest[here], atomicLoad(&most));
  }
//#else
  let at = (id.y * count.x + id.x) * 256u + thread;
  if (at < p.rows) {
    out[at] = scene_of(list[at]);
  }
//#endif
}
