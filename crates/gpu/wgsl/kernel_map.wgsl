// Source row of each tap and row of a range, or NONE: [taps, range]. A tap leads from a row's cell to a cell beside it; the
// center leads to the row itself.

const NONE: u32 = 0xffffffffu;

struct Params {
  rows: u32,    // of the range
  scenes: u32,
  last: u32,    // slots − 1, ones only
  first: u32,   // row of the range
}

@group(0) @binding(0) var<uniform> p: Params;
@group(0) @binding(1) var<storage, read> offsets: array<u32>;
@group(0) @binding(2) var<storage, read> cells: array<i32>;
@group(0) @binding(3) var<storage, read> slots: array<u32>;
@group(0) @binding(4) var<storage, read_write> sources: array<u32>;

fn cell(row: u32) -> vec3<i32> {
  return vec3<i32>(cells[row * 3u], cells[row * 3u + 1u], cells[row * 3u + 2u]);
}

// The row that stands for a cell of a scene.
fn find(wanted: vec3<i32>, scene: u32) -> u32 {
  let first = offsets[scene];
  let end = offsets[scene + 1u];
  var slot = cell_hash(u32(wanted.x), u32(wanted.y), u32(wanted.z), scene) & p.last;
  loop {
    let entry = slots[slot];
    if (entry == 0u) {
      return NONE;
    }
    let row = entry - 1u;
    if (row >= first && row < end && all(cell(row) == wanted)) {
      return row;
    }
    slot = (slot + 1u) & p.last;
  }
  return NONE;
}

@compute @workgroup_size(256)
fn main(
  @builtin(workgroup_id) id: vec3<u32>,
  @builtin(num_workgroups) count: vec3<u32>,
  @builtin(local_invocation_index) thread: u32,
) {
  let at = (id.y * count.x + id.x) * 256u + thread;
  let tap = at / p.rows;
  if (tap >= SIZE * SIZE * SIZE) {
    return;
  }
  let row = p.first + at % p.rows;
  let step = vec3<i32>(vec3<u32>(tap / (SIZE * SIZE), tap / SIZE % SIZE, tap % SIZE));
  let away = step - vec3<i32>(i32(SIZE / 2u));
  if (all(away == vec3<i32>(0))) {
    sources[at] = row;
  } else {
    // Cells beyond the ends of an axis are in no slot.
    sources[at] = find(cell(row) + away, scene_of(row));
  }
}
