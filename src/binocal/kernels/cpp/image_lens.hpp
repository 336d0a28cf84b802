// The lens of one image from its own board: no focal length and no other image is needed.
//
// Model. A pixel d, in half diagonals from the centre c, looks along the ray (dx, e^a dy, f phi(s)), where r^2 = dx^2 + (e^a dy)^2,
// s = w r^2 + v r^4 + q r^6, phi(s) = sqrt(s) cot sqrt(s), sqrt(-s) coth sqrt(-s) for s < 0, and f = 1 / sqrt(max(w, 0.15)) of the start, which
// only scales the board's plane. With w = 1 / f^2 alone it is the equidistant lens, at any angle below 177 degrees; with w = v = q = 0 a
// pinhole; barrel distortion has w > 0, pincushion w < 0. The board's plane is seen along m = H (X, Y, 1).
//
// To first order the image of m lies e = B m / t from the pixel, t = m.ray / |ray|^2, for
// B = [I2 | 0] - d (-g dx, -g dy, 1) / (f phi - g r^2), g = 2 d(f phi) / d(r^2). B ray = 0, so that e is exact where it vanishes, and
// its derivatives by a parameter of the lens are -B d(ray): Gauss and Newton's method needs no inverse of the lens.
#pragma once

#include "linear_algebra.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <vector>

namespace binocal {

constexpr double kLeastW = 0.15;               // of f: a pinhole's is not infinite
constexpr double kMostS = 9.575;               // (0.985 pi)^2: 177 degrees from the axis
constexpr double kLensPriors[6] = {6, 6, 6, 0.06, 0.06, 0.5};  // standard deviations of w, v, q, the centre (half diagonals) and a
constexpr double kLensNoise_px = 0.05;         // the least that corners are taken to be off, against those
constexpr double kStartsOfW[7] = {0, 0.7, 1.8, 3.2, 4.8, 6.5, -0.6};
constexpr double kTukey = 4.7 * 1.4826 / 1.1774;  // times the median length: 95 % of least squares' efficiency on Gaussian noise
constexpr double kBehind_px = 1e4;             // how far a point counts as off that is seen from the other side of the lens
constexpr int kLensUnknowns = 15;              // H, then w, v, q, cx, cy, a

struct LensPoint {
    double X, Y;  // on the board
    double x, y;  // in the image, px
};

// A pixel's ray, and what its derivatives need.
struct LensRay {
    double dx, dy;         // half diagonals, dy stretched
    double depth, slope;   // f phi, g
    double r2, phi, dphi;  // dphi: phi'(s)
    double stretch;        // e^a
};

struct LensResidual {
    double e[2];  // px: the board's point less the pixel
    double t;
    double G[2][3];  // de / dm
    double B[2][3];  // px
};

class ImageLens {
  public:
    ImageLens() = default;
    ImageLens(double width, double height)
        : middle_{(width - 1) / 2, (height - 1) / 2}, unit_(std::max(0.5 * std::hypot(width, height), 1e-9)) {}

    double H[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};  // board (moved and scaled) to the ray's frame, norm 1
    double p[6] = {};                           // w, v, q, cx, cy, a
    double f = 1;                               // a scale of H's third row: any does, but not any is well conditioned
    double board_x = 0, board_y = 0, board_scale = 1;

    // f for w, the images of all points as before.
    void scale_depth() {
        const double wanted = 1 / std::sqrt(std::max(p[0], kLeastW));
        for (int k = 6; k < 9; ++k) H[k] *= wanted / f;
        f = wanted;
        double square = 0;
        for (double value : H) square += value * value;
        for (double& value : H) value /= std::sqrt(square);
    }

    // The board's coordinates are moved to the points' middle and scaled to their extent.
    void adapt(const std::vector<LensPoint>& points) {
        board_x = board_y = 0;
        for (const LensPoint& point : points) board_x += point.X, board_y += point.Y;
        board_x /= points.size(), board_y /= points.size();
        board_scale = 0;
        for (const LensPoint& point : points)
            board_scale = std::max({board_scale, std::fabs(point.X - board_x), std::fabs(point.Y - board_y)});
        if (!(board_scale > 0)) board_scale = 1;
    }

    LensRay ray(double x, double y) const {
        LensRay ray;
        ray.stretch = p[5] == 0 ? 1 : std::exp(p[5]);
        ray.dx = (x - middle_[0]) / unit_ - p[3];
        ray.dy = ray.stretch * ((y - middle_[1]) / unit_ - p[4]);
        ray.r2 = ray.dx * ray.dx + ray.dy * ray.dy;
        const double s = ray.r2 * (p[0] + ray.r2 * (p[1] + ray.r2 * p[2]));
        if (s > kMostS) {
            ray.phi = phi(kMostS, ray.dphi);
            ray.dphi = 0;
        } else {
            ray.phi = phi(s, ray.dphi);
        }
        ray.depth = f * ray.phi;
        ray.slope = 2 * f * ray.dphi * (p[0] + ray.r2 * (2 * p[1] + ray.r2 * 3 * p[2]));
        return ray;
    }

    // Where on the sphere a board's point is, not normalised.
    Vector3 direction(double X, double Y) const {
        return product3(H, Vector3{(X - board_x) / board_scale, (Y - board_y) / board_scale, 1});
    }

    // B, px: how the image moves with the ray.
    void motion(const LensRay& ray, double (&B)[2][3]) const {
        const double denominator = ray.depth - ray.slope * ray.r2;
        const double safe = std::fabs(denominator) > 1e-9 ? denominator : 1e-9;
        const double row[3] = {-ray.slope * ray.dx / safe, -ray.slope * ray.dy / safe, 1 / safe};
        for (int k = 0; k < 3; ++k) {
            B[0][k] = unit_ * ((k == 0) - ray.dx * row[k]);
            B[1][k] = unit_ * ((k == 1) - ray.dy * row[k]) / ray.stretch;
        }
    }

    // The point's first-order distance from a pixel; false if it is seen from behind.
    bool residual(const Vector3& m, const LensRay& ray, LensResidual& out) const {
        const double length2 = ray.r2 + ray.depth * ray.depth;
        out.t = (m.x * ray.dx + m.y * ray.dy + m.z * ray.depth) / length2;
        motion(ray, out.B);
        const double inverse = 1 / out.t, of_ray[3] = {ray.dx / length2, ray.dy / length2, ray.depth / length2};
        for (int i : {0, 1}) {
            out.e[i] = (out.B[i][0] * m.x + out.B[i][1] * m.y + out.B[i][2] * m.z) * inverse;
            for (int k = 0; k < 3; ++k) out.G[i][k] = (out.B[i][k] - out.e[i] * of_ray[k]) * inverse;
        }
        return out.t > 0 && std::isfinite(out.e[0]) && std::isfinite(out.e[1]);
    }

    // The image of a direction, from a pixel near it by Newton's method; false where that leads nowhere.
    bool project(const Vector3& m, int n_rounds, double& x, double& y) const {
        LensResidual at;
        for (int round = 0; round < n_rounds; ++round) {
            if (!residual(m, ray(x, y), at)) return false;
            const double length2 = at.e[0] * at.e[0] + at.e[1] * at.e[1], most = 0.4 * unit_;
            const double shrink = length2 > most * most ? most / std::sqrt(length2) : 1;
            x += shrink * at.e[0], y += shrink * at.e[1];
        }
        return true;
    }

    // Handedness of the board's image: positive for a board seen from its front.
    double determinant() const {
        return H[0] * (H[4] * H[8] - H[5] * H[7]) - H[1] * (H[3] * H[8] - H[5] * H[6]) + H[2] * (H[3] * H[7] - H[4] * H[6]);
    }

    double unit_px() const { return unit_; }
    double centre_x() const { return middle_[0] + unit_ * p[3]; }
    double centre_y() const { return middle_[1] + unit_ * p[4]; }

  private:
    static double phi(double s, double& derivative) {
        if (std::fabs(s) < 1e-4) {
            derivative = -1.0 / 3 - s * (2.0 / 45);
            return 1 - s / 3 - s * s / 45;
        }
        const double u = std::sqrt(std::fabs(s));
        if (s > 0) {
            const double sine = std::sin(u), cotangent = std::cos(u) / sine;
            derivative = 0.5 * (cotangent / u - 1 / (sine * sine));
            return u * cotangent;
        }
        const double sine = std::sinh(std::min(u, 300.0)), cotangent = 1 / std::tanh(u);
        derivative = 0.5 * (1 / (sine * sine) - cotangent / u);
        return u * cotangent;
    }

    double middle_[2] = {0, 0}, unit_ = 1;
};

struct LensOptions {
    double tolerance_px = 0.3;  // what is off by less keeps a weight
    bool is_robust = false;     // whether wild points are looked for from every start
    int n_unknowns = 6;         // of the lens: 6, or 1 for w alone
};

// Fits an image's lens and the board's plane to points; see the head of this file.
class ImageLensFit {
  public:
    ImageLensFit(const std::vector<LensPoint>& points, double width, double height, const LensOptions& options)
        : points_(points), options_(options), lens_(width, height), weights_(points.size(), 1.0), lengths_(points.size(), 0.0), rays_(points.size()) {
        lens_.adapt(points);
    }

    // False where no plane can be fitted.
    bool fit() {
        if (points_.size() < 4) return false;
        return options_.is_robust ? fit_robustly() : fit_plainly();
    }

    const ImageLens& lens() const { return lens_; }
    const std::vector<double>& lengths() const { return lengths_; }  // px, of the residuals; kBehind_px behind the lens

    // Whether the board is seen from its front, every point before the lens.
    bool is_front() const {
        return lens_.determinant() > 0 && std::all_of(lengths_.begin(), lengths_.end(), [](double length) { return length < kBehind_px; });
    }

  private:
    // From no bending at all; from the other starts only where that leaves much.
    bool fit_plainly() {
        ImageLens best = lens_;
        double least = std::numeric_limits<double>::infinity();
        bool has_best = false;
        for (double w : kStartsOfW) {
            if (!fit_plane(w, 0)) continue;
            const double size = mean_length(kBehind_px);
            if (size < least) least = size, best = lens_, has_best = true;
            if (w == 0 && size < 1.0) break;  // px: bent by less, a lens is found from any start
        }
        if (!has_best) return false;
        lens_ = best;
        refine();
        for (int round = 0; round < 3 && reweight(0.5); ++round) refine();
        return true;
    }

    bool fit_robustly() {
        ImageLens best = lens_;
        double least = std::numeric_limits<double>::infinity();
        for (double w : kStartsOfW) {
            std::fill(weights_.begin(), weights_.end(), 1.0);
            if (!fit_plane(w, 3)) continue;
            const double size = mean_length(10 * options_.tolerance_px);
            if (size < least) least = size, best = lens_;
        }
        if (!std::isfinite(least)) return false;
        lens_ = best;
        measure();
        for (int round = 0; round < 6; ++round) {
            const bool changed = reweight(0.0);
            if (round > 0 && !changed) break;
            refine();
        }
        return true;
    }

    double mean_length(double most) const {
        double sum = 0;
        for (double length : lengths_) sum += std::min(length, most);
        return sum / lengths_.size();
    }

    // Tukey's weights of the residuals; whether one changed by more than 0.05. With `least` > 0 only lengths beyond the cut count,
    // where the cut is at least that many px more than the tolerance.
    bool reweight(double least) {
        std::vector<double> sorted = lengths_;
        std::nth_element(sorted.begin(), sorted.begin() + sorted.size() / 2, sorted.end());
        const double cut = kTukey * std::max(sorted[sorted.size() / 2], 1e-6) + options_.tolerance_px;
        bool changed = false;
        if (least > 0 && *std::max_element(lengths_.begin(), lengths_.end()) < std::max(cut, least)) return false;
        for (std::size_t i = 0; i < lengths_.size(); ++i) {
            const double share = lengths_[i] / cut, rest = share < 1 ? 1 - share * share : 0, weight = rest * rest + 1e-9;
            changed = changed || std::fabs(weight - weights_[i]) > 0.05;
            weights_[i] = weight;
        }
        return changed;
    }

    // The residuals' lengths, and the weighted sum of their squares.
    double measure() {
        for (std::size_t i = 0; i < points_.size(); ++i) rays_[i] = lens_.ray(points_[i].x, points_[i].y);
        return measure_along_rays();
    }

    // The same where only H has changed since.
    double measure_along_rays() {
        double sum = 0;
        LensResidual at;
        for (std::size_t i = 0; i < points_.size(); ++i) {
            const LensPoint& point = points_[i];
            const bool is_seen = lens_.residual(lens_.direction(point.X, point.Y), rays_[i], at);
            lengths_[i] = is_seen ? std::min(std::sqrt(at.e[0] * at.e[0] + at.e[1] * at.e[1]), 0.999 * kBehind_px) : kBehind_px;
            sum += weights_[i] * lengths_[i] * lengths_[i];
        }
        return sum;
    }

    // H alone for a w, by the least eigenvector of the algebraic errors, over t in the second pass, and with Tukey's weights in
    // `n_robust` more.
    bool fit_plane(double w, int n_robust) {
        for (double& value : lens_.p) value = 0;
        lens_.p[0] = w;
        lens_.scale_depth();
        for (std::size_t i = 0; i < points_.size(); ++i) rays_[i] = lens_.ray(points_[i].x, points_[i].y);
        std::vector<double> over_t(points_.size(), 1.0);
        for (int pass = 0; pass < 2 + n_robust; ++pass) {
            double A[81] = {};
            for (std::size_t i = 0; i < points_.size(); ++i) {
                const LensPoint& point = points_[i];
                double B[2][3];
                lens_.motion(rays_[i], B);
                const double X[3] = {(point.X - lens_.board_x) / lens_.board_scale, (point.Y - lens_.board_y) / lens_.board_scale, 1};
                const double weight = weights_[i] * over_t[i] / (lens_.unit_px() * lens_.unit_px());
                for (int k : {0, 1}) {
                    double row[9];
                    for (int a = 0; a < 3; ++a)
                        for (int c = 0; c < 3; ++c) row[3 * a + c] = B[k][a] * X[c];
                    for (int a = 0; a < 9; ++a)
                        for (int c = 0; c <= a; ++c) A[9 * a + c] += weight * row[a] * row[c];
                }
            }
            if (!least_direction(A)) return false;
            orient();
            measure_along_rays();
            for (std::size_t i = 0; i < points_.size(); ++i) {
                const LensRay& ray = rays_[i];
                const Vector3 m = lens_.direction(points_[i].X, points_[i].Y);
                const double t = (m.x * ray.dx + m.y * ray.dy + m.z * ray.depth) / (ray.r2 + ray.depth * ray.depth);
                over_t[i] = 1 / std::max(t * t, 1e-6);
            }
            if (n_robust > 0 && pass >= 1) reweight(0.0);
        }
        return true;
    }

    // H, the direction in which A does least, by inverse iteration.
    bool least_direction(const double (&A)[81]) {
        double trace = 0, L[81], x[9] = {0.61, 0.13, 0.07, -0.11, 0.59, 0.05, 0.17, -0.19, 0.43};
        for (int i = 0; i < 9; ++i) trace += A[10 * i];
        if (!(trace > 0) || !std::isfinite(trace)) return false;
        std::copy(A, A + 81, L);
        for (int i = 0; i < 9; ++i) L[10 * i] += 1e-13 * trace;
        if (!cholesky(L, L, 9, 9, 1e-16)) return false;
        for (int round = 0; round < 8; ++round) {
            solve_lower(L, 9, 9, x, x);
            solve_upper(L, 9, 9, x);
            double square = 0;
            for (double value : x) square += value * value;
            if (!(square > 0) || !std::isfinite(square)) return false;
            for (double& value : x) value /= std::sqrt(square);
        }
        std::copy(x, x + 9, lens_.H);
        return true;
    }

    // The sign of H by which most points are before the lens.
    void orient() {
        double before = 0;
        for (std::size_t i = 0; i < points_.size(); ++i) {
            const LensRay& ray = rays_[i];
            const Vector3 m = lens_.direction(points_[i].X, points_[i].Y);
            before += weights_[i] * (m.x * ray.dx + m.y * ray.dy + m.z * ray.depth > 0 ? 1 : -1);
        }
        if (before < 0)
            for (double& value : lens_.H) value = -value;
    }

    double prior(double noise2) const {
        double sum = 0;
        for (int k = 0; k < 6; ++k) sum += lens_.p[k] * lens_.p[k] / (kLensPriors[k] * kLensPriors[k]);
        return noise2 * sum;
    }

    // Levenberg's and Marquardt's steps in H and the lens, from what is there.
    void refine() {
        lens_.scale_depth();
        const double squares = measure(), noise2 = noise_px2();
        double cost = squares + prior(noise2), damping = 1e-4;
        for (int round = 0; round < 12 && damping < 1e6; ++round) {
            const ImageLens before = lens_;
            if (!step(noise2, damping)) {
                lens_ = before;
                damping *= 10;
                continue;
            }
            const double after = measure() + prior(noise2);
            if (!(after < cost)) {
                lens_ = before;
                measure();
                damping *= 10;
                if (after - cost < 1e-9 * cost) break;
                continue;
            }
            const bool is_done = cost - after < 1e-4 * after + 1e-9 * noise2;
            cost = after;
            damping = std::max(0.1 * damping, 1e-9);
            if (is_done) break;
        }
    }

    // The corners' noise against the priors: what was left of them when measured, at least kLensNoise_px, at most 1 px.
    double noise_px2() const {
        std::vector<double> sorted = lengths_;
        std::nth_element(sorted.begin(), sorted.begin() + sorted.size() / 2, sorted.end());
        const double noise = std::min(std::max(sorted[sorted.size() / 2] / 1.1774, kLensNoise_px), 1.0);
        return noise * noise;
    }

    bool step(double noise2, double damping) {
        const int n = 9 + options_.n_unknowns;
        double A[kLensUnknowns][kLensUnknowns] = {}, b[kLensUnknowns] = {};
        LensResidual at;
        for (std::size_t i = 0; i < points_.size(); ++i) {
            if (weights_[i] < 1e-6) continue;
            const LensPoint& point = points_[i];
            const LensRay& ray = rays_[i];  // of the last measurement
            if (!lens_.residual(lens_.direction(point.X, point.Y), ray, at)) continue;
            const double X[3] = {(point.X - lens_.board_x) / lens_.board_scale, (point.Y - lens_.board_y) / lens_.board_scale, 1};
            const double by_s = lens_.f * ray.dphi;
            const double of_depth[3] = {by_s * ray.r2, by_s * ray.r2 * ray.r2, by_s * ray.r2 * ray.r2 * ray.r2};
            for (int k : {0, 1}) {
                double row[kLensUnknowns];
                for (int a = 0; a < 3; ++a)
                    for (int c = 0; c < 3; ++c) row[3 * a + c] = at.G[k][a] * X[c];
                for (int a = 0; a < 3; ++a) row[9 + a] = -at.B[k][2] * of_depth[a];
                row[12] = k == 0 ? lens_.unit_px() : 0;
                row[13] = k == 1 ? lens_.unit_px() : 0;
                row[14] = k == 1 ? -lens_.unit_px() * ray.dy / ray.stretch : 0;
                for (int a = 0; a < n; ++a) {
                    const double weighted = weights_[i] * row[a];
                    for (int c = 0; c <= a; ++c) A[a][c] += weighted * row[c];
                    b[a] -= weighted * at.e[k];
                }
            }
        }
        double trace = 0;
        for (int a = 0; a < 9; ++a) trace += A[a][a];
        for (int k = 0; k < options_.n_unknowns; ++k) {
            const double precision = noise2 / (kLensPriors[k] * kLensPriors[k]);
            A[9 + k][9 + k] += precision;
            b[9 + k] -= precision * lens_.p[k];
        }
        for (int a = 0; a < n; ++a) A[a][a] *= 1 + damping;
        for (int a = 0; a < 9; ++a)  // H has no scale
            for (int c = 0; c <= a; ++c) A[a][c] += trace * lens_.H[a] * lens_.H[c];
        if (!cholesky(&A[0][0], &A[0][0], n, kLensUnknowns, 1e-14)) return false;
        solve_lower(&A[0][0], n, kLensUnknowns, b, b);
        solve_upper(&A[0][0], n, kLensUnknowns, b);
        double square = 0;
        for (int a = 0; a < 9; ++a) lens_.H[a] += b[a], square += lens_.H[a] * lens_.H[a];
        for (int a = 0; a < 9; ++a) lens_.H[a] /= std::sqrt(square);
        for (int k = 0; k < options_.n_unknowns; ++k) lens_.p[k] += b[9 + k];
        for (int k = 0; k < 6; ++k)
            if (!std::isfinite(lens_.p[k])) return false;
        lens_.p[5] = std::min(std::max(lens_.p[5], -2.0), 2.0);
        return std::isfinite(square);
    }

    const std::vector<LensPoint>& points_;
    LensOptions options_;
    ImageLens lens_;
    std::vector<double> weights_, lengths_;
    std::vector<LensRay> rays_;  // of the points, by the lens when last measured
};

// Where places of the board lie in the image, by Newton's method from the point that is nearest on the board; NaN where that leads
// nowhere. Both are x and y in turn.
inline void project_places(const ImageLens& lens, const std::vector<LensPoint>& points, const double* places, std::size_t n, double* images) {
    for (std::size_t i = 0; i < n; ++i) {
        const double X = places[2 * i], Y = places[2 * i + 1];
        const LensPoint* nearest = nullptr;
        double least = std::numeric_limits<double>::infinity();
        for (const LensPoint& point : points) {
            const double off2 = (point.X - X) * (point.X - X) + (point.Y - Y) * (point.Y - Y);
            if (off2 < least) least = off2, nearest = &point;
        }
        if (nearest == nullptr) continue;
        // Along the way in steps: one long step of Newton's leaves a strong lens's field.
        constexpr int n_steps = 8;
        double x = nearest->x, y = nearest->y;
        bool is_seen = true;
        for (int step = 1; step <= n_steps && is_seen; ++step) {
            const double share = static_cast<double>(step) / n_steps;
            const Vector3 m = lens.direction(nearest->X + share * (X - nearest->X), nearest->Y + share * (Y - nearest->Y));
            is_seen = lens.project(m, step < n_steps ? 3 : 6, x, y);
        }
        LensResidual last;
        is_seen = is_seen && lens.residual(lens.direction(X, Y), lens.ray(x, y), last) && std::hypot(last.e[0], last.e[1]) < 1e-3;
        if (is_seen) images[2 * i] = x, images[2 * i + 1] = y;
    }
}

}  // namespace binocal
