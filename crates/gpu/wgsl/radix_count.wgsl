// How often each digit stands in each workgroup's stretch of keys. counts: [256, workgroups]

const THREADS: u32 = 256u;
const BLOCK: u32 = THREADS * ROUNDS;

struct Params {
  len: u32,
  shift: u32,
  blocks: u32,
}

@group(0) @binding(0) var<uniform> p: Params;
@group(0) @binding(1) var<storage, read> keys: array<u32>;
@group(0) @binding(2) var<storage, read_write> counts: array<u32>;

// Sums of whole numbers are the same in any order.
var<workgroup> found: array<atomic<u32>, 256>;

@compute @workgroup_size(THREADS)
fn main(
  @builtin(workgroup_id) id: vec3<u32>,
  @builtin(num_workgroups) count: vec3<u32>,
  @builtin(local_invocation_index) thread: u32,
) {
  let group = id.y * count.x + id.x;
  if (group >= p.blocks) {
    return;
  }
  atomicStore(&found[thread], 0u);
  workgroupBarrier();
  for (var i = thread; i < BLOCK; i += THREADS) {
    let at = group * BLOCK + i;
    if (at < p.len) {
      atomicAdd(&found[(keys[at] >> p.shift) & 255u], 1u);
    }
  }
  workgroupBarrier();
  counts[thread * p.blocks + group] = atomicLoad(&found[thread]);
}
