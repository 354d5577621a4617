// One pass of a stable sort: moves keys and what goes with them to the places of a digit of eight bits.
//
// `starts` says where each workgroup's entries of a digit go. A workgroup takes its stretch in rounds of one entry for each
// thread. In a round, each thread sets its bit in the set of threads with its digit: sets are the same in whatever order bits
// are set, and an entry's place among its like is the number of lower bits.
// Flags: WIDE (the high words go along), HIGH (the digit is theirs), ROWS (numbers go along, else an entry's place does).

const THREADS: u32 = 256u;
const BLOCK: u32 = THREADS * ROUNDS;
const WORDS: u32 = THREADS / 32u;

struct Params {
  len: u32,
  shift: u32,
  blocks: u32,
}

@group(0) @binding(0) var<uniform> p: Params;
@group(0) @binding(1) var<storage, read> low: array<u32>;
@group(0) @binding(2) var<storage, read> starts: array<u32>;
@group(0) @binding(3) var<storage, read_write> to_low: array<u32>;
@group(0) @binding(4) var<storage, read_write> to_rows: array<u32>;
//#if WIDE
@group(0) @binding(5) var<storage, read> high: array<u32>;
@group(0) @binding(6) var<storage, read_write> to_high: array<u32>;
//#endif
//#if ROWS
@group(0) @binding(7) var<storage, read> rows: array<u32>;
//#endif

// Where the next entry of each digit goes.
var<workgroup> next: array<u32, 256>;
// Threads of the round with each digit, 32 in a word: [WORDS, 256].
var<workgroup> like: array<atomic<u32>, WORDS * 256u>;

@compute @workgroup_size(THREADS)
fn main(
  @builtin(workgroup_id) id: vec3<u32>,
  @builtin(num_workgroups) count: vec3<u32>,
  @builtin(local_invocation_index) thread: u32,
) {
  let group = id.y * count.x + id.x;
  if (group >= p.blocks) {
    return;
  }
  next[thread] = starts[thread * p.blocks + group];
  for (var w = 0u; w < WORDS; w++) {
    atomicStore(&like[w * 256u + thread], 0u);
  }
  let word = thread / 32u;
  let bit = 1u << (thread % 32u);
  for (var round = 0u; round < ROUNDS; round++) {
    let first = group * BLOCK + round * THREADS;
    if (first >= p.len) {
      break;
    }
    workgroupBarrier();
    let at = first + thread;
    var low_word = 0u;
    var high_word = 0u;
    var digit = 0u;
    if (at < p.len) {
      low_word = low[at];
//#if WIDE
      high_word = high[at];
//#endif
//#if HIGH
      digit = (high_word >> p.shift) & 255u;
//#else
      digit = (low_word >> p.shift) & 255u;
//#endif
      atomicOr(&like[word * 256u + digit], bit);
    }
    workgroupBarrier();
    if (at < p.len) {
      var place = next[digit];
      for (var w = 0u; w < word; w++) {
        place += countOneBits(atomicLoad(&like[w * 256u + digit]));
      }
      place += countOneBits(atomicLoad(&like[word * 256u + digit]) & (bit - 1u));
      to_low[place] = low_word;
//#if WIDE
      to_high[place] = high_word;
//#endif
//#if ROWS
      to_rows[place] = rows[at];
//#else
      to_rows[place] = at;
//#endif
    }
    workgroupBarrier();
    // Now a thread for each digit.
    var more = 0u;
    for (var w = 0u; w < WORDS; w++) {
      more += countOneBits(atomicLoad(&like[w * 256u + thread]));
      atomicStore(&like[w * 256u + thread], 0u);
    }
    next[thread] += more;
  }
}
