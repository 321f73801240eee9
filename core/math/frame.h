// An orthonormal frame around a normal, to bring directions into the local shading space (normal +Z) and back.
#pragma once

#include "math/vec.h"

namespace footlight {

template <class F>
struct Frame {
    Vec3<F> t, b, n;
};

// n: unit. Continuous but for the sign of n.z, exact at n = -z, |t·b|, |t·n| <= 3e-7 everywhere.
// Duff et al. 2017, "Building an Orthonormal Basis, Revisited", listing 3.
template <class F>
inline Frame<F> make_frame(Vec3<F> n) {
    const F sign = copysign(F(1), n.z);
    const F a = F(-1) / (sign + n.z);
    const F c = n.x * n.y * a;
    const Vec3<F> t{fma(sign * n.x, n.x * a, F(1)), sign * c, -sign * n.x};
    const Vec3<F> b{c, fma(n.y, n.y * a, sign), -n.y};
    return {t, b, n};
}

template <class F>
inline Vec3<F> to_local(const Frame<F>& frame, Vec3<F> v) {
    return {dot(v, frame.t), dot(v, frame.b), dot(v, frame.n)};
}

template <class F>
inline Vec3<F> to_world(const Frame<F>& frame, Vec3<F> v) {
    const auto axis = [&](F t, F b, F n) { return fma(v.x, t, fma(v.y, b, v.z * n)); };
    return {axis(frame.t.x, frame.b.x, frame.n.x), axis(frame.t.y, frame.b.y, frame.n.y),
            axis(frame.t.z, frame.b.z, frame.n.z)};
}

}  // namespace footlight
