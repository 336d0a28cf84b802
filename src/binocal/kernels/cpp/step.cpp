// The step of the joint solver: normal equations of a rig from those of its views, board poses eliminated
// (binocal.kernels.steps says what the arrays mean). Rigs are independent; each is summed in one fixed order.

#include "camera_models.hpp"
#include "gram.hpp"
#include "kernel.hpp"
#include "linear_algebra.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

namespace binocal {
namespace {

constexpr double kTiny = 1e-300;
constexpr int kMaxGram = (kMaxParameters + 7) * (kMaxParameters + 7);  // parameters, 6 pose columns, the residual
constexpr int kMaxShared = 2 * kMaxParameters + 6;                   // two cameras and the rig
constexpr int kMaxColumns = (kMaxShared + 1 + kRun - 1) / kRun * kRun;  // those and the gradient, in whole vectors

struct CameraPart {
    const double* gram;       // (rigs, views, q, q), q = p + 7
    int p;                    // free parameters, before the six pose columns
    std::vector<int> keep;    // columns of the Gram matrix that are shared unknowns
    std::vector<int> place;   // and where they stand among those
};

struct Problem {
    std::vector<CameraPart> cameras;
    std::size_t n_rigs, n_views;
    int s;                                // shared unknowns
    const double *R, *t;                  // T_right_left of each rig, null with one camera
    const double *prior_information, *prior_gradient;  // (rigs, s, s), (rigs, s), added to the shared equations; or null
    const double *growth, *pose_growth;   // (rigs), what the diagonals of shared unknowns and of poses are multiplied by
    const double* stretch;                // (rigs, s), what the shared steps are multiplied by, or null
    const double* shift;                  // (rigs, s), what is added to them, or null
    double *shared, *views, *predicted;   // (rigs, s), (rigs, views, 6), (rigs); null if only reduced is wanted
    double* reduced;                      // (rigs, s, s), or null
    double *gradient, *pivot;             // (rigs, s), (rigs): reduced gradient, least pivot of its equilibrated matrix; or null
};

struct Workspace {
    std::size_t stride;
    int m;  // columns of Y with padding
    std::vector<double> Y, L, scale, H, g, block, gradients, diagonals, totals;
    Workspace(const Problem& problem)
        : stride((6 * problem.n_views + kRun - 1) / kRun * kRun), m((problem.s + 1 + 3) / 4 * 4),
          Y(m * stride, 0.0), L(36 * problem.n_views), scale(6 * problem.n_views), H(problem.s * problem.s),
          g(problem.s), block(m * m), gradients(6 * problem.n_views), diagonals(6 * problem.n_views), totals(2 * kMaxGram) {}
};

using Coupling = double[6][kMaxColumns];  // of a view with the shared unknowns, row after row, then in column s its gradient

// Adds one camera's corners of a view to the view's pose equations A and coupling, and to the camera's totals.
BINOCAL_INLINE void add_camera(const Problem& problem, std::size_t rig, std::size_t view, std::size_t index, Workspace& w, double* A,
                               Coupling& W) {
    const CameraPart& camera = problem.cameras[index];
    const double *R = problem.R ? problem.R + 9 * rig : nullptr, *t = problem.t ? problem.t + 3 * rig : nullptr;
    const int s = problem.s, p = camera.p, q = p + 7, n_keep = static_cast<int>(camera.keep.size());
    const double* G = camera.gram + (rig * problem.n_views + view) * q * q;
    for (int i = 0; i < n_keep; ++i) {
        const double* row = G + camera.keep[i] * q;
        double x[6];
        for (int k = 0; k < 6; ++k) x[k] = row[p + k];
        if (index == 1) adjoint_transposed(R, t, x);
        for (int k = 0; k < 6; ++k) W[k][camera.place[i]] += x[k];
    }
    double* total = w.totals.data() + index * kMaxGram;
    for (int i = 0; i < q * q; ++i) total[i] += G[i];
    double pose[7][6];  // the pose columns and the gradient, at first G's own
    for (int i = 0; i < 7; ++i) {
        const double* row = G + (p + i) * q + p;
        for (int k = 0; k < 6; ++k) pose[i][k] = row[k];
    }
    if (index == 1) {
        for (auto& column : pose) adjoint_transposed(R, t, column);  // Adᵀ G, by columns
        for (int k = 0; k < 6; ++k) {                                // (Adᵀ G) Ad = (Adᵀ (Adᵀ G)ᵀ)ᵀ
            double x[6];
            for (int i = 0; i < 6; ++i) x[i] = pose[i][k];
            adjoint_transposed(R, t, x);
            for (int i = 0; i < 6; ++i) pose[i][k] = x[i];
        }
    }
    for (int i = 0; i < 6; ++i) {
        for (int k = 0; k < 6; ++k) A[6 * i + k] += pose[i][k];
        W[i][s] += pose[6][i];
    }
}

// Takes a view whose corners do not determine its pose out of all sums: it neither steps nor counts.
BINOCAL_INLINE void leave_out(const Problem& problem, std::size_t rig, std::size_t view, Workspace& w, Coupling& W) {
    for (std::size_t index = 0; index < problem.cameras.size(); ++index) {
        const int q = problem.cameras[index].p + 7;
        const double* G = problem.cameras[index].gram + (rig * problem.n_views + view) * q * q;
        double* total = w.totals.data() + index * kMaxGram;
        for (int i = 0; i < q * q; ++i) total[i] -= G[i];
    }
    double *A = w.L.data() + 36 * view, *scale = w.scale.data() + 6 * view;
    std::fill(A, A + 36, 0.0);
    for (int i = 0; i < 6; ++i) A[7 * i] = scale[i] = 1;
    for (auto& row : W) std::fill(row, row + problem.s + 1, 0.0);
    std::fill_n(w.diagonals.data() + 6 * view, 6, 0.0);
    std::fill_n(w.gradients.data() + 6 * view, 6, 0.0);
}

// Factorises one view's pose equations and writes its rows of Y = L⁻¹ S [coupling, gradient]; false where they are singular.
BINOCAL_INLINE bool eliminate_view(const Problem& problem, std::size_t rig, std::size_t view, Workspace& w) {
    const int s = problem.s;
    double* A = w.L.data() + 36 * view;
    alignas(64) Coupling W;
    std::fill(A, A + 36, 0.0);
    for (auto& row : W) std::fill(row, row + s + 1, 0.0);
    for (std::size_t index = 0; index < problem.cameras.size(); ++index) add_camera(problem, rig, view, index, w, A, W);
    double trace = 0;
    double *scale = w.scale.data() + 6 * view, *diagonal = w.diagonals.data() + 6 * view;
    for (int i = 0; i < 6; ++i) trace += diagonal[i] = A[7 * i];
    for (int i = 0; i < 6; ++i) w.gradients[6 * view + i] = W[i][s];
    if (!(trace > 0)) {  // no corner at all: the view neither steps nor counts
        std::fill(A, A + 36, 0.0);
        for (int i = 0; i < 6; ++i) A[7 * i] = 1;
    }
    for (int i = 0; i < 6; ++i) A[7 * i] *= problem.pose_growth[rig];
    for (int i = 0; i < 6; ++i) scale[i] = 1 / std::sqrt(std::max(A[7 * i], kTiny));
    for (int i = 0; i < 6; ++i) {
        for (int k = 0; k < 6; ++k) A[6 * i + k] *= scale[i] * scale[k];
    }
    const bool is_determined = cholesky(A, A, 6, 6, 0.0);
    if (!is_determined) leave_out(problem, rig, view, w, W);
    for (int i = 0; i < 6; ++i) {  // in place, all columns at once
        const double inverse_pivot = A[7 * i];
        double* row = W[i];
        for (int column = 0; column <= s; ++column) row[column] *= scale[i];
        for (int k = 0; k < i; ++k) {
            for (int column = 0; column <= s; ++column) row[column] -= A[6 * i + k] * W[k][column];
        }
        for (int column = 0; column <= s; ++column) row[column] *= inverse_pivot;
    }
    for (int column = 0; column <= s; ++column) {
        for (int i = 0; i < 6; ++i) w.Y[column * w.stride + 6 * view + i] = W[i][column];
    }
    return is_determined;
}

// The shared unknowns' own equations H, g, priors included.
BINOCAL_INLINE void sum_shared(const Problem& problem, std::size_t rig, Workspace& w) {
    const int s = problem.s;
    for (std::size_t index = 0; index < problem.cameras.size(); ++index) {
        const CameraPart& camera = problem.cameras[index];
        const int q = camera.p + 7, n_keep = static_cast<int>(camera.keep.size());
        for (int i = 0; i < n_keep; ++i) {
            const double* row = w.totals.data() + index * kMaxGram + camera.keep[i] * q;
            for (int k = 0; k < n_keep; ++k) w.H[camera.place[i] * s + camera.place[k]] += row[camera.keep[k]];
            w.g[camera.place[i]] += row[q - 1];
        }
    }
    if (problem.prior_information) {
        for (int i = 0; i < s * s; ++i) w.H[i] += problem.prior_information[rig * s * s + i];
        for (int i = 0; i < s; ++i) w.g[i] += problem.prior_gradient[rig * s + i];
    }
}

// Solves the equilibrated shared equations A x = x0 and alters the solution as the problem says; false where they are singular.
// Adds to `unsolved` the altered step times what it leaves of the gradient.
BINOCAL_INLINE bool solve_shared(const Problem& problem, std::size_t rig, std::vector<double>& A, std::vector<double>& x,
                                 const std::vector<double>& scale, double& unsolved) {
    const int s = problem.s;
    for (int i = 0; i < s; ++i) {
        for (int k = 0; k < s; ++k) A[i * s + k] *= scale[i] * scale[k];
        x[i] *= scale[i];
    }
    std::vector<double> plain, right_side;  // the equations as they were, for a step that does not solve them
    const bool is_altered = problem.stretch || problem.shift;
    if (is_altered) plain = A, right_side = x;
    double least_pivot;
    if (!eliminate(A.data(), x.data(), s, least_pivot)) return false;
    if (problem.pivot) problem.pivot[rig] = least_pivot;
    if (!is_altered) return true;
    for (int i = 0; i < s; ++i) {
        if (problem.stretch) x[i] *= problem.stretch[rig * s + i];
        if (problem.shift) x[i] += problem.shift[rig * s + i] / scale[i];
    }
    for (int i = 0; i < s; ++i) {
        double left = right_side[i];
        for (int k = 0; k < s; ++k) left -= plain[i * s + k] * x[k];
        unsolved += x[i] * left;
    }
    return true;
}

// The views' best steps beside the shared one, and the fall of the cost that both predict.
BINOCAL_INLINE double step_views(const Problem& problem, std::size_t rig, const Workspace& w, double unsolved) {
    const int s = problem.s;
    const std::size_t n_views = problem.n_views;
    const double growth = problem.growth[rig], pose_growth = problem.pose_growth[rig];
    const double *shared = problem.shared + rig * s, *Y = w.Y.data();
    double* views = problem.views + 6 * n_views * rig;
    double linear = 0, extra = 0, pose_extra = 0;
    for (int i = 0; i < s; ++i) {
        linear += shared[i] * w.g[i];
        extra += shared[i] * shared[i] * w.H[i * s + i];
    }
    for (std::size_t entry = 0; entry < 6 * n_views; ++entry) views[entry] = Y[s * w.stride + entry];
    for (int column = 0; column < s; ++column) {
        const double* y = Y + column * w.stride;
        for (std::size_t entry = 0; entry < 6 * n_views; ++entry) views[entry] -= y[entry] * shared[column];
    }
    for (std::size_t view = 0; view < n_views; ++view) {
        double* xi = views + 6 * view;
        solve_upper(w.L.data() + 36 * view, 6, 6, xi);
        for (int i = 0; i < 6; ++i) {
            xi[i] *= w.scale[6 * view + i];
            linear += xi[i] * w.gradients[6 * view + i];
            pose_extra += xi[i] * xi[i] * w.diagonals[6 * view + i];
        }
    }
    return 0.5 * (linear + unsolved + (growth - 1) * extra + (pose_growth - 1) * pose_extra);
}

template <int lanes>
BINOCAL_INLINE bool step_of_rig(const Problem& problem, std::size_t rig, Workspace& w) {
    const int s = problem.s;
    const double growth = problem.growth[rig];
    std::fill(w.H.begin(), w.H.end(), 0.0);
    std::fill(w.g.begin(), w.g.end(), 0.0);
    std::fill(w.totals.begin(), w.totals.end(), 0.0);
    std::size_t n_determined = 0;
    for (std::size_t view = 0; view < problem.n_views; ++view) n_determined += eliminate_view(problem, rig, view, w);
    if (n_determined == 0) return false;
    sum_shared(problem, rig, w);
    gram_matrix<lanes>(w.Y.data(), w.stride, w.m, w.block.data());
    std::vector<double> A(s * s), x(s), scale(s);
    for (int i = 0; i < s; ++i) {
        for (int k = 0; k < s; ++k) {
            const double eliminated = i <= k ? w.block[i * w.m + k] : w.block[k * w.m + i];
            A[i * s + k] = w.H[i * s + k] * (i == k ? growth : 1.0) - eliminated;
        }
        x[i] = w.g[i] - w.block[i * w.m + s];
        scale[i] = 1 / std::sqrt(std::max(w.H[i * s + i] * growth, kTiny));
    }
    if (problem.reduced) std::copy(A.begin(), A.end(), problem.reduced + rig * s * s);
    if (!problem.shared) return true;
    if (problem.gradient) std::copy(x.begin(), x.end(), problem.gradient + rig * s);
    double unsolved = 0;
    if (!solve_shared(problem, rig, A, x, scale, unsolved)) return false;
    for (int i = 0; i < s; ++i) problem.shared[rig * s + i] = x[i] * scale[i];
    problem.predicted[rig] = step_views(problem, rig, w, unsolved);
    return std::isfinite(problem.predicted[rig]);
}

template <int lanes>
BINOCAL_INLINE void run_rigs(const Problem& problem, std::size_t first, std::size_t last) {
    constexpr double nan = std::numeric_limits<double>::quiet_NaN();
    Workspace workspace(problem);
    for (std::size_t rig = first; rig < last; ++rig) {
        if (step_of_rig<lanes>(problem, rig, workspace)) continue;
        const std::size_t s = problem.s, v = 6 * problem.n_views;
        if (problem.shared) {
            std::fill_n(problem.shared + rig * s, s, nan);
            std::fill_n(problem.views + rig * v, v, nan);
            problem.predicted[rig] = nan;
            if (problem.gradient) std::fill_n(problem.gradient + rig * s, s, nan), problem.pivot[rig] = nan;
        } else {
            std::fill_n(problem.reduced + rig * s * s, s * s, nan);
        }
    }
}

BINOCAL_DISPATCH(steps_of_rigs, Problem, (run_rigs<lanes>(task, first, last)))

// Of one or two cameras: Gram matrices (rigs, views, q, q), T_right_left of each rig (empty with one camera), and what is added to
// the shared equations, (rigs, s, s) and (rigs, s), or empty.
struct JointEquations {
    std::vector<Doubles> grams;
    Doubles R, t;
    bool is_rig_free;
    Doubles prior_information, prior_gradient;
};

// (rigs), (rigs), then (rigs, s) or empty.
struct Damping {
    Doubles growth, pose_growth, stretch, shift;
};

// What is written, as in Problem; what is not wanted is empty.
struct StepArrays {
    DoublesOut shared, views, predicted, reduced, gradient, pivot;
};

void solve_steps(const JointEquations& equations, const Damping& damping, const StepArrays& out, std::size_t n_threads) {
    const auto& [grams, R, t, is_rig_free, prior_information, prior_gradient] = equations;
    const auto& [growth, pose_growth, stretch, shift] = damping;
    const auto& [shared, views, predicted, reduced, gradient, pivot] = out;
    require(!grams.empty() && grams.size() <= 2, "one or two cameras");
    Problem problem{};
    const bool is_stereo = grams.size() == 2;
    int column = 0;
    for (std::size_t index = 0; index < grams.size(); ++index) {
        const Doubles& gram = grams[index];
        require(gram.ndim() == 4 && gram.shape(2) == gram.shape(3) && gram.shape(2) >= 7,
                "gram must be (rigs, views, q, q)");
        require(gram.shape(2) * gram.shape(3) <= kMaxGram, "too many columns");
        require(index == 0 || (gram.shape(0) == problem.n_rigs && gram.shape(1) == problem.n_views),
                "the cameras' views differ");
        problem.n_rigs = gram.shape(0), problem.n_views = gram.shape(1);
        CameraPart camera{gram.data(), static_cast<int>(gram.shape(2)) - 7, {}, {}};
        for (int i = 0; i < camera.p; ++i) camera.keep.push_back(i), camera.place.push_back(column++);
        problem.cameras.push_back(std::move(camera));
    }
    if (is_stereo && is_rig_free) {
        CameraPart& right = problem.cameras[1];
        for (int i = 0; i < 6; ++i) right.keep.push_back(right.p + i), right.place.push_back(column++);
    }
    problem.s = column;
    require(column <= kMaxShared, "too many shared unknowns");
    const std::size_t rigs = problem.n_rigs, s = column;
    require(growth.size() == rigs && pose_growth.size() == rigs, "one growth for each rig");
    if (is_stereo) {
        require(R.size() == 9 * rigs && t.size() == 3 * rigs, "one T_right_left for each rig");
        problem.R = R.data(), problem.t = t.data();
    }
    if (prior_information.size() > 0) {
        require(prior_information.size() == rigs * s * s && prior_gradient.size() == rigs * s, "the priors' size is wrong");
        problem.prior_information = prior_information.data(), problem.prior_gradient = prior_gradient.data();
    }
    problem.growth = growth.data(), problem.pose_growth = pose_growth.data();
    if (stretch.size() > 0) {
        require(stretch.size() == rigs * s, "one stretch for each shared unknown");
        problem.stretch = stretch.data();
    }
    if (shift.size() > 0) {
        require(shift.size() == rigs * s, "one shift for each shared unknown");
        problem.shift = shift.data();
    }
    if (gradient.size() > 0) {
        require(gradient.size() == rigs * s && pivot.size() == rigs, "an output has the wrong size");
        problem.gradient = gradient.data(), problem.pivot = pivot.data();
    }
    if (predicted.size() > 0) {
        require(shared.size() == rigs * s && views.size() == 6 * rigs * problem.n_views && predicted.size() == rigs,
                "an output has the wrong size");
        problem.shared = shared.data(), problem.views = views.data(), problem.predicted = predicted.data();
    }
    if (reduced.size() > 0) {
        require(reduced.size() == rigs * s * s, "an output has the wrong size");
        problem.reduced = reduced.data();
    }
    nb::gil_scoped_release unlocked;
    in_parallel(rigs, n_threads, [&](std::size_t first, std::size_t last) { steps_of_rigs(problem, first, last); });
}

}  // namespace

void register_step(nb::module_& module) {
    nb::class_<JointEquations>(module, "JointEquations")
        .def(nb::init<std::vector<Doubles>, Doubles, Doubles, bool, Doubles, Doubles>(), nb::kw_only(), "grams"_a, "R"_a, "t"_a,
             "is_rig_free"_a, "prior_information"_a, "prior_gradient"_a);
    nb::class_<Damping>(module, "Damping")
        .def(nb::init<Doubles, Doubles, Doubles, Doubles>(), nb::kw_only(), "growth"_a, "pose_growth"_a, "stretch"_a, "shift"_a);
    nb::class_<StepArrays>(module, "StepArrays")
        .def(nb::init<DoublesOut, DoublesOut, DoublesOut, DoublesOut, DoublesOut, DoublesOut>(), nb::kw_only(), "shared"_a, "views"_a,
             "predicted"_a, "reduced"_a, "gradient"_a, "pivot"_a);
    module.def("solve_steps", &solve_steps);
}

}  // namespace binocal
