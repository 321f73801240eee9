// Sanitises the texels of a dome, and computes in double the densities and row shares its kernel samples from.
#include "light/dome_image.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace footlight {
namespace {

// Largest finite number of a half-precision image: what an overflowed texel most likely stood for.
constexpr double kHalfMax = 65504;

struct Repairs {
    std::size_t nan = 0, infinite = 0, negative = 0;

    std::string note() const {
        std::string text;
        const auto add = [&](std::size_t count, const char* what) {
            if (count > 0) text += (text.empty() ? "image: " : ", ") + std::to_string(count) + what;
        };
        add(nan, " NaN values set to 0");
        add(infinite, " infinite values set to +65504 or 0");
        add(negative, " negative values kept");
        return text;
    }
};

double repaired(double value, Repairs& repairs) {
    if (std::isnan(value)) {
        ++repairs.nan;
        return 0;
    }
    if (std::isinf(value)) {
        ++repairs.infinite;
        return value > 0 ? kHalfMax : 0;
    }
    if (value < 0) ++repairs.negative;
    return value;
}

// 1 - cos(angle), without cancellation.
double versine(double angle) { return 2 * std::sin(angle / 2) * std::sin(angle / 2); }

// cos(theta0) - cos(theta1) of two heights in the image [rows from the top], without cancellation.
double height_between(double y0, double y1, double height) {
    const double a = kPi * y0 / height, b = kPi * y1 / height;
    return 2 * std::sin((a + b) / 2) * std::sin((b - a) / 2);
}

// Fills image.rows and image.heights; answers each row's share of the sphere, as a height: they sum to 2.
std::vector<double> make_rows(DomeImage& image) {
    const std::uint32_t h = image.height;
    std::vector<double> shares(h);
    image.heights.resize(std::size_t{2} * h);
    image.rows.resize(std::size_t{row_columns} * h);
    for (std::uint32_t y = 0; y < h; ++y) {
        const double center = y + 0.5;
        const bool first = y == 0, last = y + 1 == h;
        const double up = height_between(first ? 0 : center - 1, center, h);
        const double down = height_between(center, last ? h : center + 1, h);
        const double share_up = first ? up : up / 2, share_down = last ? down : down / 2;
        const double from_top = versine(kPi * center / h), from_bottom = versine(kPi * (h - center) / h);
        shares[y] = share_up + share_down;
        image.heights[y] = static_cast<float>(from_top);
        image.heights[h + y] = static_cast<float>(from_bottom);
        float* row = &image.rows[std::size_t{row_columns} * y];
        const bool top_is_nearer = from_top <= from_bottom;
        row[row_height] = static_cast<float>(top_is_nearer ? from_top : from_bottom);
        row[row_sign] = top_is_nearer ? 1.0F : -1.0F;
        row[row_up] = static_cast<float>(up);
        row[row_down] = static_cast<float>(down);
        row[row_split] = static_cast<float>(share_up / shares[y]);
    }
    return shares;
}

}  // namespace

PreparedDome prepare_dome(const float* texels, std::uint32_t width, std::uint32_t height,
                          const std::array<double, 3>& emission, bool compensate) {
    PreparedDome dome{};
    DomeImage& image = dome.image;
    image.width = width;
    image.height = height;
    const std::vector<double> shares = make_rows(image);
    const std::size_t count = std::size_t{width} * height;
    std::vector<double> weights(count);
    image.texels.resize(4 * count);
    Repairs repairs;
    dome.is_constant = true;
    for (std::size_t i = 0; i < count; ++i) {
        const double share = shares[i / width] / (2.0 * width);  // of the sphere
        double magnitude = 0;
        for (std::size_t c = 0; c < 3; ++c) {
            const double radiance = repaired(double{texels[3 * i + c]}, repairs) * emission[c];
            const double limit = double{std::numeric_limits<float>::max()};
            image.texels[4 * i + c] = static_cast<float>(std::clamp(radiance, -limit, limit));
            const double kept = double{image.texels[4 * i + c]};
            dome.is_constant = dome.is_constant && image.texels[4 * i + c] == image.texels[c];
            dome.mean[c] += kept * share;
            magnitude += std::abs(kept) / 3;
        }
        weights[i] = magnitude * share;
        dome.magnitude += weights[i];
    }
    dome.note = repairs.note();
    if (dome.is_constant) {
        for (std::size_t c = 0; c < 3; ++c) dome.mean[c] = double{image.texels[c]};
        dome.image = {};
        return dome;
    }
    const auto excess = [&](std::size_t i) {
        return std::max(weights[i] - dome.magnitude * shares[i / width] / (2.0 * width), 0.0);
    };
    for (std::size_t i = 0; i < count; ++i) dome.excess += excess(i);
    if (compensate && dome.excess > 0)  // rounding can leave nothing of an image of nearly one colour
        for (std::size_t i = 0; i < count; ++i) weights[i] = excess(i);
    image.table = Distribution2D(weights, width, height);
    for (std::size_t i = 0; i < count; ++i) {
        const auto x = static_cast<std::uint32_t>(i % width), y = static_cast<std::uint32_t>(i / width);
        const double density = image.table.probability(x, y) * width / (2 * kPi * shares[y]);
        image.texels[4 * i + 3] = static_cast<float>(density);
    }
    return dome;
}

}  // namespace footlight
