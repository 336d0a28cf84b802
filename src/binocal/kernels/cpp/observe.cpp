// What a controller sees of a robust solve: scale-free numbers of residuals and of the next step (binocal.solvers.observation
// says what they mean and in which order they come).

#include "kernel.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>
#include <vector>

namespace binocal {
namespace {

constexpr int kFeatures = 24;
constexpr double kLimit = 30;  // of any number that is returned, and what is not a number is 0
constexpr int kBinsPerOctave = 8, kOctaves = 96, kBins = kBinsPerOctave * kOctaves;  // of squared lengths
constexpr double kTiny = 1e-12;

// log2 with the mantissa's logarithm taken as straight: off by 0.086 at most, continuous and monotone.
inline double rough_log2(double x) {
    return static_cast<double>(std::bit_cast<std::uint64_t>(x) >> 32) * 0x1p-20 - 1023.0;
}
inline double log10_of(double x) { return std::log10(std::max(x, kTiny)); }
inline double length3(const double* v) { return std::sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]); }

struct Spread {
    double mean, deviation;
};
Spread spread_of(const std::vector<double>& values) {
    double sum = 0, squares = 0;
    for (double v : values) sum += v;
    const double mean = values.empty() ? 0 : sum / static_cast<double>(values.size());
    for (double v : values) squares += (v - mean) * (v - mean);
    return {mean, values.empty() ? 0 : std::sqrt(squares / static_cast<double>(values.size()))};
}

// The next step: (rigs, s), (rigs, views, 6), (rigs), (rigs, s), (rigs).
struct NextStep {
    Doubles shared, views, predicted, gradient, pivot;
};

// Of the last iteration, (rigs) but for the shared step (rigs, s): scale, gain, whether it was kept, noise and step before it.
struct Previous {
    Doubles scale_px, gain;
    Flags is_kept;
    Doubles mad, predicted, shared;
};

void observe(const std::vector<Doubles>& r2, const std::vector<Flags>& is_seen, const Doubles& mad, const NextStep& step,
             const Doubles& t_rig, const Doubles& t, const Previous& last, DoublesOut out) {
    const auto& [shared, views, predicted, gradient, pivot] = step;
    const auto& [scale_px, gain, is_kept, previous_mad, previous_predicted, previous_shared] = last;
    require(r2.size() == 2 && is_seen.size() == 2, "two cameras");
    require(r2[0].ndim() == 3, "squared lengths must be (rigs, views, n)");
    const std::size_t rigs = r2[0].shape(0), n_views = r2[0].shape(1), n = r2[0].shape(2), m = n_views * n;
    const std::size_t s = rigs ? shared.size() / rigs : 0;
    require(r2[1].size() == rigs * m && is_seen[0].size() == rigs * m && is_seen[1].size() == rigs * m, "the cameras differ in shape");
    require(mad.size() == rigs && predicted.size() == rigs && pivot.size() == rigs && gradient.size() == shared.size() && s >= 6,
            "one value for each rig");
    require(views.size() == 6 * rigs * n_views && t.size() == 3 * rigs * n_views && t_rig.size() == 3 * rigs, "views differ in length");
    require(scale_px.size() == rigs && gain.size() == rigs && is_kept.size() == rigs && previous_mad.size() == rigs &&
                previous_predicted.size() == rigs && previous_shared.size() == shared.size(), "one last iteration for each rig");
    require(out.size() == rigs * kFeatures, "the output has the wrong size");
    nb::gil_scoped_release unlocked;
    std::vector<std::uint32_t> bins(kBins);
    std::vector<double> view_logs[2];
    for (std::size_t rig = 0; rig < rigs; ++rig) {
        double* f = out.data() + rig * kFeatures;
        const double scale = std::max(mad.data()[rig], kTiny);
        std::fill(bins.begin(), bins.end(), 0);
        std::size_t n_seen = 0;
        for (int camera = 0; camera < 2; ++camera) {
            view_logs[camera].clear();
            for (std::size_t view = 0; view < n_views; ++view) {
                const double* values = r2[camera].data() + rig * m + view * n;
                const bool* seen = is_seen[camera].data() + rig * m + view * n;
                double sum = 0;
                std::size_t count = 0;
                for (std::size_t j = 0; j < n; ++j) {
                    if (!seen[j]) continue;
                    const double value = std::clamp(values[j], 0x1p-60, 0x1p34);
                    const auto bits = std::bit_cast<std::uint64_t>(value);
                    ++bins[std::min<std::uint64_t>((bits >> 49) - (std::uint64_t{1023 - 60} << 3), kBins - 1)];
                    sum += rough_log2(value);
                    ++count;
                }
                n_seen += count;
                if (count) view_logs[camera].push_back(sum / static_cast<double>(count));
            }
        }
        // quantiles as log2 of the length over the MAD, and the shares beyond 3.5 and 7 of it
        const double base = 2 * std::log2(scale);
        const double shares[4] = {0.25, 0.5, 0.75, 0.9};
        std::size_t below = 0;
        int next = 0;
        double beyond[2] = {0, 0};
        const double limits[2] = {base + 2 * std::log2(3.5), base + 2 * std::log2(7.0)};
        for (int bin = 0; bin < kBins; ++bin) {
            if (!bins[bin]) continue;
            const double low = static_cast<double>(bin) / kBinsPerOctave - 60, width = 1.0 / kBinsPerOctave;
            const double count = bins[bin];
            while (next < 4 && static_cast<double>(below) + count > shares[next] * static_cast<double>(n_seen)) {
                const double within = (shares[next] * static_cast<double>(n_seen) - static_cast<double>(below)) / count;
                f[8 + next] = 0.5 * (low + within * width - base);
                ++next;
            }
            below += bins[bin];
            for (int i = 0; i < 2; ++i) beyond[i] += low + 0.5 * width > limits[i] ? count : 0.0;
        }
        for (; next < 4; ++next) f[8 + next] = 0;
        for (int i = 0; i < 2; ++i) f[12 + i] = n_seen ? beyond[i] / static_cast<double>(n_seen) : 0;
        const Spread left = spread_of(view_logs[0]), right = spread_of(view_logs[1]);
        f[14] = 0.5 * (right.mean - left.mean);
        f[15] = 0.5 * left.deviation;
        f[16] = 0.5 * right.deviation;
        f[17] = log10_of(static_cast<double>(n_seen)) - 3;

        const double *x = shared.data() + rig * s + (s - 6), *g = gradient.data() + rig * s + (s - 6);
        const double turn = std::max(x[0] * g[0] + x[1] * g[1] + x[2] * g[2], 0.0);
        const double shift = std::max(x[3] * g[3] + x[4] * g[4] + x[5] * g[5], 0.0);
        const double total = std::max(2 * predicted.data()[rig], 0.0);
        double turns = 0, shifts = 0;
        for (std::size_t view = 0; view < n_views; ++view) {
            const double *xi = views.data() + 6 * (rig * n_views + view), *at = t.data() + 3 * (rig * n_views + view);
            turns += xi[0] * xi[0] + xi[1] * xi[1] + xi[2] * xi[2];
            const double along = length3(xi + 3) / std::max(length3(at), kTiny);
            shifts += along * along;
        }
        f[0] = log10_of(std::sqrt(total) / scale);
        f[1] = turn / std::max(turn + shift, kTiny);
        f[2] = std::clamp((turn + shift) / std::max(total, 1e-300), 0.0, 2.0);
        f[3] = log10_of(pivot.data()[rig]);
        f[4] = log10_of(length3(x));
        f[5] = log10_of(length3(x + 3) / std::max(length3(t_rig.data() + 3 * rig), kTiny));
        f[6] = log10_of(std::sqrt(turns / static_cast<double>(n_views)));
        f[7] = log10_of(std::sqrt(shifts / static_cast<double>(n_views)));

        // the last iteration
        const double* before = previous_shared.data() + rig * s + (s - 6);
        double along = 0, own = 0;
        for (int i = 0; i < 6; ++i) along += g[i] * before[i], own += g[i] * x[i];
        const double old_mad = previous_mad.data()[rig], old_total = std::max(2 * previous_predicted.data()[rig], 1e-300);
        f[18] = std::log10(scale_px.data()[rig] / scale);
        f[19] = std::log10(scale / old_mad);
        f[20] = 0.5 * std::log10(std::max(total, 1e-300) / (scale * scale) / (old_total / (old_mad * old_mad)));
        f[21] = gain.data()[rig];
        f[22] = is_kept.data()[rig] ? 1 : -1;
        f[23] = along / std::max(std::abs(own), 1e-150);
        for (int i = 0; i < kFeatures; ++i) f[i] = std::isnan(f[i]) ? 0.0 : std::clamp(f[i], -kLimit, kLimit);
    }
}

}  // namespace

void register_observe(nb::module_& module) {
    nb::class_<NextStep>(module, "NextStep")
        .def(nb::init<Doubles, Doubles, Doubles, Doubles, Doubles>(), nb::kw_only(), "shared"_a, "views"_a, "predicted"_a, "gradient"_a,
             "pivot"_a);
    nb::class_<Previous>(module, "Previous")
        .def(nb::init<Doubles, Doubles, Flags, Doubles, Doubles, Doubles>(), nb::kw_only(), "scale_px"_a, "gain"_a, "is_kept"_a, "mad"_a,
             "predicted"_a, "shared"_a);
    module.attr("N_OBSERVED") = kFeatures;
    module.def("observe", &observe);
}

}  // namespace binocal
