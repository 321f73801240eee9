// A sphere that emits outward, sampled uniformly in the cone it fills.
#pragma once

#include "light/light_sample.h"
#include "math/frame.h"
#include "math/warp.h"

namespace footlight {

// Row: center; size_u the radius.
template <class F>
struct SphereLight {
    static constexpr LightKind kind = LightKind::sphere;
    static constexpr bool is_infinite = false;

    // The cone of the sphere seen from p. 1 - cos is kept instead of cos: it has all its digits however far the light.
    struct Cone {
        Vec3<F> to_center;
        F distance, sin2, one_minus_cos;
        Mask<F> outside;
    };

    static Cone cone(const LightRow<F>& row, Vec3<F> p) {
        const Vec3<F> to_center = row.center - p;
        const F distance = length(to_center), sine = row.size_u / distance, sin2 = sine * sine;
        return {to_center, distance, sin2, cone_one_minus_cos(sin2), distance > row.size_u};
    }

    static LightSample<F> sample(const LightRow<F>& row, Vec3<F> p, F u0, F u1) {
        const Cone c = cone(row, p);
        const Vec3<F> local = uniform_cone(u0, u1, c.one_minus_cos);
        const Vec3<F> wi = to_world(make_frame(c.to_center * (F(1) / c.distance)), local);
        // nearer root of the chord, as product over sum of the roots: no difference of nearly equal lengths
        const F sin2 = local.x * local.x + local.y * local.y;
        const F r = row.size_u, chord = r * safe_sqrt(F(1) - sin2 / c.sin2);
        const F distance = (c.distance - r) * (c.distance + r) / fma(c.distance, local.z, chord);
        const LightHit<F> found = answer(row, c);
        return {wi, distance, found.radiance, found.pdf, found.pdf > F(0), Mask<F>(false)};
    }

    static LightHit<F> hit(const LightRow<F>& row, Vec3<F> p, Vec3<F> /*wi*/, F /*distance*/) {
        return answer(row, cone(row, p));
    }

    // Distance along the unit direction d to the nearer surface ahead, or infinity. Closest-approach form (Haines,
    // Gunther, Akenine-Moller 2019, "Precision Improvements for Ray/Sphere Intersection").
    static F intersect(const LightRow<F>& row, Vec3<F> o, Vec3<F> d) {
        const Vec3<F> f = row.center - o;
        const F b = dot(f, d);
        Vec3<F> l{residual(f.x, b, d.x), residual(f.y, b, d.y), residual(f.z, b, d.z)};
        l = l - d * dot(l, d);  // d is unit only up to rounding, and b is far longer than l
        const F r = row.size_u, discriminant = r * r - dot(l, l), root = safe_sqrt(discriminant);
        // the nearer root as product over sum, as sample() has it: b - root loses a short distance to a large sphere
        const F distance = length(f), far = b + root, near = (distance - r) * (distance + r) / far;
        const F t = select(near > F(0), near, far);
        return select(both(discriminant >= F(0), both(t > F(0), is_finite(t))), t, infinity<F>());
    }

  private:
    static LightHit<F> answer(const LightRow<F>& row, const Cone& c) {
        return hit_where(c.outside, row.radiance, uniform_cone_pdf(c.one_minus_cos));
    }
};

}  // namespace footlight
