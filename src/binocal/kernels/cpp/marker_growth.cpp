// A lattice of X-corners grown from the corners that markers name: each next corner is looked for where those around it put it.
// What it decides and why stands in binocal/detection/finding/marker_growth.py; here are only the loops.
#include "lens_plane.hpp"
#include "sampler.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>

namespace binocal {
namespace {

using FlagsInOut = nb::ndarray<bool, nb::device::cpu, nb::c_contig>;

constexpr int kNearest = 12;         // known corners that a prediction rests on
constexpr double kReachPitch = 1.6;  // sigma of their weights
constexpr double kPerspectiveRidge = 1e-4, kBendRidge = 0.1;
constexpr int kTried = 3;  // candidates about a prediction
constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

// Solves A x = b for a symmetric positive matrix and several right-hand sides, in place. False where it is not positive.
template <int n, int m>
bool solve(double (&A)[n][n], double (&b)[n][m]) {
    for (int i = 0; i < n; ++i) {
        for (int j = 0; j <= i; ++j) {
            double sum = A[i][j];
            for (int k = 0; k < j; ++k) sum -= A[i][k] * A[j][k];
            if (i == j) {
                if (!(sum > 1e-12 * (std::fabs(A[i][i]) + 1e-12))) return false;
                A[i][i] = std::sqrt(sum);
            } else {
                A[i][j] = sum / A[j][j];
            }
        }
    }
    for (int c = 0; c < m; ++c) {
        for (int i = 0; i < n; ++i) {
            for (int k = 0; k < i; ++k) b[i][c] -= A[i][k] * b[k][c];
            b[i][c] /= A[i][i];
        }
        for (int i = n - 1; i >= 0; --i) {
            for (int k = i + 1; k < n; ++k) b[i][c] -= A[k][i] * b[k][c];
            b[i][c] /= A[i][i];
        }
    }
    return true;
}

// The board about one of its places: a homography and a bend, through a lens.
struct LocalMap {
    LocalPlane plane;
    Homography H;
    double bend[3][2];  // of x^2, xy, y^2
    Point origin;       // on the board
    double scale;       // of the board's unit

    bool operator()(const Point& on_board, Point& pixel) const {
        const double x = (on_board[0] - origin[0]) / scale, y = (on_board[1] - origin[1]) / scale;
        Point place;
        if (!H({x, y}, place)) return false;
        for (int k = 0; k < 2; ++k) place[k] += bend[0][k] * x * x + bend[1][k] * x * y + bend[2][k] * y * y;
        pixel = plane.to_pixel(place);
        return std::isfinite(pixel[0]) && std::isfinite(pixel[1]);
    }
};

class Board {
  public:
    Board(const Doubles& x, const Doubles& y, double pitch, const Lens& lens, double* known, const double* trust = nullptr)
        : x_(x.data()), y_(y.data()), columns_(static_cast<int>(x.size())), rows_(static_cast<int>(y.size())), pitch_(pitch), lens_(lens), known_(known), trust_(trust) {}

    int columns() const { return columns_; }
    int rows() const { return rows_; }
    bool is_known(int column, int row) const {
        return column >= 0 && column < columns_ && row >= 0 && row < rows_ && std::isfinite(known_[2 * (row * columns_ + column)]);
    }
    double* at(int column, int row) const { return known_ + 2 * (row * columns_ + column); }
    Point place(int column, int row) const { return {x_[column], y_[row]}; }

    // The known corners nearest to a place that lies at these fractions of the lattice; as indices, nearest first.
    int nearest(const Point& place, int column, int row, int (&index)[kNearest], double (&square)[kNearest], int most_rings, int but = -1) const {
        int count = 0;
        for (int ring = 0; ring <= std::max(columns_, rows_) && ring <= most_rings; ++ring) {
            // A full ring beyond the last one needed finds none nearer, on lattices whose steps differ by four at most.
            if (count == kNearest && ring > full_at_ + 2) break;
            for (int r = row - ring; r <= row + ring; ++r)
                for (int c = column - ring; c <= column + ring; c += (std::abs(r - row) == ring || ring == 0) ? 1 : 2 * ring) {
                    if (!is_known(c, r) || r * columns_ + c == but) continue;
                    const double dx = x_[c] - place[0], dy = y_[r] - place[1], d = (dx * dx + dy * dy) / (pitch_ * pitch_);
                    if (count == kNearest && !(d < square[kNearest - 1])) continue;
                    int k = count < kNearest ? count++ : kNearest - 1;
                    for (; k > 0 && square[k - 1] > d; --k) square[k] = square[k - 1], index[k] = index[k - 1];
                    square[k] = d, index[k] = r * columns_ + c;
                    if (count == kNearest && full_at_ < 0) full_at_ = ring;
                }
        }
        full_at_ = -1;
        return count;
    }

    // The map about a place from the known corners nearest to it, without one of them; false where they do not determine it.
    bool map_about(const Point& place, int column, int row, LocalMap& map, int* used, int& n_used, int most_rings, int but = -1) const {
        int index[kNearest];
        double square[kNearest];
        n_used = nearest(place, column, row, index, square, most_rings, but);
        if (n_used < 4) return false;
        std::copy_n(index, n_used, used);
        const double* middle = known_ + 2 * index[0];
        map.plane = LocalPlane(lens_, {middle[0], middle[1]});
        map.origin = {x_[index[0] % columns_], y_[index[0] / columns_]};
        map.scale = pitch_;
        Point xy[kNearest], image[kNearest];
        double weight[kNearest];
        // Far from all of them, weights about the place would leave only the nearest.
        const double sigma2 = std::max(kReachPitch * kReachPitch, square[n_used / 2]);
        double extent = 0;
        for (int k = 0; k < n_used; ++k) {
            const int i = index[k];
            xy[k] = {(x_[i % columns_] - map.origin[0]) / pitch_, (y_[i / columns_] - map.origin[1]) / pitch_};
            if (!map.plane.from_pixel({known_[2 * i], known_[2 * i + 1]}, image[k])) return false;
            weight[k] = std::exp(-0.5 * square[k] / sigma2) * (trust_ ? trust_[i] : 1.0);
            extent = std::max(extent, std::hypot(image[k][0], image[k][1]));
        }
        if (!(extent > 0)) return false;
        double A[8][8] = {}, b[8][1] = {};
        for (int k = 0; k < n_used; ++k) {
            const double x = xy[k][0], y = xy[k][1], w = weight[k];
            const double X = image[k][0] / extent, Y = image[k][1] / extent;
            const double rows[2][8] = {{1, x, y, 0, 0, 0, -x * X, -y * X}, {0, 0, 0, 1, x, y, -x * Y, -y * Y}};
            const double value[2] = {X, Y};
            for (int e = 0; e < 2; ++e)
                for (int i = 0; i < 8; ++i) {
                    b[i][0] += w * rows[e][i] * value[e];
                    for (int j = 0; j <= i; ++j) A[i][j] += w * rows[e][i] * rows[e][j];
                }
        }
        for (int i = 0; i < 6; ++i) A[i][i] += 1e-9;
        A[6][6] += kPerspectiveRidge, A[7][7] += kPerspectiveRidge;
        if (!solve(A, b)) return false;
        map.H.h = {b[1][0] * extent, b[2][0] * extent, b[0][0] * extent, b[4][0] * extent, b[5][0] * extent, b[3][0] * extent, b[6][0], b[7][0], 1};
        double Q[3][3] = {}, q[3][2] = {};
        for (int k = 0; k < n_used; ++k) {
            Point fitted;
            if (!map.H(xy[k], fitted)) return false;
            const double x = xy[k][0], y = xy[k][1], terms[3] = {x * x, x * y, y * y};
            for (int i = 0; i < 3; ++i) {
                for (int e = 0; e < 2; ++e) q[i][e] += weight[k] * terms[i] * (image[k][e] - fitted[e]);
                for (int j = 0; j <= i; ++j) Q[i][j] += weight[k] * terms[i] * terms[j];
            }
        }
        for (int i = 0; i < 3; ++i) Q[i][i] += kBendRidge;
        if (!solve(Q, q)) return false;
        std::copy_n(&q[0][0], 6, &map.bend[0][0]);
        return true;
    }

  private:
    const double *x_, *y_;
    int columns_, rows_;
    double pitch_;
    Lens lens_;
    double* known_;
    const double* trust_;
    mutable int full_at_ = -1;
};

LocalMap empty_map(const Lens& lens) { return {LocalPlane(lens, {0, 0}), {}, {}, {}, 1}; }

// Where places of the board lie in the image by the known corners nearest to them: NaN where those do not tell. Known are
// (rows, columns) corners of the lattice with lines at x and y, ascending, NaN where unknown.
void predict_places(const Doubles& x, const Doubles& y, double pitch, const DoublesOut& known, double cx, double cy, double f, const Doubles& places,
                    DoublesOut points) {
    const std::size_t n = places.size() / 2;
    require(x.size() > 0 && y.size() > 0 && known.size() == 2 * x.size() * y.size() && places.size() == 2 * n && points.size() == 2 * n && pitch > 0,
            "the arrays' lengths do not match");
    const Lens lens{cx, cy, f};
    Board board(x, y, pitch, lens, known.data());
    const double* place = places.data();
    double* out = points.data();
    const double *x0 = x.data(), *y0 = y.data();
    const int columns = static_cast<int>(x.size()), rows = static_cast<int>(y.size());
    nb::gil_scoped_release unlocked;
    for (std::size_t i = 0; i < n; ++i) {
        const Point at{place[2 * i], place[2 * i + 1]};
        const int column = std::min(static_cast<int>(std::lower_bound(x0, x0 + columns, at[0]) - x0), columns - 1);
        const int row = std::min(static_cast<int>(std::lower_bound(y0, y0 + rows, at[1]) - y0), rows - 1);
        LocalMap map = empty_map(lens);
        int used[kNearest], n_used = 0;
        Point pixel;
        const bool is_told = board.map_about(at, column, row, map, used, n_used, columns + rows) && map(at, pixel);
        out[2 * i] = is_told ? pixel[0] : kNan;
        out[2 * i + 1] = is_told ? pixel[1] : kNan;
    }
}

// Where each known corner would be expected by those around it, NaN where unknown or where those do not tell. `trust` are weights.
void predict_each(const Doubles& x, const Doubles& y, double pitch, const DoublesOut& known, const Doubles& trust, double cx, double cy, double f,
                  DoublesOut points) {
    const std::size_t n = x.size() * y.size();
    require(n > 0 && known.size() == 2 * n && trust.size() == n && points.size() == 2 * n && pitch > 0, "the arrays' lengths do not match");
    const Lens lens{cx, cy, f};
    const Board board(x, y, pitch, lens, known.data(), trust.data());
    double* out = points.data();
    nb::gil_scoped_release unlocked;
    for (int row = 0; row < board.rows(); ++row)
        for (int column = 0; column < board.columns(); ++column, out += 2) {
            out[0] = out[1] = kNan;
            if (!board.is_known(column, row)) continue;
            LocalMap map = empty_map(lens);
            int used[kNearest], n_used = 0;
            Point pixel;
            const Point place = board.place(column, row);
            if (board.map_about(place, column, row, map, used, n_used, 8, row * board.columns() + column) && map(place, pixel)) out[0] = pixel[0], out[1] = pixel[1];
        }
}

// What a unit of the board along x, and along y, is in the image at each known corner, by differences over `probe` to both sides.
void predict_steps(const Doubles& x, const Doubles& y, double pitch, const DoublesOut& known, double cx, double cy, double f, double probe, DoublesOut steps) {
    const std::size_t n = x.size() * y.size();
    require(n > 0 && known.size() == 2 * n && steps.size() == 4 * n && pitch > 0 && probe > 0, "the arrays' lengths do not match");
    const Lens lens{cx, cy, f};
    const Board board(x, y, pitch, lens, known.data());
    double* out = steps.data();
    nb::gil_scoped_release unlocked;
    for (int row = 0; row < board.rows(); ++row)
        for (int column = 0; column < board.columns(); ++column, out += 4) {
            std::fill_n(out, 4, kNan);
            if (!board.is_known(column, row)) continue;
            LocalMap map = empty_map(lens);
            int used[kNearest], n_used = 0;
            const Point place = board.place(column, row);
            if (!board.map_about(place, column, row, map, used, n_used, board.columns() + board.rows())) continue;
            for (int axis : {0, 1}) {
                Point ahead, behind, to = place, from = place;
                to[axis] += probe, from[axis] -= probe;
                if (!map(to, ahead) || !map(from, behind)) continue;
                for (int k : {0, 1}) out[2 * axis + k] = (ahead[k] - behind[k]) / (2 * probe);
            }
        }
}

struct Print {
    double sign;  // 1 where the face beyond corner (0, 0) is bright
    double free;  // how far from a corner, along both axes, nothing else is printed
    bool has_dots;  // on the middle of every edge
};

// Bright minus dark about a corner, the least of the four sectors' differences, and the mean.
template <typename Pixel>
bool read_sectors(const Sampler<Pixel>& read, const LocalMap& map, const Point& place, const Point& pixel, double sign, double off, double& least, double& mean) {
    Point there;
    if (!map(place, there)) return false;
    double value[4];
    for (int k = 0; k < 4; ++k) {
        Point at;
        if (!map({place[0] + (k == 0 || k == 3 ? off : -off), place[1] + (k < 2 ? off : -off)}, at)) return false;
        value[k] = read(pixel[0] + at[0] - there[0], pixel[1] + at[1] - there[1]);
    }
    // In turn: beyond both axes, left of it, opposite, above it.
    const double bright[2] = {sign > 0 ? value[0] : value[1], sign > 0 ? value[2] : value[3]};
    const double dark[2] = {sign > 0 ? value[1] : value[0], sign > 0 ? value[3] : value[2]};
    least = std::min(bright[0], bright[1]) - std::max(dark[0], dark[1]);
    mean = 0.5 * (bright[0] + bright[1] - dark[0] - dark[1]);
    return true;
}

template <typename Pixel>
class Growth {
  public:
    Growth(const Sampler<Pixel>& read, const Board& board, const Lens& lens, const Print& print, double pitch, const double* candidates, std::size_t n_candidates,
           bool* is_new)
        : read_(read), board_(board), lens_(lens), print_(print), pitch_(pitch), candidates_(candidates), n_candidates_(n_candidates), is_new_(is_new),
          contrast_(static_cast<std::size_t>(board.columns()) * board.rows(), kNan), tried_(contrast_.size(), -1) {}

    void run() {
        for (int row = 0; row < board_.rows(); ++row)
            for (int column = 0; column < board_.columns(); ++column)
                if (board_.is_known(column, row)) measure(column, row);
        for (int pass = 0; pass < board_.columns() + board_.rows() + 8; ++pass) {
            bool is_grown = false;
            for (int row = 0; row < board_.rows(); ++row)
                for (int column = 0; column < board_.columns(); ++column)
                    if (!board_.is_known(column, row) && try_corner(column, row)) is_grown = true;
            if (!is_grown) break;
        }
    }

  private:
    double sign_at(int column, int row) const { return (column + row) % 2 ? -print_.sign : print_.sign; }

    double off_at(const LocalMap& map, const Point& place) const {
        Point a, b, c;
        const double step = 0.1 * pitch_;
        if (!map(place, a) || !map({place[0] + step, place[1]}, b) || !map({place[0], place[1] + step}, c)) return kNan;
        const double least_px = std::min(std::hypot(b[0] - a[0], b[1] - a[1]), std::hypot(c[0] - a[0], c[1] - a[1])) / step;
        return std::max(0.6 * print_.free, std::min(1.3 / std::max(least_px, 1e-9), print_.free));
    }

    void measure(int column, int row) {
        LocalMap map = empty_map(lens_);
        int used[kNearest], n_used = 0;
        const Point place = board_.place(column, row);
        if (!board_.map_about(place, column, row, map, used, n_used, 8)) return;
        const double* at = board_.at(column, row);
        double least, mean;
        if (read_sectors(read_, map, place, {at[0], at[1]}, sign_at(column, row), off_at(map, place), least, mean)) contrast_[index(column, row)] = mean;
    }

    std::size_t index(int column, int row) const { return static_cast<std::size_t>(row) * board_.columns() + column; }

    bool try_corner(int column, int row) {
        static constexpr int step[4][2] = {{1, 0}, {-1, 0}, {0, 1}, {0, -1}};
        int beside = 0, around = 0;
        for (const auto& s : step) beside += board_.is_known(column + s[0], row + s[1]);
        if (!beside) return false;
        for (int r = row - 2; r <= row + 2; ++r)
            for (int c = column - 2; c <= column + 2; ++c) around += board_.is_known(c, r);
        auto& tried = tried_[index(column, row)];
        if (around <= tried) return false;
        tried = around;
        LocalMap map = empty_map(lens_);
        int used[kNearest], n_used = 0;
        const Point place = board_.place(column, row);
        Point expected;
        if (!board_.map_about(place, column, row, map, used, n_used, 8) || !map(place, expected)) return false;
        if (!(expected[0] >= 1 && expected[1] >= 1 && expected[0] <= read_.width - 2.0 && expected[1] <= read_.height - 2.0)) return false;
        double shortest = std::numeric_limits<double>::infinity();
        // Seen obliquely the corner across a face may be the nearest, and its sectors are alike.
        for (int r = std::max(row - 1, 0); r <= std::min(row + 1, board_.rows() - 1); ++r)
            for (int c = std::max(column - 1, 0); c <= std::min(column + 1, board_.columns() - 1); ++c) {
                Point there;
                if ((r == row && c == column) || !map(board_.place(c, r), there)) continue;
                shortest = std::min(shortest, std::hypot(there[0] - expected[0], there[1] - expected[1]));
            }
        double typical[kNearest];
        int n_typical = 0;
        for (int k = 0; k < n_used; ++k)
            if (std::isfinite(contrast_[used[k]])) typical[n_typical++] = contrast_[used[k]];
        if (!n_typical) return false;
        std::nth_element(typical, typical + n_typical / 2, typical + n_typical);
        const double contrast = typical[n_typical / 2];
        if (!(contrast > 0)) return false;
        const double limit = std::max(0.25 * shortest, 1.0), off = off_at(map, place), sign = sign_at(column, row);
        if (!std::isfinite(limit) || !std::isfinite(off)) return false;
        int found[kTried], n_found = 0;
        double away[kTried];  // squared
        for (std::size_t i = 0; i < n_candidates_; ++i) {
            const double dx = candidates_[2 * i] - expected[0], dy = candidates_[2 * i + 1] - expected[1], d = dx * dx + dy * dy;
            if (!(d < limit * limit) || (n_found == kTried && !(d < away[kTried - 1]))) continue;
            int k = n_found < kTried ? n_found++ : kTried - 1;
            for (; k > 0 && away[k - 1] > d; --k) away[k] = away[k - 1], found[k] = found[k - 1];
            away[k] = d, found[k] = static_cast<int>(i);
        }
        for (int k = 0; k < n_found; ++k) {
            const Point pixel{candidates_[2 * found[k]], candidates_[2 * found[k] + 1]};
            double least, mean;
            if (!read_sectors(read_, map, place, pixel, sign, off, least, mean)) continue;
            if (!(least > 0.12 * contrast && mean > 0.33 * contrast)) continue;
            int n_seen = 0, n_edges = 0;
            for (const auto& s : step) {
                if (!board_.is_known(column + s[0], row + s[1])) continue;
                const double* other = board_.at(column + s[0], row + s[1]);
                ++n_edges;
                const auto follow = print_.has_dots ? is_dotted_edge<Pixel> : is_marker_edge<Pixel>;
                n_seen += follow(read_, pixel[0], pixel[1], other[0] - pixel[0], other[1] - pixel[1], s[0] ? sign : -sign, std::min(mean, contrast));
            }
            if (2 * n_seen < n_edges) continue;
            board_.at(column, row)[0] = pixel[0];
            board_.at(column, row)[1] = pixel[1];
            contrast_[index(column, row)] = mean;
            is_new_[index(column, row)] = true;
            return true;
        }
        return false;
    }

    const Sampler<Pixel>& read_;
    const Board& board_;
    Lens lens_;
    Print print_;
    double pitch_;
    const double* candidates_;
    std::size_t n_candidates_;
    bool* is_new_;
    std::vector<double> contrast_;
    std::vector<int> tried_;
};

// Adds to the known corners (rows, columns) those candidates that lie where the corners around put them, with four sectors as
// printed and edges to the known ones beside them; `is_new` says which.
template <typename Pixel>
void grow_lattice(const Plane<Pixel>& image, const Doubles& x, const Doubles& y, double pitch, double sign, double free, bool has_dots, DoublesOut known, const Doubles& candidates,
                  double cx, double cy, double f, FlagsInOut is_new) {
    const std::size_t n = x.size() * y.size();
    require(n > 0 && known.size() == 2 * n && is_new.size() == n && candidates.size() % 2 == 0 && pitch > 0, "the arrays' lengths do not match");
    const Sampler<Pixel> read(image);
    const Lens lens{cx, cy, f};
    const Board board(x, y, pitch, lens, known.data());
    bool* flags = is_new.data();
    const double* candidate = candidates.data();
    nb::gil_scoped_release unlocked;
    std::fill_n(flags, n, false);
    Growth<Pixel>(read, board, lens, {sign, free, has_dots}, pitch, candidate, candidates.size() / 2, flags).run();
}

}  // namespace

void register_marker_growth(nb::module_& module) {
    module.def("predict_places", &predict_places);
    module.def("predict_each", &predict_each);
    module.def("predict_steps", &predict_steps);
    module.def("grow_lattice", &grow_lattice<std::uint8_t>);
    module.def("grow_lattice", &grow_lattice<float>);
}

}  // namespace binocal
