// The corners of one board's image: each fitted on its own, then again along the curves that its edges are by the image's lens.
//
// The fit's model has straight edges. One of curvature k lies k t^2 / 2 from its tangent, in the mean over a disc of radius R
// k R^2 / 6, and moves the corner by as much: 0.1 px at the rim of a lens of 180 degrees. The corners show the lens well enough
// to know k: biased by that much they still give the second fit's corners to 0.0002 px.
#pragma once

#include "corner_fit.hpp"
#include "image_lens.hpp"

#include <vector>

namespace binocal {

constexpr std::size_t kMinCornersForLens = 6;  // fewer fit any lens
constexpr std::size_t kMinCornersForAll = 10;  // of the lens's unknowns; below it w alone
constexpr double kMostOffLens_px = 1.0;        // median distance from the lens: beyond it the image is no plane's
constexpr double kStraight_px = 0.003;         // edges that would move no corner by more bend the reach too little to count
constexpr double kBent_px = 0.006;             // beyond it what is left along the edges would count as noise
// The same beside clipped paper: there the light's slope shifts both arms of an edge to one side, and takes the place of the bend, so
// that what a bent edge moves the corner by is not known before.
constexpr double kBentClipped_px = 0.0003;
constexpr double kTouching = 0.9;              // of the reach by the lens: a first disc beyond it may hold a neighbour's edge
constexpr double kDerivativeStep = 0.05;       // pitches
constexpr double kLineHalf = 1.3;              // pitches, from the middle of a neighbouring line to where it ends
constexpr int kLineSamples = 3;                // on either side of its middle

// The board's two axes at a corner.
struct Bends {
    double tangent[2][2];  // unit vectors
    double curvature[2];   // 1/px, towards (-tangent y, tangent x)
    bool is_known = false;
};

// By differences of the image over a small step: Newton's method starts each end where the tangent leads, and needs one round.
inline Bends bends_at(const ImageLens& lens, double X, double Y, double pitch, double x, double y) {
    Bends bends;
    const double h = kDerivativeStep * pitch, of_unit = h / lens.board_scale;
    const Vector3 m = lens.direction(X, Y);
    LensResidual at;
    for (int round = 0; round < 2; ++round) {
        if (!lens.residual(m, lens.ray(x, y), at)) return bends;
        x += at.e[0], y += at.e[1];
    }
    for (int axis : {0, 1}) {
        double move[2], ends[2][2];
        for (int i : {0, 1}) move[i] = of_unit * (at.G[i][0] * lens.H[axis] + at.G[i][1] * lens.H[3 + axis] + at.G[i][2] * lens.H[6 + axis]);
        for (int side : {0, 1}) {
            const double sign = side ? 1 : -1, step = sign * h;
            ends[side][0] = x + sign * move[0], ends[side][1] = y + sign * move[1];
            if (!lens.project(lens.direction(X + (axis ? 0 : step), Y + (axis ? step : 0)), 1, ends[side][0], ends[side][1])) return bends;
        }
        const double tx = 0.5 * (ends[1][0] - ends[0][0]), ty = 0.5 * (ends[1][1] - ends[0][1]), length = std::sqrt(tx * tx + ty * ty);
        const double sx = ends[1][0] + ends[0][0] - 2 * x, sy = ends[1][1] + ends[0][1] - 2 * y;
        bends.tangent[axis][0] = tx / length, bends.tangent[axis][1] = ty / length;
        bends.curvature[axis] = (tx * sy - ty * sx) / (length * length * length);
        if (!std::isfinite(bends.curvature[axis])) return bends;
    }
    bends.is_known = true;
    return bends;
}

inline double distance_to_segment(const double (&a)[2], const double (&b)[2], double x, double y) {
    const double dx = b[0] - a[0], dy = b[1] - a[1], length2 = std::max(dx * dx + dy * dy, 1e-18);
    const double share = std::min(std::max(((x - a[0]) * dx + (y - a[1]) * dy) / length2, 0.0), 1.0);
    return std::hypot(a[0] + share * dx - x, a[1] + share * dy - y);
}

// Distance from a corner to the images of the four lines one pitch away, which are the neighbours' edges or the board's, px.
inline double reach_by_lens(const ImageLens& lens, double X, double Y, double pitch, double x, double y) {
    double nearest = std::numeric_limits<double>::infinity();
    for (int axis : {0, 1}) {
        for (double side : {-pitch, pitch}) {
            auto at = [&](double along) { return axis ? lens.direction(X + along, Y + side) : lens.direction(X + side, Y + along); };
            double middle[2] = {x, y};
            if (!lens.project(at(0), 6, middle[0], middle[1])) continue;
            for (double way : {-1.0, 1.0}) {
                double from[2] = {middle[0], middle[1]};
                for (int k = 1; k <= kLineSamples; ++k) {
                    double to[2] = {from[0], from[1]};
                    if (!lens.project(at(way * kLineHalf * pitch * k / kLineSamples), 3, to[0], to[1])) break;
                    nearest = std::min(nearest, distance_to_segment(from, to, x, y));
                    from[0] = to[0], from[1] = to[1];
                }
            }
        }
    }
    return nearest;
}

// The edges' curvatures towards the fit's own normals: an edge belongs to the axis that it follows.
inline void attach(const CornerResult& fit, const Bends& bends, double (&bend)[2]) {
    const double angles[2] = {fit.angle1, fit.angle2};
    double cosines[2][2];
    for (int edge : {0, 1})
        for (int axis : {0, 1})
            cosines[edge][axis] = std::cos(angles[edge]) * bends.tangent[axis][0] + std::sin(angles[edge]) * bends.tangent[axis][1];
    const bool is_swapped =
        std::fabs(cosines[0][0]) + std::fabs(cosines[1][1]) < std::fabs(cosines[0][1]) + std::fabs(cosines[1][0]);
    for (int edge : {0, 1}) {
        const int axis = edge ^ static_cast<int>(is_swapped);
        bend[edge] = cosines[edge][axis] < 0 ? -bends.curvature[axis] : bends.curvature[axis];
    }
}

// Moves a corner from where straight edges crossed to where the bent ones do, to first order.
inline void unbend(const Bends& bends, CornerResult& fit) {
    const double blur = 0.5 * (fit.blur1 + fit.blur2);
    // The blurred crossing says little.
    const double mean_t2 = fit.radius * fit.radius / 3 / std::max(1 - 1.13 * blur / fit.radius, 0.3);
    const double offset[2] = {0.5 * bends.curvature[0] * mean_t2, 0.5 * bends.curvature[1] * mean_t2};
    const double normal[2][2] = {{-bends.tangent[0][1], bends.tangent[0][0]}, {-bends.tangent[1][1], bends.tangent[1][0]}};
    const double determinant = normal[0][0] * normal[1][1] - normal[0][1] * normal[1][0];
    if (!(std::fabs(determinant) > 0.1)) return;
    fit.x -= (normal[1][1] * offset[0] - normal[0][1] * offset[1]) / determinant;
    fit.y -= (normal[0][0] * offset[1] - normal[1][0] * offset[0]) / determinant;
}

// What the corners of one board's image need beside the image.
struct BoardPlaces {
    const double* xy;  // on the board, n times x and y
    double pitch;      // of its lines, in the same unit; 0 where its edges are not a grid of lines one pitch apart
};

// A corner whose first disc, by the reach that the caller knew, held one of the bent lines beside it: again from where the others'
// lens sees it, with the reach by that lens. A corner that failed for anything else stays as it is.
template <typename Pixel>
CornerResult fit_off_lines(const ImageView<Pixel>& image, CornerInput input, const CornerResult& nowhere, const ImageLens& lens,
                           const double (&at)[2], double pitch, bool looks_at_noise, Workspace& work) {
    const double start[2] = {input.x, input.y};
    if (!lens.project(lens.direction(at[0], at[1]), 6, input.x, input.y)) return nowhere;
    if (!(std::hypot(input.x - start[0], input.y - start[1]) < std::max(1.5, 0.5 * input.reach))) return nowhere;
    const double reach = reach_by_lens(lens, at[0], at[1], pitch, input.x, input.y);
    if (!(kDiscShare * input.reach > kTouching * reach)) return nowhere;
    input.reach = reach;
    return CornerFitter<Pixel>(image, input, work, looks_at_noise).fit();
}

// A corner beside markers that failed on its own: again from where the others' lens sees it and its edges, with the nearest one's blur and
// contrast.
template <typename Pixel>
CornerResult fit_by_others(const ImageView<Pixel>& image, CornerInput input, const CornerResult* fits, std::ptrdiff_t n, std::ptrdiff_t self,
                           const BoardPlaces& board, const ImageLens& lens, double step, bool looks_at_noise, Workspace& work) {
    const CornerResult& nowhere = fits[self];
    const double start[2] = {input.x, input.y}, *at = board.xy + 2 * self;
    if (!std::isfinite(start[0]) || !std::isfinite(start[1])) return nowhere;
    std::ptrdiff_t nearest = -1;
    double least = std::numeric_limits<double>::infinity();
    for (std::ptrdiff_t i = 0; i < n; ++i) {
        const double square = (board.xy[2 * i] - at[0]) * (board.xy[2 * i] - at[0]) + (board.xy[2 * i + 1] - at[1]) * (board.xy[2 * i + 1] - at[1]);
        if (std::isfinite(fits[i].x) && square < least) least = square, nearest = i;
    }
    if (nearest < 0 || !lens.project(lens.direction(at[0], at[1]), 6, input.x, input.y)) return nowhere;
    if (!(std::hypot(input.x - start[0], input.y - start[1]) < std::max(1.5, 0.5 * input.reach))) return nowhere;
    const Bends bends = bends_at(lens, at[0], at[1], step, input.x, input.y);
    if (!bends.is_known) return nowhere;
    double edges[2];
    for (int axis : {0, 1}) edges[axis] = std::atan2(bends.tangent[axis][1], bends.tangent[axis][0]);
    return CornerFitter<Pixel>(image, input, work, looks_at_noise).fit_like(fits[nearest], edges, bends.curvature);
}

template <typename Pixel>
void fit_board_corners(const ImageView<Pixel>& image, const CornerInput* inputs, std::ptrdiff_t n, const BoardPlaces& board,
                       CornerResult* results) {
    fit_corners(image, inputs, n, results);
    std::vector<LensPoint> points;
    double extent = 0;
    for (std::ptrdiff_t i = 0; i < n; ++i) {
        if (!std::isfinite(results[i].x)) continue;
        points.push_back({board.xy[2 * i], board.xy[2 * i + 1], results[i].x, results[i].y});
        extent = std::max({extent, std::fabs(points.back().X - points[0].X), std::fabs(points.back().Y - points[0].Y)});
    }
    if (points.size() < kMinCornersForLens || !(extent > 0) || !std::isfinite(extent)) return;
    LensOptions options;
    options.n_unknowns = points.size() < kMinCornersForAll ? 1 : 6;
    ImageLensFit fitted(points, static_cast<double>(image.width), static_cast<double>(image.height), options);
    if (!fitted.fit()) return;
    std::vector<double> lengths = fitted.lengths();
    std::nth_element(lengths.begin(), lengths.begin() + lengths.size() / 2, lengths.end());
    if (!(lengths[lengths.size() / 2] < kMostOffLens_px)) return;
    const ImageLens& lens = fitted.lens();

    const double step = board.pitch > 0 ? board.pitch : 0.1 * extent;
    std::vector<Bends> bends(n);
    double worst = 0;
    auto offset_of = [&](std::ptrdiff_t i) {
        const double k = std::max(std::fabs(bends[i].curvature[0]), std::fabs(bends[i].curvature[1]));
        return k * results[i].radius * results[i].radius / 6;
    };
    auto bend_at = [&](std::ptrdiff_t i) {
        if (std::isfinite(results[i].x))
            bends[i] = bends_at(lens, board.xy[2 * i], board.xy[2 * i + 1], step, results[i].x, results[i].y);
    };
    for (std::ptrdiff_t i = 0; i < n; ++i) {
        bend_at(i);
        if (bends[i].is_known) worst = std::max(worst, offset_of(i));
    }
    const bool is_straight = worst < kStraight_px;
    alignas(32) static thread_local Workspace work;
    const std::ptrdiff_t every = (n + kCornersForNoise - 1) / kCornersForNoise;
    for (std::ptrdiff_t i = 0; i < n; ++i) {
        if (is_straight || !(board.pitch > 0) || std::isfinite(results[i].x)) continue;
        results[i] = fit_off_lines<Pixel>(image, inputs[i], results[i], lens, {board.xy[2 * i], board.xy[2 * i + 1]},
                                          board.pitch, is_picked(i, every), work);
        bend_at(i);
    }
    std::vector<CornerResult> by_others;
    for (std::ptrdiff_t i = 0; i < n; ++i) {
        if (std::isfinite(results[i].x) || !std::isfinite(inputs[i].strip)) continue;
        by_others.push_back(fit_by_others<Pixel>(image, inputs[i], results, n, i, board, lens, step, is_picked(i, every), work));
    }
    for (std::ptrdiff_t i = n - 1; i >= 0 && !by_others.empty(); --i) {
        if (std::isfinite(results[i].x) || !std::isfinite(inputs[i].strip)) continue;
        results[i] = by_others.back();
        by_others.pop_back();
    }
    for (std::ptrdiff_t i = 0; i < n; ++i) {
        if (!bends[i].is_known) continue;
        CornerInput input = inputs[i];
        bool touches = false;
        if (!is_straight && board.pitch > 0) {
            const double reach = reach_by_lens(lens, board.xy[2 * i], board.xy[2 * i + 1], board.pitch, results[i].x, results[i].y);
            touches = results[i].radius > kTouching * reach;
            input.reach = std::min(input.reach, reach);
        }
        if (touches || offset_of(i) > (results[i].clipped_share > 0 ? kBentClipped_px : kBent_px)) {
            double bend[2];
            attach(results[i], bends[i], bend);
            input.x = results[i].x, input.y = results[i].y;
            const CornerResult again = CornerFitter<Pixel>(image, input, work, is_picked(i, every)).fit_bent(results[i], bend);
            if (std::isfinite(again.x)) {
                results[i] = again;
                continue;
            }
        }
        unbend(bends[i], results[i]);
    }
}

}  // namespace binocal
