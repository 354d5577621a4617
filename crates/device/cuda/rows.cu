// Copies of rows: `crates/kernels/src/permute.rs`.

template <class T> DEVICE void gather(In<T> x, In<u32> rows, Out<T> out, u32 n, u32 channels) {
    u64 i = global_index();
    if (i >= (u64)n * channels) return;
    u64 row;
    u32 channel;
    split_index(i, channels, row, channel);
    out[i] = x[(u64)rows[row] * channels + channel];
}

KERNEL(256) gather_rows_4(In<u32> x, In<u32> rows, Out<u32> out, u32 n, u32 channels) {
    gather<u32>(x, rows, out, n, channels);
}
ENTRY(gather_rows_4)

KERNEL(256) gather_rows_2(In<u16> x, In<u32> rows, Out<u16> out, u32 n, u32 channels) {
    gather<u16>(x, rows, out, n, channels);
}
ENTRY(gather_rows_2)

KERNEL(256) invert(In<u32> order, Out<u32> inverse, u32 n) {
    u64 i = global_index();
    if (i < n) inverse[order[i]] = (u32)i;
}
ENTRY(invert)

KERNEL(256) count_up(Out<u32> out, u32 n) {
    u64 i = global_index();
    if (i < n) out[i] = (u32)i;
}
ENTRY(count_up)
