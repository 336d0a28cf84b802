// Maximum-likelihood fit of a blurred quadrilateral to the grey values about its outline: the four corners of a printed square.
//
// Model. A quadrilateral of constant light on a ground of constant light. Edge i runs from corner i to the next one, clockwise as the image is
// seen; with z_i the signed distance to it over its blur, inward positive, and E_i = erf(z_i / sqrt 2), the blurred quadrilateral is
//   F = P(all four z_i + n_i > 0) = (E_0 + E_2) / 2 (E_1 + E_3) / 2 + sum over corners of T(z_i, z_j; rho),
// exact where opposite edges are farther apart than the blur: two edges that meet have jointly normal distances with rho = n_i.n_j, and
// T = (1 / 2 pi) int_0^asin(rho) exp(-(z_i^2 + z_j^2 - 2 z_i z_j sin t) / (2 cos^2 t)) dt is what their joint distribution has beyond the
// product (Price 1958, as in corner_fit.hpp). The grey value is (a + b (2 F - 1)) (1 + g.u).
// Fourteen parameters: the corners (8), ln of two blurs (of edges 0 and 2, and 1 and 3), a, b, g (2). Pixel integration adds 1/12 px^2 to the
// blurs' squares, which the fit absorbs. As in ellipse_fit.hpp light falls before the blur, so s^2 g is added to the corners, and pixels that
// clip, by what the fit expects of them, are left out.
// A lens bends an edge by a known bow: its image leaves the chord by t (1 - t) (k_0 + k_1 t + k_2 t^2) px inward, t from 0 to 1 along it.
#pragma once

#include "ellipse_fit.hpp"

namespace binocal {

constexpr int kSquareParameters = 14;
constexpr int kSquareColumns = 15;  // the residual is the last
enum SquareParameter { kSquareBlur1 = 8, kSquareBlur2, kSquareLevel, kSquareHalf, kSquareLightX, kSquareLightY };

constexpr double kLeastSquareSide = 4.0;   // px: of a smaller one the blur leaves no side
constexpr double kMostSquarePixels = 6e5;  // of the box about it
constexpr double kMostSquareRho = 0.94;    // edges that meet at less than 20 degrees
constexpr int kMaxSquareEvaluations = 20;
constexpr double kMostCornerStep_px = 3.0;  // in one step
constexpr double kSquareSlack = 0.4;        // px: pixels are gathered again when a corner has moved farther
// A last step is not evaluated: its residuals are those that the Jacobian predicts. Of all parameters together, in standard deviations.
constexpr double kLastSquareStep_px = 0.004, kLastSquareStepOfSigma = 0.3, kLastRoughStep_px = 0.1;
constexpr double kBowOfBand_px = 0.5;  // the band of pixels need not follow an edge that leaves its chord by less

// Corners to start from, clockwise as seen, the edges' bows, how far from each edge, px, nothing else is printed on the outside, the
// longest way, px, that a corner may go, and the blur to start with.
struct SquareInput {
    double corners[8];
    double bows[12];
    double outward[4];
    double reach;
    double blur;
};
constexpr int kSquareInputSize = 26;
static_assert(sizeof(SquareInput) == kSquareInputSize * sizeof(double));

// All NaN where the fit failed. The corners' records share everything but the point and its covariance.
struct SquareResult {
    CornerResult corners[4];
};
constexpr int kSquareResultSize = 4 * kResultSize;
static_assert(sizeof(SquareResult) == kSquareResultSize * sizeof(double));

struct SquareEdge {
    double x, y, tx, ty, length, bow[3];

    // Inward distance in px, and how far along.
    double distance(double px, double py, double& along) const {
        const double u = px - x, v = py - y;
        along = (tx * u + ty * v) / length;
        const double t = std::min(std::max(along, -0.5), 1.5);
        return tx * v - ty * u - t * (1 - t) * (bow[0] + t * (bow[1] + t * bow[2]));
    }
    // Leaves of the pixel columns from..to of a row those whose distance from the straight edge is at least so much.
    void cut(double row, double least, double& from, double& to) const {
        const double at_zero = tx * (row - y) + ty * x - least;  // of the distance less `least` at column 0; it changes by -ty a column
        if (std::fabs(ty) < 1e-9) {
            if (at_zero < 0) to = from - 1;
        } else if (ty > 0) {
            to = std::min(to, at_zero / ty);
        } else {
            from = std::max(from, at_zero / ty);
        }
    }
    // With the edge that begins where this one ends: the correlation of the two distances, and what it changes by when either edge turns.
    void meet(const SquareEdge& next, double& rho, double& to_this, double& to_next) const {
        // tangents there, of curves that leave the chord inward
        const double end = -(bow[0] + bow[1] + bow[2]) / length, start = next.bow[0] / next.length;
        const double ax = tx - end * ty, ay = ty + end * tx, bx = next.tx - start * next.ty, by = next.ty + start * next.tx;
        const double over = 1 / std::sqrt((ax * ax + ay * ay) * (bx * bx + by * by));
        rho = std::min(std::max((ax * bx + ay * by) * over, -kMostSquareRho), kMostSquareRho);
        const double sine = (ax * by - ay * bx) * over;  // of the turn from this edge to the next one
        to_this = sine, to_next = -sine;
    }
};

struct SquareEdges {
    SquareEdge edge[4];

    SquareEdges(const double* corners, const double* bows) {
        for (int i = 0; i < 4; ++i) {
            const double *from = corners + 2 * i, *to = corners + 2 * ((i + 1) % 4);
            const double dx = to[0] - from[0], dy = to[1] - from[1], length = std::max(std::hypot(dx, dy), 1e-6);
            edge[i] = {from[0], from[1], dx / length, dy / length, length, {bows[3 * i], bows[3 * i + 1], bows[3 * i + 2]}};
        }
    }
    // Whether every corner turns the same way, by 20 degrees at least, and no side is too short.
    bool is_convex() const {
        for (int i = 0; i < 4; ++i) {
            const SquareEdge &one = edge[i], &next = edge[(i + 1) % 4];
            if (!(one.length >= kLeastSquareSide) || !(one.tx * next.ty - one.ty * next.tx > 0.34)) return false;
        }
        return true;
    }
};

struct SquarePatch {
    int column, row;  // whole pixels from which u and v count
    int n_pixels, n_vectors, n_clipped;
    double corners[8], wide;  // what was gathered
};

class SquareWorkspace {
  public:
    SquarePatch patch{};
    void reserve(int n) {
        if (n <= capacity_) return;
        capacity_ = (n + kLanes - 1) / kLanes * kLanes;
        memory_.assign(static_cast<std::size_t>(capacity_) * (kSquareColumns + 3), 0.0f);
    }
    int capacity() const { return capacity_; }
    float* column(int k) { return memory_.data() + static_cast<std::size_t>(capacity_) * k; }
    float* u() { return column(kSquareColumns); }
    float* v() { return column(kSquareColumns + 1); }
    float* value() { return column(kSquareColumns + 2); }

  private:
    std::vector<float> memory_;
    int capacity_ = 0;
};

struct SquareEquations {
    double gram[kSquareColumns][kSquareColumns];
};

namespace portable {
#include "square_fit_loops.hpp"
}
#if defined(BINOCAL_AVX2)
#pragma GCC push_options
#pragma GCC target("avx2,fma")
namespace avx2 {
#include "square_fit_loops.hpp"
}
#pragma GCC pop_options
#endif

inline void evaluate(SquareWorkspace& work, const double* p, const SquareEdges& edges, SquareEquations& out) {
#if defined(BINOCAL_AVX2)
    if (has_avx2()) {
        avx2::linearize(work, p, edges);
        return avx2::multiply(work, out);
    }
#endif
    portable::linearize(work, p, edges);
    portable::multiply(work, out);
}

// One square's fit: damped least squares on a band about the outline, which follows what is found.
template <typename Pixel>
class SquareFitter {
  public:
    SquareFitter(const ImageView<Pixel>& image, const SquareInput& input, bool is_rough, SquareWorkspace& work)
        : image_(image), input_(input), work_(work), is_rough_(is_rough) {}

    SquareResult fit() {
        SquareResult result;
        if (!begin() || !iterate() || !leave_clipped_out() || !is_a_square() || !describe(result))
            std::fill_n(reinterpret_cast<double*>(&result), kSquareResultSize, std::numeric_limits<double>::quiet_NaN());
        return result;
    }

  private:
    double blur() const { return std::exp(std::max(p_[kSquareBlur1], p_[kSquareBlur2])); }
    static double band(double blur) { return std::max(kLeastBand, kBandPerBlur * blur + kBandBeyondBlur); }
    SquareEdges edges(const double* p) const { return {p, input_.bows}; }

    // Gathers the pixels of the band for which keeps(column, row, value) holds, every other one of a rough fit.
    template <typename Keeps>
    bool gather(double wide, const Keeps& keeps) {
        SquarePatch& patch = work_.patch;
        const SquareEdges lines = edges(p_);
        const double bow = farthest_bow(), slack = bow > kBowOfBand_px ? bow : 0;
        double low[2] = {p_[0], p_[1]}, high[2] = {p_[0], p_[1]}, outward[4];
        for (int i = 1; i < 4; ++i)
            for (int k : {0, 1}) low[k] = std::min(low[k], p_[2 * i + k]), high[k] = std::max(high[k], p_[2 * i + k]);
        for (int i = 0; i < 4; ++i) outward[i] = std::max(1.0, std::min(wide, input_.outward[i]));
        // Corners of the band lie farther off than its width, by the sine of half their angle.
        const double beyond = wide / 0.17 + slack;
        const auto first_row = std::max<std::ptrdiff_t>(0, static_cast<std::ptrdiff_t>(std::floor(low[1] - beyond)));
        const auto last_row = std::min<std::ptrdiff_t>(image_.height - 1, static_cast<std::ptrdiff_t>(std::ceil(high[1] + beyond)));
        if (!((high[0] - low[0] + 2 * beyond) * (high[1] - low[1] + 2 * beyond) < kMostSquarePixels)) return false;
        double length = 0;
        for (const SquareEdge& edge : lines.edge) length += edge.length + 8 * (wide + slack);
        work_.reserve(static_cast<int>(std::min((2 * wide + 2 * slack + 2) * length, (high[0] - low[0] + 2 * beyond) * (high[1] - low[1] + 2 * beyond))) + kLanes);
        std::copy(p_, p_ + 8, patch.corners);
        patch.wide = wide, patch.n_clipped = 0;
        float *u = work_.u(), *v = work_.v(), *value = work_.value();
        const int most = work_.capacity() - kLanes;
        int n = 0;
        auto take = [&](const Pixel* line, std::ptrdiff_t row, double from, double to) {
            auto first = std::max<std::ptrdiff_t>(0, static_cast<std::ptrdiff_t>(std::ceil(from)));
            if (is_rough_ && (first + row) % 2) ++first;
            const auto last = std::min<std::ptrdiff_t>(image_.width - 1, static_cast<std::ptrdiff_t>(std::floor(to)));
            for (std::ptrdiff_t column = first; column <= last && n < most; column += is_rough_ ? 2 : 1) {
                if (slack > 0 && !is_in_band(lines, column, row, outward, wide)) continue;
                if (!keeps(static_cast<double>(column), static_cast<double>(row), line[column])) {
                    ++patch.n_clipped;
                    continue;
                }
                u[n] = static_cast<float>(column - patch.column), v[n] = static_cast<float>(row - patch.row);
                value[n++] = static_cast<float>(line[column] * scale_);
            }
        };
        for (auto row = first_row; row <= last_row; ++row) {
            const Pixel* line = image_.pixels + row * image_.width;
            double from = -1e9, to = 1e9, hole_from = -1e9, hole_to = 1e9;
            for (int i = 0; i < 4; ++i) {
                lines.edge[i].cut(static_cast<double>(row), -outward[i] - slack, from, to);
                lines.edge[i].cut(static_cast<double>(row), wide + slack, hole_from, hole_to);
            }
            if (std::ceil(hole_from) <= std::floor(hole_to)) {
                take(line, row, from, std::ceil(hole_from) - 0.5);
                take(line, row, std::floor(hole_to) + 0.5, to);
            } else {
                take(line, row, from, to);
            }
        }
        patch.n_pixels = n;
        for (; n % kLanes; ++n) u[n] = v[n] = 1000.0f, value[n] = 0;
        patch.n_vectors = n / kLanes;
        return patch.n_pixels >= 4 * kSquareParameters;
    }

    static bool is_in_band(const SquareEdges& lines, std::ptrdiff_t column, std::ptrdiff_t row, const double* outward, double wide) {
        double nearest = std::numeric_limits<double>::infinity(), along;
        for (int i = 0; i < 4; ++i) {
            const double d = lines.edge[i].distance(static_cast<double>(column), static_cast<double>(row), along);
            if (d < -outward[i]) return false;
            nearest = std::min(nearest, d);
        }
        return nearest <= wide;
    }

    double farthest_bow() const {
        double most = 0;
        for (int i = 0; i < 4; ++i) most = std::max(most, std::fabs(input_.bows[3 * i]) + std::fabs(input_.bows[3 * i + 1]) + std::fabs(input_.bows[3 * i + 2]));
        return 0.25 * most;
    }

    bool take() {
        const double wide = band(blur());
        if (!std::is_integral_v<Pixel>) return gather(wide, [](double, double, Pixel) { return true; });
        if (!knows_noise_) return gather(wide, [&](double, double, Pixel value) { return value > image_.bottom && value < image_.top; });
        // Which pixels are left out does not depend on their noise: what the fit so far expects of them does not come near the range's ends.
        const double away = kClearOfNoise * std::max(std::sqrt(cost_) / scale_, kLeastNoise_dn);
        const SquareEdges lines = edges(p_);
        return gather(wide, [&](double column, double row, Pixel) {
            const double grey = expected(lines, column, row) / scale_;
            return grey > image_.bottom + away && grey < image_.top - away;
        });
    }

    // The grey value in the fit's unit, without what the joint distribution adds at corners.
    double expected(const SquareEdges& lines, double column, double row) const {
        double E[4], along;
        for (int i = 0; i < 4; ++i)
            E[i] = std::erf(lines.edge[i].distance(column, row, along) * std::exp(-p_[kSquareBlur1 + i % 2]) * 0.70710678);
        const double G = 0.5 * (E[0] + E[2]) * (E[1] + E[3]) - 1;
        const double u = column - work_.patch.column, v = row - work_.patch.row;
        return (p_[kSquareLevel] + p_[kSquareHalf] * G) * (1 + p_[kSquareLightX] * u + p_[kSquareLightY] * v);
    }

    bool begin() {
        const double* given = reinterpret_cast<const double*>(&input_);
        for (int i = 0; i < kSquareInputSize; ++i)
            if (std::isnan(given[i])) return false;
        std::copy(input_.corners, input_.corners + 8, p_);
        double x = 0, y = 0, shortest = std::numeric_limits<double>::infinity();
        const SquareEdges lines = edges(p_);
        if (!lines.is_convex()) return false;
        for (int i = 0; i < 4; ++i) {
            x += 0.25 * p_[2 * i], y += 0.25 * p_[2 * i + 1], shortest = std::min(shortest, lines.edge[i].length);
            if (!(p_[2 * i] >= 1 && p_[2 * i + 1] >= 1 && p_[2 * i] <= image_.width - 2 && p_[2 * i + 1] <= image_.height - 2)) return false;
        }
        work_.patch.column = static_cast<int>(std::lround(x)), work_.patch.row = static_cast<int>(std::lround(y));
        p_[kSquareBlur1] = p_[kSquareBlur2] = std::log(std::min(std::max(input_.blur, 0.3), 0.2 * shortest));
        if (!take() || !levels(lines)) return false;
        return is_finite(evaluate_at(p_, current_));
    }

    bool is_finite(double cost) { return std::isfinite(cost_ = cost); }

    // Levels inside and outside to start from. Values are kept in units of half the contrast.
    bool levels(const SquareEdges& lines) {
        double sum[2] = {0, 0}, deepest = -std::numeric_limits<double>::infinity(), inside = 0;
        int count[2] = {0, 0};
        const SquarePatch& patch = work_.patch;
        for (int i = 0; i < patch.n_pixels; ++i) {
            double nearest = std::numeric_limits<double>::infinity(), along;
            for (const SquareEdge& edge : lines.edge)
                nearest = std::min(nearest, edge.distance(work_.u()[i] + patch.column, work_.v()[i] + patch.row, along));
            if (nearest > deepest) deepest = nearest, inside = work_.value()[i];
            if (std::fabs(nearest) > 1.5) sum[nearest > 0] += work_.value()[i], ++count[nearest > 0];
        }
        if (count[0] < 8) {
            if (!patch.n_clipped) return false;
            sum[0] = image_.top, count[0] = 1;  // all of the paper is clipped
        }
        if (count[1] < 3) sum[1] = inside, count[1] = 1;
        const double around = sum[0] / count[0], within = sum[1] / count[1], half = 0.5 * (within - around);
        if (!(std::fabs(half) > 0.5)) return false;
        scale_ = 1 / std::fabs(half);
        p_[kSquareLevel] = 0.5 * (around + within) * scale_, p_[kSquareHalf] = sign_ = half > 0 ? 1 : -1;
        p_[kSquareLightX] = p_[kSquareLightY] = 0;
        float* value = work_.value();
        for (int i = 0; i < patch.n_pixels; ++i) value[i] = static_cast<float>(value[i] * scale_);
        return true;
    }

    // Mean square of the residuals.
    double evaluate_at(const double* p, SquareEquations& out) {
        evaluate(work_, p, edges(p), out);
        ++n_evaluations_;
        return out.gram[kSquareParameters][kSquareParameters] / work_.patch.n_pixels;
    }

    struct Step {
        double next[kSquareParameters];
        double moved;      // of the corner that goes farthest, px
        double decrement;  // of the sum of squares
        bool is_whole;
    };

    bool propose(Step& step) const {
        constexpr int n = kSquareParameters;
        double A[n][n], L[n][n], gradient[n], change[n];
        for (int i = 0; i < n; ++i) {
            for (int j = 0; j < n; ++j) A[i][j] = current_.gram[i][j];
            A[i][i] *= 1 + damping_;
            gradient[i] = current_.gram[i][n];
        }
        if (!cholesky(&A[0][0], &L[0][0], n, n, 1e-9)) return false;
        solve_lower(&L[0][0], n, n, gradient, change);
        solve_upper(&L[0][0], n, n, change);
        step.moved = step.decrement = 0;
        for (int i = 0; i < 4; ++i) step.moved = std::max(step.moved, std::hypot(change[2 * i], change[2 * i + 1]));
        double shrink = std::min(1.0, kMostCornerStep_px / std::max(step.moved, 1e-9));
        for (int i : {kSquareBlur1, kSquareBlur2}) shrink = std::min(shrink, 0.7 / std::max(std::fabs(change[i]), 1e-9));
        for (int i = 0; i < n; ++i) step.next[i] = p_[i] + shrink * change[i], step.decrement += gradient[i] * change[i];
        for (int i : {kSquareBlur1, kSquareBlur2}) step.next[i] = std::max(step.next[i], kLeastLogBlur);
        step.moved *= shrink, step.is_whole = shrink == 1;
        return edges(step.next).is_convex();
    }

    bool iterate() {
        while (n_evaluations_ < most_evaluations_) {
            Step step;
            if (!propose(step)) {
                if (!damp()) return false;
                continue;
            }
            for (int i = 0; i < 8; ++i)
                if (std::fabs(step.next[i] - input_.corners[i]) > input_.reach) return false;
            const double noise2 = current_.gram[kSquareParameters][kSquareParameters] / std::max(1, work_.patch.n_pixels - kSquareParameters);
            if (step.is_whole && (step.moved < (is_rough_ ? kLastRoughStep_px : kLastSquareStep_px) ||
                                  step.decrement < kLastSquareStepOfSigma * kLastSquareStepOfSigma * noise2)) {
                std::copy(step.next, step.next + kSquareParameters, p_);
                cost_ = std::max(cost_ - step.decrement / work_.patch.n_pixels, 0.0);
                return true;
            }
            const double cost = evaluate_at(step.next, trial_);
            if (!(cost < cost_)) {
                if (!damp()) return false;
                continue;
            }
            std::copy(step.next, step.next + kSquareParameters, p_);
            current_ = trial_, cost_ = cost;
            damping_ = std::max(0.1 * damping_, 1e-7);
            if (!follow()) return false;
        }
        return false;
    }

    bool damp() { return (damping_ = std::max(10 * damping_, 1e-3)) < 1e5; }

    // Pixels are gathered anew where the outline or the blur has moved.
    bool follow() {
        if (n_evaluations_ > 10) return true;
        double moved = std::fabs(band(blur()) - work_.patch.wide);
        for (int i = 0; i < 8; ++i) moved = std::max(moved, std::fabs(p_[i] - work_.patch.corners[i]));
        if (moved < kSquareSlack) return true;
        return take() && is_finite(evaluate_at(p_, current_));
    }

    // Once more where values are clipped: left out by what they are, those that noise kept from the top pull the level and the slope down.
    bool leave_clipped_out() {
        if (!work_.patch.n_clipped || is_rough_) return true;
        knows_noise_ = true, most_evaluations_ = n_evaluations_ + 12;
        if (!take()) return false;
        damping_ = 0;
        return is_finite(evaluate_at(p_, current_)) && iterate();
    }

    // Its contrast has the start's sign, and its blur leaves it an inside.
    bool is_a_square() const {
        double shortest = std::numeric_limits<double>::infinity();
        for (const SquareEdge& edge : edges(p_).edge) shortest = std::min(shortest, edge.length);
        return p_[kSquareHalf] * sign_ > 0.2 && blur() < 0.35 * shortest;
    }

    bool describe(SquareResult& out) const {
        constexpr int n = kSquareParameters;
        constexpr int shown[10] = {0, 1, 2, 3, 4, 5, 6, 7, kSquareLightX, kSquareLightY};
        double A[n][n], L[n][n], C[10][10];
        for (int i = 0; i < n; ++i)
            for (int j = 0; j < n; ++j) A[i][j] = current_.gram[i][j];
        if (!cholesky(&A[0][0], &L[0][0], n, n, 1e-9)) return false;
        for (int i = 0; i < 10; ++i) {
            double unit[n] = {}, inverse[n];
            unit[shown[i]] = 1;
            solve_lower(&L[0][0], n, n, unit, inverse);
            solve_upper(&L[0][0], n, n, inverse);
            for (int j = 0; j < 10; ++j) C[i][j] = inverse[shown[j]];
        }
        // Corners under light that falls before the blur: x + s^2 g, in the covariance too.
        const double blur2 = std::exp(p_[kSquareBlur1] + p_[kSquareBlur2]), noise_unit = scale_ * scale_;
        for (int i = 0; i < 8; ++i)
            for (int j = 0; j < 10; ++j) C[i][j] += blur2 * C[8 + i % 2][j];
        for (int i = 0; i < 10; ++i)
            for (int j = 0; j < 8; ++j) C[i][j] += blur2 * C[i][8 + j % 2];
        const int n_pixels = work_.patch.n_pixels;
        const SquareEdges lines = edges(p_);
        for (int k = 0; k < 4; ++k) {
            CornerResult& r = out.corners[k];
            r.x = p_[2 * k] + blur2 * p_[kSquareLightX], r.y = p_[2 * k + 1] + blur2 * p_[kSquareLightY];
            r.gx = p_[kSquareLightX], r.gy = p_[kSquareLightY];
            const int index[4] = {2 * k, 2 * k + 1, 8, 9};
            for (int i = 0, at = 0; i < 4; ++i)
                for (int j = i; j < 4; ++j) r.covariance[at++] = C[index[i]][index[j]] * noise_unit;
            // What is even about a square's middle moves its corners too, apart from one another.
            r.variance = r.odd_variance = cost_ * n_pixels / std::max(1, n_pixels - n) / noise_unit;
            r.contrast = p_[kSquareHalf] / scale_;
            r.blur1 = std::exp(p_[kSquareBlur1]), r.blur2 = std::exp(p_[kSquareBlur2]);
            const SquareEdge &first = lines.edge[k % 2 ? (k + 3) % 4 : k], &second = lines.edge[k % 2 ? k : (k + 3) % 4];
            r.angle1 = std::atan2(first.ty, first.tx), r.angle2 = std::atan2(second.ty, second.tx);
            r.radius = 0.5 * std::min(first.length, second.length);
            r.n_pixels = n_pixels, r.n_evaluations = n_evaluations_;
            r.long_variance = std::numeric_limits<double>::quiet_NaN();
            r.clipped_share = static_cast<double>(work_.patch.n_clipped) / (n_pixels + work_.patch.n_clipped);
        }
        return true;
    }

    const ImageView<Pixel>& image_;
    SquareInput input_;
    SquareWorkspace& work_;
    double scale_ = 1, sign_ = 0;  // of the start: values are kept in units of its half contrast
    double p_[kSquareParameters]{};
    SquareEquations current_{}, trial_{};
    double cost_ = 0, damping_ = 0;
    bool is_rough_, knows_noise_ = false;
    int n_evaluations_ = 0, most_evaluations_ = kMaxSquareEvaluations;
};

template <typename Pixel>
void fit_squares(const ImageView<Pixel>& image, const SquareInput* inputs, std::ptrdiff_t n, bool is_rough, SquareResult* results) {
    static thread_local SquareWorkspace work;
    for (std::ptrdiff_t i = 0; i < n; ++i) results[i] = SquareFitter<Pixel>(image, inputs[i], is_rough, work).fit();
}

}  // namespace binocal
