// Stable sorting of 64-bit codes with their rows, a digit of eight bits at a time:
// `crates/kernels/src/serialization/radix_sort.rs`.
//
// A block counts the digits of its stretch; running sums over digits, and over the blocks of a digit, say where
// each block's entries of a digit go; then the block moves them in their order. Counts are whole numbers, so that
// atomic additions give one result.

#define SORT_THREADS 256
#define SORT_WARPS (SORT_THREADS / WARP)
#define DIGITS 256
/// Entries of a block: as many rounds of one for each thread.
#define SORT_ROUNDS 16

DEVICE u32 digit_of(u64 code, u32 shift) { return (u32)(code >> shift) & (DIGITS - 1); }

/// Counts of a block's digits. `counts`: `[256, blocks]`
KERNEL(256) sort_count(In<u64> codes, Out<u32> counts, u32 n, u32 shift) {
    SHARED(u32, count, DIGITS);
    u32 t = thread_index();
    count[t] = 0;
    BARRIER();
    u64 first = (u64)block_index() * SORT_THREADS * SORT_ROUNDS;
    for (u32 round = 0; round < SORT_ROUNDS; round++) {
        u64 i = first + round * SORT_THREADS + t;
        if (i < n) add_atomically(count[digit_of(codes[i], shift)], 1u);
    }
    BARRIER();
    counts[(u64)t * grid_blocks() + block_index()] = count[t];
}
ENTRY(sort_count)

/// Moves entries to their places. `starts`: `[256, blocks]`, running sums of the counts.
KERNEL(256) sort_move(In<u64> codes, In<u32> rows, In<u32> starts, Out<u64> to_codes, Out<u32> to_rows, u32 n,
                      u32 shift) {
    SHARED(u32, next, DIGITS);
    SHARED(u32, of_warp, SORT_WARPS* DIGITS);
    u32 t = thread_index(), warp = warp_index();
    next[t] = starts[(u64)t * grid_blocks() + block_index()];
    u64 first = (u64)block_index() * SORT_THREADS * SORT_ROUNDS;
    for (u32 round = 0; round < SORT_ROUNDS; round++) {
        u64 i = first + round * SORT_THREADS + t;
        bool there = i < n;
        u64 code = there ? codes[i] : 0;
        u32 digit = digit_of(code, shift);
        for (u32 w = 0; w < SORT_WARPS; w++) of_warp[w * DIGITS + t] = 0;
        BARRIER();
        // Lanes of the warp with the same digit.
        u32 same = warp_votes(there);
        UNROLL
        for (u32 bit = 0; bit < 8; bit++) {
            bool set = (digit >> bit & 1u) != 0;
            u32 votes = warp_votes(set);
            same &= set ? votes : ~votes;
        }
        u32 before = ones(same & ((1u << lane_index()) - 1));
        if (there && before == 0) of_warp[warp * DIGITS + digit] = ones(same);
        BARRIER();
        // A thread for each digit: where each warp's entries of it begin.
        u32 at = next[t];
        for (u32 w = 0; w < SORT_WARPS; w++) {
            u32 count = of_warp[w * DIGITS + t];
            of_warp[w * DIGITS + t] = at;
            at += count;
        }
        next[t] = at;
        BARRIER();
        if (there) {
            u32 place = of_warp[warp * DIGITS + digit] + before;
            to_codes[place] = code;
            to_rows[place] = rows[i];
        }
        BARRIER();
    }
}
ENTRY(sort_move)
