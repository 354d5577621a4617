// Values of one type as another. Floats become whole numbers as in Rust: cut off, held within the type, NaN as 0.

template <class T>
struct Limits;
template <>
struct Limits<u8> {
    static __device__ inline f64 low() { return 0.0; }
    static __device__ inline f64 end() { return 256.0; }
    static __device__ inline u8 last() { return 255; }
};
template <>
struct Limits<u32> {
    static __device__ inline f64 low() { return 0.0; }
    static __device__ inline f64 end() { return 4294967296.0; }
    static __device__ inline u32 last() { return 4294967295u; }
};
template <>
struct Limits<i64> {
    static __device__ inline f64 low() { return -9223372036854775808.0; }
    static __device__ inline f64 end() { return 9223372036854775808.0; }
    static __device__ inline i64 last() { return 9223372036854775807ll; }
};

template <class T>
__device__ inline T whole(f64 x) {
    if (x != x) return 0;
    if (x <= Limits<T>::low()) return (T)Limits<T>::low();
    if (x >= Limits<T>::end()) return Limits<T>::last();
    return (T)x;
}

#define CAST(FROM, TO, EXPRESSION)                                                                             \
    extern "C" __global__ void cast_##FROM##_##TO(usize count, usize num_dims, const usize *info,             \
                                                  const FROM *in, TO *out) {                                  \
        for (usize i = FIRST; i < count; i += STEP) {                                                         \
            Wide<FROM>::type x = wide(in[info ? strided(i, num_dims, info, info + num_dims) : i]);            \
            out[i] = EXPRESSION;                                                                              \
        }                                                                                                     \
    }
#define TO_FLOAT(FROM, TO) CAST(FROM, TO, Narrow<TO>::of((Wide<TO>::type)x))
#define FLOAT_TO_WHOLE(FROM, TO) CAST(FROM, TO, whole<TO>((f64)x))
#define WHOLE_TO_WHOLE(FROM, TO) CAST(FROM, TO, (TO)x)

ALL_TYPES(TO_FLOAT, f32)
ALL_TYPES(TO_FLOAT, f64)
ALL_TYPES(TO_FLOAT, f16)
ALL_TYPES(TO_FLOAT, bf16)
FLOATS(FLOAT_TO_WHOLE, u8)
FLOATS(FLOAT_TO_WHOLE, u32)
FLOATS(FLOAT_TO_WHOLE, i64)
INTEGERS(WHOLE_TO_WHOLE, u8)
INTEGERS(WHOLE_TO_WHOLE, u32)
INTEGERS(WHOLE_TO_WHOLE, i64)
