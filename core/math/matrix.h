// Double-precision affine transforms in USD's convention: row vectors, p' = p * M, translation in the last row.
#pragma once

#include <array>

#include "math/vec.h"

namespace footlight {

struct Matrix4 {
    std::array<std::array<double, 4>, 4> m{{{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 0}, {0, 0, 0, 1}}};
};

inline Matrix4 operator*(const Matrix4& a, const Matrix4& b) {
    Matrix4 r;
    for (int i = 0; i < 4; ++i)
        for (int j = 0; j < 4; ++j) {
            double sum = 0;
            for (int k = 0; k < 4; ++k) sum += a.m[i][k] * b.m[k][j];
            r.m[i][j] = sum;
        }
    return r;
}

inline Vec3<double> transform_point(const Matrix4& m, Vec3<double> p) {
    return {p.x * m.m[0][0] + p.y * m.m[1][0] + p.z * m.m[2][0] + m.m[3][0],
            p.x * m.m[0][1] + p.y * m.m[1][1] + p.z * m.m[2][1] + m.m[3][1],
            p.x * m.m[0][2] + p.y * m.m[1][2] + p.z * m.m[2][2] + m.m[3][2]};
}

inline Vec3<double> transform_vector(const Matrix4& m, Vec3<double> v) {
    return {v.x * m.m[0][0] + v.y * m.m[1][0] + v.z * m.m[2][0], v.x * m.m[0][1] + v.y * m.m[1][1] + v.z * m.m[2][1],
            v.x * m.m[0][2] + v.y * m.m[1][2] + v.z * m.m[2][2]};
}

inline Vec3<double> translation(const Matrix4& m) { return {m.m[3][0], m.m[3][1], m.m[3][2]}; }
inline Vec3<double> row(const Matrix4& m, int i) { return {m.m[i][0], m.m[i][1], m.m[i][2]}; }

// The same transform seen from a world whose origin is moved to `origin`.
inline Matrix4 relative_to(Matrix4 m, Vec3<double> origin) {
    m.m[3][0] -= origin.x;
    m.m[3][1] -= origin.y;
    m.m[3][2] -= origin.z;
    return m;
}

inline double determinant(const Matrix4& m) { return dot(row(m, 0), cross(row(m, 1), row(m, 2))); }

// Rows of the cofactor matrix: n * cofactor is the direction of the transformed normal, without dividing by the
// determinant, so a mirrored or strongly scaled transform loses nothing.
inline std::array<Vec3<double>, 3> cofactor_rows(const Matrix4& m) {
    return {cross(row(m, 1), row(m, 2)), cross(row(m, 2), row(m, 0)), cross(row(m, 0), row(m, 1))};
}

inline Vec3<double> transform_normal(const std::array<Vec3<double>, 3>& cofactor, Vec3<double> n) {
    return cofactor[0] * n.x + cofactor[1] * n.y + cofactor[2] * n.z;
}

inline bool is_finite(const Matrix4& m) {
    for (const auto& r : m.m)
        for (const double v : r)
            if (!std::isfinite(v)) return false;
    return true;
}

}  // namespace footlight
