// The list of image channels a render can produce; everything about AOVs folds over it.
#pragma once

#include <array>
#include <optional>
#include <string_view>

namespace footlight {

enum class Aov { color, alpha, depth, normal, albedo, position, error, sample_count };

struct AovInfo {
    Aov aov;
    std::string_view name;
    int channels;
    std::string_view meaning;
};

inline constexpr std::array<AovInfo, 8> kAovs{{
    {Aov::color, "color", 3, "radiance in the rendering space, mean over the pixel filter"},
    {Aov::alpha, "alpha", 1, "share of the camera rays that hit a surface or a visible light"},
    {Aov::depth, "depth", 1,
     "distance along the view axis to the nearest sample [stage units]; infinite where nothing is hit"},
    {Aov::normal, "normal", 3, "world-space shading normal, mean over the samples; zero where nothing is hit"},
    {Aov::albedo, "albedo", 3, "directional albedo of the first surface, mean over the samples"},
    {Aov::position, "position", 3, "world-space position of the nearest sample [stage units]"},
    {Aov::error, "error", 3, "standard error of the pixel's colour, pooled over 16x16 pixels, from two replicates"},
    {Aov::sample_count, "sample_count", 1, "samples per pixel"},
}};

inline const AovInfo& aov_info(Aov aov) { return kAovs[static_cast<std::size_t>(aov)]; }

inline std::optional<Aov> find_aov(std::string_view name) {
    for (const AovInfo& info : kAovs)
        if (info.name == name) return info.aov;
    return std::nullopt;
}

// A set of AOVs, one bit each.
using AovSet = unsigned;
inline constexpr AovSet bit(Aov aov) { return 1U << static_cast<unsigned>(aov); }
inline constexpr bool contains(AovSet set, Aov aov) { return (set & bit(aov)) != 0; }

}  // namespace footlight
