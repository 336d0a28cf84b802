// Maximum-likelihood fit of a blurred ellipse to the grey values about its outline.
//
// Model. A spot of constant light on a ground of constant light; its outline is the ellipse u.M u = 1, u = x - c. With q = u.M u the
// distance to the outline is d = (q - sqrt q) / |M u| (the root's first order: exact on the outline, and odd about the centre in nothing).
// A lens's Gaussian blur makes an edge E(d) = erf(d / (sqrt 2 s)) of it, and light that varies linearly multiplies both sides:
//   grey value = (a + b E(d)) (1 + g.u).
// Ten parameters: c (2), M (3), ln s, a, b, g (2). Pixel integration adds 1/12 px^2 to the blur's square, which the fit absorbs.
// The light falls on the print before the lens blurs both. To first order in g that is a pattern seen at x + s^2 g, for the mean of
// (1 + g.y) f(y) under a Gaussian about x is (1 + g.x) F(x) + s^2 g.grad F(x): so s^2 g is added to the centre in the end.
// Blur moves a curved edge inward by half its curvature times s^2: the half-axes are given without that.
// Pixels that clip, by what the fit expects of them, are left out: what is clipped says nothing of the light's slope, and as if measured
// it pulls the centre by half a pixel where paper saturates on one side.
#pragma once

#include "corner_fit.hpp"

#include <vector>

namespace binocal {

constexpr int kEllipseParameters = 10;
constexpr int kEllipseColumns = 12;  // the residual is the eleventh, one is empty
enum EllipseParameter { kCentreX, kCentreY, kShapeXX, kShapeXY, kShapeYY, kBlur, kLevel, kHalf, kLightX, kLightY };

constexpr double kLeastBand = 5.6;  // px to each side of the outline: 3.5 px lose the paper's level under blur, 2.5 px fail
constexpr double kBandPerBlur = 3.0, kBandBeyondBlur = 2.0;
constexpr double kLeastEllipseRadius = 1.8;  // px, of the smaller half-axis: a spot below it has no inside
constexpr float kLeastRelativeRadius = 0.05f;  // nearer to the centre the distance has no slope
constexpr double kEllipseSlack = 0.35;  // px: pixels are gathered again when the outline has moved farther
constexpr int kMaxEllipseEvaluations = 16;
constexpr int kPixelsForCoarse = 240;  // from so many on, every other pixel is enough until the outline is nearly there
constexpr double kNearlyThere_px = 0.2;
constexpr double kMostEllipsePixels = 4e5;
constexpr double kMostElongation = 12;
constexpr double kEllipseNearLoss_px = 3.0;  // measured: 3.2 +- 0.2, 3.1, 2.5 px at blurs of 0.6, 1.1, 2 px, for radii of 6 to 30 px
constexpr double kLeastEllipseNearRadius = 6.0;  // px: of a smaller spot the fit itself takes most of such noise away
constexpr double kClearOfNoise = 2.5;  // standard deviations: of a normal value so far off, 0.002 of one is clipped away

// An ellipse to start from, and how far from its outline, px, nothing else is printed: outside and inside it.
struct EllipseInput {
    double x, y;
    double major, minor, angle;  // half-axes, px; the first one's direction, rad
    double outward, inward;
};
constexpr int kEllipseInputSize = 7;
static_assert(sizeof(EllipseInput) == kEllipseInputSize * sizeof(double));

// All NaN where the fit failed. Of `point`, the blurs are the one blur, the angles that of the axis, the radius the mean one.
struct EllipseResult {
    CornerResult point;
    double major, minor, angle;
};
constexpr int kEllipseResultSize = kResultSize + 3;
static_assert(sizeof(EllipseResult) == kEllipseResultSize * sizeof(double));

struct Ellipse {
    double x, y, xx, xy, yy;  // (u, v) M (u, v) = 1

    static Ellipse of_axes(double x, double y, double major, double minor, double angle) {
        const double c = std::cos(angle), s = std::sin(angle), A = 1 / (major * major), B = 1 / (minor * minor);
        return {x, y, A * c * c + B * s * s, (A - B) * c * s, A * s * s + B * c * c};
    }
    void axes(double& major, double& minor, double& angle) const {
        const double middle = 0.5 * (xx + yy), half = std::hypot(0.5 * (xx - yy), xy);
        major = 1 / std::sqrt(std::max(middle - half, 1e-12)), minor = 1 / std::sqrt(middle + half);
        angle = 0.5 * std::atan2(-2 * xy, yy - xx);
    }
    // The pixel columns of a row that lie within it, false where there is none; relative to the centre.
    bool span(double v, double& first, double& last) const {
        const double root = xy * xy * v * v - xx * (yy * v * v - 1);
        if (!(root > 0)) return false;
        const double width = std::sqrt(root) / xx, middle = -xy * v / xx;
        first = middle - width, last = middle + width;
        return true;
    }
    bool is_one() const { return xx > 0 && yy > 0 && xx * yy > xy * xy; }
};

struct EllipsePatch {
    int column, row;  // whole pixels from which u and v count
    int n_pixels, n_vectors;
    double unit;      // 1 / px^2: of the shape's parameters
    Ellipse outline;  // what was gathered about
    double outward, inward;
    int n_clipped;
};

class EllipseWorkspace {
  public:
    EllipsePatch patch{};
    void reserve(int n) {
        if (n <= capacity_) return;
        capacity_ = (n + kLanes - 1) / kLanes * kLanes;
        memory_.assign(static_cast<std::size_t>(capacity_) * (kEllipseColumns + 3), 0.0f);
    }
    float* column(int k) { return memory_.data() + static_cast<std::size_t>(capacity_) * k; }
    float* u() { return column(kEllipseColumns); }
    float* v() { return column(kEllipseColumns + 1); }
    float* value() { return column(kEllipseColumns + 2); }
    std::vector<float> grid;  // of the residuals, to find what is odd in them

  private:
    std::vector<float> memory_;
    int capacity_ = 0;
};

struct EllipseEquations {
    double gram[kEllipseColumns][kEllipseColumns];
};

namespace portable {
#include "ellipse_fit_loops.hpp"
}
#if defined(BINOCAL_AVX2)
#pragma GCC push_options
#pragma GCC target("avx2,fma")
namespace avx2 {
#include "ellipse_fit_loops.hpp"
}
#pragma GCC pop_options
#endif

inline void evaluate(EllipseWorkspace& work, const double* p, EllipseEquations& out) {
#if defined(BINOCAL_AVX2)
    if (has_avx2()) {
        avx2::linearize(work, p);
        return avx2::multiply(work, out);
    }
#endif
    portable::linearize(work, p);
    portable::multiply(work, out);
}

// Gathers the pixels between the ellipses `inward` inside and `outward` outside the outline for which keeps(u, v, value) holds, u and v
// from the outline's centre, every other one where it is coarse; false where they are too few.
template <typename Pixel, typename Keeps>
bool gather(const ImageView<Pixel>& image, const Ellipse& outline, double outward, double inward, double scale, const Keeps& keeps,
            bool is_coarse, EllipseWorkspace& work) {
    double major, minor, angle;
    outline.axes(major, minor, angle);
    const Ellipse outer = Ellipse::of_axes(outline.x, outline.y, major + outward, minor + outward, angle);
    const bool is_ring = minor - inward > 0.5;
    const Ellipse inner = is_ring ? Ellipse::of_axes(outline.x, outline.y, major - inward, minor - inward, angle) : outer;
    const double height = std::sqrt(outer.xx / (outer.xx * outer.yy - outer.xy * outer.xy));
    if (!(4 * (major + outward) * (minor + outward) < kMostEllipsePixels)) return false;
    EllipsePatch& patch = work.patch;
    patch.column = static_cast<int>(std::lround(outline.x)), patch.row = static_cast<int>(std::lround(outline.y));
    patch.outline = outline, patch.outward = outward, patch.inward = inward, patch.n_clipped = 0;
    const double area = 3.14159265358979 * (major + outward) * (minor + outward);
    work.reserve(static_cast<int>(area + 4 * (major + outward)) + 16 + kLanes);  // no row has more than its chord and one
    const auto first_row = std::max<std::ptrdiff_t>(0, static_cast<std::ptrdiff_t>(std::ceil(outline.y - height)));
    const auto last_row = std::min<std::ptrdiff_t>(image.height - 1, static_cast<std::ptrdiff_t>(std::floor(outline.y + height)));
    float *u = work.u(), *v = work.v(), *value = work.value();
    int n = 0;
    auto take = [&](const Pixel* line, std::ptrdiff_t row, double from, double to) {
        auto first = std::max<std::ptrdiff_t>(0, static_cast<std::ptrdiff_t>(std::ceil(from)));
        if (is_coarse && (first + row) % 2) ++first;
        const auto last = std::min<std::ptrdiff_t>(image.width - 1, static_cast<std::ptrdiff_t>(std::floor(to)));
        for (std::ptrdiff_t column = first; column <= last; column += is_coarse ? 2 : 1) {
            if (!keeps(static_cast<double>(column) - outline.x, static_cast<double>(row) - outline.y, line[column])) {
                ++patch.n_clipped;
                continue;
            }
            u[n] = static_cast<float>(column - patch.column), v[n] = static_cast<float>(row - patch.row);
            value[n++] = static_cast<float>(line[column] * scale);
        }
    };
    for (auto row = first_row; row <= last_row; ++row) {
        const Pixel* line = image.pixels + row * image.width;
        double from, to, hole_from, hole_to;
        const double dy = static_cast<double>(row) - outline.y;
        if (!outer.span(dy, from, to)) continue;
        if (is_ring && inner.span(dy, hole_from, hole_to) && std::ceil(outline.x + hole_from) <= std::floor(outline.x + hole_to)) {
            take(line, row, outline.x + from, std::ceil(outline.x + hole_from) - 0.5);
            take(line, row, std::floor(outline.x + hole_to) + 0.5, outline.x + to);
        } else {
            take(line, row, outline.x + from, outline.x + to);
        }
    }
    patch.n_pixels = n;
    for (; n % kLanes; ++n) u[n] = v[n] = 1000.0f, value[n] = 0;
    patch.n_vectors = n / kLanes;
    return patch.n_pixels >= 3 * kEllipseParameters;
}

inline int reach_of(EllipseWorkspace& work) {
    float reach = 0;
    for (int i = 0; i < work.patch.n_pixels; ++i) reach = std::max({reach, std::fabs(work.u()[i]), std::fabs(work.v()[i])});
    return static_cast<int>(reach);
}

// Variance of independent noise, in the residuals' units, that would scatter the centre as much as these residuals' noise does, which may be
// alike in neighbouring pixels; corner_fit.hpp has the reasons. Mean over x and y. Of independent noise the fit leaves the share that
// kEllipseNearLoss_px says.
inline double long_variance(EllipseWorkspace& work, const double (*to_centre)[kEllipseParameters], const double* p, double radius) {
    const EllipsePatch& patch = work.patch;
    constexpr int slack = 2;  // opposite points lie so far off the patch at most
    const int middle = reach_of(work) + kNear + slack, side = 2 * middle + 1, size = side * side;
    const int twice_x = static_cast<int>(std::lround(2 * (p[kCentreX] - patch.column))), twice_y = static_cast<int>(std::lround(2 * (p[kCentreY] - patch.row)));
    if (std::abs(twice_x) > slack || std::abs(twice_y) > slack) return std::numeric_limits<double>::quiet_NaN();
    const float *residual = work.column(kEllipseParameters), *u = work.u(), *v = work.v();
    double total = 0;
    for (int k : {0, 1}) {
        work.grid.assign(2 * static_cast<std::size_t>(size) + side, 0.0f);
        float *one = work.grid.data(), *both = one + size, *line = both + size;
        double squares = 0, sum = 0;
        for (int i = 0; i < patch.n_pixels; ++i) {
            float gain = 0;
            for (int j = 0; j < kEllipseParameters; ++j) gain += static_cast<float>(to_centre[k][j]) * work.column(j)[i];
            const int column = static_cast<int>(u[i]), row = static_cast<int>(v[i]);
            const float move = gain * residual[i];
            squares += gain * gain;
            one[(middle + row) * side + middle + column] = move;
            both[(middle + row) * side + middle + column] += move;
            both[(middle + twice_y - row) * side + middle + twice_x - column] += move;
        }
        for (int y = kNear; y < side - kNear; ++y) {
            const float *at = both + y * side, *own = one + y * side;
            for (int x = 0; x < side; ++x) line[x] = at[x - 2 * side] + at[x - side] + at[x] + at[x + side] + at[x + 2 * side];
            float of_row = 0;
            for (int x = kNear; x < side - kNear; ++x) of_row += own[x] * (line[x - 2] + line[x - 1] + line[x] + line[x + 1] + line[x + 2]);
            sum += of_row;
        }
        total += 0.5 * sum / std::max(squares, 1e-30);
    }
    return total / (1 - kEllipseNearLoss_px / radius);
}

// Mean square of what is odd in the residuals about the centre: what blur's shape and a halo leave is even, and moves no centre.
inline double odd_variance(EllipseWorkspace& work, const double* p, double mean_square) {
    const EllipsePatch& patch = work.patch;
    const int reach = reach_of(work), side = 2 * reach + 4, middle = reach + 1;
    work.grid.assign(static_cast<std::size_t>(side) * side, std::numeric_limits<float>::quiet_NaN());
    const float* residual = work.column(kEllipseParameters);
    auto at = [&](int row, int column) -> float& { return work.grid[static_cast<std::size_t>(row) * side + column]; };
    for (int i = 0; i < patch.n_pixels; ++i)
        at(middle + static_cast<int>(work.v()[i]), middle + static_cast<int>(work.u()[i])) = residual[i];
    const double x = 2 * (p[kCentreX] - patch.column), y = 2 * (p[kCentreY] - patch.row);  // of the opposite point, less the point's own
    const int column0 = static_cast<int>(std::floor(x)), row0 = static_cast<int>(std::floor(y));
    const float a = static_cast<float>(x - column0), b = static_cast<float>(y - row0);
    const float w00 = (1 - a) * (1 - b), w01 = a * (1 - b), w10 = (1 - a) * b, w11 = a * b;
    const double scale = 1 + w00 * w00 + w01 * w01 + w10 * w10 + w11 * w11;
    double sum = 0;
    int count = 0;
    for (int i = 0; i < patch.n_pixels; ++i) {
        const int column = middle + column0 - static_cast<int>(work.u()[i]), row = middle + row0 - static_cast<int>(work.v()[i]);
        if (column < 0 || row < 0 || column + 1 >= side || row + 1 >= side) continue;
        const float difference =
            residual[i] - (w00 * at(row, column) + w01 * at(row, column + 1) + w10 * at(row + 1, column) + w11 * at(row + 1, column + 1));
        if (!(difference == difference)) continue;
        sum += difference * difference;
        ++count;
    }
    if (count < 24) return mean_square;
    return sum / (count * scale) / (1 - std::min(0.5, 8.0 / count));  // half the pixels are odd, and four parameters took their share
}

// One spot's fit: damped least squares on a band about the outline, which follows what is found.
template <typename Pixel>
class EllipseFitter {
  public:
    EllipseFitter(const ImageView<Pixel>& image, const EllipseInput& input, EllipseWorkspace& work, bool looks_at_noise)
        : image_(image), input_(input), work_(work), looks_at_noise_(looks_at_noise) {}

    EllipseResult fit() {
        EllipseResult result;
        if (!begin() || !iterate() || !leave_clipped_out() || !is_a_spot() || !describe(result))
            std::fill_n(reinterpret_cast<double*>(&result), kEllipseResultSize, std::numeric_limits<double>::quiet_NaN());
        return result;
    }

  private:
    Ellipse outline(const double* p) const {
        const double unit = work_.patch.unit;
        return {p[kCentreX], p[kCentreY], p[kShapeXX] * unit, p[kShapeXY] * unit, p[kShapeYY] * unit};
    }

    double band(double blur) const { return std::max(kLeastBand, kBandPerBlur * blur + kBandBeyondBlur); }

    // The band, as far as nothing else is printed in it.
    bool take(const Ellipse& ellipse, double blur) {
        const double wide = band(blur);
        const double outward = std::max(1.0, std::min(wide, input_.outward)), inward = std::max(1.0, std::min(wide, input_.inward));
        if (!std::is_integral_v<Pixel>) return gather(image_, ellipse, outward, inward, scale_, [](double, double, Pixel) { return true; }, is_coarse_, work_);
        if (!knows_noise_) {
            auto keeps = [&](double, double, Pixel value) { return value > image_.bottom && value < image_.top; };
            return gather(image_, ellipse, outward, inward, scale_, keeps, is_coarse_, work_);
        }
        // Which pixels are left out does not depend on their noise: what the fit so far expects of them does not come near the range's ends.
        const double away = kClearOfNoise * std::max(std::sqrt(cost_) / scale_, kLeastNoise_dn);
        auto keeps = [&](double u, double v, Pixel) {
            const double grey = expected(u, v) / scale_;
            return grey > image_.bottom + away && grey < image_.top - away;
        };
        return gather(image_, ellipse, outward, inward, scale_, keeps, is_coarse_, work_);
    }

    // The grey value, in the fit's unit, at u, v from the centre.
    double expected(double u, double v) const {
        const Ellipse e = outline(p_);
        const double wx = e.xx * u + e.xy * v, wy = e.xy * u + e.yy * v, q = u * wx + v * wy;
        const double d = (q - std::sqrt(std::max(q, 0.0))) / std::sqrt(std::max(wx * wx + wy * wy, 1e-18));
        return (p_[kLevel] + p_[kHalf] * std::erf(d * std::exp(-p_[kBlur]) * 0.70710678)) * (1 + p_[kLightX] * u + p_[kLightY] * v);
    }

    bool begin() {
        const double values[] = {input_.x, input_.y, input_.major, input_.minor, input_.angle, input_.outward, input_.inward};
        for (double value : values)
            if (std::isnan(value)) return false;
        if (!(input_.minor >= kLeastEllipseRadius) || !(input_.major < kMostElongation * input_.minor) || !(input_.minor < kMostElongation * input_.major))
            return false;
        const double reach = std::max(input_.major, input_.minor) + 2;
        if (!(input_.x >= reach && input_.y >= reach && input_.x <= image_.width - 1 - reach && input_.y <= image_.height - 1 - reach)) return false;
        const Ellipse ellipse = Ellipse::of_axes(input_.x, input_.y, input_.major, input_.minor, input_.angle);
        work_.patch.unit = 1 / (input_.major * input_.minor);
        const double length = 3.14159265358979 * (input_.major + input_.minor);
        is_coarse_ = length * std::min(2 * kLeastBand, std::min(kLeastBand, input_.outward) + std::min(kLeastBand, input_.inward)) > kPixelsForCoarse;
        if (!take(ellipse, 1.0) || !levels(ellipse)) return false;
        const double unit = work_.patch.unit;
        const double first[kEllipseParameters] = {ellipse.x, ellipse.y, ellipse.xx / unit, ellipse.xy / unit, ellipse.yy / unit,
                                                  std::log(std::min(1.2, 0.4 * input_.minor)), level_, half_, 0, 0};
        std::copy(first, first + kEllipseParameters, p_);
        cost_ = evaluate_at(p_, current_);
        return true;
    }

    // Levels inside and outside to start from. Values are kept in units of half the contrast.
    bool levels(const Ellipse& e) {
        double sum[2] = {0, 0}, deepest = 0, inside = 0;
        int count[2] = {0, 0};
        const EllipsePatch& patch = work_.patch;
        for (int i = 0; i < patch.n_pixels; ++i) {
            const double u = work_.u()[i] + patch.column - e.x, v = work_.v()[i] + patch.row - e.y;
            const double wx = e.xx * u + e.xy * v, wy = e.xy * u + e.yy * v, q = u * wx + v * wy;
            const double d = (q - std::sqrt(q)) / std::sqrt(std::max(wx * wx + wy * wy, 1e-18));
            if (d < deepest) deepest = d, inside = work_.value()[i];
            if (std::fabs(d) > 1.5) sum[d > 0] += work_.value()[i], ++count[d > 0];
        }
        if (count[1] < 6) {
            if (!patch.n_clipped) return false;
            sum[1] = image_.top, count[1] = 1;  // all of the paper is clipped
        }
        if (count[0] < 3) sum[0] = inside, count[0] = 1;
        const double dark = sum[0] / count[0], bright = sum[1] / count[1], half = 0.5 * (bright - dark);
        if (!(std::fabs(half) > 0.5)) return false;
        scale_ = 1 / std::fabs(half);
        level_ = 0.5 * (bright + dark) * scale_, half_ = half > 0 ? 1 : -1;
        float* value = work_.value();
        for (int i = 0; i < patch.n_pixels; ++i) value[i] = static_cast<float>(value[i] * scale_);
        return true;
    }

    // Mean square of the residuals.
    double evaluate_at(const double* p, EllipseEquations& out) {
        evaluate(work_, p, out);
        ++n_evaluations_;
        return out.gram[kEllipseParameters][kEllipseParameters] / work_.patch.n_pixels;
    }

    struct Step {
        double next[kEllipseParameters], change[kEllipseParameters];
        double moved, shrink, decrement;
    };

    bool propose(Step& step) const {
        double A[kEllipseParameters][kEllipseParameters], L[kEllipseParameters][kEllipseParameters], gradient[kEllipseParameters];
        for (int i = 0; i < kEllipseParameters; ++i) {
            for (int j = 0; j < kEllipseParameters; ++j) A[i][j] = current_.gram[i][j];
            A[i][i] *= 1 + damping_;
            gradient[i] = current_.gram[i][kEllipseParameters];
        }
        if (!cholesky(&A[0][0], &L[0][0], kEllipseParameters, kEllipseParameters, 1e-9)) return false;
        solve_lower(&L[0][0], kEllipseParameters, kEllipseParameters, gradient, step.change);
        solve_upper(&L[0][0], kEllipseParameters, kEllipseParameters, step.change);
        const double length = std::hypot(step.change[kCentreX], step.change[kCentreY]);
        // One step moves the centre by a third of the radius at most, and changes the axes by a sixth, the blur by e^0.7.
        double shrink = std::min(1.0, std::max(1.0, input_.minor / 3) / std::max(length, 1e-9));
        const double least = 1 / (input_.major * input_.major * work_.patch.unit);
        for (int i : {kShapeXX, kShapeXY, kShapeYY}) shrink = std::min(shrink, 0.33 * least / std::max(std::fabs(step.change[i]), 1e-12));
        shrink = std::min(shrink, 0.7 / std::max(std::fabs(step.change[kBlur]), 1e-9));
        for (int i = 0; i < kEllipseParameters; ++i) step.next[i] = p_[i] + shrink * step.change[i];
        step.next[kBlur] = std::max(step.next[kBlur], kLeastLogBlur);
        step.shrink = shrink, step.moved = shrink * length, step.decrement = 0;
        for (int i = 0; i < kEllipseParameters; ++i) step.decrement += gradient[i] * step.change[i];
        return outline(step.next).is_one();
    }

    // The last step need not be evaluated: its residuals are those that the Jacobian predicts.
    bool is_last(const Step& step) const {
        const double noise2 = current_.gram[kEllipseParameters][kEllipseParameters] / std::max(1, work_.patch.n_pixels - kEllipseParameters);
        return step.shrink == 1 && (step.moved < 0.1 * kLastStepUnseen || (step.moved < kLastStepAtMost && step.decrement < 0.1 * noise2) ||
                                    (step.moved < kLastStepAtMost && step.moved < kLastStepShrinks * last_moved_ && step.decrement < noise2));
    }

    double change_of_axes(const Step& step) const {
        double major, minor, angle, old_major, old_minor;
        outline(step.next).axes(major, minor, angle);
        outline(p_).axes(old_major, old_minor, angle);
        return std::max(std::fabs(major - old_major), std::fabs(minor - old_minor));
    }

    void end(const Step& step) {
        float* residual = work_.column(kEllipseParameters);
        for (int k = 0; k < kEllipseParameters; ++k) {
            const float size = static_cast<float>(step.next[k] - p_[k]);
            const float* column = work_.column(k);
            for (int i = 0; i < work_.patch.n_pixels; ++i) residual[i] -= size * column[i];
        }
        cost_ = std::max(cost_ - step.decrement / work_.patch.n_pixels, 0.0);
        std::copy(step.next, step.next + kEllipseParameters, p_);
    }

    bool iterate() {
        while (n_evaluations_ < kMaxEllipseEvaluations) {
            Step step;
            if (!propose(step)) {
                if (!damp()) return false;
                continue;
            }
            if (std::hypot(step.next[kCentreX] - input_.x, step.next[kCentreY] - input_.y) > 0.4 * input_.minor + 1) return false;
            if (is_coarse_ && (step.shrink == 1 && step.moved < kNearlyThere_px && change_of_axes(step) < kNearlyThere_px)) {
                std::copy(step.next, step.next + kEllipseParameters, p_);
                is_coarse_ = false, is_linearized_here_ = true, last_moved_ = step.moved;
                if (!take(outline(p_), std::exp(p_[kBlur]))) return false;
                cost_ = evaluate_at(p_, current_);
                continue;
            }
            if (is_last(step)) {
                if (!is_linearized_here_) evaluate_at(p_, current_);
                end(step);
                return true;
            }
            const double cost = evaluate_at(step.next, trial_);
            is_linearized_here_ = false;
            if (!(cost < cost_)) {
                if (step.moved < kLastStepUnseen && cost < 1.0001 * cost_) {  // nothing is left to gain in single precision
                    evaluate_at(p_, current_);
                    return true;
                }
                if (!damp()) return false;
                continue;
            }
            is_linearized_here_ = true;
            std::copy(step.next, step.next + kEllipseParameters, p_);
            current_ = trial_, cost_ = cost, last_moved_ = step.moved;
            damping_ = std::max(0.1 * damping_, 1e-7);
            if (!follow()) return false;
        }
        return false;
    }

    // Once more where values are clipped: left out by what they are, those that noise kept from the top pull the level and the slope down.
    bool leave_clipped_out() {
        if (!work_.patch.n_clipped) return true;
        knows_noise_ = true, n_evaluations_ = std::min(n_evaluations_, 4);
        if (!take(outline(p_), std::exp(p_[kBlur]))) return false;
        cost_ = evaluate_at(p_, current_);
        last_moved_ = std::numeric_limits<double>::infinity(), damping_ = 0;
        return iterate();
    }

    bool damp() { return (damping_ = std::max(10 * damping_, 1e-3)) < 1e6; }

    // Pixels are gathered anew where the outline or the blur has moved.
    bool follow() {
        if (n_evaluations_ > 8) return true;
        const Ellipse now = outline(p_), &then = work_.patch.outline;
        double major, minor, angle, old_major, old_minor, old_angle;
        now.axes(major, minor, angle);
        then.axes(old_major, old_minor, old_angle);
        const double moved = std::max(std::hypot(now.x - then.x, now.y - then.y),
                                      std::max(std::fabs(major - old_major), std::fabs(minor - old_minor)));
        const double wide = band(std::exp(p_[kBlur]));
        const double grown = std::max(std::fabs(std::max(1.0, std::min(wide, input_.outward)) - work_.patch.outward),
                                      std::fabs(std::max(1.0, std::min(wide, input_.inward)) - work_.patch.inward));
        if (moved < kEllipseSlack && grown < kEllipseSlack) return true;
        if (!(minor >= kLeastEllipseRadius && major < 2 * kMostElongation * minor)) return false;
        if (!take(now, std::exp(p_[kBlur]))) return false;
        cost_ = evaluate_at(p_, current_);
        return true;
    }

    // Its contrast has the start's sign, its axes are near the start's, its blur leaves it an inside.
    bool is_a_spot() const {
        double major, minor, angle;
        outline(p_).axes(major, minor, angle);
        const double grown = major * minor / (input_.major * input_.minor);
        return p_[kHalf] * half_ > 0.2 && grown > 0.4 && grown < 2.5 && minor >= kLeastEllipseRadius && std::exp(p_[kBlur]) < 0.8 * minor;
    }

    bool describe(EllipseResult& out) const {
        double L[kEllipseParameters][kEllipseParameters], inverse[4][kEllipseParameters], A[kEllipseParameters][kEllipseParameters];
        for (int i = 0; i < kEllipseParameters; ++i)
            for (int j = 0; j < kEllipseParameters; ++j) A[i][j] = current_.gram[i][j];
        if (!cholesky(&A[0][0], &L[0][0], kEllipseParameters, kEllipseParameters, 1e-9)) return false;
        constexpr EllipseParameter shown[4] = {kCentreX, kCentreY, kLightX, kLightY};
        double C[4][4];
        for (int i = 0; i < 4; ++i) {
            double unit[kEllipseParameters] = {};
            unit[shown[i]] = 1;
            solve_lower(&L[0][0], kEllipseParameters, kEllipseParameters, unit, inverse[i]);
            solve_upper(&L[0][0], kEllipseParameters, kEllipseParameters, inverse[i]);
            for (int j = 0; j < 4; ++j) C[i][j] = inverse[i][shown[j]];
        }
        const double blur = std::exp(p_[kBlur]), blur2 = blur * blur, grey2 = 1 / (scale_ * scale_);
        // The centre under light that falls before the blur: x + s^2 g, in the covariance too.
        for (int i : {0, 1})
            for (int j = 0; j < 4; ++j) C[i][j] += blur2 * C[i + 2][j];
        for (int i = 0; i < 4; ++i)
            for (int j : {0, 1}) C[i][j] += blur2 * C[i][j + 2];
        CornerResult& r = out.point;
        r.x = p_[kCentreX] + blur2 * p_[kLightX], r.y = p_[kCentreY] + blur2 * p_[kLightY];
        r.gx = p_[kLightX], r.gy = p_[kLightY];
        for (int i = 0, k = 0; i < 4; ++i)
            for (int j = i; j < 4; ++j) r.covariance[k++] = C[i][j] / grey2;
        const int n = work_.patch.n_pixels;
        const double mean_square = cost_ * n / std::max(1, n - kEllipseParameters);
        r.variance = mean_square * grey2;
        r.odd_variance = odd_variance(work_, p_, mean_square) * grey2;
        r.contrast = p_[kHalf] / scale_;
        r.blur1 = r.blur2 = blur;
        outline(p_).axes(out.major, out.minor, out.angle);
        // Blur moves a curved edge inward by half its curvature times s^2; a / b^2 is an ellipse's at the end of its axis a.
        const double ratio = out.major / out.minor, longer = blur2 * ratio / (2 * out.minor), shorter = blur2 / (ratio * 2 * out.major);
        out.major += longer, out.minor += shorter;
        r.angle1 = r.angle2 = out.angle;
        r.radius = std::sqrt(out.major * out.minor);
        r.n_pixels = n, r.n_evaluations = n_evaluations_;
        r.long_variance = looks_at_noise_ && r.radius >= kLeastEllipseNearRadius ? long_variance(work_, inverse, p_, r.radius) * grey2
                                                                                 : std::numeric_limits<double>::quiet_NaN();
        r.clipped_share = static_cast<double>(work_.patch.n_clipped) / (n + work_.patch.n_clipped);
        return true;
    }

    const ImageView<Pixel>& image_;
    EllipseInput input_;
    EllipseWorkspace& work_;
    bool looks_at_noise_;  // whether its neighbouring pixels' noise is alike
    double scale_ = 1, level_ = 0, half_ = 1;  // of the start: values are kept in units of its half contrast
    double p_[kEllipseParameters]{};
    EllipseEquations current_{}, trial_{};
    double cost_ = 0, damping_ = 0;
    double last_moved_ = std::numeric_limits<double>::infinity();
    bool is_linearized_here_ = true, knows_noise_ = false, is_coarse_ = false;
    int n_evaluations_ = 0;
};

template <typename Pixel>
void fit_ellipses(const ImageView<Pixel>& image, const EllipseInput* inputs, std::ptrdiff_t n, EllipseResult* results) {
    static thread_local EllipseWorkspace work;
    const std::ptrdiff_t every = (n + kCornersForNoise - 1) / kCornersForNoise;
    for (std::ptrdiff_t i = 0; i < n; ++i) results[i] = EllipseFitter<Pixel>(image, inputs[i], work, is_picked(i, every)).fit();
}

}  // namespace binocal
