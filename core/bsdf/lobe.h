// What a lobe is: the conventions of core/bsdf, the results of its two functions, and the list of all lobes.
//
// Space      local shading frame, normal +Z; wo (towards the viewer) and wi (towards the light) are unit and point
//            away from the surface. Every lobe here reflects: wo.z > 0 and wi.z > 0, or the answer is black.
// f          includes |cos(theta_i)|, [1/sr]: radiance out = integral of f * radiance in over wi.
// pdf        per solid angle of wi, [1/sr]; integrates to the probability that sample() returns a valid direction.
// sample     takes two numbers of [0, 1); valid is false where the drawn direction leaves through the surface. Such a
//            sample is a real outcome of value 0: it must be counted as a sample, not drawn again.
// weight     f / pdf from eval(wo, wi) of the sampled wi: one formula for both strategies of MIS.
// delta      is_delta lobes have no density: eval is black with pdf 0, weight(wo) is f / pdf of the only direction.
// albedo     directional albedo, the integral of f over wi: for choosing lobes and for stacking layers; in [0, 1].
// reciprocal f(wo, wi) / wi.z is symmetric for lambert and mirror. ggx multiplies its symmetric single scattering by a
//            factor of wo alone (Turquin 2019), see ggx.h.
#pragma once

#include <tuple>

#include "math/vec.h"

namespace footlight {

template <class F>
struct LobeEval {
    Rgb<F> f;  // f * |cos(theta_i)| [1/sr]
    F pdf;     // [1/sr]
};

template <class F>
struct LobeSample {
    Vec3<F> wi;
    Mask<F> valid;
};

template <class L, class F>
concept Lobe = requires(const L lobe, Vec3<F> w, F x) {
                   { lobe.eval(w, w) } -> std::same_as<LobeEval<F>>;
                   { lobe.sample(w, x, x) } -> std::same_as<LobeSample<F>>;
                   { lobe.albedo(x) } -> std::same_as<Rgb<F>>;
                   { L::is_delta } -> std::convertible_to<bool>;
               };

template <class F>
struct Lambert;
template <class F>
struct GgxReflection;
template <class F>
struct Mirror;

// Every lobe there is; tests fold over this list.
template <class F>
using Lobes = std::tuple<Lambert<F>, GgxReflection<F>, Mirror<F>>;

}  // namespace footlight
