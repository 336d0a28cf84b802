// The faces of a net of linked X-corners, what is printed in them, and which of their readings fit one board. What each
// decides and why stands in binocal/detection/finding; here are only the loops.
#include "lens_plane.hpp"
#include "sampler.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numeric>

namespace binocal {
namespace {

using Numbers = nb::ndarray<const std::int64_t, nb::device::cpu, nb::c_contig>;
using NumbersOut = nb::ndarray<std::int64_t, nb::device::cpu, nb::c_contig>;
using FloatsOut = nb::ndarray<float, nb::device::cpu, nb::c_contig>;

constexpr char kLengths[] = "the arrays' lengths do not match";

// Closed ways over four links, each with the face on the side of larger angles: corners clockwise on the screen. `parity` is that
// of the first corner's ray: 0 where the face is bright. Returns how many.
std::size_t find_faces(const Numbers& neighbour, const Numbers& back_ray, NumbersOut faces, NumbersOut parity) {
    const std::size_t n = neighbour.size() / 4, most = faces.size() / 4;
    require(neighbour.size() == 4 * n && back_ray.size() == 4 * n && parity.size() == most, kLengths);
    const std::int64_t *to = neighbour.data(), *back = back_ray.data();
    for (std::size_t i = 0; i < 4 * n; ++i)
        require(to[i] < static_cast<std::int64_t>(n) && (to[i] < 0 || (back[i] >= 0 && back[i] < 4)), kLengths);
    std::int64_t *out = faces.data(), *colour = parity.data();
    nb::gil_scoped_release unlocked;
    std::size_t count = 0;
    for (std::size_t first = 0; first < n; ++first)
        for (std::int64_t start = 0; start < 4; ++start) {
            std::int64_t corner = static_cast<std::int64_t>(first), ray = start, members[4];
            int steps = 0;
            for (; steps < 4; ++steps) {
                members[steps] = corner;
                const std::int64_t link = 4 * corner + ray;
                if (to[link] < 0) break;
                corner = to[link];
                ray = (back[link] + 3) % 4;
            }
            // Each face is met four times: it is kept where its first corner is the least.
            if (steps < 4 || corner != members[0] || ray != start || count == most) continue;
            if (*std::min_element(members, members + 4) != members[0] || members[1] == members[3]) continue;
            std::copy_n(members, 4, out + 4 * count);
            colour[count++] = start % 2;
        }
    return count;
}

// Mean grey value of each cell in each face: `places` are `per_cell` points a cell, in the face's unit square.
template <typename Pixel>
void read_cells(const Plane<Pixel>& image, const Doubles& quads, const Doubles& places, std::size_t per_cell, double cx, double cy, double f,
                FloatsOut values) {
    const std::size_t n = quads.size() / 8;
    require(per_cell > 0 && quads.size() == 8 * n && places.size() % (2 * per_cell) == 0, kLengths);
    const std::size_t n_cells = places.size() / (2 * per_cell);
    require(values.size() == n * n_cells, kLengths);
    const Sampler<Pixel> read(image);
    const double *quad = quads.data(), *place = places.data();
    float* out = values.data();
    nb::gil_scoped_release unlocked;
    for (std::size_t i = 0; i < n; ++i, quad += 8) {
        const Face face({cx, cy, f}, quad);
        for (std::size_t cell = 0; cell < n_cells; ++cell, ++out) {
            float sum = 0;
            for (std::size_t k = 0; face.is_good && k < per_cell; ++k) {
                const double* at = place + 2 * (cell * per_cell + k);
                Point pixel;
                if (face({at[0], at[1]}, pixel)) sum += read(pixel[0], pixel[1]);
            }
            *out = sum / static_cast<float>(per_cell);
        }
    }
}

struct Tag {
    const double *quad, *place;  // corners in the image and, by its reading, on the board
    Point middle;                // on the board
    double side_px;
};

// Whether a's corners put b's where they are, to `base` + `per_pitch` distance, in sides of b.
bool puts(const Tag& a, const Face& face, const Tag& b, double base, double per_pitch, double distance) {
    const double ux = a.place[2] - a.place[0], uy = a.place[3] - a.place[1], vx = a.place[6] - a.place[0], vy = a.place[7] - a.place[1];
    const double uu = ux * ux + uy * uy, vv = vx * vx + vy * vy, limit = (base + per_pitch * distance) * b.side_px;
    for (int k = 0; k < 4; ++k) {
        const double x = b.place[2 * k] - a.place[0], y = b.place[2 * k + 1] - a.place[1];
        Point pixel;
        if (!face({(x * ux + y * uy) / uu, (x * vx + y * vy) / vv}, pixel)) return false;
        if (!(std::hypot(pixel[0] - b.quad[2 * k], pixel[1] - b.quad[2 * k + 1]) < limit)) return false;
    }
    return true;
}

// Groups of readings that fit one board: `places` are the faces' corners on the board by their readings, in units of `pitch`.
// Writes each reading's group and how many of those within `reach` pitches agree and disagree with it.
void vote_on_tags(const Doubles& quads, const Doubles& places, double cx, double cy, double f, double pitch, double reach, NumbersOut groups,
                  NumbersOut agreeing, NumbersOut disagreeing) {
    const std::size_t n = groups.size();
    require(quads.size() == 8 * n && places.size() == 8 * n && agreeing.size() == n && disagreeing.size() == n, kLengths);
    const Lens lens{cx, cy, f};
    std::int64_t *group = groups.data(), *yes = agreeing.data(), *no = disagreeing.data();
    const double *quad = quads.data(), *place = places.data();
    nb::gil_scoped_release unlocked;
    std::vector<Tag> tags(n);
    std::vector<Face> faces;
    faces.reserve(n);
    for (std::size_t i = 0; i < n; ++i) {
        const double *q = quad + 8 * i, *p = place + 8 * i;
        const double area = 0.5 * std::fabs((q[4] - q[0]) * (q[7] - q[3]) - (q[5] - q[1]) * (q[6] - q[2]));
        tags[i] = {q, p, {(p[0] + p[4]) / 2, (p[1] + p[5]) / 2}, std::sqrt(area)};
        faces.emplace_back(lens, q);
    }
    std::vector<std::size_t> parent(n);
    std::iota(parent.begin(), parent.end(), std::size_t{0});
    auto root = [&](std::size_t i) {
        while (parent[i] != i) i = parent[i] = parent[parent[i]];
        return i;
    };
    std::fill_n(yes, n, 0);
    std::fill_n(no, n, 0);
    for (std::size_t i = 0; i < n; ++i)
        for (std::size_t j = i + 1; j < n; ++j) {
            const double distance = std::hypot(tags[i].middle[0] - tags[j].middle[0], tags[i].middle[1] - tags[j].middle[1]) / pitch;
            if (!(distance < reach)) continue;
            // Two faces at one place of the board contradict each other.
            const bool agrees = distance > 0.1 && ((faces[i].is_good && puts(tags[i], faces[i], tags[j], 0.2, 0.15, distance)) ||
                                                   (faces[j].is_good && puts(tags[j], faces[j], tags[i], 0.2, 0.15, distance)));
            ++(agrees ? yes : no)[i];
            ++(agrees ? yes : no)[j];
            if (agrees) parent[root(i)] = root(j);
        }
    for (std::size_t i = 0; i < n; ++i) group[i] = static_cast<std::int64_t>(root(i));
}

}  // namespace

void register_marker_cells(nb::module_& module) {
    module.def("find_faces", &find_faces);
    module.def("read_cells", &read_cells<std::uint8_t>);
    module.def("read_cells", &read_cells<float>);
    module.def("vote_on_tags", &vote_on_tags);
}

}  // namespace binocal
