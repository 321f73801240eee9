// A light at infinity: a cone of parallel radiance, or one direction when its angle is zero.
#pragma once

#include "light/light_sample.h"
#include "math/frame.h"
#include "math/warp.h"

namespace footlight {

// Row: n towards the light, u, v across; size_u = 1 - cos of half the angle, 0 for a delta light; density 1 / solid
// angle [1/sr]; radiance, for a delta light the irradiance on a surface that faces it.
template <class F>
struct DistantLight {
    static constexpr LightKind kind = LightKind::distant;
    static constexpr bool is_infinite = true;
    // Half angles [rad] below this are delta lights: float directions could not tell the cone from its axis.
    static constexpr double kDeltaAngle = 0x1p-16;

    static LightSample<F> sample(const LightRow<F>& row, Vec3<F> /*p*/, F u0, F u1) {
        const Vec3<F> wi = to_world(Frame<F>{row.u, row.v, row.n}, uniform_cone(u0, u1, row.size_u));
        const Mask<F> is_delta = row.size_u == F(0);
        return {wi, infinity<F>(), row.radiance, select(is_delta, F(1), row.density), row.density > F(0), is_delta};
    }

    // The length of the chord between wi and the axis tells the angle with all its digits, which its cosine does not.
    // The margin covers the rounding of two unit vectors, so that every sampled direction is inside.
    static LightHit<F> escape(const LightRow<F>& row, Vec3<F> wi) {
        const F chord = length(wi - row.n), limit = sqrt(F(2) * row.size_u) + F(0x1p-22F);
        return hit_where(both(chord <= limit, row.size_u > F(0)), row.radiance, row.density);
    }
};

}  // namespace footlight
