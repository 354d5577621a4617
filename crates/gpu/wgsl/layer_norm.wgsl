// (x - mean) / sqrt(variance + epsilon) · weight + bias over the channels of each row; then GELU or a residual.
//
// LANES invocations share a row. Rows too large for f32 squares are made smaller first, so that they get what the CPU
// computes in f64. A row with NaN or an infinity is NaN.
// Flags: GELU, RESIDUAL (added at the end).

struct Params {
  rows: u32,
  channels: u32,
  epsilon: f32,
}

const THREADS: u32 = 64u;
const LARGE: f32 = 1e15;
// Brings any row above that to values whose squares are numbers.
const SMALLER: f32 = 1e-25;
const LEAST: f32 = 1.2e-38;

@group(0) @binding(0) var<uniform> p: Params;
@group(0) @binding(1) var<storage, read> x: array<stored>;
@group(0) @binding(2) var<storage, read> weight: array<f32>;
@group(0) @binding(3) var<storage, read> bias: array<f32>;
@group(0) @binding(4) var<storage, read_write> out: array<stored>;
//#if RESIDUAL
@group(0) @binding(5) var<storage, read> residual: array<stored>;
//#endif

var<workgroup> part: array<f32, THREADS>;

fn total(thread: u32, value: f32) -> f32 {
  part[thread] = value;
  workgroupBarrier();
  for (var half = LANES / 2u; half > 0u; half /= 2u) {
    if (thread % LANES < half) {
      part[thread] += part[thread + half];
    }
    workgroupBarrier();
  }
  let sum = part[thread / LANES * LANES];
  workgroupBarrier();
  return sum;
}

fn largest(thread: u32, value: f32) -> f32 {
  part[thread] = value;
  workgroupBarrier();
  for (var half = LANES / 2u; half > 0u; half /= 2u) {
    if (thread % LANES < half) {
      part[thread] = max(part[thread], part[thread + half]);
    }
    workgroupBarrier();
  }
  let most = part[thread / LANES * LANES];
  workgroupBarrier();
  return most;
}

@compute @workgroup_size(THREADS)
fn main(
  @builtin(workgroup_id) id: vec3<u32>,
  @builtin(num_workgroups) count: vec3<u32>,
  @builtin(local_invocation_index) thread: u32,
) {
  let group = id.y * count.x + id.x;
  let row = group * (THREADS / LANES) + thread / LANES;
  let lane = thread % LANES;
  let here = row < p.rows;
  let base = row * p.channels;
  var most = 0.0;
  if (here) {
    for (var c = lane; c < p.channels; c += LANES) {
      most = max(most, abs(f32(x[base + c])));
    }
  }
  most = largest(thread, most);
  let scale = select(1.0, SMALLER, most > LARGE);
  let number = f32(p.channels);
  var sum = 0.0;
  if (here) {
    for (var c = lane; c < p.channels; c += LANES) {
      sum += f32(x[base + c]) * scale;
    }
  }
  let mean = total(thread, sum) / number;
  sum = 0.0;
  if (here) {
    for (var c = lane; c < p.channels; c += LANES) {
      let away = f32(x[base + c]) * scale - mean;
      sum += away * away;
    }
  }
  let variance = total(thread, sum) / number;
  let spread = variance + p.epsilon * scale * scale;
  // Not `max`, which may lose NaN.
  let inverse = 1.0 / sqrt(select(spread, LEAST, spread < LEAST));
  if (here) {
    for (var c = lane; c < p.channels; c += LANES) {
      var value = (f32(x[base + c]) * scale - mean) * inverse * weight[c] + bias[c];
//#if GELU
      value = gelu(value);
//#endif
//#if RESIDUAL
      value += f32(residual[base + c]);
//#endif
      out[base + c] = stored(value);
    }
  }
}
