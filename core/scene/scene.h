// What a stage calls for, in plain structs: meshes, instances, materials, lights, camera. Filled by a translator, read
// by commit.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <string>
#include <variant>
#include <vector>

#include "light/light_table.h"
#include "math/matrix.h"

namespace footlight {

using Index3 = std::array<std::uint32_t, 3>;

// A value per point or, with indices, per triangle corner.
template <class T>
struct Primvar {
    std::vector<T> values;
    std::vector<Index3> indices;  // empty: one value per point
    [[nodiscard]] bool empty() const { return values.empty(); }
};

struct Mesh {
    std::string path;
    std::uint32_t material = 0;
    std::vector<Vec3<float>> points;  // object space [stage units]
    std::vector<Index3> triangles;    // counter-clockwise seen from outside
    Primvar<Vec3<float>> normals;     // object space, any length; empty: the face's own
    Primvar<Rgb<float>> colors;
    Primvar<float> opacities;
};

// Meshes placed together, once (then they are baked into the world) or many times (then they share one BVH).
struct Instances {
    std::string path;
    std::vector<std::uint32_t> meshes;
    std::vector<Matrix4> local_transforms;  // one per mesh
    std::vector<Matrix4> transforms;        // one per instance
    bool visible_to_camera = true;
};

// UsdPreviewSurface's constants, in its words.
struct PreviewSurface {
    std::string path;
    Rgb<float> diffuse_color{0.18F, 0.18F, 0.18F};
    bool diffuse_from_primvar = false;  // diffuse_color where the mesh has no colours
    float metallic = 0.0F;
    float roughness = 0.5F;
    float ior = 1.5F;
    Rgb<float> specular_color{0, 0, 0};
    bool use_specular_workflow = false;
    float clearcoat = 0.0F;
    float clearcoat_roughness = 0.01F;
    Rgb<float> emissive_color{0, 0, 0};
    float opacity = 1.0F;
    bool opacity_from_primvar = false;
};

// A perspective camera in UsdGeomCamera's units: apertures and focal length in the same unit, tenths of a stage unit.
struct Camera {
    std::string path;
    Matrix4 camera_to_world;
    double focal_length = 50.0;
    double horizontal_aperture = 20.955;
    double vertical_aperture = 15.2908;
    double horizontal_aperture_offset = 0.0;
    double vertical_aperture_offset = 0.0;
    double f_stop = 0.0;                              // 0: pinhole
    double focus_distance = 0.0;                      // [stage units]
    std::array<double, 2> clipping_range{0.0, 1e30};  // along the view axis [stage units]
    double exposure_scale = 1.0;                      // multiplies radiance
};

using AnyLight =
    std::variant<RectLightDesc, DiskLightDesc, SphereLightDesc, CylinderLightDesc, DistantLightDesc, DomeLightDesc>;

// Adds the light; the reason it cannot shine, or an empty string.
std::string append(LightTable& table, const AnyLight& light);
// What all lights have, whichever kind this is.
const LightDesc& common(const AnyLight& light);
LightDesc& common(AnyLight& light);

// A latitude-longitude image, (height, width, 3), owned by the scene.
struct DomeTexture {
    std::vector<float> texels;
    std::uint32_t width = 0, height = 0;
};

struct LeftOut {
    std::string path;
    std::string reason;
};

// Every add_* refuses bad data with std::invalid_argument naming the path, the value and what is allowed.
class Scene {
  public:
    Scene() = default;
    // Lights point into the textures: a copy would share them.
    Scene(const Scene&) = delete;
    Scene& operator=(const Scene&) = delete;

    void set_camera(Camera camera);
    std::uint32_t add_material(PreviewSurface material);
    std::uint32_t add_mesh(Mesh mesh);
    void add_instances(Instances instances);
    // The reason a light was pruned, or an empty string. The desc's image pointer is set by add_dome_light only.
    std::string add_light(AnyLight light);
    std::string add_dome_light(DomeLightDesc light, DomeTexture texture);

    [[nodiscard]] const Camera& camera() const { return camera_; }
    [[nodiscard]] const std::vector<PreviewSurface>& materials() const { return materials_; }
    [[nodiscard]] const std::vector<Mesh>& meshes() const { return meshes_; }
    [[nodiscard]] const std::vector<Instances>& instances() const { return instances_; }
    [[nodiscard]] const std::vector<AnyLight>& lights() const { return lights_; }

  private:
    Camera camera_;
    std::vector<PreviewSurface> materials_;
    std::vector<Mesh> meshes_;
    std::vector<Instances> instances_;
    std::vector<AnyLight> lights_;
    std::vector<std::unique_ptr<DomeTexture>> textures_;
};

}  // namespace footlight
