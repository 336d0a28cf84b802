// Planes seen through a lens: about any pixel the picture is that of a pinhole camera that looks that way, if the lens is
// known roughly. A homography then holds over several squares at any field of view.
#pragma once

#include "kernel.hpp"

#include <array>
#include <cmath>

namespace binocal {

using Point = std::array<double, 2>;

// An equidistant lens about (cx, cy) with f pixels a radian; f = 0: no lens, the picture is a plane.
struct Lens {
    double cx, cy, f;
};

// The picture as a pinhole camera that looks at one of its pixels sees it: its plane's unit is about a pixel.
class LocalPlane {
  public:
    LocalPlane(const Lens& lens, const Point& middle) : lens_(lens), middle_(middle) {
        if (lens.f <= 0) return;
        axis_ = ray(middle);
        const double across = std::hypot(axis_[0], axis_[2]);
        u_ = across > 1e-9 ? std::array<double, 3>{axis_[2] / across, 0, -axis_[0] / across} : std::array<double, 3>{1, 0, 0};
        v_ = {axis_[1] * u_[2] - axis_[2] * u_[1], axis_[2] * u_[0] - axis_[0] * u_[2], axis_[0] * u_[1] - axis_[1] * u_[0]};
    }

    bool from_pixel(const Point& pixel, Point& place) const {
        if (lens_.f <= 0) {
            place = {pixel[0] - middle_[0], pixel[1] - middle_[1]};
            return true;
        }
        const auto r = ray(pixel);
        const double depth = r[0] * axis_[0] + r[1] * axis_[1] + r[2] * axis_[2];
        if (!(depth > 0.1)) return false;
        const double scale = lens_.f / depth;
        place = {scale * (r[0] * u_[0] + r[1] * u_[1] + r[2] * u_[2]), scale * (r[0] * v_[0] + r[1] * v_[1] + r[2] * v_[2])};
        return true;
    }

    Point to_pixel(const Point& place) const {
        if (lens_.f <= 0) return {place[0] + middle_[0], place[1] + middle_[1]};
        const double a = place[0] / lens_.f, b = place[1] / lens_.f;
        double r[3];
        for (int i = 0; i < 3; ++i) r[i] = axis_[i] + a * u_[i] + b * v_[i];
        const double off = std::hypot(r[0], r[1]);
        if (off < 1e-12) return {lens_.cx, lens_.cy};
        const double radius = lens_.f * std::atan2(off, r[2]) / off;
        return {lens_.cx + radius * r[0], lens_.cy + radius * r[1]};
    }

  private:
    std::array<double, 3> ray(const Point& pixel) const {
        const double x = pixel[0] - lens_.cx, y = pixel[1] - lens_.cy, radius = std::hypot(x, y), angle = radius / lens_.f;
        if (radius < 1e-12) return {0, 0, 1};
        const double s = std::sin(angle) / radius;
        return {s * x, s * y, std::cos(angle)};
    }

    Lens lens_;
    Point middle_;
    std::array<double, 3> axis_{}, u_{}, v_{};
};

// A homography of the plane, row by row, the last number 1.
struct Homography {
    std::array<double, 9> h;

    // False beyond the horizon.
    bool operator()(const Point& from, Point& to) const {
        const double w = h[6] * from[0] + h[7] * from[1] + h[8];
        if (!(w > 0.05)) return false;
        to = {(h[0] * from[0] + h[1] * from[1] + h[2]) / w, (h[3] * from[0] + h[4] * from[1] + h[5]) / w};
        return true;
    }
};

// From the unit square, whose corners (0, 0), (1, 0), (1, 1), (0, 1) go to these. Source: Heckbert 1989, section 2.2.3.
inline bool square_to(const std::array<Point, 4>& q, Homography& out) {
    const double dx1 = q[1][0] - q[2][0], dx2 = q[3][0] - q[2][0], sx = q[0][0] - q[1][0] + q[2][0] - q[3][0];
    const double dy1 = q[1][1] - q[2][1], dy2 = q[3][1] - q[2][1], sy = q[0][1] - q[1][1] + q[2][1] - q[3][1];
    const double determinant = dx1 * dy2 - dx2 * dy1;
    if (!(std::fabs(determinant) > 1e-9)) return false;
    const double g = (sx * dy2 - dx2 * sy) / determinant, h = (dx1 * sy - sx * dy1) / determinant;
    out.h = {q[1][0] - q[0][0] + g * q[1][0], q[3][0] - q[0][0] + h * q[3][0], q[0][0],
             q[1][1] - q[0][1] + g * q[1][1], q[3][1] - q[0][1] + h * q[3][1], q[0][1], g, h, 1};
    return g > -0.9 && h > -0.9 && g + h > -0.9;
}

// Four corners of a face and the plane about their middle.
struct Face {
    LocalPlane plane;
    Homography from_square;
    bool is_good;

    Face(const Lens& lens, const double* quad)
        : plane(lens, {(quad[0] + quad[2] + quad[4] + quad[6]) / 4, (quad[1] + quad[3] + quad[5] + quad[7]) / 4}), from_square{}, is_good(true) {
        std::array<Point, 4> corners;
        for (int k = 0; k < 4; ++k) is_good = is_good && plane.from_pixel({quad[2 * k], quad[2 * k + 1]}, corners[k]);
        is_good = is_good && square_to(corners, from_square);
    }

    bool operator()(const Point& in_square, Point& pixel) const {
        Point place;
        if (!from_square(in_square, place)) return false;
        pixel = plane.to_pixel(place);
        return true;
    }
};

}  // namespace binocal
