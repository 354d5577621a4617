// One factor and one shift for all values.
//
// `info` is null for contiguous tensors, else the dimensions and then the strides of the input.

#define AFFINE(T, ...)                                                                                       \
    extern "C" __global__ void affine_##T(usize count, usize num_dims, const usize *info, const T *in,      \
                                          T *out, T factor, T shift) {                                      \
        typedef Wide<T>::type W;                                                                            \
        W f = wide(factor), s = wide(shift);                                                                \
        for (usize i = FIRST; i < count; i += STEP) {                                                       \
            W x = wide(in[info ? strided(i, num_dims, info, info + num_dims) : i]);                         \
            out[i] = Narrow<T>::of((W)(x * f + s));                                                         \
        }                                                                                                   \
    }
ALL_TYPES(AFFINE, )
