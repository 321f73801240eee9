// An independent brute-force path tracer in double precision: what the renderer's kernels and images are compared with.
//
// It shares no line and no idea with core/: no next-event estimation, no MIS, no Russian roulette, no Embree, no SIMD,
// its own random numbers, normals of the distribution instead of visible normals. Light is found by chance alone.
// Conventions: directions point away from the surface, lengths in scene units, radiance in any unit, normals point out
// of spheres and towards u x v of a quad. Surfaces scatter on both sides and emit on the side of the normal only.
#pragma once

#include <array>
#include <cmath>
#include <cstdint>
#include <functional>
#include <limits>
#include <numbers>
#include <optional>
#include <variant>
#include <vector>

namespace brute_force {

inline constexpr double pi = std::numbers::pi;
inline constexpr double infinity = std::numeric_limits<double>::infinity();

// --- vectors; also colours, component by component ---

struct Vec {
    double x = 0, y = 0, z = 0;
};

inline Vec operator+(Vec a, Vec b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
inline Vec operator-(Vec a, Vec b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
inline Vec operator-(Vec a) { return {-a.x, -a.y, -a.z}; }
inline Vec operator*(Vec a, Vec b) { return {a.x * b.x, a.y * b.y, a.z * b.z}; }
inline Vec operator*(Vec a, double s) { return {a.x * s, a.y * s, a.z * s}; }
inline Vec operator*(double s, Vec a) { return a * s; }
inline Vec operator/(Vec a, double s) { return {a.x / s, a.y / s, a.z / s}; }
inline double dot(Vec a, Vec b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline Vec cross(Vec a, Vec b) { return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x}; }
inline double length(Vec a) { return std::sqrt(dot(a, a)); }
inline Vec normalize(Vec a) { return a / length(a); }
inline bool is_black(Vec a) { return a.x == 0 && a.y == 0 && a.z == 0; }

// --- random numbers: xoshiro256++ of Blackman and Vigna, seeded by splitmix64; 53 bits each ---

class Random {
  public:
    explicit Random(std::uint64_t seed) {
        for (auto& word : state_) {
            seed += 0x9e3779b97f4a7c15u;
            std::uint64_t z = seed;
            z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
            z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
            word = z ^ (z >> 31);
        }
    }

    // Uniform in [0, 1).
    double next() {
        auto rotate = [](std::uint64_t x, int k) { return (x << k) | (x >> (64 - k)); };
        const std::uint64_t result = rotate(state_[0] + state_[3], 23) + state_[0];
        const std::uint64_t t = state_[1] << 17;
        state_[2] ^= state_[0];
        state_[3] ^= state_[1];
        state_[1] ^= state_[2];
        state_[0] ^= state_[3];
        state_[2] ^= t;
        state_[3] = rotate(state_[3], 45);
        return static_cast<double>(result >> 11) * 0x1p-53;
    }

  private:
    std::array<std::uint64_t, 4> state_{};
};

// --- estimates ---

// A mean with its standard error, per channel.
struct Estimate {
    Vec mean, standard_error;
};

// Welford's sums: the difference of large squares never appears.
class Accumulator {
  public:
    void add(Vec value) {
        ++count_;
        const Vec before = value - mean_;
        mean_ = mean_ + before / static_cast<double>(count_);
        squares_ = squares_ + before * (value - mean_);
    }

    Estimate result() const {
        const double n = static_cast<double>(count_);
        const Vec variance = squares_ / (n * (n - 1));
        return {mean_, {std::sqrt(variance.x), std::sqrt(variance.y), std::sqrt(variance.z)}};
    }

  private:
    std::int64_t count_ = 0;
    Vec mean_, squares_;
};

// Standard deviations between an estimate and the truth, of the worst channel; exact agreement is 0 even without noise.
inline double z_score(const Estimate& estimate, Vec truth) {
    auto z = [](double mean, double error, double expected) {
        const double rounding = 1e-12 * std::max(std::abs(mean), std::abs(expected));
        const double difference = std::abs(mean - expected);
        return difference <= rounding ? 0.0 : difference / std::max(error, rounding);
    };
    return std::max({z(estimate.mean.x, estimate.standard_error.x, truth.x),
                     z(estimate.mean.y, estimate.standard_error.y, truth.y),
                     z(estimate.mean.z, estimate.standard_error.z, truth.z)});
}

// --- local frames and directions; the local normal is +Z ---

struct Frame {
    Vec s, t, n;

    explicit Frame(Vec normal) : n(normal) {
        // The axis least aligned with the normal gives a well-conditioned cross product.
        const Vec a{std::abs(n.x), std::abs(n.y), std::abs(n.z)};
        const Vec axis = a.x <= a.y && a.x <= a.z ? Vec{1, 0, 0} : a.y <= a.z ? Vec{0, 1, 0} : Vec{0, 0, 1};
        s = normalize(cross(n, axis));
        t = cross(n, s);
    }

    Vec to_local(Vec v) const { return {dot(v, s), dot(v, t), dot(v, n)}; }
    Vec to_world(Vec v) const { return s * v.x + t * v.y + n * v.z; }
};

inline Vec from_polar(double cosine, double azimuth) {
    const double sine = std::sqrt(std::max(0.0, 1 - cosine * cosine));
    return {sine * std::cos(azimuth), sine * std::sin(azimuth), cosine};
}

// Density cos/pi.
inline Vec cosine_direction(Random& random) { return from_polar(std::sqrt(1 - random.next()), 2 * pi * random.next()); }

// --- materials ---

struct Lambert {
    Vec reflectance{0.5, 0.5, 0.5};
};

// Single scattering by GGX facets: Schlick's Fresnel, Smith's height-correlated shadowing, no energy compensation.
struct Ggx {
    Vec f0{1, 1, 1}, f90{1, 1, 1};
    double alpha = 0.5;
};

struct Mirror {
    Vec f0{1, 1, 1}, f90{1, 1, 1};
};

struct Black {};

using Scattering = std::variant<Black, Lambert, Ggx, Mirror>;

struct Material {
    Scattering scattering = Black{};
    Vec emission;
};

inline Vec schlick(Vec f0, Vec f90, double cosine) { return f0 + (f90 - f0) * std::pow(1 - cosine, 5); }

inline double ggx_density(double alpha, Vec h) {
    const double slope = h.x * h.x + h.y * h.y + alpha * alpha * h.z * h.z;
    return alpha * alpha / (pi * slope * slope);
}

inline double ggx_lambda(double alpha, Vec w) {
    return (std::sqrt(1 + alpha * alpha * (w.x * w.x + w.y * w.y) / (w.z * w.z)) - 1) / 2;
}

// The BRDF [1/sr] times |cos| of the incoming direction; both directions above the surface. Zero for a mirror.
inline Vec evaluate(const Scattering& scattering, Vec wo, Vec wi) {
    if (wo.z <= 0 || wi.z <= 0) return {};
    if (const auto* lambert = std::get_if<Lambert>(&scattering)) return lambert->reflectance * (wi.z / pi);
    if (const auto* ggx = std::get_if<Ggx>(&scattering)) {
        const Vec h = normalize(wo + wi);
        const double shadowing = 1 / (1 + ggx_lambda(ggx->alpha, wo) + ggx_lambda(ggx->alpha, wi));
        return schlick(ggx->f0, ggx->f90, dot(wo, h)) * (ggx_density(ggx->alpha, h) * shadowing / (4 * wo.z));
    }
    return {};
}

// A direction and f |cos| / pdf; nothing when the path is absorbed.
struct Scattered {
    Vec wi, weight;
};

inline std::optional<Scattered> scatter(const Scattering& scattering, Vec wo, Random& random) {
    if (const auto* lambert = std::get_if<Lambert>(&scattering)) {
        return Scattered{cosine_direction(random), lambert->reflectance};
    }
    if (const auto* mirror = std::get_if<Mirror>(&scattering)) {
        return Scattered{{-wo.x, -wo.y, wo.z}, schlick(mirror->f0, mirror->f90, wo.z)};
    }
    if (const auto* ggx = std::get_if<Ggx>(&scattering)) {
        // Walter 2007, eqs. 35 and 36: facets by D cos, whatever is visible.
        const double u = random.next();
        const double cosine = std::sqrt((1 - u) / (1 + (ggx->alpha * ggx->alpha - 1) * u));
        const Vec h = from_polar(cosine, 2 * pi * random.next());
        const double along = dot(wo, h);
        const Vec wi = 2 * along * h - wo;
        const double pdf = ggx_density(ggx->alpha, h) * h.z / (4 * along);
        if (along <= 0 || wi.z <= 0 || !(pdf > 0)) return std::nullopt;
        return Scattered{wi, evaluate(scattering, wo, wi) / pdf};
    }
    return std::nullopt;
}

// --- shapes ---

struct Ray {
    Vec origin, direction;
    Vec at(double t) const { return origin + direction * t; }
};

struct Sphere {
    Vec centre;
    double radius = 1;
};

// The plane through a point, infinite.
struct Plane {
    Vec point, normal{0, 0, 1};
};

// Points corner + a u + b v with a and b in [0, 1].
struct Quad {
    Vec corner, u, v;
};

struct Disk {
    Vec centre, normal{0, 0, 1};
    double radius = 1;
};

struct Triangle {
    Vec a, b, c;
};

using Shape = std::variant<Sphere, Plane, Quad, Disk, Triangle>;

// A crossing at distance t > nearest along the ray, with the unit normal there.
struct Crossing {
    double t;
    Vec normal;
};

inline std::optional<Crossing> cross_plane(Ray ray, Vec point, Vec normal, double nearest) {
    const double rate = dot(ray.direction, normal);
    if (rate == 0) return std::nullopt;
    const double t = dot(point - ray.origin, normal) / rate;
    if (!(t > nearest)) return std::nullopt;
    return Crossing{t, normal};
}

inline std::optional<Crossing> intersect(const Sphere& sphere, Ray ray, double nearest) {
    const Vec to_centre = sphere.centre - ray.origin;
    const double closest = dot(to_centre, ray.direction);
    const Vec off_axis = to_centre - ray.direction * closest;
    const double inside = sphere.radius * sphere.radius - dot(off_axis, off_axis);
    if (inside < 0) return std::nullopt;
    const double half = std::sqrt(inside);
    for (const double t : {closest - half, closest + half}) {
        if (t > nearest) return Crossing{t, (ray.at(t) - sphere.centre) / sphere.radius};
    }
    return std::nullopt;
}

inline std::optional<Crossing> intersect(const Plane& plane, Ray ray, double nearest) {
    return cross_plane(ray, plane.point, plane.normal, nearest);
}

inline std::optional<Crossing> intersect(const Quad& quad, Ray ray, double nearest) {
    const Vec area = cross(quad.u, quad.v);
    const auto crossing = cross_plane(ray, quad.corner, normalize(area), nearest);
    if (!crossing) return std::nullopt;
    const Vec p = ray.at(crossing->t) - quad.corner;
    const double a = dot(cross(p, quad.v), area) / dot(area, area);
    const double b = dot(cross(quad.u, p), area) / dot(area, area);
    return a >= 0 && a <= 1 && b >= 0 && b <= 1 ? crossing : std::nullopt;
}

inline std::optional<Crossing> intersect(const Disk& disk, Ray ray, double nearest) {
    const auto crossing = cross_plane(ray, disk.centre, disk.normal, nearest);
    if (!crossing || length(ray.at(crossing->t) - disk.centre) > disk.radius) return std::nullopt;
    return crossing;
}

inline std::optional<Crossing> intersect(const Triangle& triangle, Ray ray, double nearest) {
    const Vec u = triangle.b - triangle.a, v = triangle.c - triangle.a, area = cross(u, v);
    const auto crossing = cross_plane(ray, triangle.a, normalize(area), nearest);
    if (!crossing) return std::nullopt;
    const Vec p = ray.at(crossing->t) - triangle.a;
    const double a = dot(cross(p, v), area) / dot(area, area);
    const double b = dot(cross(u, p), area) / dot(area, area);
    return a >= 0 && b >= 0 && a + b <= 1 ? crossing : std::nullopt;
}

// --- scenes ---

struct Object {
    Shape shape;
    Material material;
};

struct Scene {
    std::vector<Object> objects;
    std::function<Vec(Vec)> environment = [](Vec) { return Vec{}; };  // radiance from a unit direction
};

struct Hit {
    double t;
    Vec position, normal;
    const Material* material;
};

// The first surface after `nearest`. Every object is asked: there is no tree that could be wrong.
inline std::optional<Hit> closest(const Scene& scene, Ray ray, double nearest) {
    std::optional<Hit> result;
    for (const Object& object : scene.objects) {
        const auto crossing =
            std::visit([&](const auto& shape) { return intersect(shape, ray, nearest); }, object.shape);
        if (crossing && (!result || crossing->t < result->t)) {
            result = Hit{crossing->t, ray.at(crossing->t), crossing->normal, &object.material};
        }
    }
    return result;
}

// A start this far along a scattered ray clears the rounding of the point it left: 1e-9 of the distance travelled, at a
// precision of 1e-16. Scenes for this tracer have no gaps that small.
inline double clearance(double travelled) { return 1e-9 * travelled; }

// Radiance towards ray.origin along paths of at most max_edges edges, the one to the first hit included. What a longer
// path would have carried is lost, as it is in a renderer with that depth.
inline Vec radiance(const Scene& scene, Ray ray, int max_edges, Random& random) {
    Vec total, throughput{1, 1, 1};
    double nearest = 0;
    for (int edge = 1; edge <= max_edges; ++edge) {
        const auto hit = closest(scene, ray, nearest);
        if (!hit) return total + throughput * scene.environment(ray.direction);
        const bool front = dot(ray.direction, hit->normal) < 0;
        if (front) total = total + throughput * hit->material->emission;
        const Frame frame(front ? hit->normal : -hit->normal);
        const auto next = scatter(hit->material->scattering, frame.to_local(-ray.direction), random);
        if (!next) return total;
        throughput = throughput * next->weight;
        if (is_black(throughput)) return total;
        ray = {hit->position, frame.to_world(next->wi)};
        nearest = clearance(hit->t);
    }
    return total;
}

inline Estimate mean_radiance(const Scene& scene, Ray ray, int max_edges, int samples, std::uint64_t seed) {
    Random random(seed);
    Accumulator sum;
    for (int k = 0; k < samples; ++k) sum.add(radiance(scene, ray, max_edges, random));
    return sum.result();
}

// Irradiance on a point that no object needs to hold, by cosine-distributed rays.
inline Estimate irradiance(const Scene& scene, Vec point, Vec normal, int max_edges, int samples, std::uint64_t seed) {
    Random random(seed);
    const Frame frame(normal);
    Accumulator sum;
    for (int k = 0; k < samples; ++k) {
        const Ray ray{point, frame.to_world(cosine_direction(random))};
        sum.add(pi * radiance(scene, ray, max_edges, random));
    }
    return sum.result();
}

// Reflected part of unit illumination from everywhere: the directional albedo.
inline Estimate albedo(const Scattering& scattering, double cosine, int samples, std::uint64_t seed) {
    Random random(seed);
    const Vec wo = from_polar(cosine, 0);
    Accumulator sum;
    for (int k = 0; k < samples; ++k) {
        const auto next = scatter(scattering, wo, random);
        sum.add(next ? next->weight : Vec{});
    }
    return sum.result();
}

// --- a pinhole camera at the origin of its frame, looking along -Z with +Y up ---

struct Camera {
    Vec position, right{1, 0, 0}, up{0, 1, 0}, back{0, 0, 1};
    double half_width = 0.5, half_height = 0.5;  // of the image plane at distance 1
    int width = 1, height = 1;                   // [pixels]
};

// The mean of a pixel under a box filter; row 0 is the top.
inline Estimate pixel(const Scene& scene, const Camera& camera, int column, int row, int max_edges, int samples,
                      std::uint64_t seed) {
    Random random(seed ^ (static_cast<std::uint64_t>(row) * static_cast<std::uint64_t>(camera.width) +
                          static_cast<std::uint64_t>(column) + 1) *
                             0xd1342543de82ef95u);
    Accumulator sum;
    for (int k = 0; k < samples; ++k) {
        const double x = 2 * (column + random.next()) / camera.width - 1;
        const double y = 1 - 2 * (row + random.next()) / camera.height;
        const Vec direction =
            camera.right * (x * camera.half_width) + camera.up * (y * camera.half_height) - camera.back;
        sum.add(radiance(scene, {camera.position, normalize(direction)}, max_edges, random));
    }
    return sum.result();
}

}  // namespace brute_force
