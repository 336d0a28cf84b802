// Grey values between the pixels.
#pragma once

#include "kernel.hpp"

#include <algorithm>
#include <cmath>
#include <initializer_list>

namespace binocal {

template <typename Pixel>
using Plane = nb::ndarray<const Pixel, nb::ndim<2>, nb::device::cpu, nb::c_contig>;

// Bilinear values; the border's value beyond the border, 0 where a coordinate is no number.
template <typename Pixel>
struct Sampler {
    const Pixel* image;
    std::ptrdiff_t height, width;

    explicit Sampler(const Plane<Pixel>& plane)
        : image(plane.data()), height(static_cast<std::ptrdiff_t>(plane.shape(0))), width(static_cast<std::ptrdiff_t>(plane.shape(1))) {
        require(height > 0 && width > 0, "an image has one pixel at least; got an empty one");
    }

    float operator()(double x, double y) const {
        if (!(std::isfinite(x) && std::isfinite(y))) return 0.0f;
        x = std::min(std::max(x, 0.0), static_cast<double>(width - 1));
        y = std::min(std::max(y, 0.0), static_cast<double>(height - 1));
        const auto column = static_cast<std::ptrdiff_t>(x), row = static_cast<std::ptrdiff_t>(y);
        const float a = static_cast<float>(x - column), b = static_cast<float>(y - row);
        const std::ptrdiff_t right = column + 1 < width, down = row + 1 < height ? width : 0;
        const Pixel* at = image + row * width + column;
        const float top = at[0] + a * (static_cast<float>(at[right]) - at[0]);
        const float bottom = at[down] + a * (static_cast<float>(at[down + right]) - at[down]);
        return top + b * (bottom - top);
    }
};

// Whether one side of the way from (x, y) is brighter than the other all along it, by 0.3 of the contrast.
template <typename Pixel>
bool is_edge(const Sampler<Pixel>& read, double x, double y, double way_x, double way_y, double sign, double contrast) {
    const double length = std::hypot(way_x, way_y), aside = std::min(std::max(0.15, 1.5 / std::max(length, 1.0)), 0.4);
    for (double share : {0.3, 0.5, 0.7}) {
        const double at_x = x + share * way_x, at_y = y + share * way_y;
        const float step = read(at_x - aside * way_y, at_y + aside * way_x) - read(at_x + aside * way_y, at_y - aside * way_x);
        if (!(sign * step > 0.3 * contrast)) return false;
    }
    return true;
}

// The same where more is printed near the edge: read close to it, at the shares of the way that are given.
template <typename Pixel>
bool is_edge_at(const Sampler<Pixel>& read, std::initializer_list<double> shares, double x, double y, double way_x, double way_y, double sign, double contrast) {
    const double length = std::sqrt(way_x * way_x + way_y * way_y), aside = std::min(std::max(0.05, 1.3 / std::max(length, 1.0)), 0.4);
    for (double share : shares) {
        const double at_x = x + share * way_x, at_y = y + share * way_y;
        const float step = read(at_x - aside * way_y, at_y + aside * way_x) - read(at_x + aside * way_y, at_y - aside * way_x);
        if (!(sign * step > 0.3 * contrast)) return false;
    }
    return true;
}

// With markers beside the edge.
template <typename Pixel>
bool is_marker_edge(const Sampler<Pixel>& read, double x, double y, double way_x, double way_y, double sign, double contrast) {
    return is_edge_at(read, {0.15, 0.3, 0.5, 0.7, 0.85}, x, y, way_x, way_y, sign, contrast);
}

// With a dot on its middle third.
template <typename Pixel>
bool is_dotted_edge(const Sampler<Pixel>& read, double x, double y, double way_x, double way_y, double sign, double contrast) {
    return is_edge_at(read, {0.15, 0.25, 0.75, 0.85}, x, y, way_x, way_y, sign, contrast);
}

}  // namespace binocal
