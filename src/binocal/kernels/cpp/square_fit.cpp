// The square fit in Python: an image and starts in, corners and what is known of them out.
#include "square_fit.hpp"
#include "kernel.hpp"

namespace binocal {

namespace {

template <typename Pixel>
using Image = nb::ndarray<const Pixel, nb::ndim<2>, nb::device::cpu, nb::c_contig>;

template <typename Pixel>
void fit(const Image<Pixel>& image, double bottom, double top, const Doubles& inputs, bool is_rough, DoublesOut results) {
    const std::size_t n = inputs.size() / kSquareInputSize;
    require(inputs.size() == kSquareInputSize * n && results.size() == kSquareResultSize * n, "inputs must be (n, 26) and results (n, 104)");
    const ImageView<Pixel> view{image.data(), static_cast<std::ptrdiff_t>(image.shape(0)), static_cast<std::ptrdiff_t>(image.shape(1)),
                                bottom, top};
    nb::gil_scoped_release unlocked;
    fit_squares(view, reinterpret_cast<const SquareInput*>(inputs.data()), static_cast<std::ptrdiff_t>(n), is_rough,
                reinterpret_cast<SquareResult*>(results.data()));
}

// Where the fields of the records start, bytes, and the records' sizes: what the NumPy types of binocal.kernels.square_fits must be.
nb::dict record_layouts() {
    nb::dict input, fit, layouts;
    input["corners_px"] = offsetof(SquareInput, corners);
    input["bows_px"] = offsetof(SquareInput, bows);
    input["outward_px"] = offsetof(SquareInput, outward);
    input["reach_px"] = offsetof(SquareInput, reach);
    input["blur_px"] = offsetof(SquareInput, blur);
    fit["corners"] = offsetof(SquareResult, corners);
    layouts["SQUARE_INPUT"] = nb::make_tuple(sizeof(SquareInput), input);
    layouts["SQUARE_FIT"] = nb::make_tuple(sizeof(SquareResult), fit);
    return layouts;
}

}  // namespace

void register_square_fit(nb::module_& module) {
    module.def("fit_squares", &fit<std::uint8_t>);
    module.def("fit_squares", &fit<std::uint16_t>);
    module.def("fit_squares", &fit<float>);
    module.attr("SQUARE_LAYOUTS") = record_layouts();
}

}  // namespace binocal
