// Residuals, Jacobians and per-view normal equations of one camera (binocal.kernels.residuals says what the arrays mean).
//
// A view is linearised column by column: every column of [parameters, xi, residual] is a run of u entries followed by
// one of v entries, padded with zeros to whole vectors, so that both the camera model and the Gram matrix are plain
// loops over corners. Views are independent; each is summed in one fixed order, whatever the number of threads.

#include "camera_models.hpp"
#include "gram.hpp"
#include "kernel.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>
#include <stdexcept>
#include <string>
#include <string_view>

namespace binocal {
namespace {

constexpr double kHampelFlat = 3.5, kHampelDrop = 4.5, kHampelEnd = 7.0;  // binocal.solvers.robust
constexpr int kMaxColumns = (kMaxParameters + 7 + 3) / 4 * 4;  // parameters, 6 pose columns, the residual, in whole blocks

enum class Kernel { squared, cauchy, hampel };

struct Task {
    std::size_t n_views, views_per_rig, n;  // views of all rigs, views of one, corners of a view
    int p;                                  // parameters of the model
    const double *parameters, *R, *t, *points, *pixels, *scale;
    const double* whitening;  // (views, 3, n): a, b, c of every corner's [[a, 0], [b, c]]; null where all corners are alike
    const bool *is_seen, *is_free;
    bool sees_behind;
    Kernel kernel;
    double *gram, *r2, *cost;  // of accumulate
    double *coupling, *information;  // of accumulate where the board's points are wanted, else null
    bool gradient_only;              // of the points: the coupling is with the residual alone
    double* columns;           // of unweighted_columns, else null
};

// Room for one view, one per thread: the columns, weights, depths and squared lengths.
struct Scratch {
    std::size_t run;     // padded corners
    std::size_t stride;  // from column to column: u run, v run
    std::vector<double> memory;
    double *J, *trash, *weight, *Z, *length2;  // trash: three columns
    explicit Scratch(std::size_t n) : run((n + kRun - 1) / kRun * kRun), stride(2 * run) {
        memory.assign((kMaxColumns + 3) * stride + 3 * run + 8, 0.0);
        auto address = reinterpret_cast<std::uintptr_t>(memory.data());
        J = memory.data() + (64 - address % 64) % 64 / sizeof(double);
        trash = J + kMaxColumns * stride;
        weight = trash + 3 * stride;
        Z = weight + run;
        length2 = Z + run;
    }
};

// Columns, squared lengths and depths of one view.
template <class Model, bool Full>
BINOCAL_INLINE void fill(const Task& task, const Scratch& s, std::size_t view, double* const* column) {
    const std::size_t n = task.n, run = s.run;
    constexpr int p = n_parameters_of<Model>;
    double a[p];
    std::copy_n(task.parameters + view / task.views_per_rig * p, p, a);
    const double* R = task.R + 9 * view;
    const double* t = task.t + 3 * view;
    const double R00 = R[0], R01 = R[1], R02 = R[2], R10 = R[3], R11 = R[4], R12 = R[5], R20 = R[6], R21 = R[7],
                 R22 = R[8], t0 = t[0], t1 = t[1], t2 = t[2];
    const double *x = task.points, *y = x + n, *z = y + n;
    const double *pixel_u = task.pixels + 2 * n * view, *pixel_v = pixel_u + n;
    double *depth = s.Z, *length2 = s.length2;
    double* c[p + 7];
    std::copy(column, column + p + 7, c);
    BINOCAL_INDEPENDENT
    for (std::size_t j = 0; j < n; ++j) {
        const double X = R00 * x[j] + R01 * y[j] + R02 * z[j] + t0;
        const double Y = R10 * x[j] + R11 * y[j] + R12 * z[j] + t1;
        const double Z = R20 * x[j] + R21 * y[j] + R22 * z[j] + t2;
        const Linearization<Model> g = linearize<Model, Full>(a, X, Y, Z);
        if constexpr (Full) {
            c[0][j] = g.x, c[0][run + j] = 0;
            c[1][j] = 0, c[1][run + j] = g.y;
            c[2][j] = 1, c[2][run + j] = 0;
            c[3][j] = 0, c[3][run + j] = 1;
            c[4][j] = g.y, c[4][run + j] = 0;
            for (int k = 0; k < Model::n_coefficients; ++k)
                c[kIntrinsics + k][j] = g.coefficients[k][0], c[kIntrinsics + k][run + j] = g.coefficients[k][1];
        }
        c[p][j] = Y * g.uz - Z * g.uy, c[p][run + j] = Y * g.vz - Z * g.vy;
        c[p + 1][j] = Z * g.ux - X * g.uz, c[p + 1][run + j] = Z * g.vx - X * g.vz;
        c[p + 2][j] = X * g.uy - Y * g.ux, c[p + 2][run + j] = X * g.vy - Y * g.vx;
        c[p + 3][j] = g.ux, c[p + 3][run + j] = g.vx;
        c[p + 4][j] = g.uy, c[p + 4][run + j] = g.vy;
        c[p + 5][j] = g.uz, c[p + 5][run + j] = g.vz;
        const double e_u = pixel_u[j] - g.u, e_v = pixel_v[j] - g.v;
        c[p + 6][j] = e_u, c[p + 6][run + j] = e_v;
        depth[j] = Z;
        length2[j] = e_u * e_u + e_v * e_v;
    }
}

// log(1 + x) for x >= 0 to rounding, without a branch, so that it is computed for whole vectors; NaN where x is not finite.
BINOCAL_INLINE double log1p_positive(double x) {
    const double y = 1 + x, rest = (x - (y - 1)) / y;  // what rounding 1 + x lost
    const auto bits = std::bit_cast<std::uint64_t>(y);
    const std::uint64_t above = bits - 0x3fe6a09e667f3bcdULL;  // y = 2^k m with m in [sqrt(1/2), sqrt(2))
    const std::uint64_t k = above >> 52;
    const double m = std::bit_cast<double>(bits - (above & 0xfff0000000000000ULL));
    const double exponent = std::bit_cast<double>(k + 0x4338000000000000ULL) - 6755399441055744.0;
    const double s = (m - 1) / (m + 1), z = s * s;  // log m = 2 artanh s, |s| < 0.172: the next term is below 2e-17
    const double series =
        1.0 / 3 + z * (1.0 / 5 + z * (1.0 / 7 + z * (1.0 / 9 + z * (1.0 / 11 + z * (1.0 / 13 + z * (1.0 / 15 +
        z * (1.0 / 17 + z * (1.0 / 19))))))));
    return exponent * 0.693147180559945309417 + (2 * s * (1 + z * series) + rest);
}

// Robust cost of squared lengths (binocal.solvers.robust states the formulas).
BINOCAL_INLINE double robust_cost(Kernel kernel, const double* length2, std::size_t n, double scale) {
    const double s2 = scale * scale;
    constexpr std::size_t kParts = 8;  // several sums, so that they need not wait for one another
    double parts[kParts] = {};
    std::size_t j = 0;
    if (kernel == Kernel::cauchy) {
        const double inverse_s2 = 1 / s2;
        for (; j + kParts <= n; j += kParts) {
            for (std::size_t k = 0; k < kParts; ++k) parts[k] += log1p_positive(length2[j + k] * inverse_s2);
        }
        for (; j < n; ++j) parts[0] += log1p_positive(length2[j] * inverse_s2);
        double cost = 0;
        for (double part : parts) cost += part;
        return 0.5 * s2 * cost;
    }
    for (; j + kParts <= n; j += kParts) {
        for (std::size_t k = 0; k < kParts; ++k) parts[k] += length2[j + k];
    }
    for (; j < n; ++j) parts[0] += length2[j];
    double cost = 0;
    for (double part : parts) cost += 0.5 * part;
    if (kernel == Kernel::squared) return cost;
    // Few corners lie beyond the flat part of Hampel's kernel: those are gone through one by one.
    constexpr double a = kHampelFlat, b = kHampelDrop, c = kHampelEnd;
    const double flat2 = a * a * s2;
    double flat_cost = 0, bent_cost = 0;
    std::size_t n_beyond = 0;
    for (std::size_t i = 0; i < n; ++i) n_beyond += length2[i] > flat2;
    if (n_beyond == 0) return cost;
    for (std::size_t i = 0; i < n; ++i) {
        if (!(length2[i] > flat2)) {
            flat_cost += 0.5 * length2[i];
            continue;
        }
        const double q = std::sqrt(length2[i] / s2);
        const double fall = std::clamp((c - q) / (c - b), 0.0, 1.0);
        bent_cost += a * std::min(q, b) - 0.5 * a * a + (q > b ? 0.5 * a * (c - b) * (1 - fall * fall) : 0.0);
    }
    return flat_cost + s2 * bent_cost;
}

// Square roots of the corners' weights go to s.weight, 0 where not seen; false where all are 1 and none was written.
BINOCAL_INLINE bool weigh(const Task& task, const Scratch& s, std::size_t view) {
    const std::size_t n = task.n;
    const bool* seen = task.is_seen + n * view;
    const double* length2 = s.length2;
    double* weight = s.weight;
    const double scale = task.scale[view / task.views_per_rig], s2 = scale * scale;
    const double flat2 = task.kernel == Kernel::hampel ? kHampelFlat * kHampelFlat * s2 : 0.0;
    std::size_t n_beyond = 0, n_seen = 0;
    for (std::size_t j = 0; j < n; ++j) n_beyond += length2[j] > flat2;
    for (std::size_t j = 0; j < n; ++j) n_seen += seen[j];
    if (task.kernel == Kernel::cauchy) {
        BINOCAL_INDEPENDENT
        for (std::size_t j = 0; j < n; ++j) weight[j] = std::sqrt(s2 / (s2 + length2[j]));
    } else {
        if (n_seen == n && (task.kernel == Kernel::squared || n_beyond == 0)) return false;
        std::fill(weight, weight + n, 1.0);
    }
    if (task.kernel == Kernel::hampel && n_beyond > 0) {
        for (std::size_t j = 0; j < n; ++j) {
            if (!(length2[j] > flat2)) continue;
            const double q = std::sqrt(length2[j] / s2);
            const double fall = std::clamp((kHampelEnd - q) / (kHampelEnd - kHampelDrop), 0.0, 1.0);
            weight[j] = std::sqrt(kHampelFlat * fall / q);
        }
    }
    for (std::size_t j = 0; j < n; ++j) weight[j] = seen[j] ? weight[j] : 0.0;
    return true;
}

// A column times the weights; 0 where the weight is 0, whatever the column holds there.
BINOCAL_INLINE void scale_column(double* column, const double* weight, std::size_t n) {
    BINOCAL_INDEPENDENT
    for (std::size_t j = 0; j < n; ++j) {
        const double value = column[j];
        column[j] = (weight[j] != 0 ? value : 0.0) * weight[j];
    }
}

// A column's u and v runs times every corner's [[a, 0], [b, c]].
BINOCAL_INLINE void whiten_column(double* u, double* v, const double* whitening, std::size_t n) {
    const double *a = whitening, *b = a + n, *c = b + n;
    BINOCAL_INDEPENDENT
    for (std::size_t j = 0; j < n; ++j) {
        v[j] = b[j] * u[j] + c[j] * v[j];
        u[j] = a[j] * u[j];
    }
}

// The products of every column, weighted, with the derivatives by each board point: (m, 3, n) to coupling. And the points' own
// 3 x 3 information, (6, n): xx, xy, xz, yy, yz, zz. A board point moves a corner by R times its step, in the camera's frame, so
// its derivatives are those by the pose's translation, columns m - 4 to m - 2, turned.
BINOCAL_INLINE void couple_points(const Task& task, const Scratch& s, std::size_t view, int m) {
    const std::size_t n = task.n, run = s.run, stride = s.stride;
    const double *R = task.R + 9 * view, *tau = s.J + (m - 4) * stride;
    double* point = s.trash;  // u and v runs of three columns
    for (int axis = 0; axis < 3; ++axis) {
        const double a = R[axis], b = R[3 + axis], c = R[6 + axis];
        double* column = point + axis * stride;
        BINOCAL_INDEPENDENT
        for (std::size_t j = 0; j < stride; ++j) column[j] = a * tau[j] + b * tau[stride + j] + c * tau[2 * stride + j];
    }
    const int first = task.gradient_only ? m - 1 : 0;
    double* out = task.coupling + static_cast<std::size_t>(m - first) * 3 * n * view;
    for (int i = first; i < m; ++i) {
        const double *u = s.J + i * stride, *v = u + run;
        for (int axis = 0; axis < 3; ++axis, out += n) {
            const double *by_u = point + axis * stride, *by_v = by_u + run;
            BINOCAL_INDEPENDENT
            for (std::size_t j = 0; j < n; ++j) out[j] = u[j] * by_u[j] + v[j] * by_v[j];
        }
    }
    if (task.gradient_only) return;
    double* own = task.information + 6 * n * view;
    for (int a = 0; a < 3; ++a) {
        for (int b = a; b < 3; ++b, own += n) {
            const double *au = point + a * stride, *bu = point + b * stride;
            BINOCAL_INDEPENDENT
            for (std::size_t j = 0; j < n; ++j) own[j] = au[j] * bu[j] + au[run + j] * bu[run + j];
        }
    }
}

template <class Model, bool Full, int lanes>
BINOCAL_INLINE void run_views(const Task& task, std::size_t first, std::size_t last) {
    constexpr int p = n_parameters_of<Model>, q = p + 7;
    Scratch s(task.n);
    double* column[q];
    int m = 0;  // columns that are kept
    for (int i = 0; i < q; ++i) {
        const bool is_kept = i >= p || task.is_free[i];
        column[i] = is_kept ? s.J + m++ * s.stride : s.trash;
    }
    const int padded = (m + 3) / 4 * 4;
    double block[kMaxColumns * kMaxColumns];
    for (std::size_t view = first; view < last; ++view) {
        fill<Model, Full>(task, s, view, column);
        const std::size_t n = task.n;
        const bool* seen = task.is_seen + n * view;
        bool is_impossible = false;
        if (!task.sees_behind) {
            int n_behind = 0;
            for (std::size_t j = 0; j < n; ++j) n_behind += seen[j] & (s.Z[j] <= 0);
            is_impossible = n_behind > 0;
        }
        if (task.whitening) {
            for (int i = 0; i < m; ++i) {
                double* c = s.J + i * s.stride;
                whiten_column(c, c + s.run, task.whitening + 3 * n * view, n);
            }
            const double *e_u = s.J + (m - 1) * s.stride, *e_v = e_u + s.run;
            for (std::size_t j = 0; j < n; ++j) s.length2[j] = e_u[j] * e_u[j] + e_v[j] * e_v[j];
        }
        for (std::size_t j = 0; j < n; ++j) s.length2[j] = seen[j] ? s.length2[j] : 0.0;
        const double cost = robust_cost(task.kernel, s.length2, n, task.scale[view / task.views_per_rig]);
        if (weigh(task, s, view)) {
            for (int i = 0; i < m; ++i) {
                double* c = s.J + i * s.stride;
                for (int half = 0; half < 2; ++half, c += s.run) {
                    scale_column(c, s.weight, n);
                }
            }
        }
        std::memcpy(task.r2 + n * view, s.length2, n * sizeof(double));
        task.cost[view] = is_impossible || !std::isfinite(cost) ? std::numeric_limits<double>::infinity() : cost;
        gram_matrix<lanes>(s.J, s.stride, padded, block);
        double* gram = task.gram + static_cast<std::size_t>(m) * m * view;
        for (int i = 0; i < m; ++i) {
            for (int k = i; k < m; ++k) gram[i * m + k] = gram[k * m + i] = block[i * padded + k];
        }
        if (task.coupling) couple_points(task, s, view, m);
    }
}

template <class Model, int lanes>
BINOCAL_INLINE void fill_columns(const Task& task, std::size_t first, std::size_t last) {
    constexpr int p = n_parameters_of<Model>, q = p + 7;
    const std::size_t n = task.n;
    Scratch s(n);
    double* column[q];
    for (int i = 0; i < q; ++i) column[i] = s.J + i * s.stride;
    for (std::size_t view = first; view < last; ++view) {
        fill<Model, true>(task, s, view, column);
        const bool* seen = task.is_seen + n * view;
        for (int row = 0; row < 2 * q; ++row) {
            const double* from = s.J + row * s.run;
            double* to = task.columns + (2 * q * view + row) * n;
            for (std::size_t j = 0; j < n; ++j) to[j] = seen[j] ? from[j] : 0.0;
        }
    }
}

template <class Model, bool is_whitened>
BINOCAL_INLINE void measure_as(const Task& task, std::size_t first, std::size_t last) {
    const std::size_t n = task.n;
    const double *x = task.points, *y = x + n, *z = y + n;
    for (std::size_t view = first; view < last; ++view) {
        constexpr int p = n_parameters_of<Model>;
        double parameters[p];
        std::copy_n(task.parameters + view / task.views_per_rig * p, p, parameters);
        const double *R = task.R + 9 * view, *t = task.t + 3 * view, *pixel = task.pixels + 2 * n * view;
        const bool* seen = task.is_seen + n * view;
        const double *a = is_whitened ? task.whitening + 3 * n * view : nullptr, *b = is_whitened ? a + n : nullptr,
                     *c = is_whitened ? b + n : nullptr;
        double* out = task.r2 + n * view;
        BINOCAL_INDEPENDENT
        for (std::size_t j = 0; j < n; ++j) {
            const double X = R[0] * x[j] + R[1] * y[j] + R[2] * z[j] + t[0], Y = R[3] * x[j] + R[4] * y[j] + R[5] * z[j] + t[1],
                         Z = R[6] * x[j] + R[7] * y[j] + R[8] * z[j] + t[2];
            const Point2<double, double> at = project<Model>(parameters, X, Y, Z);
            double e_u = pixel[j] - at.x, e_v = pixel[n + j] - at.y;
            if constexpr (is_whitened) {
                e_v = b[j] * e_u + c[j] * e_v;
                e_u = a[j] * e_u;
            }
            out[j] = e_u * e_u + e_v * e_v;
        }
        for (std::size_t j = 0; j < n; ++j) {
            out[j] = !seen[j] ? 0.0 : std::isfinite(out[j]) ? out[j] : std::numeric_limits<double>::infinity();
        }
    }
}

template <class Model, int lanes>
BINOCAL_INLINE void measure(const Task& task, std::size_t first, std::size_t last) {
    if (task.whitening) {
        measure_as<Model, true>(task, first, last);
    } else {
        measure_as<Model, false>(task, first, last);
    }
}

#define BINOCAL_COPIES(name, Model)                                                     \
    BINOCAL_DISPATCH(views_##name, Task, (run_views<Model, true, lanes>(task, first, last)))  \
    BINOCAL_DISPATCH(held_##name, Task, (run_views<Model, false, lanes>(task, first, last)))  \
    BINOCAL_DISPATCH(columns_##name, Task, (fill_columns<Model, lanes>(task, first, last)))   \
    BINOCAL_DISPATCH(measure_##name, Task, (measure<Model, lanes>(task, first, last)))
BINOCAL_CAMERA_MODELS(BINOCAL_COPIES)

using Work = void (*)(const Task&, std::size_t, std::size_t);
struct Copies {
    std::string_view name;
    int n_parameters;
    bool sees_behind;
    Work views, held, columns, measure;
};
#define BINOCAL_ENTRY(name, Model) \
    {#name, n_parameters_of<Model>, Model::sees_behind, views_##name, held_##name, columns_##name, measure_##name},
constexpr Copies kModels[] = {BINOCAL_CAMERA_MODELS(BINOCAL_ENTRY)};

const Copies& copies_of(const std::string& name) {
    for (const Copies& model : kModels) {
        if (model.name == name) return model;
    }
    throw std::invalid_argument("no compiled camera model " + name);
}

Kernel kernel_of(const std::string& name) {
    if (name == "squared") return Kernel::squared;
    if (name == "cauchy") return Kernel::cauchy;
    if (name == "hampel") return Kernel::hampel;
    throw std::invalid_argument("no robust kernel " + name);
}

// Corners of one camera's views and where it stands. Shapes: parameters (rigs, p), R (views, 3, 3), t (views, 3), points (3, n),
// pixels (views, 2, n), is_seen (views, n), whitening (views, 3, n) or empty; views counts those of all rigs.
struct Views {
    Doubles parameters, R, t, points, pixels;
    Flags is_seen;
    Doubles whitening;
};

// What `accumulate` writes: (views, q, q), (views, n), (views); (views, q, 3, n) and (views, 6, n), or (views, 3, n) for the points'
// gradient alone and empty, or both empty.
struct Sums {
    DoublesOut gram, r2, cost, coupling, information;
};

Task make_task(const Copies& model, const Views& given) {
    const auto& [parameters, R, t, points, pixels, is_seen, whitening] = given;
    require(is_seen.ndim() == 2 && parameters.ndim() == 2 && points.ndim() == 2, "wrong number of dimensions");
    const std::size_t views = is_seen.shape(0), n = is_seen.shape(1), rigs = parameters.shape(0);
    require(parameters.shape(1) == static_cast<std::size_t>(model.n_parameters), "wrong number of parameters");
    require(R.size() == 9 * views && t.size() == 3 * views, "R or t does not match the views");
    require(points.shape(0) == 3 && points.shape(1) == n, "object points must be (3, n)");
    require(pixels.size() == 2 * views * n, "pixels must be (views, 2, n)");
    require(whitening.size() == 0 || whitening.size() == 3 * views * n, "whitening must be (views, 3, n)");
    require(rigs > 0 && views % rigs == 0, "the views do not divide among the rigs");
    Task task{};
    task.n_views = views, task.views_per_rig = std::max<std::size_t>(views / rigs, 1), task.n = n;
    task.p = model.n_parameters, task.sees_behind = model.sees_behind;
    task.parameters = parameters.data(), task.R = R.data(), task.t = t.data(), task.points = points.data();
    task.pixels = pixels.data(), task.is_seen = is_seen.data();
    task.whitening = whitening.size() > 0 ? whitening.data() : nullptr;
    return task;
}

void accumulate(const std::string& name, const Views& views, const Flags& is_free, const Doubles& scale, const std::string& kernel,
                const Sums& out, std::size_t n_threads) {
    const Copies& model = copies_of(name);
    Task task = make_task(model, views);
    require(is_free.size() == static_cast<std::size_t>(task.p), "is_free must have one flag for each parameter");
    const std::size_t n_free = std::count(is_free.data(), is_free.data() + is_free.size(), true), q = n_free + 7;
    require(scale.size() == views.parameters.shape(0), "one scale for each rig");
    require(out.gram.size() == q * q * task.n_views && out.r2.size() == task.n * task.n_views && out.cost.size() == task.n_views,
            "an output has the wrong size");
    task.is_free = is_free.data(), task.scale = scale.data(), task.kernel = kernel_of(kernel);
    const bool couples = out.coupling.size() > 0, has_all = out.information.size() > 0;
    require(out.coupling.size() == (has_all ? 3 * q : couples ? 3 : 0) * task.n * task.n_views &&
                out.information.size() == (has_all ? 6 * task.n * task.n_views : 0),
            "an output of the board's points has the wrong size");
    task.gradient_only = couples && !has_all;
    if (couples) task.coupling = out.coupling.data(), task.information = out.information.data();
    task.gram = out.gram.data(), task.r2 = out.r2.data(), task.cost = out.cost.data();
    const Work work = n_free > 0 ? model.views : model.held;
    nb::gil_scoped_release unlocked;
    in_parallel(task.n_views, n_threads, [&](std::size_t first, std::size_t last) { work(task, first, last); });
}

// Robust cost of stored squared lengths, (rigs, m), each rig under its own scale.
void costs(const Doubles& r2, const Doubles& scale, const std::string& kernel, DoublesOut cost) {
    require(r2.ndim() == 2 && scale.size() == r2.shape(0) && cost.size() == r2.shape(0), "one scale and cost for each rig");
    const std::size_t m = r2.shape(1);
    const Kernel which = kernel_of(kernel);
    nb::gil_scoped_release unlocked;
    for (std::size_t rig = 0; rig < r2.shape(0); ++rig) {
        cost.data()[rig] = robust_cost(which, r2.data() + rig * m, m, scale.data()[rig]);
    }
}

// Median of non-negative numbers, which order like their bits: the bin of the leading ones that holds the middle is found
// first, and only its few numbers are sorted out. NaN counts as largest.
double median(const double* values, std::size_t n) {
    constexpr int kShift = 50;  // 11 bits of exponent and 2 of mantissa are left
    std::vector<std::uint32_t> count(std::size_t{1} << (64 - kShift), 0);
    auto bin_of = [](double value) { return std::bit_cast<std::uint64_t>(value) >> kShift; };
    for (std::size_t i = 0; i < n; ++i) ++count[bin_of(values[i])];
    const std::size_t k = (n - 1) / 2;
    std::size_t chosen = 0, below = 0;
    while (below + count[chosen] <= k) below += count[chosen++];
    std::vector<double> bin(count[chosen] + 1);
    for (std::size_t i = 0, kept = 0; i < n; ++i) {
        bin[kept] = values[i];
        kept += bin_of(values[i]) == chosen;
    }
    bin.pop_back();
    auto less = [](double a, double b) { return std::bit_cast<std::uint64_t>(a) < std::bit_cast<std::uint64_t>(b); };
    const auto middle = bin.begin() + (k - below);
    std::nth_element(bin.begin(), middle, bin.end(), less);
    if (n % 2 == 1) return *middle;
    if (middle + 1 != bin.end()) return 0.5 * (*middle + *std::min_element(middle + 1, bin.end(), less));
    while (count[++chosen] == 0) {
    }
    double high = std::numeric_limits<double>::infinity();  // the next larger one begins the next bin
    for (std::size_t i = 0; i < n; ++i) {
        if (bin_of(values[i]) == chosen) high = std::min(high, values[i], less);
    }
    return 0.5 * (*middle + high);
}

// Median of each rig's seen squared lengths over all cameras; 0 where nothing is seen.
void medians(const std::vector<Doubles>& r2, const std::vector<Flags>& is_seen, DoublesOut out) {
    require(!r2.empty() && r2.size() == is_seen.size(), "as many flags as lengths");
    const std::size_t n_rigs = out.size();
    for (std::size_t camera = 0; camera < r2.size(); ++camera) {
        require(n_rigs > 0 && r2[camera].size() == is_seen[camera].size() && r2[camera].size() % n_rigs == 0,
                "the lengths do not divide among the rigs");
    }
    nb::gil_scoped_release unlocked;
    std::vector<double> values;
    for (std::size_t rig = 0; rig < n_rigs; ++rig) {
        values.clear();
        for (std::size_t camera = 0; camera < r2.size(); ++camera) {
            const std::size_t m = r2[camera].size() / n_rigs, start = values.size();
            const double* lengths2 = r2[camera].data() + rig * m;
            const bool* seen = is_seen[camera].data() + rig * m;
            values.resize(start + m);
            std::size_t kept = start;
            for (std::size_t j = 0; j < m; ++j) {
                values[kept] = lengths2[j];
                kept += seen[j];
            }
            values.resize(kept);
        }
        out.data()[rig] = values.empty() ? 0.0 : median(values.data(), values.size());
    }
}

void squared_lengths(const std::string& name, const Views& views, DoublesOut r2, std::size_t n_threads) {
    const Copies& model = copies_of(name);
    Task task = make_task(model, views);
    require(r2.size() == task.n * task.n_views, "the output has the wrong size");
    task.r2 = r2.data();
    nb::gil_scoped_release unlocked;
    in_parallel(task.n_views, n_threads, [&](std::size_t first, std::size_t last) { model.measure(task, first, last); });
}

void unweighted_columns(const std::string& name, const Views& views, DoublesOut columns) {
    const Copies& model = copies_of(name);
    Task task = make_task(model, views);
    require(!task.whitening, "columns are not whitened");
    require(columns.size() == 2 * (model.n_parameters + 7) * task.n * task.n_views, "the output has the wrong size");
    task.columns = columns.data();
    nb::gil_scoped_release unlocked;
    model.columns(task, 0, task.n_views);
}

}  // namespace

void register_accumulate(nb::module_& module) {
    nb::class_<Views>(module, "Views")
        .def(nb::init<Doubles, Doubles, Doubles, Doubles, Doubles, Flags, Doubles>(), nb::kw_only(), "parameters"_a, "R"_a, "t"_a,
             "points"_a, "pixels"_a, "is_seen"_a, "whitening"_a);
    nb::class_<Sums>(module, "Sums").def(nb::init<DoublesOut, DoublesOut, DoublesOut, DoublesOut, DoublesOut>(), nb::kw_only(), "gram"_a, "r2"_a,
                                     "cost"_a, "coupling"_a, "information"_a);
    module.def("accumulate", &accumulate);
    module.def("costs", &costs);
    module.def("medians", &medians);
    module.def("squared_lengths", &squared_lengths);
    module.def("unweighted_columns", &unweighted_columns);
}

}  // namespace binocal
