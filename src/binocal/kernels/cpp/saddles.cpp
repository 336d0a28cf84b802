// Saddles of a smoothed image: minus the determinant of its Hessian, and the peaks of that.
#include "kernel.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

// These loops vectorise by themselves; where compiler and C library can choose at start, they are compiled for AVX2 too.
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && defined(__GLIBC__)
#define BINOCAL_CLONED __attribute__((target_clones("arch=haswell", "default")))
#else
#define BINOCAL_CLONED
#endif

namespace binocal {
namespace {

using FloatPlane = nb::ndarray<const float, nb::ndim<2>, nb::device::cpu, nb::c_contig>;
using FloatPlaneOut = nb::ndarray<float, nb::ndim<2>, nb::device::cpu, nb::c_contig>;

// One row of the response, from three rows of the image; mean, bend and slope are scratch. The second derivatives are
// Sobel's of size 3, divided by 4.
BINOCAL_CLONED void respond(const float* BINOCAL_APART above, const float* BINOCAL_APART row, const float* BINOCAL_APART below,
                            std::ptrdiff_t width, float* BINOCAL_APART mean, float* BINOCAL_APART bend, float* BINOCAL_APART slope,
                            float* BINOCAL_APART out) {
    for (std::ptrdiff_t x = 0; x < width; ++x) {
        mean[x] = above[x] + 2 * row[x] + below[x];
        bend[x] = above[x] - 2 * row[x] + below[x];
        slope[x] = below[x] - above[x];
    }
    out[0] = out[width - 1] = 0;
    for (std::ptrdiff_t x = 1; x < width - 1; ++x) {
        const float xx = mean[x - 1] - 2 * mean[x] + mean[x + 1], yy = bend[x - 1] + 2 * bend[x] + bend[x + 1];
        const float xy = slope[x + 1] - slope[x - 1];
        out[x] = (xy * xy - xx * yy) * (1.0f / 16);
    }
}

BINOCAL_CLONED float greatest_of(const float* values, std::ptrdiff_t n) {
    float most[8];
    std::fill_n(most, 8, values[0]);
    std::ptrdiff_t i = 0;
    for (; i + 8 <= n; i += 8)
        for (int k = 0; k < 8; ++k) most[k] = values[i + k] > most[k] ? values[i + k] : most[k];
    for (; i < n; ++i) most[0] = std::max(most[0], values[i]);
    return *std::max_element(most, most + 8);
}

// Which of n values in a row are at least `least` and no smaller than the four beside, above and below. No branch: in noise
// every third value would be mispredicted.
BINOCAL_CLONED void mark_tops(const float* row, std::ptrdiff_t width, std::ptrdiff_t n, float least, std::uint8_t* is_top) {
    const float *above = row - width, *below = row + width;
    for (std::ptrdiff_t i = 0; i < n; ++i)
        is_top[i] = (row[i] >= least) & !(row[i - 1] > row[i]) & !(row[i + 1] > row[i]) & !(above[i] > row[i]) & !(below[i] > row[i]);
}

void saddle_response(const FloatPlane& smooth, FloatPlaneOut response) {
    const auto height = static_cast<std::ptrdiff_t>(smooth.shape(0)), width = static_cast<std::ptrdiff_t>(smooth.shape(1));
    if (response.shape(0) != smooth.shape(0) || response.shape(1) != smooth.shape(1) || height < 3 || width < 3)
        throw nb::value_error("the response must have the image's shape, at least 3 x 3");
    const float* in = smooth.data();
    float* out = response.data();
    nb::gil_scoped_release unlocked;
    std::vector<float> sums(3 * width);
    float* mean = sums.data();
    std::fill_n(out, width, 0.0f);
    std::fill_n(out + (height - 1) * width, width, 0.0f);
    for (std::ptrdiff_t y = 1; y < height - 1; ++y) respond(in + (y - 1) * width, in + y * width, in + (y + 1) * width, width, mean, mean + width, mean + 2 * width, out + y * width);
}

// Greatest values, at least `least`, in windows of 2 reach + 1, `margin` from the border: rows of x, y to a fraction of a pixel
// (parabolas through the neighbours) in reading order, the `most` greatest. Returns how many.
std::size_t find_peaks(const FloatPlane& response, std::ptrdiff_t reach, std::ptrdiff_t margin, float least, DoublesOut points) {
    constexpr std::ptrdiff_t block = 64;
    const auto height = static_cast<std::ptrdiff_t>(response.shape(0)), width = static_cast<std::ptrdiff_t>(response.shape(1));
    if (reach < 1 || margin < 1) throw nb::value_error("windows reach, and stay, one pixel from the border at least");
    const float* values = response.data();
    double* out = points.data();
    const std::size_t most = points.size() / 2;
    nb::gil_scoped_release unlocked;
    std::vector<const float*> peaks;
    std::uint8_t is_top[block];
    for (std::ptrdiff_t y = margin; y < height - margin; ++y) {
        const float* row = values + y * width;
        for (std::ptrdiff_t start = margin; start < width - margin; start += block) {
            const std::ptrdiff_t stop = std::min(start + block, width - margin);
            if (!(greatest_of(row + start, stop - start) >= least)) continue;
            mark_tops(row + start, width, stop - start, least, is_top);
            for (std::ptrdiff_t x = start; x < stop; ++x) {
                if (!is_top[x - start]) continue;
                const float value = row[x];
                const std::ptrdiff_t left = std::max<std::ptrdiff_t>(x - reach, 0), right = std::min(x + reach, width - 1);
                bool is_peak = true;
                for (std::ptrdiff_t v = std::max<std::ptrdiff_t>(y - reach, 0); is_peak && v <= std::min(y + reach, height - 1); ++v)
                    for (std::ptrdiff_t u = left; is_peak && u <= right; ++u) is_peak = !(values[v * width + u] > value);
                if (is_peak) peaks.push_back(row + x);
            }
        }
    }
    if (peaks.size() > most) {
        std::nth_element(peaks.begin(), peaks.begin() + most, peaks.end(), [](const float* a, const float* b) { return *a != *b ? *a > *b : a < b; });
        peaks.resize(most);
        std::sort(peaks.begin(), peaks.end());
    }
    auto offset = [](float before, float at, float after) {
        const double bend = static_cast<double>(before) - 2.0 * at + after;
        return bend < 0 ? std::clamp(0.5 * (static_cast<double>(before) - after) / bend, -0.5, 0.5) : 0.0;
    };
    for (std::size_t i = 0; i < peaks.size(); ++i) {
        const float* at = peaks[i];
        const std::ptrdiff_t y = (at - values) / width, x = (at - values) % width;
        out[2 * i] = x + offset(at[-1], at[0], at[1]);
        out[2 * i + 1] = y + offset(at[-width], at[0], at[width]);
    }
    return peaks.size();
}

}  // namespace

void register_saddles(nb::module_& module) {
    module.def("saddle_response", &saddle_response);
    module.def("find_peaks", &find_peaks);
}

}  // namespace binocal
