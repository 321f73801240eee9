// What a stage calls for, in plain structs: the checks that keep bad data out.
#include "scene/scene.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <span>
#include <stdexcept>

namespace footlight {

namespace {

[[noreturn]] void refuse(const std::string& path, const std::string& reason) {
    throw std::invalid_argument(path + ": " + reason);
}

bool is_finite(const Vec3<float>& v) { return std::isfinite(v.x) && std::isfinite(v.y) && std::isfinite(v.z); }
bool is_finite(const Rgb<float>& v) { return std::isfinite(v.r) && std::isfinite(v.g) && std::isfinite(v.b); }
bool is_finite(float v) { return std::isfinite(v); }

void check_indices(const std::string& path, const std::vector<Index3>& indices, std::size_t size, const char* what) {
    for (std::size_t i = 0; i < indices.size(); ++i)
        for (const std::uint32_t index : indices[i])
            if (index >= size)
                refuse(path, std::string(what) + " of triangle " + std::to_string(i) + " is " + std::to_string(index) +
                                 "; allowed: below " + std::to_string(size));
}

template <class T>
void check_finite(const std::string& path, const std::vector<T>& values, const char* what) {
    for (std::size_t i = 0; i < values.size(); ++i)
        if (!is_finite(values[i])) refuse(path, std::string(what) + " " + std::to_string(i) + " is not finite");
}

template <class T>
void check_primvar(const Mesh& mesh, const Primvar<T>& primvar, const char* what) {
    if (primvar.empty()) return;
    check_finite(mesh.path, primvar.values, what);
    if (primvar.indices.empty() && primvar.values.size() != mesh.points.size())
        refuse(mesh.path, std::string(what) + ": " + std::to_string(primvar.values.size()) + " values for " +
                              std::to_string(mesh.points.size()) + " points and no indices");
    if (!primvar.indices.empty() && primvar.indices.size() != mesh.triangles.size())
        refuse(mesh.path, std::string(what) + ": indices for " + std::to_string(primvar.indices.size()) +
                              " triangles, the mesh has " + std::to_string(mesh.triangles.size()));
    check_indices(mesh.path, primvar.indices, primvar.values.size(), what);
}

void check_transforms(const std::string& path, const std::vector<Matrix4>& transforms, const char* what) {
    for (std::size_t i = 0; i < transforms.size(); ++i)
        if (!is_finite(transforms[i])) refuse(path, std::string(what) + " " + std::to_string(i) + " is not finite");
}

void check_range(const std::string& path, float value, float low, float high, const char* what) {
    if (!(value >= low && value <= high))
        refuse(path, std::string(what) + " is " + std::to_string(value) + "; allowed: " + std::to_string(low) + " to " +
                         std::to_string(high));
}

}  // namespace

void Scene::set_camera(Camera camera) {
    const std::string& path = camera.path;
    if (!is_finite(camera.camera_to_world) || determinant(camera.camera_to_world) == 0)
        refuse(path, "the camera's transform is singular or not finite");
    for (const double v : {camera.focal_length, camera.horizontal_aperture, camera.vertical_aperture})
        if (!(std::isfinite(v) && v > 0)) refuse(path, "focal length and apertures must be finite and above 0");
    if (!(std::isfinite(camera.horizontal_aperture_offset) && std::isfinite(camera.vertical_aperture_offset)))
        refuse(path, "aperture offsets must be finite");
    if (!(camera.f_stop >= 0 && std::isfinite(camera.f_stop) && camera.focus_distance >= 0 &&
          std::isfinite(camera.focus_distance)))
        refuse(path, "f_stop and focus_distance must be finite and not negative");
    if (!(camera.clipping_range[0] >= 0 && camera.clipping_range[1] > camera.clipping_range[0]))
        refuse(path, "clipping_range must be 0 <= near < far");
    if (!(std::isfinite(camera.exposure_scale) && camera.exposure_scale >= 0))
        refuse(path, "exposure_scale must be finite and not negative");
    camera_ = std::move(camera);
}

std::uint32_t Scene::add_material(PreviewSurface material) {
    const std::string& path = material.path;
    for (const auto* color : {&material.diffuse_color, &material.specular_color, &material.emissive_color})
        if (!is_finite(*color) || color->r < 0 || color->g < 0 || color->b < 0)
            refuse(path, "colours must be finite and not negative");
    check_range(path, material.metallic, 0, 1, "metallic");
    check_range(path, material.roughness, 0, 1, "roughness");
    check_range(path, material.clearcoat, 0, 1, "clearcoat");
    check_range(path, material.clearcoat_roughness, 0, 1, "clearcoat_roughness");
    check_range(path, material.opacity, 0, 1, "opacity");
    if (!(std::isfinite(material.ior) && material.ior > 0)) refuse(path, "ior must be finite and above 0");
    materials_.push_back(std::move(material));
    return static_cast<std::uint32_t>(materials_.size() - 1);
}

std::uint32_t Scene::add_mesh(Mesh mesh) {
    if (mesh.material >= materials_.size())
        refuse(mesh.path, "material " + std::to_string(mesh.material) + " does not exist");
    check_finite(mesh.path, mesh.points, "point");
    check_indices(mesh.path, mesh.triangles, mesh.points.size(), "point index");
    check_primvar(mesh, mesh.normals, "normals");
    check_primvar(mesh, mesh.colors, "colors");
    check_primvar(mesh, mesh.opacities, "opacities");
    meshes_.push_back(std::move(mesh));
    return static_cast<std::uint32_t>(meshes_.size() - 1);
}

void Scene::add_instances(Instances instances) {
    for (const std::uint32_t mesh : instances.meshes)
        if (mesh >= meshes_.size()) refuse(instances.path, "mesh " + std::to_string(mesh) + " does not exist");
    if (instances.local_transforms.size() != instances.meshes.size())
        refuse(instances.path, "one local transform per mesh is needed");
    check_transforms(instances.path, instances.local_transforms, "local transform");
    check_transforms(instances.path, instances.transforms, "transform");
    instances_.push_back(std::move(instances));
}

std::string append(LightTable& table, const AnyLight& light) {
    struct Append {
        LightTable& table;
        std::string operator()(const RectLightDesc& desc) const { return append_rect(table, desc); }
        std::string operator()(const DiskLightDesc& desc) const { return append_disk(table, desc); }
        std::string operator()(const SphereLightDesc& desc) const { return append_sphere(table, desc); }
        std::string operator()(const CylinderLightDesc& desc) const { return append_cylinder(table, desc); }
        std::string operator()(const DistantLightDesc& desc) const { return append_distant(table, desc); }
        std::string operator()(const DomeLightDesc& desc) const { return append_dome(table, desc); }
    };
    return std::visit(Append{table}, light);
}

const LightDesc& common(const AnyLight& light) {
    return std::visit([](const auto& desc) -> const LightDesc& { return desc; }, light);
}
LightDesc& common(AnyLight& light) {
    return std::visit([](auto& desc) -> LightDesc& { return desc; }, light);
}

std::string Scene::add_light(AnyLight light) {
    const LightDesc& desc = common(light);
    if (!is_finite(desc.transform)) refuse(desc.path, "the light's transform is not finite");
    for (const double e : desc.emission)
        if (!std::isfinite(e)) refuse(desc.path, "the light's emission is not finite");
    // The table of a dome's image is built once, at commit: here the image only has to hold some light.
    AnyLight checked = light;
    if (auto* dome = std::get_if<DomeLightDesc>(&checked); dome != nullptr && dome->image != nullptr) {
        const std::span texels(dome->image, std::size_t{3} * dome->width * dome->height);
        if (std::none_of(texels.begin(), texels.end(), [](float t) { return std::abs(t) > 0; }))
            return "its image is black";
        dome->image = nullptr;
    }
    LightTable scratch;
    std::string reason = append(scratch, checked);
    if (reason.empty()) lights_.push_back(std::move(light));
    return reason;
}

std::string Scene::add_dome_light(DomeLightDesc light, DomeTexture texture) {
    textures_.push_back(std::make_unique<DomeTexture>(std::move(texture)));
    const DomeTexture& kept = *textures_.back();
    light.image = kept.texels.empty() ? nullptr : kept.texels.data();
    light.width = kept.width;
    light.height = kept.height;
    return add_light(std::move(light));
}

}  // namespace footlight
