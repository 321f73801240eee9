// Discrete distributions in one and two dimensions, built in double and sampled by kernels.
//
// Probabilities are whole multiples of 2^-24, the grid of `to_unit`. So an entry is picked by exactly as many of the
// random numbers as its probability says, every entry of positive weight owns at least one of them, an entry of weight
// zero owns none, and the probabilities sum to 1 without rounding. What quantising changes is variance, never a mean:
// the probability a kernel divides by is the one it draws with.
#pragma once

#include <bit>
#include <cmath>
#include <cstddef>
#include <span>
#include <stdexcept>
#include <vector>

#include "math/simd.h"

namespace footlight {

inline constexpr double kDistributionGrid = 0x1p24;
// Longer rows would leave less than 16 grid steps per entry on average: use two dimensions instead.
inline constexpr std::size_t kMaxRowEntries = std::size_t{1} << 20;

template <class F>
struct DiscreteSample {
    UInt<F> index;
    F probability;  // of this index; 0 only for an empty distribution
    F remapped;     // what is left of u, uniform in [0, 1)
};

// The cumulative distribution of non-negative finite weights: count + 1 numbers, 0 to 1. Empty if all weights are 0.
inline std::vector<float> make_cdf(std::span<const double> weights) {
    if (weights.size() > kMaxRowEntries) throw std::invalid_argument("distribution: more than 2^20 entries in one row");
    double largest = 0;
    for (const double w : weights) {
        if (!(w >= 0) || !std::isfinite(w))
            throw std::invalid_argument("distribution: a weight is negative or not finite");
        largest = std::max(largest, w);
    }
    if (largest == 0) return {};
    const std::size_t count = weights.size();
    const int exponent = -std::ilogb(largest);  // scaled so that the sum neither overflows nor underflows
    double total = 0;
    for (const double w : weights) total += std::scalbn(w, exponent);
    std::vector<double> steps(count + 1, 0.0);
    double sum = 0;
    for (std::size_t i = 0; i < count; ++i) {  // at least one grid step per positive weight, from the left …
        sum += std::scalbn(weights[i], exponent);
        const double rounded = std::nearbyint(sum / total * kDistributionGrid);
        steps[i + 1] = std::max(steps[i] + (weights[i] > 0 ? 1 : 0), rounded);
    }
    steps[count] = kDistributionGrid;
    for (std::size_t i = count; i-- > 1;)  // … and, where that ran past the end, from the right
        steps[i] = std::min(steps[i], steps[i + 1] - (weights[i] > 0 ? 1 : 0));
    std::vector<float> cdf(count + 1);
    for (std::size_t i = 0; i <= count; ++i) cdf[i] = static_cast<float>(steps[i] / kDistributionGrid);
    return cdf;
}

// Where to look: with `buckets` a power of two, entry b is the index that u = b / buckets picks, so the index that u
// picks lies between entries floor(u * buckets) and that plus one. buckets + 1 numbers. With it a lane reads one or two
// cache lines of a long row instead of one per halving (measured on a 2048 x 1024 dome of noise: 105 instead of 144 ns
// a sample).
inline std::vector<std::uint32_t> make_guide(std::span<const float> cdf, std::uint32_t buckets) {
    std::vector<std::uint32_t> guide(buckets + 1);
    std::uint32_t index = 0;
    const auto last = static_cast<std::uint32_t>(cdf.size() - 2);
    for (std::uint32_t b = 0; b <= buckets; ++b) {
        const double u = std::min(static_cast<double>(b) / buckets, 1 - 0x1p-24);
        while (index < last && double{cdf[index + 1]} <= u) ++index;
        guide[b] = index;
    }
    return guide;
}
// A quarter of the entries, as a power of two.
inline std::uint32_t guide_buckets(std::size_t entries) {
    return std::bit_floor(std::max(1U, static_cast<std::uint32_t>(entries / 4)));
}

// One row of a table in memory: a cdf from cdf[base], its guide from guide[guide_base].
template <class F>
struct CdfRow {
    const float* cdf;
    const std::uint32_t* guide;
    std::uint32_t buckets;
    UInt<F> base, guide_base;
};

// u in [0, 1).
template <class F>
inline DiscreteSample<F> sample_cdf(const CdfRow<F>& row, F u) {
    const UInt<F> bucket = row.guide_base + to_uint(u * F(static_cast<float>(row.buckets)));
    const UInt<F> first = gather_uint<F>(row.guide, bucket);
    UInt<F> low = row.base + first;
    UInt<F> length = gather_uint<F>(row.guide, bucket + UInt<F>(1U)) - first + UInt<F>(1U);
    while (any(to_number<F>(length) > F(1))) {  // the last entry whose cdf is <= u: never one of zero width
        const UInt<F> half = length >> 1;
        const UInt<F> middle = low + half;
        low = select(gather<F>(row.cdf, middle) <= u, middle, low);
        length = length - half;
    }
    const F begin = gather<F>(row.cdf, low);
    const F width = gather<F>(row.cdf, low + UInt<F>(1U)) - begin;
    return {low - row.base, width, min((u - begin) / width, F(1.0F - 0x1p-24F))};
}

// One row.
struct Distribution1D {
    std::vector<float> cdf;
    std::vector<std::uint32_t> guide;

    Distribution1D() = default;
    explicit Distribution1D(std::span<const double> weights) : cdf(make_cdf(weights)) {
        if (!cdf.empty()) guide = make_guide(cdf, guide_buckets(weights.size()));
    }

    std::uint32_t size() const { return cdf.empty() ? 0U : static_cast<std::uint32_t>(cdf.size() - 1); }

    template <class F>
    DiscreteSample<F> sample(F u) const {
        const auto buckets = static_cast<std::uint32_t>(guide.size() - 1);
        return sample_cdf<F>({cdf.data(), guide.data(), buckets, UInt<F>(0U), UInt<F>(0U)}, u);
    }
    template <class F>
    F probability(UInt<F> index) const {
        return gather<F>(cdf.data(), index + UInt<F>(1U)) - gather<F>(cdf.data(), index);
    }
};

template <class F>
struct DiscreteSample2D {
    UInt<F> column, row;
    F u, v;  // what is left of the numbers that chose the column and the row, uniform in [0, 1)
};

// A row is chosen first, then a column in it. Rows of weight zero are never chosen.
struct Distribution2D {
    std::uint32_t width = 0, height = 0;
    Distribution1D rows;
    std::uint32_t buckets = 0;
    std::vector<float> columns;               // (height, width + 1)
    std::vector<std::uint32_t> column_guide;  // (height, buckets + 1)

    Distribution2D() = default;
    // weights (height, width), row by row
    Distribution2D(std::span<const double> weights, std::uint32_t width_, std::uint32_t height_)
        : width(width_), height(height_), buckets(guide_buckets(width_)) {
        if (weights.size() != std::size_t{width} * height)
            throw std::invalid_argument("distribution: the number of weights is not width times height");
        columns.assign(std::size_t{height} * (width + 1), 0.0F);
        column_guide.assign(std::size_t{height} * (buckets + 1), 0U);
        std::vector<double> row_weights(height);
        for (std::uint32_t y = 0; y < height; ++y) {
            const auto row = weights.subspan(std::size_t{y} * width, width);
            for (const double w : row) row_weights[y] += w;
            const std::vector<float> cdf = make_cdf(row);
            if (cdf.empty()) continue;
            std::copy(cdf.begin(), cdf.end(), columns.begin() + static_cast<std::ptrdiff_t>(y) * (width + 1));
            const std::vector<std::uint32_t> guide = make_guide(cdf, buckets);
            std::copy(guide.begin(), guide.end(),
                      column_guide.begin() + static_cast<std::ptrdiff_t>(y) * (buckets + 1));
        }
        rows = Distribution1D(row_weights);
    }

    bool empty() const { return rows.size() == 0; }

    template <class F>
    DiscreteSample2D<F> sample(F u, F v) const {
        const DiscreteSample<F> row = rows.sample<F>(v);
        const CdfRow<F> columns_of_row{columns.data(), column_guide.data(), buckets, row.index * UInt<F>(width + 1),
                                       row.index * UInt<F>(buckets + 1)};
        const DiscreteSample<F> column = sample_cdf(columns_of_row, u);
        return {column.index, row.index, column.remapped, row.remapped};
    }
    // Probability of one entry, in double: for tables built on top, not for kernels.
    double probability(std::uint32_t column, std::uint32_t row) const {
        const std::size_t at = std::size_t{row} * (width + 1) + column;
        return rows.probability<double>(row) * (double{columns[at + 1]} - double{columns[at]});
    }
};

}  // namespace footlight
