// Rough reflection: GGX microfacets with Schlick's Fresnel and compensation for the light lost to multiple scattering.
#pragma once

#include "bsdf/albedo_table.h"
#include "bsdf/fresnel.h"
#include "bsdf/ggx_distribution.h"
#include "bsdf/lobe.h"

namespace footlight {

// f = single scattering * (1 + f0 (1 - E) / E), E: directional albedo of single scattering at Fresnel 1 (Turquin 2019,
// "Practical multiple scattering compensation for microfacet models", eq. 16). White stays white; a colour saturates.
// The factor depends on wo alone: f(wo, wi) / wi.z / f(wi, wo) * wo.z = factor(wo) / factor(wi).
template <class F>
struct GgxReflection {
    static constexpr bool is_delta = false;
    Rgb<F> f0, f90;  // reflectance at normal and at grazing incidence, in [0, 1]
    F alpha;         // roughness squared, clamped to [kGgxMinAlpha, 1]

    F clamped_alpha() const { return clamp(alpha, F(kGgxMinAlpha), F(1)); }

    // The factor for multiple scattering. Holds for all wi of one wo: a caller with two of them computes it once.
    Rgb<F> compensation(F cos_o) const {
        const F lost = F(1) / ggx_albedo(cos_o, clamped_alpha()) - F(1);
        return {fma(f0.r, lost, F(1)), fma(f0.g, lost, F(1)), fma(f0.b, lost, F(1))};
    }

    LobeEval<F> eval(Vec3<F> wo, Vec3<F> wi) const { return eval(wo, wi, compensation(wo.z)); }

    LobeEval<F> eval(Vec3<F> wo, Vec3<F> wi, Rgb<F> compensation) const {
        const GgxSingle<F> single = ggx_single_scattering(wo, wi, clamped_alpha());
        return {schlick_fresnel(f0, f90, single.cos_d) * compensation * single.f, single.pdf};
    }

    LobeSample<F> sample(Vec3<F> wo, F u0, F u1) const {
        const Vec3<F> wi = reflect(wo, ggx_sample_half(wo, clamped_alpha(), u0, u1));
        const Mask<F> above = (wo.z > F(0)) & (wi.z > F(0));
        return {wi, above};
    }

    Rgb<F> albedo(F cos_o) const {
        const F kept = ggx_albedo(cos_o, clamped_alpha());
        const F share = ggx_schlick_share(cos_o, clamped_alpha());
        const auto channel = [&](F c0, F c90) { return fma(c90 - c0, share, c0) * fma(c0, F(1) - kept, kept); };
        return {channel(f0.r, f90.r), channel(f0.g, f90.g), channel(f0.b, f90.b)};
    }
};

}  // namespace footlight
