// The light table: what is pruned (L14), normalisation, negative (L15) and huge (L16) lights, the choice of a light.
#include "light/light_table.h"

#include "light_testing.h"

namespace footlight::testing {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN(), kInfinity = std::numeric_limits<double>::infinity();

template <class Desc>
Desc with_emission(double e) {
    Desc desc;
    desc.emission = {e, e, e};
    return desc;
}

TEST(LightTable, WhatCannotShineIsPrunedWithAReason) {
    LightTable table;
    const auto pruned = [&](const std::string& reason) {
        EXPECT_NE(reason, "");
        EXPECT_EQ(table.size(), 0U);
        EXPECT_TRUE(table.rows.empty());
    };
    for (const double e : {0.0, std::ldexp(1.0, -200), kInfinity, kNan, 1e39}) {
        pruned(append_rect(table, with_emission<RectLightDesc>(e)));
        pruned(append_disk(table, with_emission<DiskLightDesc>(e)));
        pruned(append_sphere(table, with_emission<SphereLightDesc>(e)));
        pruned(append_cylinder(table, with_emission<CylinderLightDesc>(e)));
        pruned(append_distant(table, with_emission<DistantLightDesc>(e)));
        pruned(append_dome(table, with_emission<DomeLightDesc>(e)));
    }
    for (const double size : {0.0, -1.0, kNan, 1e-30}) {
        RectLightDesc rect;
        rect.width = rect.height = size;
        pruned(append_rect(table, rect));
        DiskLightDesc disk;
        disk.radius = size;
        pruned(append_disk(table, disk));
        SphereLightDesc sphere;
        sphere.radius = size;
        pruned(append_sphere(table, sphere));
        CylinderLightDesc cylinder;
        cylinder.radius = cylinder.length = size;
        pruned(append_cylinder(table, cylinder));
    }
    DistantLightDesc distant;
    distant.angle = -1;
    pruned(append_distant(table, distant));
    for (const Matrix4& m : {scale({0, 0, 0}), scale({0, 1, 1}), scale({1, 1, kNan})}) {
        RectLightDesc rect;
        rect.transform = m;
        pruned(append_rect(table, rect));
        CylinderLightDesc cylinder;
        cylinder.transform = m;
        pruned(append_cylinder(table, cylinder));
        SphereLightDesc sphere;
        sphere.transform = m;
        pruned(append_sphere(table, sphere));
        DomeLightDesc dome;
        dome.transform = m;
        pruned(append_dome(table, dome));
    }
    finalize(table, 1);
    EXPECT_EQ(select_light<float>(table, 0.5F).probability, 0);
    EXPECT_EQ(select_light<FloatV>(table, FloatV(0.5F)).probability.get(0), 0);
}

// normalize divides by the world-space area, after the transform.
TEST(LightTable, NormalizeDividesByTheAreaInTheWorld) {
    const Matrix4 m = rotate(normalize(Vector{1, 2, 3}), 20) * scale({2, 2, 2});
    const auto radiance = [&](auto desc, auto append) {
        desc.transform = m;
        desc.normalize = true;
        LightTable table;
        EXPECT_EQ(append(table, desc), "");
        return broadcast_row<double>(table, 0).radiance.r;
    };
    RectLightDesc rect;
    rect.width = 3;
    rect.height = 0.5;
    EXPECT_NEAR(radiance(rect, append_rect) * (3 * 0.5 * 4), 1, 1e-6);
    EXPECT_NEAR(radiance(DiskLightDesc{}, append_disk) * (kPi * 0.25 * 4), 1, 1e-6);
    EXPECT_NEAR(radiance(SphereLightDesc{}, append_sphere) * (4 * kPi * 0.25 * 4), 1, 1e-6);
    EXPECT_NEAR(radiance(CylinderLightDesc{}, append_cylinder) * (2 * kPi * 0.5 * 4), 1, 1e-6);
    EXPECT_EQ(radiance(DomeLightDesc{}, append_dome), 1);
}

LightTable spheres(const std::vector<double>& emissions) {
    LightTable table;
    for (const double e : emissions) EXPECT_EQ(append_sphere(table, with_emission<SphereLightDesc>(e)), "");
    finalize(table, 1);
    return table;
}

TEST(LightTable, ChoiceIsAProbability) {
    for (const auto& emissions :
         {std::vector<double>{1}, {1, 1e12, 1e-6}, {1e-20, 1e30, -1e30, 3}, std::vector<double>(10000, 0.5)}) {
        const LightTable table = spheres(emissions);
        double sum = 0;
        for (std::uint32_t i = 0; i < table.size(); ++i) {
            const auto p = double{select_pmf<float>(table, i)};
            EXPECT_GT(p, 0);
            EXPECT_GE(p, 0.19 / static_cast<double>(table.size()));  // no light is starved
            sum += p;
        }
        EXPECT_NEAR(sum, 1, 1e-5);
        for (const float u : {0.0F, 0x1p-24F, 0.3F, 0.5F, 1 - 0x1p-24F}) {
            const auto chosen = select_light<float>(table, u);
            const auto in_batch = select_light<FloatV>(table, FloatV(u));
            ASSERT_LT(chosen.index, table.size());
            EXPECT_EQ(chosen.probability, select_pmf<float>(table, chosen.index));
            EXPECT_EQ(in_batch.index.get(0), chosen.index);
            EXPECT_EQ(in_batch.probability.get(0), chosen.probability);
        }
    }
}

TEST(LightTable, ChoiceFollowsPower) {
    const LightTable table = spheres({1, 3});
    EXPECT_NEAR(double{select_pmf<float>(table, 1)}, 0.8 * 0.75 + 0.1, 1e-6);
}

// One light takes away what the other gives; chosen by magnitude, their estimates cancel.
TEST(LightTable, NegativeLights) {
    const LightTable table = spheres({1, -1});
    double sum = 0;
    constexpr std::uint32_t count = 4096;
    for (std::uint32_t i = 0; i < count; ++i) {
        const auto chosen = select_light<float>(table, point(1, i).u);
        const Uniform2<float> q = point(2, i);
        const auto s = sample_light<float>(table, chosen.index, {0, 0, 3}, q.u, q.v);
        sum += double{s.radiance.r * std::max(0.0F, -s.wi.z) / (s.pdf * chosen.probability)} / count;
    }
    EXPECT_NEAR(sum, 0, 5e-3);
    EXPECT_EQ(draw<float>(table, 1, {0, 0, 3}, 16)[0].radiance, -1);
}

TEST(LightTable, HugeAndTinyEmissionsStayExact) {
    for (const int k : {-60, 60, 100}) {
        const LightTable table = spheres({std::ldexp(1.0, k)});
        const auto plain = draw<FloatV>(spheres({1}), 0, {0, 0, 3}, 64), bright = draw<FloatV>(table, 0, {0, 0, 3}, 64);
        for (std::size_t i = 0; i < plain.size(); ++i) EXPECT_EQ(bright[i].radiance, std::ldexp(plain[i].radiance, k));
    }
}

// The power of infinite lights is what they send through the disc of the scene.
TEST(LightTable, Powers) {
    LightTable table;
    SphereLightDesc sphere;
    sphere.radius = 0.5;
    DistantLightDesc distant;
    distant.normalize = true;
    EXPECT_EQ(append_sphere(table, sphere), "");
    EXPECT_EQ(append_distant(table, distant), "");
    EXPECT_EQ(append_dome(table, DomeLightDesc{}), "");
    finalize(table, 3);
    EXPECT_NEAR(table.info[0].power, kPi * kPi, 1e-9);
    EXPECT_NEAR(table.info[1].power, kPi * 9, 1e-6);
    EXPECT_NEAR(table.info[2].power, 4 * kPi * kPi * 9, 1e-6);
    EXPECT_EQ(table.finite, std::vector<std::uint32_t>{0});
    EXPECT_EQ(table.infinite, (std::vector<std::uint32_t>{1, 2}));
}

}  // namespace
}  // namespace footlight::testing
