// Stage: from hits to surface points: position, normals, colour, and how far off a new ray must start.
#include <limits>

#include "math/vec.h"
#include "pipeline/worker.h"

namespace footlight {

namespace {

// Error bounds of float arithmetic after n operations (Higham 2002, section 3.1; pbrt-v4, section 6.8).
constexpr float gamma(int n) { return static_cast<float>(n * 0x1p-24 / (1 - n * 0x1p-24)); }
// Barycentric interpolation rounds six times; the spawned ray's origin clears four times that bound, because Embree's
// own test rounds too (0 self-hits and 0 missed gaps over 9 decades of scale and distance).
constexpr float kInterpolationError = gamma(6);
constexpr float kTransformError = gamma(3);
// Embree takes the spawned ray's origin back into the instance's space: three products, and the rounded inverse.
constexpr float kReturnError = gamma(4);
constexpr float kClearance = 4.0F;

struct Corners {
    UIntV index[3];
};

Vec3<FloatV> load_row3(const std::vector<float>& table, UIntV row) {
    const UIntV at = row * UIntV(3U);
    return {gather<FloatV>(table.data(), at), gather<FloatV>(table.data() + 1, at),
            gather<FloatV>(table.data() + 2, at)};
}

// Rows of a primvar at the triangle's corners; `constant` and `none` lanes get a row that exists.
Corners primvar_rows(UIntV kind, UIntV base, UIntV triangle, const Corners& points,
                     const std::vector<std::uint32_t>& corners) {
    const Mask<FloatV> per_point = equal<FloatV>(kind, UIntV(static_cast<std::uint32_t>(PrimvarLookup::per_point)));
    const Mask<FloatV> per_corner = equal<FloatV>(kind, UIntV(static_cast<std::uint32_t>(PrimvarLookup::per_corner)));
    const Mask<FloatV> constant = equal<FloatV>(kind, UIntV(static_cast<std::uint32_t>(PrimvarLookup::constant)));
    Corners rows{};
    for (std::uint32_t c = 0; c < 3; ++c) {
        UIntV row = select(per_point, base + points.index[c], select(constant, base, UIntV(0U)));
        if (any(per_corner)) {
            const UIntV at = select(per_corner, base + triangle * UIntV(3U) + UIntV(c), UIntV(0U));
            row = select(per_corner, gather_uint<FloatV>(corners.data(), at), row);
        }
        rows.index[c] = row;
    }
    return rows;
}

Vec3<FloatV> interpolate(const std::vector<float>& table, const Corners& rows, FloatV u, FloatV v) {
    const FloatV w = FloatV(1.0F) - u - v;
    return load_row3(table, rows.index[0]) * w + load_row3(table, rows.index[1]) * u +
           load_row3(table, rows.index[2]) * v;
}

// Unit length without underflow for the normals of the smallest faces.
Vec3<FloatV> normalize_any_scale(Vec3<FloatV> v) {
    const FloatV largest = max_component(abs(v));
    return normalize(v * (FloatV(1.0F) / largest));
}

Vec3<FloatV> face_towards(Vec3<FloatV> n, Vec3<FloatV> w) {
    const FloatV side = select(dot(n, w) < FloatV(0.0F), FloatV(-1.0F), FloatV(1.0F));
    return n * side;
}

struct Point {
    Vec3<FloatV> position, error;  // error: bound per axis [stage units]
    Vec3<FloatV> normal;           // unit face normal, either side
};

Point triangle_point(const Geometry& geometry, const Corners& corners, FloatV u, FloatV v) {
    const Vec3<FloatV> p0 = load_row3(geometry.positions, corners.index[0]);
    const Vec3<FloatV> p1 = load_row3(geometry.positions, corners.index[1]);
    const Vec3<FloatV> p2 = load_row3(geometry.positions, corners.index[2]);
    const FloatV w = FloatV(1.0F) - u - v;
    const Vec3<FloatV> a = p0 * w, b = p1 * u, c = p2 * v;
    return {a + b + c, (abs(a) + abs(b) + abs(c)) * FloatV(kInterpolationError),
            normalize_any_scale(cross(p1 - p0, p2 - p0))};
}

// Instance transforms of a group of lanes; row 0 is the identity, exact to the bit.
struct LaneTransform {
    Vec3<FloatV> row[4];       // p' = p.x row0 + p.y row1 + p.z row2 + row3
    Vec3<FloatV> cofactor[3];  // n' ~ n.x c0 + n.y c1 + n.z c2
    Mask<FloatV> is_world;

    LaneTransform(const Geometry& geometry, UIntV instance) : is_world(equal<FloatV>(instance, UIntV(0U))) {
        const auto load = [&](int column) {
            return Vec3<FloatV>{gather<FloatV>(geometry.transform[column].data(), instance),
                                gather<FloatV>(geometry.transform[column + 1].data(), instance),
                                gather<FloatV>(geometry.transform[column + 2].data(), instance)};
        };
        for (int r = 0; r < 4; ++r) row[r] = load(r * 3);
        for (int r = 0; r < 3; ++r) cofactor[r] = load(12 + r * 3);
    }

    [[nodiscard]] Vec3<FloatV> normal(Vec3<FloatV> n) const {
        return select(is_world, n, cofactor[0] * n.x + cofactor[1] * n.y + cofactor[2] * n.z);
    }

    [[nodiscard]] Point apply(const Point& p) const {
        const Vec3<FloatV> x = row[0] * p.position.x, y = row[1] * p.position.y, z = row[2] * p.position.z;
        const Vec3<FloatV> carried = abs(row[0]) * p.error.x + abs(row[1]) * p.error.y + abs(row[2]) * p.error.z;
        const Vec3<FloatV> own = (abs(x) + abs(y) + abs(z) + abs(row[3])) * FloatV(kTransformError);
        const Vec3<FloatV> position = x + y + z + row[3];
        const Vec3<FloatV> returned = there_and_back(abs(position) + abs(row[3])) * FloatV(kReturnError);
        return {select(is_world, p.position, position),
                select(is_world, p.error, carried * FloatV(1.0F + kTransformError) + own + returned),
                select(is_world, p.normal, normalize_any_scale(normal(p.normal)))};
    }

  private:
    // |M| |M^-1| v: what the terms of a point's way into the instance's space amount to in the world. They cancel for
    // an instance far from the camera, their roundings do not.
    [[nodiscard]] Vec3<FloatV> there_and_back(Vec3<FloatV> v) const {
        const FloatV inverse_determinant = FloatV(1.0F) / abs(dot(row[0], cofactor[0]));
        Vec3<FloatV> sum{FloatV(0.0F), FloatV(0.0F), FloatV(0.0F)};
        for (int r = 0; r < 3; ++r) sum = sum + abs(row[r]) * (dot(abs(cofactor[r]), v) * inverse_determinant);
        return sum;
    }
};

// Shading normal on the side of wo; the face's own where the interpolated one has no direction or faces away.
Vec3<FloatV> shading_normal(Mask<FloatV> has_normals, Vec3<FloatV> interpolated, Vec3<FloatV> geometric,
                            Vec3<FloatV> wo) {
    const FloatV squared = length_squared(interpolated);
    const Vec3<FloatV> n = face_towards(interpolated * (FloatV(1.0F) / sqrt(squared)), geometric);
    // Half a degree above the horizon: below it a frame around n would put wo under the surface.
    const Mask<FloatV> usable = has_normals & (squared > FloatV(1e-12F)) & (dot(n, wo) > FloatV(0.01F));
    return select(usable, n, geometric);
}

}  // namespace

void surface(Worker& w) noexcept {
    const CommittedScene& scene = w.scene;
    const Geometry& geometry = scene.geometry;
    const bool instances = scene.effects.active(Effect::instances);
    const bool normals = scene.effects.active(Effect::shading_normals);
    const bool colors = scene.effects.active(Effect::vertex_color);
    SurfaceColumns& s = w.surfaces;
    w.surface_count = 0;
    for (RowRange& run : w.lobe_set_runs) run = {};
    // Nothing is scattered at the end of the last edge; only camera rays still have AOVs to write.
    const bool last_edge = static_cast<int>(w.bounce) + 1 >= scene.options.max_depth;
    if (last_edge && w.bounce > 0) return;

    for (int set = 0; set < kLobeSets; ++set) {
        RowList& list = w.by_lobe_set[set];
        list.pad();
        // Runs start at a full register, so that scatter reads whole ones.
        const std::size_t begin = (w.surface_count + kLanes - 1) / kLanes * kLanes;
        w.lobe_set_runs[set] = {begin, begin + list.count};
        w.surface_count = begin + list.count;
        for (std::size_t i = 0; i < list.count; i += kLanes) {
            const std::size_t out = begin + i;
            const UIntV hit = list.load(i);
            const UIntV path = gather_uint<FloatV>(w.living.rows.data(), hit);
            const UIntV triangle = gather_uint<FloatV>(w.hits.id.data(), hit);
            const FloatV u = gather<FloatV>(w.hits.u.data(), hit), v = gather<FloatV>(w.hits.v.data(), hit);
            const UIntV mesh = gather_uint<FloatV>(geometry.mesh_of_triangle.data(), triangle);
            const UIntV material = gather_uint<FloatV>(geometry.meshes.material.data(), mesh);
            const UIntV first_index = triangle * UIntV(3U);
            const Corners corners{{gather_uint<FloatV>(geometry.indices.data(), first_index),
                                   gather_uint<FloatV>(geometry.indices.data() + 1, first_index),
                                   gather_uint<FloatV>(geometry.indices.data() + 2, first_index)}};
            const Vec3<FloatV> wo = -w.paths.direction.gather_rows(path);

            Point point = triangle_point(geometry, corners, u, v);
            Vec3<FloatV> interpolated = point.normal;
            Mask<FloatV> has_normals(false);
            if (normals && !geometry.normals.empty()) {
                const UIntV kind = gather_uint<FloatV>(geometry.meshes.normal_kind.data(), mesh);
                const UIntV base = gather_uint<FloatV>(geometry.meshes.normal_base.data(), mesh);
                const Corners rows = primvar_rows(kind, base, triangle, corners, geometry.normal_corners);
                has_normals = !equal<FloatV>(kind, UIntV(static_cast<std::uint32_t>(PrimvarLookup::none)));
                interpolated = interpolate(geometry.normals, rows, u, v);
            }
            if (instances) {
                const UIntV instance = gather_uint<FloatV>(w.hits.instance.data(), hit);
                const LaneTransform transform(geometry, instance);
                interpolated = transform.normal(interpolated);
                point = transform.apply(point);
            }
            const Vec3<FloatV> geometric = face_towards(point.normal, wo);
            const Vec3<FloatV> shading = normals ? shading_normal(has_normals, interpolated, geometric, wo) : geometric;

            Rgb<FloatV> color{gather<FloatV>(scene.materials.base[0].data(), material),
                              gather<FloatV>(scene.materials.base[1].data(), material),
                              gather<FloatV>(scene.materials.base[2].data(), material)};
            if (colors && !geometry.colors.empty()) {
                const UIntV kind = gather_uint<FloatV>(geometry.meshes.color_kind.data(), mesh);
                const UIntV base = gather_uint<FloatV>(geometry.meshes.color_base.data(), mesh);
                const Corners rows = primvar_rows(kind, base, triangle, corners, geometry.color_corners);
                const Mask<FloatV> none = equal<FloatV>(kind, UIntV(static_cast<std::uint32_t>(PrimvarLookup::none)));
                const Vec3<FloatV> c = interpolate(geometry.colors, rows, u, v);
                color = select(none, color,
                               Rgb<FloatV>{max(c.x, FloatV(0.0F)), max(c.y, FloatV(0.0F)), max(c.z, FloatV(0.0F))});
            }
            s.position.store(out, point.position);
            s.wo.store(out, wo);
            s.geometric.store(out, geometric);
            s.shading.store(out, shading);
            s.color.store(out, color);
            s.throughput.store(out, w.paths.throughput.gather_rows(path));
            (dot(point.error, abs(geometric)) * FloatV(kClearance)).store_aligned(&s.offset[out]);
            material.store_aligned(&s.material[out]);
            gather_uint<FloatV>(w.paths.key.data(), path).store_aligned(&s.key[out]);
            gather_uint<FloatV>(w.paths.reversed_index.data(), path).store_aligned(&s.reversed_index[out]);
            gather_uint<FloatV>(w.paths.slot.data(), path).store_aligned(&s.slot[out]);
        }
    }
}

}  // namespace footlight
