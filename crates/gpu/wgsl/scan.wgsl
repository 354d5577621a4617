// Running sums of whole numbers. A workgroup sums BLOCK values; what comes before each workgroup is summed the same way and
// added afterwards (flag ADD).

const THREADS: u32 = 256u;
const EACH: u32 = 8u;
const BLOCK: u32 = THREADS * EACH;

struct Params {
  len: u32,
}

@group(0) @binding(0) var<uniform> p: Params;
//#if ADD
@group(0) @binding(1) var<storage, read> before: array<u32>;
@group(0) @binding(2) var<storage, read_write> sums: array<u32>;

@compute @workgroup_size(THREADS)
fn main(
  @builtin(workgroup_id) id: vec3<u32>,
  @builtin(num_workgroups) count: vec3<u32>,
  @builtin(local_invocation_index) thread: u32,
) {
  let group = id.y * count.x + id.x;
  if (group >= (p.len + BLOCK - 1u) / BLOCK) {
    return;
  }
  let more = before[group];
  for (var i = thread; i < BLOCK; i += THREADS) {
    let at = group * BLOCK + i;
    if (at < p.len) {
      sums[at] += more;
    }
  }
}
//#else
@group(0) @binding(1) var<storage, read> values: array<u32>;
@group(0) @binding(2) var<storage, read_write> sums: array<u32>;
@group(0) @binding(3) var<storage, read_write> totals: array<u32>;

var<workgroup> tile: array<u32, BLOCK>;
var<workgroup> of_thread: array<u32, THREADS>;

@compute @workgroup_size(THREADS)
fn main(
  @builtin(workgroup_id) id: vec3<u32>,
  @builtin(num_workgroups) count: vec3<u32>,
  @builtin(local_invocation_index) thread: u32,
) {
  let group = id.y * count.x + id.x;
  if (group >= (p.len + BLOCK - 1u) / BLOCK) {
    return;
  }
  for (var i = thread; i < BLOCK; i += THREADS) {
    let at = group * BLOCK + i;
    var value = 0u;
    if (at < p.len) {
      value = values[at];
    }
    tile[i] = value;
  }
  workgroupBarrier();
  var own = 0u;
  for (var i = 0u; i < EACH; i++) {
    own += tile[thread * EACH + i];
  }
  of_thread[thread] = own;
  workgroupBarrier();
  for (var step = 1u; step < THREADS; step *= 2u) {
    var less = 0u;
    if (thread >= step) {
      less = of_thread[thread - step];
    }
    workgroupBarrier();
    of_thread[thread] += less;
    workgroupBarrier();
  }
  var sum = of_thread[thread] - own;
  for (var i = 0u; i < EACH; i++) {
    let value = tile[thread * EACH + i];
    tile[thread * EACH + i] = sum;
    sum += value;
  }
  if (thread == THREADS - 1u) {
    totals[group] = sum;
  }
  workgroupBarrier();
  for (var i = thread; i < BLOCK; i += THREADS) {
    let at = group * BLOCK + i;
    if (at < p.len) {
      sums[at] = tile[i];
    }
  }
}
//#endif
