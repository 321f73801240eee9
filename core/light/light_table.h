// The lights of a scene as kernels read them, and the functions that fill the table in double precision.
#pragma once

#include <algorithm>
#include <array>
#include <optional>
#include <string>
#include <vector>

#include "light/dome.h"
#include "light/light_sample.h"
#include "math/distribution.h"
#include "math/matrix.h"

namespace footlight {

// What is common to all lights. emission: intensity * 2^exposure * colour * blackbody, may be negative.
struct LightDesc {
    std::string path;   // of the prim
    Matrix4 transform;  // light to render space (relative to the render origin)
    std::array<double, 3> emission{1, 1, 1};
    bool normalize = false;  // divide by the size, as UsdLux defines it
    bool visible_to_camera = true;
};
struct RectLightDesc : LightDesc {
    double width = 1, height = 1;
};
struct DiskLightDesc : LightDesc {
    double radius = 0.5;
};
struct SphereLightDesc : LightDesc {
    double radius = 0.5;
};
struct CylinderLightDesc : LightDesc {
    double radius = 0.5, length = 1;
};
struct DistantLightDesc : LightDesc {
    double angle = 0.53;  // [degrees], diameter
};
// Faces of emissive meshes are placed by their corners, in render space.
struct TriangleLightDesc : LightDesc {
    std::array<Vec3<double>, 3> corners{};
};
struct DomeLightDesc : LightDesc {
    const float* image = nullptr;  // (height, width, 3), latitude-longitude, top row first; none: one colour
    std::uint32_t width = 0, height = 0;
    // Sample only what is brighter than the mean, and leave the rest to BSDF sampling: less error at equal time, but
    // right only where both strategies are combined. Karlik et al. 2019, "MIS Compensation", section 4.
    bool compensate = false;
};

// What the host, not a kernel, needs to know of a light.
struct LightInfo {
    LightKind kind;
    std::string path;
    bool visible_to_camera;
    double power;      // |emitted power|, mean of the channels; for infinite lights see finalize
    bool sampled;      // false: only rays that escape find it
    std::string note;  // what was changed to make it usable, for the report; empty if nothing
};

struct LightTable {
    std::vector<float> rows;  // (lights, kLightColumns), see LightRow
    std::vector<LightInfo> info;
    std::vector<std::uint32_t> finite, infinite;  // indices of lights
    std::uint32_t kinds = 0;                      // bit mask of the LightKinds present
    struct Dome {
        std::uint32_t light;
        DomeImage image;
    };
    std::vector<Dome> domes;  // only the domes that have an image
    Distribution1D selection;

    std::uint32_t size() const { return static_cast<std::uint32_t>(info.size()); }
    bool any_sampled() const {
        return std::any_of(info.begin(), info.end(), [](const LightInfo& i) { return i.sampled; });
    }
    bool has(LightKind kind) const { return (kinds >> static_cast<std::uint32_t>(kind) & 1U) != 0; }
};

// Each adds one light and answers "", or leaves the table as it is and answers why the light cannot shine.
std::string append_rect(LightTable& table, const RectLightDesc& desc);
std::string append_disk(LightTable& table, const DiskLightDesc& desc);
std::string append_sphere(LightTable& table, const SphereLightDesc& desc);
std::string append_cylinder(LightTable& table, const CylinderLightDesc& desc);
std::string append_distant(LightTable& table, const DistantLightDesc& desc);
std::string append_dome(LightTable& table, const DomeLightDesc& desc);
std::string append_triangle(LightTable& table, const TriangleLightDesc& desc);

// Computes what depends on all lights and on the scene: the power of infinite lights is what they send through the disc
// of scene_radius, and lights are chosen in proportion to power. Call it once, after the last append.
void finalize(LightTable& table, double scene_radius);

struct LightBounds {
    Vec3<float> lower, upper;
};
// A box around a finite light, rounded outward.
LightBounds light_bounds(const LightTable& table, std::uint32_t light);
// The corners of a rect light, in order around it, counter-clockwise seen from the side that emits.
std::array<Vec3<float>, 4> rect_corners(const LightTable& table, std::uint32_t light);

// --- rows, for kernels ---
template <class F>
inline LightRow<F> gather_row(const LightTable& table, UInt<F> light) {
    const UInt<F> at = light * UInt<F>(kLightColumns);
    return read_light_row<F>([&](std::uint32_t c) { return gather<F>(table.rows.data() + c, at); });
}
template <class F>
inline LightRow<F> broadcast_row(const LightTable& table, std::uint32_t light) {
    const float* row = table.rows.data() + std::size_t{light} * kLightColumns;
    return read_light_row<F>([&](std::uint32_t c) { return F(row[c]); });
}

}  // namespace footlight
