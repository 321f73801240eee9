// Cylinder lights: irradiance against quadrature from all around (L05), thin, near, end-on; rays that find them.
#include "light/cylinder.h"

#include "light_testing.h"

namespace footlight::testing {
namespace {

LightTable cylinder(double radius, double length, Matrix4 m = {}) {
    CylinderLightDesc desc;
    desc.radius = radius;
    desc.length = length;
    desc.transform = m;
    LightTable table;
    EXPECT_EQ(append_cylinder(table, desc), "");
    finalize(table, 1);
    return table;
}

double quadrature(double radius, double length, Vector p, Vector n, int steps) {
    return irradiance_by_quadrature(p, n, steps, [&](double a, double b) {
        const double phi = 2 * kPi * a;
        const Vector normal{0, std::cos(phi), std::sin(phi)};
        return SurfacePoint{Vector{(b - 0.5) * length, 0, 0} + normal * radius, normal, 2 * kPi * radius * length};
    });
}

TEST(Cylinder, IrradianceMatchesQuadrature) {
    struct Case {
        double radius, length;
        Vector p, n;
    };
    for (const Case& c :
         {Case{0.5, 2, {0, 0, 3}, {0, 0, -1}}, Case{0.5, 2, {0, 1, 0}, {0, -1, 0}},
          Case{0.5, 2, {0.3, 0.6, 0}, {0, -1, 0}}, Case{0.5, 2, {4, 1, 0}, normalize(Vector{-1, 0.1, 0})},
          Case{0.5, 2, {3, 0.51, 0}, {-1, 0, 0}}, Case{0.01, 10, {0, 1, 1}, {0, -1, 0}},
          Case{0.1, 0.1, {1, 1, 1}, {-1, 0, 0}}, Case{1, 0.01, {0, 0, 4}, {0, 0, -1}}}) {
        const double expected = quadrature(c.radius, c.length, c.p, c.n, 1500);
        for (const double turn : {0.0, 63.0}) {
            const Matrix4 m = rotate(normalize(Vector{1, 2, -1}), turn);
            const LightTable table = cylinder(c.radius, c.length, m);
            const Vector p = transform_vector(m, c.p), n = transform_vector(m, c.n);
            EXPECT_NEAR(irradiance(draw<FloatV>(table, 0, p, 1 << 14), n) / expected, 1, 2e-3)
                << c.radius << " " << c.length << " " << c.p.x;
            EXPECT_NEAR(irradiance(draw<double>(table, 0, p, 1 << 14), n) / expected, 1, 2e-3)
                << c.radius << " " << c.length << " " << c.p.x;
        }
    }
}

// Far away only the projected area counts: 2 r l cos / d^2 for a receiver that faces it.
TEST(Cylinder, FarAwayItIsItsProjectedArea) {
    for (const double d : {1e4, 1e5, 1e6})
        for (const double angle : {0.0, 30.0, 60.0, 85.0}) {
            const Vector p = Vector{std::sin(angle * kPi / 180), 0, std::cos(angle * kPi / 180)} * d;
            const double expected = 2 * 0.5 * 2 * std::cos(angle * kPi / 180) / (d * d);
            const double e = irradiance(draw<FloatV>(cylinder(0.5, 2), 0, p, 4096), normalize(-p));
            EXPECT_NEAR(e / expected, 1, 3e-3) << d << " " << angle;
        }
}

// A very long one, seen from distance a: E = pi r / a on a receiver that faces it.
TEST(Cylinder, InfinitelyLong) {
    for (const double a : {1.01, 2.0, 20.0}) {
        const double e = irradiance(draw<FloatV>(cylinder(1, 1e5), 0, {0, 0, a}, 1 << 14), {0, 0, -1});
        EXPECT_NEAR(e / (kPi / a), 1, 2e-3) << a;
    }
}

TEST(Cylinder, InsideAndEndOnAreDark) {
    const LightTable table = cylinder(0.5, 2);
    for (const Vector p : {Vector{0, 0, 0}, Vector{0, 0.3, 0}, Vector{5, 0.4, 0}, Vector{-3, 0, 0.5}})
        for (const Record& r : draw<FloatV>(table, 0, p, 64)) EXPECT_FALSE(r.valid);
    // in through the open end, onto the inner wall
    const Vector o{3, 0.6, 0}, d = normalize(Vector{-3, -1, 0});
    const auto t = double{intersect_light<float>(table, 0, number<float>(o), number<float>(d))};
    EXPECT_NEAR(t, std::sqrt(10.0) * 1.1, 1e-4);
    EXPECT_EQ(found<float>(table, 0, o, d, t).pdf, 0);
    EXPECT_EQ(found<float>(table, 0, o, d, t).radiance.r, 0);
}

TEST(Cylinder, SampledPointsAreWhereRaysFindThem) {
    for (const Vector p : {Vector{0, 0, 3}, Vector{4, 1, 0}, Vector{0, 0.6, 0}}) {
        const LightTable table = cylinder(0.5, 2);
        for (const Record& r : draw<double>(table, 0, p, 1024)) {
            ASSERT_TRUE(r.valid);
            const bool at_rim = std::abs(r.u0 - 0.5) > 0.499 || std::abs(r.u1 - 0.5) > 0.499;
            if (!at_rim) {
                EXPECT_NEAR(intersect_light<double>(table, 0, p, r.wi) / r.distance, 1, 1e-5);
            }
        }
    }
}

TEST(Cylinder, RaysFindItFromAfar) {
    const LightTable table = cylinder(1, 4);
    for (const double d : {10.0, 1e3, 1e5}) {
        int missed = 0;
        for (std::uint32_t i = 0; i < 4096; ++i) {
            const Uniform2<float> a = point(5, i);
            const Vector target{3.8 * (double{a.u} - 0.5), 1.8 * (double{a.v} - 0.5), 0}, o{0.3 * d, 0.1 * d, 0.95 * d};
            const Vector w = normalize(target - o);
            if (!(intersect_light<float>(table, 0, number<float>(o), number<float>(w)) < 1e30F)) ++missed;
        }
        EXPECT_EQ(missed, 0) << d;
    }
}

}  // namespace
}  // namespace footlight::testing
