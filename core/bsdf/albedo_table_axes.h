// The axes of the GGX albedo tables, shared by the program that fills them and the lookup.
#pragma once

#include "math/simd.h"

namespace footlight {

inline constexpr int kAlbedoColumns = 48;  // over cos_o
inline constexpr int kAlbedoRows = 48;     // over alpha

// The albedo dips where cos_o ~ alpha, however small: columns go with sqrt(r / (1 + r)), r = cos_o / alpha, brought to
// [0, kAlbedoColumns - 1], rows with alpha. Bilinear error 6e-4; over plain cos_o it is 0.1.
template <class F>
inline F albedo_column(F cos_o, F alpha) {
    return sqrt(fma(cos_o, alpha, cos_o) / (cos_o + alpha)) * F(kAlbedoColumns - 1);
}
template <class F>
inline F albedo_row(F alpha) {
    return alpha * F(kAlbedoRows - 1);
}
inline double albedo_row_alpha(int row) { return row / (kAlbedoRows - 1.0); }
inline double albedo_column_cos(int column, double alpha) {
    const double x = column / (kAlbedoColumns - 1.0);
    return alpha * x * x / (1 + alpha - x * x);
}

// The share of f90 has no such dip, and bends where both are small: columns go with sqrt(cos_o), rows with sqrt(alpha).
template <class F>
inline F schlick_column(F cos_o) {
    return sqrt(cos_o) * F(kAlbedoColumns - 1);
}
template <class F>
inline F schlick_row(F alpha) {
    return sqrt(alpha) * F(kAlbedoRows - 1);
}
inline double schlick_row_alpha(int row) {
    const double y = row / (kAlbedoRows - 1.0);
    return y * y;
}
inline double schlick_column_cos(int column) {
    const double x = column / (kAlbedoColumns - 1.0);
    return x * x;
}

}  // namespace footlight
