// Sphere lights: far and small (L01), near and inside (L02), and rays that must find them from afar (G15).
#include "light/sphere.h"

#include "light_testing.h"

namespace footlight::testing {
namespace {

LightTable sphere(double radius, Matrix4 m = {}) {
    SphereLightDesc desc;
    desc.radius = radius;
    desc.transform = m;
    LightTable table;
    EXPECT_EQ(append_sphere(table, desc), "");
    finalize(table, 1);
    return table;
}

// Seen from outside, by a receiver that faces its centre: E = pi r^2 / d^2, however near or far.
TEST(Sphere, IrradianceFarAway) {
    for (const double ratio : {0.9, 0.5, 0.1, 1e-2, 1e-3, 3e-4, 1e-4, 1e-5, 1e-6, 1e-7})
        for (const double unit : {0x1p-10, 1.0, 0x1p10}) {
            const LightTable table = sphere(ratio * unit);
            const Vector p{0.6 * unit, 0, -0.8 * unit};
            const double expected = kPi * ratio * ratio;
            EXPECT_NEAR(irradiance(draw<FloatV>(table, 0, p, 1024), normalize(-p)) / expected, 1, 2e-3) << ratio;
            EXPECT_NEAR(irradiance(draw<float>(table, 0, p, 1024), normalize(-p)) / expected, 1, 2e-3) << ratio;
        }
    // the test rejects the naive solid angle 2 pi (1 - cos)
    const float sine = 3e-4F, naive = 1 - std::sqrt(1 - sine * sine);
    EXPECT_GT(std::abs(naive / (0.5F * sine * sine) - 1), 0.1F);
}

TEST(Sphere, IrradianceNearTheSurface) {
    const LightTable table = sphere(1);
    for (const double gap : {1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7}) {
        const double d = double{static_cast<float>(1 + gap)};
        const std::vector<Record> records = draw<FloatV>(table, 0, {0, d, 0}, 1 << 12);
        for (const Record& r : records) ASSERT_TRUE(std::isfinite(r.pdf) && std::isfinite(r.wi.x) && r.distance >= 0);
        if (d > 1) {
            EXPECT_NEAR(irradiance(records, {0, -1, 0}) / (kPi / (d * d)), 1, 5e-3) << gap;
        }
    }
}

TEST(Sphere, InsideIsDark) {
    const LightTable table = sphere(1);
    for (const double d : {0.0, 0.5, 1 - 1e-6, 1.0}) {
        for (const Record& r : draw<FloatV>(table, 0, {0, 0, d}, 64)) EXPECT_FALSE(r.valid);
        const LightHit<double> hit = found<float>(table, 0, {0, 0, d}, {0, 1, 0}, 1);
        EXPECT_EQ(hit.pdf, 0);
        EXPECT_EQ(hit.radiance.r, 0);
    }
}

// The drawn distance ends on the sphere: it is not found again by intersection, and never behind the centre.
TEST(Sphere, SampledPointsLieOnTheNearSide) {
    for (const double d : {1.001, 1.5, 10.0, 1e3, 1e5}) {
        const LightTable table = sphere(1);
        for (const Record& r : draw<float>(table, 0, {0, 0, d}, 256)) {
            const Vector q = Vector{0, 0, d} + r.wi * r.distance;
            EXPECT_NEAR(length(q), 1, 3e-7 * d + 2e-6) << d;  // the rounding of wi, at that distance
            EXPECT_LE(r.distance, d * (1 + 1e-6));
        }
    }
}

TEST(Sphere, ScaleFoldsIntoTheRadius) {
    const Matrix4 m = rotate(normalize(Vector{1, 1, 0}), 50) * scale({3, 3, 3});
    EXPECT_NEAR(broadcast_row<double>(sphere(0.5, m), 0).size_u, 1.5, 1e-6);
    EXPECT_TRUE(sphere(0.5, m).info[0].note.empty());
    const LightTable squashed = sphere(0.5, scale({1, 2, 3}));
    EXPECT_FALSE(squashed.info[0].note.empty());
}

// t of the nearer root, as a textbook has it.
float naive_intersect(Vec3<float> center, float r, Vec3<float> o, Vec3<float> d) {
    const Vec3<float> f = o - center;
    const float b = 2 * dot(f, d), c = dot(f, f) - r * r, discriminant = b * b - 4 * c;
    return discriminant < 0 ? INFINITY : (-b - std::sqrt(discriminant)) / 2;
}

// Not inlined: GCC 12 otherwise vectorises away the rounding when the result is widened again.
[[gnu::noinline]] Vec3<float> rounded(Vector v) { return number<float>(v); }

template <class F>
void expect_hits_from_afar() {
    const LightTable table = sphere(1);
    constexpr std::uint32_t count = 1 << 14;
    for (const double d : {10.0, 1e2, 1e3, 1e4, 1e5, 1e6}) {
        std::uint32_t missed = 0, aimed = 0, naive_missed = 0;
        for (std::uint32_t i = 0; i < count; ++i) {
            const Uniform2<float> a = point(3, i), b = point(4, i);
            const Vector target{0.99 * std::sqrt(double{a.u}) * std::cos(6.2831853 * a.v),
                                0.99 * std::sqrt(double{a.u}) * std::sin(6.2831853 * a.v), 0};
            const Matrix4 turn = rotate({1, 0, 0}, 360 * double{b.u}) * rotate({0, 1, 0}, 360 * double{b.v});
            const Vec3<float> o = rounded(transform_vector(turn, {0, 0, d}));
            const Vector exact_o{double{o.x}, double{o.y}, double{o.z}};
            const Vec3<float> w = rounded(normalize(transform_vector(turn, target) - exact_o));
            // the float ray itself, in double: rounding wi may have turned it away
            const Vector unit = normalize(Vector{double{w.x}, double{w.y}, double{w.z}});
            const double b_exact = -dot(exact_o, unit);
            const Vector closest = exact_o + unit * b_exact;
            const double l2 = length_squared(closest);
            if (l2 > 0.999) continue;
            ++aimed;
            const auto t = lane_of<F>(intersect_light<F>(table, 0, broadcast<F>(o), broadcast<F>(w)), 0);
            if (!(t < 1e30)) {
                ++missed;
                continue;
            }
            EXPECT_NEAR(t, b_exact - std::sqrt(1 - l2), 4e-7 * d + 1e-3);
            if (!(naive_intersect({0, 0, 0}, 1, o, w) < 1e30F)) ++naive_missed;
        }
        EXPECT_GT(aimed, count / 2);
        EXPECT_LE(missed, aimed / 10000) << d;
        if (d == 1e4) {
            EXPECT_GT(naive_missed, aimed / 10);  // the test rejects the textbook quadratic
        }
    }
}
TEST(Sphere, RaysFindItFromAfar) {
    expect_hits_from_afar<float>();
    expect_hits_from_afar<FloatV>();
}

TEST(Sphere, RaysFromInsideFindTheFarSideAndBackwardRaysNothing) {
    const LightTable table = sphere(1);
    EXPECT_FLOAT_EQ(intersect_light<float>(table, 0, {0, 0, 0}, {0, 0, 1}), 1.0F);
    EXPECT_EQ(intersect_light<float>(table, 0, {0, 0, 2}, {0, 0, 1}), INFINITY);
    EXPECT_EQ(intersect_light<float>(table, 0, {0, 2, 2}, {0, 0, -1}), INFINITY);
}

}  // namespace
}  // namespace footlight::testing
