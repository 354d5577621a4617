// The grid of `grid.h` on one thread of a CPU, for tests.
//
// Blocks run one after another. The threads of a block are fibres: each runs until it reaches a barrier or
// a function of its warp, then another one runs. With a seed, blocks and threads run in shuffled orders, so
// that a kernel which lacks a barrier, or whose result hangs on the order of blocks, gives another result.
// Shared memory is filled with NaN before each block. Every access is checked against the length of its
// array. What is wrong ends the launch with a sentence.
#ifndef SCENESPLAT_EMULATED_GRID_H
#define SCENESPLAT_EMULATED_GRID_H

#include <cmath>
#include <csetjmp>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <tuple>
#include <utility>
#include <vector>

#include <sys/mman.h>
#include <ucontext.h>

#define DEVICE static inline
#define KERNEL(threads) static void
#define UNROLL
#define BARRIER() grid::wait_for_block(__LINE__)
#define SHARED(type, name, count)                        \
    static thread_local grid::Shared<type, count> name;  \
    name.begin()

namespace grid {

const u32 MOST_THREADS = 1024;
const size_t STACK_BYTES = 128 << 10;

struct Launch {
    u32 blocks;
    u32 threads;
    u64 seed;
    char* message;
    u64 message_bytes;
};

enum State { READY, AT_BARRIER, IN_WARP, DONE };

struct Fibre {
    jmp_buf place;
    bool begun = false;
    void* stack = nullptr;
    State state = DONE;
    /// Line of the barrier or warp function at which it waits.
    int line = 0;
    /// Which of the two sets of slots its next warp function uses.
    u32 turn = 0;
};

/// What lanes show each other; two sets, so that a fast lane does not overwrite what a slow one reads.
struct Slots {
    u64 values[2][WARP];
};

struct Machine {
    std::vector<Fibre> fibres;
    std::vector<Slots> slots;
    jmp_buf scheduler;
    ucontext_t scheduler_context;
    u32 thread = 0, block = 0, threads = 0, blocks = 0;
    /// Number of blocks begun; shared arrays remember for which one they were filled.
    u64 block_serial = 0;
    void (*body)(void*) = nullptr;
    void* arguments = nullptr;
    const Launch* launch = nullptr;
    const char* kernel = "";
    bool failed = false;
    u64 random = 0;
};

inline Machine& machine() {
    static thread_local Machine m;
    return m;
}

/// Keeps the first complaint.
template <class... A> void complain(const char* format, A... values) {
    Machine& m = machine();
    if (m.failed) return;
    m.failed = true;
    int used = snprintf(m.launch->message, m.launch->message_bytes, "%s, block %u, thread %u: ", m.kernel,
                        m.block, m.thread);
    if (used >= 0 && (u64)used < m.launch->message_bytes)
        snprintf(m.launch->message + used, m.launch->message_bytes - used, format, values...);
}

inline u64 random_number() {
    u64 z = (machine().random += 0x9e3779b97f4a7c15ull);
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ull;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebull;
    return z ^ (z >> 31);
}

/// 0..count in order, or shuffled where the launch has a seed.
inline void arrange(std::vector<u32>& order, u32 count) {
    order.resize(count);
    for (u32 i = 0; i < count; i++) order[i] = i;
    if (machine().launch->seed != 0)
        for (u32 i = count; i > 1; i--) std::swap(order[i - 1], order[random_number() % i]);
}

/// Goes back to the scheduler, until it lets this thread run on.
inline void pause(State state, int line) {
    Machine& m = machine();
    Fibre& self = m.fibres[m.thread];
    self.state = state;
    self.line = line;
    if (_setjmp(self.place) == 0) _longjmp(m.scheduler, 1);
}

inline void run_fibre() {
    for (;;) {
        Machine& m = machine();
        m.body(m.arguments);
        pause(DONE, 0);
    }
}

inline void wait_for_block(int line) { pause(AT_BARRIER, line); }

/// Lets the fibre of a thread run until it waits or ends.
inline void resume(u32 thread) {
    Machine& m = machine();
    m.thread = thread;
    Fibre& fibre = m.fibres[thread];
    if (_setjmp(m.scheduler) != 0) return;
    if (fibre.begun) _longjmp(fibre.place, 1);
    if (!fibre.stack) {
        // The page below is never there: a stack that is too deep ends the process.
        void* memory = mmap(nullptr, STACK_BYTES + 4096, PROT_READ | PROT_WRITE,
                            MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
        if (memory == MAP_FAILED) abort();
        mprotect(memory, 4096, PROT_NONE);
        fibre.stack = (char*)memory + 4096;
    }
    fibre.begun = true;
    ucontext_t context;
    getcontext(&context);
    context.uc_stack.ss_sp = fibre.stack;
    context.uc_stack.ss_size = STACK_BYTES;
    context.uc_link = nullptr;
    makecontext(&context, run_fibre, 0);
    setcontext(&context);
    abort();
}

/// Lets lanes go on that all wait in a function of their warp.
inline bool release_warp(u32 warp) {
    Machine& m = machine();
    for (u32 t = warp * WARP; t < (warp + 1) * WARP; t++)
        if (m.fibres[t].state != IN_WARP) return false;
    for (u32 t = warp * WARP; t < (warp + 1) * WARP; t++) {
        m.thread = t;
        if (m.fibres[t].line != m.fibres[warp * WARP].line)
            complain("a function of the warp at line %d, where lane 0 is at line %d", m.fibres[t].line,
                     m.fibres[warp * WARP].line);
        m.fibres[t].state = READY;
    }
    return true;
}

inline void run_block(std::vector<u32>& order) {
    Machine& m = machine();
    m.block_serial++;
    for (u32 t = 0; t < m.threads; t++) {
        m.fibres[t].state = READY;
        m.fibres[t].turn = 0;
    }
    for (;;) {
        arrange(order, m.threads);
        bool ran = false;
        for (u32 t : order) {
            if (m.fibres[t].state != READY) continue;
            resume(t);
            ran = true;
            if (m.failed) return;
        }
        for (u32 w = 0; w < m.threads / WARP; w++) ran |= release_warp(w);
        if (m.failed) return;
        if (ran) continue;
        // All threads wait or are done.
        u32 done = 0, waiting = 0, at = 0;
        for (u32 t = 0; t < m.threads; t++) {
            done += m.fibres[t].state == DONE;
            if (m.fibres[t].state == AT_BARRIER) {
                waiting++;
                at = t;
            }
        }
        if (done == m.threads) return;
        m.thread = at;
        if (waiting == 0) {
            complain("lanes wait for others of their warp that are done");
        } else if (waiting < m.threads) {
            complain("the barrier at line %d is reached by %u of %u threads", m.fibres[at].line, waiting, m.threads);
        }
        for (u32 t = 0; t < m.threads && !m.failed; t++) {
            if (m.fibres[t].line != m.fibres[at].line)
                complain("waits at line %d, thread %u at line %d", m.fibres[at].line, t, m.fibres[t].line);
            m.fibres[t].state = READY;
        }
        if (m.failed) return;
    }
}

inline int run(const Launch* launch, const char* kernel, void (*body)(void*), void* arguments) {
    Machine& m = machine();
    m.launch = launch;
    m.kernel = kernel;
    m.body = body;
    m.arguments = arguments;
    m.failed = false;
    m.random = launch->seed;
    m.threads = launch->threads;
    m.blocks = launch->blocks;
    m.thread = m.block = 0;
    if (m.threads == 0 || m.threads > MOST_THREADS || m.threads % WARP != 0 || m.blocks == 0)
        complain("%u blocks of %u threads", m.blocks, m.threads);
    if (m.failed) return 1;
    if (m.fibres.size() < m.threads) m.fibres.resize(m.threads);
    if (m.slots.size() < m.threads / WARP) m.slots.resize(m.threads / WARP);
    std::vector<u32> blocks, order;
    arrange(blocks, m.blocks);
    for (u32 b : blocks) {
        m.block = b;
        run_block(order);
        if (m.failed) break;
    }
    // Fibres that wait where they will never go on begin anew.
    if (m.failed)
        for (Fibre& f : m.fibres) f.begun = false;
    return m.failed ? 1 : 0;
}

/// An array argument: as the caller passes it.
struct Array {
    void* values;
    u64 bytes;
};

template <class T> struct Checked {
    T* values;
    u64 count;
    T& operator[](u64 i) const {
        if (i >= count) {
            complain("element %llu of an array of %llu", i, count);
            // Somewhere to write to; the launch ends when this thread waits or ends.
            static thread_local char nowhere[64];
            memset(nowhere, 0, sizeof nowhere);
            return *reinterpret_cast<T*>(nowhere);
        }
        return values[i];
    }
};

template <class T, u64 N> struct Shared {
    T values[N];
    u64 serial;
    void begin() {
        u64 now = machine().block_serial;
        if (serial == now) return;
        serial = now;
        memset(static_cast<void*>(values), 0xff, sizeof values);
    }
    T& operator[](u64 i) { return Checked<T>{values, N}[i]; }
};

template <class T> struct Argument {
    static T of(const void* at) {
        T v;
        memcpy(&v, at, sizeof v);
        return v;
    }
};
template <class T> struct Argument<Checked<T>> {
    static Checked<T> of(const void* at) {
        const Array* array = static_cast<const Array*>(at);
        return {static_cast<T*>(array->values), array->bytes / sizeof(T)};
    }
};

template <class... A> struct Call {
    void (*kernel)(A...);
    std::tuple<A...> arguments;
    static void body(void* self) {
        Call* call = static_cast<Call*>(self);
        std::apply(call->kernel, call->arguments);
    }
};

template <class... A, size_t... I>
int start(const char* name, void (*kernel)(A...), const Launch* l, void* const* arguments, u64 count,
          std::index_sequence<I...>) {
    Machine& m = machine();
    m.launch = l;
    m.kernel = name;
    m.failed = false;
    if (count != sizeof...(A)) {
        complain("takes %llu arguments, got %llu", (u64)sizeof...(A), count);
        return 1;
    }
    Call<A...> call{kernel, std::tuple<A...>(Argument<A>::of(arguments[I])...)};
    return run(l, name, Call<A...>::body, &call);
}

template <class... A>
int start(const char* name, void (*kernel)(A...), const Launch* l, void* const* arguments, u64 count) {
    return start(name, kernel, l, arguments, count, std::index_sequence_for<A...>());
}

/// Shows a value to the other lanes; then `get(lane)` is what another one shows.
struct Shown {
    u64* values;
    u64 get(u32 lane) const { return values[lane & (WARP - 1)]; }
};
inline Shown show(u64 value, int line) {
    Machine& m = machine();
    Fibre& self = m.fibres[m.thread];
    u64* values = m.slots[m.thread / WARP].values[self.turn & 1];
    values[m.thread % WARP] = value;
    self.turn++;
    pause(IN_WARP, line);
    return {values};
}

template <class T> u64 raw(T v) {
    u64 bits = 0;
    memcpy(&bits, &v, sizeof v);
    return bits;
}
template <class T> T unraw(u64 bits) {
    T v;
    memcpy(&v, &bits, sizeof v);
    return v;
}

} // namespace grid

#define ENTRY(name)                                                                                    \
    extern "C" int emulate_##name(const grid::Launch* launch, void* const* arguments, u64 count) {   \
        return grid::start(#name, name, launch, arguments, count);                                   \
    }

template <class T> using In = grid::Checked<const T>;
template <class T> using Out = grid::Checked<T>;

DEVICE u32 thread_index() { return grid::machine().thread; }
DEVICE u32 block_index() { return grid::machine().block; }
DEVICE u32 block_threads() { return grid::machine().threads; }
DEVICE u32 grid_blocks() { return grid::machine().blocks; }

template <class T> DEVICE T warp_xor(T v, u32 mask) {
    u32 lane = thread_index() % WARP;
    return grid::unraw<T>(grid::show(grid::raw(v), -1).get(lane ^ mask));
}
DEVICE u32 warp_votes(bool v) {
    grid::Shown all = grid::show(v, -2);
    u32 votes = 0;
    for (u32 lane = 0; lane < WARP; lane++) votes |= (u32)all.get(lane) << lane;
    return votes;
}

DEVICE u32 add_atomically(u32& at, u32 v) { u32 old = at; at = old + v; return old; }
DEVICE u64 add_atomically(u64& at, u64 v) { u64 old = at; at = old + v; return old; }
DEVICE u32 minimum_atomically(u32& at, u32 v) { u32 old = at; at = v < old ? v : old; return old; }
DEVICE u64 exchange_atomically(u64& at, u64 expected, u64 v) {
    u64 old = at;
    if (old == expected) at = v;
    return old;
}

DEVICE u32 bits_of(float v) { return (u32)grid::raw(v); }
DEVICE float float_of(u32 v) { return grid::unraw<float>(v); }
DEVICE u32 ones(u32 v) { return (u32)__builtin_popcount(v); }
DEVICE u32 leading_zeros(u32 v) { return v == 0 ? 32 : (u32)__builtin_clz(v); }
DEVICE float fused(float a, float b, float c) { return std::fma(a, b, c); }
DEVICE float square_root(float v) { return std::sqrt(v); }
DEVICE double square_root(double v) { return std::sqrt(v); }
DEVICE float nearest_even(float v) { return std::nearbyint(v); }
DEVICE double floor_of(double v) { return std::floor(v); }
DEVICE float floor_of(float v) { return std::floor(v); }
DEVICE float ceil_of(float v) { return std::ceil(v); }
DEVICE void sine_cosine(double v, double& sine, double& cosine) {
    sine = std::sin(v);
    cosine = std::cos(v);
}

/// The product that a tensor core makes, by the layout of the words that `grid.h` states; sums in f32.
DEVICE void multiply_16x8x16(float (&d)[4], const u32 (&a)[4], const u32 (&b)[2]) {
    u32 rows[16][8], columns[8][8];
    for (u32 part = 0; part < 4; part++) {
        grid::Shown all = grid::show(a[part], -3);
        for (u32 lane = 0; lane < WARP; lane++)
            rows[lane / 4 + part % 2 * 8][lane % 4 + part / 2 * 4] = (u32)all.get(lane);
    }
    for (u32 part = 0; part < 2; part++) {
        grid::Shown all = grid::show(b[part], -4);
        for (u32 lane = 0; lane < WARP; lane++) columns[lane / 4][lane % 4 + part * 4] = (u32)all.get(lane);
    }
    u32 lane = thread_index() % WARP;
    for (u32 i = 0; i < 4; i++) {
        u32 row = lane / 4 + i / 2 * 8, column = lane % 4 * 2 + i % 2;
        float sum = 0.0f;
        for (u32 k = 0; k < 16; k++) {
            u32 shift = k % 2 * 16;
            float x = float_of(rows[row][k / 2] >> shift << 16), y = float_of(columns[column][k / 2] >> shift << 16);
            sum += x * y;
        }
        d[i] += sum;
    }
}

#endif
