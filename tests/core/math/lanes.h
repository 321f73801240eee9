// Kernels of any number type on plain numbers: fills lanes, calls, and reads them back in double.
#pragma once

#include <array>
#include <cstdint>
#include <random>

#include "math/vec.h"

namespace footlight::testing {

template <class F>
inline constexpr int lanes_of = is_batch<F> ? kLanes : 1;

// A constant from double; for float types, rounded once.
template <class F>
inline F number(double x) {
    if constexpr (std::is_same_v<F, double>)
        return x;
    else
        return F(static_cast<float>(x));
}
template <class F>
inline Vec3<F> vector(Vec3<double> v) {
    return {number<F>(v.x), number<F>(v.y), number<F>(v.z)};
}
template <class F>
inline double lane(F x, int i) {
    if constexpr (is_batch<F>)
        return static_cast<double>(x.get(static_cast<std::size_t>(i)));
    else
        return static_cast<double>(x);
}
template <class F>
inline Vec3<double> lane(Vec3<F> v, int i) {
    return {lane(v.x, i), lane(v.y, i), lane(v.z, i)};
}
template <class F>
inline bool lane_of_mask(Mask<F> m, int i) {
    return lane(select(m, F(1), F(0)), i) != 0;
}

// Independent numbers k / 2^24 of [0, 1), one per lane.
class Uniform {
  public:
    explicit Uniform(std::uint32_t seed) : engine_(seed) {}
    template <class F>
    F next() {
        std::array<float, kLanes> u{};
        for (int i = 0; i < lanes_of<F>; ++i)
            u[static_cast<std::size_t>(i)] = to_unit<float>(static_cast<std::uint32_t>(engine_()));
        if constexpr (is_batch<F>)
            return F::load_unaligned(u.data());
        else
            return static_cast<F>(u[0]);
    }

  private:
    std::mt19937 engine_;
};

}  // namespace footlight::testing
