// The renderer against the brute-force tracer, pixel by pixel, on scenes that both can hold exactly.
#include "pipeline/renderer.h"

#include <gtest/gtest.h>

#include <cmath>

#include "reference/brute_force.h"

namespace footlight {
namespace {

namespace bf = brute_force;

constexpr int kSide = 6;      // [pixels]
constexpr int kMaxEdges = 5;  // of a path
constexpr int kSeeds = 8;     // independent renders
constexpr int kSpp = 512;     // of one render
constexpr int kReferenceSpp = 6'000;
constexpr double kFocalLength = 20, kAperture = 36;
// Two-sided 2e-7 for a normal variable; the references carry nearly all of the noise.
constexpr double kLimit = 5.2;

// One scene in two languages. Quads become two triangles; lights are black bodies in both.
class Twins {
  public:
    Twins() {
        Camera camera;
        camera.path = "/camera";
        camera.camera_to_world.m[3] = {0.1, 0.2, 0.9, 1};
        camera.focal_length = kFocalLength;
        camera.horizontal_aperture = camera.vertical_aperture = kAperture;
        scene_.set_camera(camera);
        view_ = {.position = {0.1, 0.2, 0.9},
                 .half_width = kAperture / 2 / kFocalLength,
                 .half_height = kAperture / 2 / kFocalLength,
                 .width = kSide,
                 .height = kSide};
    }

    void quad(bf::Vec corner, bf::Vec u, bf::Vec v, PreviewSurface surface, bf::Scattering scattering) {
        auto point = [](bf::Vec p) {
            return Vec3<float>{static_cast<float>(p.x), static_cast<float>(p.y), static_cast<float>(p.z)};
        };
        Mesh mesh;
        mesh.path = surface.path = "/quad";
        mesh.material = scene_.add_material(surface);
        mesh.points = {point(corner), point(corner + u), point(corner + u + v), point(corner + v)};
        mesh.triangles = {{0, 1, 2}, {0, 2, 3}};
        Instances instances;
        instances.path = "/quad";
        instances.meshes = {scene_.add_mesh(mesh)};
        instances.local_transforms = instances.transforms = {Matrix4{}};
        scene_.add_instances(instances);
        reference_.objects.push_back({bf::Quad{corner, u, v}, {scattering, {}}});
    }

    void diffuse(bf::Vec corner, bf::Vec u, bf::Vec v, bf::Vec reflectance) {
        PreviewSurface surface;
        surface.diffuse_color = rgb(reflectance);
        surface.ior = 1;
        surface.roughness = 1;
        quad(corner, u, v, surface, bf::Lambert{reflectance});
    }

    void metal(bf::Vec corner, bf::Vec u, bf::Vec v, bf::Vec f0, double roughness) {
        PreviewSurface surface;
        surface.diffuse_color = rgb(f0);
        surface.metallic = 1;
        surface.roughness = static_cast<float>(roughness);
        const bf::Vec white{1, 1, 1};
        const double alpha = roughness * roughness;
        quad(corner, u, v, surface,
             roughness == 0 ? bf::Scattering{bf::Mirror{f0, white}} : bf::Scattering{bf::Ggx{f0, white, alpha}});
    }

    // The inside of [-1, 1]^3, without its lid unless asked for.
    void room(bf::Vec reflectance, bool lid) {
        diffuse({-1, -1, 1}, {2, 0, 0}, {0, 0, -2}, reflectance);
        diffuse({-1, -1, -1}, {2, 0, 0}, {0, 2, 0}, {0.6, 0.6, 0.2});
        diffuse({-1, -1, 1}, {0, 0, -2}, {0, 2, 0}, {0.7, 0.1, 0.1});
        diffuse({1, -1, -1}, {0, 0, 2}, {0, 2, 0}, {0.1, 0.2, 0.7});
        diffuse({1, -1, 1}, {-2, 0, 0}, {0, 2, 0}, reflectance);
        if (lid) diffuse({-1, 1, -1}, {2, 0, 0}, {0, 0, 2}, reflectance);
    }

    // Faces down.
    void rect(bf::Vec centre, double width, double height, bf::Vec emission) {
        RectLightDesc light;
        place(light, centre, emission);
        light.transform.m = {{{1, 0, 0, 0}, {0, 0, -1, 0}, {0, 1, 0, 0}, {centre.x, centre.y, centre.z, 1}}};
        light.width = width;
        light.height = height;
        EXPECT_EQ(scene_.add_light(light), "");
        const bf::Vec corner = centre - bf::Vec{width / 2, 0, height / 2};
        reference_.objects.push_back({bf::Quad{corner, {width, 0, 0}, {0, 0, height}}, {bf::Black{}, emission}});
    }

    void disk(bf::Vec centre, double radius, bf::Vec emission) {
        DiskLightDesc light;
        place(light, centre, emission);
        light.transform.m = {{{1, 0, 0, 0}, {0, 0, -1, 0}, {0, 1, 0, 0}, {centre.x, centre.y, centre.z, 1}}};
        light.radius = radius;
        EXPECT_EQ(scene_.add_light(light), "");
        reference_.objects.push_back({bf::Disk{centre, {0, -1, 0}, radius}, {bf::Black{}, emission}});
    }

    void sphere(bf::Vec centre, double radius, bf::Vec emission) {
        SphereLightDesc light;
        place(light, centre, emission);
        light.radius = radius;
        EXPECT_EQ(scene_.add_light(light), "");
        reference_.objects.push_back({bf::Sphere{centre, radius}, {bf::Black{}, emission}});
    }

    void sky(bf::Vec emission) {
        DomeLightDesc light;
        place(light, {}, emission);
        EXPECT_EQ(scene_.add_light(light), "");
        reference_.environment = [emission](bf::Vec) { return emission; };
    }

    // The largest deviation of any pixel and channel, in standard deviations.
    [[nodiscard]] double worst(Strategy strategy) {
        std::vector<bf::Accumulator> pixels(kSide * kSide);
        for (std::uint32_t seed = 1; seed <= kSeeds; ++seed) {
            RenderOptions options;
            options.width = options.height = kSide;
            options.seed = seed;
            options.max_depth = kMaxEdges;
            options.pixel_filter = PixelFilter::box;
            options.filter_width = 1;
            options.strategy = strategy;
            options.threads = 1;
            Renderer renderer(scene_, options);
            EXPECT_TRUE(renderer.render(0, kSpp, 0, renderer.tiles()));
            const std::vector<float> image = renderer.film().read(Aov::color, 0, 0, kSide, kSide);
            for (std::size_t k = 0; k < pixels.size(); ++k)
                pixels[k].add({image[3 * k], image[3 * k + 1], image[3 * k + 2]});
        }
        const std::vector<bf::Estimate>& expected = references();
        double result = 0;
        for (std::size_t k = 0; k < pixels.size(); ++k) {
            bf::Estimate ours = pixels[k].result();
            auto both = [](double a, double b, double mean) { return std::hypot(a, b, 1e-6 * mean); };
            const bf::Vec a = ours.standard_error, b = expected[k].standard_error, m = expected[k].mean;
            ours.standard_error = {both(a.x, b.x, m.x), both(a.y, b.y, m.y), both(a.z, b.z, m.z)};
            result = std::max(result, bf::z_score(ours, expected[k].mean));
        }
        return result;
    }

    bf::Scene& reference() {
        expected_.clear();
        return reference_;
    }

  private:
    static Rgb<float> rgb(bf::Vec v) {
        return {static_cast<float>(v.x), static_cast<float>(v.y), static_cast<float>(v.z)};
    }

    static void place(LightDesc& light, bf::Vec centre, bf::Vec emission) {
        light.path = "/light";
        light.transform.m[3] = {centre.x, centre.y, centre.z, 1};
        light.emission = {emission.x, emission.y, emission.z};
    }

    const std::vector<bf::Estimate>& references() {
        for (int row = 0; row < kSide && expected_.size() < kSide * kSide; ++row)
            for (int column = 0; column < kSide; ++column)
                expected_.push_back(bf::pixel(reference_, view_, column, row, kMaxEdges, kReferenceSpp, 99));
        return expected_;
    }

    Scene scene_;
    bf::Scene reference_;
    bf::Camera view_;
    std::vector<bf::Estimate> expected_;
};

class Agreement : public testing::TestWithParam<Strategy> {};

TEST_P(Agreement, DiffuseRoomUnderARect) {
    Twins twins;
    twins.room({0.6, 0.6, 0.6}, true);
    twins.diffuse({-0.6, -0.4, -0.7}, {0.7, 0, 0.2}, {0, 0.1, 0.6}, {0.8, 0.7, 0.5});
    twins.rect({0, 0.9, 0}, 1.2, 1, {3, 2.5, 2});
    EXPECT_LT(twins.worst(GetParam()), kLimit);
    if (GetParam() != Strategy::mis) return;
    // Power: a reference whose light is 3 % brighter is told apart.
    auto& light = twins.reference().objects.back().material.emission;
    light = light * 1.03;
    EXPECT_GT(twins.worst(GetParam()), kLimit);
}

TEST_P(Agreement, DiskAndSphereInAnOpenRoom) {
    Twins twins;
    twins.room({0.5, 0.6, 0.7}, false);
    twins.disk({-0.3, 0.8, -0.2}, 0.5, {2, 2, 3});
    twins.sphere({0.5, -0.2, -0.4}, 0.3, {2, 1, 0.5});
    EXPECT_LT(twins.worst(GetParam()), kLimit);
}

TEST_P(Agreement, MirrorUnderASky) {
    Twins twins;
    twins.room({0.5, 0.5, 0.5}, false);
    twins.metal({-0.8, -0.8, -0.9}, {1.5, 0, 0}, {0, 1.2, 0.2}, {0.9, 0.7, 0.4}, 0);
    twins.sky({0.5, 0.7, 1});
    twins.sphere({0.3, 0.6, 0.2}, 0.25, {2, 2, 1});
    EXPECT_LT(twins.worst(GetParam()), kLimit);
}

// Light samples seldom meet so narrow a lobe: it is tried with the other two strategies.
class NarrowLobe : public Agreement {};

// Where single scattering loses less than a thousandth, energy compensation is invisible.
TEST_P(NarrowLobe, GlossyMetalUnderASky) {
    Twins twins;
    twins.room({0.5, 0.5, 0.5}, false);
    twins.metal({-0.8, -0.8, -0.9}, {1.5, 0, 0}, {0, 1.2, 0.2}, {0.9, 0.7, 0.4}, 0.17);
    twins.sky({0.5, 0.7, 1});
    twins.rect({0, 0.9, 0.2}, 1, 0.8, {2, 2, 1});
    EXPECT_LT(twins.worst(GetParam()), kLimit);
}

std::string strategy_name(const testing::TestParamInfo<Strategy>& info) {
    return std::string(kStrategies[static_cast<std::size_t>(info.param)].name);
}

INSTANTIATE_TEST_SUITE_P(Strategies, Agreement, testing::Values(Strategy::mis, Strategy::light, Strategy::bsdf),
                         strategy_name);
INSTANTIATE_TEST_SUITE_P(Strategies, NarrowLobe, testing::Values(Strategy::mis, Strategy::bsdf), strategy_name);

}  // namespace
}  // namespace footlight
