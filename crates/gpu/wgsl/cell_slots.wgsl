// Puts every row into a table of slots, at most half of them taken; where rows share a cell, the first stands for it.
// slots: row + 1, or 0. Which slot a cell gets hangs on the order of invocations; which row is found for it does not.

struct Params {
  rows: u32,
  scenes: u32,
  last: u32,  // slots − 1, ones only
}

@group(0) @binding(0) var<uniform> p: Params;
@group(0) @binding(1) var<storage, read> offsets: array<u32>;
@group(0) @binding(2) var<storage, read> cells: array<i32>;
@group(0) @binding(3) var<storage, read_write> slots: array<atomic<u32>>;

fn cell(row: u32) -> vec3<i32> {
  return vec3<i32>(cells[row * 3u], cells[row * 3u + 1u], cells[row * 3u + 2u]);
}

@compute @workgroup_size(256)
fn main(
  @builtin(workgroup_id) id: vec3<u32>,
  @builtin(num_workgroups) count: vec3<u32>,
  @builtin(local_invocation_index) thread: u32,
) {
  let at = (id.y * count.x + id.x) * 256u + thread;
  if (at >= p.rows) {
    return;
  }
  // The last row first: where invocations run one after the other, a later one takes the place of the first that came, so
  // that tests see whether it does.
  let row = p.rows - 1u - at;
  let scene = scene_of(row);
  let first = offsets[scene];
  let end = offsets[scene + 1u];
  let own = cell(row);
  var slot = cell_hash(u32(own.x), u32(own.y), u32(own.z), scene) & p.last;
  loop {
    let found = atomicCompareExchangeWeak(&slots[slot], 0u, row + 1u);
    if (found.exchanged) {
      return;
    }
    if (found.old_value == 0u) {
      // Failed for no reason, as it may.
      continue;
    }
    let other = found.old_value - 1u;
    if (other >= first && other < end && all(cell(other) == own)) {
      atomicMin(&slots[slot], row + 1u);
      return;
    }
    slot = (slot + 1u) & p.last;
  }
}
