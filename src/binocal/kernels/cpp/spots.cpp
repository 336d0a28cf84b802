// Components of what is darker than its surroundings, with the moments of each: runs of pixels, joined from row to row.
#include "kernel.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace binocal {
namespace {

using BytePlane = nb::ndarray<const std::uint8_t, nb::ndim<2>, nb::device::cpu, nb::c_contig>;

struct Run {
    std::int32_t first, behind;  // columns: the run's first, and the one behind its last
    std::int32_t parent;         // an earlier run of its component, or itself; then the component
};

struct Component {
    std::int64_t n = 0, x = 0, y = 0, xx = 0, yy = 0, xy = 0;  // sums over its pixels
    std::int32_t left = std::numeric_limits<std::int32_t>::max(), right = -1, top = 0, bottom = -1;
};

class Components {
  public:
    Components(std::ptrdiff_t height, std::ptrdiff_t width) : height_(height), width_(width), first_of_row_(height + 1), changes_(width + 9), places_(width + 9) {}

    // Pixels more than `below` below the mean of what is around them.
    void read(const std::uint8_t* image, const std::uint8_t* around, int below) {
        for (std::ptrdiff_t y = 0; y < height_; ++y) {
            first_of_row_[y] = static_cast<std::int32_t>(runs_.size());
            add_row(image + y * width_, around + y * width_, below);
            if (y) join(first_of_row_[y - 1], first_of_row_[y], static_cast<std::int32_t>(runs_.size()));
        }
        first_of_row_[height_] = static_cast<std::int32_t>(runs_.size());
        measure();
    }

    const std::vector<Component>& all() const { return components_; }

    bool holds(std::size_t component, std::ptrdiff_t x, std::ptrdiff_t y) const {
        const auto first = runs_.begin() + first_of_row_[y], last = runs_.begin() + first_of_row_[y + 1];
        const auto behind = std::upper_bound(first, last, x, [](std::ptrdiff_t column, const Run& run) { return column < run.first; });
        if (behind == first) return false;
        const Run& run = *(behind - 1);
        return x < run.behind && static_cast<std::size_t>(run.parent) == component;
    }

  private:
    void add_row(const std::uint8_t* image, const std::uint8_t* around, int below) {
        std::uint8_t* changes = changes_.data();
        for (std::ptrdiff_t x = 0; x < width_; ++x) changes[x] = image[x] + below < around[x];
        changes[width_] = 0;
        std::uint8_t before = 0;
        std::int32_t* place = places_.data();
        // Where the row changes between inside and outside, without a branch for each pixel.
        for (std::ptrdiff_t x = 0; x <= width_; ++x) {
            const std::uint8_t now = changes[x];
            *place = static_cast<std::int32_t>(x);
            place += now ^ before;
            before = now;
        }
        for (const std::int32_t* at = places_.data(); at < place; at += 2) {
            const auto number = static_cast<std::int32_t>(runs_.size());
            runs_.push_back({at[0], at[1], number});
        }
    }

    std::int32_t root(std::int32_t run) {
        while (runs_[run].parent != run) run = runs_[run].parent = runs_[runs_[run].parent].parent;
        return run;
    }

    // Runs of two rows that share a column are of one component; its root is its earliest run.
    void join(std::int32_t above, std::int32_t row, std::int32_t end) {
        const std::int32_t end_above = row;
        for (std::int32_t run = row; run < end; ++run) {
            while (above < end_above && runs_[above].behind <= runs_[run].first) ++above;
            for (std::int32_t other = above; other < end_above && runs_[other].first < runs_[run].behind; ++other) {
                const std::int32_t a = root(other), b = root(run);
                runs_[std::max(a, b)].parent = std::min(a, b);
            }
        }
    }

    void measure() {
        auto squares = [](std::int64_t n) { return (n - 1) * n * (2 * n - 1) / 6; };  // of the whole numbers below n
        for (std::ptrdiff_t y = 0; y < height_; ++y)
            for (std::int32_t i = first_of_row_[y]; i < first_of_row_[y + 1]; ++i) {
                Run& run = runs_[i];
                if (run.parent == i) {
                    run.parent = static_cast<std::int32_t>(components_.size());
                    components_.emplace_back().top = static_cast<std::int32_t>(y);
                } else {
                    run.parent = runs_[run.parent].parent;  // an earlier run's, which is the component by now
                }
                Component& c = components_[run.parent];
                const std::int64_t n = run.behind - run.first, x = n * (run.first + run.behind - 1) / 2;
                c.n += n, c.x += x, c.y += n * y, c.yy += n * y * y, c.xy += x * y, c.xx += squares(run.behind) - squares(run.first);
                c.left = std::min(c.left, run.first), c.right = std::max(c.right, run.behind - 1), c.bottom = static_cast<std::int32_t>(y);
            }
    }

    std::ptrdiff_t height_, width_;
    std::vector<std::int32_t> first_of_row_;
    std::vector<std::uint8_t> changes_;
    std::vector<std::int32_t> places_;
    std::vector<Run> runs_;
    std::vector<Component> components_;
};

constexpr std::size_t kSpotSize = 9;  // doubles: area, width, height, mean x and y, second moments xx, yy, xy about it, whether the mean lies in it

// Components that do not touch the border, of at least `least_area` pixels and narrower and lower than `most_side`, in reading
// order of their first pixels. Returns how many there are; those that the records have no room for are not written.
std::size_t find_spots(const BytePlane& image, const BytePlane& around, int below, int least_area, double most_side, DoublesOut records) {
    const auto height = static_cast<std::ptrdiff_t>(image.shape(0)), width = static_cast<std::ptrdiff_t>(image.shape(1));
    require(around.shape(0) == image.shape(0) && around.shape(1) == image.shape(1) && records.size() % kSpotSize == 0, "the arrays' shapes do not match");
    require(image.size() < static_cast<std::size_t>(std::numeric_limits<std::int32_t>::max()), "the image is too large");
    const std::uint8_t *pixels = image.data(), *means = around.data();
    double* out = records.data();
    const std::size_t room = records.size() / kSpotSize;
    nb::gil_scoped_release unlocked;
    Components components(height, width);
    components.read(pixels, means, below);
    std::size_t count = 0;
    for (std::size_t i = 0; i < components.all().size(); ++i) {
        const Component& c = components.all()[i];
        const std::int32_t wide = c.right - c.left + 1, high = c.bottom - c.top + 1;
        if (c.n < least_area || !(std::max(wide, high) < most_side)) continue;
        if (c.left == 0 || c.top == 0 || c.right == width - 1 || c.bottom == height - 1) continue;
        if (count++ >= room) continue;
        const auto n = static_cast<double>(c.n);
        const double x = c.x / n, y = c.y / n;
        const bool is_held = components.holds(i, static_cast<std::ptrdiff_t>(std::nearbyint(x)), static_cast<std::ptrdiff_t>(std::nearbyint(y)));
        const double record[kSpotSize] = {n, static_cast<double>(wide), static_cast<double>(high), x, y, c.xx / n - x * x, c.yy / n - y * y, c.xy / n - x * y, is_held ? 1.0 : 0.0};
        std::copy(record, record + kSpotSize, out);
        out += kSpotSize;
    }
    return count;
}

}  // namespace

void register_spots(nb::module_& module) {
    module.attr("SPOT_SIZE") = kSpotSize;
    module.def("find_spots", &find_spots);
}

}  // namespace binocal
