// Kernels with one fault each, which the emulation must notice.

/// Right: a block's values in reverse.
KERNEL(64) reverse(In<u32> x, Out<u32> out) {
    SHARED(u32, tile, 64);
    u32 t = thread_index();
    tile[t] = x[block_index() * 64 + t];
    BARRIER();
    out[block_index() * 64 + t] = tile[63 - t];
}
ENTRY(reverse)

/// Reads what others have not written yet.
KERNEL(64) reverse_without_barrier(In<u32> x, Out<u32> out) {
    SHARED(u32, tile, 64);
    u32 t = thread_index();
    tile[t] = x[block_index() * 64 + t];
    out[block_index() * 64 + t] = tile[63 - t];
}
ENTRY(reverse_without_barrier)

/// Half of the threads never come to the barrier.
KERNEL(64) half_at_the_barrier(In<u32> x, Out<u32> out) {
    SHARED(u32, tile, 64);
    u32 t = thread_index();
    tile[t] = x[block_index() * 64 + t];
    if (t < 32) BARRIER();
    out[block_index() * 64 + t] = tile[63 - t];
}
ENTRY(half_at_the_barrier)

/// Two barriers that are not the same one.
KERNEL(64) two_barriers(In<u32> x, Out<u32> out) {
    u32 t = thread_index();
    if (t < 32) {
        BARRIER();
    } else {
        BARRIER();
    }
    out[block_index() * 64 + t] = x[block_index() * 64 + t];
}
ENTRY(two_barriers)

/// One lane leaves before its warp adds up.
KERNEL(64) lane_left_behind(In<u32> x, Out<u32> out) {
    u32 t = thread_index();
    if (t == 40) return;
    out[block_index() * 64 + t] = warp_sum(x[block_index() * 64 + t]);
}
ENTRY(lane_left_behind)

/// One more than the array has.
KERNEL(64) beyond_the_end(In<u32> x, Out<u32> out) {
    u32 t = thread_index();
    out[block_index() * 64 + t] = x[block_index() * 64 + t + 1];
}
ENTRY(beyond_the_end)

/// Beside the shared array.
KERNEL(64) beyond_the_tile(In<u32> x, Out<u32> out) {
    SHARED(u32, tile, 64);
    u32 t = thread_index();
    tile[t + 1] = x[block_index() * 64 + t];
    BARRIER();
    out[block_index() * 64 + t] = tile[t];
}
ENTRY(beyond_the_tile)

/// A block uses what the block before left in shared memory.
KERNEL(64) left_from_before(In<u32> x, Out<u32> out) {
    SHARED(u32, tile, 64);
    u32 t = thread_index();
    if (block_index() == 0) tile[t] = x[t];
    BARRIER();
    out[block_index() * 64 + t] = tile[t];
}
ENTRY(left_from_before)

/// The result hangs on which block comes last.
KERNEL(64) last_block_wins(In<u32> x, Out<u32> out) {
    u32 t = thread_index();
    out[t] = x[block_index() * 64 + t];
    out[64 + t] = 0;
}
ENTRY(last_block_wins)
