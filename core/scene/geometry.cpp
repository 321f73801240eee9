// Commit of the geometry: transforms in double, rebased to the render origin, then rounded to float once.
#include "scene/geometry.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <utility>

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

namespace footlight {

namespace {

struct Placement {
    const Mesh* mesh;
    Matrix4 transform;
    bool visible_to_camera;
};

Vec3<double> widen(Vec3<float> v) { return {v.x, v.y, v.z}; }

bool needs_opacity(const Mesh& mesh, const PreviewSurface& material) {
    if (!material.opacity_from_primvar || mesh.opacities.empty()) return material.opacity < 1.0F;
    return std::any_of(mesh.opacities.values.begin(), mesh.opacities.values.end(), [](float o) { return o < 1.0F; });
}

// Grows the tables of one Geometry mesh by mesh.
class GeometryBuilder {
  public:
    GeometryBuilder(const Scene& scene, Vec3<double> origin) : scene_(scene), origin_(origin) {}

    Geometry build() {
        std::vector<Placement> world;
        geometry_.groups.emplace_back();
        add_transform(Matrix4{});
        for (const Instances& instances : scene_.instances()) {
            std::vector<Matrix4> kept = invertible(instances);
            if (kept.size() == 1) {
                const std::vector<Placement> placed = placements(instances, kept[0], origin_);
                world.insert(world.end(), placed.begin(), placed.end());
            } else if (kept.size() > 1) {
                add_prototype(instances, kept);
            }
        }
        bake_group(geometry_.groups[0], world);
        grow_bounds_by_world();
        geometry_.positions.resize(geometry_.positions.size() + 4, 0.0F);  // Embree reads 16 bytes at the last vertex
        if (vertex_count() > kMaxRows || geometry_.triangle_count() > kMaxRows)
            throw std::invalid_argument("the scene has more than " + std::to_string(kMaxRows) +
                                        " points or triangles after baking");
        return std::move(geometry_);
    }

  private:
    // 32-bit gathers address floats: 3 per row must stay below 2^31.
    static constexpr std::size_t kMaxRows = 715'000'000;

    [[nodiscard]] std::size_t vertex_count() const { return geometry_.positions.size() / 3; }

    std::vector<Matrix4> invertible(const Instances& instances) {
        std::vector<Matrix4> kept;
        std::size_t singular = 0;
        for (const Matrix4& m : instances.transforms) {
            if (determinant(m) != 0)
                kept.push_back(m);
            else
                ++singular;
        }
        if (singular > 0)
            geometry_.left_out.push_back(
                {instances.path, std::to_string(singular) + " of " + std::to_string(instances.transforms.size()) +
                                     " transforms are singular (determinant 0): those placements are not rendered"});
        return kept;
    }

    std::vector<Placement> placements(const Instances& instances, const Matrix4& transform, Vec3<double> origin) {
        std::vector<Placement> result;
        for (std::size_t i = 0; i < instances.meshes.size(); ++i) {
            const Mesh& mesh = scene_.meshes()[instances.meshes[i]];
            if (determinant(instances.local_transforms[i]) == 0) {
                geometry_.left_out.push_back({mesh.path, "its transform is singular (determinant 0)"});
                continue;
            }
            result.push_back(
                {&mesh, relative_to(instances.local_transforms[i] * transform, origin), instances.visible_to_camera});
        }
        return result;
    }

    void add_prototype(const Instances& instances, const std::vector<Matrix4>& transforms) {
        const auto group = static_cast<std::uint32_t>(geometry_.groups.size());
        TriangleGroup prototype;
        const std::size_t first_vertex = vertex_count();
        bake_group(prototype, placements(instances, Matrix4{}, {0, 0, 0}));
        geometry_.groups.push_back(std::move(prototype));
        const auto [low, high] = bounds(first_vertex, vertex_count());
        for (const Matrix4& m : transforms) {
            const Matrix4 placed = relative_to(m, origin_);
            geometry_.instances.push_back({group, instances.visible_to_camera});
            add_transform(placed);
            if (!(low.x <= high.x)) continue;
            for (int corner = 0; corner < 8; ++corner)
                instance_corners_.push_back(
                    transform_point(placed, {(corner & 1) != 0 ? high.x : low.x, (corner & 2) != 0 ? high.y : low.y,
                                             (corner & 4) != 0 ? high.z : low.z}));
        }
    }

    void add_transform(const Matrix4& m) {
        for (int r = 0; r < 4; ++r)
            for (int c = 0; c < 3; ++c) geometry_.transform[r * 3 + c].push_back(static_cast<float>(m.m[r][c]));
        const auto cofactor = cofactor_rows(m);
        // Only the direction of a transformed normal counts: scaling by a power of two keeps it exact and in range.
        double largest = 0;
        for (const Vec3<double>& r : cofactor) largest = std::max(largest, max_component(abs(r)));
        const double scale = largest > 0 ? std::exp2(-std::ilogb(largest)) : 1.0;
        for (int r = 0; r < 3; ++r) {
            geometry_.transform[12 + r * 3].push_back(static_cast<float>(cofactor[r].x * scale));
            geometry_.transform[12 + r * 3 + 1].push_back(static_cast<float>(cofactor[r].y * scale));
            geometry_.transform[12 + r * 3 + 2].push_back(static_cast<float>(cofactor[r].z * scale));
        }
    }

    void bake_group(TriangleGroup& group, const std::vector<Placement>& placed) {
        for (const bool visible : {true, false})
            for (const bool opacity : {false, true}) {
                TriangleRange range{.first = static_cast<std::uint32_t>(geometry_.triangle_count()),
                                    .visible_to_camera = visible,
                                    .has_opacity = opacity};
                for (const Placement& p : placed)
                    if (p.visible_to_camera == visible &&
                        needs_opacity(*p.mesh, scene_.materials()[p.mesh->material]) == opacity)
                        bake(p);
                range.count = static_cast<std::uint32_t>(geometry_.triangle_count()) - range.first;
                if (range.count > 0) group.ranges.push_back(range);
            }
    }

    void bake(const Placement& placement) {
        const Mesh& mesh = *placement.mesh;
        const std::size_t first_vertex = vertex_count();
        geometry_.positions.resize(geometry_.positions.size() + mesh.points.size() * 3);
        float* positions = geometry_.positions.data() + first_vertex * 3;
        tbb::parallel_for(tbb::blocked_range<std::size_t>(0, mesh.points.size(), 4096), [&](const auto& range) {
            for (std::size_t i = range.begin(); i < range.end(); ++i) {
                const Vec3<double> p = transform_point(placement.transform, widen(mesh.points[i]));
                positions[i * 3] = static_cast<float>(p.x);
                positions[i * 3 + 1] = static_cast<float>(p.y);
                positions[i * 3 + 2] = static_cast<float>(p.z);
            }
        });
        const std::vector<std::uint32_t> kept = add_triangles(mesh, first_vertex);
        add_mesh_row(mesh, placement.transform, first_vertex, kept);
    }

    // Adds the triangles that have an area; returns their indices in the mesh.
    std::vector<std::uint32_t> add_triangles(const Mesh& mesh, std::size_t first_vertex) {
        std::vector<std::uint32_t> kept;
        kept.reserve(mesh.triangles.size());
        const auto row = static_cast<std::uint32_t>(geometry_.meshes.material.size());
        geometry_.indices.reserve(geometry_.indices.size() + mesh.triangles.size() * 3);
        geometry_.mesh_of_triangle.reserve(geometry_.mesh_of_triangle.size() + mesh.triangles.size());
        const auto point = [&](std::uint32_t i) {
            const float* p = geometry_.positions.data() + (first_vertex + i) * 3;
            return Vec3<double>{p[0], p[1], p[2]};
        };
        for (std::uint32_t t = 0; t < mesh.triangles.size(); ++t) {
            const auto [i0, i1, i2] = mesh.triangles[t];
            const Vec3<double> p0 = point(i0);
            const double area = length_squared(cross(point(i1) - p0, point(i2) - p0));
            if (!(area > 0) || !std::isfinite(area)) continue;
            kept.push_back(t);
            for (const std::uint32_t i : mesh.triangles[t])
                geometry_.indices.push_back(static_cast<std::uint32_t>(first_vertex) + i);
            geometry_.mesh_of_triangle.push_back(row);
        }
        if (kept.size() < mesh.triangles.size())
            geometry_.left_out.push_back({mesh.path, std::to_string(mesh.triangles.size() - kept.size()) + " of " +
                                                         std::to_string(mesh.triangles.size()) +
                                                         " triangles have no area or are out of float range"});
        return kept;
    }

    void add_mesh_row(const Mesh& mesh, const Matrix4& transform, std::size_t first_vertex,
                      const std::vector<std::uint32_t>& kept) {
        MeshColumns& rows = geometry_.meshes;
        const PreviewSurface& material = scene_.materials()[mesh.material];
        rows.material.push_back(mesh.material);

        const std::size_t first_normal = geometry_.normals.size() / 3;
        add_normals(mesh, transform);
        const auto [normal_kind, normal_base] =
            locate(mesh.normals, first_normal, first_vertex, kept, geometry_.normal_corners);
        rows.normal_kind.push_back(static_cast<std::uint32_t>(normal_kind));
        rows.normal_base.push_back(normal_base);

        const std::size_t first_color = geometry_.colors.size() / 3;
        if (material.diffuse_from_primvar)
            for (const Rgb<float>& c : mesh.colors.values)
                geometry_.colors.insert(geometry_.colors.end(), {c.r, c.g, c.b});
        const auto [color_kind, color_base] =
            material.diffuse_from_primvar
                ? locate(mesh.colors, first_color, first_vertex, kept, geometry_.color_corners)
                : std::pair{PrimvarLookup::none, 0U};
        rows.color_kind.push_back(static_cast<std::uint32_t>(color_kind));
        rows.color_base.push_back(color_base);

        const bool varying_opacity = material.opacity_from_primvar && !mesh.opacities.empty();
        const std::size_t first_opacity = geometry_.opacities.size();
        if (varying_opacity)
            geometry_.opacities.insert(geometry_.opacities.end(), mesh.opacities.values.begin(),
                                       mesh.opacities.values.end());
        const auto [opacity_kind, opacity_base] =
            varying_opacity ? locate(mesh.opacities, first_opacity, first_vertex, kept, geometry_.opacity_corners)
                            : std::pair{PrimvarLookup::none, 0U};
        rows.opacity_kind.push_back(static_cast<std::uint32_t>(opacity_kind));
        rows.opacity_base.push_back(opacity_base);
        rows.constant_opacity.push_back(material.opacity);
    }

    // Where the corners of the mesh's triangles find their value. Corner tables keep the order of the kept triangles.
    template <class T>
    std::pair<PrimvarLookup, std::uint32_t> locate(const Primvar<T>& primvar, std::size_t first_value,
                                                   std::size_t first_vertex, const std::vector<std::uint32_t>& kept,
                                                   std::vector<std::uint32_t>& corners) {
        if (primvar.empty()) return {PrimvarLookup::none, 0U};
        if (primvar.values.size() == 1) return {PrimvarLookup::constant, static_cast<std::uint32_t>(first_value)};
        if (primvar.indices.empty())
            return {PrimvarLookup::per_point,
                    static_cast<std::uint32_t>(first_value) - static_cast<std::uint32_t>(first_vertex)};
        const std::size_t first_triangle = geometry_.triangle_count() - kept.size();
        const std::size_t base = corners.size() - first_triangle * 3;
        for (const std::uint32_t t : kept)
            for (const std::uint32_t i : primvar.indices[t])
                corners.push_back(static_cast<std::uint32_t>(first_value) + i);
        return {PrimvarLookup::per_corner, static_cast<std::uint32_t>(base)};
    }

    void add_normals(const Mesh& mesh, const Matrix4& transform) {
        const std::size_t first = geometry_.normals.size();
        const auto cofactor = cofactor_rows(transform);
        geometry_.normals.resize(first + mesh.normals.values.size() * 3);
        float* normals = geometry_.normals.data() + first;
        tbb::parallel_for(tbb::blocked_range<std::size_t>(0, mesh.normals.values.size(), 4096), [&](const auto& range) {
            for (std::size_t i = range.begin(); i < range.end(); ++i) {
                const Vec3<double> n = transform_normal(cofactor, widen(mesh.normals.values[i]));
                const double l = length(n);
                // A normal without direction becomes zero; shading then takes the face's own.
                const double scale = l > 0 && std::isfinite(l) ? 1.0 / l : 0.0;
                normals[i * 3] = static_cast<float>(n.x * scale);
                normals[i * 3 + 1] = static_cast<float>(n.y * scale);
                normals[i * 3 + 2] = static_cast<float>(n.z * scale);
            }
        });
    }

    [[nodiscard]] std::pair<Vec3<double>, Vec3<double>> bounds(std::size_t begin, std::size_t end) const {
        constexpr double kInfinity = std::numeric_limits<double>::infinity();
        Vec3<double> low{kInfinity, kInfinity, kInfinity}, high{-kInfinity, -kInfinity, -kInfinity};
        for (std::size_t i = begin; i < end; ++i) {
            const float* p = geometry_.positions.data() + i * 3;
            low = {std::min<double>(low.x, p[0]), std::min<double>(low.y, p[1]), std::min<double>(low.z, p[2])};
            high = {std::max<double>(high.x, p[0]), std::max<double>(high.y, p[1]), std::max<double>(high.z, p[2])};
        }
        return {low, high};
    }

    void grow_bounds_by_world() {
        // World vertices are the ones baked last.
        std::size_t world_begin = vertex_count();
        for (const TriangleRange& range : geometry_.groups[0].ranges)
            for (std::size_t i = std::size_t{range.first} * 3; i < (std::size_t{range.first} + range.count) * 3; ++i)
                world_begin = std::min<std::size_t>(world_begin, geometry_.indices[i]);
        auto [low, high] = bounds(world_begin, vertex_count());
        for (const Vec3<double>& p : instance_corners_) {
            low = {std::min(low.x, p.x), std::min(low.y, p.y), std::min(low.z, p.z)};
            high = {std::max(high.x, p.x), std::max(high.y, p.y), std::max(high.z, p.z)};
        }
        if (!(low.x <= high.x)) return;
        geometry_.bounds_min = {static_cast<float>(low.x), static_cast<float>(low.y), static_cast<float>(low.z)};
        geometry_.bounds_max = {static_cast<float>(high.x), static_cast<float>(high.y), static_cast<float>(high.z)};
    }

    const Scene& scene_;
    Vec3<double> origin_;
    Geometry geometry_;
    std::vector<Vec3<double>> instance_corners_;
};

}  // namespace

double Geometry::scene_radius() const {
    const bool empty = !(bounds_min.x <= bounds_max.x);
    return empty ? 0 : length(widen(bounds_max) - widen(bounds_min)) * 0.5;
}

Geometry build_geometry(const Scene& scene, Vec3<double> origin) { return GeometryBuilder(scene, origin).build(); }

}  // namespace footlight
