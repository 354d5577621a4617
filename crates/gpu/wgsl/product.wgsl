// Rows times a matrix: linear layers, and submanifold convolutions as one product over all taps.
//
//   out[r] = ending( Σ_tap x[source(tap, r)] · weight[tap] + bias )
//
// A workgroup makes ROWS rows of COLUMNS columns. Sums run over taps, then over inputs, in that order, for every row alike.
// Flags: TAPS (a table of source rows for each tap), GATHER (a list of source rows), SCATTER (a list of result rows),
// BIAS, GELU, RESIDUAL (added behind GELU), RESIDUAL_ROWS (a list of the residual's rows).

const ROWS: u32 = 64u;
const DEPTH: u32 = 16u;
const NONE: u32 = 0xffffffffu;

struct Params {
  rows: u32,     // result rows made here
  first: u32,    // first source row of a plain product, or first entry of the lists
  at: u32,       // where the first result row goes
  inputs: u32,
  outputs: u32,
  columns: u32,  // of the packed weight, in fours
  taps: u32,
  base: u32,     // number in the list of source rows that means row 0
}

@group(0) @binding(0) var<uniform> p: Params;
@group(0) @binding(1) var<storage, read> x: array<stored>;
@group(0) @binding(2) var<storage, read> weight: array<vec4<stored>>;
@group(0) @binding(3) var<storage, read_write> out: array<stored>;
//#if BIAS
@group(0) @binding(4) var<storage, read> bias: array<f32>;
//#endif
//#if TAPS
@group(0) @binding(5) var<storage, read> sources: array<u32>;
//#endif
//#if GATHER
@group(0) @binding(5) var<storage, read> sources: array<u32>;
//#endif
//#if RESIDUAL
@group(0) @binding(6) var<storage, read> residual: array<stored>;
//#endif
//#if RESIDUAL_ROWS
@group(0) @binding(7) var<storage, read> residual_rows: array<u32>;
//#endif
//#if SCATTER
@group(0) @binding(8) var<storage, read> result_rows: array<u32>;
//#endif

var<workgroup> a: array<f32, DEPTH * ROWS>;
var<workgroup> b: array<vec4<f32>, DEPTH * COLUMNS / 4u>;
var<workgroup> source: array<u32, ROWS>;
var<workgroup> found: atomic<u32>;
var<workgroup> any_row: u32;

@compute @workgroup_size(THREADS)
fn main(
  @builtin(workgroup_id) id: vec3<u32>,
  @builtin(num_workgroups) count: vec3<u32>,
  @builtin(local_invocation_index) thread: u32,
) {
  let group = id.y * count.x + id.x;
  let across = (p.outputs + COLUMNS - 1u) / COLUMNS;
  let row0 = group / across * ROWS;
  let column0 = group % across * COLUMNS;
  if (row0 >= p.rows) {
    return;
  }
  // Eight rows and eight columns for each invocation.
  let tx = thread % (COLUMNS / 8u);
  let ty = thread / (COLUMNS / 8u);
  var sum: array<array<vec4<f32>, 2>, 8>;
  for (var i = 0u; i < 8u; i++) {
    sum[i][0] = vec4<f32>(0.0);
    sum[i][1] = vec4<f32>(0.0);
  }
  for (var tap = 0u; tap < p.taps; tap++) {
    if (thread == 0u) {
      atomicStore(&found, 0u);
    }
    workgroupBarrier();
    for (var i = thread; i < ROWS; i += THREADS) {
      let row = row0 + i;
      var from_row = NONE;
      if (row < p.rows) {
//#if TAPS
        from_row = sources[tap * p.rows + row];
//#endif
//#if GATHER
        from_row = sources[p.first + row] - p.base;
//#endif
//#if PLAIN
        from_row = p.first + row;
//#endif
      }
      source[i] = from_row;
      if (from_row != NONE) {
        atomicStore(&found, 1u);
      }
    }
    workgroupBarrier();
    if (thread == 0u) {
      any_row = atomicLoad(&found);
    }
    // What no row of the group has adds nothing.
    if (workgroupUniformLoad(&any_row) == 0u) {
      continue;
    }
    for (var k0 = 0u; k0 < p.inputs; k0 += DEPTH) {
      for (var i = thread; i < DEPTH * ROWS; i += THREADS) {
        let k = i % DEPTH;
        let r = i / DEPTH;
        var value = 0.0;
        if (source[r] != NONE && k0 + k < p.inputs) {
          value = f32(x[source[r] * p.inputs + k0 + k]);
        }
        a[k * ROWS + r] = value;
      }
      for (var i = thread; i < DEPTH * COLUMNS / 4u; i += THREADS) {
        let k = i / (COLUMNS / 4u);
        let c = column0 / 4u + i % (COLUMNS / 4u);
        var value = vec4<f32>(0.0);
        if (k0 + k < p.inputs && c < p.columns) {
          value = vec4<f32>(weight[(tap * p.inputs + k0 + k) * p.columns + c]);
        }
        b[i] = value;
      }
      workgroupBarrier();
      for (var k = 0u; k < DEPTH; k++) {
        let left = b[k * (COLUMNS / 4u) + tx * 2u];
        let right = b[k * (COLUMNS / 4u) + tx * 2u + 1u];
        for (var i = 0u; i < 8u; i++) {
          let value = a[k * ROWS + ty * 8u + i];
          sum[i][0] += value * left;
          sum[i][1] += value * right;
        }
      }
      workgroupBarrier();
    }
  }
  for (var i = 0u; i < 8u; i++) {
    let row = row0 + ty * 8u + i;
    if (row >= p.rows) {
      break;
    }
//#if SCATTER
    let to = result_rows[p.first + row];
//#else
    let to = p.at + row;
//#endif
    for (var j = 0u; j < 8u; j++) {
      let column = column0 + tx * 8u + j;
      if (column >= p.outputs) {
        break;
      }
      var value = sum[i][j / 4u][j % 4u];
//#if BIAS
      value += bias[column];
//#endif
//#if GELU
      value = gelu(value);
//#endif
//#if RESIDUAL
      var beside = to;
//#endif
//#if RESIDUAL_ROWS
      beside = residual_rows[to];
//#endif
//#if RESIDUAL
      value += f32(residual[beside * p.outputs + column]);
//#endif
      out[to * p.outputs + column] = stored(value);
    }
  }
}
