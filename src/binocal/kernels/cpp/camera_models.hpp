// The camera models, each stated once, for every scalar of dual.hpp: values, derivatives and Taylor series come from the same lines.
//
// A model takes a point of the camera's frame to the plane of unit focal length, distorted; fx, fy, cx, cy and skew are the same
// for all and applied by `project` and `linearize`. To add one, write a struct like those below, add its line to BINOCAL_CAMERA_MODELS, and write its
// plain NumPy statement in binocal/cameras, against which the tests compare it.
#pragma once

#include "dual.hpp"

#include <algorithm>
#include <cstddef>
#include <utility>

// X(name in Python, struct)
#define BINOCAL_CAMERA_MODELS(X) X(brown4, Brown4) X(brown5, Brown5) X(brown8, Brown8) X(fisheye4, Fisheye4)

namespace binocal {

template <class U, class V>
struct Point2 {
    U x;
    V y;
};
template <class U, class V>
Point2(U, V) -> Point2<U, V>;

// A radial factor and the tangential terms of a decentred lens (Brown 1966).
BINOCAL_INLINE auto decentred(auto x, auto y, auto r2, auto factor, auto p1, auto p2) {
    const auto two_xy = 2 * (x * y);
    return Point2{x * factor + p1 * two_xy + p2 * (r2 + 2 * (x * x)), y * factor + p1 * (r2 + 2 * (y * y)) + p2 * two_xy};
}

struct Brown4 {
    static constexpr int n_coefficients = 4;
    static constexpr bool sees_behind = false;  // a point at negative depth has no image
    BINOCAL_INLINE static auto distort(auto X, auto Y, auto Z, auto k1, auto k2, auto p1, auto p2) {
        const auto depth = inverse(Z);
        const auto x = X * depth;
        const auto y = Y * depth;
        const auto r2 = x * x + y * y;
        const auto factor = through(r2, [&](auto t) BINOCAL_INLINE_LAMBDA { return 1.0 + t * (k1 + t * k2); });
        return decentred(x, y, r2, factor, p1, p2);
    }
};

struct Brown5 {
    static constexpr int n_coefficients = 5;
    static constexpr bool sees_behind = false;
    BINOCAL_INLINE static auto distort(auto X, auto Y, auto Z, auto k1, auto k2, auto p1, auto p2, auto k3) {
        const auto depth = inverse(Z);
        const auto x = X * depth;
        const auto y = Y * depth;
        const auto r2 = x * x + y * y;
        const auto factor = through(r2, [&](auto t) BINOCAL_INLINE_LAMBDA { return 1.0 + t * (k1 + t * (k2 + t * k3)); });
        return decentred(x, y, r2, factor, p1, p2);
    }
};

struct Brown8 {
    static constexpr int n_coefficients = 8;
    static constexpr bool sees_behind = false;
    BINOCAL_INLINE static auto distort(auto X, auto Y, auto Z, auto k1, auto k2, auto p1, auto p2, auto k3, auto k4, auto k5, auto k6) {
        const auto depth = inverse(Z);
        const auto x = X * depth;
        const auto y = Y * depth;
        const auto r2 = x * x + y * y;
        const auto factor = through(r2, [&](auto t) BINOCAL_INLINE_LAMBDA {
            return (1.0 + t * (k1 + t * (k2 + t * k3))) * inverse(1.0 + t * (k4 + t * (k5 + t * k6)));
        });
        return decentred(x, y, r2, factor, p1, p2);
    }
};

// Equidistant with a polynomial of the angle (Kannala & Brandt 2006, as in OpenCV).
struct Fisheye4 {
    static constexpr int n_coefficients = 4;
    static constexpr bool sees_behind = true;
    BINOCAL_INLINE static auto distort(auto X, auto Y, auto Z, auto k1, auto k2, auto k3, auto k4) {
        const auto r = radius(X * X + Y * Y, Z);
        const auto theta_d = through(angle(r, Z), [&](auto theta) BINOCAL_INLINE_LAMBDA {
            const auto t = theta * theta;
            return theta * (1.0 + t * (k1 + t * (k2 + t * (k3 + t * k4))));
        });
        const auto stretch = theta_d * inverse(r);
        return Point2{X * stretch, Y * stretch};
    }
};

// Parameters: fx, fy, cx, cy, skew, then the coefficients in the order of `distort`.
constexpr int kIntrinsics = 5;
template <class Model>
constexpr int n_parameters_of = kIntrinsics + Model::n_coefficients;

// The most that any model has.
#define BINOCAL_COUNT(name, Model) n_parameters_of<Model>,
constexpr int kMaxParameters = std::max({BINOCAL_CAMERA_MODELS(BINOCAL_COUNT)});
#undef BINOCAL_COUNT

// The pixel of a point, all scalars alike: double or Series.
template <class Model, class Scalar>
BINOCAL_INLINE Point2<Scalar, Scalar> project(const Scalar* a, Scalar X, Scalar Y, Scalar Z) {
    return [&]<std::size_t... i>(std::index_sequence<i...>) BINOCAL_INLINE_LAMBDA {
        const auto at = Model::distort(X, Y, Z, a[kIntrinsics + i]...);
        return Point2<Scalar, Scalar>{a[0] * at.x + a[4] * at.y + a[2], a[1] * at.y + a[3]};
    }(std::make_index_sequence<Model::n_coefficients>{});
}

// Pixel, its derivatives by the point and, if Full, by the parameters, each of these a pair of u and v.
template <class Model>
struct Linearization {
    double u, v, ux, uy, uz, vx, vy, vz;
    double coefficients[Model::n_coefficients][2];
    double x, y;  // on the distorted plane: the derivatives by fx, fy and skew
};

template <class Model, bool Full>
BINOCAL_INLINE Linearization<Model> linearize(const double* a, double X, double Y, double Z) {
    constexpr unsigned by_x = 1, by_y = 2, by_z = 4;
    constexpr int first = 3;  // the first coefficient's bit
    static_assert(first + Model::n_coefficients <= kInner, "an unknown for each coefficient");
    return [&]<std::size_t... i>(std::index_sequence<i...>) BINOCAL_INLINE_LAMBDA {
        auto coefficient = [&]<std::size_t k>() BINOCAL_INLINE_LAMBDA {
            if constexpr (Full) {
                return Dual<(1u << (first + k))>{a[kIntrinsics + k], {1.0}};
            } else {
                return a[kIntrinsics + k];
            }
        };
        // A ray's pixel does not depend on its length: X u_x + Y u_y + Z u_z = 0, which gives u_z where the depth cannot be 0.
        const auto depth = [&]() BINOCAL_INLINE_LAMBDA {
            if constexpr (Model::sees_behind) {
                return Dual<by_z>{Z, {1.0}};
            } else {
                return Z;
            }
        }();
        const auto at = Model::distort(Dual<by_x>{X, {1.0}}, Dual<by_y>{Y, {1.0}}, depth, coefficient.template operator()<i>()...);
        const double fx = a[0], fy = a[1], skew = a[4];
        Linearization<Model> out;
        out.x = at.x.value, out.y = at.y.value;
        out.u = fx * out.x + skew * out.y + a[2];
        out.v = fy * out.y + a[3];
        out.ux = fx * at.x.template by<0>() + skew * at.y.template by<0>();
        out.uy = fx * at.x.template by<1>() + skew * at.y.template by<1>();
        out.vx = fy * at.y.template by<0>();
        out.vy = fy * at.y.template by<1>();
        if constexpr (Model::sees_behind) {
            out.uz = fx * at.x.template by<2>() + skew * at.y.template by<2>();
            out.vz = fy * at.y.template by<2>();
        } else {
            const double inverse_Z = inverse(Z), x = X * inverse_Z, y = Y * inverse_Z;
            out.uz = -(x * out.ux + y * out.uy);
            out.vz = -(x * out.vx + y * out.vy);
        }
        if constexpr (Full) {
            ((out.coefficients[i][0] = fx * at.x.template by<first + i>() + skew * at.y.template by<first + i>(),
              out.coefficients[i][1] = fy * at.y.template by<first + i>()), ...);
        }
        return out;
    }(std::make_index_sequence<Model::n_coefficients>{});
}

}  // namespace binocal
