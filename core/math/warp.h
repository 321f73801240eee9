// Maps from the unit square to directions and disks, each with its density. No map can leave its domain by rounding.
#pragma once

#include "math/vec.h"

namespace footlight {

// Sine and cosine for |x| <= pi/2: no range reduction. Absolute error of the float instances <= 1.2e-7.
// Coefficients: minimax fit in x^2 over the interval (absolute error 4.6e-9 and 2.4e-10).
template <class F>
inline SinCos<F> sin_cos_half_pi(F x) {
    if constexpr (std::is_same_v<F, double>) {
        return {std::sin(x), std::cos(x)};
    } else {
        const F y = x * x;
        F s = fma(F(2.600054619e-6F), y, F(-1.980661513e-4F));
        s = fma(s, y, F(8.333017291e-3F));
        s = fma(s, y, F(-1.666665710e-1F));
        F c = fma(F(-2.607710413e-7F), y, F(2.476188618e-5F));
        c = fma(c, y, F(-1.388840351e-3F));
        c = fma(c, y, F(4.166664073e-2F));
        c = fma(c, y, F(-4.999999955e-1F));
        return {fma(s * y, x, x), fma(c, y, F(1))};
    }
}

// Sine and cosine of 2 pi (u - 1/2), u in [0, 1): a uniform angle, by the double-angle formulas.
template <class F>
inline SinCos<F> sin_cos_turn(F u) {
    const SinCos<F> half = sin_cos_half_pi(F(kPi) * (u - F(0.5)));
    const F twice = half.sin + half.sin;
    return {twice * half.cos, fma(-twice, half.sin, F(1))};
}

// --- disk ---
template <class F>
struct Disk {
    F x, y;
    F radius;  // |(x, y)|, exact, in [0, 1]
};
// Uniform on the unit disk; keeps neighbours together. Shirley and Chiu 1997, in the form of Cline (2011).
template <class F>
inline Disk<F> uniform_disk(F u0, F u1) {
    const F a = fma(F(2), u0, F(-1));
    const F b = fma(F(2), u1, F(-1));
    const Mask<F> wide = abs(a) > abs(b);
    const F major = select(wide, a, b);  // signed radius
    const F minor = select(wide, b, a);
    const F ratio = minor / select(major == F(0), F(1), major);
    const SinCos<F> angle = sin_cos_half_pi(F(kPi / 4) * ratio);
    const F along = major * angle.cos;
    const F across = major * angle.sin;
    return {select(wide, along, across), select(wide, across, along), abs(major)};
}
// [1 / area of the disk]
template <class F>
inline F uniform_disk_pdf() {
    return F(1 / kPi);
}

// --- hemisphere ---
// Density cos / pi around +Z. z = 0 happens (at u = 0): such a direction has pdf 0.
template <class F>
inline Vec3<F> cosine_hemisphere(F u0, F u1) {
    const Disk<F> disk = uniform_disk(u0, u1);
    return {disk.x, disk.y, sqrt((F(1) - disk.radius) * (F(1) + disk.radius))};
}
template <class F>
inline F cosine_hemisphere_pdf(F cos) {
    return cos * F(1 / kPi);
}

// --- cone and sphere ---
// Everything about a cone hangs on m = 1 - cos(half angle) in [0, 2], which keeps its digits for narrow cones
// (1 - sqrt(1 - s^2) loses them all at s = 3e-4).
// m of a cone of half angle <= pi/2, from the squared sine of that angle.
template <class F>
inline F cone_one_minus_cos(F sin_squared) {
    return sin_squared / (F(1) + safe_sqrt(F(1) - sin_squared));
}
// Uniform over the solid angle of the cone around +Z.
template <class F>
inline Vec3<F> uniform_cone(F u0, F u1, F one_minus_cos) {
    const F m = u0 * one_minus_cos;
    const F sine = safe_sqrt(m * (F(2) - m));
    const SinCos<F> turn = sin_cos_turn(u1);
    return {sine * turn.cos, sine * turn.sin, F(1) - m};
}
template <class F>
inline F cone_solid_angle(F one_minus_cos) {
    return F(2 * kPi) * one_minus_cos;
}
// one_minus_cos > 0
template <class F>
inline F uniform_cone_pdf(F one_minus_cos) {
    return F(1 / (2 * kPi)) / one_minus_cos;
}
template <class F>
inline Vec3<F> uniform_sphere(F u0, F u1) {
    return uniform_cone(u0, u1, F(2));
}
template <class F>
inline F uniform_sphere_pdf() {
    return F(1 / (4 * kPi));
}

}  // namespace footlight
