// The brute-force tracer against closed forms, and mutants of it that the same closed forms reject.
#include "reference/brute_force.h"

#include <gtest/gtest.h>

#include <cmath>

namespace brute_force {
namespace {

constexpr double z_limit = 5.2;  // two-sided 2e-7: 500 such tests give one false alarm in 10 000 runs
constexpr int many = 200'000;

Vec grey(double value) { return {value, value, value}; }
Scattering white() { return Lambert{grey(1)}; }

// Irradiance fraction at a point of a parallel rectangle [0, a] x [0, b] at height h, one corner straight above.
double corner_form_factor(double a, double b, double h) {
    const double x = a / h, y = b / h, rx = std::sqrt(1 + x * x), ry = std::sqrt(1 + y * y);
    return (x / rx * std::atan(y / rx) + y / ry * std::atan(x / ry)) / (2 * pi);
}

// --- random numbers ---

TEST(Random, IsUniformAndUncorrelated) {
    Random random(1);
    constexpr int n = 1'000'000, cells = 64;
    std::vector<double> counts(cells * cells);
    for (int k = 0; k < n; ++k) {
        const auto i = static_cast<std::size_t>(random.next() * cells),
                   j = static_cast<std::size_t>(random.next() * cells);
        counts[i * cells + j] += 1;
    }
    double chi2 = 0;
    const double expected = static_cast<double>(n) / (cells * cells);
    for (const double count : counts) chi2 += (count - expected) * (count - expected) / expected;
    const double freedom = cells * cells - 1;
    EXPECT_LT(std::abs(chi2 - freedom) / std::sqrt(2 * freedom), z_limit);
}

TEST(Random, SeedsGiveDifferentSequences) {
    Random a(1), b(2), c(1);
    const double first = a.next();
    EXPECT_NE(first, b.next());
    EXPECT_EQ(first, c.next());
}

// --- shapes ---

TEST(Intersect, PointsLieOnTheShapeAndNormalsAreUnit) {
    Random random(3);
    const Sphere sphere{{0.3, -0.2, 4}, 1.5};
    const Quad quad{{-1, -1, 3}, {2, 0, 0.5}, {0, 2, 0}};
    int hits = 0;
    for (int k = 0; k < 10'000; ++k) {
        const Ray ray{{random.next(), random.next(), 0}, normalize({random.next() - 0.5, random.next() - 0.5, 1})};
        if (const auto crossing = intersect(sphere, ray, 0)) {
            ++hits;
            EXPECT_NEAR(length(ray.at(crossing->t) - sphere.centre), sphere.radius, 1e-13);
            EXPECT_NEAR(length(crossing->normal), 1, 1e-13);
            EXPECT_LT(dot(crossing->normal, ray.direction), 0);
        }
        if (const auto crossing = intersect(quad, ray, 0)) {
            ++hits;
            EXPECT_NEAR(dot(ray.at(crossing->t) - quad.corner, crossing->normal), 0, 1e-13);
        }
    }
    EXPECT_GT(hits, 5'000);
}

TEST(Intersect, TwoTrianglesAreAQuad) {
    const Quad quad{{-1, -1, 3}, {2, 0, 0.5}, {0.3, 2, 0}};
    const Vec opposite = quad.corner + quad.u + quad.v;
    const Triangle lower{quad.corner, quad.corner + quad.u, opposite},
        upper{quad.corner, opposite, quad.corner + quad.v};
    Random random(4);
    for (int k = 0; k < 10'000; ++k) {
        const Ray ray{{}, normalize({2 * random.next() - 1, 2 * random.next() - 1, 1})};
        const bool in_quad = intersect(quad, ray, 0).has_value();
        EXPECT_EQ(in_quad, intersect(lower, ray, 0).has_value() || intersect(upper, ray, 0).has_value());
    }
}

TEST(Intersect, FromInsideASphereTheFarSideIsHit) {
    const auto crossing = intersect(Sphere{{0, 0, 0}, 2}, Ray{{0, 0, 1}, {0, 0, 1}}, 0);
    ASSERT_TRUE(crossing);
    EXPECT_DOUBLE_EQ(crossing->t, 1);
}

// --- lobes ---

TEST(Albedo, LambertReflectsItsReflectance) {
    EXPECT_EQ(z_score(albedo(Lambert{{0.2, 0.5, 1}}, 0.3, 100, 5), {0.2, 0.5, 1}), 0);
}

// Single scattering by white GGX, measured independently by quadrature: numbers of the project's notes, three digits.
TEST(Albedo, WhiteGgxLosesWhatScattersTwice) {
    const struct {
        double alpha, degrees, expected;
    } rows[] = {{1, 0, 0.307}, {1, 70, 0.533}, {0.5, 0, 0.688}, {0.5, 70, 0.732}, {0.1, 0, 0.988}, {0.1, 70, 0.946}};
    for (const auto& row : rows) {
        const auto estimate = albedo(Ggx{grey(1), grey(1), row.alpha}, std::cos(row.degrees * pi / 180), many, 6);
        // Half a unit of the last digit that the notes give, plus noise.
        EXPECT_NEAR(estimate.mean.x, row.expected, 5e-4 + z_limit * estimate.standard_error.x) << row.alpha;
    }
}

TEST(Albedo, GgxSamplerAgreesWithUniformDirections) {
    Random random(7);
    const Scattering lobe = Ggx{{0.9, 0.5, 0.1}, grey(1), 0.4};
    const Vec wo = from_polar(0.5, 0);
    Accumulator uniform;
    for (int k = 0; k < 5 * many; ++k)
        uniform.add(2 * pi * evaluate(lobe, wo, from_polar(random.next(), 2 * pi * random.next())));
    const auto a = uniform.result(), b = albedo(lobe, 0.5, many, 8);
    const Vec error{std::hypot(a.standard_error.x, b.standard_error.x),
                    std::hypot(a.standard_error.y, b.standard_error.y),
                    std::hypot(a.standard_error.z, b.standard_error.z)};
    EXPECT_LT(z_score({a.mean, error}, b.mean), z_limit);
}

TEST(Evaluate, IsReciprocal) {
    Random random(9);
    const Scattering lobes[] = {white(), Ggx{{0.9, 0.5, 0.1}, grey(1), 0.3}};
    for (const Scattering& lobe : lobes) {
        for (int k = 0; k < 1'000; ++k) {
            const Vec a = cosine_direction(random), b = cosine_direction(random);
            const Vec forward = evaluate(lobe, a, b) / b.z, backward = evaluate(lobe, b, a) / a.z;
            EXPECT_NEAR(forward.y, backward.y, 1e-10 * forward.y);
        }
    }
}

// --- light on a plane ---

TEST(Irradiance, SphereIsPiTimesSquaredSine) {
    for (const double radius : {0.9, 0.5, 0.2}) {
        const Scene scene{{{Sphere{{0, 0, 1}, radius}, {Black{}, grey(2)}}}};
        EXPECT_LT(z_score(irradiance(scene, {}, {0, 0, 1}, 1, many, 10), grey(2 * pi * radius * radius)), z_limit);
    }
}

TEST(Irradiance, DiskOnAxis) {
    const Scene scene{{{Disk{{0, 0, 2}, {0, 0, -1}, 1.5}, {Black{}, grey(3)}}}};
    EXPECT_LT(z_score(irradiance(scene, {}, {0, 0, 1}, 1, many, 11), grey(3 * pi * 2.25 / (4 + 2.25))), z_limit);
}

TEST(Irradiance, RectangleOffItsCorner) {
    // [1, 3] x [-1, 2] at height 1.5, by the corner formula with signs.
    auto signed_corner = [](double a, double b) {
        return std::copysign(1, a * b) * corner_form_factor(std::abs(a), std::abs(b), 1.5);
    };
    const double factor = signed_corner(3, 2) - signed_corner(1, 2) - signed_corner(3, -1) + signed_corner(1, -1);
    const Scene scene{{{Quad{{1, -1, 1.5}, {0, 3, 0}, {2, 0, 0}}, {Black{}, grey(1)}}}};
    const auto estimate = irradiance(scene, {}, {0, 0, 1}, 1, many, 12);
    EXPECT_LT(z_score(estimate, grey(pi * factor)), z_limit);
    // The mutant that forgets the receiver's cosine is told apart.
    Random random(12);
    Accumulator no_cosine;
    for (int k = 0; k < many; ++k)
        no_cosine.add(pi * radiance(scene, {{}, from_polar(random.next(), 2 * pi * random.next())}, 1, random));
    EXPECT_GT(z_score(no_cosine.result(), grey(pi * factor)), 2 * z_limit);
}

TEST(Irradiance, OneSidedEmittersAreDarkBehind) {
    const Scene scene{{{Quad{{-1, -1, 1}, {2, 0, 0}, {0, 2, 0}}, {Black{}, grey(1)}}}};
    EXPECT_EQ(z_score(irradiance(scene, {}, {0, 0, 1}, 1, 10'000, 13), grey(0)), 0);
}

TEST(Irradiance, GradientEnvironment) {
    // L = 1 + cos of the angle to the normal: E = pi + 2 pi / 3.
    const Scene scene{{}, [](Vec d) { return grey(1 + d.z); }};
    EXPECT_LT(z_score(irradiance(scene, {}, {0, 0, 1}, 1, many, 14), grey(pi + 2 * pi / 3)), z_limit);
}

// --- furnaces ---

TEST(Furnace, WhiteConvexBodyVanishes) {
    const Scene scene{{{Sphere{{0, 0, 3}, 1}, {white(), {}}}}, [](Vec) { return grey(1); }};
    // Every single path carries exactly one.
    EXPECT_EQ(z_score(mean_radiance(scene, {{}, {0, 0, 1}}, 8, 10'000, 15), grey(1)), 0);
    // A mutant with 0.999 of the reflectance is told apart without any statistics.
    const Scene grey_scene{{{Sphere{{0, 0, 3}, 1}, {Lambert{grey(0.999)}, {}}}}, [](Vec) { return grey(1); }};
    EXPECT_GT(z_score(mean_radiance(grey_scene, {{}, {0, 0, 1}}, 8, 10'000, 15), grey(1)), z_limit);
}

TEST(Furnace, InsideAnEmittingSphereItIsAGeometricSeries) {
    // From inside, the normal must point inwards: six quads make the room instead.
    const double reflectance = 0.8;
    Scene scene;
    const Material wall{Lambert{grey(reflectance)}, grey(0.2)};
    const Vec axes[3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    for (int k = 0; k < 3; ++k) {
        const Vec n = axes[k], u = axes[(k + 1) % 3], v = axes[(k + 2) % 3];
        scene.objects.push_back({Quad{-n - u - v, u * 2, v * 2}, wall});  // normal +n, seen from inside
        scene.objects.push_back({Quad{n - u - v, v * 2, u * 2}, wall});   // normal -n
    }
    for (const int edges : {1, 2, 8, 20}) {
        const double expected = 0.2 * (1 - std::pow(reflectance, edges)) / (1 - reflectance);
        EXPECT_LT(
            z_score(mean_radiance(scene, {{0.1, 0.2, 0.3}, normalize({1, 2, 3})}, edges, 2'000, 16), grey(expected)),
            z_limit);
    }
}

TEST(Furnace, MirrorShowsTheEnvironmentBehind) {
    const Scene scene{{{Plane{{0, 0, 0}, {0, 0, 1}}, {Mirror{}, {}}}}, [](Vec d) { return Vec{d.x, d.y, d.z}; }};
    const Vec down = normalize({0.3, 0.1, -1});
    EXPECT_EQ(z_score(mean_radiance(scene, {{0, 0, 1}, down}, 2, 10, 17), {down.x, down.y, -down.z}), 0);
}

TEST(Scene, InterreflectionOfTwoPlatesFollowsTheFormFactor) {
    // A black emitting plate over a grey one; the point sees the plate and, through the mirror image of depth, nothing
    // else.
    const double factor = 4 * corner_form_factor(1, 1, 2);
    Scene scene;
    scene.objects.push_back({Quad{{-1, -1, 2}, {0, 2, 0}, {2, 0, 0}}, {Black{}, grey(5)}});
    scene.objects.push_back({Plane{{0, 0, 0}, {0, 0, 1}}, {Lambert{grey(0.5)}, {}}});
    const Ray ray{{3, 0, 1}, normalize({-3, 0, -1})};  // below the plate, at the point under its centre
    EXPECT_LT(z_score(mean_radiance(scene, ray, 2, many, 18), grey(5 * factor * 0.5)), z_limit);
}

TEST(Pixel, AlignedEdgesSplitPixelsExactly) {
    // The left half of the view is lit; of four pixels two are bright, two dark, without noise.
    const Scene scene{{{Quad{{-10, -10, -1}, {10, 0, 0}, {0, 20, 0}}, {Black{}, grey(1)}}}};
    const Camera camera{.position = {0, 0, 0}, .width = 4, .height = 1};
    for (int column = 0; column < 4; ++column) {
        EXPECT_EQ(z_score(pixel(scene, camera, column, 0, 1, 100, 19), grey(column < 2 ? 1 : 0)), 0) << column;
    }
}

TEST(Pixel, RowZeroIsTheTop) {
    const Scene scene{{}, [](Vec d) { return grey(d.y > 0 ? 1 : 0); }};
    const Camera camera{.position = {0, 0, 0}, .width = 1, .height = 2};
    EXPECT_EQ(z_score(pixel(scene, camera, 0, 0, 1, 100, 20), grey(1)), 0);
    EXPECT_EQ(z_score(pixel(scene, camera, 0, 1, 1, 100, 20), grey(0)), 0);
}

}  // namespace
}  // namespace brute_force
