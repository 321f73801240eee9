// Ideal diffuse reflection.
#pragma once

#include "bsdf/lobe.h"
#include "math/warp.h"

namespace footlight {

template <class F>
struct Lambert {
    static constexpr bool is_delta = false;
    Rgb<F> reflectance;  // in [0, 1]

    LobeEval<F> eval(Vec3<F> wo, Vec3<F> wi) const {
        const Mask<F> above = (wo.z > F(0)) & (wi.z > F(0));
        const F pdf = select(above, cosine_hemisphere_pdf(wi.z), F(0));
        return {reflectance * pdf, pdf};
    }

    LobeSample<F> sample(Vec3<F> wo, F u0, F u1) const {
        const Vec3<F> wi = cosine_hemisphere(u0, u1);
        const Mask<F> above = (wo.z > F(0)) & (wi.z > F(0));
        return {wi, above};
    }

    Rgb<F> albedo(F /*cos_o*/) const { return reflectance; }
};

}  // namespace footlight
