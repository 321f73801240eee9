// Build-time program: integrates the GGX albedo table in double and writes it as a header to the path in argv[1].
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <vector>

#include "bsdf/albedo_table_axes.h"
#include "bsdf/fresnel.h"
#include "bsdf/ggx_distribution.h"

namespace {

using namespace footlight;

struct Reflected {
    double albedo = 0;        // at Fresnel 1
    double schlick_root = 0;  // fifth root of the mean Schlick weight
};

// Midpoint rule over the unit square of visible normals; the lobe is symmetric in u0 about 1/2.
Reflected integrate(double cos_o, double alpha) {
    constexpr int kTurns = 48, kDepths = 384;
    const Vec3<double> wo{std::sqrt(1 - cos_o * cos_o), 0, cos_o};
    double all = 0, grazing = 0;
    for (int i = 0; i < kTurns; ++i) {
        for (int j = 0; j < kDepths; ++j) {
            const Vec3<double> h = ggx_sample_half(wo, alpha, (i + 0.5) / (2 * kTurns), (j + 0.5) / kDepths);
            const GgxSingle<double> single = ggx_single_scattering(wo, reflect(wo, h), alpha);
            if (single.pdf <= 0) continue;
            const double weight = single.f / single.pdf;
            all += weight;
            grazing += weight * schlick_weight(single.cos_d);
        }
    }
    return {all / (kTurns * kDepths), std::pow(grazing / all, 0.2)};
}

// value(row, column) for each pair of neighbouring columns, as 16-bit fractions; the left one in the low half.
template <class Value>
void write_table(std::ostream& out, const char* name, Value value) {
    out << "inline constexpr std::uint32_t " << name << "[] = {\n";
    for (int row = 0; row < kAlbedoRows; ++row) {
        std::vector<std::uint32_t> fractions;
        for (int column = 0; column < kAlbedoColumns; ++column) {
            fractions.push_back(
                static_cast<std::uint32_t>(std::lround(std::clamp(value(row, column), 0.0, 1.0) * 0xffff)));
        }
        for (int column = 0; column + 1 < kAlbedoColumns; ++column) {
            out << "0x" << std::hex << (fractions[column] | fractions[column + 1] << 16) << std::dec
                << (column + 2 < kAlbedoColumns ? "," : ",\n");
        }
    }
    out << "};\n";
}

}  // namespace

int main(int argc, char** argv) {
    if (argc != 2) {
        std::cerr << "usage: albedo_table_gen OUTPUT_HEADER\n";
        return 2;
    }
    const std::filesystem::path path = argv[1];
    if (path.has_parent_path()) std::filesystem::create_directories(path.parent_path());
    std::ofstream out(path);
    out << "// Directional albedo of single-scattering GGX, integrated by albedo_table_gen.cpp.\n"
           "#pragma once\n\n#include <cstdint>\n\nnamespace footlight {\n\n";
    // The limit at grazing incidence is taken a little above it, where every visible normal still reflects.
    constexpr double kGrazing = 1e-7;
    write_table(out, "kGgxAlbedo", [&](int row, int column) {
        const double alpha = std::max(albedo_row_alpha(row), kGgxMinAlpha);
        return integrate(std::clamp(albedo_column_cos(column, alpha), kGrazing * alpha, 1.0), alpha).albedo;
    });
    write_table(out, "kGgxSchlickRoot", [&](int row, int column) {
        const double alpha = std::max(schlick_row_alpha(row), kGgxMinAlpha);
        return integrate(std::max(schlick_column_cos(column), kGrazing), alpha).schlick_root;
    });
    out << "\n}  // namespace footlight\n";
    out.close();
    if (!out) {
        std::cerr << "albedo_table_gen: cannot write " << path << "\n";
        return 1;
    }
    return 0;
}
