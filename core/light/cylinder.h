// An open cylinder that emits outward, without caps, sampled nearly uniformly in solid angle.
#pragma once

#include "light/light_sample.h"
#include "math/warp.h"

namespace footlight {

// Row: center; u the axis; size_u the radius; size_v half the length.
//
// The plane through p across the axis sees the circle under the angle 2 psi_max: psi is drawn uniformly there. At each
// psi the visible surface is a line parallel to the axis at distance h; the sine of the elevation is drawn uniformly
// between its ends. In these coordinates the solid angle is d(sine) d(psi), so the density is exact and bounded.
template <class F>
struct CylinderLight {
    static constexpr LightKind kind = LightKind::cylinder;
    static constexpr bool is_infinite = false;

    struct View {
        Vec3<F> towards, across;  // unit, in the plane through p: to the axis, and at right angles to it
        F distance;               // of p from the axis
        F begin, end;             // of the axis, relative to p, along u
        F psi_max;
        Mask<F> outside;
    };

    static View view(const LightRow<F>& row, Vec3<F> p) {
        const Vec3<F> to_center = row.center - p;
        const F along = dot(to_center, row.u);
        const Vec3<F> to_axis = to_center - row.u * along;
        const F rho = length(to_axis), r = row.size_u;
        const Mask<F> outside = rho > r;
        const Vec3<F> towards = to_axis * (F(1) / select(outside, rho, F(1)));
        const F psi_max = atan2(r, safe_sqrt((rho - r) * (rho + r)));
        return {towards, cross(row.u, towards), rho, along - row.size_v, along + row.size_v, psi_max, outside};
    }

    // The visible line at angle psi.
    struct Line {
        F h;                   // its distance from p, in the plane
        F sin_begin, sin_end;  // elevation of its ends
        F sin_span;            // their difference, without cancellation
    };

    static Line line(const LightRow<F>& row, const View& v, F sin_psi, F cos_psi) {
        const F r = row.size_u, off = v.distance * sin_psi;
        const F h = (v.distance - r) * (v.distance + r) / fma(v.distance, cos_psi, safe_sqrt((r - off) * (r + off)));
        const F hh = h * h, d0 = sqrt(hh + v.begin * v.begin), d1 = sqrt(hh + v.end * v.end);
        const F s0 = v.begin / d0, s1 = v.end / d1;
        const F apart = hh * (F(2) * row.size_v) * (d0 + d1) / (d0 * d1 * (d0 * d1 + hh + v.begin * v.end));
        return {h, s0, s1, select(v.begin * v.end > F(0), apart, s1 - s0)};
    }

    static LightSample<F> sample(const LightRow<F>& row, Vec3<F> p, F u0, F u1) {
        const View v = view(row, p);
        const SinCos<F> psi = sin_cos_half_pi(fma(F(2) * u0, v.psi_max, -v.psi_max));
        const Line l = line(row, v, psi.sin, psi.cos);
        const F sine = fma(u1, l.sin_end - l.sin_begin, l.sin_begin);
        const F cos2 = max((F(1) - sine) * (F(1) + sine), F(0x1p-100F));
        const F x = clamp(l.h * sine / sqrt(cos2), v.begin, v.end);
        const F distance = sqrt(l.h * l.h + x * x), scale = F(1) / distance;
        const Vec3<F> wi = (v.towards * psi.cos + v.across * psi.sin) * (l.h * scale) + row.u * (x * scale);
        const LightHit<F> found = answer(row, v, l);
        return {wi, distance, found.radiance, found.pdf, found.pdf > F(0), Mask<F>(false)};
    }

    static LightHit<F> hit(const LightRow<F>& row, Vec3<F> p, Vec3<F> wi, F distance) {
        const View v = view(row, p);
        const Vec3<F> in_plane = wi - row.u * dot(wi, row.u);
        const F planar = length(in_plane), inverse = F(1) / planar;
        const F sin_psi = dot(in_plane, v.across) * inverse, cos_psi = dot(in_plane, v.towards) * inverse;
        const LightHit<F> found = answer(row, v, line(row, v, sin_psi, cos_psi));
        // Beyond the closest approach to the axis the ray has come in through an open end, and sees the dark inside.
        // The margin is for rounding, at the rim, where near and far side meet.
        const Mask<F> front = distance * planar <= v.distance * cos_psi * F(1 + 0x1p-18);
        return select_hit<F>(front, found, no_light_hit<F>());
    }

    // Distance along the unit direction d to the nearer surface ahead, or infinity.
    static F intersect(const LightRow<F>& row, Vec3<F> o, Vec3<F> d) {
        const Vec3<F> f = row.center - o;
        const F along = dot(f, row.u), slope = dot(d, row.u);
        const Vec3<F> g{residual(f.x, along, row.u.x), residual(f.y, along, row.u.y), residual(f.z, along, row.u.z)};
        const Vec3<F> e{residual(d.x, slope, row.u.x), residual(d.y, slope, row.u.y), residual(d.z, slope, row.u.z)};
        const F planar = length(e);
        const Vec3<F> w = e * (F(1) / planar);
        const F b = dot(g, w);
        Vec3<F> l{residual(g.x, b, w.x), residual(g.y, b, w.y), residual(g.z, b, w.z)};
        l = l - w * dot(l, w);
        const F r = row.size_u, discriminant = r * r - dot(l, l), root = safe_sqrt(discriminant);
        const auto on_surface = [&](F t) {
            return both(both(t > F(0), is_finite(t)), abs(t * slope - along) <= row.size_v);
        };
        const F near = (b - root) / planar, far = (b + root) / planar;
        const F t = select(on_surface(near), near, select(on_surface(far), far, infinity<F>()));
        return select(both(discriminant >= F(0), planar > F(0)), t, infinity<F>());
    }

  private:
    static LightHit<F> answer(const LightRow<F>& row, const View& v, const Line& l) {
        return hit_where(v.outside, row.radiance, F(0.5) / (v.psi_max * l.sin_span));
    }
};

}  // namespace footlight
