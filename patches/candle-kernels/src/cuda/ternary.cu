// Choices by a condition.

// `info`: dimensions, then the strides of the condition, of what is taken where it holds, and of what else.
#define WHERE(T, CONDITION)                                                                                   \
    extern "C" __global__ void where_##CONDITION##_##T(usize count, usize num_dims, const usize *info,       \
                                                       const CONDITION *condition, const T *yes, const T *no, \
                                                       T *out) {                                             \
        for (usize i = FIRST; i < count; i += STEP) {                                                        \
            bool holds = condition[strided(i, num_dims, info, info + num_dims)] != 0;                        \
            out[i] = holds ? yes[strided(i, num_dims, info, info + 2 * num_dims)]                            \
                           : no[strided(i, num_dims, info, info + 3 * num_dims)];                            \
        }                                                                                                    \
    }
ALL_TYPES(WHERE, u8)
ALL_TYPES(WHERE, u32)
ALL_TYPES(WHERE, i64)
