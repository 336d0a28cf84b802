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
// Grey values beyond the range's ends are clipped to them, the noise with them: where m is normal with the mean m0 = grey value and the
// noise's standard deviation, the value to expect at the top t is E[min(m, t)] = m0 - s (phi(z) + z Phi(z)), z = (m0 - t) / s (the mean
// of a censored normal: Greene 2012, Econometric Analysis, theorem 19.3), and it follows m0 by the share 1 - Phi(z) that is not clipped.
// A disc with clipped values is fitted by that expectation at both ends: values far beyond the top say no more than that they are there,
// and as the model is smooth and bounded, neither noise that was clipped nor a compression's ringing at the top pulls the corner. Edges of
// clipped paper seem to lie in the ink, on opposite arms of an edge towards opposite sides: that the arms are one line tells the paper's
// level, where blur and level alone would trade.
// An edge that a lens bends by a known curvature k has d = (n.u - k / 2 ((t.u)^2 + sigma^2)) / sigma, t along it: the last term
// is what blur moves a bent edge by, towards its centre of curvature.
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
#include <type_traits>

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
constexpr double kDiscShare = 0.85;  // of the reach, of the disc's radius
constexpr int kSide = 2 * kMaxRadius + 3;
constexpr int kMaxPixels = ((kSide * kSide + kLanes - 1) / kLanes) * kLanes;
constexpr int kMaxEvaluations = 25, kMaxClippedEvaluations = 40;  // a level that is clipped is found from far below
constexpr double kLastStep = 0.008;  // px
// In a large disc, whose many pixels make the cost smooth, a step need not be evaluated to be the last, its residuals being
// those that the Jacobian predicts, if it is short, px, or below this many standard deviations of the parameters together and
// so much shorter than the one before that the next would be nothing.
constexpr double kLastStepUnseen = 0.004, kLastStepOfSigma = 1, kLastStepAtMost = 0.03, kLastStepShrinks = 0.25;
constexpr double kLastClippedStepOfSigma = 0.3;  // of all parameters together: ended by the corner's own step, levels were 20 % off
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
    double long_variance;     // grey levels^2: of noise that is alike in neighbouring pixels, as it moves the corner; NaN if not measured
    double clipped_share;     // of the disc: pixels so near an end of the range that their noise is clipped
};
constexpr int kResultSize = 26;
static_assert(sizeof(CornerResult) == kResultSize * sizeof(double));

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
    bool is_clipped;  // holds values at an end of the range
    int n_vectors;
    int n_rows;
    struct {
        int u, v, first, n;  // leftmost pixel, where it stands in the arrays, and how many follow
    } rows[kSide];
    double x, y, radius;  // what was gathered
};

struct Region {
    double radius, strip;      // px: disc, and half width of the bands along the edges beyond which nothing counts
    double bend[2] = {0, 0};  // 1/px: the edges' curvatures, towards their normals
};

// The ends of the range, and the standard deviation of the noise before it is clipped there; in the patch's unit.
struct Clipping {
    double bottom, top, noise;
};
constexpr float kClear = 0.98f;  // of a change that is seen: pixels that show less are near an end of the range, their noise clipped
constexpr double kFirstNoise = 0.05, kMostNoise = 0.1;  // of the start's half contrast
constexpr double kLeastNoise_dn = 0.29;                 // rounding's
constexpr double kNoiseStep = 1.3;                      // the noise is taken anew where it has changed by more than this factor
constexpr int kLastNoiseEvaluation = 10;
constexpr double kMostTone = 0.45;
// In narrow bands beside markers the tone, the levels and the blur trade, and steps in them may end nowhere: a corner whose own step
// is that short is found.
constexpr double kSettled_px = 0.01;
constexpr double kBlurByOthers = 0.25;  // standard deviation of a log blur about that of the corners beside it

struct Equations {
    double gram[kColumns][kColumns];
    double weight_sum;   // of the pixels whose noise is not clipped
    double mean_square;  // of all residuals: what is minimised
    double noise2;       // mean square of the residuals that are not clipped
};

constexpr int kNear = 2;                  // px: noise further apart counts as independent
constexpr std::ptrdiff_t kCornersForNoise = 60;  // of an image, evenly chosen, are looked at for that: it costs a sixth of a fit
constexpr double kNearShare = 0.98, kNearLoss_px = 3.9;  // what the fit leaves of it in a disc: measured, see long_variance
constexpr double kLeastNearRadius = 8.0;  // px: in a smaller disc the fit itself takes most of such noise away

struct Workspace {
    Patch patch;
    alignas(32) float columns[kColumns][kMaxPixels];
    alignas(32) float weights[kMaxPixels];
    alignas(32) float moves[2][kMaxPixels];
    double disc, clear_squares;  // of a clipped patch: the sum of all weights, and of the squared residuals that are not clipped
};

// An image of (height, width) and the ends of its range: values there may be clipped.
template <typename Pixel>
struct ImageView {
    const Pixel* pixels;
    std::ptrdiff_t height, width;
    double bottom, top;  // infinite where nothing clips; of floats no range is known
};

constexpr double kSlack = 0.3;  // px: pixels are gathered again when the corner has moved farther

template <typename Pixel>
void gather(const ImageView<Pixel>& image, double x, double y, double radius, double scale, Patch& patch) {
    patch.x = x;
    patch.y = y;
    patch.radius = radius;
    patch.column = static_cast<int>(std::lround(x));
    patch.row = static_cast<int>(std::lround(y));
    const double limit = radius + 0.5 + kSlack;
    const float gain = static_cast<float>(scale);
    Pixel least = std::numeric_limits<Pixel>::max(), most = std::numeric_limits<Pixel>::lowest();
    int n = 0;
    patch.n_rows = 0;
    for (int row = static_cast<int>(std::ceil(y - limit)); row <= y + limit; ++row) {
        double half = std::sqrt(std::max(0.0, limit * limit - (row - y) * (row - y)));
        int first = static_cast<int>(std::ceil(x - half)), last = static_cast<int>(std::floor(x + half));
        const Pixel* line = image.pixels + row * image.width;
        float v = static_cast<float>(row - patch.row);
        patch.rows[patch.n_rows++] = {first - patch.column, row - patch.row, n, last - first + 1};
        if constexpr (std::is_integral_v<Pixel>) {
            for (int column = first; column <= last; ++column) {
                least = std::min(least, line[column]);
                most = std::max(most, line[column]);
            }
        }
        for (int column = first; column <= last; ++column, ++n) {
            patch.u[n] = static_cast<float>(column - patch.column);
            patch.v[n] = v;
            patch.value[n] = static_cast<float>(line[column]) * gain;
        }
    }
    patch.is_clipped = std::is_integral_v<Pixel> && (least <= image.bottom || most >= image.top);
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

inline void linearize(Workspace& work, const double* p, const Region& region, const Clipping& clipping) {
#if defined(BINOCAL_AVX2)
    if (has_avx2()) return avx2::linearize(work, p, region, clipping);
#endif
    portable::linearize(work, p, region, clipping);
}

inline void multiply(const Workspace& work, Equations& out) {
#if defined(BINOCAL_AVX2)
    if (has_avx2()) return avx2::multiply(work, out);
#endif
    portable::multiply(work, out);
}

inline void moves(Workspace& work, const float (&step)[2][kParameters], float (&squares)[2]) {
#if defined(BINOCAL_AVX2)
    if (has_avx2()) return avx2::moves(work, step, squares);
#endif
    portable::moves(work, step, squares);
}

inline float near_products(const Workspace& work, const float* values, int twice_x, int twice_y) {
#if defined(BINOCAL_AVX2)
    if (has_avx2()) return avx2::near_products(work, values, twice_x, twice_y);
#endif
    return portable::near_products(work, values, twice_x, twice_y);
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
//
// Where values are clipped the tone is held near none: a level beyond the range and a tone that saturates explain the same.
inline void information(const Equations& e, const double* p, bool is_clipped, double (&A)[kParameters][kParameters], double* gradient) {
    constexpr double kBlurSpread = 0.3;  // standard deviations; motion of 2 px at sigma 0.8 gives 0.25
    constexpr double kToneSpread = 0.15, kClippedToneSpread = 0.02;
    for (int i = 0; i < kParameters; ++i) {
        for (int j = 0; j < kParameters; ++j) A[i][j] = e.gram[i][j];
        gradient[i] = e.gram[i][kParameters];
    }
    const double spread = is_clipped ? kClippedToneSpread : kToneSpread;
    double blur = e.noise2 / (kBlurSpread * kBlurSpread), tone = e.noise2 / (spread * spread);
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
bool start(const ImageView<Pixel>& image, double x, double y, double radius, double* p, double& offset, double& contrast) {
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
            const Pixel* at = image.pixels + row * image.width + column;
            sum += (1 - b) * ((1 - a) * at[0] + a * at[1]) + b * ((1 - a) * at[image.width] + a * at[image.width + 1]);
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

// Variance of independent noise, in the residuals' units, that would scatter the corner as much as these residuals' noise does,
// which may be alike in neighbouring pixels (JPEG, smoothing, interpolation); NaN in a small disc.
//
// With b = a r, a being what a grey value moves the corner by and r its residual, the corner's variance is the sum of b(p) b(q)
// over pixels at most kNear apart in x and y (Newey & West 1987, in the plane), for independent noise the variance times the
// sum of a^2. The fit makes sums of b vanish, over each edge's arms above all, which takes its share from the first sum: of
// independent noise 0.57 and 0.70 are left at radii of 9.5 and 14 px (+-0.03 for blurs of 0.5 to 2 px), measured on
// rendered boards. What is even in r about the corner, as a blur of another shape leaves it, moves no corner: it makes b odd, and
// the products with pixels near the opposite point take it out again. Mean over the two edges' normals.
inline double long_variance(Workspace& work, const double (*to_corner)[kParameters], const double* p, double radius) {
    if (!(radius >= kLeastNearRadius)) return std::numeric_limits<double>::quiet_NaN();
    float step[2][kParameters], squares[2];
    for (int k : {0, 1})
        for (int j = 0; j < kParameters; ++j)
            step[k][j] = static_cast<float>(std::cos(p[kAngle1 + k]) * to_corner[1][j] - std::sin(p[kAngle1 + k]) * to_corner[0][j]);
    moves(work, step, squares);
    const int twice_x = static_cast<int>(std::lround(2 * (p[kX] - work.patch.column)));
    const int twice_y = static_cast<int>(std::lround(2 * (p[kY] - work.patch.row)));
    double total = 0;
    for (int k : {0, 1}) total += 0.5 * near_products(work, work.moves[k], twice_x, twice_y) / std::max(squares[k], 1e-30f);
    return total / (kNearShare - kNearLoss_px / radius);
}

struct CornerInput {
    double x, y;
    double reach;  // px to the nearest edge that is not the corner's own
    double strip;  // px from the corner's own edges to what is printed inside the squares; infinite if nothing is
};
constexpr int kInputSize = 4;
static_assert(sizeof(CornerInput) == kInputSize * sizeof(double));

// One corner's fit: damped least squares on a disc that grows and shrinks with what is found.
template <typename Pixel>
class CornerFitter {
  public:
    CornerFitter(const ImageView<Pixel>& image, const CornerInput& input, Workspace& work, bool looks_at_noise)
        : image_(image), input_(input), work_(work), looks_at_noise_(looks_at_noise),
          is_large_(kDiscShare * input.reach > 1.4 * kFirstRadius),
          greatest_(is_large_ ? kFirstRadius : kMaxRadius),  // a small disc until the corner is nearly there costs half or less
          farthest_(std::max(1.5, 0.5 * input.reach)) {}

    // All NaN where there is no corner.
    CornerResult fit() { return fit_from(begin()); }

    // From an earlier fit, with edges of these curvatures towards their normals, 1/px.
    CornerResult fit_bent(const CornerResult& first, const double (&bend)[2]) {
        greatest_ = kMaxRadius;
        std::copy(bend, bend + 2, region_.bend);
        return fit_from(begin(&first));
    }

    // From where the others' lens sees the corner, its edges in these directions, with the blur and the contrast of a corner beside it.
    //
    // A ring about a corner between narrow squares shows their markers, and bands that are hardly wider than the blur do not tell the
    // blur from the contrast.
    CornerResult fit_like(const CornerResult& other, const double (&edges)[2], const double (&bend)[2]) {
        greatest_ = kMaxRadius;
        std::copy(bend, bend + 2, region_.bend);
        prior_log_blur_ = 0.5 * std::log(other.blur1 * other.blur2);
        return fit_from(begin_like(other, edges));
    }

  private:
    enum class Progress { running, done, failed };

    CornerResult fit_from(bool has_begun) {
        CornerResult result;
        if (has_begun) {
            Progress progress = Progress::running;
            while (progress == Progress::running && n_evaluations_ < most_evaluations()) progress = iterate();
            const bool is_found = progress == Progress::done || (progress == Progress::running && is_settled());
            if (is_found && is_a_corner() && describe(result)) return result;
        }
        std::fill_n(reinterpret_cast<double*>(&result), kResultSize, std::numeric_limits<double>::quiet_NaN());
        return result;
    }

    int most_evaluations() const { return work_.patch.is_clipped ? kMaxClippedEvaluations : kMaxEvaluations; }

    struct Step {
        double change[kParameters], next[kParameters];
        double shrink;     // the share of `change` that is made
        double moved;      // px, of the corner
        double decrement;  // of the whole change: gradient times change
        // The blurs change by less than that, or stand at their bound.
        bool blurs_hold(double limit) const {
            return (std::fabs(change[kBlur1]) < limit || next[kBlur1] == kLeastLogBlur) &&
                   (std::fabs(change[kBlur2]) < limit || next[kBlur2] == kLeastLogBlur);
        }
    };

    // How far the disc may reach from there so that it and its soft edge stay inside the image, px.
    double margin(double x, double y) const {
        return std::min(std::min(x, image_.width - 1 - x), std::min(y, image_.height - 1 - y)) - 1.9;
    }

    Region region_of(double x, double y, double blur) const {
        double radius = std::min({greatest_, kDiscShare * input_.reach, input_.reach - 2 * blur});
        double strip = std::max(input_.strip - 2 * blur, 1.0);
        return Region{std::min(std::max(radius, kMinRadius), margin(x, y)), strip, {region_.bend[0], region_.bend[1]}};
    }

    // Region, first parameters and their cost, the parameters those of an earlier fit if there is one; false where the ring around
    // the start shows no saddle.
    bool begin(const CornerResult* first = nullptr) {
        if (!(std::isfinite(input_.x) && std::isfinite(input_.y) && input_.reach > 0 && input_.strip > 0)) return false;
        region_ = region_of(input_.x, input_.y, first ? std::max(first->blur1, first->blur2) : 1.0);
        if (!(region_.radius >= kMinRadius)) return false;
        double offset = 0;
        const double ring = std::min(region_.radius, std::max(kMinRadius, 1.8 * input_.strip));
        if (!start(image_, input_.x, input_.y, ring, p_, offset, contrast_)) return false;
        if (first) {
            p_[kAngle1] = first->angle1, p_[kAngle2] = first->angle2;
            p_[kBlur1] = std::log(first->blur1), p_[kBlur2] = std::log(first->blur2);
            p_[kContrast] = first->contrast / contrast_;
            p_[kSlopeX] = first->gx, p_[kSlopeY] = first->gy;
            if (first->clipped_share > 0) p_[kOffset] += p_[kContrast] - 1;  // the ring shows the ink's level, and clipped paper
        }
        work_.patch.radius = 0;  // holds another corner
        clipping_ = Clipping{image_.bottom / contrast_, image_.top / contrast_, kFirstNoise};
        cost_ = evaluate(p_, current_);
        n_evaluations_ = 1;
        return true;
    }

    // As begin, with edges and blur as told; the levels that fit them best.
    bool begin_like(const CornerResult& other, const double (&edges)[2]) {
        if (!(std::isfinite(input_.x) && std::isfinite(input_.y) && input_.reach > 0 && input_.strip > 0)) return false;
        const double blur = std::exp(prior_log_blur_);
        region_ = region_of(input_.x, input_.y, blur);
        if (!(region_.radius >= kMinRadius)) return false;
        contrast_ = std::fabs(other.contrast);
        if (!(contrast_ > 0)) return false;
        std::fill_n(p_, kParameters, 0.0);
        p_[kX] = input_.x, p_[kY] = input_.y;
        p_[kAngle1] = edges[0], p_[kAngle2] = edges[1];
        p_[kBlur1] = p_[kBlur2] = prior_log_blur_;
        p_[kContrast] = 1;
        work_.patch.radius = 0;
        clipping_ = Clipping{image_.bottom / contrast_, image_.top / contrast_, kFirstNoise};
        evaluate(p_, current_);
        const auto& G = current_.gram;
        const double determinant = G[kOffset][kOffset] * G[kContrast][kContrast] - G[kOffset][kContrast] * G[kOffset][kContrast];
        if (!(determinant > 1e-9 * G[kOffset][kOffset] * G[kContrast][kContrast])) return false;
        const double b[2] = {G[kOffset][kParameters], G[kContrast][kParameters]};
        p_[kOffset] += (G[kContrast][kContrast] * b[0] - G[kOffset][kContrast] * b[1]) / determinant;
        p_[kContrast] += (G[kOffset][kOffset] * b[1] - G[kOffset][kContrast] * b[0]) / determinant;
        cost_ = evaluate(p_, current_);
        n_evaluations_ = 2;
        return true;
    }

    // The information matrix and the gradient there, with all that is known beforehand.
    void inform(double (&A)[kParameters][kParameters], double* gradient) const {
        information(current_, p_, work_.patch.is_clipped, A, gradient);
        if (!std::isfinite(prior_log_blur_)) return;
        const double weight = current_.noise2 / (kBlurByOthers * kBlurByOthers);
        for (int i : {kBlur1, kBlur2}) A[i][i] += weight, gradient[i] -= weight * (p_[i] - prior_log_blur_);
    }

    // Where steps have ended nowhere beside markers: whether the corner's own is as good as none.
    bool is_settled() {
        if (!std::isfinite(input_.strip) || greatest_ != kMaxRadius) return false;
        if (!is_linearized_here_) cost_ = evaluate(p_, current_);
        is_linearized_here_ = true;
        damping_ = 0;
        Step step;
        return propose(step) && std::hypot(step.change[kX], step.change[kY]) < kSettled_px;
    }

    // Equations at these parameters, and the residuals' weighted mean square.
    BINOCAL_INLINE double evaluate(const double* at, Equations& equations) {
        const Patch& patch = work_.patch;
        if (patch.radius != region_.radius || std::hypot(at[kX] - patch.x, at[kY] - patch.y) > kSlack)
            gather(image_, at[kX], at[kY], region_.radius, 1 / contrast_, work_.patch);
        linearize(work_, at, region_, clipping_);
        multiply(work_, equations);
        const double squares = equations.gram[kParameters][kParameters];
        equations.mean_square = squares / std::max(patch.is_clipped ? work_.disc : equations.weight_sum, 1e-9);
        equations.noise2 =
            patch.is_clipped ? work_.clear_squares / std::max(equations.weight_sum, 1e-9) : equations.mean_square;
        return equations.mean_square;
    }

    BINOCAL_INLINE Progress iterate() {
        Step step;
        if (!propose(step)) return damp(1e-3, 1e6);
        if (!stays(step.next)) return Progress::failed;
        const bool may_end = greatest_ == kMaxRadius && step.shrink == 1 && damping_ < 0.1;
        if (is_large_ && may_end && is_short(step) && is_linearized_here_ && step.blurs_hold(0.01) && levels_hold(step)) {
            end_unseen(step);
            return Progress::done;
        }
        const double cost = evaluate(step.next, trial_);
        ++n_evaluations_;
        is_linearized_here_ = false;
        // Pixels enter and leave the disc as the corner moves: near the minimum a rise of that size is none.
        if (!(cost <= cost_ * (1 + 1e-6) || (step.moved < 0.05 && cost < cost_ * (1 + 3e-3)))) return damp(1e-2, 1e7);
        accept(step, cost);
        if (may_end && step.moved < kLastStep && step.blurs_hold(is_large_ ? 0.02 : 0.05) && levels_hold(step))
            return Progress::done;
        return follow(step.moved) ? Progress::running : Progress::failed;
    }

    // The damped step, shortened where it would be wild; false where its equations are singular.
    BINOCAL_INLINE bool propose(Step& step) const {
        double A[kParameters][kParameters], L[kParameters][kParameters], gradient[kParameters];
        inform(A, gradient);
        for (int i = 0; i < kParameters; ++i) A[i][i] *= 1 + damping_;
        if (!factorize(A, L)) return false;
        double* change = step.change;
        solve(L, gradient, change);
        if (hold_bounds(change, A, gradient)) {
            if (!factorize(A, L)) return false;
            solve(L, gradient, change);
        }
        const double length = std::hypot(change[kX], change[kY]);
        double shrink = 1;  // one step moves the corner by less than a third of the disc, turns by 0.4 rad, blurs by e^0.7
        shrink = std::min(shrink, std::max(1.0, region_.radius / 3) / std::max(1e-9, length));
        for (int i : {kAngle1, kAngle2}) shrink = std::min(shrink, 0.4 / std::max(1e-9, std::fabs(change[i])));
        for (int i : {kBlur1, kBlur2}) shrink = std::min(shrink, 0.7 / std::max(1e-9, std::fabs(change[i])));
        for (int i = 0; i < kParameters; ++i) step.next[i] = p_[i] + shrink * change[i];
        for (int i : {kBlur1, kBlur2}) step.next[i] = std::max(step.next[i], kLeastLogBlur);
        step.next[kTone] = std::min(kMostTone, std::max(-kMostTone, step.next[kTone]));
        step.shrink = shrink;
        step.moved = shrink * length;
        step.decrement = 0;
        for (int i = 0; i < kParameters; ++i) step.decrement += gradient[i] * change[i];
        return true;
    }

    // Holds the blurs and the tone where they stand at a bound and would go beyond: a step that counts on them never ends. Whether any do.
    bool hold_bounds(const double* change, double (&A)[kParameters][kParameters], double* gradient) const {
        bool holds = false;
        for (int i : {kBlur1, kBlur2, kTone}) {
            const bool is_beyond = i == kTone ? std::fabs(p_[i]) >= kMostTone && change[i] * p_[i] > 0
                                              : p_[i] <= kLeastLogBlur && change[i] < 0;
            if (!is_beyond) continue;
            for (int j = 0; j < kParameters; ++j) A[i][j] = A[j][i] = 0;
            A[i][i] = 1, gradient[i] = 0;
            holds = true;
        }
        return holds;
    }

    // Whether the corner stays near its start and in the image, if need be with a smaller disc.
    bool stays(const double* next) {
        const double left = margin(next[kX], next[kY]);
        if (left < region_.radius) {
            if (!(left >= kMinRadius)) return false;
            region_.radius = left;
            return true;
        }
        return !(std::hypot(next[kX] - input_.x, next[kY] - input_.y) > farthest_);
    }

    // So short that nothing would be seen by evaluating it.
    bool is_short(const Step& step) const {
        return step.moved < kLastStepUnseen || (step.moved < kLastStepAtMost && step.moved < kLastStepShrinks * last_moved_ &&
                                                step.decrement < kLastStepOfSigma * kLastStepOfSigma * current_.noise2);
    }

    // Where the paper is clipped its level is known from the edges alone, and found last.
    bool levels_hold(const Step& step) const {
        constexpr double most = kLastClippedStepOfSigma * kLastClippedStepOfSigma;
        return !work_.patch.is_clipped || step.decrement < most * current_.noise2;
    }

    // The last step, its residuals as the Jacobian predicts them.
    void end_unseen(Step& step) {
        for (int i = 0; i < kParameters; ++i) step.change[i] = step.next[i] - p_[i];
        subtract(work_, step.change);
        std::copy(step.next, step.next + kParameters, p_);
        current_.noise2 = std::max(current_.noise2 - step.decrement / current_.weight_sum, 0.0);
    }

    Progress damp(double least, double most) {
        damping_ = std::max(10 * damping_, least);
        return damping_ > most ? Progress::failed : Progress::running;
    }

    void accept(const Step& step, double cost) {
        is_linearized_here_ = true;
        last_moved_ = step.moved;
        std::copy(step.next, step.next + kParameters, p_);
        current_ = trial_;
        cost_ = cost;
        if (work_.patch.is_clipped) follow_noise();
        damping_ = std::max(damping_ * 0.1, 1e-6);
    }

    // The noise that is clipped is that of the pixels where it is not.
    void follow_noise() {
        const double left = std::max(current_.weight_sum - kParameters, 0.25 * current_.weight_sum);
        const double found = std::sqrt(current_.noise2 * current_.weight_sum / std::max(left, 1.0));
        const double noise = std::max(std::min(found, kMostNoise), kLeastNoise_dn / contrast_);
        if (n_evaluations_ >= kLastNoiseEvaluation || std::fabs(std::log(noise / clipping_.noise)) < std::log(kNoiseStep)) return;
        clipping_.noise = noise;
        cost_ = evaluate(p_, current_);
        ++n_evaluations_;
    }

    // The disc follows the blur that is found, then stays; false where the image leaves no place for one.
    bool follow(double moved) {
        if (moved < 0.3 || n_evaluations_ > 3) greatest_ = kMaxRadius;
        if (n_evaluations_ >= (is_large_ ? 8 : 6)) return true;
        const Region wanted = region_of(p_[kX], p_[kY], std::exp(std::max(p_[kBlur1], p_[kBlur2])));
        if (!(wanted.radius >= kMinRadius)) return false;
        if (std::fabs(wanted.radius - region_.radius) > 0.3 || std::fabs(wanted.strip - region_.strip) > 0.3) {
            region_ = wanted;
            cost_ = evaluate(p_, current_);
            ++n_evaluations_;
        }
        return true;
    }

    // Contrast, the edges' angle and their blur are those of a corner.
    bool is_a_corner() const {
        const double skew = std::fabs(std::sin(p_[kAngle1] - p_[kAngle2]));
        return std::fabs(p_[kContrast]) > 0.2 && !(skew < 0.17) &&
               !(std::exp(std::max(p_[kBlur1], p_[kBlur2])) > region_.radius + 0.5);
    }

    // What is written of the fit; false where its information is singular.
    bool describe(CornerResult& r) const {
        double A[kParameters][kParameters], L[kParameters][kParameters], gradient[kParameters], inverse[4][kParameters];
        inform(A, gradient);
        if (!factorize(A, L)) return false;
        constexpr Parameter shown[4] = {kX, kY, kSlopeX, kSlopeY};
        for (int i = 0; i < 4; ++i) {
            double unit[kParameters] = {};
            unit[shown[i]] = 1;
            solve(L, unit, inverse[i]);
        }
        const double unit = contrast_ * contrast_;  // grey levels^2
        r.x = p_[kX], r.y = p_[kY];
        r.gx = p_[kSlopeX], r.gy = p_[kSlopeY];
        for (int i = 0, k = 0; i < 4; ++i)
            for (int j = i; j < 4; ++j) r.covariance[k++] = inverse[i][shown[j]] / unit;
        r.variance = current_.noise2 * current_.weight_sum / std::max(1.0, current_.weight_sum - kParameters) * unit;
        r.odd_variance = odd_variance(work_, p_, r.variance / unit) * unit;
        r.long_variance = looks_at_noise_ ? long_variance(work_, inverse, p_, region_.radius) * unit
                                          : std::numeric_limits<double>::quiet_NaN();
        r.contrast = p_[kContrast] * contrast_;
        r.blur1 = std::exp(p_[kBlur1]), r.blur2 = std::exp(p_[kBlur2]);
        r.angle1 = p_[kAngle1], r.angle2 = p_[kAngle2];
        r.radius = region_.radius;
        r.n_pixels = current_.weight_sum;
        r.clipped_share = work_.patch.is_clipped ? 1 - current_.weight_sum / std::max(work_.disc, 1e-9) : 0;
        r.n_evaluations = n_evaluations_;
        return true;
    }

    const ImageView<Pixel>& image_;
    CornerInput input_;
    Workspace& work_;
    bool looks_at_noise_;  // whether its neighbouring pixels' noise is alike
    bool is_large_;
    double greatest_;   // px, of the disc's radius
    double farthest_;   // px, from the start
    Region region_{};
    Clipping clipping_{};
    double p_[kParameters]{};
    double prior_log_blur_ = std::numeric_limits<double>::quiet_NaN();  // by the corners beside it; NaN: nothing is known
    double contrast_ = 0;  // of the start, grey levels: the unit of values and costs
    Equations current_, trial_;
    double cost_ = 0, damping_ = 1e-3;
    double last_moved_ = std::numeric_limits<double>::infinity();
    bool is_linearized_here_ = true;  // the Jacobian in the workspace is that of p
    int n_evaluations_ = 0;
};

// One in `every` of the numbers, spread so that they never fall on one row or column of a grid.
inline bool is_picked(std::ptrdiff_t i, std::ptrdiff_t every) {
    return (static_cast<std::uint32_t>(i) * 2654435761u >> 8) % static_cast<std::uint32_t>(every) == 0;
}

template <typename Pixel>
void fit_corners(const ImageView<Pixel>& image, const CornerInput* inputs, std::ptrdiff_t n, CornerResult* results) {
    alignas(32) static thread_local Workspace work;
    const std::ptrdiff_t every = (n + kCornersForNoise - 1) / kCornersForNoise;
    for (std::ptrdiff_t i = 0; i < n; ++i) {
        results[i] = CornerFitter<Pixel>(image, inputs[i], work, is_picked(i, every)).fit();
    }
}

}  // namespace binocal
