// Types, conversions and index arithmetic that all modules share. Put before each of them as text, so that nothing
// is included: NVRTC needs no header of a toolkit.

typedef unsigned char u8;
typedef unsigned int u32;
typedef short i16;
typedef int i32;
typedef long long i64;
typedef unsigned long long usize;
typedef float f32;
typedef double f64;

// The two types of 16 bits are computed in f32 and rounded once.
struct bf16 {
    unsigned short bits;
};
struct f16 {
    unsigned short bits;
};

union Bits32 {
    f32 f;
    u32 u;
};

__device__ inline u32 bits_of(f32 x) {
    Bits32 b;
    b.f = x;
    return b.u;
}
__device__ inline f32 of_bits(u32 x) {
    Bits32 b;
    b.u = x;
    return b.f;
}

// The type that values are computed in.
template <class T>
struct Wide {
    typedef T type;
};
template <>
struct Wide<bf16> {
    typedef f32 type;
};
template <>
struct Wide<f16> {
    typedef f32 type;
};

template <class T>
__device__ inline T wide(T x) {
    return x;
}
__device__ inline f32 wide(bf16 x) { return of_bits((u32)x.bits << 16); }
__device__ inline f32 wide(f16 x) {
    u32 sign = (u32)(x.bits & 0x8000) << 16, exponent = x.bits >> 10 & 31, fraction = x.bits & 0x3ff;
    if (exponent == 31) return of_bits(sign | 0x7f800000 | fraction << 13);
    if (exponent != 0) return of_bits(sign | (exponent + 112) << 23 | fraction << 13);
    // Below 2^-14: a multiple of 2^-24.
    f32 value = (f32)fraction * 5.9604644775390625e-8f;
    return of_bits(sign | bits_of(value));
}

template <class T>
struct Narrow {
    template <class W>
    static __device__ inline T of(W x) {
        return (T)x;
    }
};
template <>
struct Narrow<bf16> {
    static __device__ inline bf16 of(f32 x) {
        u32 bits = bits_of(x);
        bf16 out;
        // To the nearest, ties to even; rounding could carry a NaN into infinity.
        if ((bits & 0x7fffffff) > 0x7f800000) {
            out.bits = (unsigned short)(bits >> 16 | 0x40);
        } else {
            out.bits = (unsigned short)((bits + 0x7fff + (bits >> 16 & 1)) >> 16);
        }
        return out;
    }
};
template <>
struct Narrow<f16> {
    static __device__ inline f16 of(f32 x) {
        u32 bits = bits_of(x), sign = bits >> 16 & 0x8000, size = bits & 0x7fffffff;
        f16 out;
        if (size > 0x7f800000) {
            out.bits = (unsigned short)(sign | 0x7e00 | (size >> 13 & 0x3ff));
        } else if (size >= 0x47800000) {
            out.bits = (unsigned short)(sign | 0x7c00);
        } else if (size < 0x38800000) {
            // Below 2^-14: adding 0.5 leaves the multiple of 2^-24 in the low bits, rounded to even.
            f32 shifted = of_bits(size) + 0.5f;
            out.bits = (unsigned short)(sign | (bits_of(shifted) - 0x3f000000));
        } else {
            u32 rounded = size + 0xfff + (size >> 13 & 1);
            out.bits = (unsigned short)(sign | ((rounded - 0x38000000) >> 13));
        }
        return out;
    }
};

// candle starts one thread for each element, and none for elements beyond 2^32: the rest goes round again.
#define FIRST ((usize)blockIdx.x * blockDim.x + threadIdx.x)
#define STEP ((usize)blockDim.x * gridDim.x)

// Where element `i` of a tensor with these dimensions and strides lies. Divisions of 64 bits are several times as slow
// and long, and few tensors need them.
__device__ __noinline__ usize strided_far(usize i, usize num_dims, const usize *dims, const usize *strides) {
    usize at = 0;
    for (usize d = num_dims; d-- > 0;) {
        at += i % dims[d] * strides[d];
        i /= dims[d];
    }
    return at;
}
__device__ inline usize strided(usize i, usize num_dims, const usize *dims, const usize *strides) {
    if (i >> 32 != 0) return strided_far(i, num_dims, dims, strides);
    usize at = 0;
    u32 rest = (u32)i;
#pragma unroll 1
    for (u32 d = (u32)num_dims; d-- > 0;) {
        u32 dim = (u32)dims[d];
        at += (usize)(rest % dim) * strides[d];
        rest /= dim;
    }
    return at;
}

#define FLOATS(M, ...) M(f32, __VA_ARGS__) M(f64, __VA_ARGS__) M(f16, __VA_ARGS__) M(bf16, __VA_ARGS__)
#define INTEGERS(M, ...) M(u8, __VA_ARGS__) M(u32, __VA_ARGS__) M(i16, __VA_ARGS__) M(i32, __VA_ARGS__) M(i64, __VA_ARGS__)
#define ALL_TYPES(M, ...) FLOATS(M, __VA_ARGS__) INTEGERS(M, __VA_ARGS__)
