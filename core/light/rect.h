// A rectangle (or, under shear, a parallelogram) that emits from one side.
#pragma once

#include "light/light_sample.h"
#include "math/warp.h"

namespace footlight {

// Row: center; u, v along the edges; n the side that emits; size_u, size_v half the edges; density 1 / area;
// limit: solid angle [sr] above which directions are drawn uniformly in solid angle; infinite for a parallelogram.
template <class F>
struct RectLight {
    static constexpr LightKind kind = LightKind::rect;
    static constexpr bool is_infinite = false;
    // Below this solid angle its error (about 4e-7 sr, from differences of angles in float) is no longer negligible,
    // and uniform sampling of the area is as good. [sr], measured
    static constexpr double kSolidAngleLimit = 3e-3;

    // The rectangle in the frame of its axes, with the foot of p as the origin.
    struct View {
        Vec3<F> to_center;
        F x, y;  // the centre
        F z;     // height of p above the plane, positive on the side that emits
        F x0, x1, y0, y1;
        F begin;  // solid angle up to x0, in the sense of `corner_pair`
        F solid_angle;
    };

    // The quarter plane behind the corner (x, y) covers atan(x y / (z r)); the difference of two taken as one angle.
    static F corner_pair(F x, F z, F y0, F r0, F y1, F r1) {
        const F zr0 = z * r0, zr1 = z * r1, xy0 = x * y0, xy1 = x * y1;
        return atan2(xy1 * zr0 - xy0 * zr1, zr1 * zr0 + xy1 * xy0);
    }

    static View view(const LightRow<F>& row, Vec3<F> p) {
        const Vec3<F> to_center = row.center - p;
        const F x = dot(to_center, row.u), y = dot(to_center, row.v), z = -dot(to_center, row.n);
        View s{to_center, x, y, z, x - row.size_u, x + row.size_u, y - row.size_v, y + row.size_v, F(0), F(0)};
        const F xz0 = s.x0 * s.x0 + z * z, xz1 = s.x1 * s.x1 + z * z, yy0 = s.y0 * s.y0, yy1 = s.y1 * s.y1;
        s.begin = corner_pair(s.x0, z, s.y0, sqrt(xz0 + yy0), s.y1, sqrt(xz0 + yy1));
        s.solid_angle = corner_pair(s.x1, z, s.y0, sqrt(xz1 + yy0), s.y1, sqrt(xz1 + yy1)) - s.begin;
        return s;
    }

    struct Point {
        F x, y;
    };

    // A point of the rectangle, uniform in the solid angle seen from p. Urena, Fajardo, King 2013, "An area-preserving
    // parametrization for spherical rectangles"; x and y are solved from the small complements of sines and cosines,
    // because near the plane of the light these are all close to 1.
    static Point sample_solid_angle(const View& s, F u0, F u1) {
        const F z2 = s.z * s.z, yy0 = s.y0 * s.y0, yy1 = s.y1 * s.y1;
        const F a0 = yy0 + z2, a1 = yy1 + z2, r0 = sqrt(a0), r1 = sqrt(a1);
        // D = |sin| of the elevation of edge y1 less that of edge y0
        const F difference = z2 * (s.y1 - s.y0) * (s.y1 + s.y0) / ((abs(s.y1) * r0 + abs(s.y0) * r1) * (r0 * r1));
        const F beta = fma(u0, s.solid_angle, s.begin);
        const SinCos<F> half = sin_cos_half_pi(beta * F(0.5));
        const Mask<F> same_side = s.y0 * s.y1 > F(0);
        const F q = select(same_side, half.sin * half.sin, half.cos * half.cos);
        const F d2 = difference * difference;
        const F t = d2 - F(2) * q * (d2 + z2 / a0 + z2 / a1) + F(4) * q * q;
        const F x_abs = sqrt(z2 * F(4) * q * (F(1) - q) / max(t, F(0x1p-100F)));
        const F x = clamp(copysign(x_abs, beta), s.x0, s.x1);

        const F xz = x * x + z2, s0 = sqrt(xz + yy0), s1 = sqrt(xz + yy1);
        const F h = fma(u1, s.y1 / s1 - s.y0 / s0, s.y0 / s0);
        const F g0 = xz / (s0 * (s0 + abs(s.y0))), g1 = xz / (s1 * (s1 + abs(s.y1)));
        const F g = max(select(same_side, fma(u1, g1 - g0, g0), F(1) - abs(h)), F(0x1p-100F));
        const F y_abs = (F(1) - g) * sqrt(xz / (g * (F(2) - g)));
        return {x, clamp(copysign(y_abs, h), s.y0, s.y1)};
    }

    static LightSample<F> sample(const LightRow<F>& row, Vec3<F> p, F u0, F u1) {
        const View s = view(row, p);
        const Mask<F> by_solid_angle = s.solid_angle > row.limit;
        F a = fma(F(2) * u0, row.size_u, -row.size_u), b = fma(F(2) * u1, row.size_v, -row.size_v);
        if (any(by_solid_angle)) {
            const Point point = sample_solid_angle(s, u0, u1);
            a = select(by_solid_angle, point.x - s.x, a);
            b = select(by_solid_angle, point.y - s.y, b);
        }
        const Vec3<F> to_point = s.to_center + row.u * a + row.v * b;
        const F distance = length(to_point);
        const LightHit<F> found = answer(row, s, distance);
        return {to_point * (F(1) / distance), distance, found.radiance, found.pdf, found.pdf > F(0), Mask<F>(false)};
    }

    static LightHit<F> hit(const LightRow<F>& row, Vec3<F> p, Vec3<F> /*wi*/, F distance) {
        return answer(row, view(row, p), distance);
    }

  private:
    static LightHit<F> answer(const LightRow<F>& row, const View& s, F distance) {
        const F by_area = area_density(row, s.z, distance);
        const F pdf = select(s.solid_angle > row.limit, F(1) / s.solid_angle, by_area);
        return hit_where(s.z > F(0), row.radiance, pdf);
    }
};

}  // namespace footlight
