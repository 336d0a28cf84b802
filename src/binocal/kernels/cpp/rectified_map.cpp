// Where in a camera's image the pixels of a rectified one lie (binocal.rectification states the projections).

#include "camera_models.hpp"
#include "kernel.hpp"

#include <cmath>
#include <cstdint>
#include <stdexcept>
#include <string_view>

namespace binocal {
namespace {

// A double whose inverse is that of a float with one step of Newton's method: to 1e-14, in a third of a division's time.
struct Quick {
    double value;
};
BINOCAL_INLINE Quick operator+(Quick a, Quick b) { return {a.value + b.value}; }
BINOCAL_INLINE Quick operator+(double a, Quick b) { return {a + b.value}; }
BINOCAL_INLINE Quick operator*(Quick a, Quick b) { return {a.value * b.value}; }
BINOCAL_INLINE Quick operator*(double a, Quick b) { return {a * b.value}; }
BINOCAL_INLINE Quick inverse(Quick a) {
    const double near = 1.0f / static_cast<float>(a.value);
    return {near * (2.0 - a.value * near)};
}
BINOCAL_INLINE Quick radius(Quick r2, Quick Z) { return {binocal::radius(r2.value, Z.value)}; }
BINOCAL_INLINE Quick angle(Quick y, Quick x) { return {binocal::angle(y.value, x.value)}; }

// The ray of pixel (row i, column j) in the camera's frame is rows[i] + columns[j].
struct Task {
    const double *parameters, *rows, *columns;  // (p), (h, 3), (3, w)
    std::size_t width;
    double least_cosine;  // of a ray's angle from the axis: beyond it the lens model folds back
    double last_x, last_y;
    float outside;  // NaN or below -0.5
    float *map_x, *map_y;
    std::uint8_t* is_inside;
};

template <class Model>
BINOCAL_INLINE void map_rows(const Task& task, std::size_t first, std::size_t last) {
    Quick a[kMaxParameters];
    for (int k = 0; k < n_parameters_of<Model>; ++k) a[k] = {task.parameters[k]};
    const double *columns_x = task.columns, *columns_y = columns_x + task.width, *columns_z = columns_y + task.width;
    const double least = task.least_cosine * std::fabs(task.least_cosine), last_x = task.last_x, last_y = task.last_y;
    const float outside = task.outside;
    for (std::size_t i = first; i < last; ++i) {
        const double row_x = task.rows[3 * i], row_y = task.rows[3 * i + 1], row_z = task.rows[3 * i + 2];
        float *BINOCAL_APART map_x = task.map_x + i * task.width, *BINOCAL_APART map_y = task.map_y + i * task.width;
        BINOCAL_INDEPENDENT
        for (std::size_t j = 0; j < task.width; ++j) {
            const double X = row_x + columns_x[j], Y = row_y + columns_y[j], Z = row_z + columns_z[j];
            const auto at = project<Model>(a, Quick{X}, Quick{Y}, Quick{Z});
            const double u = at.x.value, v = at.y.value;
            // Z over the ray's length against the cosine, both times their absolute value, which keeps the order
            const bool is_inside = (Z * std::fabs(Z) > least * (X * X + Y * Y + Z * Z)) & (u >= -0.5) & (u <= last_x) & (v >= -0.5) &
                                   (v <= last_y);
            map_x[j] = is_inside ? static_cast<float>(u) : outside;
            map_y[j] = is_inside ? static_cast<float>(v) : outside;
        }
        if (!task.is_inside) continue;
        std::uint8_t* BINOCAL_APART seen = task.is_inside + i * task.width;
        BINOCAL_INDEPENDENT
        for (std::size_t j = 0; j < task.width; ++j) seen[j] = map_x[j] >= -0.5f;
    }
}

#define BINOCAL_COPIES(name, Model) \
    BINOCAL_DISPATCH(map_##name, Task, (static_cast<void>(lanes), map_rows<Model>(task, first, last)))
BINOCAL_CAMERA_MODELS(BINOCAL_COPIES)

struct Entry {
    std::string_view name;
    std::size_t n_parameters;
    void (*run)(const Task&, std::size_t, std::size_t);
};
#define BINOCAL_ENTRY(name, Model) {#name, n_parameters_of<Model>, map_##name},
constexpr Entry kModels[] = {BINOCAL_CAMERA_MODELS(BINOCAL_ENTRY)};

using Map = nb::ndarray<float, nb::ndim<3>, nb::device::cpu, nb::c_contig>;
using Mask = nb::ndarray<bool, nb::device::cpu, nb::c_contig>;

// `is_inside` is (h, w), or empty where it is not wanted. `size` is the camera's width and height.
void rectified_map(const std::string& name, const Doubles& parameters, const Doubles& rows, const Doubles& columns, const Doubles& size,
                   double least_cosine, double outside, Map map, Mask is_inside, std::size_t n_threads) {
    const Entry* model = nullptr;
    for (const Entry& entry : kModels) {
        if (entry.name == name) model = &entry;
    }
    if (!model) throw std::invalid_argument("no compiled camera model " + name);
    require(parameters.size() == model->n_parameters, "wrong number of parameters for the camera model");
    require(rows.ndim() == 2 && rows.shape(1) == 3, "rows must be (h, 3)");
    require(columns.ndim() == 2 && columns.shape(0) == 3, "columns must be (3, w)");
    require(size.size() == 2, "size must be width and height");
    const std::size_t height = rows.shape(0), width = columns.shape(1);
    require(map.shape(0) == 2 && map.shape(1) == height && map.shape(2) == width, "map must be (2, h, w)");
    require(!(outside >= -0.5), "what stands for no pixel is NaN or below -0.5");
    require(is_inside.size() == 0 || is_inside.size() == height * width, "is_inside must be (h, w)");
    const Task task{parameters.data(), rows.data(), columns.data(), width, least_cosine, size.data()[0] - 0.5, size.data()[1] - 0.5,
                    static_cast<float>(outside), map.data(), map.data() + height * width,
                    is_inside.size() ? reinterpret_cast<std::uint8_t*>(is_inside.data()) : nullptr};
    nb::gil_scoped_release unlocked;
    in_parallel(height, n_threads, [&](std::size_t first, std::size_t last) { model->run(task, first, last); });
}

}  // namespace

void register_rectified_map(nb::module_& module) { module.def("rectified_map", &rectified_map); }

}  // namespace binocal
