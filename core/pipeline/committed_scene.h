// What all batches of a render share: the committed scene and the options that shape the image.
#pragma once

#include <string>
#include <string_view>

#include "accel/accel.h"
#include "film/film.h"
#include "film/filter.h"
#include "light/light.h"
#include "material/material_table.h"
#include "pipeline/camera_rays.h"
#include "pipeline/effects.h"

namespace footlight {

// How direct light is found. All three have the same mean; mis has the least error at equal time (Veach 1997).
enum class Strategy { mis, light, bsdf };
struct StrategyInfo {
    Strategy strategy;
    std::string_view name;
};
inline constexpr std::array<StrategyInfo, 3> kStrategies{
    {{Strategy::mis, "mis"}, {Strategy::light, "light"}, {Strategy::bsdf, "bsdf"}}};

struct RenderOptions {
    int width = 1280, height = 720;  // [pixels]
    std::uint32_t seed = 0;
    int max_depth = 8;  // edges of a path, camera to light; 1 shows emitters only
    PixelFilter pixel_filter = PixelFilter::blackman_harris;
    double filter_width = 0;  // full width [pixels]; 0: the filter's own
    Strategy strategy = Strategy::mis;
    AovSet aovs = bit(Aov::color);
    int threads = 0;  // 0: all
    std::vector<std::string> force_effects;
};

// Committed once, read by every thread.
struct CommittedScene {
    const RenderOptions& options;
    const Effects& effects;
    const CameraRays& camera;
    const FilterSampler& filter;
    const Geometry& geometry;
    const MaterialTable& materials;
    const std::vector<LobeSet>& lobe_set_of_mesh;  // by row of Geometry::meshes
    const LightTable& lights;
    const Accel& accel;
    float exposure;      // multiplies every sample
    bool with_aovs;      // normal, albedo or position are wanted
    bool sort_rays;      // the BVH outgrows the caches
    bool few_triangles;  // every ray meets most nodes of the BVH
    bool sample_lights;  // the strategy and the lights call for light samples
};

}  // namespace footlight
