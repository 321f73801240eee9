// Dome lights: orientation, constant and black (L07), poles (L08), broken texels (L09), one bright texel (L10).
#include "light/dome.h"

#include "light_testing.h"

namespace footlight::testing {
namespace {

// An image to fill by hand.
struct Image {
    std::uint32_t width, height;
    std::vector<float> texels;

    Image(std::uint32_t w, std::uint32_t h, float value = 0)
        : width(w), height(h), texels(std::size_t{3} * w * h, value) {}
    void set(std::uint32_t x, std::uint32_t y, float value) {
        for (std::size_t c = 0; c < 3; ++c) texels[3 * (std::size_t{y} * width + x) + c] = value;
    }
    float at(std::uint32_t x, std::uint32_t y) const { return texels[3 * (std::size_t{y} * width + x)]; }
};

struct Built {
    LightTable table;
    std::string reason;
};
Built build(const Image& image, Matrix4 m = {}, double emission = 1) {
    DomeLightDesc desc;
    desc.image = image.texels.data();
    desc.width = image.width;
    desc.height = image.height;
    desc.transform = m;
    desc.emission = {emission, emission, emission};
    Built built;
    built.reason = append_dome(built.table, desc);
    if (built.reason.empty()) finalize(built.table, 1);
    return built;
}

// Bilinear lookup written down on its own, from the words of the UsdLux schema.
double reference_radiance(const Image& image, Vector d) {
    const double u = 0.5 - std::atan2(d.x, d.z) / (2 * kPi), v = std::acos(std::clamp(d.y, -1.0, 1.0)) / kPi;
    const double s = u * image.width - 0.5, t = v * image.height - 0.5;
    const auto texel = [&](double x, double y) {
        const auto w = static_cast<double>(image.width), h = static_cast<double>(image.height);
        const double wrapped = x - w * std::floor(x / w), clamped = std::clamp(y, 0.0, h - 1);
        return double{image.at(static_cast<std::uint32_t>(wrapped), static_cast<std::uint32_t>(clamped))};
    };
    const double x = std::floor(s), y = std::floor(t), fx = s - x, fy = t - y;
    return (texel(x, y) * (1 - fx) + texel(x + 1, y) * fx) * (1 - fy) +
           (texel(x, y + 1) * (1 - fx) + texel(x + 1, y + 1) * fx) * fy;
}

Vector direction(double u, double v) {
    const double theta = kPi * v, phi = (0.5 - u) * 2 * kPi;
    return {std::sin(theta) * std::sin(phi), std::cos(theta), std::sin(theta) * std::cos(phi)};
}

// Irradiance on normal n, over the sphere: the cells of a grid aligned with the texels, `fine` per texel side.
double quadrature(const Image& image, Vector n, std::uint32_t fine) {
    double sum = 0;
    const std::uint32_t w = image.width * fine, h = image.height * fine;
    for (std::uint32_t y = 0; y < h; ++y)
        for (std::uint32_t x = 0; x < w; ++x) {
            const Vector d = direction((x + 0.5) / w, (y + 0.5) / h);
            const double area = 2 * kPi / w * (std::cos(kPi * y / h) - std::cos(kPi * (y + 1.0) / h));
            sum += reference_radiance(image, d) * std::max(0.0, dot(d, n)) * area;
        }
    return sum;
}

Image random_image(std::uint32_t w, std::uint32_t h) {
    Image image(w, h);
    for (std::uint32_t y = 0; y < h; ++y)
        for (std::uint32_t x = 0; x < w; ++x) {
            const float r = to_unit<float>(mix_bits(y * w + x + 1U));
            image.set(x, y, r < 0.3F ? 0.0F : r * r * 10);
        }
    return image;
}

// Latitude 0, longitude 0 points into +Z, longitude pi/2 into +X, the top row into +Y; the first column is longitude
// +pi.
TEST(Dome, Orientation) {
    Image image(8, 4);
    image.set(3, 1, 1);
    image.set(4, 1, 2);  // around the centre column
    image.set(1, 1, 3);
    image.set(2, 1, 4);  // around u = 1/4
    for (std::uint32_t x = 0; x < 8; ++x) image.set(x, 0, 9);
    const Built built = build(image);
    const auto seen = [&](Vector d) { return found<float>(built.table, 0, {}, d, 0).radiance.r; };
    EXPECT_NEAR(seen({0, 1, 0}), 9, 1e-5);
    EXPECT_NEAR(seen({0, -1, 0}), 0, 1e-5);
    EXPECT_NEAR(seen(direction(0.5, 0.375)), 1.5, 1e-5);
    EXPECT_GT(direction(0.5, 0.375).z, 0.9);
    EXPECT_NEAR(seen(direction(0.25, 0.375)), 3.5, 1e-5);
    EXPECT_GT(direction(0.25, 0.375).x, 0.9);
}

TEST(Dome, LookupIsTheBilinearReconstruction) {
    for (const auto& [w, h] :
         {std::pair{16U, 8U}, std::pair{1U, 1U}, std::pair{5U, 1U}, std::pair{1U, 6U}, std::pair{3U, 2U}}) {
        Image image = random_image(w, h);
        image.set(0, 0, 7);
        const Matrix4 m = rotate(normalize(Vector{1, 2, 3}), 50);
        const Built built = build(image, m);
        for (std::uint32_t i = 0; i < 2000; ++i) {
            const Uniform2<float> q = point(9, i);
            const Vector d = direction(double{q.u}, double{q.v});
            EXPECT_NEAR(found<float>(built.table, 0, {}, transform_vector(m, d), 0).radiance.r,
                        reference_radiance(image, d), 1e-3);
        }
        for (const Vector d : {Vector{0, 1, 0}, Vector{0, -1, 0}})
            EXPECT_TRUE(std::isfinite(found<float>(built.table, 0, {}, transform_vector(m, d), 0).radiance.r));
    }
}

TEST(Dome, ConstantImagesNeedNoTable) {
    const Built built = build(Image(16, 8, 1));
    ASSERT_EQ(built.reason, "");
    EXPECT_TRUE(built.table.domes.empty());
    for (const Vector n : {Vector{0, 1, 0}, Vector{0, 0, -1}, normalize(Vector{1, 2, 3})})
        EXPECT_NEAR(irradiance(draw<FloatV>(built.table, 0, {}, 1 << 14), n), kPi, 2e-3 * kPi);
    Image nearly(16, 8, 1);
    nearly.set(3, 3, 1 + 1e-5F);
    EXPECT_NEAR(irradiance(draw<FloatV>(build(nearly).table, 0, {}, 1 << 14), {0, 1, 0}), kPi, 2e-3 * kPi);
}

TEST(Dome, BlackImagesArePruned) {
    const Built built = build(Image(16, 8));
    EXPECT_NE(built.reason, "");
    EXPECT_EQ(built.table.size(), 0U);
    EXPECT_EQ(build(random_image(4, 4), {}, 0).table.size(), 0U);
}

// Energy only in one row or at one texel of a pole, one-row and one-column images: nothing is lost, nothing is NaN.
TEST(Dome, PolesAndTinyImages) {
    std::vector<Image> images;
    for (const std::uint32_t y : {0U, 15U}) {
        Image row(32, 16), texel(32, 16);
        for (std::uint32_t x = 0; x < 32; ++x) row.set(x, y, 100);
        texel.set(5, y, 100);
        images.push_back(row);
        images.push_back(texel);
    }
    images.push_back(random_image(32, 1));
    images.push_back(random_image(1, 16));
    Image two(2, 2);
    two.set(1, 0, 1);
    images.push_back(two);
    for (const Image& image : images) {
        const Built built = build(image);
        ASSERT_EQ(built.reason, "");
        for (const Vector n : {Vector{0, 1, 0}, Vector{0, -1, 0}, normalize(Vector{1, 0.3, -0.4})}) {
            const double expected = quadrature(image, n, 256 / std::min(image.width, image.height));
            const auto records = draw<FloatV>(built.table, 0, {}, 1 << 16);
            for (const Record& r : records) ASSERT_TRUE(std::isfinite(r.pdf) && std::isfinite(r.wi.x + r.radiance));
            // where only the rim of the light is above the horizon, few samples count
            EXPECT_NEAR(irradiance(records, n), expected, 3e-3 * expected + 1e-5 * built.table.info[0].power)
                << image.width << "x" << image.height;
        }
    }
}

TEST(Dome, AnyImageMatchesQuadrature) {
    for (const auto& [w, h] : {std::pair{64U, 32U}, std::pair{7U, 5U}}) {
        const Image image = random_image(w, h);
        const Matrix4 m = rotate(normalize(Vector{3, -1, 2}), 110) * scale({2, 2, 2});
        const Built built = build(image, m, 0.5);
        for (const Vector n : {Vector{0, 1, 0}, normalize(Vector{-1, 0.2, 0.5})}) {
            const double e = irradiance(draw<FloatV>(built.table, 0, {}, 1 << 15), normalize(transform_vector(m, n)));
            EXPECT_NEAR(e / (0.5 * quadrature(image, n, 8)), 1, 5e-3);
        }
    }
}

// One texel, alone or above a sky, up to 1e8 times as bright.
TEST(Dome, OneBrightTexel) {
    for (const float sky : {0.0F, 1.0F})
        for (const float sun : {1e2F, 1e4F, 1e6F, 1e8F}) {
            Image image(512, 256, sky);
            image.set(100, 60, sun);
            const Built built = build(image);
            const Vector d = direction(100.5 / 512, 60.5 / 256);
            // a texel's tent covers one texel; the irradiance of the sky alone is pi
            const double area = 2 * kPi / 512 * (std::cos(kPi * 60 / 256) - std::cos(kPi * 61 / 256));
            const double expected = sky * kPi + (sun - sky) * area;
            const auto records = draw<FloatV>(built.table, 0, {}, 1 << 13);
            EXPECT_NEAR(irradiance(records, d) / expected, 1, sky > 0 && sun < 1e5F ? 1e-2 : 5e-3) << sky << " " << sun;
            if (sky == 0) {  // as good as a delta light: every sample answers the same
                double worst = 0;
                for (const Record& r : records)
                    worst = std::max(worst, std::abs(r.radiance / r.pdf / (sun * area) - 1));
                EXPECT_LT(worst, 0.05);
            }
        }
}

TEST(Dome, BrokenTexelsAreRepairedAndCounted) {
    constexpr float infinity = std::numeric_limits<float>::infinity();
    for (const float broken : {std::numeric_limits<float>::quiet_NaN(), infinity, -infinity, -1e4F, 1e30F}) {
        Image image(16, 8, 1);
        image.set(4, 3, broken);
        const Built built = build(image);
        ASSERT_EQ(built.reason, "");
        const bool is_finite_and_positive = broken == 1e30F;
        EXPECT_EQ(built.table.info[0].note.empty(), is_finite_and_positive) << built.table.info[0].note;
        for (const Record& r : draw<FloatV>(built.table, 0, {}, 4096))
            ASSERT_TRUE(!r.valid || (std::isfinite(r.radiance) && std::isfinite(r.pdf) && r.pdf > 0));
    }
    // a negative texel is light taken away, drawn by its magnitude
    Image image(16, 8, 1);
    image.set(4, 3, -20);
    const double expected = quadrature(image, direction(4.5 / 16, 3.5 / 8), 16);
    EXPECT_LT(expected, 2);
    EXPECT_NEAR(irradiance(draw<FloatV>(build(image).table, 0, {}, 1 << 15), direction(4.5 / 16, 3.5 / 8)), expected,
                2e-2);
}

// MIS compensation (Karlik et al. 2019): only what exceeds the mean is sampled, and a second strategy that covers all
// directions brings in the rest.
TEST(Dome, CompensatedDomesAreCompleteWithASecondStrategy) {
    Image nearly(16, 8, 1);
    nearly.set(3, 3, std::nextafter(1.0F, 2.0F));
    for (const Image& image : {random_image(32, 16), nearly}) {
        DomeLightDesc desc;
        desc.image = image.texels.data();
        desc.width = image.width;
        desc.height = image.height;
        desc.compensate = true;
        LightTable table;
        ASSERT_EQ(append_dome(table, desc), "");
        finalize(table, 1);
        const Vector n = normalize(Vector{0.3, 1, -0.2});
        constexpr std::uint32_t count = 1 << 15;
        const double uniform_pdf = 1 / (4 * kPi);
        double sum = 0;
        if (table.info[0].sampled) {
            for (const Record& r : draw<FloatV>(table, 0, {}, count))
                if (r.valid) sum += r.radiance * std::max(0.0, dot(r.wi, n)) / (r.pdf + uniform_pdf) / count;
        }
        for (std::uint32_t i = 0; i < count; ++i) {
            const Uniform2<float> q = point(21, i);
            const Vector wi = uniform_sphere(double{q.u}, double{q.v});
            const LightHit<double> hit = found<float>(table, 0, {}, wi, 0);
            const double light_pdf = table.info[0].sampled ? hit.pdf : 0;
            sum += hit.radiance.r * std::max(0.0, dot(wi, n)) / (light_pdf + uniform_pdf) / count;
        }
        EXPECT_NEAR(sum / quadrature(image, n, 16), 1, 5e-3);
    }
}

// Lanes without a path may hold anything: no direction may look outside the image.
TEST(Dome, DirectionsThatAreNotANumberStayInTheImage) {
    const Built built = build(random_image(16, 8));
    constexpr double nan = std::numeric_limits<double>::quiet_NaN();
    for (const Vector wi : {Vector{nan, nan, nan}, Vector{0, 0, 0}, Vector{nan, 1, 0}, Vector{1e30, -1e30, 1e30}}) {
        static_cast<void>(found<float>(built.table, 0, {}, wi, 0));
        static_cast<void>(found<FloatV>(built.table, 0, {}, wi, 0));
    }
}

// A mirrored transform mirrors the image.
TEST(Dome, MirroredTransform) {
    const Image image = random_image(16, 8);
    const Built plain = build(image), mirrored = build(image, scale({-1, 1, 1}));
    for (std::uint32_t i = 0; i < 200; ++i) {
        const Uniform2<float> q = point(11, i);
        const Vector d = direction(double{q.u}, double{q.v});
        EXPECT_NEAR(found<float>(plain.table, 0, {}, d, 0).radiance.r,
                    found<float>(mirrored.table, 0, {}, {-d.x, d.y, d.z}, 0).radiance.r, 1e-4);
    }
}

}  // namespace
}  // namespace footlight::testing
