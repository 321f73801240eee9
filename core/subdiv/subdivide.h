// Subdivision surfaces: polygon cage in, triangles with points and normals on the limit surface out.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

namespace footlight {

// USD's words: UsdGeomMesh subdivisionScheme, interpolateBoundary, faceVaryingLinearInterpolation,
// triangleSubdivisionRule.
enum class SubdivScheme : std::uint8_t { catmull_clark, loop };
enum class SubdivBoundary : std::uint8_t { none, edge_only, edge_and_corner };
enum class SubdivFaceVarying : std::uint8_t { none, corners_only, corners_plus1, corners_plus2, boundaries, all };
enum class SubdivTriangleRule : std::uint8_t { catmull_clark, smooth };

enum class PrimvarKind : std::uint8_t { vertex, varying, face_varying };

struct SubdivPrimvar {
    PrimvarKind kind = PrimvarKind::vertex;
    int width = 3;                          // floats per value, 1..4
    std::span<const float> values;          // width per value; vertex and varying: one value per point
    std::span<const std::int32_t> indices;  // face varying: one per face corner; empty: 0, 1, 2, …
};

struct SubdivCage {
    std::span<const float> points;               // 3 per point, any unit
    std::span<const std::int32_t> face_counts;   // corners per face, at least 3
    std::span<const std::int32_t> face_indices;  // point of each corner
    SubdivScheme scheme = SubdivScheme::catmull_clark;
    SubdivBoundary boundary = SubdivBoundary::edge_and_corner;
    SubdivFaceVarying face_varying = SubdivFaceVarying::corners_plus1;
    SubdivTriangleRule triangle_rule = SubdivTriangleRule::catmull_clark;
    std::span<const std::int32_t> crease_indices;  // points of all creases, one crease after another
    std::span<const std::int32_t> crease_lengths;  // points per crease, at least 2
    std::span<const float> crease_sharpnesses;  // one per crease, or one per crease edge; 10 and more: infinitely sharp
    std::span<const std::int32_t> corner_indices;
    std::span<const float> corner_sharpnesses;  // one per corner
    std::span<const std::int32_t> holes;        // faces that are not there
    std::span<const SubdivPrimvar> primvars;
};

struct SubdividedPrimvar {
    int width = 3;
    std::vector<float> values;
    std::vector<std::uint32_t> indices;  // 3 per triangle
};

struct SubdividedMesh {
    std::vector<float> points;   // 3 per point, on the limit surface
    std::vector<float> normals;  // 3 per normal, unit; the first points/3 belong to the points of the same index
    std::vector<std::uint32_t> triangles;         // 3 points per triangle, wound as the cage
    std::vector<std::uint32_t> normal_indices;    // 3 per triangle; corners at sharp edges have normals of their own
    std::vector<std::uint32_t> face_of_triangle;  // cage face of each triangle
    std::vector<SubdividedPrimvar> primvars;      // in the order of SubdivCage::primvars
};

// Refines `level` times (1..10), each face into 4, and pushes the points to the limit.
// Throws std::invalid_argument naming the array, the index and what is allowed.
[[nodiscard]] SubdividedMesh subdivide(const SubdivCage& cage, int level);

}  // namespace footlight
