// X-corners and their lattices: bilinear reading, rings, saddles, links along edges and connected grids. What each decides
// and why stands in binocal/detection/finding; here are only the loops.
#include "sampler.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numeric>

namespace binocal {
namespace {

constexpr double kPi = 3.14159265358979323846;
constexpr int kRing = 32;        // samples on a ring: 11 degrees apart, fine enough for sectors of 30 degrees
constexpr int kNeighbours = 14;  // nearest corners that are tried as partners of a link
constexpr int kNeighboursOfMarkers = 24;  // markers' codes have saddles of their own
constexpr int kNeighboursOblique = 96;    // of squares six times as long as high

using Places = nb::ndarray<const double, nb::shape<-1, 2>, nb::device::cpu, nb::c_contig>;
using FlagsOut = nb::ndarray<bool, nb::device::cpu, nb::c_contig>;
using IndicesIn = nb::ndarray<const std::int64_t, nb::device::cpu, nb::c_contig>;
using IndicesOut = nb::ndarray<std::int64_t, nb::device::cpu, nb::c_contig>;

template <typename Pixel>
void sample(const Plane<Pixel>& plane, const Places& points, nb::ndarray<float, nb::ndim<1>, nb::device::cpu, nb::c_contig> values) {
    require(values.size() == points.shape(0), "the arrays' lengths do not match");
    const Sampler<Pixel> read(plane);
    const double* at = points.data();
    float* out = values.data();
    const std::size_t n = values.size();
    nb::gil_scoped_release unlocked;
    for (std::size_t i = 0; i < n; ++i) out[i] = read(at[2 * i], at[2 * i + 1]);
}

double wrapped(double angle) { return angle - 2 * kPi * std::floor((angle + kPi) / (2 * kPi)); }

struct RingLimits {
    double radius, min_contrast, max_unlikeness;
};

// Whether the ring around a point shows four crossings, opposite ones alike; the four edges' directions and the contrast.
template <typename Pixel>
bool read_ring(const Sampler<Pixel>& read, double x, double y, const RingLimits& limits, double* rays, double& contrast) {
    static const auto circle = [] {
        std::array<std::array<double, 2>, kRing> points;
        for (int k = 0; k < kRing; ++k) points[k] = {std::cos(2 * kPi * k / kRing), std::sin(2 * kPi * k / kRing)};
        return points;
    }();
    float value[kRing];
    for (int k = 0; k < kRing; ++k) value[k] = read(x + limits.radius * circle[k][0], y + limits.radius * circle[k][1]);
    const auto [least, most] = std::minmax_element(value, value + kRing);
    contrast = *most - *least;
    if (!(contrast > limits.min_contrast)) return false;
    const float middle = 0.5f * (*most + *least);
    float unlike = 0;
    for (int k = 0; k < kRing / 2; ++k) unlike += std::fabs(value[k] - value[k + kRing / 2]);
    if (!(unlike / (kRing / 2) < limits.max_unlikeness * contrast)) return false;
    int n_crossings = 0;
    double angle[4];
    bool is_first_rising = false;
    for (int k = 0; k < kRing; ++k) {
        const float before = value[k] - middle, after = value[(k + 1) % kRing] - middle;
        if ((before > 0) == (after > 0)) continue;
        if (n_crossings == 4) return false;
        if (n_crossings == 0) is_first_rising = after > 0;
        angle[n_crossings++] = (k + static_cast<double>(before) / (before - after)) * (2 * kPi / kRing);
    }
    if (n_crossings != 4) return false;
    for (int k = 0; k < 4; ++k) rays[k] = angle[is_first_rising ? k : (k + 1) % 4];
    // Each edge runs straight through: 40 degrees admit strong lens distortion, thin sectors and noise.
    constexpr double most_bend = 40 * kPi / 180, least_sector = 18 * kPi / 180;
    for (int k = 0; k < 2; ++k)
        if (!(std::fabs(wrapped(rays[k] + kPi - rays[k + 2])) < most_bend)) return false;
    for (int k = 0; k < 4; ++k) {
        double sector = std::fmod(rays[(k + 1) % 4] - rays[k] + 4 * kPi, 2 * kPi);
        if (!(sector > least_sector)) return false;
    }
    return true;
}

template <typename Pixel>
void read_rings(const Plane<Pixel>& plane, const Places& points, double radius, double min_contrast, double max_unlikeness,
                FlagsOut is_corner, DoublesOut rays, DoublesOut contrast) {
    const std::size_t n = points.shape(0);
    require(is_corner.size() == n && rays.size() == 4 * n && contrast.size() == n, "the arrays' lengths do not match");
    const Sampler<Pixel> read(plane);
    const RingLimits limits{radius, min_contrast, max_unlikeness};
    const double* at = points.data();
    bool* flag = is_corner.data();
    double *ray = rays.data(), *span = contrast.data();
    nb::gil_scoped_release unlocked;
    std::fill_n(ray, 4 * n, 0.0);
    for (std::size_t i = 0; i < n; ++i) flag[i] = read_ring(read, at[2 * i], at[2 * i + 1], limits, ray + 4 * i, span[i]);
}

// Moves points to the saddle of the quadratic that the rows of `fit` (x^2, xy, y^2, x, y) find in the window around them.
template <typename Pixel>
void localize_saddles(const Plane<Pixel>& plane, const Doubles& fit, std::ptrdiff_t reach, DoublesOut points) {
    require(reach >= 0 && reach < 1000, "the reach must be 0 or more pixels, and below 1000");
    const std::ptrdiff_t side = 2 * reach + 1, area = side * side;
    require(fit.size() == static_cast<std::size_t>(5 * area) && points.size() % 2 == 0, "the arrays' lengths do not match");
    const auto height = static_cast<std::ptrdiff_t>(plane.shape(0)), width = static_cast<std::ptrdiff_t>(plane.shape(1));
    const Pixel* image = plane.data();
    const double* weights = fit.data();
    double* point = points.data();
    const std::size_t n = points.size() / 2;
    nb::gil_scoped_release unlocked;
    for (std::size_t i = 0; i < n; ++i, point += 2) {
        const double start[2] = {point[0], point[1]};
        if (!(std::isfinite(start[0]) && std::isfinite(start[1]))) continue;
        for (int round = 0; round < 2; ++round) {
            const double centre[2] = {std::nearbyint(point[0]), std::nearbyint(point[1])};
            if (!(centre[0] >= reach && centre[0] < width - reach && centre[1] >= reach && centre[1] < height - reach)) break;
            const Pixel* corner = image + (static_cast<std::ptrdiff_t>(centre[1]) - reach) * width + static_cast<std::ptrdiff_t>(centre[0]) - reach;
            double c[5] = {};
            for (std::ptrdiff_t row = 0; row < side; ++row)
                for (std::ptrdiff_t column = 0; column < side; ++column)
                    for (int k = 0; k < 5; ++k) c[k] += weights[k * area + row * side + column] * corner[row * width + column];
            const double determinant = 4 * c[0] * c[2] - c[1] * c[1];
            if (!(determinant < -1e-6)) continue;
            const double x = centre[0] + (c[1] * c[4] - 2 * c[2] * c[3]) / determinant;
            const double y = centre[1] + (c[1] * c[3] - 2 * c[0] * c[4]) / determinant;
            if (std::fabs(x - start[0]) <= reach && std::fabs(y - start[1]) <= reach) point[0] = x, point[1] = y;
        }
    }
}

template <typename Pixel>
void follow_edges(const Plane<Pixel>& plane, const Places& start, const Places& way, const Doubles& sign, const Doubles& contrast,
                  FlagsOut is_seen) {
    const std::size_t n = start.shape(0);
    require(way.shape(0) == n && sign.size() == n && contrast.size() == n && is_seen.size() == n, "the arrays' lengths do not match");
    const Sampler<Pixel> read(plane);
    const double *from = start.data(), *to = way.data(), *s = sign.data(), *c = contrast.data();
    bool* out = is_seen.data();
    nb::gil_scoped_release unlocked;
    for (std::size_t i = 0; i < n; ++i) out[i] = is_edge(read, from[2 * i], from[2 * i + 1], to[2 * i], to[2 * i + 1], s[i], c[i]);
}

// Points in square cells, some in each: those near a place lie in the cells around its own.
class PointCells {
  public:
    PointCells(const double* points, int n, double per_cell) : points_(points) {
        double low[2] = {std::numeric_limits<double>::infinity(), std::numeric_limits<double>::infinity()}, high[2] = {-low[0], -low[1]};
        std::vector<int> finite;
        for (int i = 0; i < n; ++i) {
            if (!std::isfinite(points[2 * i]) || !std::isfinite(points[2 * i + 1])) continue;
            finite.push_back(i);
            for (int k : {0, 1}) low[k] = std::min(low[k], points[2 * i + k]), high[k] = std::max(high[k], points[2 * i + k]);
        }
        if (finite.empty()) return;
        const double width = high[0] - low[0], height = high[1] - low[1];
        // Along a line there are as many cells as points at most.
        side_ = std::max({std::sqrt(width * height * per_cell / finite.size()), std::max(width, height) * per_cell / finite.size(), 1e-9});
        for (int k : {0, 1}) {
            const double count = (high[k] - low[k]) / side_;  // no number where the points are too far apart for one
            low_[k] = low[k], size_[k] = count < n ? static_cast<int>(count) + 1 : 1;
        }
        first_.assign(static_cast<std::size_t>(size_[0]) * size_[1] + 1, 0);
        for (int i : finite) ++first_[index(i) + 1];
        for (std::size_t c = 1; c < first_.size(); ++c) first_[c] += first_[c - 1];
        members_.resize(finite.size());
        std::vector<int> next(first_.begin(), first_.end() - 1);
        for (int i : finite) members_[next[index(i)]++] = i;
    }

    // The nearest points to one of them, nearest first; returns how many there are, `most` at most.
    int nearest(int self, int most, int* out) {
        const double x = points_[2 * self], y = points_[2 * self + 1];
        const int column = cell(self, 0), row = cell(self, 1);
        for (int reach = 1;; ++reach) {
            const int left = std::max(column - reach, 0), right = std::min(column + reach, size_[0] - 1);
            const int above = std::max(row - reach, 0), below = std::min(row + reach, size_[1] - 1);
            keys_.clear();
            for (int r = above; r <= below; ++r)
                for (int k = first_[r * size_[0] + left]; k < first_[r * size_[0] + right + 1]; ++k) {
                    const int other = members_[k];
                    const double dx = points_[2 * other] - x, dy = points_[2 * other + 1] - y;
                    if (other != self) keys_.push_back({dx * dx + dy * dy, other});
                }
            const int count = std::min(most, static_cast<int>(keys_.size()));
            const bool is_all = left == 0 && above == 0 && right == size_[0] - 1 && below == size_[1] - 1;
            if (count < most && !is_all) continue;
            std::nth_element(keys_.begin(), keys_.begin() + count, keys_.end());
            std::sort(keys_.begin(), keys_.begin() + count);
            // Beyond the cells looked at there is none nearer than their border.
            if (!is_all) {
                double border = std::numeric_limits<double>::infinity();
                if (left > 0) border = std::min(border, x - (low_[0] + left * side_));
                if (above > 0) border = std::min(border, y - (low_[1] + above * side_));
                if (right < size_[0] - 1) border = std::min(border, low_[0] + (right + 1) * side_ - x);
                if (below < size_[1] - 1) border = std::min(border, low_[1] + (below + 1) * side_ - y);
                if (keys_[count - 1].first > border * border) continue;
            }
            for (int k = 0; k < count; ++k) out[k] = keys_[k].second;
            return count;
        }
    }

  private:
    int cell(int i, int axis) const {
        return size_[axis] == 1 ? 0 : std::min(static_cast<int>((points_[2 * i + axis] - low_[axis]) / side_), size_[axis] - 1);
    }
    std::size_t index(int i) const { return static_cast<std::size_t>(cell(i, 1)) * size_[0] + cell(i, 0); }

    const double* points_;
    double low_[2] = {0, 0}, side_ = 1;
    int size_[2] = {0, 0};
    std::vector<int> first_, members_;
    std::vector<std::pair<double, int>> keys_;
};

// The nearest points to each point, nearest first, -1 where there are no more. Points that are no numbers have none and are none's.
template <int kNearest>
std::vector<std::array<int, kNearest>> find_nearest(const double* points, int n_points) {
    std::vector<std::array<int, kNearest>> nearest(n_points);
    PointCells cells(points, n_points, kNearest / 3.0);
    for (int i = 0; i < n_points; ++i) {
        nearest[i].fill(-1);
        if (std::isfinite(points[2 * i]) && std::isfinite(points[2 * i + 1])) cells.nearest(i, kNearest, nearest[i].data());
    }
    return nearest;
}

struct Corners {
    const double *points, *rays, *contrast;
    std::vector<std::array<double, 8>> directions;  // cosine and sine of each ray
    int n;
};

// The ray nearest to a way of that length, and the cosine of the turn to it.
int nearest_ray(const std::array<double, 8>& direction, double x, double y, double length, double& cosine) {
    int best = 0;
    double most = -2 * length;
    for (int k = 0; k < 4; ++k) {
        const double along = direction[2 * k] * x + direction[2 * k + 1] * y;
        if (along > most) most = along, best = k;
    }
    cosine = most / std::max(length, 1e-12);
    return best;
}

// For each corner and ray the nearest neighbour along it that an edge leads to, and which of its rays points back.
// Corners of boards with markers have more neighbours to try, and edges that are read close by.
template <int kNearest, typename Pixel>
void link(const Sampler<Pixel>& read, const Corners& corners, double max_turn, bool has_dots, std::int64_t* neighbour, std::int64_t* back_ray) {
    const auto nearest = find_nearest<kNearest>(corners.points, corners.n);
    const double least_cosine = std::cos(max_turn);
    std::fill_n(neighbour, 4 * corners.n, -1);
    std::fill_n(back_ray, 4 * corners.n, -1);
    for (int i = 0; i < corners.n; ++i) {
        const double *at = corners.points + 2 * i, contrast = corners.contrast[i];
        for (int other : nearest[i]) {
            if (other < 0) break;
            const double x = corners.points[2 * other] - at[0], y = corners.points[2 * other + 1] - at[1];
            // sqrt is faster, and rounds otherwise.
            const double length = kNearest != kNeighbours ? std::sqrt(x * x + y * y) : std::hypot(x, y);
            double cosine, cosine_back;
            const int ray = nearest_ray(corners.directions[i], x, y, length, cosine);
            if (neighbour[4 * i + ray] >= 0) continue;
            const int back = nearest_ray(corners.directions[other], -x, -y, length, cosine_back);
            // The bright side of an edge is the same seen from both ends.
            if (!(std::min(cosine, cosine_back) > least_cosine) || ray % 2 == back % 2) continue;
            const double weaker = std::min(contrast, corners.contrast[other]);
            if (!(weaker > 0.15 * std::max(contrast, corners.contrast[other]))) continue;
            const double sign = ray % 2 ? -1.0 : 1.0;
            const bool is_linked = has_dots                  ? is_dotted_edge(read, at[0], at[1], x, y, sign, weaker)
                                   : kNearest != kNeighbours ? is_marker_edge(read, at[0], at[1], x, y, sign, weaker)
                                                             : is_edge(read, at[0], at[1], x, y, sign, weaker);
            if (!is_linked) continue;
            neighbour[4 * i + ray] = other;
            back_ray[4 * i + ray] = back;
        }
    }
    std::vector<std::int64_t> all(neighbour, neighbour + 4 * corners.n);
    for (std::int64_t i = 0; i < corners.n; ++i)  // mutual links only
        for (int ray = 0; ray < 4; ++ray)
            if (all[4 * i + ray] >= 0 && all[4 * all[4 * i + ray] + back_ray[4 * i + ray]] != i) neighbour[4 * i + ray] = -1;
}

// A group's corners by their cells.
class Cells {
  public:
    using Cell = std::array<std::int64_t, 2>;
    void clear() { entries_.clear(); }
    void put(Cell cell, std::int64_t corner) { entries_.insert(position(cell), {cell, corner}); }
    std::int64_t at(Cell cell) const {
        const auto found = position(cell);
        return found != entries_.end() && found->first == cell ? found->second : -1;
    }

  private:
    using Entry = std::pair<Cell, std::int64_t>;
    std::vector<Entry>::const_iterator position(const Cell& cell) const {
        return std::lower_bound(entries_.begin(), entries_.end(), cell, [](const Entry& entry, const Cell& c) { return entry.first < c; });
    }
    std::vector<Entry> entries_;  // sorted by cell
};

constexpr int kStep[4][2] = {{1, 0}, {0, 1}, {-1, 0}, {0, -1}};  // in the turning sense of the rays: x towards y

// Whether a corner lies where the row behind it and the rows beside it lead, to half a step. The border of a shadow looks like
// an edge and would lead to the corner diagonally ahead.
bool is_ahead(const double* points, const Cells& cells, const Cells::Cell& from, std::int64_t way, std::int64_t other) {
    const std::int64_t corner = cells.at(from);
    const double *p = points + 2 * corner, *q = points + 2 * other;
    auto agrees = [&](std::int64_t behind, std::int64_t ahead) {  // the step from behind to ahead is the step to be made
        if (behind < 0 || ahead < 0) return true;
        const double x = points[2 * ahead] - points[2 * behind], y = points[2 * ahead + 1] - points[2 * behind + 1];
        return std::hypot(q[0] - p[0] - x, q[1] - p[1] - y) <= 0.5 * std::hypot(x, y);
    };
    const std::int64_t dx = kStep[way][0], dy = kStep[way][1];
    return agrees(cells.at({from[0] - dx, from[1] - dy}), corner) &&
           agrees(cells.at({from[0] - dy, from[1] + dx}), cells.at({from[0] + dx - dy, from[1] + dy + dx})) &&
           agrees(cells.at({from[0] + dy, from[1] - dx}), cells.at({from[0] + dx + dy, from[1] + dy - dx}));
}

// Connected corners with integer cells (column, row) and the turn of their rays, seed first, group after group. A corner
// whose links disagree is left out. Returns how many entries of members, cells, turns and groups were written.
std::size_t grow(const double* points, const std::int64_t* neighbour, const std::int64_t* back_ray, int n, std::int64_t* members,
                 std::int64_t* cells, std::int64_t* turns, std::int64_t* groups) {
    std::vector<int> degree(n), order(n);
    for (int i = 0; i < n; ++i) degree[i] = static_cast<int>(std::count_if(neighbour + 4 * i, neighbour + 4 * i + 4, [](auto o) { return o >= 0; }));
    std::iota(order.begin(), order.end(), 0);
    std::stable_sort(order.begin(), order.end(), [&](int a, int b) { return degree[a] > degree[b]; });
    std::vector<char> seen(n, 0);
    Cells taken;
    std::size_t count = 0;
    std::int64_t group = 0;
    for (int seed : order) {
        if (seen[seed] || degree[seed] < 2) continue;
        taken.clear();
        auto place = [&](std::int64_t corner, const Cells::Cell& cell, std::int64_t turn) {
            seen[corner] = 1;
            taken.put(cell, corner);
            members[count] = corner, cells[2 * count] = cell[0], cells[2 * count + 1] = cell[1], turns[count] = turn, groups[count] = group;
            ++count;
        };
        std::size_t next = count;
        place(seed, {0, 0}, 0);
        for (; next < count; ++next) {
            const std::int64_t corner = members[next];
            const Cells::Cell from{cells[2 * next], cells[2 * next + 1]};
            for (int ray = 0; ray < 4; ++ray) {
                const std::int64_t other = neighbour[4 * corner + ray], way = (ray + turns[next]) % 4;
                if (other < 0 || seen[other]) continue;
                const Cells::Cell cell{from[0] + kStep[way][0], from[1] + kStep[way][1]};
                if (taken.at(cell) >= 0 || !is_ahead(points, taken, from, way, other)) continue;
                place(other, cell, (way + 6 - back_ray[4 * corner + ray]) % 4);
            }
        }
        ++group;
    }
    return count;
}

template <typename Pixel>
void link_corners(const Plane<Pixel>& plane, const Places& points, const Doubles& rays, const Doubles& contrast, double max_turn,
                  bool has_markers, bool is_oblique, bool has_dots, IndicesOut neighbour, IndicesOut back_ray) {
    const std::size_t n = points.shape(0);
    require(rays.size() == 4 * n && contrast.size() == n && neighbour.size() == 4 * n && back_ray.size() == 4 * n, "the arrays' lengths do not match");
    Corners corners{points.data(), rays.data(), contrast.data(), {}, static_cast<int>(n)};
    const Sampler<Pixel> read(plane);
    std::int64_t *to = neighbour.data(), *back = back_ray.data();
    nb::gil_scoped_release unlocked;
    corners.directions.resize(n);
    for (std::size_t i = 0; i < n; ++i)
        for (int k = 0; k < 4; ++k) {
            corners.directions[i][2 * k] = std::cos(corners.rays[4 * i + k]);
            corners.directions[i][2 * k + 1] = std::sin(corners.rays[4 * i + k]);
        }
    if (has_markers && is_oblique) link<kNeighboursOblique>(read, corners, max_turn, has_dots, to, back);
    else if (has_markers) link<kNeighboursOfMarkers>(read, corners, max_turn, has_dots, to, back);
    else link<kNeighbours>(read, corners, max_turn, has_dots, to, back);
}

std::size_t grow_groups(const Places& points, const IndicesIn& neighbour, const IndicesIn& back_ray, IndicesOut members, IndicesOut cells, IndicesOut turns,
                        IndicesOut groups) {
    const std::size_t n = members.size();
    require(points.shape(0) == n && neighbour.size() == 4 * n && back_ray.size() == 4 * n && cells.size() == 2 * n && turns.size() == n && groups.size() == n, "the arrays' lengths do not match");
    const std::int64_t *to = neighbour.data(), *back = back_ray.data();
    for (std::size_t i = 0; i < 4 * n; ++i)
        require(to[i] < static_cast<std::int64_t>(n) && (to[i] < 0 || (back[i] >= 0 && back[i] < 4)), "the arrays' lengths do not match");
    std::int64_t *m = members.data(), *c = cells.data(), *t = turns.data(), *g = groups.data();
    const double* at = points.data();
    nb::gil_scoped_release unlocked;
    return grow(at, to, back, static_cast<int>(n), m, c, t, g);
}

template <typename Pixel>
void register_for(nb::module_& module) {
    module.def("sample", &sample<Pixel>);
    module.def("read_rings", &read_rings<Pixel>);
    module.def("localize_saddles", &localize_saddles<Pixel>);
    module.def("follow_edges", &follow_edges<Pixel>);
    module.def("link_corners", &link_corners<Pixel>);
}

}  // namespace

void register_xcorners(nb::module_& module) {
    register_for<std::uint8_t>(module);
    register_for<float>(module);
    module.def("grow_groups", &grow_groups);
}

}  // namespace binocal
