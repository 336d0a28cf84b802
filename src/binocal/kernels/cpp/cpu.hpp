// What the processor at hand can do. One statement for every dispatch to wider copies of a loop.
#pragma once

#if defined(__x86_64__) && defined(__GNUC__)
#define BINOCAL_X86 1
#else
#define BINOCAL_X86 0
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
