// Laws of bsdf/fresnel.h: reflectances lie in [0, 1], meet their two colours, and vanish without a boundary.
#include "bsdf/fresnel.h"

#include <gtest/gtest.h>

#include "math/lanes.h"

namespace footlight::testing {
namespace {

TEST(Fresnel, DielectricReflectsNothingWithoutABoundary) {
    EXPECT_EQ(dielectric_f0(1.0F), 0);
    for (const double ior : {1 + 1e-7, 1 - 1e-7, 1.001, 0.999, 1 / 1.5, 1.33, 1.5, 2.4, 1e3}) {
        const double exact = dielectric_f0(ior);
        EXPECT_NEAR(dielectric_f0(static_cast<float>(ior)), exact, 1e-6) << ior;
        EXPECT_TRUE(exact >= 0 && exact <= 1) << ior;
        EXPECT_NEAR(dielectric_f0(1 / ior), exact, 1e-12) << "the same from both sides";
    }
    EXPECT_NEAR(dielectric_f0(1.5), 0.04, 1e-15);
}

TEST(Fresnel, SchlickLiesBetweenItsColors) {
    const Rgb<FloatV> f0{FloatV(0.04F), FloatV(0.9F), FloatV(1.0F)}, f90{FloatV(1.0F), FloatV(0.3F), FloatV(1.0F)};
    for (const double cos : {0.0, 1e-6, 0.1, 0.5, 0.99, 1.0, 1.0000001}) {
        const Rgb<FloatV> f = schlick_fresnel(f0, f90, number<FloatV>(cos));
        const Rgb<double> exact = schlick_fresnel<double>({0.04, 0.9, 1}, {1, 0.3, 1}, cos);
        EXPECT_NEAR(lane(f.r, 0), exact.r, 1e-6);
        EXPECT_NEAR(lane(f.g, 0), exact.g, 1e-6);
        EXPECT_EQ(lane(f.b, 0), 1) << "white is white at every angle";
        EXPECT_TRUE(exact.r >= 0.04 && exact.r <= 1 && exact.g >= 0.3 - 1e-12 && exact.g <= 0.9);
    }
    EXPECT_EQ(lane(schlick_fresnel(f0, f90, FloatV(1.0F)).r, 0), 0.04F);
    EXPECT_FLOAT_EQ(static_cast<float>(lane(schlick_fresnel(f0, f90, FloatV(0.0F)).g, 0)), 0.3F);
}

}  // namespace
}  // namespace footlight::testing
