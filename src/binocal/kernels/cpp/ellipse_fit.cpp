// The ellipse fit in Python: an image and starts in, ellipses and what is known of their centres out.
#include "ellipse_fit.hpp"
#include "kernel.hpp"

namespace binocal {

namespace {

template <typename Pixel>
using Image = nb::ndarray<const Pixel, nb::ndim<2>, nb::device::cpu, nb::c_contig>;

template <typename Pixel>
void fit(const Image<Pixel>& image, double bottom, double top, const Doubles& inputs, DoublesOut results) {
    const std::size_t n = inputs.size() / kEllipseInputSize;
    require(inputs.size() == kEllipseInputSize * n && results.size() == kEllipseResultSize * n, "inputs must be (n, 7) and results (n, 29)");
    const ImageView<Pixel> view{image.data(), static_cast<std::ptrdiff_t>(image.shape(0)), static_cast<std::ptrdiff_t>(image.shape(1)),
                                bottom, top};
    nb::gil_scoped_release unlocked;
    fit_ellipses(view, reinterpret_cast<const EllipseInput*>(inputs.data()), static_cast<std::ptrdiff_t>(n),
                 reinterpret_cast<EllipseResult*>(results.data()));
}

// Where the fields of the records start, bytes, and the records' sizes: what the NumPy types of binocal.kernels.ellipse_fits must be.
nb::dict record_layouts() {
    nb::dict input, fit, layouts;
    input["centre_px"] = offsetof(EllipseInput, x);
    input["axes_px"] = offsetof(EllipseInput, major);
    input["angle_rad"] = offsetof(EllipseInput, angle);
    input["outward_px"] = offsetof(EllipseInput, outward);
    input["inward_px"] = offsetof(EllipseInput, inward);
    fit["centre"] = offsetof(EllipseResult, point);
    fit["axes_px"] = offsetof(EllipseResult, major);
    fit["angle_rad"] = offsetof(EllipseResult, angle);
    layouts["ELLIPSE_INPUT"] = nb::make_tuple(sizeof(EllipseInput), input);
    layouts["ELLIPSE_FIT"] = nb::make_tuple(sizeof(EllipseResult), fit);
    return layouts;
}

}  // namespace

void register_ellipse_fit(nb::module_& module) {
    module.def("fit_ellipses", &fit<std::uint8_t>);
    module.def("fit_ellipses", &fit<std::uint16_t>);
    module.def("fit_ellipses", &fit<float>);
    module.attr("ELLIPSE_LAYOUTS") = record_layouts();
}

}  // namespace binocal
