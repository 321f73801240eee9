// Disk lights: irradiance against the closed form (L05), ellipses against quadrature (L23), rays that find them.
#include "light/disk.h"

#include "light_testing.h"

namespace footlight::testing {
namespace {

LightTable disk(double radius, Matrix4 m = {}) {
    DiskLightDesc desc;
    desc.radius = radius;
    desc.transform = m;
    LightTable table;
    EXPECT_EQ(append_disk(table, desc), "");
    finalize(table, 1);
    return table;
}

TEST(Disk, IrradianceOnTheAxis) {
    for (const double radius : {0.1, 0.5, 1.0, 3.0, 1e-3, 1e-6})
        for (const double turn : {0.0, 33.0}) {
            const Matrix4 m = rotate(normalize(Vector{1, 2, 3}), turn);
            const double expected = kPi * radius * radius / (1 + radius * radius);
            const auto records = draw<FloatV>(disk(radius, m), 0, transform_vector(m, {0, 0, -1}), 1 << 14);
            EXPECT_NEAR(irradiance(records, transform_vector(m, {0, 0, 1})) / expected, 1, 2e-3) << radius;
        }
}

// A circle turned, then stretched: the ellipse's axes are not the images of the disk's.
TEST(Disk, AffineImagesMatchQuadrature) {
    for (const Matrix4& m : {scale({1, 3, 1}), rotate({0, 0, 1}, 30) * scale({1, 3, -2}),
                             rotate({0, 0, 1}, 45) * scale({2, 1, 1}) * rotate({1, 0, 0}, 70)}) {
        const LightTable table = disk(0.5, m);
        const Vector u = row(m, 0) * 0.5, v = row(m, 1) * 0.5, c = cross(u, v);
        const Vector n = normalize(c) * (determinant(m) < 0 ? 1.0 : -1.0);
        const Vector p = n * 0.9 + u * 0.5, receiver = normalize(u * 0.2 - n);
        const double expected = irradiance_by_quadrature(p, receiver, 300, [&](double a, double b) {
            const double rho = std::sqrt(a), phi = 2 * kPi * b;
            return SurfacePoint{u * (rho * std::cos(phi)) + v * (rho * std::sin(phi)), n, kPi * length(c)};
        });
        EXPECT_NEAR(irradiance(draw<FloatV>(table, 0, p, 1 << 14), receiver) / expected, 1, 2e-3);
        // every sampled point is on the surface that rays find, and nowhere else
        for (const Record& r : draw<double>(table, 0, p, 256)) {
            ASSERT_TRUE(r.valid);
            if (r.u0 < 0.999) {
                EXPECT_NEAR(intersect_light<double>(table, 0, p, r.wi) / r.distance, 1, 1e-5);
            }
        }
        const LightBounds box = light_bounds(table, 0);
        for (const Record& r : draw<float>(table, 0, p, 256)) {
            const Vector q = p + r.wi * r.distance;
            EXPECT_TRUE(q.x >= double{box.lower.x} && q.x <= double{box.upper.x} && q.y >= double{box.lower.y} &&
                        q.y <= double{box.upper.y} && q.z >= double{box.lower.z} && q.z <= double{box.upper.z});
        }
    }
}

TEST(Disk, BehindItIsDark) {
    const LightTable table = disk(1);
    for (const double z : {1e-6, 1e-3, 1.0, 1e3})
        for (const Record& r : draw<FloatV>(table, 0, {0.2, 0.1, z}, 64)) EXPECT_FALSE(r.valid);
    EXPECT_EQ(found<float>(table, 0, {0.2, 0.1, 1}, {0, 0, -1}, 1).pdf, 0);
}

}  // namespace
}  // namespace footlight::testing
