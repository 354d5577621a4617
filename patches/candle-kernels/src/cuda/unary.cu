// Functions of one value, and copies.
//
// `info` is null for contiguous tensors, else the dimensions and then the strides of the input.

__device__ inline f32 m_exp(f32 x) { return expf(x); }
__device__ inline f64 m_exp(f64 x) { return exp(x); }
__device__ inline f32 m_log(f32 x) { return logf(x); }
__device__ inline f64 m_log(f64 x) { return log(x); }
__device__ inline f32 m_sin(f32 x) { return sinf(x); }
__device__ inline f64 m_sin(f64 x) { return sin(x); }
__device__ inline f32 m_cos(f32 x) { return cosf(x); }
__device__ inline f64 m_cos(f64 x) { return cos(x); }
__device__ inline f32 m_tanh(f32 x) { return tanhf(x); }
__device__ inline f64 m_tanh(f64 x) { return tanh(x); }
__device__ inline f32 m_sqrt(f32 x) { return sqrtf(x); }
__device__ inline f64 m_sqrt(f64 x) { return sqrt(x); }
__device__ inline f32 m_abs(f32 x) { return fabsf(x); }
__device__ inline f64 m_abs(f64 x) { return fabs(x); }
__device__ inline f32 m_ceil(f32 x) { return ceilf(x); }
__device__ inline f64 m_ceil(f64 x) { return ceil(x); }
__device__ inline f32 m_floor(f32 x) { return floorf(x); }
__device__ inline f64 m_floor(f64 x) { return floor(x); }
__device__ inline f32 m_round(f32 x) { return roundf(x); }
__device__ inline f64 m_round(f64 x) { return round(x); }
__device__ inline f32 m_erf(f32 x) { return erff(x); }
__device__ inline f64 m_erf(f64 x) { return erf(x); }
__device__ inline f32 m_pow(f32 x, f32 y) { return powf(x, y); }
__device__ inline f64 m_pow(f64 x, f64 y) { return pow(x, y); }

// A kernel `PREFIX_TYPE(count, dimensions, info, in, out)` for each type: x is the value, W its wide type.
#define UNARY(T, NAME, EXPRESSION)                                                                            \
    extern "C" __global__ void NAME##_##T(usize count, usize num_dims, const usize *info, const T *in, T *out) { \
        typedef Wide<T>::type W;                                                                              \
        for (usize i = FIRST; i < count; i += STEP) {                                                         \
            W x = wide(in[info ? strided(i, num_dims, info, info + num_dims) : i]);                           \
            out[i] = Narrow<T>::of((W)(EXPRESSION));                                                          \
        }                                                                                                     \
    }

FLOATS(UNARY, uneg, -x)
FLOATS(UNARY, urecip, (W)1 / x)
FLOATS(UNARY, uexp, m_exp(x))
FLOATS(UNARY, ulog, m_log(x))
FLOATS(UNARY, usin, m_sin(x))
FLOATS(UNARY, ucos, m_cos(x))
FLOATS(UNARY, utanh, m_tanh(x))
FLOATS(UNARY, uerf, m_erf(x))
FLOATS(UNARY, uceil, m_ceil(x))
FLOATS(UNARY, ufloor, m_floor(x))
FLOATS(UNARY, uround, m_round(x))
FLOATS(UNARY, uabs, m_abs(x))
FLOATS(UNARY, usqr, x * x)
FLOATS(UNARY, usqrt, m_sqrt(x))
FLOATS(UNARY, urelu, x > (W)0 ? x : (W)0)
FLOATS(UNARY, usilu, x / ((W)1 + m_exp(-x)))
FLOATS(UNARY, usigmoid, (W)1 / ((W)1 + m_exp(-x)))
FLOATS(UNARY, usign, (W)(x > (W)0) - (W)(x < (W)0))
// 0.7978845608028654 = √(2/π), 0.7071067811865476 = √½.
FLOATS(UNARY, ugelu, (W)0.5 * x * ((W)1 + m_tanh((W)0.7978845608028654 * x * ((W)1 + (W)0.044715 * x * x))))
FLOATS(UNARY, ugelu_erf, (m_erf(x * (W)0.7071067811865476) + (W)1) * (W)0.5 * x)

// Bits are kept.
#define COPY(T, NAME)                                                                                            \
    extern "C" __global__ void NAME##_##T(usize count, usize num_dims, const usize *info, const T *in, T *out) { \
        for (usize i = FIRST; i < count; i += STEP)                                                              \
            out[i] = in[info ? strided(i, num_dims, info, info + num_dims) : i];                                 \
    }
#define COPY_OF(T, ...) COPY(T, ucopy)
ALL_TYPES(COPY_OF, )

#define UNARY_WITH(T, NAME, EXPRESSION)                                                                     \
    extern "C" __global__ void NAME##_##T(usize count, usize num_dims, const usize *info, T parameter,      \
                                          const T *in, T *out) {                                            \
        typedef Wide<T>::type W;                                                                            \
        W p = wide(parameter);                                                                              \
        for (usize i = FIRST; i < count; i += STEP) {                                                       \
            W x = wide(in[info ? strided(i, num_dims, info, info + num_dims) : i]);                         \
            out[i] = Narrow<T>::of((W)(EXPRESSION));                                                        \
        }                                                                                                   \
    }
FLOATS(UNARY_WITH, upowf, m_pow(x, p))
FLOATS(UNARY_WITH, uelu, x > (W)0 ? x : p * (m_exp(x) - (W)1))
