// Tools for the light tests: samples drawn by any number type, recorded in double, and what to ask of them.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <string>
#include <vector>

#include "light/light.h"
#include "math/sampler.h"

namespace footlight::testing {

using Vector = Vec3<double>;

struct Record {
    Vector wi;
    double distance, radiance, pdf;  // radiance: red
    bool valid, is_delta;
    double u0, u1;
};

template <class F>
inline F spread(const std::array<float, kLanes>& lanes, int lane) {
    if constexpr (is_batch<F>)
        return F::load_unaligned(lanes.data());
    else
        return static_cast<F>(lanes[lane]);
}
template <class F>
inline double lane_of(F x, int lane) {
    if constexpr (is_batch<F>)
        return double{x.get(static_cast<std::size_t>(lane))};
    else
        return static_cast<double>(x);
}
template <class F>
inline bool lane_of_mask(Mask<F> m, int lane) {
    return lane_of<F>(select(m, F(1), F(0)), lane) != 0;
}

template <class F>
inline Vec3<F> number(Vector v) {
    using S = std::conditional_t<std::is_same_v<F, double>, double, float>;
    return {F(static_cast<S>(v.x)), F(static_cast<S>(v.y)), F(static_cast<S>(v.z))};
}

// The points of an Owen-scrambled Sobol' sequence, fixed by its seed.
inline Uniform2<float> point(std::uint32_t seed, std::uint32_t index) {
    return sample_2d<float>({mix_bits(seed + 17U), reverse_bits(index)}, 1, Dim::light_uv);
}

// Independent points, for tests that count.
inline Uniform2<float> independent_point(std::uint32_t seed, std::uint32_t index) {
    const std::uint32_t first = mix_bits(mix_bits(seed) + index);
    return {to_unit<float>(first), to_unit<float>(mix_bits(first + 0x9e3779b9U))};
}

// count samples of one light seen from p. A multiple of the lanes.
template <class F>
inline std::vector<Record> draw(const LightTable& table, std::uint32_t light, Vector p, std::uint32_t count,
                                Uniform2<float> (*points)(std::uint32_t, std::uint32_t) = point,
                                std::uint32_t seed = 1) {
    constexpr int lanes = is_batch<F> ? kLanes : 1;
    std::vector<Record> records;
    records.reserve(count);
    for (std::uint32_t i = 0; i < count; i += lanes) {
        std::array<float, kLanes> u{}, v{};
        for (int k = 0; k < lanes; ++k) {
            const Uniform2<float> q = points(seed, i + static_cast<std::uint32_t>(k));
            u[k] = q.u;
            v[k] = q.v;
        }
        const LightSample<F> s = sample_light<F>(table, UInt<F>(light), number<F>(p), spread<F>(u, 0), spread<F>(v, 0));
        for (int k = 0; k < lanes; ++k)
            records.push_back({{lane_of(s.wi.x, k), lane_of(s.wi.y, k), lane_of(s.wi.z, k)},
                               lane_of(s.distance, k),
                               lane_of(s.radiance.r, k),
                               lane_of(s.pdf, k),
                               lane_of_mask<F>(s.valid, k),
                               lane_of_mask<F>(s.is_delta, k),
                               double{u[k]},
                               double{v[k]}});
    }
    return records;
}

// What a diffuse white receiver with normal n gets, over pi: the mean of radiance cos / pdf.
inline double irradiance(const std::vector<Record>& records, Vector n) {
    double sum = 0;
    for (const Record& r : records)
        if (r.valid) sum += r.radiance * std::max(0.0, dot(r.wi, n)) / r.pdf;
    return sum / static_cast<double>(records.size());
}

// The answer of the light to a ray that found it along wi.
template <class F>
inline LightHit<double> found(const LightTable& table, std::uint32_t light, Vector p, Vector wi, double distance) {
    using S = std::conditional_t<std::is_same_v<F, double>, double, float>;
    const bool is_infinite = std::find(table.infinite.begin(), table.infinite.end(), light) != table.infinite.end();
    const LightHit<F> hit =
        is_infinite ? escape_light<F>(table, light, number<F>(wi))
                    : hit_light<F>(table, UInt<F>(light), number<F>(p), number<F>(wi), F(static_cast<S>(distance)));
    return {{lane_of(hit.radiance.r, 0), lane_of(hit.radiance.g, 0), lane_of(hit.radiance.b, 0)}, lane_of(hit.pdf, 0)};
}

inline Matrix4 translate(Vector t) {
    Matrix4 m;
    m.m[3] = {t.x, t.y, t.z, 1};
    return m;
}
inline Matrix4 scale(Vector s) {
    Matrix4 m;
    m.m[0][0] = s.x;
    m.m[1][1] = s.y;
    m.m[2][2] = s.z;
    return m;
}
// Right-handed, angle in degrees, about a unit axis: row vectors, p' = p * M.
inline Matrix4 rotate(Vector axis, double degrees) {
    const double a = degrees * kPi / 180, c = std::cos(a), s = std::sin(a);
    const auto turned = [&](Vector v) { return v * c + cross(axis, v) * s + axis * (dot(axis, v) * (1 - c)); };
    Matrix4 m;
    const std::array<Vector, 3> rows{turned({1, 0, 0}), turned({0, 1, 0}), turned({0, 0, 1})};
    for (int i = 0; i < 3; ++i) m.m[i] = {rows[i].x, rows[i].y, rows[i].z, 0};
    return m;
}

// Midpoint rule over the unit square.
inline double integrate(int steps, const std::function<double(double, double)>& f) {
    double sum = 0;
    for (int i = 0; i < steps; ++i)
        for (int j = 0; j < steps; ++j) sum += f((i + 0.5) / steps, (j + 0.5) / steps);
    return sum / (static_cast<double>(steps) * steps);
}

// Irradiance / radiance at p, normal n, from a surface patch given by its points, its normals and area elements.
struct SurfacePoint {
    Vector position, normal;
    double area;  // per unit square of parameters
};
inline double irradiance_by_quadrature(Vector p, Vector n, int steps,
                                       const std::function<SurfacePoint(double, double)>& surface) {
    return integrate(steps, [&](double a, double b) {
        const SurfacePoint s = surface(a, b);
        const Vector d = s.position - p;
        const double d2 = length_squared(d), r = std::sqrt(d2);
        return std::max(0.0, dot(d, n) / r) * std::max(0.0, -dot(d, s.normal) / r) / d2 * s.area;
    });
}

}  // namespace footlight::testing
