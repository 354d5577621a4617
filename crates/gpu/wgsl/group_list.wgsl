// Groups from the running sums of their beginnings. Flag OFFSETS: the first group of each scene, closed by the number of
// groups. Else: where each group begins, closed by the number of places; its first row; and the group of each row. ROWS: the
// row of each place, else its number.

struct Params {
  rows: u32,
  items: u32,
}

@group(0) @binding(0) var<uniform> p: Params;
@group(0) @binding(1) var<storage, read> before: array<u32>;
//#if OFFSETS
@group(0) @binding(2) var<storage, read> offsets: array<u32>;
@group(0) @binding(3) var<storage, read> total: array<u32>;
@group(0) @binding(4) var<storage, read_write> first_groups: array<u32>;
//#else
@group(0) @binding(2) var<storage, read> begins: array<u32>;
@group(0) @binding(3) var<storage, read_write> starts: array<u32>;
@group(0) @binding(4) var<storage, read_write> heads: array<u32>;
@group(0) @binding(5) var<storage, read_write> inverse: array<u32>;
//#endif
//#if ROWS
@group(0) @binding(6) var<storage, read> rows: array<u32>;
//#endif

@compute @workgroup_size(256)
fn main(
  @builtin(workgroup_id) id: vec3<u32>,
  @builtin(num_workgroups) count: vec3<u32>,
  @builtin(local_invocation_index) thread: u32,
) {
  let at = (id.y * count.x + id.x) * 256u + thread;
  if (at >= p.items) {
    return;
  }
//#if OFFSETS
  let first = offsets[at];
  if (first < p.rows) {
    first_groups[at] = before[first];
  } else {
    first_groups[at] = total[0];
  }
//#else
  var row = at;
  let group = before[at] + begins[at] - 1u;
//#endif
//#if ROWS
  row = rows[at];
//#endif
//#if LIST
  inverse[row] = group;
  if (begins[at] == 1u) {
    starts[group] = at;
    heads[group] = row;
  }
  if (at + 1u == p.rows) {
    starts[group + 1u] = p.rows;
  }
//#endif
}
