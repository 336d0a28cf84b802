// What the processor at hand can do and what the compiler may assume of loops. One statement for every source file.
#pragma once

#include <cstddef>

#if defined(__x86_64__) && defined(__GNUC__)
#define BINOCAL_X86 1
#else
#define BINOCAL_X86 0
#endif

// Of functions and of lambdas: they become part of their caller, and are compiled for its instruction set.
#if defined(__GNUC__)
#define BINOCAL_INLINE [[gnu::always_inline]] inline
#define BINOCAL_INLINE_LAMBDA __attribute__((always_inline))
#elif defined(_MSC_VER)
#define BINOCAL_INLINE __forceinline
#define BINOCAL_INLINE_LAMBDA
#else
#define BINOCAL_INLINE inline
#define BINOCAL_INLINE_LAMBDA
#endif

// Of pointers: nothing is reached through another one.
#if defined(_MSC_VER)
#define BINOCAL_APART __restrict
#else
#define BINOCAL_APART __restrict__
#endif

// Of loops: the iterations do not depend on one another.
#if defined(__clang__)
#define BINOCAL_INDEPENDENT _Pragma("clang loop vectorize(assume_safety)")
#elif defined(__GNUC__)
#define BINOCAL_INDEPENDENT _Pragma("GCC ivdep")
#else
#define BINOCAL_INDEPENDENT __pragma(loop(ivdep))
#endif

// Defines void name(const Task&, first, last), which calls the widest copy of body<lanes>(task, first, last). One build serves
// every x86-64 machine: hot functions are compiled three times. Elsewhere the compiler's baseline (NEON on Arm) is all there is.
#if BINOCAL_X86
#define BINOCAL_V3 __attribute__((target("arch=x86-64-v3")))
#define BINOCAL_V4 __attribute__((target("arch=x86-64-v4")))
#define BINOCAL_DISPATCH(name, Task, ...)                                                                             \
    BINOCAL_V4 void name##_v4(const Task& task, std::size_t first, std::size_t last) { constexpr int lanes = 8; __VA_ARGS__; } \
    BINOCAL_V3 void name##_v3(const Task& task, std::size_t first, std::size_t last) { constexpr int lanes = 4; __VA_ARGS__; } \
    void name##_v2(const Task& task, std::size_t first, std::size_t last) { constexpr int lanes = 4; __VA_ARGS__; }    \
    void name(const Task& task, std::size_t first, std::size_t last) {                                                \
        static const auto widest = has_avx512() ? name##_v4 : has_avx2() ? name##_v3 : name##_v2;                     \
        widest(task, first, last);                                                                                    \
    }
#else
#define BINOCAL_DISPATCH(name, Task, ...)                                                                             \
    void name(const Task& task, std::size_t first, std::size_t last) { constexpr int lanes = 4; __VA_ARGS__; }
#endif

namespace binocal {

#if BINOCAL_X86
// AVX2 with what came along with it: fused multiply-add and the bit manipulations (Haswell and later).
inline bool has_avx2() {
    static const bool has = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") && __builtin_cpu_supports("bmi") &&
                            __builtin_cpu_supports("bmi2");
    return has;
}

inline bool has_avx512() {
    static const bool has = __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512cd") &&
                            __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl");
    return has;
}
#endif

}  // namespace binocal
