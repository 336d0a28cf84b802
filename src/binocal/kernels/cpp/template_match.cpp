// Least-squares template matching: the place in one image, to a hundredth of a pixel, of what a window of another shows.
//
// Inverse compositional Gauss-Newton on an affine warp with gain and offset (Baker & Matthews 2004, "Lucas-Kanade 20 years on";
// least-squares matching of photogrammetry: Gruen 1985). The template's gradients make a constant Hessian, so that an iteration is
// one sampling of the other image, by Lanczos windows of eight samples.
#include "kernel.hpp"
#include "linear_algebra.hpp"

#include <array>
#include <cmath>
#include <limits>

namespace binocal {
namespace {

using Plane = nb::ndarray<const float, nb::ndim<2>, nb::device::cpu, nb::c_contig>;

constexpr int kTaps = 8, kPhases = 1024;
constexpr int kMostHalf = 15, kMostPixels = (2 * kMostHalf + 1) * (2 * kMostHalf + 1);
constexpr int kGeometric = 6;
constexpr double kPi = 3.14159265358979323846;

// Weights of the eight samples around a place, by its fraction in 1/1024 pixel; each sums to 1.
struct Lanczos {
    std::array<std::array<float, kTaps>, kPhases + 1> weights;
    Lanczos() {
        for (int phase = 0; phase <= kPhases; ++phase) {
            double sum = 0, value[kTaps];
            for (int i = 0; i < kTaps; ++i) {
                const double x = static_cast<double>(phase) / kPhases - (i - 3);
                value[i] = std::abs(x) < 1e-9 ? 1.0 : std::abs(x) >= 4 ? 0.0 : 4 * std::sin(kPi * x) * std::sin(kPi * x / 4) / (kPi * kPi * x * x);
                sum += value[i];
            }
            for (int i = 0; i < kTaps; ++i) weights[phase][i] = static_cast<float>(value[i] / sum);
        }
    }
};

const Lanczos& lanczos() {
    static const Lanczos table;
    return table;
}

struct Image {
    const float* pixels;
    std::ptrdiff_t width, height;
};

struct Task {
    Image from, to;
    const double *start_from, *start_to;  // (n, 2)
    const double* start_warp;             // (n, 4) or null: identity
    int half, max_iterations;
    double tolerance_px, sigma_share;
    double *place, *warp, *likeness, *spread;  // (n, 2), (n, 4), (n), (n, 3): covariance of the place for unit noise
    bool* is_converged;
};

// The image's value at a place; false where samples would lie beyond it.
BINOCAL_INLINE bool sample(const Image& image, double x, double y, float& out) {
    const double floor_x = std::floor(x), floor_y = std::floor(y);
    // compared before the cast: a place that no integer holds (NaN, infinite, huge) may become any index
    if (!(floor_x >= 3 && floor_y >= 3 && floor_x + (kTaps - 3) <= static_cast<double>(image.width) &&
          floor_y + (kTaps - 3) <= static_cast<double>(image.height)))
        return false;
    const auto left = static_cast<std::ptrdiff_t>(floor_x) - 3, top = static_cast<std::ptrdiff_t>(floor_y) - 3;
    const float* wx = lanczos().weights[static_cast<int>((x - floor_x) * kPhases + 0.5)].data();
    const float* wy = lanczos().weights[static_cast<int>((y - floor_y) * kPhases + 0.5)].data();
    float columns[kTaps] = {};
    const float* row = image.pixels + top * image.width + left;
    for (int j = 0; j < kTaps; ++j, row += image.width) {
        for (int i = 0; i < kTaps; ++i) columns[i] += wy[j] * row[i];
    }
    float sum = 0;
    for (int i = 0; i < kTaps; ++i) sum += wx[i] * columns[i];
    out = sum;
    return true;
}

struct Scratch {
    std::array<float, kMostPixels> shown, found;
    std::array<std::array<float, kMostPixels>, kGeometric> columns;
    std::array<float, kMostPixels> weight;
};

BINOCAL_INLINE bool match_one(const Task& task, std::size_t index, Scratch& s) {
    const int half = task.half, side = 2 * half + 1, n = side * side;
    const double cx = task.start_from[2 * index], cy = task.start_from[2 * index + 1];
    // template, its gradients by central differences of samples, and the weighted columns without their mean and template
    for (int y = -half, k = 0; y <= half; ++y) {
        for (int x = -half; x <= half; ++x, ++k) {
            if (!sample(task.from, cx + x, cy + y, s.shown[k])) return false;
        }
    }
    for (int y = -half, k = 0; y <= half; ++y) {
        for (int x = -half; x <= half; ++x, ++k) {
            float east, west, south, north;
            if (!sample(task.from, cx + x + 0.5, cy + y, east) || !sample(task.from, cx + x - 0.5, cy + y, west) ||
                !sample(task.from, cx + x, cy + y + 0.5, south) || !sample(task.from, cx + x, cy + y - 0.5, north))
                return false;
            const float gx = east - west, gy = south - north;
            const float px = static_cast<float>(x), py = static_cast<float>(y);
            const float column[kGeometric] = {gx, gy, gx * px, gx * py, gy * px, gy * py};
            for (int c = 0; c < kGeometric; ++c) s.columns[c][k] = column[c];
        }
    }
    // gain and offset are projected out of template and columns: what is left is orthogonal to 1 and to the template
    double total = 0, mean = 0;
    for (int k = 0; k < n; ++k) total += s.weight[k], mean += s.weight[k] * s.shown[k];
    mean /= total;
    double variance = 0;
    for (int k = 0; k < n; ++k) {
        s.shown[k] -= static_cast<float>(mean);
        variance += s.weight[k] * s.shown[k] * s.shown[k];
    }
    if (!(variance > 1e-6 * total)) return false;  // a window without texture
    double H[kGeometric * kGeometric];
    for (auto& column : s.columns) {
        double own = 0, along = 0;
        for (int k = 0; k < n; ++k) own += s.weight[k] * column[k], along += s.weight[k] * column[k] * s.shown[k];
        own /= total;
        along /= variance;
        for (int k = 0; k < n; ++k) column[k] -= static_cast<float>(own + along * s.shown[k]);
    }
    for (int a = 0; a < kGeometric; ++a) {
        for (int b = a; b < kGeometric; ++b) {
            double sum = 0;
            for (int k = 0; k < n; ++k) sum += s.weight[k] * s.columns[a][k] * s.columns[b][k];
            H[a * kGeometric + b] = H[b * kGeometric + a] = sum;
        }
    }
    double scale[kGeometric], L[kGeometric * kGeometric];
    for (int a = 0; a < kGeometric; ++a) {
        if (!(H[a * kGeometric + a] > 0)) return false;
        scale[a] = 1 / std::sqrt(H[a * kGeometric + a]);
    }
    for (int a = 0; a < kGeometric; ++a)
        for (int b = 0; b < kGeometric; ++b) H[a * kGeometric + b] *= scale[a] * scale[b];
    if (!cholesky(H, L, kGeometric, kGeometric, 1e-6)) return false;
    double* A = task.warp + 4 * index;
    double x0 = task.start_to[2 * index], y0 = task.start_to[2 * index + 1];
    for (int i = 0; i < 4; ++i) A[i] = task.start_warp ? task.start_warp[4 * index + i] : (i == 0 || i == 3);
    bool is_converged = false;
    double likeness = 0;
    for (int iteration = 0; iteration < task.max_iterations; ++iteration) {
        double sum = 0;
        for (int y = -half, k = 0; y <= half; ++y) {
            for (int x = -half; x <= half; ++x, ++k) {
                if (!sample(task.to, x0 + A[0] * x + A[1] * y, y0 + A[2] * x + A[3] * y, s.found[k])) return false;
                sum += s.weight[k] * s.found[k];
            }
        }
        sum /= total;
        double product = 0, square = 0;
        for (int k = 0; k < n; ++k) {
            s.found[k] -= static_cast<float>(sum);
            product += s.weight[k] * s.found[k] * s.shown[k];
            square += s.weight[k] * s.found[k] * s.found[k];
        }
        likeness = product / std::sqrt(std::max(square * variance, 1e-300));
        if (!(product > 0)) return false;
        const auto gain = static_cast<float>(variance / product);
        double g[kGeometric], step[kGeometric];
        for (int a = 0; a < kGeometric; ++a) {
            double along = 0;
            for (int k = 0; k < n; ++k) along += s.weight[k] * s.columns[a][k] * (gain * s.found[k]);
            g[a] = along * scale[a];
        }
        solve_lower(L, kGeometric, kGeometric, g, step);
        solve_upper(L, kGeometric, kGeometric, step);
        for (int a = 0; a < kGeometric; ++a) step[a] *= scale[a];
        // the other image's patch looks as the template does moved by the step: compose with its inverse
        const double a = 1 + step[2], b = step[3], c = step[4], d = 1 + step[5], det = a * d - b * c;
        if (!(std::abs(det) > 0.2)) return false;
        const double inverse[4] = {d / det, -b / det, -c / det, a / det};
        const double mx = -(inverse[0] * step[0] + inverse[1] * step[1]), my = -(inverse[2] * step[0] + inverse[3] * step[1]);
        x0 += A[0] * mx + A[1] * my;
        y0 += A[2] * mx + A[3] * my;
        const double before[4] = {A[0], A[1], A[2], A[3]};
        for (int i = 0; i < 2; ++i)
            for (int j = 0; j < 2; ++j) A[2 * i + j] = before[2 * i] * inverse[j] + before[2 * i + 1] * inverse[2 + j];
        if (!(std::abs(A[0] * A[3] - A[1] * A[2]) > 0.1 && std::isfinite(x0 + y0))) return false;
        if (std::abs(mx) + std::abs(my) < task.tolerance_px) {
            is_converged = true;
            break;
        }
    }
    task.place[2 * index] = x0;
    task.place[2 * index + 1] = y0;
    task.likeness[index] = likeness;
    // covariance of the place: A S Aᵀ, S the first 2 x 2 of the inverse Hessian, noise of the template's units left out
    double inverse[4];
    for (int i = 0; i < 2; ++i) {
        double unit[kGeometric] = {}, x[kGeometric];
        unit[i] = scale[i];
        solve_lower(L, kGeometric, kGeometric, unit, x);
        solve_upper(L, kGeometric, kGeometric, x);
        inverse[2 * i] = x[0] * scale[0];
        inverse[2 * i + 1] = x[1] * scale[1];
    }
    const double noise2 = variance * std::max(1 / std::max(likeness * likeness, 1e-6) - 1, 0.0) / total;
    const double AS[4] = {A[0] * inverse[0] + A[1] * inverse[2], A[0] * inverse[1] + A[1] * inverse[3],
                          A[2] * inverse[0] + A[3] * inverse[2], A[2] * inverse[1] + A[3] * inverse[3]};
    task.spread[3 * index] = noise2 * (AS[0] * A[0] + AS[1] * A[1]);
    task.spread[3 * index + 1] = noise2 * (AS[0] * A[2] + AS[1] * A[3]);
    task.spread[3 * index + 2] = noise2 * (AS[2] * A[2] + AS[3] * A[3]);
    return is_converged;
}

template <int lanes>
BINOCAL_INLINE void match_some(const Task& task, std::size_t first, std::size_t last) {
    Scratch s;
    const double sigma = task.sigma_share * task.half;
    for (int y = -task.half, k = 0; y <= task.half; ++y)
        for (int x = -task.half; x <= task.half; ++x, ++k) s.weight[k] = static_cast<float>(std::exp(-0.5 * (x * x + y * y) / (sigma * sigma)));
    for (std::size_t index = first; index < last; ++index) {
        task.is_converged[index] = match_one(task, index, s);
    }
}

BINOCAL_DISPATCH(match_all, Task, (match_some<lanes>(task, first, last)))

void match_templates(const Plane& from, const Plane& to, const Doubles& start_from, const Doubles& start_to, const Doubles& start_warp, int half,
                     int max_iterations, double tolerance_px, double sigma_share, DoublesOut place, DoublesOut warp, DoublesOut likeness,
                     DoublesOut spread, nb::ndarray<bool, nb::device::cpu, nb::c_contig> is_converged, std::size_t n_threads) {
    const std::size_t n = likeness.size();
    require(half >= 2 && half <= kMostHalf, "a window reaches 2 to 15 pixels");
    require(start_from.size() == 2 * n && start_to.size() == 2 * n && place.size() == 2 * n && warp.size() == 4 * n && spread.size() == 3 * n &&
                is_converged.size() == n && (start_warp.size() == 0 || start_warp.size() == 4 * n),
            "one place, warp and result for each match");
    auto image = [](const Plane& plane) {
        return Image{plane.data(), static_cast<std::ptrdiff_t>(plane.shape(1)), static_cast<std::ptrdiff_t>(plane.shape(0))};
    };
    const Task task{image(from),  image(to),        start_from.data(), start_to.data(), start_warp.size() ? start_warp.data() : nullptr,
                    half,         max_iterations,   tolerance_px,      sigma_share,     place.data(),
                    warp.data(),  likeness.data(),  spread.data(),     is_converged.data()};
    nb::gil_scoped_release unlocked;
    lanczos();
    in_parallel(n, n_threads, [&](std::size_t first, std::size_t last) { match_all(task, first, last); });
}

}  // namespace

void register_template_match(nb::module_& module) { module.def("match_templates", &match_templates); }

}  // namespace binocal
