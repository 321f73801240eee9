// The bill: CPU seconds per stage, rays, and every guard that fired.
#pragma once

#include <time.h>

#include <array>
#include <cstdint>
#include <string_view>

namespace footlight {

enum class StageId { generate, opacity, sort, intersect, escape, light_hit, emission, surface, scatter, shadow, film };
inline constexpr std::array<std::string_view, 11> kStageNames{"generate", "opacity",   "sort",     "intersect",
                                                              "escape",   "light_hit", "emission", "surface",
                                                              "scatter",  "shadow",    "film"};

// What a guard caught. A count above 0 is a defect of the scene or of the renderer, and is shown.
enum class Guard { bad_radiance, bad_weight, bad_direction, bad_pdf };
inline constexpr std::array<std::string_view, 4> kGuardNames{"bad_radiance", "bad_weight", "bad_direction", "bad_pdf"};

struct Ledger {
    std::array<double, kStageNames.size()> seconds{};  // CPU time of the thread
    double embree_seconds = 0;                         // within intersect and shadow
    std::uint64_t closest_rays = 0, shadow_rays = 0, samples = 0;
    std::array<std::uint64_t, kGuardNames.size()> guards{};

    void add(const Ledger& other) {
        for (std::size_t i = 0; i < seconds.size(); ++i) seconds[i] += other.seconds[i];
        for (std::size_t i = 0; i < guards.size(); ++i) guards[i] += other.guards[i];
        embree_seconds += other.embree_seconds;
        closest_rays += other.closest_rays;
        shadow_rays += other.shadow_rays;
        samples += other.samples;
    }
    std::uint64_t& guard(Guard g) { return guards[static_cast<std::size_t>(g)]; }
};

// CPU time of the calling thread [s]. One read per stage and batch of thousands of paths: it costs nothing.
inline double thread_seconds() {
    timespec t{};
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
}

}  // namespace footlight
