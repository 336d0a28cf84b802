// The corner fit in Python: an image and starts in, corners and what is known of them out.
#include "board_corners.hpp"
#include "corner_pool.hpp"
#include "kernel.hpp"

namespace binocal {

namespace {

template <typename Pixel>
using Image = nb::ndarray<const Pixel, nb::ndim<2>, nb::device::cpu, nb::c_contig>;

template <typename Pixel>
void fit(const Image<Pixel>& image, double bottom, double top, const Doubles& inputs, const Doubles& board_xy, double pitch,
         DoublesOut results) {
    const std::size_t n = inputs.size() / kInputSize;
    if (inputs.size() != kInputSize * n || results.size() != kResultSize * n)
        throw nb::value_error("inputs must be (n, 4) and results (n, 26)");
    require(board_xy.size() == 0 || board_xy.size() == 2 * n, "board_xy must be (n, 2) or empty");
    const ImageView<Pixel> view{image.data(), static_cast<std::ptrdiff_t>(image.shape(0)), static_cast<std::ptrdiff_t>(image.shape(1)),
                                bottom, top};
    nb::gil_scoped_release unlocked;
    const auto* starts = reinterpret_cast<const CornerInput*>(inputs.data());
    auto* fits = reinterpret_cast<CornerResult*>(results.data());
    const auto n_corners = static_cast<std::ptrdiff_t>(n);
    if (board_xy.size() == 0) return fit_corners(view, starts, n_corners, fits);
    fit_board_corners(view, starts, n_corners, BoardPlaces{board_xy.data(), pitch}, fits);
}

double pool(const Doubles& fits, bool are_corners, DoublesOut pooled) {
    const std::size_t n = fits.size() / kResultSize;
    if (fits.size() != kResultSize * n || pooled.size() != kPooledSize * n)
        throw nb::value_error("fits must be (n, 26) and results (n, 11)");
    nb::gil_scoped_release unlocked;
    const auto* of_fits = reinterpret_cast<const CornerResult*>(fits.data());
    auto* out = reinterpret_cast<PooledCorner*>(pooled.data());
    return are_corners ? pool_corners(of_fits, n, out) : pool_points(of_fits, n, out, kMostClippedOfSpot);
}

// Where the fields of the records start, bytes, and the records' sizes: what the NumPy types of binocal.kernels.corner_fit must be.
nb::dict record_layouts() {
    nb::dict input, fit, pooled, layouts;
    input["point_px"] = offsetof(CornerInput, x);
    input["reach_px"] = offsetof(CornerInput, reach);
    input["strip_px"] = offsetof(CornerInput, strip);
    fit["point_px"] = offsetof(CornerResult, x);
    fit["light_slope"] = offsetof(CornerResult, gx);
    fit["covariance"] = offsetof(CornerResult, covariance);
    fit["odd_variance"] = offsetof(CornerResult, odd_variance);
    fit["variance"] = offsetof(CornerResult, variance);
    fit["half_contrast_dn"] = offsetof(CornerResult, contrast);
    fit["blur_px"] = offsetof(CornerResult, blur1);
    fit["edges_rad"] = offsetof(CornerResult, angle1);
    fit["radius_px"] = offsetof(CornerResult, radius);
    fit["n_pixels"] = offsetof(CornerResult, n_pixels);
    fit["n_evaluations"] = offsetof(CornerResult, n_evaluations);
    fit["long_variance"] = offsetof(CornerResult, long_variance);
    fit["clipped_share"] = offsetof(CornerResult, clipped_share);
    pooled["point_px"] = offsetof(PooledCorner, x);
    pooled["covariance_px2"] = offsetof(PooledCorner, covariance);
    pooled["cross_covariance_px2"] = offsetof(PooledCorner, cross);
    pooled["misfit"] = offsetof(PooledCorner, misfit);
    layouts["CORNER_INPUT"] = nb::make_tuple(sizeof(CornerInput), input);
    layouts["CORNER_FIT"] = nb::make_tuple(sizeof(CornerResult), fit);
    layouts["POOLED_CORNER"] = nb::make_tuple(sizeof(PooledCorner), pooled);
    return layouts;
}

}  // namespace

void register_corner_fit(nb::module_& module) {
    module.def("fit_corners", &fit<std::uint8_t>);
    module.def("fit_corners", &fit<std::uint16_t>);
    module.def("fit_corners", &fit<float>);
    module.def("pool_corners", &pool);
    module.attr("RECORD_LAYOUTS") = record_layouts();
}

}  // namespace binocal
