// Whether a new group begins at each place. A scene begins with a new group, too.
// Flags: CODES (places of an order; codes without 3·shift bits), CELLS (rows; cells without `shift` bits), else sorted keys.

struct Params {
  rows: u32,
  scenes: u32,
}

@group(0) @binding(0) var<uniform> p: Params;
@group(0) @binding(1) var<storage, read> offsets: array<u32>;
@group(0) @binding(2) var<storage, read_write> begins: array<u32>;
//#if CELLS
@group(0) @binding(3) var<storage, read> shifts: array<u32>;
@group(0) @binding(4) var<storage, read> cells: array<i32>;
//#else
@group(0) @binding(4) var<storage, read> low: array<u32>;
@group(0) @binding(5) var<storage, read> high: array<u32>;
//#endif
//#if CODES
@group(0) @binding(3) var<storage, read> shifts: array<u32>;
@group(0) @binding(6) var<storage, read> order: array<u32>;
//#endif

//#if CELLS
// What rows of a group have in common.
fn shared_part(place: u32, scene: u32) -> vec3<u32> {
  let shift = shifts[scene];
  let at = place * 3u;
  return vec3<u32>(u32(cells[at]) >> shift, u32(cells[at + 1u]) >> shift, u32(cells[at + 2u]) >> shift);
}
//#else
fn shared_part(place: u32, scene: u32) -> vec2<u32> {
  return of_place(place, scene);
}
//#endif
//#if CODES
fn of_place(place: u32, scene: u32) -> vec2<u32> {
  let row = order[place];
  return shift_code(vec2<u32>(low[row], high[row]), 3u * shifts[scene]);
}
//#endif
//#if KEYS
fn of_place(place: u32, scene: u32) -> vec2<u32> {
  return vec2<u32>(low[place], high[place]);
}
//#endif

@compute @workgroup_size(256)
fn main(
  @builtin(workgroup_id) id: vec3<u32>,
  @builtin(num_workgroups) count: vec3<u32>,
  @builtin(local_invocation_index) thread: u32,
) {
  let place = (id.y * count.x + id.x) * 256u + thread;
  if (place >= p.rows) {
    return;
  }
  let scene = scene_of(place);
  var begin = 1u;
  if (place > offsets[scene] && all(shared_part(place - 1u, scene) == shared_part(place, scene))) {
    begin = 0u;
  }
  begins[place] = begin;
}
