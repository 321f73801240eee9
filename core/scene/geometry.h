// The committed geometry: flat tables that kernels gather from, in a world whose origin is the camera.
#pragma once

#include <cstdint>
#include <vector>

#include "scene/scene.h"

namespace footlight {

// How a mesh's primvar is found for a corner of one of its triangles.
enum class PrimvarLookup : std::uint32_t { none, per_point, per_corner, constant };

inline constexpr std::uint32_t kNoLight = 0xFFFFFFFFU;

// Per-mesh facts as columns, one row per committed mesh.
struct MeshColumns {
    std::vector<std::uint32_t> material;
    std::vector<std::uint32_t> normal_kind;  // PrimvarLookup
    std::vector<std::uint32_t>
        normal_base;  // per_point: added to the point index; per_corner: to 3 * triangle + corner
    std::vector<std::uint32_t> color_kind;
    std::vector<std::uint32_t> color_base;
    std::vector<std::uint32_t> opacity_kind;
    std::vector<std::uint32_t> opacity_base;
    std::vector<float> constant_opacity;
};

// A run of triangles that one Embree geometry holds.
struct TriangleRange {
    std::uint32_t first = 0;
    std::uint32_t count = 0;
    bool visible_to_camera = true;
    bool has_opacity = false;
};

// Triangles that share one BVH: group 0 is the world, the others are prototypes.
struct TriangleGroup {
    std::vector<TriangleRange> ranges;
};

struct PlacedInstance {
    std::uint32_t group;
    bool visible_to_camera;
};

struct Geometry {
    std::vector<float> positions;        // 3 per vertex, one vertex of padding at the end
    std::vector<std::uint32_t> indices;  // 3 per triangle, into positions
    std::vector<std::uint32_t> mesh_of_triangle;
    MeshColumns meshes;
    std::vector<float> normals;  // 3 per value, unit length
    std::vector<std::uint32_t> normal_corners;
    std::vector<float> colors;  // 3 per value
    std::vector<std::uint32_t> color_corners;
    std::vector<float> opacities;
    std::vector<std::uint32_t> opacity_corners;

    // Row of the light each triangle is, or kNoLight; empty when nothing in the world emits. Faces of prototypes and of
    // partly opaque meshes are no lights: rays find their emission by chance.
    std::vector<std::uint32_t> light_of_triangle;

    std::vector<TriangleGroup> groups;
    std::vector<PlacedInstance> instances;
    // Instance transforms as 21 columns: rows of the linear part and the translation (12), then the cofactor rows (9),
    // row-vector convention; row 0 is the world itself, instance i is row i + 1.
    static constexpr int kTransformColumns = 21;
    std::vector<float> transform[kTransformColumns];

    std::vector<LeftOut> left_out;  // degenerate triangles, singular transforms
    Vec3<float> bounds_min{0, 0, 0}, bounds_max{0, 0, 0};

    [[nodiscard]] std::size_t triangle_count() const { return mesh_of_triangle.size(); }
    // Radius of the sphere around the world's bounds [stage units].
    [[nodiscard]] double scene_radius() const;
};

// Bakes everything placed once, keeps prototypes of what is placed many times. origin: the render origin, world space.
// Throws std::invalid_argument when a table outgrows its 32-bit indices.
Geometry build_geometry(const Scene& scene, Vec3<double> origin);

}  // namespace footlight
