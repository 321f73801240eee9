// Tools for the laws of lobes: examples of every lobe, a fold over the list, quadrature, and the chi-squared test of a
// sampler against its density on the sphere.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <string>
#include <type_traits>
#include <vector>

#include "bsdf/ggx.h"
#include "bsdf/lambert.h"
#include "bsdf/lobe.h"
#include "bsdf/mirror.h"
#include "math/lanes.h"
#include "math/statistics.h"

namespace footlight::testing {

using Direction = Vec3<double>;

inline Direction direction_from_cos(double cos, double phi = 0) {
    const double sin = std::sqrt(std::max(1 - cos * cos, 0.0));
    return {sin * std::cos(phi), sin * std::sin(phi), cos};
}
inline Direction direction_from_degrees(double theta) {
    return {std::sin(theta * kPi / 180), 0, std::cos(theta * kPi / 180)};
}

// --- examples: parameters of each lobe that a law must hold for ---
template <class F>
Rgb<F> color(double r, double g, double b) {
    return {number<F>(r), number<F>(g), number<F>(b)};
}
template <class F>
std::vector<Lambert<F>> examples(std::type_identity<Lambert<F>>) {
    return {{color<F>(1, 1, 1)}, {color<F>(0.9, 0.5, 0)}};
}
template <class F>
std::vector<Mirror<F>> examples(std::type_identity<Mirror<F>>) {
    return {{color<F>(1, 1, 1), color<F>(1, 1, 1)}, {color<F>(0.04, 0.5, 0), color<F>(1, 1, 0.3)}};
}
template <class F>
std::vector<GgxReflection<F>> examples(std::type_identity<GgxReflection<F>>) {
    std::vector<GgxReflection<F>> all;
    for (const double alpha : {1e-3, 0.01, 0.1, 0.3, 0.7, 1.0}) {
        all.push_back({color<F>(0.04, 0.9, 1), color<F>(1, 0.5, 1), number<F>(alpha)});
    }
    return all;
}

// Calls visit.operator()<L<double>, L<FloatV>>(oracle, batch, name) for each example of each lobe of the list.
template <class Visit>
void for_each_lobe(Visit visit) {
    const auto visit_lobe = [&]<std::size_t I>(std::integral_constant<std::size_t, I>) {
        const auto oracles = examples(std::type_identity<std::tuple_element_t<I, Lobes<double>>>{});
        const auto batches = examples(std::type_identity<std::tuple_element_t<I, Lobes<FloatV>>>{});
        for (std::size_t k = 0; k < oracles.size(); ++k) {
            visit(oracles[k], batches[k], "lobe " + std::to_string(I) + " example " + std::to_string(k));
        }
    };
    [&]<std::size_t... I>(std::index_sequence<I...>) { (visit_lobe(std::integral_constant<std::size_t, I>{}), ...); }
    (std::make_index_sequence<std::tuple_size_v<Lobes<double>>>{});
}

// --- quadrature ---
struct Reflected {
    Rgb<double> albedo;
    double valid;  // share of samples that leave upwards
};
// Integral of f over wi by the midpoint rule over the unit square of the sampler, which is free of noise; leans on pdf
// and sampler to match, the chi-squared law below. range: of u0; 1/2 where the lobe is symmetric about u0 = 1/2.
template <class F, template <class> class L>
Reflected integrate_albedo(const L<F>& lobe, Direction from, int turns = 64, int depths = 400, double range = 1) {
    const Vec3<F> wo = vector<F>(from);
    F lane_shift(0);  // each lane its own rows of the square
    if constexpr (is_batch<F>) {
        std::array<float, kLanes> shift{};
        for (int k = 0; k < kLanes; ++k) shift[static_cast<std::size_t>(k)] = static_cast<float>(k);
        lane_shift = F::load_unaligned(shift.data());
    }
    Reflected sum{{0, 0, 0}, 0};
    for (int i = 0; i < turns; ++i) {
        Rgb<F> row = gray(F(0));
        F valid(0);
        for (int j = 0; j < depths; j += lanes_of<F>) {
            const F u1 = (lane_shift + number<F>(j + 0.5)) * number<F>(1.0 / depths);
            const LobeSample<F> s = lobe.sample(wo, number<F>((i + 0.5) / turns * range), u1);
            const LobeEval<F> e = lobe.eval(wo, s.wi);
            const Mask<F> good = s.valid & (e.pdf > F(0));
            const F one = select(good, F(1), F(0));
            row = row + e.f * (one / select(good, e.pdf, F(1)));
            valid = valid + one;
        }
        for (int k = 0; k < lanes_of<F>; ++k) {
            sum.albedo = sum.albedo + Rgb<double>{lane(row.r, k), lane(row.g, k), lane(row.b, k)};
            sum.valid += lane(valid, k);
        }
    }
    const double scale = 1.0 / (turns * depths);
    return {sum.albedo * scale, sum.valid * scale};
}

// --- chi-squared on the sphere: a Density is a function of a unit direction [1/sr] ---
// A rectangle of polar coordinates of the upper hemisphere.
struct SphereCell {
    double theta0, theta1, phi0, phi1;
};
struct Polar {
    double theta, phi;
};
inline Polar polar(Direction w) {
    const double phi = std::atan2(w.y, w.x);
    return {std::atan2(std::hypot(w.x, w.y), w.z), phi < 0 ? phi + 2 * kPi : phi};
}

template <class Density>
inline double density_at(const Density& density, double theta, double phi) {
    const double sin = std::sin(theta);
    return sin * density({sin * std::cos(phi), sin * std::sin(phi), std::cos(theta)});
}
// Gauss-Legendre, 5 x 5.
template <class Density>
inline double cell_mass_once(const Density& density, const SphereCell& c) {
    static constexpr double kNode[5] = {-0.9061798459386640, -0.5384693101056831, 0, 0.5384693101056831,
                                        0.9061798459386640};
    static constexpr double kWeight[5] = {0.2369268850561891, 0.4786286704993665, 0.5688888888888889,
                                          0.4786286704993665, 0.2369268850561891};
    const double half_theta = 0.5 * (c.theta1 - c.theta0), half_phi = 0.5 * (c.phi1 - c.phi0);
    double sum = 0;
    for (int i = 0; i < 5; ++i) {
        for (int j = 0; j < 5; ++j) {
            sum += kWeight[i] * kWeight[j] *
                   density_at(density, c.theta0 + half_theta * (1 + kNode[i]), c.phi0 + half_phi * (1 + kNode[j]));
        }
    }
    return sum * half_theta * half_phi;
}
// Adaptive: halves a cell across its worse axis until halving across either changes nothing. Peaks narrower than the
// distance of the nodes may sit at a corner, unseen: a cell that is much denser at its corners than inside is halved
// too.
template <class Density>
inline double cell_mass(const Density& density, const SphereCell& c, double tolerance, double whole, int depth = 0) {
    const double theta = 0.5 * (c.theta0 + c.theta1), phi = 0.5 * (c.phi0 + c.phi1);
    const SphereCell by_theta[2] = {{c.theta0, theta, c.phi0, c.phi1}, {theta, c.theta1, c.phi0, c.phi1}};
    const SphereCell by_phi[2] = {{c.theta0, c.theta1, c.phi0, phi}, {c.theta0, c.theta1, phi, c.phi1}};
    const double theta_mass[2] = {cell_mass_once(density, by_theta[0]), cell_mass_once(density, by_theta[1])};
    const double phi_mass[2] = {cell_mass_once(density, by_phi[0]), cell_mass_once(density, by_phi[1])};
    const double d00 = density_at(density, c.theta0, c.phi0), d01 = density_at(density, c.theta0, c.phi1);
    const double d10 = density_at(density, c.theta1, c.phi0), d11 = density_at(density, c.theta1, c.phi1);
    const double corners = (d00 + d01 + d10 + d11) / 4 * (c.theta1 - c.theta0) * (c.phi1 - c.phi0);
    const double theta_error = std::abs(theta_mass[0] + theta_mass[1] - whole);
    const double phi_error = std::abs(phi_mass[0] + phi_mass[1] - whole);
    const bool agrees = std::max(theta_error, phi_error) <= tolerance;
    const bool hides_peak = corners > 8 * whole + 10 * tolerance;
    if (depth == 40 || (agrees && !hides_peak)) return phi_mass[0] + phi_mass[1];
    const bool halve_theta = agrees
                                 ? std::abs(d00 - d10) + std::abs(d01 - d11) > std::abs(d00 - d01) + std::abs(d10 - d11)
                                 : theta_error > phi_error;
    const SphereCell* halves = halve_theta ? by_theta : by_phi;
    const double* masses = halve_theta ? theta_mass : phi_mass;
    return cell_mass(density, halves[0], tolerance, masses[0], depth + 1) +
           cell_mass(density, halves[1], tolerance, masses[1], depth + 1);
}

// Cells that hold about equally many directions of a pilot run: as fine as the lobe, wherever it points.
class SphereCells {
  public:
    SphereCells(std::vector<Polar> pilot, int depth) : depth_(depth), splits_(std::size_t{1} << depth, 0.0) {
        cells_.resize(std::size_t{1} << depth);
        split(pilot.begin(), pilot.end(), {0, kPi / 2, 0, 2 * kPi}, 1, 0);
    }
    [[nodiscard]] const std::vector<SphereCell>& cells() const { return cells_; }
    [[nodiscard]] std::size_t find(Polar p) const {
        std::size_t node = 1;
        for (int level = 0; level < depth_; ++level) {
            const double x = level % 2 == 0 ? p.theta : p.phi;
            node = 2 * node + (x >= splits_[node] ? 1 : 0);
        }
        return node - cells_.size();
    }

  private:
    void split(std::vector<Polar>::iterator first, std::vector<Polar>::iterator last, SphereCell cell, std::size_t node,
               int level) {
        if (level == depth_) {
            cells_[node - cells_.size()] = cell;
            return;
        }
        const bool by_theta = level % 2 == 0;
        const auto middle = first + (last - first) / 2;
        std::nth_element(first, middle, last,
                         [&](Polar a, Polar b) { return by_theta ? a.theta < b.theta : a.phi < b.phi; });
        const double lo = by_theta ? cell.theta0 : cell.phi0, hi = by_theta ? cell.theta1 : cell.phi1;
        const double at = middle == last ? 0.5 * (lo + hi) : std::clamp(by_theta ? middle->theta : middle->phi, lo, hi);
        splits_[node] = at;
        SphereCell below = cell, above = cell;
        (by_theta ? below.theta1 : below.phi1) = at;
        (by_theta ? above.theta0 : above.phi0) = at;
        split(first, middle, below, 2 * node, level + 1);
        split(middle, last, above, 2 * node + 1, level + 1);
    }

    int depth_;
    std::vector<double> splits_;
    std::vector<SphereCell> cells_;
};

struct DensityTest {
    double p;         // of the samples under the density
    double integral;  // of the density over the hemisphere
    double valid;     // share of samples that were valid
    double samples;
};

// Draws from sample(wo, u0, u1) in lanes, and compares with the density; the failed samples are a cell of their own,
// whose mass is 1 - integral.
template <class Sample, class Density>
DensityTest test_density(const Sample& sample, Direction wo, const Density& density, std::uint32_t seed,
                         int samples = 1 << 19) {
    // Leaves of 8 pilot directions each guide the quadrature to the peaks; 8 leaves together make a cell of the test.
    constexpr int kDepth = 10, kPilot = 1 << 13;
    constexpr std::size_t kLeaves = 8;
    const Vec3<FloatV> wo_lanes = vector<FloatV>(wo);
    Uniform uniform(seed);
    const auto draw = [&](int count, const auto& use) {
        for (int i = 0; i < count; i += kLanes) {
            std::array<float, kLanes> u0, u1;
            for (std::size_t k = 0; k < kLanes; ++k) {  // the same samples whatever the number of lanes
                u0[k] = uniform.next<float>();
                u1[k] = uniform.next<float>();
            }
            const LobeSample<FloatV> s =
                sample(wo_lanes, FloatV::load_unaligned(u0.data()), FloatV::load_unaligned(u1.data()));
            for (int k = 0; k < kLanes; ++k) use(lane_of_mask<FloatV>(s.valid, k), lane(s.wi, k));
        }
    };
    std::vector<Polar> pilot;
    draw(kPilot, [&](bool valid, Direction w) {
        if (valid) pilot.push_back(polar(w));
    });
    const SphereCells cells(pilot, kDepth);
    const std::size_t count = cells.cells().size() / kLeaves;
    std::vector<double> expected(count + 1, 0), observed(count + 1, 0);
    double integral = 0;
    for (std::size_t leaf = 0; leaf < cells.cells().size(); ++leaf) {
        const SphereCell& cell = cells.cells()[leaf];
        const double mass = cell_mass(density, cell, 1e-7, cell_mass_once(density, cell));
        integral += mass;
        expected[leaf / kLeaves] += mass * samples;
    }
    expected[count] = std::max(1 - integral, 0.0) * samples;
    draw(samples, [&](bool valid, Direction w) { ++observed[valid ? cells.find(polar(w)) / kLeaves : count]; });
    return {chi_squared_p(expected, observed), integral, 1 - observed.back() / samples, static_cast<double>(samples)};
}

}  // namespace footlight::testing
