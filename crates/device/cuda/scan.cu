// Running sums: where each of a list of stretches begins.

#define SCAN_THREADS 256
#define SCAN_EACH 8

/// Sums before each thread's own value, over the threads of a block; `total` is that of all.
template <class S> DEVICE u32 sum_before(S& sums, u32 own, u32& total) {
    u32 t = thread_index();
    sums[t] = own;
    BARRIER();
    for (u32 step = 1; step < SCAN_THREADS; step *= 2) {
        u32 before = t >= step ? sums[t - step] : 0u;
        BARRIER();
        sums[t] += before;
        BARRIER();
    }
    total = sums[SCAN_THREADS - 1];
    return sums[t] - own;
}

/// `out[i]` is the sum of the values of the block before `values[i]`, `totals[block]` that of all.
KERNEL(256) scan_blocks(In<u32> values, Out<u32> out, Out<u32> totals, u64 n) {
    SHARED(u32, sums, SCAN_THREADS);
    u64 first = ((u64)block_index() * SCAN_THREADS + thread_index()) * SCAN_EACH;
    u32 own[SCAN_EACH];
    u32 sum = 0;
    UNROLL
    for (u32 i = 0; i < SCAN_EACH; i++) {
        own[i] = sum;
        if (first + i < n) sum += values[first + i];
    }
    u32 total;
    u32 before = sum_before(sums, sum, total);
    UNROLL
    for (u32 i = 0; i < SCAN_EACH; i++) {
        if (first + i < n) out[first + i] = before + own[i];
    }
    if (thread_index() == 0) totals[block_index()] = total;
}
ENTRY(scan_blocks)

/// Adds what comes before each block.
KERNEL(256) scan_add(In<u32> before, Out<u32> out, u64 n) {
    u64 first = (u64)block_index() * SCAN_THREADS * SCAN_EACH;
    u32 more = before[block_index()];
    UNROLL
    for (u32 i = 0; i < SCAN_EACH; i++) {
        u64 at = first + i * SCAN_THREADS + thread_index();
        if (at < n) out[at] += more;
    }
}
ENTRY(scan_add)
