// Maximum-likelihood fit of a blurred saddle to the grey values around a corner.
//
// Model. Two straight edges with unit normals n1, n2 cross at c; the print is s = sign(n1.u) sign(n2.u), u = x - c.
// A Gaussian blur turns it into F(d1, d2, rho) = E[sign(d1 + z1) sign(d2 + z2)], d_i = n_i.u / sigma_i, with z normal of
// unit variance and correlation rho = n1.n2. By Price's theorem (1958), dF/drho = 4 phi2(d1, d2; rho), so
//   F = erf(d1 / sqrt 2) erf(d2 / sqrt 2) + (2 / pi) int_0^asin(rho) exp(-(d1^2 + d2^2 - 2 d1 d2 sin t) / (2 cos^2 t)) dt,
// which is exact for skewed edges too. Grey value = (a + b G)(1 + g.u) with G = F + q (1 - F^2).
// Eleven parameters: c (2), two edge angles, two log blurs, a, b, g (2), q. Each edge has its own blur, for motion; q is the
// first order of a tone curve (gamma, saturation). Both are even under u -> -u, as all but c and g are, so they cost the
// position nothing. Pixel integration adds 1/12 px^2 to the blurs' squares, which the fit absorbs.
#pragma once

#include "cpu.hpp"
#include "linear_algebra.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <limits>

// The two inner loops are compiled twice where the compiler can: for every machine, and for those with AVX2.
// (target_clones would be shorter, but GCC splits vectors for the plain machine before it clones: 4 times slower.)
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__)
#define BINOCAL_AVX2 1
#endif
namespace binocal {

constexpr int kLanes = 8;
constexpr int kParameters = 11;
constexpr int kColumns = kParameters + 1;  // the residual is the last column of the Jacobian
constexpr int kMaxRadius = 14;             // beyond it lens curvature costs more than the additional edge length gains
constexpr double kMinRadius = 2.5;
constexpr double kFirstRadius = 7;
constexpr int kSide = 2 * kMaxRadius + 3;
constexpr int kMaxPixels = ((kSide * kSide + kLanes - 1) / kLanes) * kLanes;
constexpr int kMaxEvaluations = 25;
constexpr double kLastStep = 0.008;  // px
// In a large disc, whose many pixels make the cost smooth, a step need not be evaluated to be the last, its residuals being
// those that the Jacobian predicts, if it is short, px, or below this many standard deviations of the parameters together and
// so much shorter than the one before that the next would be nothing.
constexpr double kLastStepUnseen = 0.004, kLastStepOfSigma = 1, kLastStepAtMost = 0.03, kLastStepShrinks = 0.25;
constexpr double kLeastLogBlur = -1.386;  // ln 0.25: pixel integration alone is 0.29 px, a sharpened image's less

enum Parameter { kX, kY, kAngle1, kAngle2, kBlur1, kBlur2, kOffset, kContrast, kSlopeX, kSlopeY, kTone };

// What is written per corner; all NaN where the fit failed.
struct CornerResult {
    double x, y;
    double gx, gy;            // relative slope of the light, per px
    double covariance[10];    // of x, y, gx, gy (upper triangle, row by row) for pixel noise of 1 grey level
    double odd_variance;      // grey levels^2: residuals' part that is odd about the corner; noise, or a model that does not hold
    double variance;          // grey levels^2: all residuals
    double contrast;          // b, grey levels: half of bright minus dark
    double blur1, blur2;      // px, pixel integration included
    double angle1, angle2;    // rad, of the edges
    double radius, n_pixels;  // px, and the sum of the weights
    double n_evaluations;
};
constexpr int kResultSize = 24;

// Gauss-Legendre nodes and weights on [0, 1].
struct Quadrature {
    int n;
    float node[6], weight[6];
};
inline const Quadrature& quadrature_for(double rho) {
    // F to 2e-4 for every rho below the limit that each is used for.
    static const Quadrature two{2, {0.2113249f, 0.7886751f}, {0.5f, 0.5f}};
    static const Quadrature four{4, {0.0694318f, 0.3300095f, 0.6699905f, 0.9305682f},
                                 {0.1739274f, 0.3260726f, 0.3260726f, 0.1739274f}};
    static const Quadrature six{6, {0.0337652f, 0.1693953f, 0.3806904f, 0.6193096f, 0.8306047f, 0.9662348f},
                                {0.0856622f, 0.1803808f, 0.2339570f, 0.2339570f, 0.1803808f, 0.0856622f}};
    double size = std::fabs(rho);
    return size < 0.35 ? two : size < 0.75 ? four : six;
}

struct alignas(32) Patch {
    float u[kMaxPixels], v[kMaxPixels];  // whole pixels from `column`, `row`
    float value[kMaxPixels];             // in units of the start's contrast
    int column, row;
    int n_vectors;
    double x, y, radius;  // what was gathered
};

struct Region {
    double radius, strip;  // px: disc, and half width of the bands along the edges beyond which nothing counts
};

struct Equations {
    double gram[kColumns][kColumns];
    double weight_sum;
};

struct Workspace {
    Patch patch;
    alignas(32) float columns[kColumns][kMaxPixels];
    alignas(32) float weights[kMaxPixels];
};

constexpr double kSlack = 0.3;  // px: pixels are gathered again when the corner has moved farther

template <typename Pixel>
void gather(const Pixel* image, std::ptrdiff_t width, double x, double y, double radius, double scale, Patch& patch) {
    patch.x = x;
    patch.y = y;
    patch.radius = radius;
    patch.column = static_cast<int>(std::lround(x));
    patch.row = static_cast<int>(std::lround(y));
    const double limit = radius + 0.5 + kSlack;
    const float gain = static_cast<float>(scale);
    int n = 0;
    for (int row = static_cast<int>(std::ceil(y - limit)); row <= y + limit; ++row) {
        double half = std::sqrt(std::max(0.0, limit * limit - (row - y) * (row - y)));
        int first = static_cast<int>(std::ceil(x - half)), last = static_cast<int>(std::floor(x + half));
        const Pixel* line = image + row * width;
        float v = static_cast<float>(row - patch.row);
        for (int column = first; column <= last; ++column, ++n) {
            patch.u[n] = static_cast<float>(column - patch.column);
            patch.v[n] = v;
            patch.value[n] = static_cast<float>(line[column]) * gain;
        }
    }
    while (n % kLanes) {
        patch.u[n] = patch.v[n] = 1000.0f;  // outside every disc
        patch.value[n] = 0.0f;
        ++n;
    }
    patch.n_vectors = n / kLanes;
}

namespace portable {
#include "corner_fit_loops.hpp"
}
#if defined(BINOCAL_AVX2)
#pragma GCC push_options
#pragma GCC target("avx2,fma")
namespace avx2 {
#include "corner_fit_loops.hpp"
}
#pragma GCC pop_options
#endif

inline void linearize(Workspace& work, const double* p, const Region& region) {
#if defined(BINOCAL_AVX2)
    if (has_avx2()) return avx2::linearize(work, p, region);
#endif
    portable::linearize(work, p, region);
}

inline void multiply(const Workspace& work, Equations& out) {
#if defined(BINOCAL_AVX2)
    if (has_avx2()) return avx2::multiply(work, out);
#endif
    portable::multiply(work, out);
}

// A step's equations are factorised; false where they are not positive definite.
inline bool factorize(const double (&A)[kParameters][kParameters], double (&L)[kParameters][kParameters]) {
    return cholesky(&A[0][0], &L[0][0], kParameters, kParameters, 1e-12);
}

inline void solve(const double (&L)[kParameters][kParameters], const double* b, double* x) {
    solve_lower(&L[0][0], kParameters, kParameters, b, x);
    solve_upper(&L[0][0], kParameters, kParameters, x);
}

// The information matrix, with weak priors on what small windows cannot tell: the two blurs' difference and the tone.
inline void information(const Equations& e, const double* p, double noise2, double (&A)[kParameters][kParameters],
                        double* gradient) {
    constexpr double kBlurSpread = 0.3, kToneSpread = 0.15;  // standard deviations; motion of 2 px at sigma 0.8 gives 0.25
    for (int i = 0; i < kParameters; ++i) {
        for (int j = 0; j < kParameters; ++j) A[i][j] = e.gram[i][j];
        gradient[i] = e.gram[i][kParameters];
    }
    double blur = noise2 / (kBlurSpread * kBlurSpread), tone = noise2 / (kToneSpread * kToneSpread);
    double difference = p[kBlur1] - p[kBlur2];
    A[kBlur1][kBlur1] += blur;
    A[kBlur2][kBlur2] += blur;
    A[kBlur1][kBlur2] -= blur;
    A[kBlur2][kBlur1] -= blur;
    gradient[kBlur1] -= blur * difference;
    gradient[kBlur2] += blur * difference;
    A[kTone][kTone] += tone;
    gradient[kTone] -= tone * p[kTone];
}

// The residuals after a step, as the Jacobian predicts them.
inline void subtract(Workspace& work, const double* step) {
    for (int k = 0; k < kParameters; ++k) {
        const float size = static_cast<float>(step[k]);
        for (int i = 0; i < work.patch.n_vectors * kLanes; ++i) work.columns[kParameters][i] -= size * work.columns[k][i];
    }
}

// Where edges, levels and contrast begin, read on two rings around the corner; false where there is no saddle.
template <typename Pixel>
bool start(const Pixel* image, std::ptrdiff_t width, double x, double y, double radius, double* p, double& offset,
           double& contrast) {
    constexpr int n = 32;  // over half a turn: opposite samples are averaged
    constexpr double pi = 3.14159265358979;
    static const auto circle = [] {
        std::array<std::array<double, 2>, n> points;
        for (int k = 0; k < n; ++k) points[k] = {std::cos(pi * k / n), std::sin(pi * k / n)};
        return points;
    }();
    double ring[n];
    for (int k = 0; k < n; ++k) {
        double c = circle[k][0], s = circle[k][1], sum = 0;
        for (double r : {0.55 * radius, 0.8 * radius, -0.55 * radius, -0.8 * radius}) {
            double px = x + r * c, py = y + r * s;  // positive: the ring lies inside the image
            int column = static_cast<int>(px), row = static_cast<int>(py);
            double a = px - column, b = py - row;
            const Pixel* at = image + row * width + column;
            sum += (1 - b) * ((1 - a) * at[0] + a * at[1]) + b * ((1 - a) * at[width] + a * at[width + 1]);
        }
        ring[k] = sum / 4;
    }
    double sorted[n];
    std::copy(ring, ring + n, sorted);
    std::sort(sorted, sorted + n);
    double dark = (sorted[2] + sorted[3] + sorted[4]) / 3, bright = (sorted[n - 3] + sorted[n - 4] + sorted[n - 5]) / 3;
    offset = 0.5 * (dark + bright);
    contrast = 0.5 * (bright - dark);
    if (!(contrast > 0)) return false;
    double re = 0, im = 0, share = 0;
    for (int k = 0; k < n; ++k) {
        double level = std::min(1.0, std::max(-1.0, (ring[k] - offset) / contrast));
        re += level * (circle[k][0] * circle[k][0] - circle[k][1] * circle[k][1]);  // cosine and sine of twice the angle
        im += level * 2 * circle[k][0] * circle[k][1];
        share += 0.5 + 0.5 * level;
    }
    // A square wave of half the period has 0.64 n there; a corner that is no saddle far less.
    if (std::hypot(re, im) < 0.15 * n) return false;
    double middle = 0.5 * std::atan2(im, re), opening = pi * std::min(0.85, std::max(0.15, share / n));
    p[kX] = x;
    p[kY] = y;
    p[kAngle1] = middle - opening / 2;
    p[kAngle2] = middle + opening / 2 + pi;  // so that the sign is positive between the two
    p[kBlur1] = p[kBlur2] = std::log(std::min(1.3, 0.4 * radius));
    p[kOffset] = offset / contrast;  // the true level: the slopes are the light's, which multiplies black and white alike
    p[kContrast] = 1;
    p[kSlopeX] = p[kSlopeY] = p[kTone] = 0;
    return true;
}

// Mean square of what is odd in the residuals about the corner. Misfits of blur shape and tone are even and drop out.
inline double odd_variance(const Workspace& work, const double* p, double mean_square) {
    float grid[kSide][kSide];
    std::fill_n(&grid[0][0], kSide * kSide, std::numeric_limits<float>::quiet_NaN());
    constexpr int middle = kMaxRadius + 1;
    const Patch& patch = work.patch;
    for (int i = 0; i < patch.n_vectors * kLanes; ++i) {
        if (work.weights[i] < 0.999f) continue;
        grid[middle + static_cast<int>(patch.v[i])][middle + static_cast<int>(patch.u[i])] = work.columns[kParameters][i];
    }
    double x = 2 * (middle + p[kX] - patch.column), y = 2 * (middle + p[kY] - patch.row), sum = 0;
    int column0 = static_cast<int>(std::floor(x)), row0 = static_cast<int>(std::floor(y)), count = 0;
    float a = static_cast<float>(x - column0), b = static_cast<float>(y - row0);
    float w00 = (1 - a) * (1 - b), w01 = a * (1 - b), w10 = (1 - a) * b, w11 = a * b;
    double scale = 1 + w00 * w00 + w01 * w01 + w10 * w10 + w11 * w11;
    const int reach = static_cast<int>(std::ceil(patch.radius)) + 1;
    const int least = std::max(0, middle - reach), most = std::min(kSide - 1, middle + reach);
    for (int row = std::max(least, row0 + 2 - kSide); row <= std::min(most, row0); ++row) {
        const float *one = grid[row0 - row], *next = grid[row0 - row + 1];
        for (int column = std::max(least, column0 + 2 - kSide); column <= std::min(most, column0); ++column) {
            int c = column0 - column;
            float difference = grid[row][column] - (w00 * one[c] + w01 * one[c + 1] + w10 * next[c] + w11 * next[c + 1]);
            if (!(difference == difference)) continue;
            sum += difference * difference;
            ++count;
        }
    }
    if (count < 24) return mean_square;
    return sum / (count * scale) / (1 - std::min(0.5, 8.0 / count));  // half the pixels are odd, and four parameters took their share
}

struct CornerInput {
    double x, y;
    double reach;  // px to the nearest edge that is not the corner's own
    double strip;  // px from the corner's own edges to what is printed inside the squares; infinite if nothing is
};

template <typename Pixel>
CornerResult fit_corner(const Pixel* image, std::ptrdiff_t height, std::ptrdiff_t width, const CornerInput& input,
                        Workspace& work) {
    constexpr double nan = std::numeric_limits<double>::quiet_NaN();
    CornerResult failed;
    std::fill_n(reinterpret_cast<double*>(&failed), kResultSize, nan);
    if (!(std::isfinite(input.x) && std::isfinite(input.y) && input.reach > 0 && input.strip > 0)) return failed;

    auto room = [&](double x, double y) {  // the disc and its soft edge stay inside the image
        return std::min(std::min(x, width - 1 - x), std::min(y, height - 1 - y)) - 1.9;
    };
    const bool is_large = 0.85 * input.reach > 1.4 * kFirstRadius;
    double greatest = is_large ? kFirstRadius : kMaxRadius;  // a small disc until the corner is nearly there costs half or less
    auto region_of = [&](double x, double y, double blur) {
        double radius = std::min({greatest, 0.85 * input.reach, input.reach - 2 * blur});
        double strip = std::max(input.strip - 2 * blur, 1.0);
        return Region{std::min(std::max(radius, kMinRadius), room(x, y)), strip};
    };
    Region region = region_of(input.x, input.y, 1.0);
    if (!(region.radius >= kMinRadius)) return failed;
    double p[kParameters], offset = 0, contrast = 0;
    double ring = std::min(region.radius, std::max(kMinRadius, 1.8 * input.strip));
    if (!start(image, width, input.x, input.y, ring, p, offset, contrast)) return failed;

    auto evaluate = [&](const double* at, Equations& e) {
        const Patch& patch = work.patch;
        if (patch.radius != region.radius || std::hypot(at[kX] - patch.x, at[kY] - patch.y) > kSlack)
            gather(image, width, at[kX], at[kY], region.radius, 1 / contrast, work.patch);
        linearize(work, at, region);
        multiply(work, e);
        return e.gram[kParameters][kParameters] / std::max(e.weight_sum, 1e-9);
    };
    const double most = std::max(1.5, 0.5 * input.reach);
    Equations current, trial;
    work.patch.radius = 0;  // holds another corner
    double cost = evaluate(p, current), damping = 1e-3;
    bool is_done = false, is_linearized_here = true;  // the Jacobian in the workspace is that of p
    int n_evaluations = 1;
    double last_moved = std::numeric_limits<double>::infinity();
    while (!is_done && n_evaluations < kMaxEvaluations) {
        double A[kParameters][kParameters], L[kParameters][kParameters];
        double gradient[kParameters], step[kParameters], next[kParameters];
        information(current, p, cost, A, gradient);
        for (int i = 0; i < kParameters; ++i) A[i][i] *= 1 + damping;
        if (!factorize(A, L)) {
            damping = std::max(10 * damping, 1e-3);
            if (damping > 1e6) return failed;
            continue;
        }
        solve(L, gradient, step);
        double shrink = 1;  // one step moves the corner by less than a third of the disc, turns by 0.4 rad, blurs by e^0.7
        shrink = std::min(shrink, std::max(1.0, region.radius / 3) / std::max(1e-9, std::hypot(step[kX], step[kY])));
        for (int i : {kAngle1, kAngle2}) shrink = std::min(shrink, 0.4 / std::max(1e-9, std::fabs(step[i])));
        for (int i : {kBlur1, kBlur2}) shrink = std::min(shrink, 0.7 / std::max(1e-9, std::fabs(step[i])));
        for (int i = 0; i < kParameters; ++i) next[i] = p[i] + shrink * step[i];
        for (int i : {kBlur1, kBlur2}) next[i] = std::max(next[i], kLeastLogBlur);
        next[kTone] = std::min(0.45, std::max(-0.45, next[kTone]));
        if (std::hypot(next[kX] - input.x, next[kY] - input.y) > most || room(next[kX], next[kY]) < region.radius) {
            if (room(next[kX], next[kY]) < region.radius && room(next[kX], next[kY]) >= kMinRadius)
                region.radius = room(next[kX], next[kY]);
            else
                return failed;
        }
        double moved = shrink * std::hypot(step[kX], step[kY]), decrement = 0;
        for (int i = 0; i < kParameters; ++i) decrement += gradient[i] * step[i];
        auto blurs_hold = [&](double limit) {
            return (std::fabs(step[kBlur1]) < limit || next[kBlur1] == kLeastLogBlur) &&
                   (std::fabs(step[kBlur2]) < limit || next[kBlur2] == kLeastLogBlur);
        };
        const bool may_end = greatest == kMaxRadius && shrink == 1 && damping < 0.1;
        const bool is_short = moved < kLastStepUnseen || (moved < kLastStepAtMost && moved < kLastStepShrinks * last_moved &&
                                                          decrement < kLastStepOfSigma * kLastStepOfSigma * cost);
        if (is_large && may_end && is_short && is_linearized_here && blurs_hold(0.01)) {
            for (int i = 0; i < kParameters; ++i) step[i] = next[i] - p[i];
            subtract(work, step);
            std::copy(next, next + kParameters, p);
            cost = std::max(cost - decrement / current.weight_sum, 0.0);
            is_done = true;
            break;
        }
        double next_cost = evaluate(next, trial);
        ++n_evaluations;
        is_linearized_here = false;
        // Pixels enter and leave the disc as the corner moves: near the minimum a rise of that size is none.
        if (next_cost <= cost * (1 + 1e-6) || (moved < 0.05 && next_cost < cost * (1 + 3e-3))) {
            is_linearized_here = true;
            last_moved = moved;
            is_done = may_end && moved < kLastStep && blurs_hold(is_large ? 0.02 : 0.05);
            std::copy(next, next + kParameters, p);
            current = trial;
            cost = next_cost;
            damping = std::max(damping * 0.1, 1e-6);
            if (!is_done && (moved < 0.3 || n_evaluations > 3)) greatest = kMaxRadius;
            if (!is_done && n_evaluations < (is_large ? 8 : 6)) {  // the disc follows the blur that is found, then stays
                Region wanted = region_of(p[kX], p[kY], std::exp(std::max(p[kBlur1], p[kBlur2])));
                if (!(wanted.radius >= kMinRadius)) return failed;
                if (std::fabs(wanted.radius - region.radius) > 0.3 || std::fabs(wanted.strip - region.strip) > 0.3) {
                    region = wanted;
                    cost = evaluate(p, current);
                    ++n_evaluations;
                }
            }
        } else {
            damping = std::max(10 * damping, 1e-2);
            if (damping > 1e7) return failed;
        }
    }
    if (!is_done) return failed;
    double blur1 = std::exp(p[kBlur1]), blur2 = std::exp(p[kBlur2]);
    double skew = std::fabs(std::sin(p[kAngle1] - p[kAngle2]));
    if (!(std::fabs(p[kContrast]) > 0.2) || skew < 0.17 || std::max(blur1, blur2) > region.radius + 0.5)
        return failed;

    double A[kParameters][kParameters], L[kParameters][kParameters], gradient[kParameters], inverse[4][kParameters];
    information(current, p, cost, A, gradient);
    if (!factorize(A, L)) return failed;
    constexpr Parameter shown[4] = {kX, kY, kSlopeX, kSlopeY};
    for (int i = 0; i < 4; ++i) {
        double unit[kParameters] = {};
        unit[shown[i]] = 1;
        solve(L, unit, inverse[i]);
    }
    double unit = contrast * contrast;
    CornerResult r;
    r.x = p[kX];
    r.y = p[kY];
    r.gx = p[kSlopeX];
    r.gy = p[kSlopeY];
    for (int i = 0, k = 0; i < 4; ++i)
        for (int j = i; j < 4; ++j) r.covariance[k++] = inverse[i][shown[j]] / unit;
    r.variance = cost * current.weight_sum / std::max(1.0, current.weight_sum - kParameters) * unit;
    r.odd_variance = odd_variance(work, p, r.variance / unit) * unit;
    r.contrast = p[kContrast] * contrast;
    r.blur1 = blur1;
    r.blur2 = blur2;
    r.angle1 = p[kAngle1];
    r.angle2 = p[kAngle2];
    r.radius = region.radius;
    r.n_pixels = current.weight_sum;
    r.n_evaluations = n_evaluations;
    return r;
}

template <typename Pixel>
void fit_corners(const Pixel* image, std::ptrdiff_t height, std::ptrdiff_t width, const double* inputs, std::ptrdiff_t n,
                 double* results) {
    alignas(32) static thread_local Workspace work;
    static_assert(sizeof(CornerResult) == kResultSize * sizeof(double));
    for (std::ptrdiff_t i = 0; i < n; ++i) {
        CornerInput input{inputs[4 * i], inputs[4 * i + 1], inputs[4 * i + 2], inputs[4 * i + 3]};
        CornerResult result = fit_corner(image, height, width, input, work);
        std::memcpy(results + kResultSize * i, &result, sizeof(result));
    }
}

}  // namespace binocal
