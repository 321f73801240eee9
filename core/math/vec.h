// Vectors and colours over any number type: plain structs, free functions.
#pragma once

#include "math/simd.h"

namespace footlight {

inline constexpr double kPi = 3.14159265358979323846;

template <class F>
struct Vec3 {
    F x, y, z;
};
template <class F>
struct Rgb {
    F r, g, b;
};

template <class F>
inline Vec3<F> operator+(Vec3<F> a, Vec3<F> b) {
    return {a.x + b.x, a.y + b.y, a.z + b.z};
}
template <class F>
inline Vec3<F> operator-(Vec3<F> a, Vec3<F> b) {
    return {a.x - b.x, a.y - b.y, a.z - b.z};
}
template <class F>
inline Vec3<F> operator-(Vec3<F> a) {
    return {-a.x, -a.y, -a.z};
}
template <class F>
inline Vec3<F> operator*(Vec3<F> a, F s) {
    return {a.x * s, a.y * s, a.z * s};
}
template <class F>
inline F dot(Vec3<F> a, Vec3<F> b) {
    return a.x * b.x + a.y * b.y + a.z * b.z;
}
template <class F>
inline Vec3<F> cross(Vec3<F> a, Vec3<F> b) {
    return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
template <class F>
inline F length_squared(Vec3<F> a) {
    return dot(a, a);
}
template <class F>
inline F length(Vec3<F> a) {
    return sqrt(dot(a, a));
}
template <class F>
inline Vec3<F> normalize(Vec3<F> a) {
    return a * (F(1) / length(a));
}
template <class F>
inline Vec3<F> abs(Vec3<F> a) {
    return {abs(a.x), abs(a.y), abs(a.z)};
}
template <class F>
inline F max_component(Vec3<F> a) {
    return max(a.x, max(a.y, a.z));
}
template <class F, class M>
inline Vec3<F> select(M m, Vec3<F> a, Vec3<F> b) {
    return {select(m, a.x, b.x), select(m, a.y, b.y), select(m, a.z, b.z)};
}

template <class F>
inline Rgb<F> operator+(Rgb<F> a, Rgb<F> b) {
    return {a.r + b.r, a.g + b.g, a.b + b.b};
}
template <class F>
inline Rgb<F> operator*(Rgb<F> a, Rgb<F> b) {
    return {a.r * b.r, a.g * b.g, a.b * b.b};
}
template <class F>
inline Rgb<F> operator*(Rgb<F> a, F s) {
    return {a.r * s, a.g * s, a.b * s};
}
template <class F>
inline F max_component(Rgb<F> a) {
    return max(a.r, max(a.g, a.b));
}
template <class F>
inline F mean(Rgb<F> a) {
    return (a.r + a.g + a.b) * F(1.0 / 3.0);
}
template <class F>
inline Rgb<F> gray(F v) {
    return {v, v, v};
}
template <class F, class M>
inline Rgb<F> select(M m, Rgb<F> a, Rgb<F> b) {
    return {select(m, a.r, b.r), select(m, a.g, b.g), select(m, a.b, b.b)};
}

// Widen a float vector to the number type of a kernel: a broadcast for batches, exact for double.
template <class F>
inline Vec3<F> broadcast(Vec3<float> a) {
    return {F(a.x), F(a.y), F(a.z)};
}
template <class F>
inline Rgb<F> broadcast(Rgb<float> a) {
    return {F(a.r), F(a.g), F(a.b)};
}

}  // namespace footlight
