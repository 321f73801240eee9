// Laws of bsdf/ggx.h: a white surface reflects everything, no colour gains energy, rough meets smooth without a step.
#include "bsdf/ggx.h"

#include <gtest/gtest.h>

#include "bsdf/lobe_testing.h"

namespace footlight::testing {
namespace {

template <class F>
GgxReflection<F> ggx(double f0, double f90, double alpha) {
    return {gray(number<F>(f0)), gray(number<F>(f90)), number<F>(alpha)};
}

// The mutant: single scattering only.
template <class F>
struct Uncompensated {
    GgxReflection<F> lobe;
    LobeEval<F> eval(Vec3<F> wo, Vec3<F> wi) const { return lobe.eval(wo, wi, gray(F(1))); }
    LobeSample<F> sample(Vec3<F> wo, F u0, F u1) const { return lobe.sample(wo, u0, u1); }
};

struct Range {
    double low = 1e30, high = -1e30;
    void add(double x) {
        low = std::min(low, x);
        high = std::max(high, x);
    }
};

// Over 64 directions and 32 roughnesses: a white lobe in the red channel, colours in the others.
TEST(Ggx, WhiteReflectsEverythingAndNoColorGainsEnergy) {
    Range white, others;
    for (int row = 0; row < 32; ++row) {
        const double roughness = (row + 0.5) / 32;
        const GgxReflection<FloatV> lobe{color<FloatV>(1, 0.5, 0.04), gray(FloatV(1)),
                                         number<FloatV>(roughness * roughness)};
        for (int column = 0; column < 64; ++column) {
            const double cos = column == 0 ? 1e-4 : column == 1 ? 1e-3 : (column + 0.5) / 64;
            const Rgb<double> albedo = integrate_albedo(lobe, direction_from_cos(cos), 24, 320, 0.5).albedo;
            white.add(albedo.r);
            others.add(albedo.g);
            others.add(albedo.b);
        }
    }
    EXPECT_GE(white.low, 1 - 5e-3);
    EXPECT_LE(white.high, 1 + 1e-3);
    EXPECT_GE(others.low, 0);
    EXPECT_LE(others.high, 1 + 1e-3);
}

TEST(Ggx, SingleScatteringLosesEnergy) {
    const Uncompensated<FloatV> mutant{ggx<FloatV>(1, 1, 1)};
    EXPECT_NEAR(integrate_albedo(mutant, {0, 0, 1}).albedo.g, 1 - std::log(2), 1e-4) << "the mutant passed";
}

// f is reciprocal but for the stated factor of wo.
TEST(Ggx, ReciprocalButForTheCompensation) {
    Uniform uniform(21);
    for (const double alpha : {0.01, 0.2, 1.0}) {
        const GgxReflection<float> lobe = ggx<float>(0.8, 1, alpha);
        for (int i = 0; i < 5000; ++i) {
            const Vec3<float> wo = cosine_hemisphere(uniform.next<float>(), uniform.next<float>());
            const Vec3<float> wi = cosine_hemisphere(uniform.next<float>(), uniform.next<float>());
            const double there = lobe.eval(wo, wi).f.r / wi.z / lobe.compensation(wo.z).r;
            const double back = lobe.eval(wi, wo).f.r / wo.z / lobe.compensation(wi.z).r;
            ASSERT_NEAR(there, back, 1e-4 * there);
        }
    }
}

// A pixel beside the mirror image of a step edge, as wide as one of 64 over 40 degrees: the mean of the step over the
// lobe and the pixel. A mirror leaves it black.
double pixel_beside_edge(const GgxReflection<float>& lobe) {
    constexpr double kWidth = 40.0 / 64 * kPi / 180;
    constexpr int kSide = 256;
    double sum = 0;
    for (int i = 0; i < kSide; ++i) {
        for (int j = 0; j < kSide; ++j) {
            const auto u = [](int k) { return (static_cast<float>(k) + 0.5F) / kSide; };
            const Vec3<float> wi = lobe.sample({0, 0, 1}, u(i), u(j)).wi;
            sum += std::clamp(wi.x / wi.z / kWidth, 0.0, 1.0);
        }
    }
    return sum / (kSide * kSide);
}

TEST(Ggx, MeetsTheMirrorWithoutAStep) {
    const double rough = pixel_beside_edge(ggx<float>(1, 1, 2 * kGgxMinAlpha));
    const double smallest = pixel_beside_edge(ggx<float>(1, 1, kGgxMinAlpha));
    EXPECT_LE(std::abs(rough - smallest), 1e-2);
    EXPECT_LE(smallest, 1e-2);
    EXPECT_GT(pixel_beside_edge(ggx<float>(1, 1, 1e-3)), 5e-2) << "a switch at 1e-3 would show: the mutant passed";
}

TEST(Ggx, AlphaOutsideItsRangeIsClamped) {
    const Vec3<float> wo = vector<float>(direction_from_cos(0.6));
    const auto same = [&](double alpha, double clamped) {
        const Vec3<float> wi = ggx<float>(1, 1, clamped).sample(wo, 0.3F, 0.7F).wi;
        const Vec3<float> drawn = ggx<float>(1, 1, alpha).sample(wo, 0.3F, 0.7F).wi;
        EXPECT_EQ(wi.x, drawn.x);
        EXPECT_EQ(wi.z, drawn.z);
        const LobeEval<float> a = ggx<float>(1, 1, alpha).eval(wo, wi), b = ggx<float>(1, 1, clamped).eval(wo, wi);
        EXPECT_EQ(a.pdf, b.pdf);
        EXPECT_EQ(a.f.r, b.f.r);
        EXPECT_TRUE(std::isfinite(a.f.r) && a.pdf > 0);
    };
    for (const double alpha : {0.0, -1.0, 1e-30, 0.99e-4}) same(alpha, kGgxMinAlpha);
    same(2, 1);
}

}  // namespace
}  // namespace footlight::testing
