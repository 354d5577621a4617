// One row for each group of rows: their sum, mean or largest value (NaN counts as larger than anything); then a factor and
// summand, and GELU. Members are taken in the order of the list.
// Flags: MEAN, MAX (else the sum), AFFINE, GELU.

struct Params {
  groups: u32,
  channels: u32,
}

@group(0) @binding(0) var<uniform> p: Params;
@group(0) @binding(1) var<storage, read> x: array<stored>;
@group(0) @binding(2) var<storage, read> rows: array<u32>;
@group(0) @binding(3) var<storage, read> starts: array<u32>;
@group(0) @binding(4) var<storage, read_write> out: array<stored>;
//#if AFFINE
@group(0) @binding(5) var<storage, read> factor: array<f32>;
@group(0) @binding(6) var<storage, read> summand: array<f32>;
//#endif

// By its bits: a compiler may take comparisons of NaN for what numbers give.
fn is_nan(v: f32) -> bool {
  return (bitcast<u32>(v) & 0x7fffffffu) > 0x7f800000u;
}

@compute @workgroup_size(256)
fn main(
  @builtin(workgroup_id) id: vec3<u32>,
  @builtin(num_workgroups) count: vec3<u32>,
  @builtin(local_invocation_index) thread: u32,
) {
  let at = (id.y * count.x + id.x) * 256u + thread;
  let group = at / p.channels;
  let channel = at % p.channels;
  if (group >= p.groups) {
    return;
  }
  let first = starts[group];
  let end = starts[group + 1u];
  var value = 0.0;
  for (var i = first; i < end; i++) {
    let v = f32(x[rows[i] * p.channels + channel]);
    if (i == first) {
      value = v;
    } else {
//#if MAX
      if (v > value || (is_nan(v) && !is_nan(value))) {
        value = v;
      }
//#else
      value += v;
//#endif
    }
  }
//#if MEAN
  value /= f32(max(end - first, 1u));
//#endif
//#if AFFINE
  value = value * factor[channel] + summand[channel];
//#endif
//#if GELU
  value = gelu(value);
//#endif
  out[at] = stored(value);
}
