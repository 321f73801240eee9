// Rect lights: solid angle and irradiance against closed forms, near, far, grazing, tiny (L03); affine maps (L23).
#include "light/rect.h"

#include "light_testing.h"

namespace footlight::testing {
namespace {

RectLightDesc rect(double width, double height, Matrix4 m) {
    RectLightDesc desc;
    desc.width = width;
    desc.height = height;
    desc.transform = m;
    return desc;
}

LightTable one(const RectLightDesc& desc) {
    LightTable table;
    EXPECT_EQ(append_rect(table, desc), "");
    finalize(table, 1);
    return table;
}

// Solid angle of the rectangle [x0, x1] x [y0, y1] at height z.
long double solid_angle(long double x0, long double x1, long double y0, long double y1, long double z) {
    const auto corner = [z](long double x, long double y) {
        return std::atan2(x * y, z * std::sqrt(x * x + y * y + z * z));
    };
    return corner(x1, y1) - corner(x0, y1) - corner(x1, y0) + corner(x0, y0);
}

// Irradiance of a rectangle of unit radiance on a receiver parallel to it: pi times the configuration factor.
long double irradiance_parallel(long double x0, long double x1, long double y0, long double y1, long double z) {
    const auto corner = [z](long double x, long double y) {
        const long double a = x / z, b = y / z, p = std::sqrt(1 + a * a), q = std::sqrt(1 + b * b);
        return (a / p * std::atan(b / p) + b / q * std::atan(a / q)) / 2;
    };
    return corner(x1, y1) - corner(x0, y1) - corner(x1, y0) + corner(x0, y0);
}

// The mutant: the sum of arc cosines at the corners, as published in 2013.
template <class F>
F solid_angle_acos(F x0, F x1, F y0, F y1, F z) {
    const auto edge = [&](F y) { return -y / std::sqrt(y * y + z * z); };
    const F n0 = edge(y0), n1 = -edge(x1), n2 = -edge(y1), n3 = edge(x0);
    const F sum = std::acos(-n0 * n1) + std::acos(-n1 * n2) + std::acos(-n2 * n3) + std::acos(-n3 * n0);
    return sum - F(2 * kPi);
}

struct Place {
    double size, offset;  // edge, and distance of the foot of p from the centre, for a height of 1
};
std::vector<Place> places() {
    std::vector<Place> all;
    for (const double size : {10.0, 1.0, 0.3, 0.1, 0.03, 1e-2, 1e-3, 1e-4})
        for (const double offset : {0.0, 0.3, 1.0, 3.0, 10.0, 30.0}) all.push_back({size, offset});
    return all;
}

// The light at the origin emits towards -Z; p is one below it, to the side.
TEST(Rect, DensityIsOneOverTheSolidAngleAtEverySizeAndOffset) {
    double worst_mutant = 0;
    for (const Place& place : places()) {
        for (const Matrix4& turn : {Matrix4{}, rotate({0, 0, 1}, 30)}) {
            const LightTable table = one(rect(place.size, place.size * 0.7, turn));
            const Vector p = transform_point(turn, {-place.offset, 0.4 * place.offset, -1});
            const double w = place.size / 2, h = place.size * 0.35;
            const long double x = place.offset, y = -0.4L * place.offset;
            const auto exact = static_cast<double>(solid_angle(x - w, x + w, y - h, y + h, 1));
            const std::vector<Record> records = draw<FloatV>(table, 0, p, 4096);
            double covered = 0;  // mean of 1 / pdf over the samples is the measure of what they cover
            for (const Record& r : records) {
                ASSERT_TRUE(r.valid);
                covered += 1 / r.pdf;
            }
            EXPECT_NEAR(covered / 4096 / exact, 1, 1e-3) << "size " << place.size << " offset " << place.offset;
            const auto naive = static_cast<double>(
                solid_angle_acos<float>(static_cast<float>(x - w), static_cast<float>(x + w), static_cast<float>(y - h),
                                        static_cast<float>(y + h), 1.0F));
            worst_mutant = std::max(worst_mutant, std::abs(naive / exact - 1));
        }
    }
    EXPECT_GT(worst_mutant, 0.2);  // the test rejects the acos sum
}

TEST(Rect, IrradianceOfAParallelReceiverIsTheConfigurationFactor) {
    for (const Place& place : places()) {
        for (const Matrix4& turn : {Matrix4{}, rotate(normalize(Vector{1, 2, 3}), 77)}) {
            const LightTable table = one(rect(place.size, place.size * 0.7, turn));
            const Vector p = transform_point(turn, {-place.offset, 0.4 * place.offset, -1});
            const double w = place.size / 2, h = place.size * 0.35, x = place.offset, y = -0.4 * place.offset;
            const auto exact = static_cast<double>(irradiance_parallel(x - w, x + w, y - h, y + h, 1));
            // the closed form itself cancels: beyond its digits the light is as good as a point
            const double d2 = 1 + x * x + y * y;
            const double far = 4 * w * h / (d2 * d2);
            const double expected = place.size < 0.02 ? far : exact;
            const double sum = irradiance(draw<FloatV>(table, 0, p, 4096), transform_vector(turn, {0, 0, 1}));
            EXPECT_NEAR(sum / expected, 1, 1e-3) << "size " << place.size << " offset " << place.offset;
        }
    }
}

TEST(Rect, BehindItIsDark) {
    const LightTable table = one(rect(1, 1, Matrix4{}));
    for (const double z : {1e-6, 1e-3, 1.0, 1e3})
        for (const Record& r : draw<FloatV>(table, 0, {0.2, 0.1, z}, 64)) EXPECT_FALSE(r.valid);
    const LightHit<double> hit = found<float>(table, 0, {0.2, 0.1, 1}, {0, 0, -1}, 1);
    EXPECT_EQ(hit.pdf, 0);
    EXPECT_EQ(hit.radiance.r, 0);
}

// A mirroring transform keeps the image of local -Z as the side that emits.
TEST(Rect, MirroringKeepsTheSideThatEmits) {
    for (const Vector s :
         {Vector{-1, 1, 1}, Vector{1, -1, 1}, Vector{-1, -1, 1}, Vector{1, 1, -1}, Vector{-1, -1, -1}}) {
        const LightTable table = one(rect(1, 1, scale(s)));
        EXPECT_TRUE(draw<float>(table, 0, {0.1, 0.1, -s.z}, 16)[0].valid);
        EXPECT_FALSE(draw<float>(table, 0, {0.1, 0.1, s.z}, 16)[0].valid);
    }
}

// Any affine image: a stretched rectangle, a rectangle turned by 45 degrees and then stretched (a rhombus).
TEST(Rect, AffineImagesMatchQuadrature) {
    for (const Matrix4& m :
         {scale({1, 3, 1}), rotate({0, 0, 1}, 45) * scale({1, 3, 0.5}), rotate({1, 0, 0}, 30) * scale({2, 1, 0.3})}) {
        const LightTable table = one(rect(1, 0.5, m));
        const Vector u = row(m, 0), v = row(m, 1) * 0.5, c = cross(u, v);
        const Vector n = normalize(c) * -1.0;
        const Vector p = n * 0.8 + u * 0.3, receiver = normalize(u * 0.1 - n);
        const double expected = irradiance_by_quadrature(p, receiver, 200, [&](double a, double b) {
            return SurfacePoint{u * (a - 0.5) + v * (b - 0.5), n, length(c)};
        });
        EXPECT_NEAR(irradiance(draw<FloatV>(table, 0, p, 1 << 14), receiver) / expected, 1, 2e-3);
        EXPECT_NEAR(irradiance(draw<double>(table, 0, p, 1 << 14), receiver) / expected, 1, 2e-3);
    }
}

TEST(Rect, CornersGoRoundAndLieOnTheLight) {
    const LightTable table = one(rect(2, 1, rotate({1, 0, 0}, 40) * scale({-1, 1, 1}) * translate({5, 6, 7})));
    const auto corners = rect_corners(table, 0);
    const auto edge = [&](int i, int j) {
        return Vector{double{corners[j].x} - double{corners[i].x}, double{corners[j].y} - double{corners[i].y},
                      double{corners[j].z} - double{corners[i].z}};
    };
    EXPECT_NEAR(length(edge(0, 1)), 2, 1e-6);
    EXPECT_NEAR(length(edge(1, 2)), 1, 1e-6);
    const Vector n = normalize(cross(edge(0, 1), edge(1, 2)));
    EXPECT_NEAR(dot(n, broadcast_row<double>(table, 0).n), 1, 1e-6);
    const LightBounds box = light_bounds(table, 0);
    for (const auto& c : corners)
        EXPECT_TRUE(box.lower.x <= c.x && c.x <= box.upper.x && box.lower.z <= c.z && c.z <= box.upper.z);
}

}  // namespace
}  // namespace footlight::testing
