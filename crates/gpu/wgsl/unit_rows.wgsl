// Rows divided by their length; lengths below 1e-12 count as this, so that zeros stay zeros.
//
// Squares are those of values divided by the row's largest, so that none over- or underflows.

struct Params {
  rows: u32,
  channels: u32,
}

const THREADS: u32 = 64u;
const SHORTEST: f32 = 1e-12;

@group(0) @binding(0) var<uniform> p: Params;
@group(0) @binding(1) var<storage, read> x: array<stored>;
@group(0) @binding(2) var<storage, read_write> out: array<stored>;

var<workgroup> part: array<f32, THREADS>;

@compute @workgroup_size(THREADS)
fn main(
  @builtin(workgroup_id) id: vec3<u32>,
  @builtin(num_workgroups) count: vec3<u32>,
  @builtin(local_invocation_index) thread: u32,
) {
  let row = id.y * count.x + id.x;
  if (row >= p.rows) {
    return;
  }
  let base = row * p.channels;
  var most = 0.0;
  for (var c = thread; c < p.channels; c += THREADS) {
    most = max(most, abs(f32(x[base + c])));
  }
  part[thread] = most;
  workgroupBarrier();
  for (var half = THREADS / 2u; half > 0u; half /= 2u) {
    if (thread < half) {
      part[thread] = max(part[thread], part[thread + half]);
    }
    workgroupBarrier();
  }
  most = part[0];
  workgroupBarrier();
  let scale = select(most, 1.0, most == 0.0);
  var sum = 0.0;
  for (var c = thread; c < p.channels; c += THREADS) {
    let v = f32(x[base + c]) / scale;
    sum += v * v;
  }
  part[thread] = sum;
  workgroupBarrier();
  for (var half = THREADS / 2u; half > 0u; half /= 2u) {
    if (thread < half) {
      part[thread] += part[thread + half];
    }
    workgroupBarrier();
  }
  let length = sqrt(part[0]);
  // scale · length is the row's length, and may be above all numbers.
  let short = scale < SHORTEST && scale * length < SHORTEST;
  for (var c = thread; c < p.channels; c += THREADS) {
    let v = f32(x[base + c]);
    out[base + c] = stored(select(v / scale / length, v / SHORTEST, short || most == 0.0));
  }
}
