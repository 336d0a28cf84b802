// Derivatives carried along with values (forward-mode differentiation), for functions that are written once for any scalar.
//
// double: the value alone. Dual: first derivatives by several unknowns, of which the type says which can differ from zero, so that
// nothing is multiplied by a zero. Series: a truncated Taylor series in one unknown. All three know +, *, inverse,
// radius, angle, and through, which applies a function of one argument.
#pragma once

#include "cpu.hpp"

#include <bit>
#include <cmath>
#include <type_traits>
#include <utility>

namespace binocal {

// A value and its derivatives by the unknowns whose bits are set in `Unknowns`, in rising order.
template <unsigned Unknowns>
struct Dual {
    static constexpr int n = std::popcount(Unknowns);
    double value;
    double slope[n > 0 ? n : 1];

    template <int unknown>
    static constexpr bool depends_on = (Unknowns >> unknown & 1) != 0;

    // The derivative by one unknown; 0 by those that it does not depend on.
    template <int unknown>
    BINOCAL_INLINE double by() const {
        if constexpr (depends_on<unknown>) {
            return slope[std::popcount(Unknowns & ((1u << unknown) - 1))];
        } else {
            return 0.0;
        }
    }
};

namespace dual_detail {

// The bit of the k-th unknown of a set.
constexpr int unknown_at(unsigned unknowns, int k) {
    for (; k > 0; --k) unknowns &= unknowns - 1;
    return std::countr_zero(unknowns);
}

// scale_a times a derivative of a plus scale_b times one of b, of which at least one exists.
template <int unknown, unsigned A, unsigned B>
BINOCAL_INLINE double combined(const Dual<A>& a, double scale_a, const Dual<B>& b, double scale_b) {
    if constexpr (!Dual<B>::template depends_on<unknown>) {
        return scale_a * a.template by<unknown>();
    } else if constexpr (!Dual<A>::template depends_on<unknown>) {
        return scale_b * b.template by<unknown>();
    } else {
        return scale_a * a.template by<unknown>() + scale_b * b.template by<unknown>();
    }
}

template <unsigned A, unsigned B, std::size_t... k>
BINOCAL_INLINE Dual<(A | B)> chain(double value, const Dual<A>& a, double scale_a, const Dual<B>& b, double scale_b,
                                   std::index_sequence<k...>) {
    return {value, {combined<unknown_at(A | B, static_cast<int>(k))>(a, scale_a, b, scale_b)...}};
}

}  // namespace dual_detail

// The chain rule: a function of a and b with that value and those partial derivatives.
template <unsigned A, unsigned B>
BINOCAL_INLINE Dual<(A | B)> chain(double value, const Dual<A>& a, double by_a, const Dual<B>& b, double by_b) {
    return dual_detail::chain(value, a, by_a, b, by_b, std::make_index_sequence<std::popcount(A | B)>{});
}
template <unsigned A>
BINOCAL_INLINE Dual<A> chain(double value, const Dual<A>& a, double by_a) {
    return chain(value, a, by_a, Dual<0>{}, 0.0);
}

template <unsigned A, unsigned B>
BINOCAL_INLINE Dual<(A | B)> operator+(const Dual<A>& a, const Dual<B>& b) { return chain(a.value + b.value, a, 1.0, b, 1.0); }
template <unsigned A>
BINOCAL_INLINE Dual<A> operator+(double a, const Dual<A>& b) { return chain(a + b.value, b, 1.0); }
template <unsigned A>
BINOCAL_INLINE Dual<A> operator+(const Dual<A>& a, double b) { return chain(a.value + b, a, 1.0); }
template <unsigned A, unsigned B>
BINOCAL_INLINE Dual<(A | B)> operator*(const Dual<A>& a, const Dual<B>& b) { return chain(a.value * b.value, a, b.value, b, a.value); }
template <unsigned A>
BINOCAL_INLINE Dual<A> operator*(double a, const Dual<A>& b) { return chain(a * b.value, b, a); }
template <unsigned A>
BINOCAL_INLINE Dual<A> operator*(const Dual<A>& a, double b) { return chain(a.value * b, a, b); }
template <unsigned A>
BINOCAL_INLINE Dual<A> inverse(const Dual<A>& a) {
    const double i = 1.0 / a.value;
    return chain(i, a, -i * i);
}

// f(t), for an f of one argument that depends on unknowns of its own: f is differentiated by t once, however many unknowns t has.
constexpr int kInner = 31;  // the bit of t within f

namespace dual_detail {
template <unsigned A, std::size_t... k>
BINOCAL_INLINE Dual<(A & ~(1u << kInner))> without_inner(const Dual<A>& a, std::index_sequence<k...>) {
    return {a.value, {a.slope[k]...}};  // the inner bit is the highest
}
}  // namespace dual_detail

template <unsigned A, class Function>
BINOCAL_INLINE auto through(const Dual<A>& t, Function f) {
    const auto y = f(Dual<(1u << kInner)>{t.value, {1.0}});
    const auto own = dual_detail::without_inner(y, std::make_index_sequence<std::remove_cvref_t<decltype(y)>::n - 1>{});
    return chain(y.value, t, y.template by<kInner>(), own, 1.0);
}
template <class Scalar, class Function>
BINOCAL_INLINE Scalar through(Scalar t, Function f) {
    return f(t);
}

// c0 + c1 s + c2 s².
struct Series {
    double c0, c1, c2;
};
BINOCAL_INLINE Series operator+(Series a, Series b) { return {a.c0 + b.c0, a.c1 + b.c1, a.c2 + b.c2}; }
BINOCAL_INLINE Series operator+(double a, Series b) { return {a + b.c0, b.c1, b.c2}; }
BINOCAL_INLINE Series operator*(double a, Series b) { return {a * b.c0, a * b.c1, a * b.c2}; }
BINOCAL_INLINE Series operator*(Series a, Series b) {
    return {a.c0 * b.c0, a.c0 * b.c1 + a.c1 * b.c0, a.c0 * b.c2 + a.c1 * b.c1 + a.c2 * b.c0};
}
BINOCAL_INLINE Series inverse(Series a) {
    const double i = 1 / a.c0, r1 = a.c1 * i, r2 = a.c2 * i;
    return {i, -i * r1, i * (r1 * r1 - r2)};
}

BINOCAL_INLINE double inverse(double a) { return 1.0 / a; }

// The root of a point's squared distance from the axis. On the axis it has no derivative: there it is taken as 1e-100, in a series
// as 1e-8 of the depth, where a lens that is smooth across its axis has the same image to rounding.
BINOCAL_INLINE double radius(double r2, double /*Z*/) { return std::sqrt(r2 + 1e-200); }
template <unsigned A, class Depth>
BINOCAL_INLINE Dual<A> radius(const Dual<A>& r2, const Depth& /*Z*/) {
    const double r = std::sqrt(r2.value + 1e-200);
    return chain(r, r2, 0.5 * (1.0 / r));
}
BINOCAL_INLINE Series radius(Series r2, Series Z) {
    const double r = std::sqrt(1e-16 * Z.c0 * Z.c0 + r2.c0), h = 0.5 / r, c1 = r2.c1 * h;
    return {r, c1, h * (r2.c2 - c1 * c1)};
}

// atan2(y, x) for y > 0 to 2 ulp, without a branch, so that it is computed for whole vectors. Rational approximation of the Cephes
// library (Moshier 1989) on [0, 0.66] after reduction to the first octant and by 45 degrees.
BINOCAL_INLINE double angle(double y, double x) {
    constexpr double quarter = 0.78539816339744830962, rounded_off = 3.061616997868382943e-17;  // pi / 4 and what its rounding lost
    const double a = std::fabs(x), low = y < a ? y : a, high = y < a ? a : y;
    const bool is_wide = low > 0.66 * high;
    const double s = (is_wide ? low - high : low) / (is_wide ? low + high : high), z = s * s;
    const double p = (((-8.750608600031904122785e-1 * z - 1.615753718733365076637e1) * z - 7.500855792314704667340e1) * z -
                      1.228866684490136173410e2) * z - 6.485021904942025371773e1;
    const double q = ((((z + 2.485846490142306297962e1) * z + 1.650270098316988542046e2) * z + 4.328810604912902668951e2) * z +
                      4.853903996359136964868e2) * z + 1.945506571482613964425e2;
    double t = s + s * (z * p / q);
    t = is_wide ? quarter + (t + rounded_off) : t;
    t = y < a ? t : 2 * quarter - (t - 2 * rounded_off);
    return x < 0 ? 4 * quarter - (t - 4 * rounded_off) : t;
}
template <unsigned A, unsigned B>
BINOCAL_INLINE Dual<(A | B)> angle(const Dual<A>& y, const Dual<B>& x) {
    const double i = 1.0 / (y.value * y.value + x.value * x.value);
    return chain(angle(y.value, x.value), y, x.value * i, x, -y.value * i);
}
BINOCAL_INLINE Series angle(Series y, Series x) {
    const double i = 1 / (y.c0 * y.c0 + x.c0 * x.c0), n0 = x.c0 * y.c1 - y.c0 * x.c1;
    const double n1 = 2 * (x.c0 * y.c2 - y.c0 * x.c2), d1 = 2 * (y.c0 * y.c1 + x.c0 * x.c1);
    return {angle(y.c0, x.c0), n0 * i, 0.5 * i * (n1 - n0 * d1 * i)};
}

}  // namespace binocal
