// Gram matrices of long columns.
#pragma once

#include "cpu.hpp"

#include <cstddef>
#include <cstring>

namespace binocal {

constexpr int kRun = 8;  // the longest vector, in doubles: columns are padded to whole ones

#if defined(__GNUC__)
template <int lanes>
struct VectorOf;
template <>
struct VectorOf<4> {
    typedef double type __attribute__((vector_size(32), aligned(8)));
    typedef long long index __attribute__((vector_size(32)));
};
template <>
struct VectorOf<8> {
    typedef double type __attribute__((vector_size(64), aligned(8)));
    typedef long long index __attribute__((vector_size(64)));
};
#if defined(__clang__)
#define BINOCAL_SHUFFLE(Index, a, b, ...) __builtin_shufflevector(a, b, __VA_ARGS__)
#else
#define BINOCAL_SHUFFLE(Index, a, b, ...) __builtin_shuffle(a, b, Index{__VA_ARGS__})
#endif

// The sums of four vectors' entries, ((0 + 1) + (2 + 3)) + ((4 + 5) + (6 + 7)) of each: a few shuffles for all of them.
template <int lanes>
BINOCAL_INLINE void store_sums(typename VectorOf<lanes>::type a, typename VectorOf<lanes>::type b,
                               typename VectorOf<lanes>::type c, typename VectorOf<lanes>::type d, double* out) {
    using Index [[maybe_unused]] = typename VectorOf<lanes>::index;
    if constexpr (lanes == 8) {
        const auto ab = BINOCAL_SHUFFLE(Index, a, b, 0, 8, 2, 10, 4, 12, 6, 14) +
                        BINOCAL_SHUFFLE(Index, a, b, 1, 9, 3, 11, 5, 13, 7, 15);
        const auto cd = BINOCAL_SHUFFLE(Index, c, d, 0, 8, 2, 10, 4, 12, 6, 14) +
                        BINOCAL_SHUFFLE(Index, c, d, 1, 9, 3, 11, 5, 13, 7, 15);
        const auto halves = BINOCAL_SHUFFLE(Index, ab, cd, 0, 1, 8, 9, 4, 5, 12, 13) +
                            BINOCAL_SHUFFLE(Index, ab, cd, 2, 3, 10, 11, 6, 7, 14, 15);
        const auto sums = halves + BINOCAL_SHUFFLE(Index, halves, halves, 4, 5, 6, 7, 0, 1, 2, 3);
        std::memcpy(out, &sums, 4 * sizeof(double));
    } else {
        const auto ab = BINOCAL_SHUFFLE(Index, a, b, 0, 4, 2, 6) + BINOCAL_SHUFFLE(Index, a, b, 1, 5, 3, 7);
        const auto cd = BINOCAL_SHUFFLE(Index, c, d, 0, 4, 2, 6) + BINOCAL_SHUFFLE(Index, c, d, 1, 5, 3, 7);
        const auto sums = BINOCAL_SHUFFLE(Index, ab, cd, 0, 1, 4, 5) + BINOCAL_SHUFFLE(Index, ab, cd, 2, 3, 6, 7);
        std::memcpy(out, &sums, sizeof sums);
    }
}
#endif

// The 4 x 4 products of the runs of a and of b, each run stride long (a multiple of kRun), to out with rows m apart.
template <int lanes>
BINOCAL_INLINE void dot_block(const double* a, const double* b, std::size_t stride, double* out, int m) {
#if defined(__GNUC__)
    using Vector = typename VectorOf<lanes>::type;
    auto load = [](const double* from) __attribute__((always_inline)) { return *reinterpret_cast<const Vector*>(from); };
    Vector s00{}, s01{}, s02{}, s03{}, s10{}, s11{}, s12{}, s13{}, s20{}, s21{}, s22{}, s23{}, s30{}, s31{}, s32{}, s33{};
    for (std::size_t j = 0; j < stride; j += lanes) {
        const Vector b0 = load(b + j), b1 = load(b + stride + j), b2 = load(b + 2 * stride + j),
                     b3 = load(b + 3 * stride + j);
        const Vector a0 = load(a + j);
        s00 += a0 * b0, s01 += a0 * b1, s02 += a0 * b2, s03 += a0 * b3;
        const Vector a1 = load(a + stride + j);
        s10 += a1 * b0, s11 += a1 * b1, s12 += a1 * b2, s13 += a1 * b3;
        const Vector a2 = load(a + 2 * stride + j);
        s20 += a2 * b0, s21 += a2 * b1, s22 += a2 * b2, s23 += a2 * b3;
        const Vector a3 = load(a + 3 * stride + j);
        s30 += a3 * b0, s31 += a3 * b1, s32 += a3 * b2, s33 += a3 * b3;
    }
    store_sums<lanes>(s00, s01, s02, s03, out);
    store_sums<lanes>(s10, s11, s12, s13, out + m);
    store_sums<lanes>(s20, s21, s22, s23, out + 2 * m);
    store_sums<lanes>(s30, s31, s32, s33, out + 3 * m);
#else
    double sums[4][4][lanes] = {};
    for (std::size_t j = 0; j < stride; j += lanes) {
        for (int i = 0; i < 4; ++i) {
            for (int k = 0; k < 4; ++k) {
                for (int l = 0; l < lanes; ++l) sums[i][k][l] += a[i * stride + j + l] * b[k * stride + j + l];
            }
        }
    }
    for (int i = 0; i < 4; ++i) {
        for (int k = 0; k < 4; ++k) {
            const double* s = sums[i][k];
            out[i * m + k] = (s[0] + s[1]) + (s[2] + s[3]);
        }
    }
#endif
}

// Upper triangle of J Jᵀ in 4 x 4 blocks, row-major in out (m, m). J has m rows of length stride, m a multiple of 4 and stride
// of kRun.
template <int lanes>
BINOCAL_INLINE void gram_matrix(const double* J, std::size_t stride, int m, double* out) {
    for (int row = 0; row < m; row += 4) {
        for (int column = row; column < m; column += 4) {
            dot_block<lanes>(J + row * stride, J + column * stride, stride, out + row * m + column, m);
        }
    }
}

}  // namespace binocal
