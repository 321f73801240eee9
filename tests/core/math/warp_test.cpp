// Laws of math/warp.h: each map has the density it states, stays in its domain, and keeps its digits for narrow cones.
#include "math/warp.h"

#include <gtest/gtest.h>

#include <functional>

#include "math/lanes.h"
#include "math/statistics.h"

namespace footlight::testing {
namespace {

using V = FloatV;
using Map = std::function<Vec3<V>(V, V)>;
// Coordinates in [0, 1)^2 that are uniform if the map has its density.
struct Square {
    double a, b;
};
using Unmap = Square (*)(Vec3<double>);

double turn_of(Vec3<double> w) { return std::atan2(w.y, w.x) / (2 * kPi) + 0.5; }
Square from_disk(Vec3<double> w) { return {w.x * w.x + w.y * w.y, turn_of(w)}; }
Square from_sphere(Vec3<double> w) { return {0.5 - 0.5 * w.z, turn_of(w)}; }

Map disk_map() {
    return [](V u0, V u1) {
        const Disk<V> d = uniform_disk(u0, u1);
        return Vec3<V>{d.x, d.y, V(0)};
    };
}
Map hemisphere_map() {
    return [](V u0, V u1) { return cosine_hemisphere(u0, u1); };
}
Map sphere_map() {
    return [](V u0, V u1) { return uniform_sphere(u0, u1); };
}

// The mutant that forgets the square root: too dense at the centre.
Map linear_radius() {
    return [](V u0, V u1) {
        const SinCos<V> turn = sin_cos_turn(u0);
        return Vec3<V>{u1 * turn.cos, u1 * turn.sin, safe_sqrt(V(1) - u1 * u1)};
    };
}

double uniformity_p(const Map& map, Unmap unmap, std::uint32_t seed) {
    constexpr int kSide = 32, kSamples = 1 << 18;
    std::vector<double> counts(kSide * kSide, 0);
    Uniform uniform(seed);
    for (int i = 0; i < kSamples; i += kLanes) {
        const V u0 = uniform.next<V>();
        const Vec3<V> w = map(u0, uniform.next<V>());
        for (int k = 0; k < kLanes; ++k) {
            const Square s = unmap(lane(w, k));
            const int row = std::clamp(static_cast<int>(s.a * kSide), 0, kSide - 1);
            const int column = std::clamp(static_cast<int>(s.b * kSide), 0, kSide - 1);
            ++counts[static_cast<std::size_t>(row * kSide + column)];
        }
    }
    return chi_squared_uniform_p(counts);
}

TEST(Warp, MapsHaveTheirDensity) {
    const double level = sidak_level(3);
    EXPECT_GT(uniformity_p(disk_map(), from_disk, 1), level);
    EXPECT_GT(uniformity_p(hemisphere_map(), from_disk, 2), level);
    EXPECT_GT(uniformity_p(sphere_map(), from_sphere, 3), level);
    EXPECT_LT(uniformity_p(linear_radius(), from_disk, 1), level) << "the mutant passed";
}

TEST(Warp, DensitiesIntegrateToOne) {
    EXPECT_NEAR(uniform_disk_pdf<double>() * kPi, 1, 1e-15);
    EXPECT_NEAR(uniform_sphere_pdf<double>() * 4 * kPi, 1, 1e-15);
    EXPECT_NEAR(cosine_hemisphere_pdf(0.5) * 2 * kPi, 1, 1e-15);  // mean cosine over the hemisphere: 1/2
    for (const double m : {2.0, 1.0, 1e-3, 1e-12}) EXPECT_NEAR(uniform_cone_pdf(m) * cone_solid_angle(m), 1, 1e-14);
}

// Corners and edges of the unit square as well as its inside.
std::vector<float> edge_numbers() {
    std::vector<float> u{0, 0x1p-24F, 0x1p-20F, 0.25F, 0.5F - 0x1p-24F, 0.5F, 0.75F, 1 - 0x1p-20F, 1 - 0x1p-24F};
    Uniform uniform(4);
    for (int i = 0; i < 200; ++i) u.push_back(uniform.next<float>());
    return u;
}

TEST(Warp, DirectionsAreUnitAtEveryEdge) {
    for (const float u0 : edge_numbers()) {
        for (const float u1 : edge_numbers()) {
            for (const Vec3<V>& w : {cosine_hemisphere(V(u0), V(u1)), uniform_sphere(V(u0), V(u1)),
                                     uniform_cone(V(u0), V(u1), V(1e-8F))}) {
                ASSERT_NEAR(length(lane(w, 0)), 1, 4e-7) << u0 << " " << u1;
            }
            ASSERT_GE(lane(cosine_hemisphere(V(u0), V(u1)).z, 0), 0);
            const Disk<V> d = uniform_disk(V(u0), V(u1));
            ASSERT_LE(lane(d.radius, 0), 1);
            ASSERT_NEAR(std::hypot(lane(d.x, 0), lane(d.y, 0)), lane(d.radius, 0), 2e-7);
        }
    }
}

TEST(Warp, AllNumberTypesAgree) {
    for (const float u0 : edge_numbers()) {
        for (const float u1 : edge_numbers()) {
            const double a = u0, b = u1;
            ASSERT_LE(length(lane(uniform_sphere(V(u0), V(u1)), 0) - uniform_sphere(a, b)), 1e-6);
            ASSERT_LE(length(lane(uniform_sphere(u0, u1), 0) - uniform_sphere(a, b)), 1e-6);
            const Disk<V> d = uniform_disk(V(u0), V(u1));
            const Disk<double> exact = uniform_disk(a, b);
            ASSERT_LE(std::hypot(lane(d.x, 0) - exact.x, lane(d.y, 0) - exact.y), 1e-6);
        }
        const SinCos<V> turn = sin_cos_turn(V(u0));
        const SinCos<double> exact = sin_cos_turn(static_cast<double>(u0));
        ASSERT_LE(std::hypot(lane(turn.sin, 0) - exact.sin, lane(turn.cos, 0) - exact.cos), 4e-7);
    }
}

// The naive form, which cancels.
float cone_by_cosine(float sin_squared) { return 1 - std::sqrt(1 - sin_squared); }

double worst_cone_error(float (*one_minus_cos)(float)) {
    double worst = 0;
    for (float s2 = 1; s2 > 1e-16F; s2 *= 0.3F) {
        const long double exact = s2 / (1 + std::sqrt(1 - static_cast<long double>(s2)));
        worst = std::max(worst, static_cast<double>(std::abs(one_minus_cos(s2) / exact - 1)));
    }
    return worst;
}

TEST(Warp, NarrowConesKeepTheirSolidAngle) {
    EXPECT_LE(worst_cone_error(cone_one_minus_cos<float>), 3e-7);
    EXPECT_GT(worst_cone_error(cone_by_cosine), 0.5) << "the mutant passed";
}

TEST(Warp, ConeSamplesAreUniformAndInside) {
    const double level = sidak_level(4);
    for (const float sin_angle : {1.0F, 0.1F, 1e-3F, 1e-6F}) {
        const float m = cone_one_minus_cos(sin_angle * sin_angle);
        std::vector<double> counts(64, 0);
        Uniform uniform(5);
        for (int i = 0; i < 1 << 17; i += kLanes) {
            const V u0 = uniform.next<V>();
            const Vec3<V> w = uniform_cone(u0, uniform.next<V>(), V(m));
            for (int k = 0; k < kLanes; ++k) {
                // 1 - cos by the sine, which is exact where the cosine has rounded to 1
                const double s2 = lane(w.x, k) * lane(w.x, k) + lane(w.y, k) * lane(w.y, k);
                const double share = cone_one_minus_cos(std::min(s2, 1.0)) / m;
                ASSERT_LE(share, 1 + (sin_angle == 1 ? 1e-3 : 1e-6));
                ++counts[static_cast<std::size_t>(std::clamp(static_cast<int>(share * 64), 0, 63))];
            }
        }
        EXPECT_GT(chi_squared_uniform_p(counts), level) << sin_angle;
    }
}

}  // namespace
}  // namespace footlight::testing
