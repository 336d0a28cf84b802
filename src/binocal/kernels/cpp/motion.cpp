// How far a step moves every predicted corner, to second order (binocal.kernels says what the arrays mean).
//
// Points, parameters and pixels are truncated Taylor series in the length s of the step; the series is summed at s = 1.

#include "camera_models.hpp"
#include "kernel.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>
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

struct Vector {
    double x, y, z;
};
Vector cross(Vector a, Vector b) { return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x}; }
Vector add(Vector a, Vector b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
Vector rotated(const double* R, Vector a) {
    return {R[0] * a.x + R[1] * a.y + R[2] * a.z, R[3] * a.x + R[4] * a.y + R[5] * a.z, R[6] * a.x + R[7] * a.y + R[8] * a.z};
}

// The series of one board-frame vector's image in the camera; is_point: translations count too.
void path(const Task& task, std::size_t view, Vector X, bool is_point, Vector* c) {
    const double* xi = task.view_step + 6 * view;
    const double* t = task.t + 3 * view;
    const Vector w{xi[0], xi[1], xi[2]};
    c[0] = rotated(task.R + 9 * view, X);
    if (is_point) c[0] = add(c[0], {t[0], t[1], t[2]});
    c[1] = cross(w, c[0]);
    c[2] = cross(w, c[1]);  // (exp(s w) x)'' = w x (w x x)
    if (is_point) c[1] = add(c[1], {xi[3], xi[4], xi[5]});
    if (task.R_rig) {
        const std::size_t rig = view / task.views_per_rig;
        const double *R = task.R_rig + 9 * rig, *t_rig = task.t_rig + 3 * rig, *eta = task.rig_step + 6 * rig;
        const Vector a{eta[0], eta[1], eta[2]};
        Vector y0 = rotated(R, c[0]);
        const Vector y1 = rotated(R, c[1]), y2 = rotated(R, c[2]);
        if (is_point) y0 = add(y0, {t_rig[0], t_rig[1], t_rig[2]});
        const Vector turned = cross(a, y0), mixed = cross(a, y1);
        c[0] = y0;
        c[1] = add(turned, y1);
        c[2] = add(add(cross(a, turned), y2), add(mixed, mixed));
        if (is_point) c[1] = add(c[1], {eta[3], eta[4], eta[5]});
    }
    c[2] = {0.5 * c[2].x, 0.5 * c[2].y, 0.5 * c[2].z};
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
        Vector ex[3], ey[3], ez[3], origin[3];  // the path is affine in the point
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

void pixels_behind(const std::string& name, const Doubles& parameters, const Doubles& parameter_step, const Doubles& R,
                   const Doubles& t, const Doubles& view_step, const Doubles& R_rig, const Doubles& t_rig,
                   const Doubles& rig_step, const Doubles& bend, const Doubles& points, const Doubles& pixels,
                   DoublesOut out, std::size_t n_threads) {
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

void register_motion(nb::module_& module) { module.def("pixels_behind", &pixels_behind); }

}  // namespace binocal
