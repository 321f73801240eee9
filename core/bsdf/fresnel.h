// Fresnel reflectance: Schlick's form between two colours, and the reflectance at normal incidence of a dielectric.
#pragma once

#include "math/vec.h"

namespace footlight {

// (1 - cos)^5, the share of f90. cos in [0, 1]. Schlick 1994, eq. 15.
template <class F>
inline F schlick_weight(F cos) {
    const F m = max(F(1) - cos, F(0));
    const F m2 = m * m;
    return m2 * m2 * m;
}

// f0 at cos = 1, f90 at cos = 0.
template <class F>
inline Rgb<F> schlick_fresnel(Rgb<F> f0, Rgb<F> f90, F cos) {
    const F w = schlick_weight(cos);
    return {fma(f90.r - f0.r, w, f0.r), fma(f90.g - f0.g, w, f0.g), fma(f90.b - f0.b, w, f0.b)};
}

// Reflectance at normal incidence of a smooth dielectric; ior: relative index of refraction, > 0. 0 at ior = 1.
template <class F>
inline F dielectric_f0(F ior) {
    const F r = (ior - F(1)) / (ior + F(1));
    return r * r;
}

}  // namespace footlight
