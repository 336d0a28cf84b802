// The joint equations of two cameras with board points and exposures free: views eliminated, one rig at a time
// (binocal.solvers.joint_system says what the arrays mean; tests state it plainly in NumPy).
//
// Shared unknowns: intrinsics of the left and of the right camera, the rig's six, then the board's points (x of all, y, z). A view's
// own: the board's pose, then the right camera's deviation where there is one.

#include "gram.hpp"
#include "kernel.hpp"
#include "linear_algebra.hpp"

#include <algorithm>
#include <cmath>
#include <vector>

namespace binocal {
namespace {

constexpr int kPose = 6;
constexpr int kMaxOwn = 12;
constexpr double kTiny = 1e-300;
constexpr double kLeastPivot = 1e-12;  // of an equilibrated view: below, its corners do not determine its unknowns

// Arrays of V views: gram (V, q, q); T_rig, T_pose, T_deviation (V, 6, 6): the right camera's own pose step from one of the rig, of the
// board and of the deviation; coupling (V, q, m), or empty, and information (V, 6, n) with m = 3 n, or empty where the m columns are combinations of
// the points' coordinates, whose own information the caller adds; precision (6) and pull (V, 6) of the
// deviations' prior, or empty.
struct StereoViews {
    Doubles left, right, T_rig, T_pose, T_deviation, left_coupling, right_coupling, left_points, right_points, precision, pull;
    double growth;
};

// inverse_L (V, P, P), Y (z + 1 padded to 4, stride), own (V, 2, P): gradient and undamped diagonal; determined (V); information (z, z)
// and gradient (z) without priors; h (V, k, k) and scores (V, z): every view's own, or empty.
struct ReducedViews {
    DoublesOut inverse_L, Y, own, determined, information, gradient, h, scores;
};

struct Job {
    const StereoViews& in;
    const ReducedViews& out;
    std::size_t n_views, n, m, stride;
    int q_left, q_right, n_left, n_right, k, z, P;
    const double* at(const Doubles& a, std::size_t view, std::size_t size) const { return a.data() + view * size; }
};

// out += Tᵀ a for one column a of six.
BINOCAL_INLINE void add_turned(const double* T, const double* a, double* out) {
    for (int i = 0; i < kPose; ++i) {
        double sum = 0;
        for (int j = 0; j < kPose; ++j) sum += T[6 * j + i] * a[j];
        out[i] += sum;
    }
}

// Tᵀ A S of 6 x 6 matrices, A with rows `stride` apart, added to out with rows P apart.
BINOCAL_INLINE void add_sandwich(const double* T, const double* A, int stride, const double* S, double* out, int P) {
    double half[36];
    for (int i = 0; i < kPose; ++i) {
        for (int j = 0; j < kPose; ++j) {
            double sum = 0;
            for (int l = 0; l < kPose; ++l) sum += A[i * stride + l] * S[6 * l + j];
            half[6 * i + j] = sum;
        }
    }
    for (int i = 0; i < kPose; ++i) {
        for (int j = 0; j < kPose; ++j) {
            double sum = 0;
            for (int l = 0; l < kPose; ++l) sum += T[6 * l + i] * half[6 * l + j];
            out[i * P + j] += sum;
        }
    }
}

struct ViewScratch {
    std::vector<double> own, coupling, shared, score;  // P x P, P x (z + 1), k x k, z
    explicit ViewScratch(const Job& job)
        : own(job.P * job.P), coupling(static_cast<std::size_t>(job.P) * (job.z + 1)), shared(job.k * job.k), score(job.z) {}
};

// The view's equations in the solver's unknowns.
BINOCAL_INLINE void assemble(const Job& job, std::size_t view, ViewScratch& s) {
    const int P = job.P, k = job.k, z = job.z, nl = job.n_left, nr = job.n_right, ql = job.q_left, qr = job.q_right;
    const double *GL = job.at(job.in.left, view, ql * ql), *GR = job.at(job.in.right, view, qr * qr);
    const double *T_rig = job.at(job.in.T_rig, view, 36), *T_pose = job.at(job.in.T_pose, view, 36);
    const double* T_dev = P > kPose ? job.at(job.in.T_deviation, view, 36) : nullptr;
    std::fill(s.own.begin(), s.own.end(), 0.0);
    std::fill(s.coupling.begin(), s.coupling.end(), 0.0);
    std::fill(s.shared.begin(), s.shared.end(), 0.0);
    std::fill(s.score.begin(), s.score.end(), 0.0);
    const int rig = nl + nr;
    auto couple = [&](int row, int column) -> double& { return s.coupling[static_cast<std::size_t>(row) * (z + 1) + column]; };
    // own
    for (int i = 0; i < kPose; ++i) {
        for (int j = 0; j < kPose; ++j) s.own[i * P + j] += GL[(nl + i) * ql + nl + j];
    }
    const double* R66 = GR + nr * qr + nr;
    add_sandwich(T_pose, R66, qr, T_pose, s.own.data(), P);
    if (T_dev) {
        add_sandwich(T_pose, R66, qr, T_dev, s.own.data() + kPose, P);
        add_sandwich(T_dev, R66, qr, T_pose, s.own.data() + kPose * P, P);
        add_sandwich(T_dev, R66, qr, T_dev, s.own.data() + kPose * P + kPose, P);
        for (int i = 0; i < kPose; ++i) s.own[(kPose + i) * P + kPose + i] += job.in.precision.data()[i];
    }
    // own with intrinsics, gradient
    double column[kMaxOwn];
    auto put = [&](int target) {
        for (int i = 0; i < P; ++i) couple(i, target) += column[i];
    };
    for (int c = 0; c <= nl; ++c) {
        const int source = c < nl ? c : ql - 1;
        std::fill(column, column + kMaxOwn, 0.0);
        for (int i = 0; i < kPose; ++i) column[i] = GL[(nl + i) * ql + source];
        put(c < nl ? c : z);
    }
    for (int c = 0; c <= nr; ++c) {
        const int source = c < nr ? c : qr - 1;
        double a[kPose];
        for (int i = 0; i < kPose; ++i) a[i] = GR[(nr + i) * qr + source];
        std::fill(column, column + kMaxOwn, 0.0);
        add_turned(T_pose, a, column);
        if (T_dev) add_turned(T_dev, a, column + kPose);
        put(c < nr ? nl + c : z);
    }
    if (T_dev) {
        for (int i = 0; i < kPose; ++i) couple(kPose + i, z) += job.at(job.in.pull, view, kPose)[i];
    }
    // own with the rig
    double block[36] = {}, deviation[36] = {};
    add_sandwich(T_pose, R66, qr, T_rig, block, kPose);
    if (T_dev) add_sandwich(T_dev, R66, qr, T_rig, deviation, kPose);
    for (int i = 0; i < kPose; ++i) {
        for (int j = 0; j < kPose; ++j) {
            couple(i, rig + j) += block[6 * i + j];
            if (T_dev) couple(kPose + i, rig + j) += deviation[6 * i + j];
        }
    }
    // shared
    for (int i = 0; i < nl; ++i) {
        for (int j = 0; j < nl; ++j) s.shared[i * k + j] = GL[i * ql + j];
        s.score[i] = GL[i * ql + ql - 1];
    }
    for (int i = 0; i < nr; ++i) {
        for (int j = 0; j < nr; ++j) s.shared[(nl + i) * k + nl + j] = GR[i * qr + j];
        s.score[nl + i] = GR[i * qr + qr - 1];
        double turned[kPose] = {};
        add_turned(T_rig, GR + i * qr + nr, turned);
        for (int j = 0; j < kPose; ++j) s.shared[(nl + i) * k + rig + j] = s.shared[(rig + j) * k + nl + i] = turned[j];
    }
    add_sandwich(T_rig, R66, qr, T_rig, s.shared.data() + rig * k + rig, k);
    double gradient[kPose];
    for (int i = 0; i < kPose; ++i) gradient[i] = GR[(nr + i) * qr + qr - 1];
    add_turned(T_rig, gradient, s.score.data() + rig);
    // points
    const std::size_t m = job.m;
    if (m == 0) return;
    const double *CL = job.at(job.in.left_coupling, view, ql * m), *CR = job.at(job.in.right_coupling, view, qr * m);
    for (int i = 0; i < kPose; ++i) {
        double *pose = &couple(i, k), *dev = T_dev ? &couple(kPose + i, k) : nullptr;
        const double* own = CL + (nl + i) * m;
        for (std::size_t c = 0; c < m; ++c) pose[c] = own[c];
        for (int j = 0; j < kPose; ++j) {
            const double t = T_pose[6 * j + i], d = T_dev ? T_dev[6 * j + i] : 0.0;
            const double* source = CR + (nr + j) * m;
            for (std::size_t c = 0; c < m; ++c) pose[c] += t * source[c];
            if (dev) {
                for (std::size_t c = 0; c < m; ++c) dev[c] += d * source[c];
            }
        }
    }
    const double *gl = CL + (ql - 1) * m, *gr = CR + (qr - 1) * m;
    for (std::size_t c = 0; c < m; ++c) s.score[k + c] = gl[c] + gr[c];
}

// Eliminates the view's own unknowns; false where its corners do not determine them.
BINOCAL_INLINE bool eliminate_own(const Job& job, std::size_t view, ViewScratch& s) {
    const int P = job.P, z = job.z;
    double* own_out = job.out.own.data() + view * 2 * P;
    double scale[kMaxOwn], *inverse = job.out.inverse_L.data() + view * P * P;
    for (int i = 0; i < P; ++i) {
        own_out[i] = s.coupling[static_cast<std::size_t>(i) * (z + 1) + z];
        own_out[P + i] = s.own[i * P + i];
        s.own[i * P + i] *= job.in.growth;
        scale[i] = 1 / std::sqrt(std::max(s.own[i * P + i], kTiny));
    }
    for (int i = 0; i < P; ++i) {
        for (int j = 0; j < P; ++j) s.own[i * P + j] *= scale[i] * scale[j];
    }
    bool is_determined = true;
    for (int i = 0; i < P; ++i) is_determined &= std::isfinite(s.own[i * P + i]) && s.own[i * P + i] > 0.5;
    is_determined = is_determined && cholesky(s.own.data(), s.own.data(), P, P, kLeastPivot);
    std::fill(inverse, inverse + P * P, 0.0);
    if (!is_determined) return false;
    for (int column = 0; column < P; ++column) {  // L⁻¹ S, by columns; the factor's diagonal is inverted
        double x[kMaxOwn] = {};
        x[column] = scale[column];
        solve_lower(s.own.data(), P, P, x, x);
        for (int i = column; i < P; ++i) inverse[i * P + column] = x[i];
    }
    return true;
}

// Y = L⁻¹ S [coupling, gradient], to the view's rows of every column.
BINOCAL_INLINE void write_couplings(const Job& job, std::size_t view, const ViewScratch& s, std::vector<double>& rows) {
    const int P = job.P, z = job.z;
    const double* inverse = job.out.inverse_L.data() + view * P * P;
    const std::size_t width = z + 1;
    rows.assign(P * width, 0.0);
    for (int i = 0; i < P; ++i) {
        double* row = rows.data() + i * width;
        for (int j = 0; j <= i; ++j) {
            const double factor = inverse[i * P + j];
            const double* source = s.coupling.data() + j * width;
            for (std::size_t c = 0; c < width; ++c) row[c] += factor * source[c];
        }
    }
    double* Y = job.out.Y.data() + view * P;
    for (std::size_t c = 0; c < width; ++c) {
        for (int i = 0; i < P; ++i) Y[c * job.stride + i] = rows[i * width + c];
    }
}

BINOCAL_INLINE void one_view(const Job& job, std::size_t view, ViewScratch& s, std::vector<double>& rows) {
    assemble(job, view, s);
    const bool is_determined = eliminate_own(job, view, s);
    job.out.determined.data()[view] = is_determined;
    write_couplings(job, view, s, rows);
    if (job.out.h.size() > 0) {
        const std::size_t width = job.z + 1;
        double* h = job.out.h.data() + view * job.k * job.k;
        double* score = job.out.scores.data() + view * job.z;
        std::fill(h, h + job.k * job.k, 0.0);
        std::fill(score, score + job.z, 0.0);
        if (!is_determined) return;
        for (int i = 0; i < job.k; ++i) {
            for (int j = 0; j < job.k; ++j) h[i * job.k + j] = s.shared[i * job.k + j];
        }
        for (int c = 0; c < job.z; ++c) score[c] = s.score[c];
        for (int p = 0; p < job.P; ++p) {
            const double* row = rows.data() + p * width;
            for (int i = 0; i < job.k; ++i) {
                for (int j = 0; j < job.k; ++j) h[i * job.k + j] -= row[i] * row[j];
            }
            for (int c = 0; c < job.z; ++c) score[c] -= row[c] * row[job.z];
        }
    }
}

template <int lanes>
BINOCAL_INLINE void views(const Job& job, std::size_t first, std::size_t last) {
    ViewScratch s(job);
    std::vector<double> rows;
    for (std::size_t view = first; view < last; ++view) one_view(job, view, s, rows);
}

BINOCAL_DISPATCH(each_view, Job, (views<lanes>(task, first, last)))

// The sums of the shared equations over all determined views, before the views are eliminated.
void sum_shared(const Job& job) {
    const int k = job.k, z = job.z, nl = job.n_left, nr = job.n_right, ql = job.q_left, qr = job.q_right, rig = nl + nr;
    double *H = job.out.information.data(), *g = job.out.gradient.data();
    std::fill(H, H + static_cast<std::size_t>(z) * z, 0.0);
    std::fill(g, g + z, 0.0);
    ViewScratch s(job);
    const std::size_t m = job.m, n = job.n;
    std::vector<double> own(6 * n, 0.0);
    for (std::size_t view = 0; view < job.n_views; ++view) {
        if (job.out.determined.data()[view] == 0) continue;
        const double *GL = job.at(job.in.left, view, ql * ql), *GR = job.at(job.in.right, view, qr * qr);
        const double* T_rig = job.at(job.in.T_rig, view, 36);
        for (int i = 0; i < nl; ++i) {
            for (int j = 0; j < nl; ++j) H[i * z + j] += GL[i * ql + j];
            g[i] += GL[i * ql + ql - 1];
        }
        for (int i = 0; i < nr; ++i) {
            for (int j = 0; j < nr; ++j) H[(nl + i) * z + nl + j] += GR[i * qr + j];
            g[nl + i] += GR[i * qr + qr - 1];
            double turned[kPose] = {};
            add_turned(T_rig, GR + i * qr + nr, turned);
            for (int j = 0; j < kPose; ++j) H[(nl + i) * z + rig + j] += turned[j];
        }
        add_sandwich(T_rig, GR + nr * qr + nr, qr, T_rig, H + static_cast<std::size_t>(rig) * z + rig, z);
        double gradient[kPose];
        for (int i = 0; i < kPose; ++i) gradient[i] = GR[(nr + i) * qr + qr - 1];
        add_turned(T_rig, gradient, g + rig);
        if (m == 0) continue;
        const double *CL = job.at(job.in.left_coupling, view, ql * m), *CR = job.at(job.in.right_coupling, view, qr * m);
        for (int i = 0; i < nl; ++i) {
            double* row = H + static_cast<std::size_t>(i) * z + k;
            for (std::size_t c = 0; c < m; ++c) row[c] += CL[i * m + c];
        }
        for (int i = 0; i < nr; ++i) {
            double* row = H + static_cast<std::size_t>(nl + i) * z + k;
            for (std::size_t c = 0; c < m; ++c) row[c] += CR[i * m + c];
        }
        for (int i = 0; i < kPose; ++i) {
            double* row = H + static_cast<std::size_t>(rig + i) * z + k;
            for (int j = 0; j < kPose; ++j) {
                const double t = T_rig[6 * j + i];
                const double* source = CR + (nr + j) * m;
                for (std::size_t c = 0; c < m; ++c) row[c] += t * source[c];
            }
        }
        const double *gl = CL + (ql - 1) * m, *gr = CR + (qr - 1) * m;
        for (std::size_t c = 0; c < m; ++c) g[k + c] += gl[c] + gr[c];
        const double *il = job.at(job.in.left_points, view, 6 * n), *ir = job.at(job.in.right_points, view, 6 * n);
        for (std::size_t c = 0; c < 6 * n; ++c) own[c] += il[c] + ir[c];
    }
    for (int a = 0, entry = 0; a < 3 && n > 0; ++a) {
        for (int b = a; b < 3; ++b, ++entry) {
            for (std::size_t j = 0; j < n; ++j) H[(k + a * n + j) * z + k + b * n + j] = own[entry * n + j];
        }
    }
}

struct Syrk {
    const double* Y;
    std::size_t stride;
    int rows;  // padded to 4
    double* block;
};

template <int lanes>
BINOCAL_INLINE void gram_rows(const Syrk& task, std::size_t first, std::size_t last) {
    for (std::size_t pair = first; pair < last; ++pair) {  // a row of blocks from the top and one from the bottom: equal work
        const int n_blocks = task.rows / 4;
        for (int half = 0; half < 2; ++half) {
            const int index = half == 0 ? static_cast<int>(pair) : n_blocks - 1 - static_cast<int>(pair);
            if (half == 1 && index == static_cast<int>(pair)) continue;
            const int row = 4 * index;
            for (int column = row; column < task.rows; column += 4) {
                dot_block<lanes>(task.Y + row * task.stride, task.Y + column * task.stride, task.stride,
                                 task.block + static_cast<std::size_t>(row) * task.rows + column, task.rows);
            }
        }
    }
}

BINOCAL_DISPATCH(gram_of_rows, Syrk, (gram_rows<lanes>(task, first, last)))

void reduce_stereo(const StereoViews& in, const ReducedViews& out, std::size_t n_threads) {
    require(in.left.ndim() == 3 && in.right.ndim() == 3 && in.left.shape(0) == in.right.shape(0), "as many views of both cameras");
    const std::size_t V = in.left.shape(0);
    const int ql = static_cast<int>(in.left.shape(1)), qr = static_cast<int>(in.right.shape(1));
    require(ql >= 7 && qr >= 7 && in.left.size() == V * ql * ql && in.right.size() == V * qr * qr, "Gram matrices are square");
    const bool deviates = in.T_deviation.size() > 0;
    const std::size_t n = V > 0 ? in.left_points.size() / (6 * V) : 0, m = V > 0 ? in.left_coupling.size() / (V * ql) : 0;
    Job job{in, out, V, n, m, 0, ql, qr, ql - 7, qr - 7, ql + qr - 8, 0, deviates ? kMaxOwn : kPose};
    job.z = job.k + static_cast<int>(m);
    const int rows = (job.z + 1 + 3) / 4 * 4;
    job.stride = (static_cast<std::size_t>(job.P) * V + kRun - 1) / kRun * kRun;
    const std::size_t z = job.z, P = job.P;
    require(in.T_rig.size() == 36 * V && in.T_pose.size() == 36 * V && (!deviates || in.T_deviation.size() == 36 * V),
            "one 6 x 6 matrix for each view");
    require(!deviates || (in.precision.size() == kPose && in.pull.size() == kPose * V), "a precision and pulls of deviations");
    require(in.left_points.size() == 6 * n * V && in.right_points.size() == 6 * n * V && in.left_coupling.size() == V * ql * m &&
                in.right_coupling.size() == V * qr * m && (n == 0 || m == 3 * n),
            "points do not match the views");
    require(out.inverse_L.size() == V * P * P && out.Y.size() == rows * job.stride && out.own.size() == 2 * V * P &&
                out.determined.size() == V && out.information.size() == z * z && out.gradient.size() == z,
            "an output has the wrong size");
    require(out.h.size() == 0 || (out.h.size() == V * job.k * job.k && out.scores.size() == V * z), "an output has the wrong size");
    nb::gil_scoped_release unlocked;
    std::fill_n(out.Y.data(), out.Y.size(), 0.0);
    in_parallel(V, n_threads, [&](std::size_t first, std::size_t last) { each_view(job, first, last); });
    sum_shared(job);
    std::vector<double> block(static_cast<std::size_t>(rows) * rows);
    const Syrk task{out.Y.data(), job.stride, rows, block.data()};
    in_parallel((rows / 4 + 1) / 2, n_threads, [&](std::size_t first, std::size_t last) { gram_of_rows(task, first, last); });
    double *H = out.information.data(), *g = out.gradient.data();
    for (std::size_t i = 0; i < z; ++i) {
        H[i * z + i] = H[i * z + i] * in.growth - block[i * rows + i];
        for (std::size_t j = i + 1; j < z; ++j) H[i * z + j] = H[j * z + i] = H[i * z + j] - block[i * rows + j];
        g[i] -= block[i * rows + z];
    }
}

// A x = b for a symmetric positive definite A (z, z) and right sides as rows of b (r, z), in place; false where A is not so.
template <int lanes>
BINOCAL_INLINE double dot(const double* a, const double* b, int n) {
    double sums[4 * lanes] = {};
    int j = 0;
    for (; j + 4 * lanes <= n; j += 4 * lanes) {
        for (int l = 0; l < 4 * lanes; ++l) sums[l] += a[j + l] * b[j + l];
    }
    double sum = 0;
    for (; j < n; ++j) sum += a[j] * b[j];
    for (double part : sums) sum += part;
    return sum;
}

struct Solve {
    double *A, *b;  // equilibrated; the factor is written over A's lower triangle, its diagonal inverted
    int z;
    std::size_t n_right;
    bool* is_definite;
};

template <int lanes>
BINOCAL_INLINE void factorize(const Solve& task) {
    const int z = task.z;
    double* A = task.A;
    for (int i = 0; i < z; ++i) {
        double* row = A + static_cast<std::size_t>(i) * z;
        for (int j = 0; j < i; ++j) {
            const double* other = A + static_cast<std::size_t>(j) * z;
            row[j] = (row[j] - dot<lanes>(row, other, j)) * other[j];
        }
        const double pivot = row[i] - dot<lanes>(row, row, i);
        if (!(pivot > 1e-15)) {
            *task.is_definite = false;
            return;
        }
        row[i] = 1 / std::sqrt(pivot);
    }
    *task.is_definite = true;
}

template <int lanes>
BINOCAL_INLINE void substitute(const Solve& task, std::size_t first, std::size_t last) {
    const int z = task.z;
    for (std::size_t r = first; r < last; ++r) {
        double* x = task.b + r * z;
        for (int i = 0; i < z; ++i) {
            const double* row = task.A + static_cast<std::size_t>(i) * z;
            x[i] = (x[i] - dot<lanes>(row, x, i)) * row[i];
        }
        for (int i = z - 1; i >= 0; --i) {
            const double* row = task.A + static_cast<std::size_t>(i) * z;
            x[i] *= row[i];
            const double value = x[i];
            for (int j = 0; j < i; ++j) x[j] -= value * row[j];
        }
    }
}

BINOCAL_DISPATCH(factorize_matrix, Solve, (first + last > 0 ? factorize<lanes>(task) : void()))
BINOCAL_DISPATCH(substitute_rows, Solve, (substitute<lanes>(task, first, last)))

bool solve_definite(DoublesOut A, DoublesOut b, std::size_t n_threads) {
    require(A.ndim() == 2 && A.shape(0) == A.shape(1) && b.ndim() == 2 && b.shape(1) == A.shape(0), "a square matrix and rows to solve");
    bool is_definite = true;
    const Solve task{A.data(), b.data(), static_cast<int>(A.shape(0)), b.shape(0), &is_definite};
    nb::gil_scoped_release unlocked;
    factorize_matrix(task, 0, 1);
    if (is_definite) {
        in_parallel(task.n_right, n_threads, [&](std::size_t first, std::size_t last) { substitute_rows(task, first, last); });
    }
    return is_definite;
}

}  // namespace

void register_joint_views(nb::module_& module) {
    nb::class_<StereoViews>(module, "StereoViews")
        .def(nb::init<Doubles, Doubles, Doubles, Doubles, Doubles, Doubles, Doubles, Doubles, Doubles, Doubles, Doubles, double>(),
             nb::kw_only(), "left"_a, "right"_a, "T_rig"_a, "T_pose"_a, "T_deviation"_a, "left_coupling"_a, "right_coupling"_a,
             "left_points"_a, "right_points"_a, "precision"_a, "pull"_a, "growth"_a);
    nb::class_<ReducedViews>(module, "ReducedViews")
        .def(nb::init<DoublesOut, DoublesOut, DoublesOut, DoublesOut, DoublesOut, DoublesOut, DoublesOut, DoublesOut>(), nb::kw_only(),
             "inverse_L"_a, "Y"_a, "own"_a, "determined"_a, "information"_a, "gradient"_a, "h"_a, "scores"_a);
    module.def("reduce_stereo", &reduce_stereo);
    module.def("solve_definite", &solve_definite);
}

}  // namespace binocal
