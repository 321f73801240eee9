// Laws that every lobe of the list keeps: sampler, density, value and albedo belong together.
#include "bsdf/lobe_testing.h"

#include <gtest/gtest.h>

namespace footlight::testing {
namespace {

static_assert(Lobe<Lambert<FloatV>, FloatV> && Lobe<GgxReflection<FloatV>, FloatV> && Lobe<Mirror<FloatV>, FloatV>);

constexpr double kDegrees[] = {0, 45, 80, 89, 89.9};

// The direction that the batches see, rounded to float, at unit length in double: off by 3e-8 in length, the half
// vector of alpha = 1e-3 at 89.9 degrees would be off by 1 % of the lobe's width.
Direction rounded(Direction w) { return normalize(lane(vector<float>(w), 0)); }

TEST(Lobe, SamplesFollowTheDensity) {
    constexpr int kTests = 40;  // at least as many as there are
    int tests = 0;
    for_each_lobe([&](const auto& oracle, const auto& batch, const std::string& name) {
        if constexpr (!std::decay_t<decltype(oracle)>::is_delta) {
            for (const double degrees : kDegrees) {
                SCOPED_TRACE(name + " at " + std::to_string(degrees));
                const Direction wo = rounded(direction_from_degrees(degrees));
                const auto sample = [&](auto w, auto u0, auto u1) { return batch.sample(w, u0, u1); };
                const DensityTest t = test_density(
                    sample, wo, [&](Direction wi) { return oracle.eval(wo, wi).pdf; },
                    static_cast<std::uint32_t>(++tests));
                EXPECT_GT(t.p, sidak_level(kTests));
                EXPECT_LE(t.integral, 1 + 1e-4);
                const double sigma = std::sqrt(t.valid * (1 - t.valid) / t.samples);
                EXPECT_NEAR(t.integral, t.valid, 5.2 * sigma + 1e-4);
            }
        }
    });
    EXPECT_LE(tests, kTests);
}

// The mutant: a density off by 3 % on either side of the plane of incidence, which keeps its integral.
TEST(Lobe, SlightlyWrongDensityIsRejected) {
    for_each_lobe([&](const auto& oracle, const auto& batch, const std::string& name) {
        if constexpr (!std::decay_t<decltype(oracle)>::is_delta) {
            SCOPED_TRACE(name);
            const Direction wo = rounded(direction_from_degrees(45));
            const auto sample = [&](auto w, auto u0, auto u1) { return batch.sample(w, u0, u1); };
            const DensityTest t = test_density(
                sample, wo, [&](Direction wi) { return oracle.eval(wo, wi).pdf * (wi.y > 0 ? 1.03 : 0.97); }, 1);
            EXPECT_LT(t.p, 1e-6);
        }
    });
}

// Every valid sample has a density, and every number of a sample is what double says it is.
TEST(Lobe, BatchesAgreeWithDouble) {
    for_each_lobe([&](const auto& oracle, const auto& batch, const std::string& name) {
        SCOPED_TRACE(name);
        constexpr bool is_delta = std::decay_t<decltype(oracle)>::is_delta;
        Uniform uniform(7);
        for (int i = 0; i < 20000; i += kLanes) {
            const FloatV phi = uniform.next<FloatV>();
            const SinCos<FloatV> turn = sin_cos_turn(phi);
            const FloatV z = max(uniform.next<FloatV>(), FloatV(1e-3F));
            const FloatV sine = safe_sqrt(FloatV(1) - z * z);
            const Vec3<FloatV> wo{sine * turn.cos, sine * turn.sin, z};
            const FloatV u0 = uniform.next<FloatV>(), u1 = uniform.next<FloatV>();
            const auto s = batch.sample(wo, u0, u1);
            const auto e = batch.eval(wo, s.wi);
            const auto albedo = batch.albedo(wo.z);
            for (int k = 0; k < kLanes; ++k) {
                const Direction o = lane(wo, k), w = lane(s.wi, k);
                ASSERT_NEAR(length(w), 1, 1e-6);
                ASSERT_EQ(lane_of_mask<FloatV>(s.valid, k), w.z > 0);
                // the far tail, u1 -> 1, is as well known as 1 - u1
                const double conditioned = 1e-6 / (1 - lane(u1, k));
                ASSERT_LE(length(oracle.sample(o, lane(u0, k), lane(u1, k)).wi - w), 2e-5 + conditioned);
                ASSERT_NEAR(lane(albedo.g, k), oracle.albedo(o.z).g, 2e-5);
                const LobeEval<double> exact = oracle.eval(o, w);
                if (is_delta || w.z <= 0) {
                    ASSERT_EQ(lane(e.pdf, k), 0);
                    ASSERT_EQ(lane(e.f.g, k), 0);
                    continue;
                }
                ASSERT_GT(lane(e.pdf, k), 0);
                ASSERT_NEAR(lane(e.pdf, k) / exact.pdf, 1, 1e-4);
                ASSERT_NEAR(lane(e.f.g, k), exact.f.g, 1e-4 * exact.f.g);
                ASSERT_NEAR(lane(e.f.b, k), exact.f.b, 1e-4 * exact.f.b);
            }
        }
    });
}

TEST(Lobe, BelowTheSurfaceIsBlack) {
    for_each_lobe([&](const auto&, const auto& batch, const std::string& name) {
        SCOPED_TRACE(name);
        const Vec3<FloatV> up = vector<FloatV>(direction_from_cos(0.6)), level = vector<FloatV>({1, 0, 0});
        for (const Vec3<FloatV>& down : {-up, level, -level}) {
            for (const auto& e : {batch.eval(up, down), batch.eval(down, up), batch.eval(down, down)}) {
                EXPECT_EQ(lane(e.pdf, 0), 0);
                EXPECT_EQ(lane(e.f.r, 0) + lane(e.f.g, 0) + lane(e.f.b, 0), 0);
            }
            EXPECT_FALSE(any(batch.sample(down, FloatV(0.3F), FloatV(0.6F)).valid));
        }
    });
}

// albedo() is what eval() integrates to, and no colour gains energy.
TEST(Lobe, AlbedoIsTheIntegral) {
    for_each_lobe([&](const auto& oracle, const auto&, const std::string& name) {
        if constexpr (!std::decay_t<decltype(oracle)>::is_delta) {
            for (const double cos : {1.0, 0.7, 0.3, 0.1, 0.03, 0.01}) {
                SCOPED_TRACE(name + " at cos " + std::to_string(cos));
                const Rgb<double> integral = integrate_albedo(oracle, direction_from_cos(cos)).albedo;
                const Rgb<double> stated = oracle.albedo(cos);
                EXPECT_NEAR(integral.r, stated.r, 5e-3);
                EXPECT_NEAR(integral.g, stated.g, 5e-3);
                EXPECT_NEAR(integral.b, stated.b, 5e-3);
                EXPECT_LE(max_component(integral), 1 + 1e-3);
            }
        }
    });
}

}  // namespace
}  // namespace footlight::testing
