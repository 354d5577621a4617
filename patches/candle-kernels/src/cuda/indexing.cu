// Rows by number: gathers, and sums whose order does not depend on the threads.
//
// A number outside the tensor ends the kernel, and what waits for it gets an error; the largest number of its type
// stands for "none", as on the CPU: zero is read, nothing is written.

template <class I>
struct None {
    static __device__ inline bool is(I i) { return i == (I)-1; }
};
template <>
struct None<i64> {
    static __device__ inline bool is(i64 i) { return i == 9223372036854775807ll; }
};

template <class I>
__device__ inline usize checked(I i, usize size) {
    if ((usize)i >= size) __trap();
    return (usize)i;
}

template <class T>
__device__ inline T zero() {
    return Narrow<T>::of((typename Wide<T>::type)0);
}

#define INDEX_SELECT(T, I)                                                                                      \
    extern "C" __global__ void is_##I##_##T(usize count, usize num_dims, const usize *info, const I *ids,      \
                                            const T *in, T *out, usize left, usize source, usize picked,       \
                                            usize right) {                                                     \
        for (usize i = FIRST; i < count; i += STEP) {                                                          \
            usize inner = i % right, id_at = i / right % picked, outer = i / right / picked;                   \
            I id = ids[strided(id_at, num_dims, info, info + num_dims)];                                       \
            out[i] = None<I>::is(id) ? zero<T>()                                                               \
                                     : in[(outer * source + checked(id, source)) * right + inner];             \
        }                                                                                                      \
    }
#define GATHER(T, I)                                                                                            \
    extern "C" __global__ void gather_##I##_##T(usize count, const I *ids, const T *in, T *out, usize left,    \
                                                usize source, usize picked, usize right) {                     \
        for (usize i = FIRST; i < count; i += STEP) {                                                          \
            usize inner = i % right, outer = i / right / picked;                                               \
            I id = ids[i];                                                                                     \
            out[i] = None<I>::is(id) ? zero<T>()                                                               \
                                     : in[(outer * source + checked(id, source)) * right + inner];             \
        }                                                                                                      \
    }
// One thread has a column, and adds to it in the order of the numbers.
#define INDEX_ADD(T, I)                                                                                         \
    extern "C" __global__ void ia_##I##_##T(const I *ids, usize picked, const T *in, T *out, usize left,       \
                                            usize source, usize target, usize right) {                         \
        for (usize i = FIRST; i < left * right; i += STEP) {                                                   \
            usize inner = i % right, outer = i / right;                                                        \
            for (usize j = 0; j < picked; ++j) {                                                               \
                if (None<I>::is(ids[j])) continue;                                                             \
                usize to = (outer * target + checked(ids[j], target)) * right + inner;                         \
                out[to] = Narrow<T>::of((Wide<T>::type)(wide(out[to]) +                                        \
                                                        wide(in[(outer * source + j) * right + inner])));      \
            }                                                                                                  \
        }                                                                                                      \
    }
#define SCATTER(T, I)                                                                                           \
    extern "C" __global__ void s_##I##_##T(const I *ids, const T *in, T *out, usize left, usize source,        \
                                           usize target, usize right) {                                        \
        for (usize i = FIRST; i < left * right; i += STEP) {                                                   \
            usize inner = i % right, outer = i / right;                                                        \
            for (usize j = 0; j < source; ++j) {                                                               \
                usize from = (outer * source + j) * right + inner;                                             \
                if (None<I>::is(ids[from])) continue;                                                          \
                out[(outer * target + checked(ids[from], target)) * right + inner] = in[from];                 \
            }                                                                                                  \
        }                                                                                                      \
    }
#define SCATTER_ADD(T, I)                                                                                       \
    extern "C" __global__ void sa_##I##_##T(const I *ids, const T *in, T *out, usize left, usize source,       \
                                            usize target, usize right) {                                       \
        for (usize i = FIRST; i < left * right; i += STEP) {                                                   \
            usize inner = i % right, outer = i / right;                                                        \
            for (usize j = 0; j < source; ++j) {                                                               \
                usize from = (outer * source + j) * right + inner;                                             \
                if (None<I>::is(ids[from])) continue;                                                          \
                usize to = (outer * target + checked(ids[from], target)) * right + inner;                      \
                out[to] = Narrow<T>::of((Wide<T>::type)(wide(out[to]) + wide(in[from])));                      \
            }                                                                                                  \
        }                                                                                                      \
    }
#define WITH_EACH_INDEX(KERNEL) ALL_TYPES(KERNEL, u8) ALL_TYPES(KERNEL, u32) ALL_TYPES(KERNEL, i64)
WITH_EACH_INDEX(INDEX_SELECT)
WITH_EACH_INDEX(GATHER)
WITH_EACH_INDEX(INDEX_ADD)
WITH_EACH_INDEX(SCATTER)
WITH_EACH_INDEX(SCATTER_ADD)
