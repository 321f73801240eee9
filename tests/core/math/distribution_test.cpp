// Discrete distributions: every entry reachable with exactly its probability (L11, L12), edges and plateaus (L13).
#include "math/distribution.h"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstdint>
#include <numeric>

#include "math/sampler.h"

namespace footlight {
namespace {

double random_unit(std::uint32_t i) { return double{to_unit<float>(mix_bits(mix_bits(i) + 99U))}; }

// The naive table: a running sum in float.
std::vector<float> naive_cdf(const std::vector<double>& weights) {
    std::vector<float> cdf{0};
    for (const double w : weights) cdf.push_back(cdf.back() + static_cast<float>(w));
    for (float& c : cdf) c /= cdf.back();
    return cdf;
}

TEST(Distribution, ProbabilitiesSumToOneAndNoEntryIsLost) {
    for (const std::size_t count : {1U, 2U, 1000U, 65536U, 1048576U}) {
        std::vector<double> weights(count);
        for (std::size_t i = 0; i < count; ++i) weights[i] = random_unit(static_cast<std::uint32_t>(i)) + 1e-9;
        const double total = std::accumulate(weights.begin(), weights.end(), 0.0);
        const Distribution1D table{weights};
        double sum = 0;
        for (std::uint32_t i = 0; i < count; ++i) {
            const double p = table.probability<double>(i);
            ASSERT_GT(p, 0);
            ASSERT_EQ(p * kDistributionGrid, std::floor(p * kDistributionGrid));
            ASSERT_NEAR(p, weights[i] / total, 4 / kDistributionGrid);
            sum += p;
        }
        EXPECT_EQ(sum, 1);
        if (count == 1048576U) {
            const std::vector<float> naive = naive_cdf(weights);
            std::size_t lost = 0;
            for (std::size_t i = 0; i < count; ++i) lost += naive[i] == naive[i + 1] ? 1U : 0U;
            EXPECT_GT(lost, 1000U);  // the test rejects the running float sum
        }
    }
}

// The proof that all entries are reachable: walk every number u can be.
TEST(Distribution, EveryEntryIsDrawnAsOftenAsItsProbabilitySays) {
    const std::vector<double> weights{0.3, 0, 1e-30, 5, 0, 0, 1e-3, 2.5, 0};
    const Distribution1D table{weights};
    std::vector<std::uint32_t> drawn(weights.size());
    for (std::uint32_t k = 0; k < (1U << 24); ++k) ++drawn[table.sample(static_cast<float>(k) * 0x1p-24F).index];
    for (std::uint32_t i = 0; i < weights.size(); ++i) {
        EXPECT_EQ(drawn[i], static_cast<std::uint32_t>(table.probability<double>(i) * kDistributionGrid));
        EXPECT_EQ(drawn[i] == 0, weights[i] == 0);
    }
}

TEST(Distribution, EdgesAndPlateaus) {
    const std::vector<std::vector<double>> tables{{0, 0, 1}, {1, 0, 0}, {0, 1, 0, 1},   {1e-38, 1},    {1e30, 1e-30},
                                                  {1},       {1e-310},  {1e308, 1e308}, {0, 1e-200, 0}};
    for (const auto& weights : tables) {
        const Distribution1D table{weights};
        for (const double u : {0.0, 0x1p-32, 0.5, 1 - 0x1p-24, 1 - 0x1p-53}) {
            const auto in_double = table.sample(u);
            EXPECT_GT(weights[in_double.index], 0);
            EXPECT_GE(in_double.remapped, 0);
            EXPECT_LT(in_double.remapped, 1);
            EXPECT_EQ(in_double.probability, table.probability<double>(in_double.index));
            const auto f = std::min(static_cast<float>(u), 1 - 0x1p-24F);
            const auto in_float = table.sample(f);
            const auto in_batch = table.sample(FloatV(f));
            EXPECT_GT(weights[in_float.index], 0);
            EXPECT_LT(in_float.remapped, 1);
            EXPECT_EQ(in_batch.index.get(0), in_float.index);
            EXPECT_EQ(in_batch.remapped.get(0), in_float.remapped);
            EXPECT_EQ(in_batch.probability.get(0), in_float.probability);
        }
    }
    EXPECT_EQ(Distribution1D(std::vector<double>{0, 0}).size(), 0U);
    EXPECT_THROW(Distribution1D(std::vector<double>{1, -1}), std::invalid_argument);
    EXPECT_THROW(Distribution1D(std::vector<double>{1, NAN}), std::invalid_argument);
    EXPECT_THROW(Distribution1D(std::vector<double>{INFINITY}), std::invalid_argument);
}

// Entries too faint for the grid, at either end or around the bright one, keep a step each.
TEST(Distribution, FaintEntriesKeepAStepWhereverTheyAre) {
    constexpr std::uint32_t faint = 1000;
    for (const std::uint32_t bright : {0U, faint / 2, faint}) {
        std::vector<double> weights(faint + 1, 1e-30);
        weights[bright] = 1;
        const Distribution1D table{weights};
        for (std::uint32_t i = 0; i <= faint; ++i) {
            EXPECT_EQ(table.probability<double>(i) * kDistributionGrid, i == bright ? kDistributionGrid - faint : 1.0);
            EXPECT_EQ(table.sample(table.cdf[i]).index, i);
        }
    }
}

TEST(Distribution, RemappedNumberIsUniform) {
    const Distribution1D table{std::vector<double>{1, 2, 5}};
    double mean = 0, square = 0;
    constexpr std::uint32_t count = 1 << 16;
    for (std::uint32_t k = 0; k < count; ++k) {
        const double x = table.sample((k + 0.5) / count).remapped;
        mean += x / count;
        square += x * x / count;
    }
    EXPECT_NEAR(mean, 0.5, 1e-4);
    EXPECT_NEAR(square, 1.0 / 3, 1e-4);
}

// More entries than a 24-bit number could tell apart: two levels reach all, with the rest of both numbers to spare.
TEST(Distribution, TwoLevelsReachEveryEntryOfALargeTable) {
    constexpr std::uint32_t width = 8192, height = 4096;
    std::vector<double> weights(std::size_t{width} * height);
    for (std::size_t i = 0; i < weights.size(); ++i) weights[i] = random_unit(static_cast<std::uint32_t>(i)) + 1e-4;
    const double total = std::accumulate(weights.begin(), weights.end(), 0.0);
    const Distribution2D table{weights, width, height};
    double sum = 0, worst = 0;
    for (std::uint32_t y = 0; y < height; ++y)
        for (std::uint32_t x = 0; x < width; ++x) {
            const double p = table.probability(x, y);
            ASSERT_GT(p, 0);
            sum += p;
            worst = std::max(worst, std::abs(p - weights[std::size_t{y} * width + x] / total));
        }
    EXPECT_NEAR(sum, 1, 1e-9);
    EXPECT_LT(worst, 2 / kDistributionGrid / height * 1.5);
}

TEST(Distribution, TwoLevelsDrawByWeight) {
    constexpr std::uint32_t width = 7, height = 5;
    std::vector<double> weights(width * height);
    for (std::uint32_t i = 0; i < weights.size(); ++i) weights[i] = i % 3 == 0 || i / width == 2 ? 0.0 : random_unit(i);
    const Distribution2D table{weights, width, height};
    std::vector<double> drawn(weights.size());
    constexpr std::uint32_t count = 1 << 18;
    for (std::uint32_t i = 0; i < count; i += kLanes) {
        alignas(kAlignment) std::array<float, kLanes> u, v;
        for (int k = 0; k < kLanes; ++k) {
            u[k] = to_unit<float>(mix_bits(i + static_cast<std::uint32_t>(k)));
            v[k] = to_unit<float>(mix_bits(mix_bits(i + static_cast<std::uint32_t>(k)) + 1U));
        }
        const auto s = table.sample(FloatV::load_aligned(u.data()), FloatV::load_aligned(v.data()));
        for (int k = 0; k < kLanes; ++k) drawn[s.row.get(k) * width + s.column.get(k)] += 1;
    }
    double chi2 = 0, freedom = -1;
    for (std::uint32_t i = 0; i < weights.size(); ++i) {
        const double expected = table.probability(i % width, i / width) * count;
        EXPECT_EQ(expected == 0, weights[i] == 0);
        if (expected == 0) {
            EXPECT_EQ(drawn[i], 0);
            continue;
        }
        chi2 += (drawn[i] - expected) * (drawn[i] - expected) / expected;
        freedom += 1;
    }
    EXPECT_LT((chi2 - freedom) / std::sqrt(2 * freedom), 5.2);
}

}  // namespace
}  // namespace footlight
