// Multi-head attention inside patches whose slots follow each other: softmax(q·k / sqrt(D)) · v.
//
// A workgroup answers QUERIES slots of one head and patch, each invocation one of them; keys and values pass through
// workgroup memory KEYS at a time. The softmax is kept up as keys come (largest score, sum, weighted values), in the order
// of the slots.
//
// Constants: DIM (channels of a head), FOURS (DIM in fours, rounded up), KEYS.

const QUERIES: u32 = 64u;

struct Params {
  heads: u32,
  items: u32,
  scale: f32,
}

struct Item {
  start: u32,  // first slot of the patch
  len: u32,    // its slots
  query: u32,  // first slot of the patch that this group answers
  own: u32,    // leading slots of the patch that count
}

@group(0) @binding(0) var<uniform> p: Params;
@group(0) @binding(1) var<storage, read> qkv: array<stored>;
@group(0) @binding(2) var<storage, read> items: array<Item>;
@group(0) @binding(3) var<storage, read_write> out: array<stored>;

var<workgroup> keys: array<vec4<f32>, KEYS * FOURS>;
var<workgroup> values: array<vec4<f32>, KEYS * FOURS>;

fn four(at: u32, first: u32) -> vec4<f32> {
  var v = vec4<f32>(0.0);
  for (var j = 0u; j < 4u; j++) {
    if (first + j < DIM) {
      v[j] = f32(qkv[at + first + j]);
    }
  }
  return v;
}

@compute @workgroup_size(QUERIES)
fn main(
  @builtin(workgroup_id) id: vec3<u32>,
  @builtin(num_workgroups) count: vec3<u32>,
  @builtin(local_invocation_index) thread: u32,
) {
  let group = id.y * count.x + id.x;
  if (group >= p.items * p.heads) {
    return;
  }
  let item = items[group / p.heads];
  let head = group % p.heads;
  let channels = p.heads * DIM;
  let query = item.query + thread;
  let answers = query < item.own;
  var q: array<vec4<f32>, FOURS>;
  var sum: array<vec4<f32>, FOURS>;
  for (var i = 0u; i < FOURS; i++) {
    q[i] = vec4<f32>(0.0);
    sum[i] = vec4<f32>(0.0);
    if (answers) {
      q[i] = four((item.start + query) * 3u * channels + head * DIM, 4u * i) * p.scale;
    }
  }
  var most = -3.4e38;
  var weights = 0.0;
  // The same for all invocations: their patch is.
  for (var first = 0u; first < item.len; first += KEYS) {
    for (var i = thread; i < KEYS * FOURS; i += QUERIES) {
      let key = first + i / FOURS;
      if (key < item.len) {
        let at = (item.start + key) * 3u * channels + channels + head * DIM;
        keys[i] = four(at, i % FOURS * 4u);
        values[i] = four(at + channels, i % FOURS * 4u);
      }
    }
    workgroupBarrier();
    if (answers) {
      let there = min(KEYS, item.len - first);
      for (var key = 0u; key < there; key++) {
        var score = 0.0;
        for (var i = 0u; i < FOURS; i++) {
          score += dot(q[i], keys[key * FOURS + i]);
        }
        if (score > most) {
          let shrink = exp(most - score);
          weights *= shrink;
          for (var i = 0u; i < FOURS; i++) {
            sum[i] *= shrink;
          }
          most = score;
        }
        let weight = exp(score - most);
        weights += weight;
        for (var i = 0u; i < FOURS; i++) {
          sum[i] += weight * values[key * FOURS + i];
        }
      }
    }
    workgroupBarrier();
  }
  if (answers) {
    let at = (item.start + query) * channels + head * DIM;
    for (var i = 0u; i < FOURS; i++) {
      let value = sum[i] / weights;
      for (var j = 0u; j < 4u; j++) {
        if (4u * i + j < DIM) {
          out[at + 4u * i + j] = stored(value[j]);
        }
      }
    }
  }
}
