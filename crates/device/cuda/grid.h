// One text for two machines: on a GPU these names are the grid itself, elsewhere they are emulated.
//
// A kernel is `KERNEL(threads) name(In<float> x, Out<float> y, u32 rows) { ... }`, followed by
// `ENTRY(name)`. Blocks and threads have one dimension. Threads of a block meet at `BARRIER()`, which all
// of them must reach; the 32 lanes of a warp meet in the `warp_` functions, which all lanes must reach.
//
// Kernels add and multiply as written: they are compiled without contraction, and say `fused` where one
// rounding is meant. Divisions and square roots are rounded correctly. So what the emulation computes is
// what a GPU must compute, to the bit, but for the functions at the end of this file.
#ifndef SCENESPLAT_GRID_H
#define SCENESPLAT_GRID_H

typedef unsigned char u8;
typedef unsigned short u16;
typedef unsigned int u32;
typedef int i32;
typedef unsigned long long u64;
typedef long long i64;

/// Lanes of a warp.
#define WARP 32u
/// No row.
#define NONE 0xffffffffu

#ifdef __CUDACC__

#define DEVICE __device__ __forceinline__
#define KERNEL(threads) extern "C" __global__ void __launch_bounds__(threads)
#define ENTRY(name)
/// An array that the threads of a block share; its first contents are arbitrary.
#define SHARED(type, name, count) __shared__ type name[count]
#define BARRIER() __syncthreads()
#define UNROLL _Pragma("unroll")

/// Values that a kernel reads only.
template <class T> using In = const T* __restrict__;
/// Values that a kernel writes, or reads and writes; no other argument overlaps them.
template <class T> using Out = T* __restrict__;

DEVICE u32 thread_index() { return threadIdx.x; }
DEVICE u32 block_index() { return blockIdx.x; }
DEVICE u32 block_threads() { return blockDim.x; }
DEVICE u32 grid_blocks() { return gridDim.x; }

DEVICE float warp_xor(float v, u32 mask) { return __shfl_xor_sync(0xffffffffu, v, mask); }
DEVICE double warp_xor(double v, u32 mask) { return __shfl_xor_sync(0xffffffffu, v, mask); }
DEVICE u32 warp_xor(u32 v, u32 mask) { return __shfl_xor_sync(0xffffffffu, v, mask); }
DEVICE i32 warp_xor(i32 v, u32 mask) { return __shfl_xor_sync(0xffffffffu, v, mask); }
/// A bit for each lane of the warp whose value is true.
DEVICE u32 warp_votes(bool v) { return __ballot_sync(0xffffffffu, v); }

/// Adds to a whole number and returns what was there.
DEVICE u32 add_atomically(u32& at, u32 v) { return atomicAdd(&at, v); }
DEVICE u64 add_atomically(u64& at, u64 v) { return atomicAdd(&at, v); }
DEVICE u32 minimum_atomically(u32& at, u32 v) { return atomicMin(&at, v); }
/// Puts `v` where `expected` is, and returns what was there.
DEVICE u64 exchange_atomically(u64& at, u64 expected, u64 v) { return atomicCAS(&at, expected, v); }

DEVICE u32 bits_of(float v) { return __float_as_uint(v); }
DEVICE float float_of(u32 v) { return __uint_as_float(v); }
DEVICE u32 ones(u32 v) { return (u32)__popc(v); }
DEVICE u32 leading_zeros(u32 v) { return (u32)__clz((int)v); }
/// `a · b + c` with one rounding.
DEVICE float fused(float a, float b, float c) { return __fmaf_rn(a, b, c); }
DEVICE float square_root(float v) { return __fsqrt_rn(v); }
DEVICE double square_root(double v) { return __dsqrt_rn(v); }
DEVICE float nearest_even(float v) { return rintf(v); }
DEVICE double floor_of(double v) { return floor(v); }
DEVICE float floor_of(float v) { return floorf(v); }
DEVICE float ceil_of(float v) { return ceilf(v); }
/// Sine and cosine of an angle in radians; the only functions whose last bit differs between machines.
DEVICE void sine_cosine(double v, double& sine, double& cosine) { sincos(v, &sine, &cosine); }

/// `d += a · b` of a warp: a is 16×16 in bf16, b is 16×8 in bf16, d is 16×8 in f32.
///
/// With `g = lane / 4` and `t = lane % 4`, two bf16 in a word, the lower half first: a[0] holds row g,
/// columns 2t and 2t + 1; a[1] row g + 8, the same columns; a[2] row g, columns 2t + 8 and 2t + 9; a[3] row
/// g + 8, these; b[0] holds rows 2t and 2t + 1 of column g, b[1] rows 2t + 8 and 2t + 9; d[0] and d[1] are row
/// g, columns 2t and 2t + 1, d[2] and d[3] row g + 8.
DEVICE void multiply_16x8x16(float (&d)[4], const u32 (&a)[4], const u32 (&b)[2]) {
#if __CUDA_ARCH__ >= 800
    asm volatile(
        "mma.sync.aligned.m16n8k16.row.col.f32.bf16.bf16.f32 {%0,%1,%2,%3}, {%4,%5,%6,%7}, {%8,%9}, {%0,%1,%2,%3};"
        : "+f"(d[0]), "+f"(d[1]), "+f"(d[2]), "+f"(d[3])
        : "r"(a[0]), "r"(a[1]), "r"(a[2]), "r"(a[3]), "r"(b[0]), "r"(b[1]));
#else
    // Older processors have no such products in bf16.
    asm volatile("trap;");
#endif
}

#else
#include "emulated_grid.h"
#endif

/// Number of this thread among all threads of the grid.
DEVICE u64 global_index() { return (u64)block_index() * block_threads() + thread_index(); }
DEVICE u32 lane_index() { return thread_index() & (WARP - 1); }
DEVICE u32 warp_index() { return thread_index() / WARP; }

/// Row and channel of element `i` of an array with `channels` columns.
DEVICE void split_index(u64 i, u32 channels, u64& row, u32& channel) {
    // Divisions of 64 bits are many times slower, and few arrays need them.
    if ((i >> 32) == 0) {
        row = (u32)i / channels;
        channel = (u32)i % channels;
    } else {
        row = i / channels;
        channel = (u32)(i % channels);
    }
}

/// Sum over the lanes of a warp, the same in each; in a fixed order.
template <class T> DEVICE T warp_sum(T v) {
    for (u32 step = WARP / 2; step > 0; step /= 2) v += warp_xor(v, step);
    return v;
}

DEVICE float smaller(float a, float b) { return a < b ? a : b; }
DEVICE float larger(float a, float b) { return a > b ? a : b; }
DEVICE u32 smaller(u32 a, u32 b) { return a < b ? a : b; }
DEVICE u32 larger(u32 a, u32 b) { return a > b ? a : b; }
DEVICE bool is_nan(float v) { return v != v; }
DEVICE bool is_finite(float v) { return (bits_of(v) & 0x7f800000u) != 0x7f800000u; }
DEVICE float infinity() { return float_of(0x7f800000u); }

#endif
