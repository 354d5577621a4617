// Hash of a cell and its scene. Cells near each other never share the sum; far ones rarely.
fn cell_hash(x: u32, y: u32, z: u32, scene: u32) -> u32 {
  var h = x * 0x9e3779b1u + y * 0x85ebca6bu + z * 0xc2b2ae35u + scene * 0x27d4eb2fu;
  h = (h ^ (h >> 16u)) * 0x7feb352du;
  h = (h ^ (h >> 15u)) * 0x846ca68bu;
  return h ^ (h >> 16u);
}
