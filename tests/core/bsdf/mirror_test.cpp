// Laws of bsdf/mirror.h: one direction, and a weight that the directional albedo states.
#include "bsdf/mirror.h"

#include <gtest/gtest.h>

#include "bsdf/lobe_testing.h"

namespace footlight::testing {
namespace {

TEST(Mirror, ReflectsAboutTheNormal) {
    const Mirror<FloatV> mirror{gray(FloatV(0.2F)), gray(FloatV(1.0F))};
    Uniform uniform(41);
    for (int i = 0; i < 100; ++i) {
        const FloatV u = uniform.next<FloatV>();
        const Vec3<FloatV> wo = cosine_hemisphere(u, uniform.next<FloatV>());
        const LobeSample<FloatV> s = mirror.sample(wo, u, u);
        for (int k = 0; k < kLanes; ++k) {
            const Direction o = lane(wo, k), w = lane(s.wi, k);
            ASSERT_TRUE(o.x == -w.x && o.y == -w.y && o.z == w.z);
            ASSERT_EQ(lane_of_mask<FloatV>(s.valid, k), w.z > 0);
            ASSERT_EQ(lane(mirror.weight(wo).r, k), lane(mirror.albedo(wo.z).r, k));
        }
    }
}

// The limit of ggx: the same direction and, within the lobe's width, the same light.
TEST(Mirror, IsTheLimitOfGgx) {
    for (const double cos : {1.0, 0.5, 0.1}) {
        const Rgb<double> f0{0.04, 0.5, 0.9}, f90{1, 1, 1};
        const GgxReflection<double> ggx{f0, f90, kGgxMinAlpha};
        const Mirror<double> mirror{f0, f90};
        const Rgb<double> rough = integrate_albedo(ggx, direction_from_cos(cos)).albedo;
        const Rgb<double> smooth = mirror.albedo(cos);
        EXPECT_NEAR(rough.r, smooth.r, 1e-3);
        EXPECT_NEAR(rough.b, smooth.b, 1e-3);
    }
}

}  // namespace
}  // namespace footlight::testing
