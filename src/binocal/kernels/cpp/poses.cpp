// Board poses: the left step of many rigid transforms, and their composition with a rig.

#include "kernel.hpp"
#include "linear_algebra.hpp"

#include <cmath>

namespace binocal {
namespace {

// out = R x + shift
void move(const double* R, const double* x, const double* shift, double* out) {
    const Vector3 y = product3(R, vector3(x)) + vector3(shift);
    out[0] = y.x, out[1] = y.y, out[2] = y.z;
}

// Rodrigues' formula; Taylor series below 1e-4 rad, where its next term is below 1e-18.
void exponential(const double* w, double* R) {
    const double theta2 = w[0] * w[0] + w[1] * w[1] + w[2] * w[2], theta = std::sqrt(theta2);
    const bool is_small = theta < 1e-4;
    const double a = is_small ? 1 - theta2 / 6 : std::sin(theta) / theta;
    const double b = is_small ? 0.5 - theta2 / 24 : (1 - std::cos(theta)) / theta2;
    const double W[9] = {0, -w[2], w[1], w[2], 0, -w[0], -w[1], w[0], 0};
    double W2[9];
    product3(W, W, W2);
    for (int i = 0; i < 9; ++i) R[i] = (i % 4 == 0) + a * W[i] + b * W2[i];
}

// T <- (exp(omega), tau) T for every transform.
void step_poses(const Doubles& R, const Doubles& t, const Doubles& xi, DoublesOut R_out, DoublesOut t_out) {
    const std::size_t n = t.size() / 3;
    require(R.size() == 9 * n && xi.size() == 6 * n && R_out.size() == 9 * n && t_out.size() == 3 * n,
            "R, t, xi and the outputs differ in length");
    nb::gil_scoped_release unlocked;
    for (std::size_t i = 0; i < n; ++i) {
        double turn[9];
        exponential(xi.data() + 6 * i, turn);
        product3(turn, R.data() + 9 * i, R_out.data() + 9 * i);
        move(turn, t.data() + 3 * i, xi.data() + 6 * i + 3, t_out.data() + 3 * i);
    }
}

// Every rig's transform times each of its views'.
void compose_poses(const Doubles& R_rig, const Doubles& t_rig, const Doubles& R, const Doubles& t, DoublesOut R_out,
                   DoublesOut t_out) {
    const std::size_t n_rigs = t_rig.size() / 3, n = t.size() / 3;
    require(n_rigs > 0 && n % n_rigs == 0 && R_rig.size() == 9 * n_rigs, "the views do not divide among the rigs");
    require(R.size() == 9 * n && R_out.size() == 9 * n && t_out.size() == 3 * n, "the outputs differ in length");
    nb::gil_scoped_release unlocked;
    for (std::size_t i = 0; i < n; ++i) {
        const std::size_t rig = i / (n / n_rigs);
        product3(R_rig.data() + 9 * rig, R.data() + 9 * i, R_out.data() + 9 * i);
        move(R_rig.data() + 9 * rig, t.data() + 3 * i, t_rig.data() + 3 * rig, t_out.data() + 3 * i);
    }
}

}  // namespace

void register_poses(nb::module_& module) {
    module.def("step_poses", &step_poses);
    module.def("compose_poses", &compose_poses);
}

}  // namespace binocal
