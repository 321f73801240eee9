// Perfect reflection at a smooth surface: a delta lobe.
#pragma once

#include "bsdf/fresnel.h"
#include "bsdf/lobe.h"

namespace footlight {

template <class F>
struct Mirror {
    static constexpr bool is_delta = true;
    Rgb<F> f0, f90;  // reflectance at normal and at grazing incidence, in [0, 1]

    LobeEval<F> eval(Vec3<F> /*wo*/, Vec3<F> /*wi*/) const { return {gray(F(0)), F(0)}; }

    LobeSample<F> sample(Vec3<F> wo, F /*u0*/, F /*u1*/) const { return {{-wo.x, -wo.y, wo.z}, wo.z > F(0)}; }

    // f * |cos| / pdf of the sampled direction.
    Rgb<F> weight(Vec3<F> wo) const { return albedo(wo.z); }

    Rgb<F> albedo(F cos_o) const { return schlick_fresnel(f0, f90, cos_o); }
};

}  // namespace footlight
