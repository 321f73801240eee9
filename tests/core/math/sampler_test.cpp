// The sampler: every pair of dimensions is a scrambled (0, 2)-net, and pairs of different purposes know nothing of each
// other.
#include "math/sampler.h"

#include <gtest/gtest.h>

#include <cmath>
#include <map>
#include <set>
#include <vector>

namespace footlight {
namespace {

using Points = std::vector<Uniform2<float>>;

Points draw(std::uint32_t key, std::uint32_t replicate, std::uint32_t count, std::uint32_t bounce, Dim dim) {
    Points points;
    for (std::uint32_t i = 0; i < count; ++i)
        points.push_back(sample_2d<float>({pixel_key(key, 3, 5, replicate), reverse_bits(i)}, bounce, dim));
    return points;
}

// As many points of each replicate.
Points draw_both(std::uint32_t key, std::uint32_t count, std::uint32_t bounce, Dim dim) {
    Points points = draw(key, 0, count, bounce, dim);
    const Points others = draw(key, 1, count, bounce, dim);
    points.insert(points.end(), others.begin(), others.end());
    return points;
}

// Does every elementary interval of area 2^t / count, 2^-a wide and 2^-b high, hold 2^t points?
bool fills_elementary_intervals(const Points& points, unsigned t = 0) {
    const auto log2 = static_cast<unsigned>(std::countr_zero(points.size()));
    for (unsigned a = 0; a + t <= log2; ++a) {
        std::map<std::pair<unsigned, unsigned>, unsigned> cells;
        for (const Uniform2<float>& p : points)
            ++cells[{static_cast<unsigned>(std::ldexp(p.u, static_cast<int>(a))),
                     static_cast<unsigned>(std::ldexp(p.v, static_cast<int>(log2 - t - a)))}];
        for (const auto& [cell, held] : cells)
            if (held != 1U << t) return false;
    }
    return true;
}

TEST(Sampler, PairsAreNets) {
    for (std::uint32_t seed = 0; seed < 16; ++seed)
        for (std::uint32_t count = 2; count <= 4096; count *= 2)
            for (const Dim dim : {Dim::pixel, Dim::light_uv, Dim::lobe_uv}) {
                const std::uint32_t bounce = dim == Dim::pixel ? 0 : 1 + seed % 5;
                EXPECT_TRUE(fills_elementary_intervals(draw(seed, seed % 2, count, bounce, dim))) << seed << count;
            }
}

// Of the pairs the replicates share, both together are a net and each is one of half the quality.
TEST(Sampler, SharedPairsAreNetsTogether) {
    for (std::uint32_t seed = 0; seed < 16; ++seed)
        for (std::uint32_t count = 2; count <= 4096; count *= 2)
            for (const Dim dim : {Dim::light_uv, Dim::lobe_uv}) {
                EXPECT_TRUE(fills_elementary_intervals(draw_both(seed, count, 0, dim))) << seed << " " << count;
                for (const std::uint32_t replicate : {0U, 1U})
                    EXPECT_TRUE(fills_elementary_intervals(draw(seed, replicate, count, 0, dim), 1)) << seed << count;
            }
}

// What sharing must not be: replicates of their own make no net together; neither do the even and odd points of a
// sequence make nets, which fill one half of the square each.
TEST(Sampler, ReplicatesOfTheirOwnAreNoNetTogether) {
    EXPECT_FALSE(fills_elementary_intervals(draw_both(3, 64, 1, Dim::lobe_uv)));
    Points even;
    for (std::uint32_t i = 0; i < 64; ++i)
        even.push_back({owen_scrambled<float>(2 * i, 5U), owen_scrambled<float>(sobol_second(2 * i), 6U)});
    EXPECT_FALSE(fills_elementary_intervals(even, 1));
}

TEST(Sampler, IndependentPointsAreNoNet) {
    Points points;
    for (std::uint32_t i = 0; i < 64; ++i)
        points.push_back({to_unit<float>(mix_bits(i)), to_unit<float>(mix_bits(i + 1000))});
    EXPECT_FALSE(fills_elementary_intervals(points));
}

// S05: correlation of two purposes, and of two replicates, over many pixels.
TEST(Sampler, PurposesAndReplicatesAreUncorrelated) {
    constexpr std::uint32_t pixels = 4096, samples = 16;
    const auto correlation = [&](auto first, auto second) {
        double sum = 0;
        for (std::uint32_t x = 0; x < pixels; ++x)
            for (std::uint32_t i = 0; i < samples; ++i) sum += (first(x, i) - 0.5) * (second(x, i) - 0.5);
        return 12 * sum / (pixels * samples);
    };
    const auto at = [](std::uint32_t bounce, Dim dim, std::uint32_t replicate) {
        return [=](std::uint32_t x, std::uint32_t i) {
            return sample_2d<double>({pixel_key(7, x, 1, replicate), reverse_bits(i)}, bounce, dim).u;
        };
    };
    const double limit = 5 / std::sqrt(pixels * samples);
    EXPECT_NEAR(correlation(at(0, Dim::lobe_uv, 0), at(0, Dim::light_uv, 0)), 0, limit);
    EXPECT_NEAR(correlation(at(0, Dim::lobe_uv, 0), at(1, Dim::lobe_uv, 0)), 0, limit);
    EXPECT_NEAR(correlation(at(1, Dim::lobe_uv, 0), at(1, Dim::lobe_uv, 1)), 0, limit);
    EXPECT_NEAR(correlation(at(0, Dim::pixel, 0), at(0, Dim::pixel, 1)), 0, limit);
    EXPECT_NEAR(correlation(at(0, Dim::lobe_uv, 0), at(0, Dim::lobe_uv, 0)), 1, 0.01);
}

// S06, S08: any index, any bits: never 1, and no repeat within 2^16.
TEST(Sampler, NumbersStayBelowOne) {
    EXPECT_LT(to_unit<float>(0xFFFFFFFFU), 1.0F);
    std::set<float> seen;
    for (std::uint32_t i = 0; i < (1U << 16); ++i)
        seen.insert(sample_1d<float>({42U, reverse_bits(i)}, 0, Dim::roulette));
    EXPECT_EQ(seen.size(), 1U << 16);
    for (const std::uint32_t index : {0x7FFFFFFFU, 0x80000000U, 0xFFFFFFFFU}) {
        const auto u = sample_2d<float>({1U, reverse_bits(index)}, 10'000, Dim::lens);
        EXPECT_TRUE(u.u >= 0 && u.u < 1 && u.v >= 0 && u.v < 1);
    }
}

TEST(Sampler, BatchesDrawWhatScalarsDraw) {
    alignas(kAlignment) std::uint32_t index[kLanes];
    for (std::uint32_t k = 0; k < static_cast<std::uint32_t>(kLanes); ++k) index[k] = reverse_bits(k);
    const auto batch = sample_2d<FloatV>({UIntV(99U), UIntV::load_aligned(index)}, 2, Dim::light_uv);
    for (std::size_t k = 0; k < static_cast<std::size_t>(kLanes); ++k) {
        const auto scalar = sample_2d<float>({99U, index[k]}, 2, Dim::light_uv);
        EXPECT_EQ(batch.u.get(k), scalar.u);
        EXPECT_EQ(batch.v.get(k), scalar.v);
    }
}

}  // namespace
}  // namespace footlight
