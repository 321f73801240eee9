// What every light kernel reads and answers. The conventions are at the head of light.h.
#pragma once

#include <limits>

#include "math/vec.h"

namespace footlight {

// The closed list of lights. A new one: its name here, its file, its place in LightTypes (light.h) and its append_*.
enum class LightKind : std::uint32_t { rect, disk, sphere, cylinder, distant, dome, triangle };

template <class F>
struct LightSample {
    Vec3<F> wi;       // unit, from the shaded point to the light
    F distance;       // to the light; infinity for distant and dome
    Rgb<F> radiance;  // [power / (area sr)]; for a delta light the irradiance on a surface that faces it
    F pdf;            // [1/sr], without the probability of choosing this light; 1 for a delta light
    Mask<F> valid;    // false: nothing arrives this way, the other fields mean nothing
    Mask<F> is_delta;
};

template <class F>
struct LightHit {
    Rgb<F> radiance;  // that arrives along the ray
    F pdf;            // [1/sr], with which the light's own sampling would have found the same direction
};

// One light as the kernels see it. The meaning of a column is the light's own business, stated in its file.
template <class F>
struct LightRow {
    Vec3<F> center;
    Vec3<F> u, v, n;  // unit axes
    F size_u, size_v;
    F density;
    F limit;
    Rgb<F> radiance;
    F kind;  // LightKind as a number, to compare lanes with
};
inline constexpr std::uint32_t kLightColumns = 20;

template <class F, class Read>
inline LightRow<F> read_light_row(Read column) {
    const auto vector = [&](std::uint32_t i) { return Vec3<F>{column(i), column(i + 1), column(i + 2)}; };
    return {vector(0),  vector(3),  vector(6),
            vector(9),  column(12), column(13),
            column(14), column(15), {column(16), column(17), column(18)},
            column(19)};
}

inline bool both(bool a, bool b) { return a && b; }
template <class A>
inline xsimd::batch_bool<float, A> both(xsimd::batch_bool<float, A> a, xsimd::batch_bool<float, A> b) {
    return a & b;
}

inline bool either(bool a, bool b) { return a || b; }
template <class A>
inline xsimd::batch_bool<float, A> either(xsimd::batch_bool<float, A> a, xsimd::batch_bool<float, A> b) {
    return a | b;
}

template <class F>
inline constexpr F infinity() {
    return F(std::numeric_limits<float>::infinity());
}

template <class F>
inline LightSample<F> select_sample(Mask<F> mask, const LightSample<F>& a, const LightSample<F>& b) {
    const auto merge = [&](Mask<F> x, Mask<F> y) { return either(both(mask, x), both(!mask, y)); };
    return {select(mask, a.wi, b.wi),
            select(mask, a.distance, b.distance),
            select(mask, a.radiance, b.radiance),
            select(mask, a.pdf, b.pdf),
            merge(a.valid, b.valid),
            merge(a.is_delta, b.is_delta)};
}

template <class F>
inline LightHit<F> select_hit(Mask<F> mask, const LightHit<F>& a, const LightHit<F>& b) {
    return {select(mask, a.radiance, b.radiance), select(mask, a.pdf, b.pdf)};
}

template <class F>
inline LightSample<F> no_light_sample() {
    return {{F(0), F(0), F(1)}, F(0), gray(F(0)), F(0), Mask<F>(false), Mask<F>(false)};
}
template <class F>
inline LightHit<F> no_light_hit() {
    return {gray(F(0)), F(0)};
}

// A hit counts only where the light is bright and its density a number.
template <class F>
inline LightHit<F> hit_where(Mask<F> lit, Rgb<F> radiance, F pdf) {
    const Mask<F> counts = both(lit, both(pdf > F(0), is_finite(pdf)));
    return select_hit<F>(counts, {radiance, pdf}, no_light_hit<F>());
}

// Density [1/sr] of a point drawn uniformly over a flat light: distance^2 / (cos * area). height: of the shaded point
// above the light's plane.
template <class F>
inline F area_density(const LightRow<F>& row, F height, F distance) {
    return distance * distance * (distance / height) * row.density;
}

// c - a * b, rounded once also where the hardware has no fma (batches of 4): Dekker 1971 splits the product there.
// Against a small light far away the residual is otherwise all rounding error.
template <class F>
inline F residual(F c, F a, F b) {
    if constexpr (!is_batch<F>) {
        return fma(-a, b, c);
    } else if constexpr (F::size > 4) {
        return fma(-a, b, c);
    } else {
        const auto high = [](F x) {
            const F t = x * F(4097.0F);
            return t - (t - x);
        };
        const F product = a * b, a1 = high(a), b1 = high(b), a2 = a - a1, b2 = b - b1;
        const F error = ((a1 * b1 - product) + a1 * b2 + a2 * b1) + a2 * b2;
        return (c - product) - error;
    }
}

}  // namespace footlight
