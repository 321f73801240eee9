// Discrete distributions in one and two dimensions, built in double and sampled by kernels.
//
// Probabilities are whole multiples of 2^-24, the grid of `to_unit`. So an entry is picked by exactly as many of the
// random numbers as its probability says, every entry of positive weight owns at least one of them, an entry of weight
// zero owns none, and the probabilities sum to 1 without rounding. What quantising changes is variance, never a mean:
// the probability a kernel divides by is the one it draws with.
#pragma once

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
        if (!(w >= 0) || !std::isfinite(w)) throw std::invalid_argument("distribution: a weight is negative or not finite");
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

// Picks from the cdf of `count` entries that starts at cdf[base]. u in [0, 1).
template <class F>
inline DiscreteSample<F> sample_cdf(const float* cdf, UInt<F> base, std::uint32_t count, F u) {
    UInt<F> low = base;
    for (std::uint32_t length = count; length > 1;) {  // the last entry whose cdf is <= u: never one of zero width
        const std::uint32_t half = length / 2;
        const UInt<F> middle = low + UInt<F>(half);
        low = select(gather<F>(cdf, middle) <= u, middle, low);
        length -= half;
    }
    const F begin = gather<F>(cdf, low);
    const F width = gather<F>(cdf, low + UInt<F>(1U)) - begin;
    return {low - base, width, min((u - begin) / width, F(1.0 - 0x1p-24))};
}

// One row.
struct Distribution1D {
    std::vector<float> cdf;

    Distribution1D() = default;
    explicit Distribution1D(std::span<const double> weights) : cdf(make_cdf(weights)) {}

    std::uint32_t size() const { return cdf.empty() ? 0U : static_cast<std::uint32_t>(cdf.size() - 1); }

    template <class F>
    DiscreteSample<F> sample(F u) const {
        return sample_cdf<F>(cdf.data(), UInt<F>(0U), size(), u);
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
    std::vector<float> columns;  // height times (width + 1)

    Distribution2D() = default;
    // weights (height, width), row by row
    Distribution2D(std::span<const double> weights, std::uint32_t width_, std::uint32_t height_)
        : width(width_), height(height_) {
        if (weights.size() != std::size_t{width} * height)
            throw std::invalid_argument("distribution: the number of weights is not width times height");
        columns.assign(std::size_t{height} * (width + 1), 0.0F);
        std::vector<double> row_weights(height);
        for (std::uint32_t y = 0; y < height; ++y) {
            const auto row = weights.subspan(std::size_t{y} * width, width);
            for (const double w : row) row_weights[y] += w;
            const std::vector<float> cdf = make_cdf(row);
            std::copy(cdf.begin(), cdf.end(), columns.begin() + static_cast<std::ptrdiff_t>(y) * (width + 1));
        }
        rows = Distribution1D(row_weights);
    }

    bool empty() const { return rows.size() == 0; }

    template <class F>
    DiscreteSample2D<F> sample(F u, F v) const {
        const DiscreteSample<F> row = rows.sample<F>(v);
        const DiscreteSample<F> column = sample_cdf<F>(columns.data(), row.index * UInt<F>(width + 1), width, u);
        return {column.index, row.index, column.remapped, row.remapped};
    }
    // Probability of one entry, in double: for tables built on top, not for kernels.
    double probability(std::uint32_t column, std::uint32_t row) const {
        const std::size_t at = std::size_t{row} * (width + 1) + column;
        return rows.probability<double>(row) * (double{columns[at + 1]} - double{columns[at]});
    }
};

}  // namespace footlight
