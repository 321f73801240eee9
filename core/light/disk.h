// A disk (or, under an affine map, an ellipse) that emits from one side.
#pragma once

#include "light/light_sample.h"
#include "math/warp.h"

namespace footlight {

// Row: center; u, v the principal axes; n the side that emits; size_u, size_v the semi-axes; density 1 / area.
template <class F>
struct DiskLight {
    static constexpr LightKind kind = LightKind::disk;
    static constexpr bool is_infinite = false;

    static LightSample<F> sample(const LightRow<F>& row, Vec3<F> p, F u0, F u1) {
        const Vec3<F> to_center = row.center - p;
        const Disk<F> q = uniform_disk(u0, u1);
        const Vec3<F> to_point = to_center + row.u * (row.size_u * q.x) + row.v * (row.size_v * q.y);
        const F distance = length(to_point);
        const LightHit<F> found = answer(row, to_center, distance);
        return {to_point * (F(1) / distance), distance, found.radiance, found.pdf, found.pdf > F(0), Mask<F>(false)};
    }

    static LightHit<F> hit(const LightRow<F>& row, Vec3<F> p, Vec3<F> /*wi*/, F distance) {
        return answer(row, row.center - p, distance);
    }

    // Distance along the unit direction d, or infinity.
    static F intersect(const LightRow<F>& row, Vec3<F> o, Vec3<F> d) {
        const Vec3<F> to_center = row.center - o;
        const F t = dot(to_center, row.n) / dot(d, row.n);
        const Vec3<F> q = d * t - to_center;
        const F a = dot(q, row.u) / row.size_u, b = dot(q, row.v) / row.size_v;
        return select(both(a * a + b * b <= F(1), both(t > F(0), is_finite(t))), t, infinity<F>());
    }

  private:
    static LightHit<F> answer(const LightRow<F>& row, Vec3<F> to_center, F distance) {
        const F height = -dot(to_center, row.n);  // of the shaded point above the emitting side
        return hit_where(height > F(0), row.radiance, area_density(row, height, distance));
    }
};

}  // namespace footlight
