// Lattices of plain points: the neighbours of each point, and growth from one of them, ring by ring, as a lens bends the lattice.
#include "kernel.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numeric>

namespace binocal {
namespace {

using IndicesOut = nb::ndarray<std::int64_t, nb::device::cpu, nb::c_contig>;
using Points = nb::ndarray<const double, nb::shape<-1, 2>, nb::device::cpu, nb::c_contig>;

constexpr double kInfinity = std::numeric_limits<double>::infinity();

struct Vector {
    double x = std::numeric_limits<double>::quiet_NaN(), y = std::numeric_limits<double>::quiet_NaN();
    bool is_known() const { return std::isfinite(x); }
    double length() const { return std::hypot(x, y); }
};
inline Vector operator+(Vector a, Vector b) { return {a.x + b.x, a.y + b.y}; }
inline Vector operator-(Vector a, Vector b) { return {a.x - b.x, a.y - b.y}; }
inline Vector operator*(double k, Vector a) { return {k * a.x, k * a.y}; }

// Points in the order of x, so that those about a place are near one another.
class SortedPoints {
  public:
    SortedPoints(const double* points, std::size_t n) : points_(points), order_(n) {
        std::iota(order_.begin(), order_.end(), 0);
        std::stable_sort(order_.begin(), order_.end(), [&](std::int64_t a, std::int64_t b) { return points[2 * a] < points[2 * b]; });
    }
    std::int64_t at(std::size_t rank) const { return order_[rank]; }
    std::size_t size() const { return order_.size(); }
    Vector point(std::int64_t index) const { return {points_[2 * index], points_[2 * index + 1]}; }
    std::size_t first_from(double x) const {
        return static_cast<std::size_t>(std::lower_bound(order_.begin(), order_.end(), x, [&](std::int64_t index, double value) { return points_[2 * index] < value; }) -
                                        order_.begin());
    }

  private:
    const double* points_;
    std::vector<std::int64_t> order_;
};

bool are_finite(const double* values, std::size_t n) {
    return std::all_of(values, values + n, [](double value) { return std::isfinite(value); });
}

// The k nearest other points of each, the nearest first, their distances, and how unlike the step to each is to the most opposite of the
// steps to the others, over its length.
void find_nearest(const Points& points, IndicesOut near, DoublesOut distance, DoublesOut unlike) {
    const std::size_t n = points.shape(0), k = n ? near.size() / n : 0;
    require(near.size() == n * k && distance.size() == n * k && unlike.size() == n * k && (k < n || !n), "the arrays' lengths do not match");
    require(are_finite(points.data(), 2 * n), "points are finite");
    const double* at = points.data();
    std::int64_t* neighbours = near.data();
    double *lengths = distance.data(), *odd = unlike.data();
    nb::gil_scoped_release unlocked;
    const SortedPoints sorted(at, n);
    std::vector<std::pair<double, std::int64_t>> best;
    for (std::size_t rank = 0; rank < n; ++rank) {
        const std::int64_t i = sorted.at(rank);
        const Vector p = sorted.point(i);
        best.clear();
        auto consider = [&](std::size_t other) {  // false where all that follow are farther off
            const std::int64_t j = sorted.at(other);
            const Vector way = sorted.point(j) - p;
            const bool is_full = best.size() == k;
            if (is_full && way.x * way.x > best.back().first) return false;
            const std::pair<double, std::int64_t> found{way.x * way.x + way.y * way.y, j};
            if (is_full && !(found < best.back())) return true;
            if (is_full) best.pop_back();
            best.insert(std::upper_bound(best.begin(), best.end(), found), found);
            return true;
        };
        for (std::size_t left = rank, right = rank + 1; k && (left > 0 || right < n);) {
            if (left > 0) left = consider(left - 1) ? left - 1 : 0;
            if (right < n) right = consider(right) ? right + 1 : n;
        }
        for (std::size_t a = 0; a < k; ++a) {
            const Vector way = sorted.point(best[a].second) - p;
            double least = kInfinity;
            for (std::size_t b = 0; b < k; ++b) least = std::min(least, (way + (sorted.point(best[b].second) - p)).length());
            neighbours[i * k + a] = best[a].second, lengths[i * k + a] = std::sqrt(best[a].first);
            odd[i * k + a] = least / lengths[i * k + a];
        }
    }
}

struct GrowthLimits {
    double most_error, sure_error;  // of the step, between where a neighbour should be and where it is
    double most_log_ratio;          // between a spot's size and those about it
};

constexpr int kAlong[4][2] = {{1, 0}, {-1, 0}, {0, 1}, {0, -1}};

// Cells about a seed with room beyond them: which point each holds, -1 where none.
class Canvas {
  public:
    Canvas(const double* points, const double* sizes, std::int64_t seed) : points_(points), sizes_(sizes), place_(kStart * kStart, -1), side_(kStart) {
        put({kStart / 2, kStart / 2}, seed);
    }
    using Cell = std::array<int, 2>;  // row and column

    struct Place {
        Cell cell;
        Vector expected;
        double step, size;
    };

    void put(Cell cell, std::int64_t index) {
        place_[static_cast<std::size_t>(cell[0]) * side_ + cell[1]] = index;
        for (int k : {0, 1}) low_[k] = n ? std::min(low_[k], cell[k]) : cell[k], high_[k] = n ? std::max(high_[k], cell[k]) : cell[k];
        if (!n) origin_ = cell;
        ++n;
    }

    // Empty cells beside taken ones in reading order, and where their points should be by what is known about each.
    void expect(const Vector* basis, std::vector<Place>& places) {
        if (std::min(low_[0], low_[1]) < kApron || std::max(high_[0], high_[1]) >= side_ - kApron) widen();
        places.clear();
        for (int row = low_[0] - 1; row <= high_[0] + 1; ++row)
            for (int column = low_[1] - 1; column <= high_[1] + 1; ++column) {
                if (at(row, column) >= 0) continue;
                if (at(row + 1, column) < 0 && at(row - 1, column) < 0 && at(row, column + 1) < 0 && at(row, column - 1) < 0) continue;
                Place place{{row, column}, {}, 0, 0};
                if (look_from_each_side(place, basis)) places.push_back(place);
            }
    }

    // What it holds in reading order, in cells from the seed.
    void write(std::int64_t* members, std::int64_t* cells) const {
        for (int row = low_[0]; row <= high_[0]; ++row)
            for (int column = low_[1]; column <= high_[1]; ++column)
                if (at(row, column) >= 0) *members++ = at(row, column), *cells++ = row - origin_[0], *cells++ = column - origin_[1];
    }

    std::size_t n = 0;

  private:
    static constexpr int kStart = 64, kApron = 4;

    std::int64_t at(int row, int column) const { return place_[static_cast<std::size_t>(row) * side_ + column]; }
    Vector point(int row, int column) const {
        const std::int64_t index = at(row, column);
        return index < 0 ? Vector{} : Vector{points_[2 * index], points_[2 * index + 1]};
    }

    // By the neighbour on each side: the step before, changed as the steps change along the line, else as beside it, else the basis's;
    // what more is known of has more weight.
    bool look_from_each_side(Place& place, const Vector* basis) const {
        double total = 0, step_sum = 0, size_sum = 0;
        Vector sum{0, 0};
        int n_sides = 0;
        for (int side = 0; side < 4; ++side) {
            const int dr = kAlong[side][0], dc = kAlong[side][1], ar = std::abs(dc), ac = std::abs(dr);
            auto look = [&](int i, int j) { return point(place.cell[0] - i * dr + j * ar, place.cell[1] - i * dc + j * ac); };
            const Vector first = look(1, 0);
            if (!first.is_known()) continue;
            const Vector second = look(2, 0), behind = first - second;
            Vector step;
            double weight = 1e-3;
            if (basis) step = (side % 2 ? -1.0 : 1.0) * basis[side / 2];
            auto improve = [&](Vector other, double worth) {
                if (other.is_known() && weight < worth) step = other, weight = worth;
            };
            improve(behind, 1);
            improve(2 * behind - (second - look(3, 0)), 2);
            for (int beside : {1, -1}) {  // the same step in the lines beside it
                const Vector here = look(1, beside), along = look(0, beside) - here;
                improve(along, 1);
                improve(behind + (along - (here - look(2, beside))), 3);
            }
            if (!step.is_known()) continue;
            sum = sum + weight * (first + step), total += weight;
            step_sum += step.length(), size_sum += sizes_[at(place.cell[0] - dr, place.cell[1] - dc)], ++n_sides;
        }
        if (!n_sides) return false;
        place.expected = (1 / total) * sum, place.step = std::max(step_sum / n_sides, 1e-9), place.size = size_sum / n_sides;
        return true;
    }

    void widen() {
        const int room = side_ / 2, side = 2 * side_;
        std::vector<std::int64_t> wide(static_cast<std::size_t>(side) * side, -1);
        for (int row = 0; row < side_; ++row)
            std::copy_n(place_.begin() + static_cast<std::ptrdiff_t>(row) * side_, side_, wide.begin() + static_cast<std::ptrdiff_t>(row + room) * side + room);
        place_.swap(wide), side_ = side;
        for (int k : {0, 1}) low_[k] += room, high_[k] += room, origin_[k] += room;
    }

    const double *points_, *sizes_;
    std::vector<std::int64_t> place_;
    int side_;
    Cell low_{}, high_{}, origin_{};
};

// The lattice reached from a seed, one ring of cells a round, each from all that is known about it; the surest first. Returns how many
// points it has: members, and their cells in the lattice's own basis.
std::size_t grow_lattice(const Points& points, const Doubles& log_sizes, const Flags& is_free, std::int64_t seed, const Doubles& basis, double most_error,
                         double sure_error, double most_log_ratio, IndicesOut members, IndicesOut cells) {
    const std::size_t n = points.shape(0);
    require(log_sizes.size() == n && is_free.size() == n && basis.size() == 4 && members.size() == n && cells.size() == 2 * n, "the arrays' lengths do not match");
    require(are_finite(points.data(), 2 * n), "points are finite");
    require(seed >= 0 && static_cast<std::size_t>(seed) < n, "the seed is one of the points");
    const GrowthLimits limits{most_error, sure_error, most_log_ratio};
    const double *at = points.data(), *sizes = log_sizes.data();
    const Vector steps[2] = {{basis.data()[0], basis.data()[1]}, {basis.data()[2], basis.data()[3]}};
    const bool* free = is_free.data();
    std::int64_t *members_out = members.data(), *cells_out = cells.data();
    nb::gil_scoped_release unlocked;
    std::vector<char> is_left(free, free + n);
    is_left[seed] = 0;
    const SortedPoints sorted(at, n);
    Canvas canvas(at, sizes, seed);
    std::vector<Canvas::Place> places;
    struct Found {
        double off;
        std::int64_t index;
        std::size_t place;
    };
    std::vector<Found> found;
    for (;;) {
        canvas.expect(canvas.n == 1 ? steps : nullptr, places);  // the seed's own steps hold about the seed alone
        found.clear();
        bool is_any_sure = false;
        for (std::size_t k = 0; k < places.size(); ++k) {
            const Canvas::Place& place = places[k];
            const double reach = limits.most_error * place.step;
            double best = reach * reach;
            std::int64_t nearest = -1;
            for (std::size_t rank = sorted.first_from(place.expected.x - reach); rank < n; ++rank) {
                const std::int64_t index = sorted.at(rank);
                const Vector off = sorted.point(index) - place.expected;
                if (off.x > reach) break;
                const double squared = off.x * off.x + off.y * off.y;
                if (is_left[index] && squared < best) best = squared, nearest = index;
            }
            if (nearest < 0 || !(std::fabs(sizes[nearest] - place.size) < limits.most_log_ratio)) continue;
            const double off = std::sqrt(best) / place.step;
            is_any_sure = is_any_sure || off < limits.sure_error;
            found.push_back({off, nearest, k});
        }
        if (found.empty()) break;
        std::stable_sort(found.begin(), found.end(), [](const Found& a, const Found& b) { return a.off < b.off; });
        for (const Found& one : found) {
            if (is_any_sure && !(one.off < limits.sure_error)) break;
            if (!is_left[one.index]) continue;
            canvas.put(places[one.place].cell, one.index);
            is_left[one.index] = 0;
        }
    }
    canvas.write(members_out, cells_out);
    return canvas.n;
}

}  // namespace

void register_point_lattice(nb::module_& module) {
    module.def("find_nearest", &find_nearest);
    module.def("grow_point_lattice", &grow_lattice);
}

}  // namespace binocal
