// The balance heuristic: partition of one, range and monotony for every pair of densities a float can hold (L18).
#include "light/mis.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "light/light.h"

namespace footlight {
namespace {

constexpr float kInfinity = std::numeric_limits<float>::infinity();
constexpr float kDensities[] = {0, 1e-45F, 1e-38F, 1e-23F, 1e-3F, 1, 10, 1e19F, 1.9e19F, 1e25F, 3e38F, kInfinity};

float in_batch(float a, float b) { return balance_heuristic(FloatV(a), FloatV(b)).get(0); }

TEST(Mis, BalanceHeuristicPartitionsOne) {
    for (const float a : kDensities)
        for (const float b : kDensities)
            for (const auto heuristic : {balance_heuristic<float>, in_batch}) {
                const float w = heuristic(a, b), other = heuristic(b, a);
                EXPECT_GE(w, 0);
                EXPECT_LE(w, 1);
                EXPECT_NEAR(w + other, 1, 1e-6) << a << " " << b;
                const long double exact = static_cast<long double>(a) / (static_cast<long double>(a) + b);
                if (std::isfinite(exact)) {
                    EXPECT_NEAR(w, static_cast<double>(exact), 1e-6) << a << " " << b;
                }
            }
}

TEST(Mis, BalanceHeuristicGrowsWithItsOwnDensity) {
    for (const float b : kDensities) {
        float before = -1;
        for (const float a : kDensities) {
            if (a == b && (a == 0 || a == kInfinity)) continue;
            EXPECT_GE(balance_heuristic(a, b), before) << a << " " << b;
            before = balance_heuristic(a, b);
        }
    }
}

// The mutants: the textbook forms overflow, or lose both weights, where the ratio does not.
TEST(Mis, NaiveFormsFail) {
    const auto naive = [](float a, float b) { return a / (a + b); };
    const auto naive_power = [](float a, float b) { return a * a / (a * a + b * b); };
    EXPECT_NE(naive(3e38F, 3e38F) + naive(3e38F, 3e38F), 1);
    EXPECT_TRUE(std::isnan(naive(kInfinity, 1)));
    EXPECT_TRUE(std::isnan(naive_power(1.9e19F, 1)));
    EXPECT_TRUE(std::isnan(naive_power(1e-23F, 1e-23F)));
}

// L19: a delta light is found by nothing else, so its weight is 1 whatever the BSDF's density says.
TEST(Mis, DeltaLightsAreNeverCompared) {
    LightSample<float> sample = no_light_sample<float>();
    sample.is_delta = true;
    for (const float bsdf : kDensities) EXPECT_EQ(light_weight(sample, 1.0F, bsdf), 1);
    sample.is_delta = false;
    EXPECT_EQ(light_weight(sample, 1.0F, 3.0F), 0.25F);
    EXPECT_EQ(light_weight(sample, 1.0F, 0.0F), 1);  // a delta lobe has no density towards a light
}

}  // namespace
}  // namespace footlight
