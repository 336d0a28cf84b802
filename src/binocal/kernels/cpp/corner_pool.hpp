// The fits of one image's corners made one estimate: they share the pixels' noise and the light's slope, which is
// smooth across a board.
#pragma once

#include "corner_fit.hpp"

#include <vector>

namespace binocal {

constexpr std::size_t kMinCornersToPool = 12;  // below it a fit of the light's slope to position (3 numbers an axis) gains nothing
constexpr double kLeastSlopeSpread = 2e-5;     // 1/px; what paper and lens do on a board's scale even in even light
constexpr double kNoiseSpread = 1.3;           // noise variance over the image's median that dark and bright pixels, or JPEG, explain
constexpr double kChance = 8.0;                // over the root of the pixels: four standard deviations of the odd variance that noise has
constexpr double kPixelsPerCell = 15.0;        // what contradicts the model is alike over so many pixels: measured on shadows' borders
constexpr double kMaxMisfit = 0.1;             // of the contrast: odd residuals beyond it are an occlusion or a glare, not a corner
constexpr double kFarSlope2 = 9.0;             // a slope three standard deviations from the others' is one of its own: a shadow's
constexpr double kRounding = 1.0 / 12;         // grey levels^2
constexpr double kMostLong = 16.0;             // variance of noise alike in neighbours over the pixels': upscaled images have 4 and more
constexpr double kLeastLong = 0.4;             // JPEG at a noise of 1 grey level has 0.7
constexpr double kMostCrossing = 0.3;          // of a disc's radius that the blurred crossing takes
constexpr double kMostClippedOfSpot = 0.02;  // share of a spot's pixels
constexpr double kOffLine = 0.3;               // of their distance: corners farther off each other's edge share none of its pixels

struct PooledCorner {
    double x, y;
    double covariance[4];
    double cross[4];  // the sum of its covariances with the image's other corners, which share pixels with it; symmetric part
    double misfit;  // variance of the residuals' odd part over the image's noise: 1 where the model holds
};
constexpr std::size_t kPooledSize = 11;
static_assert(sizeof(PooledCorner) == kPooledSize * sizeof(double));

inline double median_of(std::vector<double> values) {
    if (values.empty()) return std::numeric_limits<double>::quiet_NaN();
    auto middle = values.begin() + values.size() / 2;
    std::nth_element(values.begin(), middle, values.end());
    double upper = *middle;
    return values.size() % 2 ? upper : 0.5 * (upper + *std::max_element(values.begin(), middle));
}

// What a corner's covariance grows by where the residuals' odd part is more than noise.
//
// Noise averages out over the disc's pixels; a shadow's border or a glare is alike in many neighbours, and moves the corner by more.
inline double growth_of(const CornerResult& fit, double misfit) {
    const double coherent = misfit - 1 - kChance / std::sqrt(std::max(fit.n_pixels, 1.0));
    return 1 + std::max(0.0, coherent) * fit.n_pixels / kPixelsPerCell;
}

// Variance of the noise as it moves corners over that of the pixels' noise: 1 where neighbouring pixels' noise is independent.
//
// Mean over the corners that were looked at, drawn to 1 by as much as chance explains (James & Stein 1961, for one mean).
inline double coherence_of(const CornerResult* fits, const std::vector<std::size_t>& sound, double noise2) {
    double sum = 0, squares = 0;
    int count = 0;
    for (std::size_t i : sound) {
        const double ratio = fits[i].long_variance / noise2;
        if (std::isfinite(ratio)) sum += ratio, squares += ratio * ratio, ++count;
    }
    if (count < 8) return 1;
    const double mean = sum / count, chance2 = std::max(squares / count - mean * mean, 0.0) / (count - 1), off = mean - 1;
    const double kept = std::max(0.0, 1 - chance2 / std::max(off * off, 1e-300));
    return std::max(std::min(std::max(1 + kept * off, kLeastLong), kMostLong), kRounding / noise2);
}

// Weighted least squares in few unknowns by normal equations.
class LeastSquares {
  public:
    explicit LeastSquares(int n) : n_(n) {}
    void add(const double* row, double weight, double y) {
        for (int i = 0; i < n_; ++i) {
            for (int j = 0; j <= i; ++j) A_[i][j] += weight * row[i] * row[j];
            b_[i] += weight * row[i] * y;
        }
    }
    bool factorize() { return cholesky(&A_[0][0], &L_[0][0], n_, kMost, 1e-13); }
    void solve(double* x) const {
        solve_lower(&L_[0][0], n_, kMost, b_, x);
        solve_upper(&L_[0][0], n_, kMost, x);
    }
    // Variance of the fit at a row, for weights that are inverse variances.
    double variance(const double* row) const {
        double x[kMost], sum = 0;
        solve_lower(&L_[0][0], n_, kMost, row, x);
        for (int i = 0; i < n_; ++i) sum += x[i] * x[i];
        return sum;
    }

  private:
    static constexpr int kMost = 3;
    int n_;
    double A_[kMost][kMost] = {}, L_[kMost][kMost] = {}, b_[kMost] = {};
};

// Positions given what the other corners say about the light's slope (relative, per px).
//
// A slope of the light is correlated with the position (at a blur of 3 px it costs the corner a factor 1.4), and is linear
// in the image on a board's scale. The conditional mean and covariance of a Gaussian do the rest. The slopes' scatter
// beyond their own covariance, which shadows and glare raise, widens the prediction. A corner that contradicts the model keeps
// its own slope: on the border of a shadow the others' slope would move it by half a pixel.
inline void share_slope(const CornerResult* fits, std::size_t n, const std::vector<std::size_t>& sound, double noise2, double coherence,
                        PooledCorner* out) {
    if (sound.size() < kMinCornersToPool) return;
    auto scale_of = [&](const CornerResult& fit) { return coherence * noise2 * std::max(1.0, fit.odd_variance / noise2 / kNoiseSpread); };
    double mean_x = 0, mean_y = 0, square = 0;
    for (std::size_t i : sound) mean_x += fits[i].x, mean_y += fits[i].y;
    mean_x /= sound.size(), mean_y /= sound.size();
    for (std::size_t i : sound) square += std::pow(fits[i].x - mean_x, 2) + std::pow(fits[i].y - mean_y, 2);
    const double spread_px = std::sqrt(square / sound.size());
    auto row_of = [&](const CornerResult& fit, double* row) {
        row[0] = (fit.x - mean_x) / spread_px, row[1] = (fit.y - mean_y) / spread_px, row[2] = 1;
    };
    constexpr int of_slope[2] = {7, 9};  // in the packed covariance of x, y, gx, gy
    double spread2 = kLeastSlopeSpread * kLeastSlopeSpread;
    std::vector<double> predicted[2], variance[2], scatters(sound.size()), widths(sound.size());
    for (int axis : {0, 1}) {
        double row[3], c[3];
        LeastSquares fit(3);
        for (int round = 0; round < 3; ++round) {
            fit = LeastSquares(3);
            for (std::size_t i : sound) {
                row_of(fits[i], row);
                fit.add(row, 1 / (fits[i].covariance[of_slope[axis]] * scale_of(fits[i]) + spread2), axis ? fits[i].gy : fits[i].gx);
            }
            if (!fit.factorize()) return;
            fit.solve(c);
            for (std::size_t k = 0; k < sound.size(); ++k) {
                const CornerResult& corner = fits[sound[k]];
                row_of(corner, row);
                widths[k] = corner.covariance[of_slope[axis]] * scale_of(corner) + spread2;
                double off = (axis ? corner.gy : corner.gx) - (row[0] * c[0] + row[1] * c[1] + row[2] * c[2]);
                scatters[k] = std::fabs(off) / std::sqrt(widths[k]);
            }
            double scatter = 1.4826 * median_of(scatters);
            if (scatter < 1.1) break;
            spread2 += (scatter * scatter - 1) * median_of(widths);
        }
        predicted[axis].resize(n), variance[axis].resize(n);
        for (std::size_t i : sound) {
            row_of(fits[i], row);
            predicted[axis][i] = row[0] * c[0] + row[1] * c[1] + row[2] * c[2];
            variance[axis][i] = fit.variance(row);
        }
    }
    for (std::size_t i : sound) {
        const CornerResult& f = fits[i];
        const double s = scale_of(f), *c = f.covariance;
        // cov(xy, slope) inverse(cov(slope) + prior), 2 x 2 each
        double off[2] = {predicted[0][i] - f.gx, predicted[1][i] - f.gy};
        double a = std::max(c[7] * s + variance[0][i] + spread2, off[0] * off[0] / kFarSlope2);
        double b = c[8] * s, d = std::max(c[9] * s + variance[1][i] + spread2, off[1] * off[1] / kFarSlope2);
        double cross[2][2] = {{c[2] * s, c[3] * s}, {c[5] * s, c[6] * s}};
        double determinant = a * d - b * b;
        double gain[2][2];
        for (int k : {0, 1}) {
            gain[k][0] = (cross[k][0] * d - cross[k][1] * b) / determinant;
            gain[k][1] = (cross[k][1] * a - cross[k][0] * b) / determinant;
        }
        out[i].x += gain[0][0] * off[0] + gain[0][1] * off[1];
        out[i].y += gain[1][0] * off[0] + gain[1][1] * off[1];
        for (int k : {0, 1})
            for (int l : {0, 1}) out[i].covariance[2 * k + l] -= gain[k][0] * cross[l][0] + gain[k][1] * cross[l][1];
    }
}

// Adds the covariance of the bias that pixels leave which are coarser than the edge is blurred, px^2.
//
// Without blur an edge along the pixels' rows changes one grey value only, and how much the pixel's shape is not a
// Gaussian's: measured on rendered boards parallel to the rows, 0.038, 0.022, 0.0074, 0.0028 px at blurs (pixel
// integration included) of 0.295, 0.347, 0.42, 0.50. An edge that crosses a row within the disc averages it away.
inline void add_sampling(const CornerResult& fit, PooledCorner& out) {
    const double blurs[2] = {fit.blur1, fit.blur2}, angles[2] = {fit.angle1, fit.angle2};
    for (int k : {0, 1}) {
        const double slant = std::fabs(std::sin(2 * angles[k])) / 2;  // of the angle to the nearer of the pixels' axes, nearly
        const double crossed = 1 + std::pow(2 * fit.radius * slant, 2);
        const double bias = std::min(0.038 * std::exp(-12.5 * (blurs[k] - 0.29)), 0.05) / crossed;
        const double normal[2] = {-std::sin(angles[k]), std::cos(angles[k])};
        for (int i : {0, 1})
            for (int j : {0, 1}) out.covariance[2 * i + j] += bias * bias * normal[i] * normal[j];
    }
}

// Sums each corner's covariances with the others, where their discs share an edge between them.
//
// The offset of an edge along its normal is the mean of what its pixels say over the disc's diameter 2 r, less what the blurred
// crossing takes (1.13 sigma of each arm, the integral of 1 - erf^2). Corners s apart on one edge have r1 + r2 - s of it in common,
// and the same noise there: the correlation is that over the root of the two lengths, 0.44 where discs of 0.85 squares have a
// radius of ten blurs. Measured on rendered boards of 10 to 24 px a square: 0.99 +- 0.05 of it at blurs of 0.5 and 0.9 px, 0.85 at
// 2 px. What lies across an edge has no pixels of it.
inline void share_pixels(const CornerResult* fits, std::size_t n, PooledCorner* out) {
    std::vector<std::size_t> order;
    for (std::size_t i = 0; i < n; ++i)
        if (std::isfinite(out[i].x)) order.push_back(i);
    std::sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) { return out[a].x < out[b].x; });
    struct Edge {
        double normal[2], variance, length, sum;
    };
    std::vector<std::array<Edge, 2>> edges(n);
    for (std::size_t i : order) {
        const double angles[2] = {fits[i].angle1, fits[i].angle2}, *C = out[i].covariance;
        for (int k : {0, 1}) {
            const double c = std::cos(angles[k]), s = std::sin(angles[k]);
            const double crossing = std::min(1.13 * 0.5 * (fits[i].blur1 + fits[i].blur2), kMostCrossing * fits[i].radius);
            edges[i][k] = {{-s, c}, C[0] * s * s - 2 * C[1] * s * c + C[3] * c * c, 2 * (fits[i].radius - crossing), 0};
        }
    }
    for (std::size_t a = 0; a < order.size(); ++a) {
        for (std::size_t b = a + 1; b < order.size() && out[order[b]].x - out[order[a]].x < 2 * kMaxRadius; ++b) {
            const std::size_t i = order[a], j = order[b];
            const double dx = out[j].x - out[i].x, dy = out[j].y - out[i].y, r1 = fits[i].radius, r2 = fits[j].radius;
            const double apart = std::hypot(dx, dy), shared = std::min(r1 + r2 - apart, 2 * std::min(r1, r2));
            if (!(shared > 0) || apart < kMinRadius) continue;
            for (Edge& one : edges[i])
                for (Edge& other : edges[j]) {
                    const double off1 = std::fabs(dx * one.normal[0] + dy * one.normal[1]);
                    const double off2 = std::fabs(dx * other.normal[0] + dy * other.normal[1]);
                    if (std::max(off1, off2) > kOffLine * apart) continue;
                    const double covariance = shared * std::sqrt(one.variance * other.variance / (one.length * other.length));
                    one.sum += covariance, other.sum += covariance;
                }
        }
    }
    for (std::size_t i : order) {  // from the normals' components back to x and y
        const Edge &one = edges[i][0], &other = edges[i][1];
        const double determinant = one.normal[0] * other.normal[1] - one.normal[1] * other.normal[0], unit = 1 / (determinant * determinant);
        const double u[2] = {other.normal[1], -other.normal[0]}, v[2] = {-one.normal[1], one.normal[0]};
        for (int k : {0, 1})
            for (int l : {0, 1}) out[i].cross[2 * k + l] = unit * (one.sum * u[k] * u[l] + other.sum * v[k] * v[l]);
    }
}

// Pools n fits of points that share no pixels, NaN where there is none. Returns the noise's variance, grey levels^2.
//
// Points more of whose pixels than `most_clipped` are clipped keep their own slope of the light. Where light varies by half across the board
// its relative slope is not linear, by a tenth, and a spot whose own slope is hardly known would follow the line.
inline double pool_points(const CornerResult* fits, std::size_t n, PooledCorner* out, double most_clipped) {
    constexpr double nan = std::numeric_limits<double>::quiet_NaN();
    std::vector<double> odd;
    for (std::size_t i = 0; i < n; ++i)
        if (std::isfinite(fits[i].x)) odd.push_back(fits[i].odd_variance);
    const double noise2 = odd.empty() ? nan : std::max(median_of(odd), kRounding);
    std::vector<std::size_t> sound;
    std::vector<bool> is_fitted(n);
    for (std::size_t i = 0; i < n; ++i) {
        const CornerResult& fit = fits[i];
        PooledCorner& corner = out[i];
        corner.misfit = fit.odd_variance / noise2;
        is_fitted[i] = std::isfinite(fit.x) &&
                       !(std::sqrt(std::max(fit.odd_variance - noise2, 0.0)) > kMaxMisfit * 2 * std::fabs(fit.contrast));
        if (is_fitted[i] && corner.misfit < 2) sound.push_back(i);
    }
    const double coherence = coherence_of(fits, sound, noise2);
    for (std::size_t i = 0; i < n; ++i) {
        const CornerResult& fit = fits[i];
        PooledCorner& corner = out[i];
        const double scale = coherence * noise2 * std::max(1.0, corner.misfit / kNoiseSpread);
        corner.x = fit.x, corner.y = fit.y;
        corner.covariance[0] = fit.covariance[0] * scale, corner.covariance[3] = fit.covariance[4] * scale;
        corner.covariance[1] = corner.covariance[2] = fit.covariance[1] * scale;
    }
    std::erase_if(sound, [&](std::size_t i) { return fits[i].clipped_share > most_clipped; });
    share_slope(fits, n, sound, noise2, coherence, out);
    for (std::size_t i = 0; i < n; ++i) {
        const double growth = growth_of(fits[i], out[i].misfit) / std::max(1.0, out[i].misfit / kNoiseSpread);
        if (growth > 1)
            for (double& covariance : out[i].covariance) covariance *= growth;
        if (!is_fitted[i]) out[i].x = out[i].y = nan, std::fill_n(out[i].covariance, 4, nan);
        std::fill_n(out[i].cross, 4, is_fitted[i] ? 0 : nan);
    }
    return noise2;
}

// Pools n fits into n corners, which share the pixels of the edges between them. Returns the noise's variance, grey levels^2.
inline double pool_corners(const CornerResult* fits, std::size_t n, PooledCorner* out) {
    const double noise2 = pool_points(fits, n, out, std::numeric_limits<double>::infinity());
    share_pixels(fits, n, out);
    for (std::size_t i = 0; i < n; ++i)
        if (std::isfinite(out[i].x)) add_sampling(fits[i], out[i]);
    return noise2;
}

}  // namespace binocal
