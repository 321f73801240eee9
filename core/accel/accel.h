// Ray queries against the committed geometry. The only folder that knows Embree.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>

#include "light/light_table.h"
#include "scene/geometry.h"

namespace footlight {

// What a ray is for: decides which objects it may see.
enum class RayKind : unsigned { camera = 1, bounce = 2, shadow = 4 };

// Rays as columns. tnear null: 0; tfar null: infinity.
struct RayColumns {
    const float* origin[3];
    const float* direction[3];
    const float* tnear;
    const float* tfar;
};

// The id of a hit that is none. Instance row 0 is the world itself.
inline constexpr std::uint32_t kMiss = 0xFFFFFFFFU;
// Set in `id` when a light was hit: the other bits are the light's row.
inline constexpr std::uint32_t kLightBit = 0x80000000U;

// Hits as columns, one per ray of the list: id is a triangle, a light (kLightBit) or kMiss.
struct HitColumns {
    std::uint32_t* id;
    std::uint32_t* instance;  // row of Geometry::transform
    float* t;
    float* u;
    float* v;
};

class Accel {
  public:
    // geometry and lights are referred to, not copied: they must outlive the Accel.
    // Builds with the threads of the calling task arena.
    Accel(const Geometry& geometry, const LightTable& lights);
    ~Accel();
    Accel(const Accel&) = delete;
    Accel& operator=(const Accel&) = delete;

    // Nearest hit of rays[list[i]], i in [0, count), written to hits at i. The list is readable to the next multiple of
    // kLanes. opacity_u: column of numbers in [0, 1) that decide partly opaque surfaces, or null when nothing is partly
    // opaque. together: walk the BVH once for all rays of a packet, which pays where they meet the same nodes.
    void intersect(const RayColumns& rays, const std::uint32_t* list, std::size_t count, RayKind kind, bool together,
                   const float* opacity_u, const HitColumns& hits) const noexcept;

    // occluded[i] = 1 when rays[list[i]] meets anything between its ends, else 0. light: column of the rows of the
    // lights that the rays ask for; no such light shadows itself. Faces of emissive meshes are surfaces here: a ray
    // towards one has to end before it.
    void occluded(const RayColumns& rays, const std::uint32_t* list, std::size_t count, const std::uint32_t* light,
                  const float* opacity_u, std::uint8_t* occluded) const noexcept;

    // Bytes Embree holds for the scene.
    [[nodiscard]] std::size_t bytes() const;
    [[nodiscard]] static std::string embree_version();

  private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace footlight
