// The compiled kernel's own header: array types, and one registration function for each source file.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <cstddef>
#include <cstdint>
#include <thread>
#include <vector>

// Of pointers: nothing is reached through another one.
#if defined(_MSC_VER)
#define BINOCAL_APART __restrict
#else
#define BINOCAL_APART __restrict__
#endif

namespace nb = nanobind;

namespace binocal {

using Doubles = nb::ndarray<const double, nb::device::cpu, nb::c_contig>;
using Flags = nb::ndarray<const bool, nb::device::cpu, nb::c_contig>;
using DoublesOut = nb::ndarray<double, nb::device::cpu, nb::c_contig>;

// Calls work(first, last) for consecutive parts of [0, count), the last part on this thread. The parts write to
// places of their own, so the result does not depend on how many there are. At most n_threads, at least one.
template <class Work>
void in_parallel(std::size_t count, std::size_t n_threads, const Work& work) {
    if (n_threads > count) n_threads = count;
    if (n_threads <= 1) {
        work(std::size_t{0}, count);
        return;
    }
    std::vector<std::thread> threads;
    threads.reserve(n_threads - 1);
    for (std::size_t i = 0; i + 1 < n_threads; ++i) {
        threads.emplace_back([&work, i, count, n_threads] { work(i * count / n_threads, (i + 1) * count / n_threads); });
    }
    work((n_threads - 1) * count / n_threads, count);
    for (auto& thread : threads) thread.join();
}

void register_accumulate(nb::module_& module);
void register_planes(nb::module_& module);
void register_poses(nb::module_& module);
void register_step(nb::module_& module);
void register_corner_fit(nb::module_& module);
void register_motion(nb::module_& module);
void register_observe(nb::module_& module);
void register_saddles(nb::module_& module);
void register_xcorners(nb::module_& module);

}  // namespace binocal
