// One value everywhere; a rectangle of a matrix.

#define CONST_SET(T, ...)                                                                                          \
    extern "C" __global__ void const_set_##T(usize count, usize num_dims, const usize *info, T value, T *out) {   \
        for (usize i = FIRST; i < count; i += STEP)                                                               \
            out[info ? strided(i, num_dims, info, info + num_dims) : i] = value;                                  \
    }
ALL_TYPES(CONST_SET, )

// `rows` of `columns` values; a row begins `source_stride` and `target_stride` values after the one before.
#define COPY_2D(T, ...)                                                                                      \
    extern "C" __global__ void copy2d_##T(const T *in, T *out, u32 rows, u32 columns, u32 source_stride,     \
                                          u32 target_stride) {                                               \
        usize count = (usize)rows * columns;                                                                 \
        for (usize i = FIRST; i < count; i += STEP) {                                                        \
            usize row = i / columns, column = i % columns;                                                   \
            out[row * target_stride + column] = in[row * source_stride + column];                            \
        }                                                                                                    \
    }
ALL_TYPES(COPY_2D, )
