// The isotropic GGX microfacet distribution: density, Smith masking, visible normals, and single scattering without
// Fresnel. Written without 1 - c^2, tangents or unit half vectors, so that it holds from alpha = 1e-6 to 1.
#pragma once

#include "math/warp.h"

namespace footlight {

// Below this, float directions no longer resolve the lobe: render a Mirror instead.
inline constexpr double kGgxMinAlpha = 1e-4;

// Density of normals, in the vector form; h: half vector of any length, n = |h|^2.
// D = n^2 / (pi alpha^2 ((hx^2 + hy^2) / alpha^2 + hz^2)^2) [1/sr]. Walter et al. 2007, eq. 33.
template <class F>
inline F ggx_d(Vec3<F> h, F n, F alpha) {
    const F alpha2 = alpha * alpha;
    const F ratio = n / fma(h.x, h.x, fma(h.y, h.y, alpha2 * (h.z * h.z)));
    return alpha2 * F(1 / kPi) * (ratio * ratio);
}

// |(alpha x, alpha y, z)|: the length of w where the distribution is stretched to a hemisphere.
template <class F>
inline F ggx_stretched_length(Vec3<F> w, F alpha) {
    return sqrt(fma(alpha * alpha, fma(w.x, w.x, w.y * w.y), w.z * w.z));
}

// Smith masking of one direction, w.z >= 0. Heitz 2014, eq. 43, with 1 + 2 Lambda = stretched length / z.
template <class F>
inline F ggx_g1(Vec3<F> w, F alpha) {
    return F(2) * w.z / (w.z + ggx_stretched_length(w, alpha));
}

// Height-correlated masking and shadowing divided by 4 cos_o cos_i. Heitz 2014, eq. 99.
template <class F>
inline F ggx_visibility(Vec3<F> wo, Vec3<F> wi, F alpha) {
    return F(0.5) / fma(wo.z, ggx_stretched_length(wi, alpha), wi.z * ggx_stretched_length(wo, alpha));
}

// The spherical cap of visible normals that can reflect wo upwards: cut at z = -k z_stretched instead of -z_stretched.
// All members share the factor m, which saves the division in k = l / m. Eto and Tokuyoshi 2023, eq. 5.
template <class F>
struct GgxCap {
    F m;          // s^2 + alpha^2 cos_o^2, s = 1 + sin_o; in [1, 5]
    F stretched;  // m * stretched length of wo
    F k_cos;      // m * k * cos_o
    F rest_cos;   // m * (1 - k) * cos_o, without cancellation
};
template <class F>
inline GgxCap<F> ggx_cap(Vec3<F> wo, F alpha) {
    const F alpha2 = alpha * alpha;
    const F sin2 = fma(wo.x, wo.x, wo.y * wo.y);
    const F cos2 = wo.z * wo.z;
    const F s = F(1) + sqrt(sin2);
    const F s2 = s * s;
    const F m = fma(alpha2, cos2, s2);
    return {m, m * sqrt(fma(alpha2, sin2, cos2)), (F(1) - alpha2) * s2 * wo.z, alpha2 * (s2 + cos2) * wo.z};
}

// A visible normal as seen from wo (wo.z >= 0), drawn over the cap; not of unit length, z > 0.
// Dupuy and Benyoub 2023, listing 3, scaled by cap.stretched: stretched wo plus a point on the cap.
template <class F>
inline Vec3<F> ggx_sample_half(Vec3<F> wo, F alpha, F u0, F u1) {
    const GgxCap<F> cap = ggx_cap(wo, alpha);
    const F height = cap.stretched + cap.k_cos;
    const F depth = u1 * height;  // of the point below the top of the cap
    const F radius = safe_sqrt(depth * (cap.stretched + cap.stretched - depth));
    const SinCos<F> turn = sin_cos_turn(u0);
    const F stretch = alpha * cap.m;
    return {alpha * fma(radius, turn.cos, stretch * wo.x), alpha * fma(radius, turn.sin, stretch * wo.y),
            fma(height, F(1) - u1, cap.rest_cos)};
}

// wo mirrored at a normal of any length.
template <class F>
inline Vec3<F> reflect(Vec3<F> wo, Vec3<F> h) {
    const F scale = F(2) * dot(wo, h) / dot(h, h);
    return {fma(scale, h.x, -wo.x), fma(scale, h.y, -wo.y), fma(scale, h.z, -wo.z)};
}

// Single scattering with Fresnel 1, and the density with which ggx_sample_half + reflect finds wi.
template <class F>
struct GgxSingle {
    F f;      // f * cos_i [1/sr]
    F pdf;    // [1/sr]
    F cos_d;  // between wo and the half vector
};
template <class F>
inline GgxSingle<F> ggx_single_scattering(Vec3<F> wo, Vec3<F> wi, F alpha) {
    const Vec3<F> h = wo + wi;
    const F n = dot(h, h);  // |h|^2 = 4 cos_d^2
    const GgxCap<F> cap = ggx_cap(wo, alpha);
    // f = D cos_i / (2 a), pdf = D m / (2 b): one division for both
    const F a = fma(wo.z * cap.m, ggx_stretched_length(wi, alpha), wi.z * cap.stretched);  // m * a
    const F b = cap.k_cos + cap.stretched;
    const F scale = ggx_d(h, n, alpha) * (F(0.5) * cap.m / (a * b));
    const Mask<F> above = (wo.z > F(0)) & (wi.z > F(0)) & (scale <= F(3.402823466e+38F));
    return {select(above, scale * (wi.z * b), F(0)), select(above, scale * a, F(0)), F(0.5) * sqrt(n)};
}

}  // namespace footlight
