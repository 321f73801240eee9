// Fills the light table: areas, axes, radiances and powers under the light's transform, all in double precision.
#include "light/light_table.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "light/distant.h"
#include "light/dome_image.h"
#include "light/rect.h"
#include "math/frame.h"

namespace footlight {
namespace {

using Vector = Vec3<double>;
using Color = std::array<double, 3>;

// A light before it is rounded to float. Names as in LightRow; the meaning is stated in each light's file.
struct Row {
    Vector center{0, 0, 0}, u{1, 0, 0}, v{0, 1, 0}, n{0, 0, 1};
    double size_u = 0, size_v = 0, density = 0, limit = 0;
    Color radiance{0, 0, 0};
};

double magnitude(const Color& c) { return (std::abs(c[0]) + std::abs(c[1]) + std::abs(c[2])) / 3; }
Color scaled(const Color& c, double s) { return {c[0] * s, c[1] * s, c[2] * s}; }
Vector unit(Vector v) { return v * (1 / length(v)); }

// What float kernels can compute with: not zero, not infinite, and no denormal, which they flush to zero.
bool is_usable(double x) {
    const double a = std::abs(x);
    return a >= double{std::numeric_limits<float>::min()} && a <= double{std::numeric_limits<float>::max()};
}

std::string refuse_desc(const LightDesc& desc) {
    if (!is_finite(desc.transform)) return "its transform is not finite";
    for (const double e : desc.emission)
        if (!std::isfinite(e)) return "its emission is not finite";
    if (magnitude(desc.emission) == 0) return "it emits nothing";
    return "";
}

std::string refuse_radiance(const Color& radiance) {
    bool emits = false;
    for (const double c : radiance) {
        if (std::abs(c) > double{std::numeric_limits<float>::max()}) return "its radiance is too large for float";
        emits = emits || is_usable(c);
    }
    return emits ? "" : "its radiance is too small for float";
}

void add_row(LightTable& table, LightKind kind, const Row& row, const LightDesc& desc, double power, std::string note) {
    const auto push = [&](double x) { table.rows.push_back(static_cast<float>(x)); };
    for (const Vector& vector : {row.center, row.u, row.v, row.n}) {
        push(vector.x);
        push(vector.y);
        push(vector.z);
    }
    for (const double x : {row.size_u, row.size_v, row.density, row.limit}) push(x);
    for (const double c : row.radiance) push(c);
    push(static_cast<double>(kind));
    const bool is_infinite = kind == LightKind::distant || kind == LightKind::dome;
    (is_infinite ? table.infinite : table.finite).push_back(table.size());
    table.kinds |= 1U << static_cast<std::uint32_t>(kind);
    table.info.push_back({kind, desc.path, desc.visible_to_camera, power, power > 0, std::move(note)});
}

// The common end of all lights with a surface. area in render space; sides: solid angle of emission over pi.
std::string add_area_light(LightTable& table, LightKind kind, Row row, const LightDesc& desc, double area,
                           std::string note) {
    if (!is_usable(area) || !is_usable(1 / area))
        return area > 0 ? "its area is too small or too large for float" : "its area is zero";
    row.radiance = desc.normalize ? scaled(desc.emission, 1 / area) : desc.emission;
    if (std::string reason = refuse_radiance(row.radiance); !reason.empty()) return reason;
    add_row(table, kind, row, desc, magnitude(row.radiance) * area * kPi, std::move(note));
    return "";
}

// The side of a flat light that emits: the image of local -Z, also under a mirroring transform.
Vector emitting_side(const Matrix4& m) {
    const Vector n = cross(row(m, 0), row(m, 1));
    return unit(determinant(m) < 0 ? n : -n);
}

bool nearly_equal(double a, double b) { return std::abs(a - b) <= 1e-5 * std::max(a, b); }

}  // namespace

std::string append_rect(LightTable& table, const RectLightDesc& desc) {
    if (std::string reason = refuse_desc(desc); !reason.empty()) return reason;
    if (!(desc.width > 0 && desc.height > 0)) return "its width or height is zero";
    const Vector u = row(desc.transform, 0) * (desc.width / 2), v = row(desc.transform, 1) * (desc.height / 2);
    const double area = 4 * length(cross(u, v));
    if (!(area > 0)) return "its area is zero";
    Row r{.center = translation(desc.transform), .u = unit(u), .v = unit(v), .n = emitting_side(desc.transform)};
    r.size_u = length(u);
    r.size_v = length(v);
    r.density = 1 / area;
    // float axes are no more orthogonal than this
    const bool is_rectangle = std::abs(dot(r.u, r.v)) < 1e-6;
    r.limit = is_rectangle ? RectLight<float>::kSolidAngleLimit : std::numeric_limits<double>::infinity();
    return add_area_light(table, LightKind::rect, r, desc, area, "");
}

std::string append_disk(LightTable& table, const DiskLightDesc& desc) {
    if (std::string reason = refuse_desc(desc); !reason.empty()) return reason;
    if (!(desc.radius > 0)) return "its radius is zero";
    const Vector a = row(desc.transform, 0) * desc.radius, b = row(desc.transform, 1) * desc.radius;
    const double area = kPi * length(cross(a, b));
    if (!(area > 0)) return "its area is zero";
    // principal axes of the ellipse a cos(t) + b sin(t); a circle, or axes already principal, stay as they are
    const double across = 2 * dot(a, b), along = length_squared(a) - length_squared(b);
    const bool is_principal = std::abs(across) <= 1e-12 * (length_squared(a) + length_squared(b));
    const double angle = is_principal ? 0 : 0.5 * std::atan2(across, along);
    const Vector u = a * std::cos(angle) + b * std::sin(angle), v = b * std::cos(angle) - a * std::sin(angle);
    Row r{.center = translation(desc.transform), .u = unit(u), .v = unit(v), .n = emitting_side(desc.transform)};
    r.size_u = length(u);
    r.size_v = length(v);
    r.density = 1 / area;
    return add_area_light(table, LightKind::disk, r, desc, area, "");
}

std::string append_sphere(LightTable& table, const SphereLightDesc& desc) {
    if (std::string reason = refuse_desc(desc); !reason.empty()) return reason;
    if (!(desc.radius > 0)) return "its radius is zero";
    const double a = length(row(desc.transform, 0)), b = length(row(desc.transform, 1)),
                 c = length(row(desc.transform, 2));
    if (!(std::abs(determinant(desc.transform)) > 0)) return "its transform is singular";
    const bool is_uniform = nearly_equal(a, b) && nearly_equal(b, c);
    Row r{.center = translation(desc.transform)};
    r.size_u = desc.radius * (is_uniform ? a : std::sqrt((a * b + b * c + c * a) / 3));
    return add_area_light(table, LightKind::sphere, r, desc, 4 * kPi * r.size_u * r.size_u,
                          is_uniform ? "" : "non-uniform scale: rendered as a sphere of about the same area");
}

std::string append_cylinder(LightTable& table, const CylinderLightDesc& desc) {
    if (std::string reason = refuse_desc(desc); !reason.empty()) return reason;
    if (!(desc.radius > 0 && desc.length > 0)) return "its radius or length is zero";
    const Vector axis = row(desc.transform, 0), b = row(desc.transform, 1), c = row(desc.transform, 2);
    const double section = std::abs(determinant(desc.transform)) / length(axis);  // scale of the cross-section's area
    if (!(section > 0)) return "its transform is singular";
    const bool is_round = nearly_equal(length(b), length(c)) && nearly_equal(section, length(b) * length(c)) &&
                          std::abs(dot(b, c)) <= 1e-5 * section;
    Row r{.center = translation(desc.transform), .u = unit(axis)};
    r.size_u = desc.radius * std::sqrt(section);
    r.size_v = length(axis) * desc.length / 2;
    return add_area_light(table, LightKind::cylinder, r, desc, 4 * kPi * r.size_u * r.size_v,
                          is_round ? "" : "non-uniform scale: rendered as a round cylinder of the same volume");
}

std::string append_distant(LightTable& table, const DistantLightDesc& desc) {
    if (std::string reason = refuse_desc(desc); !reason.empty()) return reason;
    if (!(desc.angle >= 0)) return "its angle is negative or not a number";
    const Vector towards = row(desc.transform, 2);
    if (!(length_squared(towards) > 0)) return "its transform is singular";
    // UsdLux LightAPI, inputs:normalize: theta_max and sizeFactor
    const double theta = std::min(desc.angle / 2 * kPi / 180, kPi), sin2 = std::sin(theta) * std::sin(theta);
    const double size = theta == 0 ? 1 : kPi * (theta <= kPi / 2 ? sin2 : 2 - sin2);
    const double one_minus_cos = 2 * std::sin(theta / 2) * std::sin(theta / 2);
    Row r;
    r.n = unit(towards);
    const Frame<double> frame = make_frame(r.n);
    r.u = frame.t;
    r.v = frame.b;
    const Color radiance = desc.normalize ? scaled(desc.emission, 1 / size) : desc.emission;
    const bool is_delta = theta < DistantLight<float>::kDeltaAngle;
    r.size_u = is_delta ? 0 : one_minus_cos;
    r.density = is_delta ? 1 : 1 / (2 * kPi * one_minus_cos);
    r.radiance = is_delta ? scaled(radiance, size) : radiance;
    if (std::string reason = refuse_radiance(r.radiance); !reason.empty()) return reason;
    add_row(table, LightKind::distant, r, desc, magnitude(radiance) * size, "");
    return "";
}

std::string append_dome(LightTable& table, const DomeLightDesc& desc) {
    if (std::string reason = refuse_desc(desc); !reason.empty()) return reason;
    const Matrix4& m = desc.transform;
    if (!(std::abs(determinant(m)) > 0)) return "its transform is singular";
    // a rotation, perhaps mirrored: scale and shear do not reach infinity
    Row r;
    r.v = unit(row(m, 1));
    r.u = unit(row(m, 0) - r.v * dot(row(m, 0), r.v));
    r.n = cross(r.u, r.v) * (determinant(m) < 0 ? -1.0 : 1.0);
    PreparedDome dome{.mean = desc.emission,
                      .magnitude = magnitude(desc.emission),
                      .excess = 0,
                      .is_constant = true,
                      .image = {},
                      .note = ""};
    if (desc.image != nullptr) {
        if (desc.width == 0 || desc.height == 0) return "its image is empty";
        if (desc.width > kMaxRowEntries || desc.height > kMaxRowEntries ||
            std::uint64_t{desc.width} * desc.height >= (std::uint64_t{1} << 29))
            return "its image has more than 2^29 texels, or more than 2^20 in one direction";
        dome = prepare_dome(desc.image, desc.width, desc.height, desc.emission, desc.compensate);
    }
    if (!is_usable(dome.magnitude))
        return dome.magnitude > 0 ? "its radiance is out of the range of float" : "its image is black";
    if (dome.is_constant) {
        r.density = 1 / (4 * kPi);
        r.radiance = dome.mean;
        if (std::string reason = refuse_radiance(r.radiance); !reason.empty()) return reason;
    } else {
        table.domes.push_back({table.size(), std::move(dome.image)});
    }
    // Of a compensated dome only the excess over the mean is sampled; one colour has none.
    const double sampled = !desc.compensate ? dome.magnitude : dome.is_constant ? 0 : dome.excess;
    add_row(table, LightKind::dome, r, desc, 4 * kPi * sampled, std::move(dome.note));
    return "";
}

std::string append_triangle(LightTable& table, const TriangleLightDesc& desc) {
    if (std::string reason = refuse_desc(desc); !reason.empty()) return reason;
    const Vector a = desc.corners[1] - desc.corners[0], b = desc.corners[2] - desc.corners[0];
    const Vector normal = cross(a, b);
    const double area = length(normal) / 2;
    if (!(area > 0)) return "its area is zero";
    Row r{.center = desc.corners[0], .u = unit(a), .v = unit(b), .n = unit(normal)};
    r.size_u = length(a);
    r.size_v = length(b);
    r.density = 1 / area;
    // Both sides count for its power, one of them for the area it is normalised by: emission has no normalisation.
    std::string reason = add_area_light(table, LightKind::triangle, r, desc, area, "");
    if (reason.empty()) table.info.back().power *= 2;
    return reason;
}

void finalize(LightTable& table, double scene_radius) {
    const double radius = scene_radius > 0 ? scene_radius : 1;  // an empty scene, or a single point
    for (const std::uint32_t i : table.infinite) table.info[i].power *= kPi * radius * radius;
    double total = 0;
    std::size_t sampled = 0;
    for (const LightInfo& info : table.info) {
        total += info.power;
        sampled += info.sampled ? 1 : 0;
    }
    if (sampled == 0) return;
    // A fifth of the choices is spread evenly: power says nothing of distance, and a faint light close to a surface
    // must not depend on one sample in a million. It costs the brightest light at most a fifth of its samples.
    std::vector<double> weights;
    for (const LightInfo& info : table.info)
        weights.push_back(info.sampled ? 0.8 * info.power / total + 0.2 / static_cast<double>(sampled) : 0.0);
    table.selection = Distribution1D(weights);
}

LightBounds light_bounds(const LightTable& table, std::uint32_t light) {
    const LightRow<double> r = broadcast_row<double>(table, light);
    const auto reach = [&](double u, double v) -> double {  // along one axis, given the components of u and v
        switch (table.info[light].kind) {
            case LightKind::rect:
                return std::abs(u) * r.size_u + std::abs(v) * r.size_v;
            case LightKind::disk:
                return std::sqrt(u * u * r.size_u * r.size_u + v * v * r.size_v * r.size_v);
            case LightKind::sphere:
                return r.size_u;
            case LightKind::cylinder:
                return std::abs(u) * r.size_v + r.size_u * std::sqrt(std::max(0.0, 1 - u * u));
            case LightKind::distant:
            case LightKind::dome:
            case LightKind::triangle:
                break;
        }
        return std::numeric_limits<double>::infinity();
    };
    // wider by the error of the float arithmetic that will look for the surface
    const double scale =
        std::max({std::abs(r.center.x), std::abs(r.center.y), std::abs(r.center.z), r.size_u, r.size_v});
    const auto range = [&](double center, double half) {
        const double pad = scale * 0x1p-20;
        return std::pair{static_cast<float>(center - half - pad), static_cast<float>(center + half + pad)};
    };
    const auto [x0, x1] = range(r.center.x, reach(r.u.x, r.v.x));
    const auto [y0, y1] = range(r.center.y, reach(r.u.y, r.v.y));
    const auto [z0, z1] = range(r.center.z, reach(r.u.z, r.v.z));
    return {{x0, y0, z0}, {x1, y1, z1}};
}

std::array<Vec3<float>, 4> rect_corners(const LightTable& table, std::uint32_t light) {
    const LightRow<double> r = broadcast_row<double>(table, light);
    const auto corner = [&](double a, double b) {
        const Vector p = r.center + r.u * (a * r.size_u) + r.v * (b * r.size_v);
        return Vec3<float>{static_cast<float>(p.x), static_cast<float>(p.y), static_cast<float>(p.z)};
    };
    const double turn = dot(cross(r.u, r.v), r.n) < 0 ? -1 : 1;
    return {corner(-1, -turn), corner(1, -turn), corner(1, turn), corner(-1, turn)};
}

}  // namespace footlight
