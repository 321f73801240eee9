// Lookup of what single-scattering GGX reflects in all: its albedo at Fresnel 1, and the share of it that follows f90.
// Bilinear, from tables integrated in double at build time by albedo_table_gen.cpp.
#pragma once

#include "bsdf/albedo_table_axes.h"
#include "bsdf/albedo_table_data.h"
#include "math/simd.h"

namespace footlight {

// Each word holds two neighbouring columns as 16-bit fractions, low half first: two gathers in place of four, which is
// half the cost of a lookup (a gather of 16 lanes takes 9 cycles, all else about 20). Resolution 1.5e-5.
template <class F>
inline F albedo_table_lookup(const std::uint32_t* table, F column, F row) {
    const F left = min(floor(column), F(kAlbedoColumns - 2));
    const F top = min(floor(row), F(kAlbedoRows - 2));
    const UInt<F> index = to_uint(fma(top, F(kAlbedoColumns - 1), left));
    const auto between = [&](UInt<F> word) {
        const F a = to_number<F>(word & UInt<F>(0xffffU));
        const F b = to_number<F>(word >> 16);
        return fma(column - left, b - a, a);
    };
    const F upper = between(gather_uint<F>(table, index));
    const F lower = between(gather_uint<F>(table + kAlbedoColumns - 1, index));
    return fma(row - top, lower - upper, upper) * F(1.0 / 0xffff);
}

// E: integral of f over wi at Fresnel 1. cos_o is clamped to [0, 1]; alpha in [kGgxMinAlpha, 1].
template <class F>
inline F ggx_albedo(F cos_o, F alpha) {
    const F cos = clamp(cos_o, F(0), F(1));
    return albedo_table_lookup(kGgxAlbedo, albedo_column(cos, alpha), albedo_row(alpha));
}

// Mean Schlick weight of the reflected light: f0, f90 reflect E (f0 + (f90 - f0) share). The table holds its fifth
// root, which is nearly a straight line.
template <class F>
inline F ggx_schlick_share(F cos_o, F alpha) {
    const F cos = clamp(cos_o, F(0), F(1));
    const F root = albedo_table_lookup(kGgxSchlickRoot, schlick_column(cos), schlick_row(alpha));
    const F root2 = root * root;
    return root2 * root2 * root;
}

}  // namespace footlight
