// Laws of bsdf/albedo_table.h: between its grid points the table is the integral, at its edges it stays in range.
#include "bsdf/albedo_table.h"

#include <gtest/gtest.h>

#include "bsdf/lobe_testing.h"

namespace footlight::testing {
namespace {

struct Integral {
    double albedo, share;
};
Integral integrate(double cos_o, double alpha) {
    constexpr int kTurns = 64, kDepths = 512;
    const Direction wo = direction_from_cos(cos_o);
    double all = 0, grazing = 0;
    for (int i = 0; i < kTurns; ++i) {
        for (int j = 0; j < kDepths; ++j) {
            const Direction wi = reflect(wo, ggx_sample_half(wo, alpha, (i + 0.5) / (2 * kTurns), (j + 0.5) / kDepths));
            const GgxSingle<double> single = ggx_single_scattering(wo, wi, alpha);
            if (single.pdf <= 0) continue;
            all += single.f / single.pdf;
            grazing += single.f / single.pdf * schlick_weight(single.cos_d);
        }
    }
    return {all / (kTurns * kDepths), grazing / all};
}

TEST(AlbedoTable, IsTheIntegralBetweenItsGridPoints) {
    Uniform uniform(31);
    for (int i = 0; i < 300; ++i) {
        const double root = uniform.next<double>(), roughness = uniform.next<double>();
        const double alpha = std::max(roughness * roughness, kGgxMinAlpha);
        const double cos_o = i % 2 == 0 ? root : std::max(std::pow(root, 6), 1e-5);  // every second one grazing
        const Integral exact = integrate(cos_o, alpha);
        EXPECT_NEAR(ggx_albedo(cos_o, alpha) / exact.albedo, 1, 1e-3) << cos_o << " " << alpha;
        EXPECT_NEAR(ggx_schlick_share(cos_o, alpha), exact.share, 5e-3) << cos_o << " " << alpha;
    }
}

// The mutant: a table over plain cos_o does not see the dip at cos_o ~ alpha.
TEST(AlbedoTable, PlainCosineAxisIsRejected) {
    const double alpha = 1e-3, step = 1.0 / (kAlbedoColumns - 1);
    const double share = alpha / step;
    const double mutant = (1 - share) * integrate(1e-9, alpha).albedo + share * integrate(step, alpha).albedo;
    const double exact = integrate(alpha, alpha).albedo;
    EXPECT_GT(mutant / exact, 1.1);
    EXPECT_NEAR(ggx_albedo(alpha, alpha) / exact, 1, 1e-3);
}

TEST(AlbedoTable, StaysInRangeAtAndBeyondItsEdges) {
    for (const double alpha : {kGgxMinAlpha, 1e-3, 0.5, 1.0}) {
        for (const float cos_o : {-1.0F, -0.0F, 0.0F, 1e-38F, 1e-20F, 1e-6F, 0.5F, 1.0F, 1.0000002F, 2.0F, NAN}) {
            const double albedo = lane(ggx_albedo(FloatV(cos_o), number<FloatV>(alpha)), 0);
            const double share = lane(ggx_schlick_share(FloatV(cos_o), number<FloatV>(alpha)), 0);
            EXPECT_TRUE(albedo >= 0.3 && albedo <= 1 + 1e-6) << cos_o << " " << alpha << " " << albedo;
            EXPECT_TRUE(share >= 0 && share <= 1 + 1e-6) << cos_o << " " << alpha << " " << share;
        }
    }
    EXPECT_NEAR(ggx_albedo(1.0, 1.0), 1 - std::log(2), 1e-4) << "closed form at normal incidence and alpha = 1";
}

TEST(AlbedoTable, IsContinuous) {
    constexpr int kSteps = 20000;
    double last = ggx_albedo(0.0, 0.3);
    for (int i = 1; i <= kSteps; ++i) {
        const double root = static_cast<double>(i) / kSteps;
        const double next = ggx_albedo(root * root, 0.3);
        ASSERT_LE(std::abs(next - last), 2e-4);
        last = next;
    }
}

TEST(AlbedoTable, AllNumberTypesAgree) {
    Uniform uniform(32);
    for (int i = 0; i < 2000; ++i) {
        const FloatV cos_o = uniform.next<FloatV>();
        const FloatV alpha = max(uniform.next<FloatV>(), number<FloatV>(kGgxMinAlpha));
        const FloatV albedo = ggx_albedo(cos_o, alpha), share = ggx_schlick_share(cos_o, alpha);
        for (int k = 0; k < kLanes; ++k) {
            const double c = lane(cos_o, k), a = lane(alpha, k);
            ASSERT_NEAR(lane(albedo, k), ggx_albedo(c, a), 2e-6);
            ASSERT_NEAR(lane(share, k), ggx_schlick_share(c, a), 2e-6);
            ASSERT_NEAR(ggx_albedo(static_cast<float>(c), static_cast<float>(a)), ggx_albedo(c, a), 2e-6);
        }
    }
}

}  // namespace
}  // namespace footlight::testing
