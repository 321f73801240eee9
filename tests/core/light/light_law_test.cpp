// Laws that every light in the closed list keeps: a new light is tested by adding it to `family`.
#include <bit>

#include "light_testing.h"

namespace footlight::testing {
namespace {

constexpr std::uint32_t kKinds = std::tuple_size_v<LightTypes<float>>;

Matrix4 tilted(Vector scales = {1, 1, 1}) {
    return scale(scales) * rotate(normalize(Vector{1, 2, 3}), 35) * translate({0.2, -0.1, 0.4});
}

const std::vector<float>& dome_texels() {
    static const std::vector<float> texels = [] {
        std::vector<float> t(std::size_t{8} * 4 * 3);
        for (std::uint32_t i = 0; i < t.size(); ++i)
            t[i] = to_unit<float>(mix_bits(i / 3 + 5U)) * (i / 3 % 5 == 0 ? 0.0F : 2.0F);
        return t;
    }();
    return texels;
}

// Every kind, with and without its awkward variants, all in one table. `unit` scales all lengths, `light` all emission.
LightTable family(double unit = 1, double light = 1) {
    LightTable table;
    const auto common = [&](auto desc, Matrix4 m) {
        m.m[3][0] *= unit;
        m.m[3][1] *= unit;
        m.m[3][2] *= unit;
        desc.transform = m;
        desc.emission = {2 * light, 1 * light, 0.5 * light};
        return desc;
    };
    const auto accepted = [](const std::string& reason) { EXPECT_EQ(reason, ""); };
    for (const Matrix4& m : {tilted(), rotate({0, 0, 1}, 45) * tilted({1, 2, -1})}) {
        auto rect = common(RectLightDesc{}, m);
        rect.width = 1.5 * unit;
        rect.height = 0.5 * unit;
        accepted(append_rect(table, rect));
        auto disk = common(DiskLightDesc{}, m);
        disk.radius = 0.6 * unit;
        accepted(append_disk(table, disk));
    }
    auto small = common(RectLightDesc{}, tilted());
    small.width = small.height = 0.01 * unit;
    accepted(append_rect(table, small));
    for (const double radius : {0.5, 1e-4}) {
        auto sphere = common(SphereLightDesc{}, tilted());
        sphere.radius = radius * unit;
        accepted(append_sphere(table, sphere));
        auto cylinder = common(CylinderLightDesc{}, tilted());
        cylinder.radius = radius * unit;
        cylinder.length = 1.2 * unit;
        accepted(append_cylinder(table, cylinder));
    }
    for (const double angle : {0.0, 0.53, 60.0, 250.0}) {
        auto distant = common(DistantLightDesc{}, tilted());
        distant.angle = angle;
        accepted(append_distant(table, distant));
    }
    accepted(append_dome(table, common(DomeLightDesc{}, tilted())));
    auto dome = common(DomeLightDesc{}, tilted());
    dome.image = dome_texels().data();
    dome.width = 8;
    dome.height = 4;
    accepted(append_dome(table, dome));
    auto triangle = common(TriangleLightDesc{}, tilted());
    const Vector corner = translation(triangle.transform);
    triangle.corners = {corner, corner + row(triangle.transform, 0) * (1.2 * unit),
                        corner + (row(triangle.transform, 0) * 0.3 + row(triangle.transform, 1) * 0.8) * unit};
    accepted(append_triangle(table, triangle));
    finalize(table, 10 * unit);
    return table;
}

std::string name(const LightTable& table, std::uint32_t light) {
    return "light " + std::to_string(light) + " of kind " +
           std::to_string(static_cast<std::uint32_t>(table.info[light].kind));
}

// Seen from the light: near, far, grazing, and one from behind. In the axes of its row, so that the first five see a
// flat light's bright side.
std::vector<Vector> places(const LightTable& table, std::uint32_t light, double unit = 1) {
    const LightRow<double> row = broadcast_row<double>(table, light);
    std::vector<Vector> all;
    for (const Vector q : {Vector{0.1, 0.05, 1}, Vector{1, 0.8, 0.7}, Vector{-1.5, 0.4, 0.5}, Vector{0.3, 0.2, 30},
                           Vector{-20, 10, 4}, Vector{0.5, 1, -2}})
        all.push_back(row.center + (row.u * q.x + row.v * q.y + row.n * q.z) * unit);
    return all;
}

TEST(LightLaw, TheFamilyHoldsEveryKind) {
    EXPECT_EQ(family().kinds, (1U << kKinds) - 1);
    std::uint32_t visited = 0, next = 0;
    for_each_light_type<float>(~0U, [&]<class Light>() {
        EXPECT_EQ(static_cast<std::uint32_t>(Light::kind), next++);  // the list is in the order of LightKind
        ++visited;
    });
    EXPECT_EQ(visited, kKinds);
}

TEST(LightLaw, WhatIsSampledIsWhatARayFinds) {
    const LightTable table = family();
    for (std::uint32_t light = 0; light < table.size(); ++light)
        for (const Vector p : places(table, light))
            for (const Record& r : draw<FloatV>(table, light, p, 1024)) {
                if (!r.valid || r.is_delta) continue;
                EXPECT_NEAR(length(r.wi), 1, 1e-6);
                EXPECT_TRUE(std::isfinite(r.pdf) && r.pdf > 0);
                for (const LightHit<double>& hit : {found<FloatV>(table, light, p, r.wi, r.distance),
                                                    found<float>(table, light, p, r.wi, r.distance)}) {
                    ASSERT_NEAR(hit.radiance.r / r.radiance, 1, 2e-4)
                        << name(table, light) << " u " << r.u0 << " " << r.u1;
                    ASSERT_NEAR(hit.pdf / r.pdf, 1, 2e-4) << name(table, light) << " u " << r.u0 << " " << r.u1;
                }
            }
}

// Distance to the light along a ray, in double: flat faces that scenes hold as triangles by their plane, the others by
// their own intersection.
double distance_along(const LightTable& table, std::uint32_t light, Vector p, Vector wi) {
    const LightKind kind = table.info[light].kind;
    if (kind != LightKind::rect && kind != LightKind::triangle) return intersect_light<double>(table, light, p, wi);
    const LightRow<double> row = broadcast_row<double>(table, light);
    const double t = dot(row.center - p, row.n) / dot(wi, row.n);
    const Vector q = p + wi * t - row.center;
    // coordinates along axes that need not be at right angles, in units of their sizes
    const double uv = dot(row.u, row.v), det = 1 - uv * uv, a = dot(q, row.u), b = dot(q, row.v);
    const double along_u = (a - uv * b) / (det * row.size_u), along_v = (b - uv * a) / (det * row.size_v);
    const bool inside = kind == LightKind::rect ? std::max(std::abs(along_u), std::abs(along_v)) <= 1
                                                : std::min(along_u, along_v) >= 0 && along_u + along_v <= 1;
    return t > 0 && inside ? t : INFINITY;
}

LightHit<double> along(const LightTable& table, std::uint32_t light, Vector p, Vector wi) {
    const bool is_infinite = std::find(table.infinite.begin(), table.infinite.end(), light) != table.infinite.end();
    const double distance = is_infinite ? 0 : distance_along(table, light, p, wi);
    return std::isfinite(distance) ? found<double>(table, light, p, wi, distance) : no_light_hit<double>();
}

// A cap of directions that holds all samples, cut into cells of equal solid angle.
struct Cap {
    Frame<double> frame;
    double k;  // 1 - cos of its half angle
    static constexpr int rings = 8, sectors = 16, cells = rings * sectors;

    explicit Cap(const std::vector<Record>& records) {
        Vector axis{0, 0, 1e-9};
        for (const Record& r : records) axis = axis + r.wi;
        frame = make_frame(normalize(axis));
        k = 0;
        for (const Record& r : records) k = std::max(k, 0.5 * length_squared(r.wi - frame.n));
        k = std::min(2.0, k * 1.05);
    }
    int cell(Vector wi) const {
        const Vector d = to_local(frame, wi);
        const double a = 0.5 * length_squared(wi - frame.n) / k, b = std::atan2(d.y, d.x) / (2 * kPi) + 0.5;
        return std::min(rings - 1, static_cast<int>(a * rings)) * sectors +
               std::min(sectors - 1, static_cast<int>(b * sectors));
    }
    Vector direction(double a, double b) const {
        const double h = a * k, sine = std::sqrt(h * (2 - h)), phi = 2 * kPi * (b - 0.5);
        return to_world(frame, Vec3<double>{sine * std::cos(phi), sine * std::sin(phi), 1 - h});
    }
    double solid_angle() const { return 2 * kPi * k; }
};

// Chi-squared of the sampled directions against the density that hit_light states, which must integrate to 1.
TEST(LightLaw, DirectionsFollowTheDensity) {
    const LightTable table = family();
    constexpr std::uint32_t count = 1 << 14;
    std::uint32_t compared = 0;
    for (std::uint32_t light = 0; light < table.size(); ++light) {
        const std::vector<Vector> all = places(table, light);
        for (std::size_t i = 0; i < 3; ++i) {
            const Vector p = all[i];
            const std::vector<Record> records = draw<FloatV>(table, light, p, count, independent_point, light);
            ASSERT_TRUE(records[0].valid) << name(table, light);
            // of a light this small, seen in float, no cell could be told from the next
            const LightRow<double> row = broadcast_row<double>(table, light);
            const bool is_dome = table.info[light].kind == LightKind::dome;
            if (records[0].is_delta || (!is_dome && row.size_u < 1e-3)) continue;
            ++compared;
            const Cap cap(records);
            std::array<double, Cap::cells> drawn{}, expected{};
            for (const Record& r : records) drawn[cap.cell(r.wi)] += r.valid ? 1 : 0;
            constexpr int fine = 32;  // per side of a cell
            for (int a = 0; a < Cap::rings * fine; ++a)
                for (int b = 0; b < Cap::sectors * fine; ++b) {
                    const Vector wi = cap.direction((a + 0.5) / (Cap::rings * fine), (b + 0.5) / (Cap::sectors * fine));
                    expected[a / fine * Cap::sectors + b / fine] += along(table, light, p, wi).pdf;
                }
            double total = 0, chi2 = 0, freedom = -1, rest_drawn = 0, rest_expected = 0;
            for (int c = 0; c < Cap::cells; ++c) {
                const double e = expected[c] * cap.solid_angle() / (Cap::cells * fine * fine) * count;
                total += e / count;
                if (e < 10) {
                    rest_drawn += drawn[c];
                    rest_expected += e;
                    continue;
                }
                chi2 += (drawn[c] - e) * (drawn[c] - e) / e;
                freedom += 1;
            }
            EXPECT_NEAR(total, 1, 5e-3) << name(table, light);
            EXPECT_LT(rest_drawn, rest_expected + 6 * std::sqrt(rest_expected) + 6) << name(table, light);
            EXPECT_LT((chi2 - freedom) / std::sqrt(2 * freedom), 5.2) << name(table, light) << " place " << i;
        }
    }
    EXPECT_GE(compared, 3 * (table.size() - 4));  // all but the delta light, the thin ones and the sun
}

// The float kernels against the double instance of the same formulas: same answer to the same numbers.
TEST(LightLaw, FloatFollowsDouble) {
    const LightTable table = family();
    for (std::uint32_t light = 0; light < table.size(); ++light)
        for (const Vector p : places(table, light)) {
            const auto exact = draw<double>(table, light, p, 512), scalar = draw<float>(table, light, p, 512),
                       batch = draw<FloatV>(table, light, p, 512);
            for (std::size_t i = 0; i < exact.size(); ++i)
                for (const Record& r : {scalar[i], batch[i]}) {
                    ASSERT_EQ(r.valid, exact[i].valid) << name(table, light);
                    if (!r.valid) continue;
                    EXPECT_NEAR(r.radiance, exact[i].radiance, 1e-3) << name(table, light);
                    EXPECT_NEAR(r.pdf / exact[i].pdf, 1, 1e-3)
                        << name(table, light) << " p " << p.x << " u " << r.u0 << " " << r.u1;
                    EXPECT_LT(length(r.wi - exact[i].wi), 1e-3)
                        << name(table, light) << " p " << p.x << " u " << r.u0 << " " << r.u1;
                }
        }
}

template <class F>
bool same_bits(F a, F b) {
    for (int k = 0; k < kLanes; ++k)
        if (std::bit_cast<std::uint32_t>(a.get(k)) != std::bit_cast<std::uint32_t>(b.get(k))) return false;
    return true;
}

// Lanes that hold different lights get, bit for bit, what each would get in a batch of its own.
TEST(LightLaw, MixedLanesEqualUniformLanes) {
    const LightTable table = family();
    for (std::uint32_t start = 0; start < table.size(); ++start)
        for (const Vector p : places(table, start)) {
            std::array<std::uint32_t, kLanes> index{};
            std::array<float, kLanes> u{}, v{};
            for (std::uint32_t k = 0; k < kLanes; ++k) {
                index[k] = (start + k) % table.size();
                u[k] = point(1, k).u;
                v[k] = point(1, k).v;
            }
            const FloatV u0 = FloatV::load_unaligned(u.data()), u1 = FloatV::load_unaligned(v.data());
            const Vec3<FloatV> at = number<FloatV>(p);
            const LightSample<FloatV> mixed = sample_light(table, UIntV::load_unaligned(index.data()), at, u0, u1);
            for (std::size_t k = 0; k < kLanes; ++k) {
                const LightSample<FloatV> own = sample_light(table, UIntV(index[k]), at, u0, u1);
                const auto lane = static_cast<int>(k);
                ASSERT_EQ(lane_of_mask<FloatV>(mixed.valid, lane), lane_of_mask<FloatV>(own.valid, lane));
                if (!lane_of_mask<FloatV>(own.valid, lane)) continue;
                for (const auto& [a, b] :
                     {std::pair{mixed.wi.x, own.wi.x}, std::pair{mixed.wi.y, own.wi.y}, std::pair{mixed.wi.z, own.wi.z},
                      std::pair{mixed.pdf, own.pdf}, std::pair{mixed.distance, own.distance},
                      std::pair{mixed.radiance.r, own.radiance.r}, std::pair{mixed.radiance.b, own.radiance.b}})
                    ASSERT_EQ(std::bit_cast<std::uint32_t>(a.get(k)), std::bit_cast<std::uint32_t>(b.get(k)))
                        << name(table, index[k]);
            }
            const LightHit<FloatV> found_mixed =
                hit_light(table, UIntV::load_unaligned(index.data()), at, mixed.wi, mixed.distance);
            for (std::size_t k = 0; k < kLanes; ++k) {
                const LightHit<FloatV> own = hit_light(table, UIntV(index[k]), at, mixed.wi, mixed.distance);
                ASSERT_EQ(std::bit_cast<std::uint32_t>(found_mixed.pdf.get(k)),
                          std::bit_cast<std::uint32_t>(own.pdf.get(k)));
            }
        }
}

// No length constant: lengths times 2^k give the same directions and densities; light times 2^k the same light times
// 2^k.
TEST(LightLaw, PowersOfTwoScaleExactly) {
    const LightTable table = family();
    for (const int k : {-20, -10, 10, 20}) {
        const double factor = std::ldexp(1.0, k);
        const LightTable longer = family(factor), brighter = family(1, factor);
        EXPECT_EQ(longer.selection.cdf, table.selection.cdf);
        EXPECT_EQ(brighter.selection.cdf, table.selection.cdf);
        for (std::uint32_t light = 0; light < table.size(); ++light)
            for (const Vector p : places(table, light)) {
                const auto plain = draw<FloatV>(table, light, p, 64),
                           scaled = draw<FloatV>(longer, light, p * factor, 64);
                const auto bright = draw<FloatV>(brighter, light, p, 64);
                for (std::size_t i = 0; i < plain.size(); ++i) {
                    ASSERT_EQ(plain[i].valid, scaled[i].valid) << name(table, light);
                    if (!plain[i].valid) continue;
                    ASSERT_EQ(plain[i].wi.x, scaled[i].wi.x) << name(table, light);
                    ASSERT_EQ(plain[i].pdf, scaled[i].pdf) << name(table, light);
                    ASSERT_EQ(plain[i].radiance, scaled[i].radiance) << name(table, light);
                    ASSERT_EQ(plain[i].distance * (std::isinf(plain[i].distance) ? 1 : factor), scaled[i].distance)
                        << name(table, light);
                    ASSERT_EQ(plain[i].wi.x, bright[i].wi.x) << name(table, light);
                    ASSERT_EQ(plain[i].pdf, bright[i].pdf) << name(table, light);
                    ASSERT_EQ(plain[i].radiance * factor, bright[i].radiance) << name(table, light);
                }
            }
    }
}

}  // namespace
}  // namespace footlight::testing
