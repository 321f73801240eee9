// Turns the image of a dome light into what its kernel samples.
#pragma once

#include <array>
#include <optional>
#include <string>

#include "light/dome.h"

namespace footlight {

struct PreparedDome {
    std::array<double, 3> mean;  // radiance over the sphere
    double magnitude;            // mean over the sphere of the mean of |channels|
    double excess;               // mean over the sphere of what exceeds `magnitude`
    bool is_constant;            // all texels alike: `mean` says it all, image stays empty
    DomeImage image;
    std::string note;  // how many texels were repaired; empty if none
};

// texels (height, width, 3), multiplied by emission. NaN becomes 0, +Inf the largest half-precision number, -Inf 0;
// negative texels are kept, and sampled by their magnitude; with compensate, by what it exceeds the mean.
PreparedDome prepare_dome(const float* texels, std::uint32_t width, std::uint32_t height,
                          const std::array<double, 3>& emission, bool compensate);

}  // namespace footlight
