// Laws of bsdf/ggx_distribution.h: density for tiny alpha, masking at grazing incidence, visible normals at every edge.
#include "bsdf/ggx_distribution.h"

#include <gtest/gtest.h>

#include <numbers>

#include "bsdf/lobe_testing.h"

namespace footlight::testing {
namespace {

// --- density of normals ---
using FloatD = float (*)(Vec3<float> h, float alpha);

float vector_form(Vec3<float> h, float alpha) { return ggx_d(h, dot(h, h), alpha); }
float scaled_vector_form(Vec3<float> h, float alpha) { return vector_form(h * 1.7F, alpha); }
// The mutant: cancels in c^2 (a^2 - 1) + 1. Walter et al. 2007, eq. 33, as usually coded.
float cosine_form(Vec3<float> h, float alpha) {
    const float t = h.z * h.z * (alpha * alpha - 1) + 1;
    return alpha * alpha / (static_cast<float>(kPi) * t * t);
}

double worst_d_error(FloatD d) {
    double worst = 0;
    for (const double alpha : {1.0, 0.3, 0.1, 0.01, 1e-3, 1e-4, 1e-5}) {
        for (double k = 0.1; k < 10; k *= 1.1) {
            const double theta = std::min(k * alpha, 1.5);
            const Vec3<float> h = vector<float>({std::sin(theta) * 0.6, std::sin(theta) * 0.8, std::cos(theta)});
            const float a = static_cast<float>(alpha);
            const long double sin2 = static_cast<long double>(h.x) * h.x + static_cast<long double>(h.y) * h.y;
            const long double cos2 = static_cast<long double>(h.z) * h.z, a2 = static_cast<long double>(a) * a;
            const long double n = sin2 + cos2, q = sin2 / a2 + cos2;
            const long double exact = n * n / (std::numbers::pi_v<long double> * a2 * q * q);
            const double error = static_cast<double>(std::abs(d(h, a) / exact - 1));
            worst = std::max(worst, std::isfinite(error) ? error : 1e30);
        }
    }
    return worst;
}

TEST(GgxDistribution, DensityHoldsForTinyAlpha) {
    EXPECT_LE(worst_d_error(vector_form), 1e-5);
    EXPECT_LE(worst_d_error(scaled_vector_form), 1e-5) << "h need not be of unit length";
    EXPECT_GT(worst_d_error(cosine_form), 0.1) << "the mutant passed";
}

// --- masking ---
using FloatG1 = float (*)(Vec3<float> w, float alpha);

// The mutant: overflows in tan^2.
float g1_by_tangent(Vec3<float> w, float alpha) {
    const float tan2 = (w.x * w.x + w.y * w.y) / (w.z * w.z);
    return 2 / (1 + std::sqrt(1 + alpha * alpha * tan2));
}

double worst_g1_error(FloatG1 g1) {
    double worst = 0;
    for (const double alpha : {1.0, 0.1, 1e-2, 1e-4}) {
        for (double cos = 1; cos > 1e-20; cos *= 0.1) {
            const Vec3<float> w = vector<float>(direction_from_cos(cos));
            const float a = static_cast<float>(alpha);
            const long double x = w.x, z = w.z;
            const long double exact = 2 * z / (z + std::sqrt(static_cast<long double>(a) * a * x * x + z * z));
            const float g = g1(w, a);
            if (!(g >= 0 && g <= 1)) return 1e30;
            worst = std::max(worst, static_cast<double>(std::abs(g / exact - 1)));
        }
    }
    return worst;
}

TEST(GgxDistribution, MaskingHoldsAtGrazingIncidence) {
    EXPECT_LE(worst_g1_error(ggx_g1<float>), 1e-5);
    EXPECT_GT(worst_g1_error(g1_by_tangent), 0.5) << "the mutant passed";
}

// --- visible normals ---
using HalfSampler = Vec3<float> (*)(Vec3<float> wo, float alpha, float u0, float u1);

Vec3<float> cap_lanes(Vec3<float> wo, float alpha, float u0, float u1) {
    const Vec3<FloatV> w{FloatV(wo.x), FloatV(wo.y), FloatV(wo.z)};
    const Vec3<FloatV> h = ggx_sample_half(w, FloatV(alpha), FloatV(u0), FloatV(u1));
    return {h.x.get(0), h.y.get(0), h.z.get(0)};
}
// The mutant: the square root of 1 - t1^2 - t2^2 without a guard. Heitz 2018, listing 1.
Vec3<float> heitz_2018(Vec3<float> wo, float alpha, float u0, float u1) {
    const Vec3<float> v = normalize(Vec3<float>{alpha * wo.x, alpha * wo.y, wo.z});
    const float xy = v.x * v.x + v.y * v.y;
    const Vec3<float> t1 = xy > 0 ? Vec3<float>{-v.y, v.x, 0} * (1 / std::sqrt(xy)) : Vec3<float>{1, 0, 0};
    const Vec3<float> t2 = cross(v, t1);
    const float r = std::sqrt(u1), phi = static_cast<float>(2 * kPi) * u0;
    const float a = r * std::cos(phi), s = 0.5F * (1 + v.z);
    const float b = (1 - s) * std::sqrt(1 - a * a) + s * r * std::sin(phi);
    const Vec3<float> n = t1 * a + t2 * b + v * std::sqrt(1 - a * a - b * b);
    return {alpha * n.x, alpha * n.y, n.z};
}

int bad_half_vectors(HalfSampler sample) {
    std::vector<float> edge{0, 0x1p-24F, 0x1p-12F, 0.25F, 0.5F, 0.75F, 1 - 0x1p-12F, 1 - 0x1p-23F, 1 - 0x1p-24F};
    Uniform uniform(11);
    for (int i = 0; i < 60; ++i) edge.push_back(uniform.next<float>());
    int bad = 0;
    for (const float alpha : {1.0F, 0.1F, 1e-2F, 1e-4F, 1e-6F}) {
        for (const double cos : {1.0, 0.5, 0.1, 1e-2, 1e-3, 1e-4, 1e-6, 1e-8, 0.0}) {
            for (const double phi : {0.0, 1.0, kPi, -2.0}) {
                const Vec3<float> wo = vector<float>(direction_from_cos(cos, phi));
                for (const float u0 : edge) {
                    for (const float u1 : edge) {
                        const Vec3<float> h = sample(wo, alpha, u0, u1);
                        const Vec3<float> unit = normalize(h);
                        const bool good =
                            h.z > 0 && std::abs(length(lane(unit, 0)) - 1) < 1e-6 && std::isfinite(reflect(wo, h).z);
                        bad += good ? 0 : 1;
                    }
                }
            }
        }
    }
    return bad;
}

TEST(GgxDistribution, VisibleNormalsAreGoodAtEveryEdge) {
    EXPECT_EQ(bad_half_vectors(ggx_sample_half<float>), 0);
    EXPECT_EQ(bad_half_vectors(cap_lanes), 0);
    EXPECT_GT(bad_half_vectors(heitz_2018), 0) << "the mutant passed";
}

// --- the bounded cap ---
LobeSample<FloatV> sample_single(Vec3<FloatV> wo, double alpha, FloatV u0, FloatV u1) {
    const Vec3<FloatV> wi = reflect(wo, ggx_sample_half(wo, number<FloatV>(alpha), u0, u1));
    return {wi, wi.z > FloatV(0)};
}
// The mutant: the density of the unbounded cap, D G1 / (4 cos_o).
double unbounded_pdf(Direction wo, Direction wi, double alpha) {
    const Direction h = wo + wi;
    return ggx_d(h, dot(h, h), alpha) * ggx_g1(wo, alpha) / (4 * wo.z);
}

TEST(GgxDistribution, CapIsBoundedAndItsDensityKnowsIt) {
    for (const double degrees : {0.0, 60.0, 85.0}) {
        SCOPED_TRACE(degrees);
        const Direction wo = normalize(lane(vector<float>(direction_from_degrees(degrees)), 0));
        const auto sample = [&](auto w, auto u0, auto u1) { return sample_single(w, 0.8, u0, u1); };
        const auto pdf = [&](Direction wi) { return ggx_single_scattering(wo, wi, 0.8).pdf; };
        EXPECT_GT(test_density(sample, wo, pdf, 1).p, sidak_level(3));
        const auto mutant = [&](Direction wi) { return unbounded_pdf(wo, wi, 0.8); };
        EXPECT_LT(test_density(sample, wo, mutant, 1).p, 1e-10) << "the mutant passed";
    }
}

TEST(GgxDistribution, NoSampleIsLostAtNormalIncidence) {
    const Direction up{0, 0, 1};
    const auto sample = [&](auto w, auto u0, auto u1) { return sample_single(w, 1.0, u0, u1); };
    const auto pdf = [&](Direction wi) { return ggx_single_scattering(up, wi, 1.0).pdf; };
    const DensityTest t = test_density(sample, up, pdf, 1);
    EXPECT_GT(t.valid, 0.9999);
    EXPECT_NEAR(t.integral, 1, 1e-4);
    const auto mutant = [&](Direction wi) { return unbounded_pdf(up, wi, 1.0); };
    EXPECT_NEAR(test_density(sample, up, mutant, 1).integral, 0.5, 1e-3) << "the unbounded cap loses half";
}

// --- single scattering ---
// Independent of the shared divisions: D G2 / (4 cos_o) by Smith's Lambda, in long double.
long double textbook_f(Direction wo, Direction wi, long double alpha) {
    const auto lambda = [&](Direction w) {
        const long double tan2 = (static_cast<long double>(w.x) * w.x + static_cast<long double>(w.y) * w.y) /
                                 (static_cast<long double>(w.z) * w.z);
        return (std::sqrt(1 + alpha * alpha * tan2) - 1) / 2;
    };
    const long double x = static_cast<long double>(wo.x) + wi.x, y = static_cast<long double>(wo.y) + wi.y;
    const long double z = static_cast<long double>(wo.z) + wi.z, n = x * x + y * y + z * z;
    const long double q = (x * x + y * y) / (alpha * alpha) + z * z;
    const long double d = n * n / (std::numbers::pi_v<long double> * alpha * alpha * q * q);
    return d / (1 + lambda(wo) + lambda(wi)) / (4 * static_cast<long double>(wo.z));
}

TEST(GgxDistribution, SingleScatteringIsTheTextbookFormula) {
    Uniform uniform(12);
    for (const float alpha : {1.0F, 0.3F, 0.01F, 1e-3F, 1e-4F}) {
        for (int i = 0; i < 20000; ++i) {
            const float z = std::max(uniform.next<float>(), 1e-3F);
            const Vec3<float> wo = vector<float>(direction_from_cos(z, 6.28 * uniform.next<double>()));
            const float u0 = uniform.next<float>();
            const Vec3<float> wi = reflect(wo, ggx_sample_half(wo, alpha, u0, uniform.next<float>()));
            if (wi.z <= 0) continue;
            const GgxSingle<float> single = ggx_single_scattering(wo, wi, alpha);
            const double exact = static_cast<double>(textbook_f(lane(wo, 0), lane(wi, 0), alpha));
            ASSERT_NEAR(single.f / exact, 1, 1e-5) << alpha << " " << z;
            const double pdf_ratio = single.f / single.pdf;  // the weight is bounded: no fireflies
            ASSERT_GE(pdf_ratio, 0);
            ASSERT_LE(pdf_ratio, 1 + 1e-5);
        }
    }
}

}  // namespace
}  // namespace footlight::testing
