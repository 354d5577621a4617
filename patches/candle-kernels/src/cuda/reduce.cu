// Sums, extremes and their places along dimensions, which `info` has last.
//
// A block makes one value: each thread takes every n-th, and what they have is joined in pairs, in an order that the
// number of threads fixes; so two runs have the same bits. Types of 16 bits are summed in f32.

struct Sum {
    template <class W>
    static __device__ inline W join(W a, W b) {
        return a + b;
    }
};
struct Least {
    template <class W>
    static __device__ inline W join(W a, W b) {
        return a > b ? b : a;
    }
};
struct Most {
    template <class W>
    static __device__ inline W join(W a, W b) {
        return a < b ? b : a;
    }
};

// A block has 1024 threads at most.
#define REDUCTION(T, NAME, OP)                                                                                    \
    extern "C" __global__ void NAME##_##T(usize count, usize per_block, usize num_dims, const usize *info,       \
                                          const T *in, T *out) {                                                 \
        typedef Wide<T>::type W;                                                                                 \
        __shared__ W parts[1024];                                                                                \
        usize begin = (usize)blockIdx.x * per_block;                                                             \
        usize own = per_block < blockDim.x ? per_block : blockDim.x;                                             \
        if (threadIdx.x < own) {                                                                                 \
            W sum = wide(in[strided(begin + threadIdx.x, num_dims, info, info + num_dims)]);                     \
            for (usize i = threadIdx.x + blockDim.x; i < per_block; i += blockDim.x)                             \
                sum = OP::join(sum, wide(in[strided(begin + i, num_dims, info, info + num_dims)]));              \
            parts[threadIdx.x] = sum;                                                                            \
        }                                                                                                        \
        __syncthreads();                                                                                         \
        for (u32 half = blockDim.x / 2; half > 0; half /= 2) {                                                   \
            if (threadIdx.x < half && threadIdx.x + half < own)                                                  \
                parts[threadIdx.x] = OP::join(parts[threadIdx.x], parts[threadIdx.x + half]);                    \
            __syncthreads();                                                                                     \
        }                                                                                                        \
        if (threadIdx.x == 0) out[blockIdx.x] = Narrow<T>::of(own > 0 ? parts[0] : (W)0);                        \
    }
ALL_TYPES(REDUCTION, fast_sum, Sum)
ALL_TYPES(REDUCTION, fast_min, Least)
ALL_TYPES(REDUCTION, fast_max, Most)

// Of equal values the first.
#define PLACE(T, NAME, BETTER)                                                                                    \
    extern "C" __global__ void NAME##_##T(usize count, usize per_block, usize num_dims, const usize *info,       \
                                          const T *in, u32 *out) {                                               \
        typedef Wide<T>::type W;                                                                                 \
        __shared__ W values[1024];                                                                               \
        __shared__ u32 places[1024];                                                                             \
        usize begin = (usize)blockIdx.x * per_block;                                                             \
        usize own = per_block < blockDim.x ? per_block : blockDim.x;                                             \
        if (threadIdx.x < own) {                                                                                 \
            W b = wide(in[strided(begin + threadIdx.x, num_dims, info, info + num_dims)]);                       \
            u32 at = threadIdx.x;                                                                                \
            for (usize i = threadIdx.x + blockDim.x; i < per_block; i += blockDim.x) {                           \
                W a = wide(in[strided(begin + i, num_dims, info, info + num_dims)]);                             \
                if (a BETTER b) {                                                                                \
                    b = a;                                                                                       \
                    at = (u32)i;                                                                                 \
                }                                                                                                \
            }                                                                                                    \
            values[threadIdx.x] = b;                                                                             \
            places[threadIdx.x] = at;                                                                            \
        }                                                                                                        \
        __syncthreads();                                                                                         \
        for (u32 half = blockDim.x / 2; half > 0; half /= 2) {                                                   \
            if (threadIdx.x < half && threadIdx.x + half < own) {                                                \
                W b = values[threadIdx.x], a = values[threadIdx.x + half];                                       \
                u32 at = places[threadIdx.x], other = places[threadIdx.x + half];                                \
                if (a BETTER b || (a == b && other < at)) {                                                      \
                    values[threadIdx.x] = a;                                                                     \
                    places[threadIdx.x] = other;                                                                 \
                }                                                                                                \
            }                                                                                                    \
            __syncthreads();                                                                                     \
        }                                                                                                        \
        if (threadIdx.x == 0) out[blockIdx.x] = own > 0 ? places[0] : 0;                                         \
    }
ALL_TYPES(PLACE, fast_argmin, <)
ALL_TYPES(PLACE, fast_argmax, >)

// Of 32 values at most: a thread makes one sum. `count` is the number of sums here.
#define SMALL_SUM(T, ...)                                                                                        \
    extern "C" __global__ void fast_sum_small_##T(usize count, usize per_sum, usize num_dims,                    \
                                                  const usize *info, const T *in, T *out) {                      \
        typedef Wide<T>::type W;                                                                                 \
        for (usize i = FIRST; i < count; i += STEP) {                                                            \
            W sum = (W)0;                                                                                        \
            for (usize j = 0; j < per_sum; ++j)                                                                  \
                sum += wide(in[strided(i * per_sum + j, num_dims, info, info + num_dims)]);                      \
            out[i] = Narrow<T>::of(sum);                                                                         \
        }                                                                                                        \
    }
ALL_TYPES(SMALL_SUM, )
