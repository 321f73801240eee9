// Pixel filters by importance sampling: a sample belongs to one pixel, its position follows the filter (Ernst et al.
// 2006).
#pragma once

#include <array>
#include <cmath>
#include <string_view>

#include "math/simd.h"

namespace footlight {

enum class PixelFilter { box, gaussian, blackman_harris };

struct PixelFilterInfo {
    PixelFilter filter;
    std::string_view name;
    double default_width;  // full width [pixels]
};
inline constexpr std::array<PixelFilterInfo, 3> kPixelFilters{{
    {PixelFilter::box, "box", 1.0},
    {PixelFilter::gaussian, "gaussian", 3.0},
    {PixelFilter::blackman_harris, "blackman-harris", 3.0},
}};

// Unnormalised profile at t in [-1, 1], 1 being half the filter's width.
inline double filter_profile(PixelFilter filter, double t) {
    switch (filter) {
        case PixelFilter::box:
            return 1.0;
        case PixelFilter::gaussian: {
            // Standard deviation a sixth of the width; lowered so that it reaches zero at the edge, as is usual.
            const double edge = std::exp(-4.5);
            return (std::exp(-4.5 * t * t) - edge) / (1.0 - edge);
        }
        case PixelFilter::blackman_harris: {
            // Harris 1978, 4-term window.
            const double phase = 3.14159265358979323846 * (t + 1.0);
            return 0.35875 - 0.48829 * std::cos(phase) + 0.14128 * std::cos(2 * phase) - 0.01168 * std::cos(3 * phase);
        }
    }
    return 0.0;
}

// The inverse of the filter's cumulative distribution along one axis; the filters are separable.
class FilterSampler {
  public:
    FilterSampler(PixelFilter filter, double width) {
        constexpr int kSteps = 1 << 16;
        std::array<double, kEntries + 1> inverse{};
        double total = 0;
        for (int i = 0; i < kSteps; ++i) total += filter_profile(filter, -1.0 + (i + 0.5) * 2.0 / kSteps);
        double sum = 0;
        int entry = 0;
        for (int i = 0; i < kSteps; ++i) {
            const double next = sum + filter_profile(filter, -1.0 + (i + 0.5) * 2.0 / kSteps) / total;
            while (entry <= kEntries && static_cast<double>(entry) / kEntries <= next) {
                const double within = next > sum ? (static_cast<double>(entry) / kEntries - sum) / (next - sum) : 0.0;
                inverse[static_cast<std::size_t>(entry++)] = -1.0 + (i + within) * 2.0 / kSteps;
            }
            sum = next;
        }
        while (entry <= kEntries) inverse[static_cast<std::size_t>(entry++)] = 1.0;
        for (std::size_t i = 0; i <= kEntries; ++i) offset_[i] = static_cast<float>(inverse[i] * width * 0.5);
    }

    // Offset from the pixel's centre [pixels] for u in [0, 1).
    template <class F>
    [[nodiscard]] F sample(F u) const {
        const F x = u * F(static_cast<float>(kEntries));
        const UInt<F> i = to_uint<F>(x);
        const F t = x - to_number<F>(i);
        const F a = gather<F>(offset_.data(), i);
        const F b = gather<F>(offset_.data(), i + UInt<F>(1U));
        return a + (b - a) * t;
    }

  private:
    static constexpr int kEntries = 1024;
    std::array<float, kEntries + 1> offset_{};
};

}  // namespace footlight
