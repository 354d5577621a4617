// Scene of a row. The kernel has `offsets`, [scenes + 1], and `p.scenes`, at least 1.
fn scene_of(row: u32) -> u32 {
  var first = 0u;
  var end = p.scenes;
  while (end - first > 1u) {
    let middle = (first + end) / 2u;
    if (offsets[middle] <= row) {
      first = middle;
    } else {
      end = middle;
    }
  }
  return first;
}
