// How far a step moves every predicted corner, to second order (binocal.kernels.poses says what the arrays mean).
//
// Points, parameters and pixels are truncated Taylor series in the length s of the step; the series is summed at s = 1.

#include "camera_models.hpp"
#include "kernel.hpp"
#include "linear_algebra.hpp"

#include <algorithm>
#include <cmath>
#include <string>
#include <string_view>

namespace binocal {
namespace {

struct Task {
    std::size_t views_per_rig, n;
    int p;
    const double *parameters, *parameter_step;        // (rigs, p)
    const double *R, *t, *view_step;                  // (views, ...), T_left_board and its left step
    const double *R_rig, *t_rig, *rig_step;           // (rigs, ...), T_right_left and its left step; null in the left camera
    const double* bend;                               // (rigs), share of the second order
    const double *points, *pixels;
    double* out;
};

// The series of one board-frame vector's image in the camera; is_point: translations count too.
void path(const Task& task, std::size_t view, Vector3 X, bool is_point, Vector3* c) {
    const double* xi = task.view_step + 6 * view;
    const Vector3 w = vector3(xi);
    c[0] = product3(task.R + 9 * view, X);
    if (is_point) c[0] = c[0] + vector3(task.t + 3 * view);
    c[1] = cross(w, c[0]);
    c[2] = cross(w, c[1]);  // (exp(s w) x)'' = w x (w x x)
    if (is_point) c[1] = c[1] + vector3(xi + 3);
    if (task.R_rig) {
        const std::size_t rig = view / task.views_per_rig;
        const double *R = task.R_rig + 9 * rig, *eta = task.rig_step + 6 * rig;
        const Vector3 a = vector3(eta);
        Vector3 y0 = product3(R, c[0]);
        const Vector3 y1 = product3(R, c[1]), y2 = product3(R, c[2]);
        if (is_point) y0 = y0 + vector3(task.t_rig + 3 * rig);
        const Vector3 turned = cross(a, y0), mixed = cross(a, y1);
        c[0] = y0;
        c[1] = turned + y1;
        c[2] = (cross(a, turned) + y2) + (mixed + mixed);
        if (is_point) c[1] = c[1] + vector3(eta + 3);
    }
    c[2] = 0.5 * c[2];
}

template <class Model>
BINOCAL_INLINE void run_views(const Task& task, std::size_t first, std::size_t last) {
    const std::size_t n = task.n;
    const double *x = task.points, *y = x + n, *z = y + n;
    for (std::size_t view = first; view < last; ++view) {
        const std::size_t rig = view / task.views_per_rig;
        const double bend = task.bend[rig];
        Series a[n_parameters_of<Model>];
        for (int i = 0; i < task.p; ++i) a[i] = {task.parameters[rig * task.p + i], task.parameter_step[rig * task.p + i], 0};
        Vector3 ex[3], ey[3], ez[3], origin[3];  // the path is affine in the point
        path(task, view, {1, 0, 0}, false, ex);
        path(task, view, {0, 1, 0}, false, ey);
        path(task, view, {0, 0, 1}, false, ez);
        path(task, view, {0, 0, 0}, true, origin);
        const double *pixel_u = task.pixels + 2 * n * view, *pixel_v = pixel_u + n;
        double *out_u = task.out + 2 * n * view, *out_v = out_u + n;
        BINOCAL_INDEPENDENT
        for (std::size_t j = 0; j < n; ++j) {
            Series X, Y, Z;
            X.c0 = ex[0].x * x[j] + ey[0].x * y[j] + ez[0].x * z[j] + origin[0].x;
            X.c1 = ex[1].x * x[j] + ey[1].x * y[j] + ez[1].x * z[j] + origin[1].x;
            X.c2 = ex[2].x * x[j] + ey[2].x * y[j] + ez[2].x * z[j] + origin[2].x;
            Y.c0 = ex[0].y * x[j] + ey[0].y * y[j] + ez[0].y * z[j] + origin[0].y;
            Y.c1 = ex[1].y * x[j] + ey[1].y * y[j] + ez[1].y * z[j] + origin[1].y;
            Y.c2 = ex[2].y * x[j] + ey[2].y * y[j] + ez[2].y * z[j] + origin[2].y;
            Z.c0 = ex[0].z * x[j] + ey[0].z * y[j] + ez[0].z * z[j] + origin[0].z;
            Z.c1 = ex[1].z * x[j] + ey[1].z * y[j] + ez[1].z * z[j] + origin[1].z;
            Z.c2 = ex[2].z * x[j] + ey[2].z * y[j] + ez[2].z * z[j] + origin[2].z;
            const Point2<Series, Series> at = project<Model>(a, X, Y, Z);
            out_u[j] = pixel_u[j] - (at.x.c1 + bend * at.x.c2);
            out_v[j] = pixel_v[j] - (at.y.c1 + bend * at.y.c2);
        }
    }
}

#define BINOCAL_COPIES(name, Model) \
    BINOCAL_DISPATCH(move_##name, Task, (static_cast<void>(lanes), run_views<Model>(task, first, last)))
BINOCAL_CAMERA_MODELS(BINOCAL_COPIES)

struct Entry {
    std::string_view name;
    int n_parameters;
    void (*run)(const Task&, std::size_t, std::size_t);
};
#define BINOCAL_ENTRY(name, Model) {#name, n_parameters_of<Model>, move_##name},
constexpr Entry kModels[] = {BINOCAL_CAMERA_MODELS(BINOCAL_ENTRY)};

// What stands and steps: parameters and their step (rigs, p), T_left_board (views, ...) and T_right_left (rigs, ...) with their left
// steps; the rig's are empty for the left camera.
struct Movement {
    Doubles parameters, parameter_step, R, t, view_step, R_rig, t_rig, rig_step;
};

void pixels_behind(const std::string& name, const Movement& movement, const Doubles& bend, const Doubles& points, const Doubles& pixels,
                   DoublesOut out, std::size_t n_threads) {
    const auto& [parameters, parameter_step, R, t, view_step, R_rig, t_rig, rig_step] = movement;
    const Entry* model = nullptr;
    for (const Entry& entry : kModels) {
        if (entry.name == name) model = &entry;
    }
    require(model != nullptr, "no compiled camera model");
    require(parameters.ndim() == 2 && points.ndim() == 2 && pixels.ndim() == 3, "wrong number of dimensions");
    const std::size_t rigs = parameters.shape(0), views = pixels.shape(0), n = points.shape(1);
    require(rigs > 0 && views % rigs == 0, "the views do not divide among the rigs");
    require(parameters.shape(1) == static_cast<std::size_t>(model->n_parameters) && parameter_step.size() == parameters.size(),
            "wrong number of parameters");
    require(R.size() == 9 * views && t.size() == 3 * views && view_step.size() == 6 * views, "R, t or the step differ in length");
    require(bend.size() == rigs, "one bend for each rig");
    require(points.shape(0) == 3 && pixels.size() == 2 * views * n && out.size() == pixels.size(), "pixels must be (views, 2, n)");
    Task task{std::max<std::size_t>(views / rigs, 1), n, model->n_parameters, parameters.data(), parameter_step.data(),
              R.data(), t.data(), view_step.data(), nullptr, nullptr, nullptr, bend.data(), points.data(), pixels.data(), out.data()};
    if (t_rig.size() > 0) {
        require(R_rig.size() == 9 * rigs && t_rig.size() == 3 * rigs && rig_step.size() == 6 * rigs, "one rig step for each rig");
        task.R_rig = R_rig.data(), task.t_rig = t_rig.data(), task.rig_step = rig_step.data();
    }
    nb::gil_scoped_release unlocked;
    in_parallel(views, n_threads, [&](std::size_t first, std::size_t last) { model->run(task, first, last); });
}

}  // namespace

void register_motion(nb::module_& module) {
    nb::class_<Movement>(module, "Movement")
        .def(nb::init<Doubles, Doubles, Doubles, Doubles, Doubles, Doubles, Doubles, Doubles>(), nb::kw_only(), "parameters"_a,
             "parameter_step"_a, "R"_a, "t"_a, "view_step"_a, "R_rig"_a, "t_rig"_a, "rig_step"_a);
    module.def("pixels_behind", &pixels_behind);
}

}  // namespace binocal
