// Least-squares homographies of many images of one plane (binocal.geometry.homography states the formulas).

#include "gram.hpp"
#include "kernel.hpp"
#include "linear_algebra.hpp"

#include <algorithm>
#include <vector>

namespace binocal {
namespace {

constexpr double kLeastDepth2 = 1e-2;  // a depth under 0.1 of the centre's is a wild fit
constexpr int kBasis = 8;              // x², xy, y², x, y, 1 and two runs of zeros: whole blocks of four

struct Planes {
    std::size_t n_views, n;
    int n_passes;
    const double *xy, *u, *v, *w;  // (2, n), then (views, n) each
    double *rows, *S_inverse, *P, *D_inverse, *du, *dv;
};

// The fit of one image from its moments: sums over points of w, w u, w v and w (u² + v²) times the basis, (4, kBasis).
BINOCAL_INLINE void solve_moments(const double* moments, double* rows, double* S_inverse, double* P, double* D_inverse) {
    double S[4][3][3];
    for (int k = 0; k < 4; ++k) {
        const double* m = moments + kBasis * k;
        const double full[3][3] = {{m[0], m[1], m[3]}, {m[1], m[2], m[4]}, {m[3], m[4], m[5]}};
        std::copy(&full[0][0], &full[0][0] + 9, &S[k][0][0]);
    }
    const auto& A = S[0];
    double* I = S_inverse;
    inverse_symmetric3(A[0][0], A[0][1], A[0][2], A[1][1], A[1][2], A[2][2], I);
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 6; ++j) {
            const auto& of = S[j < 3 ? 1 : 2];
            const int column = j % 3;
            P[6 * i + j] = I[3 * i] * of[0][column] + I[3 * i + 1] * of[1][column] + I[3 * i + 2] * of[2][column];
        }
    }
    double D[2][3];
    for (int i = 0; i < 2; ++i) {
        for (int j = 0; j < 3; ++j) {
            double sum = S[3][i][j];
            for (int k = 0; k < 3; ++k) sum -= S[1][i][k] * P[6 * k + j];
            for (int k = 0; k < 3; ++k) sum -= S[2][i][k] * P[6 * k + 3 + j];
            D[i][j] = sum;
        }
    }
    const double scale = D[0][0] * D[1][1] - D[0][1] * D[0][1];
    D_inverse[0] = D[1][1] / scale, D_inverse[1] = D_inverse[2] = -D[0][1] / scale, D_inverse[3] = D[0][0] / scale;
    double* h = rows + 6;
    h[0] = -(D_inverse[0] * D[0][2] + D_inverse[1] * D[1][2]);
    h[1] = -(D_inverse[2] * D[0][2] + D_inverse[3] * D[1][2]);
    h[2] = 1;
    for (int i = 0; i < 3; ++i) {
        rows[i] = P[6 * i] * h[0] + P[6 * i + 1] * h[1] + P[6 * i + 2];
        rows[3 + i] = P[6 * i + 3] * h[0] + P[6 * i + 4] * h[1] + P[6 * i + 5];
    }
}

template <int lanes>
BINOCAL_INLINE void fit_views(const Planes& task, std::size_t first, std::size_t last) {
    const std::size_t n = task.n, run = (n + kRun - 1) / kRun * kRun;
    std::vector<double> memory((kBasis + 4 + 1) * run, 0.0);
    double *basis = memory.data(), *weighted = basis + kBasis * run, *depth = weighted + 4 * run;
    const double *x = task.xy, *y = x + n;
    for (std::size_t j = 0; j < n; ++j) {
        const double terms[6] = {x[j] * x[j], x[j] * y[j], y[j] * y[j], x[j], y[j], 1.0};
        for (int k = 0; k < 6; ++k) basis[k * run + j] = terms[k];
    }
    double moments[4 * kBasis];
    for (std::size_t view = first; view < last; ++view) {
        const double *u = task.u + n * view, *v = task.v + n * view, *w = task.w + n * view;
        double *du = task.du + n * view, *dv = task.dv + n * view, *r = task.rows + 9 * view;
        for (int pass = 0; pass < task.n_passes; ++pass) {
            const bool is_first = pass == 0;
            BINOCAL_INDEPENDENT
            for (std::size_t j = 0; j < n; ++j) {
                const double depth2 = is_first ? 1.0 : depth[j] * depth[j];
                const double weight = w[j] / (depth2 > kLeastDepth2 ? depth2 : kLeastDepth2);
                weighted[j] = weight;
                weighted[run + j] = weight * u[j];
                weighted[2 * run + j] = weight * v[j];
                weighted[3 * run + j] = weight * (u[j] * u[j] + v[j] * v[j]);
            }
            for (int k = 0; k < kBasis; k += 4) dot_block<lanes>(weighted, basis + k * run, run, moments + k, kBasis);
            solve_moments(moments, r, task.S_inverse + 9 * view, task.P + 18 * view, task.D_inverse + 4 * view);
            const double r0 = r[0], r1 = r[1], r2 = r[2], r3 = r[3], r4 = r[4], r5 = r[5], r6 = r[6], r7 = r[7];
            BINOCAL_INDEPENDENT
            for (std::size_t j = 0; j < n; ++j) {
                const double z = r6 * x[j] + r7 * y[j] + 1.0, inverse = 1.0 / z;
                depth[j] = z;
                du[j] = u[j] - (r0 * x[j] + r1 * y[j] + r2) * inverse;
                dv[j] = v[j] - (r3 * x[j] + r4 * y[j] + r5) * inverse;
            }
        }
    }
}

BINOCAL_DISPATCH(fits_of_views, Planes, (fit_views<lanes>(task, first, last)))

// What `fit_planes` writes, for each view: homography, blocks of the inverse normal matrix, residuals.
struct PlaneFits {
    DoublesOut rows, S_inverse, P, D_inverse, du, dv;
};

void fit_planes(const Doubles& xy, const Doubles& u, const Doubles& v, const Doubles& w, int n_passes, const PlaneFits& out,
                std::size_t n_threads) {
    const auto& [rows, S_inverse, P, D_inverse, du, dv] = out;
    require(xy.ndim() == 2 && xy.shape(0) == 2 && xy.shape(1) > 0, "plane points must be (2, n)");
    const std::size_t n = xy.shape(1), views = u.size() / n;
    require(u.size() == views * n && v.size() == views * n && w.size() == views * n, "u, v and w must be (views, n)");
    require(rows.size() == 9 * views && S_inverse.size() == 9 * views && P.size() == 18 * views &&
                D_inverse.size() == 4 * views && du.size() == views * n && dv.size() == views * n,
            "an output has the wrong size");
    const Planes task{views, n, n_passes, xy.data(), u.data(), v.data(), w.data(), rows.data(), S_inverse.data(),
                      P.data(), D_inverse.data(), du.data(), dv.data()};
    nb::gil_scoped_release unlocked;
    in_parallel(views, n_threads, [&](std::size_t first, std::size_t last) { fits_of_views(task, first, last); });
}

}  // namespace

void register_planes(nb::module_& module) {
    nb::class_<PlaneFits>(module, "PlaneFits")
        .def(nb::init<DoublesOut, DoublesOut, DoublesOut, DoublesOut, DoublesOut, DoublesOut>(), nb::kw_only(), "rows"_a, "S_inverse"_a,
             "P"_a, "D_inverse"_a, "du"_a, "dv"_a);
    module.def("fit_planes", &fit_planes);
}

}  // namespace binocal
