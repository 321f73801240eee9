// Python binding of Scene: what a translator calls.
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include "python/arrays.h"
#include "python/bindings.h"

namespace footlight {

namespace {

using namespace nb::literals;
using Color = std::array<float, 3>;
using Emission = std::array<double, 3>;

Rgb<float> to_rgb(const Color& c) { return {c[0], c[1], c[2]}; }

template <class Desc>
Desc light(const std::string& path, const Matrix& transform, const Emission& emission, bool normalize, bool visible) {
    Desc desc;
    desc.path = path;
    desc.transform = to_matrix(transform.data());
    desc.emission = emission;
    desc.normalize = normalize;
    desc.visible_to_camera = visible;
    return desc;
}

void set_camera(Scene& scene, const std::string& path, const Matrix& camera_to_world, double focal_length,
                double horizontal_aperture, double vertical_aperture, double horizontal_aperture_offset,
                double vertical_aperture_offset, double f_stop, double focus_distance,
                const std::array<double, 2>& clipping_range, double exposure_scale) {
    scene.set_camera({.path = path,
                      .camera_to_world = to_matrix(camera_to_world.data()),
                      .focal_length = focal_length,
                      .horizontal_aperture = horizontal_aperture,
                      .vertical_aperture = vertical_aperture,
                      .horizontal_aperture_offset = horizontal_aperture_offset,
                      .vertical_aperture_offset = vertical_aperture_offset,
                      .f_stop = f_stop,
                      .focus_distance = focus_distance,
                      .clipping_range = clipping_range,
                      .exposure_scale = exposure_scale});
}

std::uint32_t add_material(Scene& scene, const std::string& path, const Color& diffuse_color, bool diffuse_from_primvar,
                           float metallic, float roughness, float ior, const Color& specular_color,
                           bool use_specular_workflow, float clearcoat, float clearcoat_roughness,
                           const Color& emissive_color, float opacity, bool opacity_from_primvar) {
    return scene.add_material({.path = path,
                               .diffuse_color = to_rgb(diffuse_color),
                               .diffuse_from_primvar = diffuse_from_primvar,
                               .metallic = metallic,
                               .roughness = roughness,
                               .ior = ior,
                               .specular_color = to_rgb(specular_color),
                               .use_specular_workflow = use_specular_workflow,
                               .clearcoat = clearcoat,
                               .clearcoat_roughness = clearcoat_roughness,
                               .emissive_color = to_rgb(emissive_color),
                               .opacity = opacity,
                               .opacity_from_primvar = opacity_from_primvar});
}

std::uint32_t add_mesh(Scene& scene, const std::string& path, std::uint32_t material, const Floats3& points,
                       const Indices3& triangles, const std::optional<Floats3>& normals,
                       const std::optional<Indices3>& normal_indices, const std::optional<Floats3>& colors,
                       const std::optional<Indices3>& color_indices, const std::optional<Floats1>& opacities,
                       const std::optional<Indices3>& opacity_indices) {
    Mesh mesh{.path = path,
              .material = material,
              .points = copy_rows<Vec3<float>>(points),
              .triangles = copy_rows<Index3>(triangles),
              .normals = {copy_rows<Vec3<float>>(normals), copy_rows<Index3>(normal_indices)},
              .colors = {copy_rows<Rgb<float>>(colors), copy_rows<Index3>(color_indices)},
              .opacities = {copy_rows<float>(opacities), copy_rows<Index3>(opacity_indices)}};
    const nb::gil_scoped_release release;
    return scene.add_mesh(std::move(mesh));
}

void add_instances(Scene& scene, const std::string& path, const std::vector<std::uint32_t>& meshes,
                   const Matrices& local_transforms, const Matrices& transforms, bool visible_to_camera) {
    scene.add_instances({.path = path,
                         .meshes = meshes,
                         .local_transforms = to_matrices(local_transforms),
                         .transforms = to_matrices(transforms),
                         .visible_to_camera = visible_to_camera});
}

std::string add_rect_light(Scene& scene, const std::string& path, const Matrix& transform, double width, double height,
                           const Emission& emission, bool normalize, bool visible_to_camera) {
    auto desc = light<RectLightDesc>(path, transform, emission, normalize, visible_to_camera);
    desc.width = width;
    desc.height = height;
    return scene.add_light(desc);
}

template <class Desc>
std::string add_round_light(Scene& scene, const std::string& path, const Matrix& transform, double radius,
                            const Emission& emission, bool normalize, bool visible_to_camera) {
    auto desc = light<Desc>(path, transform, emission, normalize, visible_to_camera);
    desc.radius = radius;
    return scene.add_light(desc);
}

std::string add_cylinder_light(Scene& scene, const std::string& path, const Matrix& transform, double radius,
                               double length, const Emission& emission, bool normalize, bool visible_to_camera) {
    auto desc = light<CylinderLightDesc>(path, transform, emission, normalize, visible_to_camera);
    desc.radius = radius;
    desc.length = length;
    return scene.add_light(desc);
}

std::string add_distant_light(Scene& scene, const std::string& path, const Matrix& transform, double angle,
                              const Emission& emission, bool normalize, bool visible_to_camera) {
    auto desc = light<DistantLightDesc>(path, transform, emission, normalize, visible_to_camera);
    desc.angle = angle;
    return scene.add_light(desc);
}

std::string add_dome_light(Scene& scene, const std::string& path, const Matrix& transform, const Emission& emission,
                           const std::optional<Image>& image, bool visible_to_camera) {
    DomeTexture texture;
    if (image) {
        texture.texels.assign(image->data(), image->data() + image->size());
        texture.height = static_cast<std::uint32_t>(image->shape(0));
        texture.width = static_cast<std::uint32_t>(image->shape(1));
    }
    return scene.add_dome_light(light<DomeLightDesc>(path, transform, emission, false, visible_to_camera),
                                std::move(texture));
}

}  // namespace

void bind_scene(nb::module_& module) {
    const Color kGray{0.18F, 0.18F, 0.18F}, kBlack{0, 0, 0};
    const Emission kWhite{1, 1, 1};
    nb::class_<Scene>(
        module, "Scene",
        "What a stage calls for. Matrices are (4, 4) float64, row vectors: p' = p @ M. Lengths in stage units.\n"
        "Every call raises ValueError naming the path, the value and what is allowed.")
        .def(nb::init<>())
        .def("set_camera", &set_camera, nb::kw_only(), "path"_a, "camera_to_world"_a, "focal_length"_a = 50.0,
             "horizontal_aperture"_a = 20.955, "vertical_aperture"_a = 15.2908, "horizontal_aperture_offset"_a = 0.0,
             "vertical_aperture_offset"_a = 0.0, "f_stop"_a = 0.0, "focus_distance"_a = 0.0,
             "clipping_range"_a = std::array<double, 2>{0.0, 1e30}, "exposure_scale"_a = 1.0,
             "The perspective camera, in UsdGeomCamera's units; apertures conform to the image. f_stop 0: pinhole.")
        .def("add_material", &add_material, nb::kw_only(), "path"_a, "diffuse_color"_a = kGray,
             "diffuse_from_primvar"_a = false, "metallic"_a = 0.0F, "roughness"_a = 0.5F, "ior"_a = 1.5F,
             "specular_color"_a = kBlack, "use_specular_workflow"_a = false, "clearcoat"_a = 0.0F,
             "clearcoat_roughness"_a = 0.01F, "emissive_color"_a = kBlack, "opacity"_a = 1.0F,
             "opacity_from_primvar"_a = false, "UsdPreviewSurface constants; returns the material's id.")
        .def("add_mesh", &add_mesh, nb::kw_only(), "path"_a, "material"_a, "points"_a, "triangles"_a,
             "normals"_a = nb::none(), "normal_indices"_a = nb::none(), "colors"_a = nb::none(),
             "color_indices"_a = nb::none(), "opacities"_a = nb::none(), "opacity_indices"_a = nb::none(),
             "points (N, 3) float32 in object space, triangles (T, 3) uint32 counter-clockwise from outside. A primvar "
             "has a\n"
             "value per point, or indices (T, 3) uint32 per corner. Returns the mesh's id; add_instances places it.")
        .def("add_instances", &add_instances, nb::kw_only(), "path"_a, "meshes"_a, "local_transforms"_a, "transforms"_a,
             "visible_to_camera"_a = true,
             "Places meshes, each under its local transform (M, 4, 4), at every transform (K, 4, 4).")
        .def("add_rect_light", &add_rect_light, nb::kw_only(), "path"_a, "transform"_a, "width"_a = 1.0,
             "height"_a = 1.0, "emission"_a = kWhite, "normalize"_a = false, "visible_to_camera"_a = true,
             "Emits along local -Z. Lights return why they were left out, or ''.")
        .def("add_disk_light", &add_round_light<DiskLightDesc>, nb::kw_only(), "path"_a, "transform"_a,
             "radius"_a = 0.5, "emission"_a = kWhite, "normalize"_a = false, "visible_to_camera"_a = true,
             "Emits along local -Z.")
        .def("add_sphere_light", &add_round_light<SphereLightDesc>, nb::kw_only(), "path"_a, "transform"_a,
             "radius"_a = 0.5, "emission"_a = kWhite, "normalize"_a = false, "visible_to_camera"_a = true)
        .def("add_cylinder_light", &add_cylinder_light, nb::kw_only(), "path"_a, "transform"_a, "radius"_a = 0.5,
             "length"_a = 1.0, "emission"_a = kWhite, "normalize"_a = false, "visible_to_camera"_a = true,
             "Axis X, without caps.")
        .def("add_distant_light", &add_distant_light, nb::kw_only(), "path"_a, "transform"_a, "angle"_a = 0.53,
             "emission"_a = kWhite, "normalize"_a = false, "visible_to_camera"_a = true, "angle: diameter [degrees].")
        .def("add_dome_light", &add_dome_light, nb::kw_only(), "path"_a, "transform"_a, "emission"_a = kWhite,
             "image"_a = nb::none(), "visible_to_camera"_a = true,
             "image (H, W, 3) float32, latitude-longitude, top row first; emission multiplies it.");
}

}  // namespace footlight
