// Distant lights: normalize, every angle from zero to the whole sphere (L06), and the delta limit.
#include "light/distant.h"

#include "light_testing.h"

namespace footlight::testing {
namespace {

LightTable distant(double angle, bool normalize, Matrix4 m = {}) {
    DistantLightDesc desc;
    desc.angle = angle;
    desc.normalize = normalize;
    desc.transform = m;
    LightTable table;
    EXPECT_EQ(append_distant(table, desc), "");
    finalize(table, 1);
    return table;
}

double received(const LightTable& table, Vector n) {
    const std::vector<Record> records = draw<FloatV>(table, 0, {1, 2, 3}, 1 << 12);
    double sum = 0;
    for (const Record& r : records) sum += r.radiance * std::max(0.0, dot(r.wi, n)) / r.pdf;
    return sum / (1 << 12);
}

// Emission goes along local -Z: a surface with normal +Z faces it.
TEST(Distant, NormalizedIrradianceDoesNotDependOnTheAngle) {
    const Matrix4 m = rotate(normalize(Vector{1, 1, 0}), 40) * scale({3, 0.5, 7});
    for (const double angle : {0.0, 1e-6, 1e-4, 1e-3, 2e-3, 0.53, 10.0, 90.0, 180.0})
        EXPECT_NEAR(received(distant(angle, true, m), normalize(row(m, 2))), 1, 2e-3) << angle;
}

TEST(Distant, IrradianceIsThatOfItsDisc) {
    for (const double angle : {1e-3, 2e-3, 0.53, 10.0, 90.0, 180.0}) {
        const double sine = std::sin(angle / 2 * kPi / 180);
        EXPECT_NEAR(received(distant(angle, false), {0, 0, 1}) / (kPi * sine * sine), 1, 2e-3) << angle;
    }
}

// Above a hemisphere UsdLux divides by (2 - sin^2) pi.
TEST(Distant, WiderThanAHemisphere) {
    for (const double angle : {200.0, 270.0, 360.0, 720.0}) {
        const double theta = std::min(angle / 2, 180.0) * kPi / 180, sin2 = std::sin(theta) * std::sin(theta);
        EXPECT_NEAR(received(distant(angle, true), {0, 0, 1}) * (2 - sin2), 1, 2e-3) << angle;
    }
}

TEST(Distant, ZeroAngleIsADeltaLightThatNoRayFinds) {
    const LightTable table = distant(0, false);
    for (const Record& r : draw<FloatV>(table, 0, {0, 0, 0}, 64)) {
        EXPECT_TRUE(r.valid && r.is_delta);
        EXPECT_EQ(r.pdf, 1);
        EXPECT_EQ(r.radiance, 1);
        EXPECT_EQ(r.wi.z, 1);
        EXPECT_EQ(r.distance, INFINITY);
    }
    EXPECT_EQ(escape_light<float>(table, 0, {0, 0, 1}).pdf, 0);
    EXPECT_EQ(escape_light<float>(table, 0, {0, 0, 1}).radiance.r, 0);
    EXPECT_FALSE(draw<float>(distant(0.53, false), 0, {0, 0, 0}, 16)[0].is_delta);
}

// What rays find: the cone, with its measure. Directions spread over a wider cone hit the share that it fills.
TEST(Distant, EscapingRaysSeeTheConeAndNothingElse) {
    for (const double angle : {0.1, 0.53, 30.0, 180.0, 300.0}) {
        const LightTable table = distant(angle, false);
        const double cover = std::sin(angle / 4 * kPi / 180), k_max = std::min(2.0, 2 * cover * cover * 3);
        double seen = 0;
        constexpr std::uint32_t count = 1 << 14;
        for (std::uint32_t i = 0; i < count; ++i) {
            const Uniform2<float> q = point(7, i);
            const double k = k_max * double{q.u}, sine = std::sqrt(k * (2 - k)), phi = 2 * kPi * double{q.v};
            seen += found<float>(table, 0, {}, {sine * std::cos(phi), sine * std::sin(phi), 1 - k}, 0).radiance.r;
        }
        EXPECT_NEAR(seen / count * k_max / (2 * cover * cover), 1, 2e-3) << angle;
    }
}

// The rim of the cone is still inside it, whatever the rounding of the direction.
TEST(Distant, TheRimIsFound) {
    for (const double angle : {2e-3, 0.01, 0.53, 10.0, 180.0, 359.0})
        for (const Matrix4& m : {Matrix4{}, rotate(normalize(Vector{1, 2, 3}), 123)}) {
            const LightTable table = distant(angle, false, m);
            for (std::uint32_t i = 0; i < 1000; ++i) {
                const auto s = sample_light<float>(table, 0, {0, 0, 0}, 1 - 0x1p-24F, point(1, i).u);
                ASSERT_EQ(escape_light<float>(table, 0, s.wi).pdf, s.pdf) << angle;
            }
        }
}

// The reason for chords: at a fiftieth of the angle of the sun a cone known by its float cosine has lost percents of
// its area.
TEST(Distant, CosineOfASmallAngleHasNoDigits) {
    const double half = 0.01 / 2 * kPi / 180;
    const auto cosine = static_cast<float>(std::cos(half));
    EXPECT_GT(std::abs((1 - double{cosine}) / (2 * std::sin(half / 2) * std::sin(half / 2)) - 1), 0.05);
}

}  // namespace
}  // namespace footlight::testing
