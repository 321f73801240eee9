// Ray queries against the committed geometry, on Embree.
#include "accel/accel.h"

#include <algorithm>
#include <atomic>
#include <bit>
#include <limits>
#include <new>
#include <stdexcept>
#include <vector>

#include "accel/packet.h"
#include "light/light.h"
#include "math/sampler.h"

namespace footlight {

namespace {

constexpr unsigned kSeenByAll = static_cast<unsigned>(RayKind::camera) | static_cast<unsigned>(RayKind::bounce) |
                                static_cast<unsigned>(RayKind::shadow);
constexpr unsigned kHiddenFromCamera = kSeenByAll & ~static_cast<unsigned>(RayKind::camera);

unsigned visibility_mask(bool visible_to_camera) { return visible_to_camera ? kSeenByAll : kHiddenFromCamera; }

// Lights that Embree finds through callbacks; a rect is two triangles.
bool is_curved(LightKind kind) {
    return kind == LightKind::disk || kind == LightKind::sphere || kind == LightKind::cylinder;
}

// What an Embree geometry of one scene stands for.
struct GeometryEntry {
    bool is_light = false;
    std::uint32_t first_triangle = 0;               // triangles: id = first_triangle + primID
    std::vector<std::uint32_t> light_of_primitive;  // lights: the light's row
};

// Embree hands this back to filters and callbacks.
struct QueryContext {
    RTCIntersectContext embree;
    const float* opacity_u;
    const std::uint32_t* light;  // of shadow rays, by ray id
};

}  // namespace

struct Accel::Impl {
    const Geometry& geometry;
    const LightTable& lights;
    std::atomic<std::int64_t> bytes{0};
    RTCDevice device = nullptr;
    RTCScene world = nullptr;
    std::vector<RTCScene> prototypes;  // of group g at g - 1
    std::vector<GeometryEntry> world_entries;
    std::vector<std::vector<GeometryEntry>> group_entries;  // of prototypes
    std::uint32_t first_instance_id = 0;

    Impl(const Geometry& geometry_in, const LightTable& lights_in) : geometry(geometry_in), lights(lights_in) {
        // No thread count: Embree would impose it on the whole process. It builds in the caller's task arena.
        device = rtcNewDevice(nullptr);
        if (device == nullptr) throw std::runtime_error("Embree could not be started on this processor");
        rtcSetDeviceMemoryMonitorFunction(
            device,
            [](void* self, ssize_t count, bool) {
                static_cast<Impl*>(self)->bytes += count;
                return true;
            },
            this);
        build();
        // Data is checked before it comes here: what is left is exhausted memory.
        const RTCError error = rtcGetDeviceError(device);
        if (error != RTC_ERROR_NONE) {
            release();
            if (error == RTC_ERROR_OUT_OF_MEMORY) throw std::bad_alloc();
            throw std::runtime_error("Embree failed to build the scene, error code " + std::to_string(error));
        }
    }

    ~Impl() { release(); }

    void release() {
        for (RTCScene scene : prototypes) rtcReleaseScene(scene);
        if (world != nullptr) rtcReleaseScene(world);
        rtcReleaseDevice(device);
    }

    Impl(const Impl&) = delete;
    Impl& operator=(const Impl&) = delete;

    RTCScene new_scene() {
        RTCScene scene = rtcNewScene(device);
        rtcSetSceneFlags(scene, RTC_SCENE_FLAG_ROBUST);
        rtcSetSceneBuildQuality(scene, RTC_BUILD_QUALITY_MEDIUM);
        return scene;
    }

    void build() {
        for (std::size_t g = 1; g < geometry.groups.size(); ++g) {
            RTCScene scene = new_scene();
            prototypes.push_back(scene);
            std::vector<GeometryEntry>& entries = group_entries.emplace_back();
            // A prototype's own visibility is its instances'.
            for (const TriangleRange& range : geometry.groups[g].ranges) add_triangles(scene, range, true, entries);
            rtcCommitScene(scene);
        }
        world = new_scene();
        for (const TriangleRange& range : geometry.groups[0].ranges)
            add_triangles(world, range, range.visible_to_camera, world_entries);
        for (const bool visible : {true, false}) {
            add_rect_lights(visible);
            add_curved_lights(visible);
        }
        first_instance_id = static_cast<std::uint32_t>(world_entries.size());
        for (std::size_t i = 0; i < geometry.instances.size(); ++i) add_instance(i);
        rtcCommitScene(world);
    }

    void attach(RTCScene scene, RTCGeometry handle, std::uint32_t id) {
        rtcCommitGeometry(handle);
        rtcAttachGeometryByID(scene, handle, id);
        rtcReleaseGeometry(handle);
    }

    void add_triangles(RTCScene scene, const TriangleRange& range, bool visible, std::vector<GeometryEntry>& entries) {
        RTCGeometry handle = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
        rtcSetSharedGeometryBuffer(handle, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, geometry.positions.data(), 0,
                                   3 * sizeof(float), geometry.positions.size() / 3 - 1);
        rtcSetSharedGeometryBuffer(handle, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, geometry.indices.data(),
                                   std::size_t{range.first} * 3 * sizeof(std::uint32_t), 3 * sizeof(std::uint32_t),
                                   range.count);
        rtcSetGeometryMask(handle, visibility_mask(visible));
        if (range.has_opacity) {
            rtcSetGeometryUserData(handle, this);
            rtcSetGeometryIntersectFilterFunction(handle, filter_opacity);
            rtcSetGeometryOccludedFilterFunction(handle, filter_opacity);
        }
        attach(scene, handle, static_cast<std::uint32_t>(entries.size()));
        entries.push_back({.is_light = false, .first_triangle = range.first, .light_of_primitive = {}});
    }

    void add_rect_lights(bool visible) {
        GeometryEntry entry{.is_light = true, .first_triangle = 0, .light_of_primitive = {}};
        std::vector<float> corners;
        for (std::uint32_t light = 0; light < lights.size(); ++light) {
            if (lights.info[light].kind != LightKind::rect || lights.info[light].visible_to_camera != visible) continue;
            for (const Vec3<float>& p : rect_corners(lights, light)) corners.insert(corners.end(), {p.x, p.y, p.z});
            entry.light_of_primitive.insert(entry.light_of_primitive.end(), {light, light});
        }
        if (corners.empty()) return;
        RTCGeometry handle = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
        auto* vertices = static_cast<float*>(rtcSetNewGeometryBuffer(
            handle, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, 3 * sizeof(float), corners.size() / 3));
        std::copy(corners.begin(), corners.end(), vertices);
        auto* indices = static_cast<std::uint32_t*>(rtcSetNewGeometryBuffer(handle, RTC_BUFFER_TYPE_INDEX, 0,
                                                                            RTC_FORMAT_UINT3, 3 * sizeof(std::uint32_t),
                                                                            entry.light_of_primitive.size()));
        for (std::uint32_t rect = 0; rect < corners.size() / 12; ++rect)
            for (const std::uint32_t corner : {0U, 1U, 2U, 0U, 2U, 3U}) *indices++ = rect * 4 + corner;
        rtcSetGeometryMask(handle, visibility_mask(visible));
        rtcSetGeometryUserData(handle, this);
        rtcSetGeometryOccludedFilterFunction(handle, pass_own_light);
        attach(world, handle, static_cast<std::uint32_t>(world_entries.size()));
        world_entries.push_back(std::move(entry));
    }

    static void pass_own_light(const RTCFilterFunctionNArguments* args) {
        const auto* self = static_cast<const Impl*>(args->geometryUserPtr);
        const auto* context = reinterpret_cast<const QueryContext*>(args->context);
        const unsigned n = args->N;
        for (unsigned i = 0; i < n; ++i) {
            if (args->valid[i] == 0) continue;
            const GeometryEntry& entry = self->world_entries[RTCHitN_geomID(args->hit, n, i)];
            const std::uint32_t light = entry.light_of_primitive[RTCHitN_primID(args->hit, n, i)];
            if (light == context->light[RTCRayN_id(args->ray, n, i)]) args->valid[i] = 0;
        }
    }

    void add_curved_lights(bool visible) {
        GeometryEntry entry{.is_light = true, .first_triangle = 0, .light_of_primitive = {}};
        for (std::uint32_t light = 0; light < lights.size(); ++light)
            if (is_curved(lights.info[light].kind) && lights.info[light].visible_to_camera == visible)
                entry.light_of_primitive.push_back(light);
        if (entry.light_of_primitive.empty()) return;
        RTCGeometry handle = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_USER);
        const auto id = static_cast<std::uint32_t>(world_entries.size());
        rtcSetGeometryUserPrimitiveCount(handle, static_cast<unsigned>(entry.light_of_primitive.size()));
        rtcSetGeometryUserData(handle, this);
        world_entries.push_back(std::move(entry));
        // Callbacks find their light through world_entries: the geometry's id in the world is not known to the bounds
        // one.
        rtcSetGeometryBoundsFunction(handle, visible ? bounds_of<true> : bounds_of<false>, nullptr);
        rtcSetGeometryIntersectFunction(handle, intersect_light<true>);
        rtcSetGeometryOccludedFunction(handle, intersect_light<false>);
        rtcSetGeometryMask(handle, visibility_mask(visible));
        curved_entry[visible ? 0 : 1] = id;
        attach(world, handle, id);
    }

    void add_instance(std::size_t i) {
        const PlacedInstance& instance = geometry.instances[i];
        RTCGeometry handle = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_INSTANCE);
        rtcSetGeometryInstancedScene(handle, prototypes[instance.group - 1]);
        float columns[12];
        for (int c = 0; c < 12; ++c) columns[c] = geometry.transform[c][i + 1];
        rtcSetGeometryTransform(handle, 0, RTC_FORMAT_FLOAT3X4_COLUMN_MAJOR, columns);
        rtcSetGeometryMask(handle, visibility_mask(instance.visible_to_camera));
        attach(world, handle, first_instance_id + static_cast<std::uint32_t>(i));
    }

    std::uint32_t curved_entry[2] = {0, 0};

    template <bool Visible>
    static void bounds_of(const RTCBoundsFunctionArguments* args) {
        const auto* self = static_cast<const Impl*>(args->geometryUserPtr);
        const GeometryEntry& entry = self->world_entries[self->curved_entry[Visible ? 0 : 1]];
        const LightBounds b = light_bounds(self->lights, entry.light_of_primitive[args->primID]);
        args->bounds_o->lower_x = b.lower.x;
        args->bounds_o->lower_y = b.lower.y;
        args->bounds_o->lower_z = b.lower.z;
        args->bounds_o->upper_x = b.upper.x;
        args->bounds_o->upper_y = b.upper.y;
        args->bounds_o->upper_z = b.upper.z;
    }

    // Intersect and occluded callbacks have argument structs of the same members but the hit.
    template <bool Closest, class Args>
    static void intersect_light_rays(const Args* args, RTCRayN* rays, RTCHitN* hits) {
        const auto* self = static_cast<const Impl*>(args->geometryUserPtr);
        const GeometryEntry& entry = self->world_entries[args->geomID];
        const std::uint32_t light = entry.light_of_primitive[args->primID];
        const unsigned n = args->N;
        for (unsigned i = 0; i < n; ++i) {
            if (args->valid[i] == 0) continue;
            if constexpr (!Closest) {
                const auto* context = reinterpret_cast<const QueryContext*>(args->context);
                if (light == context->light[RTCRayN_id(rays, n, i)]) continue;
            }
            const Vec3<float> o{RTCRayN_org_x(rays, n, i), RTCRayN_org_y(rays, n, i), RTCRayN_org_z(rays, n, i)};
            const Vec3<float> d{RTCRayN_dir_x(rays, n, i), RTCRayN_dir_y(rays, n, i), RTCRayN_dir_z(rays, n, i)};
            const float t = footlight::intersect_light<float>(self->lights, light, o, d);
            if (!(t > RTCRayN_tnear(rays, n, i) && t < RTCRayN_tfar(rays, n, i))) continue;
            if constexpr (Closest) {
                RTCRayN_tfar(rays, n, i) = t;
                RTCHitN_geomID(hits, n, i) = args->geomID;
                RTCHitN_primID(hits, n, i) = args->primID;
                RTCHitN_instID(hits, n, i, 0) = RTC_INVALID_GEOMETRY_ID;
                RTCHitN_u(hits, n, i) = 0;
                RTCHitN_v(hits, n, i) = 0;
            } else {
                RTCRayN_tfar(rays, n, i) = -std::numeric_limits<float>::infinity();
            }
        }
    }
    template <bool Closest>
    static void intersect_light(
        const std::conditional_t<Closest, RTCIntersectFunctionNArguments, RTCOccludedFunctionNArguments>* args) {
        if constexpr (Closest)
            intersect_light_rays<true>(args, RTCRayHitN_RayN(args->rayhit, args->N),
                                       RTCRayHitN_HitN(args->rayhit, args->N));
        else
            intersect_light_rays<false>(args, args->ray, nullptr);
    }

    [[nodiscard]] float opacity_at(std::uint32_t triangle, float u, float v) const {
        const std::uint32_t mesh = geometry.mesh_of_triangle[triangle];
        const auto kind = static_cast<PrimvarLookup>(geometry.meshes.opacity_kind[mesh]);
        const std::uint32_t base = geometry.meshes.opacity_base[mesh];
        if (kind == PrimvarLookup::none) return geometry.meshes.constant_opacity[mesh];
        if (kind == PrimvarLookup::constant) return geometry.opacities[base];
        float corner[3];
        for (std::uint32_t c = 0; c < 3; ++c)
            corner[c] =
                geometry
                    .opacities[kind == PrimvarLookup::per_point ? base + geometry.indices[triangle * std::size_t{3} + c]
                                                                : geometry.opacity_corners[base + triangle * 3 + c]];
        return (1.0F - u - v) * corner[0] + u * corner[1] + v * corner[2];
    }

    // A partly opaque surface is there or not, decided by the ray's number and the triangle, so asking twice gives the
    // same answer and shadow rays see what bounce rays see.
    static void filter_opacity(const RTCFilterFunctionNArguments* args) {
        const auto* self = static_cast<const Impl*>(args->geometryUserPtr);
        const auto* context = reinterpret_cast<const QueryContext*>(args->context);
        const unsigned n = args->N;
        for (unsigned i = 0; i < n; ++i) {
            if (args->valid[i] == 0) continue;
            const std::uint32_t instance_id = RTCHitN_instID(args->hit, n, i, 0);
            const GeometryEntry& entry = self->entry_of(instance_id, RTCHitN_geomID(args->hit, n, i));
            const std::uint32_t triangle = entry.first_triangle + RTCHitN_primID(args->hit, n, i);
            const float opacity = self->opacity_at(triangle, RTCHitN_u(args->hit, n, i), RTCHitN_v(args->hit, n, i));
            // A hash of both: with a number shifted per triangle, the layers that one ray crosses would not be
            // independent.
            const auto ray = std::bit_cast<std::uint32_t>(context->opacity_u[RTCRayN_id(args->ray, n, i)]);
            const float u = to_unit<float>(mix_bits(ray ^ mix_bits(triangle * 0x9e3779b9U ^ mix_bits(instance_id))));
            if (u >= opacity) args->valid[i] = 0;
        }
    }

    [[nodiscard]] const GeometryEntry& entry_of(std::uint32_t instance_id, std::uint32_t geometry_id) const {
        if (instance_id == RTC_INVALID_GEOMETRY_ID) return world_entries[geometry_id];
        return group_entries[geometry.instances[instance_id - first_instance_id].group - 1][geometry_id];
    }
};

namespace {

template <class Ray>
void load_rays(Ray& ray, const RayColumns& rays, const std::uint32_t* list, RayKind kind) {
    const UIntV index = UIntV::load_unaligned(list);
    gather<FloatV>(rays.origin[0], index).store_aligned(ray.org_x);
    gather<FloatV>(rays.origin[1], index).store_aligned(ray.org_y);
    gather<FloatV>(rays.origin[2], index).store_aligned(ray.org_z);
    gather<FloatV>(rays.direction[0], index).store_aligned(ray.dir_x);
    gather<FloatV>(rays.direction[1], index).store_aligned(ray.dir_y);
    gather<FloatV>(rays.direction[2], index).store_aligned(ray.dir_z);
    (rays.tnear != nullptr ? gather<FloatV>(rays.tnear, index) : FloatV(0.0F)).store_aligned(ray.tnear);
    (rays.tfar != nullptr ? gather<FloatV>(rays.tfar, index) : FloatV(std::numeric_limits<float>::infinity()))
        .store_aligned(ray.tfar);
    index.store_aligned(ray.id);
    UIntV(static_cast<std::uint32_t>(kind)).store_aligned(ray.mask);
    FloatV(0.0F).store_aligned(ray.time);
    UIntV(0U).store_aligned(ray.flags);
}

void valid_lanes(std::size_t remaining, int* valid) {
    for (std::size_t i = 0; i < static_cast<std::size_t>(kLanes); ++i) valid[i] = i < remaining ? -1 : 0;
}

}  // namespace

Accel::Accel(const Geometry& geometry, const LightTable& lights) : impl_(std::make_unique<Impl>(geometry, lights)) {}
Accel::~Accel() = default;

void Accel::intersect(const RayColumns& rays, const std::uint32_t* list, std::size_t count, RayKind kind, bool together,
                      const float* opacity_u, const HitColumns& hits) const noexcept {
    QueryContext context{};
    rtcInitIntersectContext(&context.embree);
    context.opacity_u = opacity_u;
    if (together) context.embree.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
    const Impl& impl = *impl_;
    for (std::size_t i = 0; i < count; i += kLanes) {
        alignas(kAlignment) Packet<kLanes>::RayHit packet;
        alignas(kAlignment) int valid[kLanes];
        valid_lanes(count - i, valid);
        load_rays(packet.ray, rays, list + i, kind);
        UIntV(RTC_INVALID_GEOMETRY_ID).store_aligned(packet.hit.geomID);
        UIntV(RTC_INVALID_GEOMETRY_ID).store_aligned(packet.hit.instID[0]);
        Packet<kLanes>::intersect(valid, impl.world, &context.embree, &packet);
        const std::size_t lanes = std::min<std::size_t>(kLanes, count - i);
        for (std::size_t k = 0; k < lanes; ++k) {
            const std::uint32_t geometry_id = packet.hit.geomID[k];
            if (geometry_id == RTC_INVALID_GEOMETRY_ID) {
                hits.id[i + k] = kMiss;
                continue;
            }
            const std::uint32_t instance_id = packet.hit.instID[0][k];
            const GeometryEntry& entry = impl.entry_of(instance_id, geometry_id);
            hits.id[i + k] = entry.is_light ? kLightBit | entry.light_of_primitive[packet.hit.primID[k]]
                                            : entry.first_triangle + packet.hit.primID[k];
            hits.instance[i + k] =
                instance_id == RTC_INVALID_GEOMETRY_ID ? 0 : instance_id - impl.first_instance_id + 1;
            hits.t[i + k] = packet.ray.tfar[k];
            hits.u[i + k] = packet.hit.u[k];
            hits.v[i + k] = packet.hit.v[k];
        }
    }
}

void Accel::occluded(const RayColumns& rays, const std::uint32_t* list, std::size_t count, const std::uint32_t* light,
                     const float* opacity_u, std::uint8_t* occluded) const noexcept {
    QueryContext context{};
    rtcInitIntersectContext(&context.embree);
    context.opacity_u = opacity_u;
    context.light = light;
    for (std::size_t i = 0; i < count; i += kLanes) {
        alignas(kAlignment) Packet<kLanes>::Ray packet;
        alignas(kAlignment) int valid[kLanes];
        valid_lanes(count - i, valid);
        load_rays(packet, rays, list + i, RayKind::shadow);
        Packet<kLanes>::occluded(valid, impl_->world, &context.embree, &packet);
        const std::size_t lanes = std::min<std::size_t>(kLanes, count - i);
        for (std::size_t k = 0; k < lanes; ++k) occluded[i + k] = packet.tfar[k] < 0 ? 1 : 0;
    }
}

std::size_t Accel::bytes() const { return static_cast<std::size_t>(std::max<std::int64_t>(0, impl_->bytes)); }

std::string Accel::embree_version() { return RTC_VERSION_STRING; }

}  // namespace footlight
