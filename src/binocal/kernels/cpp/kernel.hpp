// The compiled kernel's own header: array types, and one registration function for each source file.
#pragma once

#include "cpu.hpp"

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <cstddef>
#include <cstdint>
#include <exception>
#include <system_error>
#include <thread>
#include <vector>

namespace nb = nanobind;

namespace binocal {

using namespace nb::literals;

using Doubles = nb::ndarray<const double, nb::device::cpu, nb::c_contig>;
using Flags = nb::ndarray<const bool, nb::device::cpu, nb::c_contig>;
using DoublesOut = nb::ndarray<double, nb::device::cpu, nb::c_contig>;

// Arrays are checked where they enter: ValueError in Python, with what was expected.
inline void require(bool holds, const char* what) {
    if (!holds) throw nb::value_error(what);
}

// Calls work(first, last) for consecutive parts of [0, count), the last part on this thread. The parts write to
// places of their own, so the result does not depend on how many there are. At most n_threads, at least one. An exception
// of any part is thrown here once all have ended; parts for which the system gives no thread are worked on this one.
template <class Work>
void in_parallel(std::size_t count, std::size_t n_threads, const Work& work) {
    if (n_threads > count) n_threads = count;
    if (n_threads <= 1) {
        work(std::size_t{0}, count);
        return;
    }
    std::vector<std::exception_ptr> failures(n_threads);
    auto part = [&](std::size_t i) noexcept {
        try {
            work(i * count / n_threads, (i + 1) * count / n_threads);
        } catch (...) {
            failures[i] = std::current_exception();
        }
    };
    std::vector<std::thread> threads;
    threads.reserve(n_threads - 1);
    std::size_t n_started = 0;
    for (; n_started + 1 < n_threads; ++n_started) {
        try {
            threads.emplace_back(part, n_started);
        } catch (const std::system_error&) {  // no thread to be had
            break;
        }
    }
    for (std::size_t i = n_started; i < n_threads; ++i) part(i);
    for (auto& thread : threads) thread.join();
    for (const auto& failure : failures)
        if (failure) std::rethrow_exception(failure);
}

void register_accumulate(nb::module_& module);
void register_planes(nb::module_& module);
void register_point_lattice(nb::module_& module);
void register_poses(nb::module_& module);
void register_step(nb::module_& module);
void register_corner_fit(nb::module_& module);
void register_ellipse_fit(nb::module_& module);
void register_image_lens(nb::module_& module);
void register_joint_views(nb::module_& module);
void register_library_words(nb::module_& module);
void register_marker_cells(nb::module_& module);
void register_marker_growth(nb::module_& module);
void register_motion(nb::module_& module);
void register_observe(nb::module_& module);
void register_template_match(nb::module_& module);
void register_rectified_map(nb::module_& module);
void register_saddles(nb::module_& module);
void register_spots(nb::module_& module);
void register_square_fit(nb::module_& module);
void register_xcorners(nb::module_& module);

}  // namespace binocal
