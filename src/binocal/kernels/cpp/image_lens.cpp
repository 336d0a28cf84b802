// The lens of one image in Python: a board's points and their image in, lens, residuals and where the board's points lie out.
#include "image_lens.hpp"

#include "kernel.hpp"

namespace binocal {

namespace {

// Writes w, v, q, the centre (px) and a, then H over the board's own coordinates, to rays with f = 1; the points' residuals, px, infinite behind the lens;
// and where more places of the board lie. False where no plane can be fitted or it is seen from behind.
bool fit(const Doubles& board_xy, const Doubles& points, double width, double height, double tolerance, int n_unknowns, bool is_robust,
         const Doubles& places, DoublesOut lens, DoublesOut lengths, DoublesOut images) {
    const std::size_t n = lengths.size(), n_places = places.size() / 2;
    require(board_xy.size() == 2 * n && points.size() == 2 * n, "board_xy and points must be (n, 2), the residuals (n)");
    require(places.size() == 2 * n_places && images.size() == 2 * n_places, "places and their images must be (m, 2)");
    require(lens.size() == 15, "the lens has 15 numbers");
    require(n_unknowns == 1 || n_unknowns == 6, "a lens has 1 or 6 unknowns");
    nb::gil_scoped_release unlocked;
    std::vector<LensPoint> corners(n);
    const double *xy = board_xy.data(), *at = points.data(), *place = places.data();
    double *out = lens.data(), *length = lengths.data(), *image = images.data();
    constexpr double nan = std::numeric_limits<double>::quiet_NaN();
    std::fill_n(out, 15, nan), std::fill_n(image, 2 * n_places, nan), std::fill_n(length, n, std::numeric_limits<double>::infinity());
    for (std::size_t i = 0; i < n; ++i) {
        corners[i] = {xy[2 * i], xy[2 * i + 1], at[2 * i], at[2 * i + 1]};
        if (!(std::isfinite(corners[i].X) && std::isfinite(corners[i].Y) && std::isfinite(corners[i].x) && std::isfinite(corners[i].y)))
            return false;
    }
    ImageLensFit fitted(corners, width, height, LensOptions{tolerance, is_robust, n_unknowns});
    if (!fitted.fit() || !(fitted.lens().determinant() > 0)) return false;
    const ImageLens& found = fitted.lens();
    for (int k = 0; k < 3; ++k) out[k] = found.p[k];
    out[3] = found.centre_x(), out[4] = found.centre_y(), out[5] = found.p[5];
    const double scale = 1 / found.board_scale;
    for (int a = 0; a < 3; ++a) {
        const double *row = found.H + 3 * a, unit = a < 2 ? 1 : 1 / found.f;
        out[6 + 3 * a] = unit * row[0] * scale, out[7 + 3 * a] = unit * row[1] * scale;
        out[8 + 3 * a] = unit * (row[2] - scale * (row[0] * found.board_x + row[1] * found.board_y));
    }
    for (std::size_t i = 0; i < n; ++i)
        length[i] = fitted.lengths()[i] < kBehind_px ? fitted.lengths()[i] : std::numeric_limits<double>::infinity();
    project_places(found, corners, place, n_places, image);
    return true;
}

}  // namespace

void register_image_lens(nb::module_& module) { module.def("fit_image_lens", &fit); }

}  // namespace binocal
