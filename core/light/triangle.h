// A triangle of an emissive mesh: emits from both sides.
#pragma once

#include "light/light_sample.h"

namespace footlight {

// Row: center one corner; u, v the unit edges from it; n unit normal; size_u, size_v the edges' lengths; density 1 /
// area.
template <class F>
struct TriangleLight {
    static constexpr LightKind kind = LightKind::triangle;
    static constexpr bool is_infinite = false;

    static LightSample<F> sample(const LightRow<F>& row, Vec3<F> p, F u0, F u1) {
        // Uniform over the area: Turk 1990, "Generating Random Points in Triangles".
        const F root = sqrt(u0), along_u = root * u1, along_v = root - along_u;
        const Vec3<F> to_corner = row.center - p;
        const Vec3<F> to_point = to_corner + row.u * (row.size_u * along_u) + row.v * (row.size_v * along_v);
        const F distance = length(to_point);
        const LightHit<F> found = answer(row, to_corner, distance);
        return {to_point * (F(1) / distance), distance, found.radiance, found.pdf, found.pdf > F(0), Mask<F>(false)};
    }

    static LightHit<F> hit(const LightRow<F>& row, Vec3<F> p, Vec3<F> /*wi*/, F distance) {
        return answer(row, row.center - p, distance);
    }

  private:
    static LightHit<F> answer(const LightRow<F>& row, Vec3<F> to_corner, F distance) {
        const F height = abs(dot(to_corner, row.n));  // of the shaded point above the plane
        return hit_where(height > F(0), row.radiance, area_density(row, height, distance));
    }
};

}  // namespace footlight
