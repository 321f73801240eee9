// Laws of the subdivision surfaces: symmetry, sharpness, holes, planes, primvars, refusals.
#include "subdiv/subdivide.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <random>
#include <set>
#include <span>
#include <stdexcept>
#include <vector>

namespace footlight {
namespace {

struct Cage {
    std::vector<float> points;
    std::vector<std::int32_t> counts;
    std::vector<std::int32_t> indices;

    SubdivCage view() const {
        SubdivCage cage;
        cage.points = points;
        cage.face_counts = counts;
        cage.face_indices = indices;
        return cage;
    }
};

Cage cube() {
    return {{-1, -1, -1, 1, -1, -1, 1, 1, -1, -1, 1, -1, -1, -1, 1, 1, -1, 1, 1, 1, 1, -1, 1, 1},
            {4, 4, 4, 4, 4, 4},
            {0, 3, 2, 1, 4, 5, 6, 7, 0, 1, 5, 4, 3, 7, 6, 2, 0, 4, 7, 3, 1, 2, 6, 5}};
}

Cage octahedron() {
    return {{1, 0, 0, -1, 0, 0, 0, 1, 0, 0, -1, 0, 0, 0, 1, 0, 0, -1},
            {3, 3, 3, 3, 3, 3, 3, 3},
            {0, 2, 4, 2, 1, 4, 1, 3, 4, 3, 0, 4, 2, 0, 5, 1, 2, 5, 3, 1, 5, 0, 3, 5}};
}

// n x n quads over [0, 1]^2 in the plane z = x/2 + y/4 + height: exact in binary.
Cage plane(int n, float height) {
    Cage cage;
    for (int y = 0; y <= n; ++y) {
        for (int x = 0; x <= n; ++x) {
            const float u = static_cast<float>(x) / static_cast<float>(n);
            const float v = static_cast<float>(y) / static_cast<float>(n);
            cage.points.insert(cage.points.end(), {u, v, u / 2 + v / 4 + height});
        }
    }
    for (int y = 0; y < n; ++y) {
        for (int x = 0; x < n; ++x) {
            const int a = y * (n + 1) + x;
            cage.counts.push_back(4);
            cage.indices.insert(cage.indices.end(), {a, a + 1, a + n + 2, a + n + 1});
        }
    }
    return cage;
}

double radius(const std::vector<float>& v, std::size_t i) { return std::hypot(v[3 * i], v[3 * i + 1], v[3 * i + 2]); }

void expect_unit_outward(const SubdividedMesh& mesh) {
    for (std::size_t c = 0; c < mesh.triangles.size(); ++c) {
        const std::size_t p = mesh.triangles[c];
        const std::size_t n = mesh.normal_indices[c];
        EXPECT_NEAR(radius(mesh.normals, n), 1.0, 1e-6);
        double cosine = 0;
        for (std::size_t k = 0; k < 3; ++k) {
            cosine += static_cast<double>(mesh.points[3 * p + k]) * static_cast<double>(mesh.normals[3 * n + k]);
        }
        EXPECT_GT(cosine, 0.0);
    }
}

TEST(Subdivide, LimitOfACubeIsRoundAndSymmetric) {
    const Cage cage = cube();
    const SubdividedMesh mesh = subdivide(cage.view(), 3);
    EXPECT_EQ(mesh.triangles.size() / 3, 6U * 64U * 2U);
    EXPECT_EQ(mesh.face_of_triangle.size(), mesh.triangles.size() / 3);
    // The limit at the corner of a cube of half-size 1 is 1/2 (1, 1, 1): Halstead, Kass, DeRose 1993, n = 3.
    EXPECT_NEAR(mesh.points[0], -0.5F, 1e-6F);
    double low = 1e9;
    double high = 0;
    for (std::size_t i = 0; i < mesh.points.size() / 3; ++i) {
        low = std::min(low, radius(mesh.points, i));
        high = std::max(high, radius(mesh.points, i));
    }
    EXPECT_LT(high / low, 1.12);
    expect_unit_outward(mesh);
}

TEST(Subdivide, LevelsLieOnOneLimitSurface) {
    const Cage cage = cube();
    const SubdividedMesh coarse = subdivide(cage.view(), 1);
    const SubdividedMesh fine = subdivide(cage.view(), 4);
    for (std::size_t i = 0; i < coarse.points.size() / 3; ++i) {
        double nearest = 1e9;
        for (std::size_t k = 0; k < fine.points.size() / 3; ++k) {
            double d = 0;
            for (std::size_t c = 0; c < 3; ++c) {
                d += std::pow(static_cast<double>(coarse.points[3 * i + c] - fine.points[3 * k + c]), 2);
            }
            nearest = std::min(nearest, d);
        }
        EXPECT_LT(std::sqrt(nearest), 1e-6);
    }
}

TEST(Subdivide, LoopOfAnOctahedronIsRound) {
    const Cage cage = octahedron();
    SubdivCage view = cage.view();
    view.scheme = SubdivScheme::loop;
    const SubdividedMesh mesh = subdivide(view, 3);
    EXPECT_EQ(mesh.triangles.size() / 3, 8U * 64U);
    expect_unit_outward(mesh);
}

TEST(Subdivide, SharpEdgesKeepTheCube) {
    const Cage cage = cube();
    SubdivCage view = cage.view();
    const std::vector<std::int32_t> creases = {0, 1, 2, 3, 0, 4, 5, 6, 7, 4, 0, 4, 1, 5, 2, 6, 3, 7};
    const std::vector<std::int32_t> lengths = {5, 5, 2, 2, 2, 2};
    const std::vector<std::int32_t> crease_indices(creases.begin(), creases.end());
    const std::vector<float> sharpnesses(6, 10.0F);
    view.crease_indices = crease_indices;
    view.crease_lengths = lengths;
    view.crease_sharpnesses = sharpnesses;
    EXPECT_THROW(
        {
            SubdivCage bad = view;
            bad.crease_indices = std::span(crease_indices).first(17);
            static_cast<void>(subdivide(bad, 1));
        },
        std::invalid_argument);
    const SubdividedMesh mesh = subdivide(view, 2);
    for (std::size_t c = 0; c < mesh.triangles.size(); ++c) {
        const std::size_t p = mesh.triangles[c];
        const std::size_t n = mesh.normal_indices[c];
        // On the cube: along the normal of its face the point is at distance 1, and the normal is an axis.
        double along = 0;
        double axis = 0;
        for (std::size_t k = 0; k < 3; ++k) {
            along += static_cast<double>(mesh.points[3 * p + k] * mesh.normals[3 * n + k]);
            axis = std::max(axis, static_cast<double>(std::abs(mesh.normals[3 * n + k])));
        }
        EXPECT_NEAR(along, 1.0, 1e-6);
        EXPECT_NEAR(axis, 1.0, 1e-6);
    }
}

TEST(Subdivide, CornersStay) {
    const Cage cage = cube();
    SubdivCage view = cage.view();
    const std::vector<std::int32_t> corner = {6};
    const std::vector<float> sharpness = {10.0F};
    view.corner_indices = corner;
    view.corner_sharpnesses = sharpness;
    const SubdividedMesh mesh = subdivide(view, 3);
    double high = 0;
    for (std::size_t i = 0; i < mesh.points.size() / 3; ++i) {
        high = std::max(high, radius(mesh.points, i));
    }
    EXPECT_NEAR(high, std::sqrt(3.0), 1e-6);
    expect_unit_outward(mesh);
}

TEST(Subdivide, HolesAreGoneAndTheRestUnmoved) {
    const Cage cage = cube();
    SubdivCage view = cage.view();
    const SubdividedMesh whole = subdivide(view, 2);
    const std::vector<std::int32_t> holes = {2};
    view.holes = holes;
    const SubdividedMesh mesh = subdivide(view, 2);
    EXPECT_EQ(mesh.triangles.size(), whole.triangles.size() / 6 * 5);
    EXPECT_EQ(mesh.points, whole.points);
    const std::set<std::uint32_t> faces(mesh.face_of_triangle.begin(), mesh.face_of_triangle.end());
    EXPECT_EQ(faces, (std::set<std::uint32_t>{0, 1, 3, 4, 5}));
}

TEST(Subdivide, PlanesStayExact) {
    const Cage cage = plane(4, 1024.0F);
    const SubdividedMesh mesh = subdivide(cage.view(), 3);
    double area = 0;
    for (std::size_t i = 0; i < mesh.points.size() / 3; ++i) {
        const float* p = &mesh.points[3 * i];
        EXPECT_NEAR(static_cast<double>(p[2]), static_cast<double>(p[0]) / 2 + static_cast<double>(p[1]) / 4 + 1024.0,
                    6.2e-5);  // half a unit in the last place of 1024, with the rounding of x and y
    }
    for (std::size_t t = 0; t < mesh.triangles.size(); t += 3) {
        const float* a = &mesh.points[3 * mesh.triangles[t]];
        const float* b = &mesh.points[3 * mesh.triangles[t + 1]];
        const float* c = &mesh.points[3 * mesh.triangles[t + 2]];
        area += 0.5 * static_cast<double>((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]));
    }
    EXPECT_NEAR(area, 1.0, 1e-5);  // edgeAndCorner keeps the outline
}

TEST(Subdivide, BoundaryNoneDropsTheRim) {
    const Cage cage = plane(4, 0.0F);
    SubdivCage view = cage.view();
    view.boundary = SubdivBoundary::none;
    EXPECT_EQ(subdivide(view, 1).triangles.size() / 3, 4U * 4U * 2U);  // the inner 2 x 2 faces
}

TEST(Subdivide, PrimvarsFollow) {
    const Cage cage = plane(3, 0.0F);
    std::vector<float> corner_values;
    for (const std::int32_t i : cage.indices) {
        const auto p = 3 * static_cast<std::size_t>(i);
        corner_values.insert(corner_values.end(), {cage.points[p], cage.points[p + 1]});
    }
    std::vector<SubdivPrimvar> primvars(3);
    primvars[0] = {PrimvarKind::vertex, 3, cage.points, {}};
    primvars[1] = {PrimvarKind::varying, 3, cage.points, {}};
    primvars[2] = {PrimvarKind::face_varying, 2, corner_values, {}};
    SubdivCage view = cage.view();
    view.primvars = primvars;
    view.face_varying = SubdivFaceVarying::all;
    const SubdividedMesh mesh = subdivide(view, 2);
    ASSERT_EQ(mesh.primvars.size(), 3U);
    EXPECT_EQ(mesh.primvars[0].values, mesh.points);
    for (std::size_t c = 0; c < mesh.triangles.size(); ++c) {
        for (std::size_t k = 0; k < 2; ++k) {
            const float linear = mesh.primvars[1].values[3 * mesh.primvars[1].indices[c] + k];
            EXPECT_NEAR(mesh.primvars[2].values[2 * mesh.primvars[2].indices[c] + k], linear, 1e-6F);
        }
    }
}

// Any topology whose indices are in range, however odd (points twice in a face, edges with many faces, creases where
// there is no edge), gives finite points and indices in range, or is refused: run this under the sanitizers.
TEST(Subdivide, OddCagesDoNoHarm) {
    std::mt19937 random(7);
    const auto below = [&](int n) { return static_cast<std::int32_t>(random() % static_cast<unsigned>(n)); };
    int refined = 0;
    for (int round = 0; round < 400; ++round) {
        Cage cage;
        const int points = 3 + below(8);
        const bool loop = below(2) == 0;
        for (int i = 0; i < 3 * points; ++i) {
            cage.points.push_back(static_cast<float>(below(100)) / 10.0F);
        }
        for (int face = 1 + below(8); face > 0; --face) {
            cage.counts.push_back(loop ? 3 : 3 + below(4));
            for (int k = 0; k < cage.counts.back(); ++k) {
                cage.indices.push_back(below(points));
            }
        }
        SubdivCage view = cage.view();
        view.scheme = loop ? SubdivScheme::loop : SubdivScheme::catmull_clark;
        view.boundary = static_cast<SubdivBoundary>(below(3));
        view.face_varying = static_cast<SubdivFaceVarying>(below(6));
        const std::vector<std::int32_t> crease = {below(points), below(points), below(points)};
        const std::vector<std::int32_t> length = {3};
        const std::vector<float> sharpness = {static_cast<float>(below(12))};
        view.crease_indices = crease;
        view.crease_lengths = length;
        view.crease_sharpnesses = sharpness;
        const std::vector<std::int32_t> corner = {below(points)};
        view.corner_indices = corner;
        view.corner_sharpnesses = sharpness;
        std::vector<float> values;
        std::vector<std::int32_t> values_at;
        for (std::size_t i = 0; i < cage.indices.size(); ++i) {
            values.push_back(static_cast<float>(below(100)));
            values_at.push_back(below(static_cast<int>(cage.indices.size())));
        }
        const std::vector<SubdivPrimvar> primvars = {{PrimvarKind::face_varying, 1, values, values_at},
                                                     {PrimvarKind::varying, 3, cage.points, {}}};
        view.primvars = primvars;
        try {
            const SubdividedMesh mesh = subdivide(view, 1 + below(3));
            ++refined;
            for (const float x : mesh.points) {
                EXPECT_TRUE(std::isfinite(x));
            }
            for (const float x : mesh.normals) {
                EXPECT_TRUE(std::isfinite(x));
            }
            for (const std::uint32_t i : mesh.triangles) {
                EXPECT_LT(i, mesh.points.size() / 3);
            }
            for (const std::uint32_t i : mesh.normal_indices) {
                EXPECT_LT(i, mesh.normals.size() / 3);
            }
            for (const std::uint32_t i : mesh.face_of_triangle) {
                EXPECT_LT(i, cage.counts.size());
            }
            for (const SubdividedPrimvar& primvar : mesh.primvars) {
                EXPECT_EQ(primvar.indices.size(), mesh.triangles.size());
                for (const std::uint32_t i : primvar.indices) {
                    EXPECT_LT(i, primvar.values.size() / static_cast<std::size_t>(primvar.width));
                }
            }
        } catch (const std::invalid_argument&) {
        }
    }
    EXPECT_GT(refined, 200);
}

TEST(Subdivide, BadCagesAreRefused) {
    const auto refused = [](auto spoil) {
        Cage cage = cube();
        SubdivCage view = cage.view();
        spoil(cage, view);
        EXPECT_THROW(static_cast<void>(subdivide(view, 1)), std::invalid_argument);
    };
    refused([](Cage& cage, SubdivCage&) { cage.indices[3] = 8; });
    refused([](Cage& cage, SubdivCage&) { cage.indices[3] = -1; });
    refused([](Cage& cage, SubdivCage&) { cage.counts[0] = -4; });
    refused([](Cage& cage, SubdivCage&) { cage.counts[0] = 3; });
    refused([](Cage&, SubdivCage& view) { view.scheme = SubdivScheme::loop; });
    refused([](Cage&, SubdivCage& view) { view.points = view.points.first(22); });
    const std::vector<std::int32_t> six = {6};
    refused([&](Cage&, SubdivCage& view) { view.holes = six; });
    refused([&](Cage&, SubdivCage& view) { view.corner_indices = six; });
    EXPECT_THROW(static_cast<void>(subdivide(cube().view(), 0)), std::invalid_argument);
}

}  // namespace
}  // namespace footlight
