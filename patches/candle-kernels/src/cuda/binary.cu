// Functions of two values, and comparisons.
//
// `info` is null for contiguous tensors, else the dimensions and then the strides of both inputs.

// `OUT` is the type of the result: the inputs', or u8 for comparisons.
#define BINARY_TO(T, OUT, NAME, EXPRESSION)                                                                      \
    extern "C" __global__ void NAME##_##T(usize count, usize num_dims, const usize *info, const T *left,        \
                                          const T *right, OUT *out) {                                           \
        typedef Wide<T>::type W;                                                                                \
        for (usize i = FIRST; i < count; i += STEP) {                                                           \
            W x = wide(left[info ? strided(i, num_dims, info, info + num_dims) : i]);                           \
            W y = wide(right[info ? strided(i, num_dims, info, info + 2 * num_dims) : i]);                      \
            out[i] = Narrow<OUT>::of(EXPRESSION);                                                               \
        }                                                                                                       \
    }
#define BINARY(T, NAME, EXPRESSION) BINARY_TO(T, T, NAME, (W)(EXPRESSION))
#define COMPARISON(T, NAME, EXPRESSION) BINARY_TO(T, u8, NAME, (EXPRESSION) ? 1 : 0)

ALL_TYPES(BINARY, badd, x + y)
ALL_TYPES(BINARY, bsub, x - y)
ALL_TYPES(BINARY, bmul, x * y)
ALL_TYPES(BINARY, bdiv, x / y)
ALL_TYPES(BINARY, bminimum, x > y ? y : x)
ALL_TYPES(BINARY, bmaximum, x < y ? y : x)
ALL_TYPES(COMPARISON, eq, x == y)
ALL_TYPES(COMPARISON, ne, x != y)
ALL_TYPES(COMPARISON, lt, x < y)
ALL_TYPES(COMPARISON, le, x <= y)
ALL_TYPES(COMPARISON, gt, x > y)
ALL_TYPES(COMPARISON, ge, x >= y)
