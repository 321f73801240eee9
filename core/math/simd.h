// One set of words for float, double and SIMD batches, so that a kernel is written once over its number type.
#pragma once

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>
#include <type_traits>
#include <utility>

#include <xsimd/xsimd.hpp>

namespace footlight {

// The batch that renders. Its width follows the instruction set the translation unit is compiled for.
using FloatV = xsimd::batch<float>;
using UIntV = xsimd::batch<std::uint32_t>;
inline constexpr int kLanes = static_cast<int>(FloatV::size);
// Columns of a batch are aligned and padded to this many bytes (one AVX-512 register, one Embree packet of 16).
inline constexpr int kAlignment = 64;

template <class F>
struct NumberTraits {
    using Mask = bool;
    using UInt = std::uint32_t;
};
template <class A>
struct NumberTraits<xsimd::batch<float, A>> {
    using Mask = xsimd::batch_bool<float, A>;
    using UInt = xsimd::batch<std::uint32_t, A>;
};
template <class F>
using Mask = typename NumberTraits<F>::Mask;
template <class F>
using UInt = typename NumberTraits<F>::UInt;

template <class F>
inline constexpr bool is_batch = !std::is_same_v<Mask<F>, bool>;

// --- choice ---
template <class T>
    requires std::is_arithmetic_v<T>
inline T select(bool mask, T a, T b) {
    return mask ? a : b;
}
template <class A>
inline xsimd::batch<float, A> select(xsimd::batch_bool<float, A> mask, xsimd::batch<float, A> a,
                                     xsimd::batch<float, A> b) {
    return xsimd::select(mask, a, b);
}
template <class A>
inline xsimd::batch<std::uint32_t, A> select(xsimd::batch_bool<float, A> mask, xsimd::batch<std::uint32_t, A> a,
                                             xsimd::batch<std::uint32_t, A> b) {
    using FloatA = xsimd::batch<float, A>;
    return xsimd::bitwise_cast<xsimd::batch<std::uint32_t, A>>(
        xsimd::select(mask, xsimd::bitwise_cast<FloatA>(a), xsimd::bitwise_cast<FloatA>(b)));
}
inline bool any(bool mask) { return mask; }
inline bool all(bool mask) { return mask; }
template <class A>
inline bool any(xsimd::batch_bool<float, A> mask) {
    return xsimd::any(mask);
}
template <class A>
inline bool all(xsimd::batch_bool<float, A> mask) {
    return xsimd::all(mask);
}

// One bit per lane, lane 0 lowest.
template <class A>
inline std::uint32_t lane_bits(xsimd::batch_bool<float, A> mask) {
    if constexpr (std::is_integral_v<typename xsimd::batch_bool<float, A>::register_type>) {
        return static_cast<std::uint32_t>(static_cast<typename xsimd::batch_bool<float, A>::register_type>(mask));
    } else {
        alignas(kAlignment) bool lanes[xsimd::batch<float, A>::size];
        mask.store_aligned(lanes);
        std::uint32_t bits = 0;
        for (std::size_t i = 0; i < xsimd::batch<float, A>::size; ++i) bits |= (lanes[i] ? 1U : 0U) << i;
        return bits;
    }
}

// Equality of integer lanes as a mask of the number type F.
template <class F>
inline Mask<F> equal(UInt<F> a, UInt<F> b) {
    if constexpr (is_batch<F>) {
        using IntA = xsimd::batch<std::int32_t, typename F::arch_type>;
        return xsimd::bool_cast(xsimd::bitwise_cast<IntA>(a) == xsimd::bitwise_cast<IntA>(b));
    } else {
        return a == b;
    }
}

// --- arithmetic ---
template <class F>
inline F sqrt(F x) {
    if constexpr (is_batch<F>)
        return xsimd::sqrt(x);
    else
        return std::sqrt(x);
}
// Square root of max(x, 0): for 1 - c^2 forms that rounding may push below zero.
template <class F>
inline F safe_sqrt(F x);
template <class F>
inline F abs(F x) {
    if constexpr (is_batch<F>)
        return xsimd::abs(x);
    else
        return std::abs(x);
}
template <class F>
inline F min(F a, F b) {
    if constexpr (is_batch<F>)
        return xsimd::min(a, b);
    else
        return std::min(a, b);
}
template <class F>
inline F max(F a, F b) {
    if constexpr (is_batch<F>)
        return xsimd::max(a, b);
    else
        return std::max(a, b);
}
template <class F>
inline F safe_sqrt(F x) {
    return sqrt(max(x, F(0)));
}
template <class F>
inline F clamp(F x, F lo, F hi) {
    return min(max(x, lo), hi);
}
// a * b + c, rounded once where the hardware can. xsimd 8.1 has no AVX-512 kernel for it and would round twice; the
// overload for batches is the more special one, so that an unqualified call does not find xsimd's.
inline float fma(float a, float b, float c) { return std::fma(a, b, c); }
inline double fma(double a, double b, double c) { return std::fma(a, b, c); }
template <class A>
inline xsimd::batch<float, A> fma(xsimd::batch<float, A> a, xsimd::batch<float, A> b, xsimd::batch<float, A> c) {
    if constexpr (std::is_base_of_v<xsimd::avx512f, A>)
        return _mm512_fmadd_ps(a, b, c);
    else
        return xsimd::fma(a, b, c);
}
template <class F>
inline F copysign(F magnitude, F sign) {
    if constexpr (is_batch<F>)
        return xsimd::copysign(magnitude, sign);
    else
        return std::copysign(magnitude, sign);
}
template <class F>
inline F floor(F x) {
    if constexpr (is_batch<F>)
        return xsimd::floor(x);
    else
        return std::floor(x);
}
template <class F>
struct SinCos {
    F sin, cos;
};
template <class F>
inline SinCos<F> sin_cos(F x) {
    if constexpr (is_batch<F>) {
        const auto r = xsimd::sincos(x);
        return {r.first, r.second};
    } else
        return {std::sin(x), std::cos(x)};
}
template <class F>
inline F acos(F x) {
    if constexpr (is_batch<F>)
        return xsimd::acos(x);
    else
        return std::acos(x);
}
template <class F>
inline F asin(F x) {
    if constexpr (is_batch<F>)
        return xsimd::asin(x);
    else
        return std::asin(x);
}
template <class F>
inline F atan2(F y, F x) {
    if constexpr (is_batch<F>)
        return xsimd::atan2(y, x);
    else
        return std::atan2(y, x);
}
template <class F>
inline Mask<F> is_finite(F x) {
    return abs(x) <= F(3.402823466e+38F);
}

// --- bits ---
inline std::uint32_t reverse_bits(std::uint32_t x) {
    x = ((x >> 1) & 0x55555555U) | ((x & 0x55555555U) << 1);
    x = ((x >> 2) & 0x33333333U) | ((x & 0x33333333U) << 2);
    x = ((x >> 4) & 0x0F0F0F0FU) | ((x & 0x0F0F0F0FU) << 4);
    x = ((x >> 8) & 0x00FF00FFU) | ((x & 0x00FF00FFU) << 8);
    return (x >> 16) | (x << 16);
}
// Bytes of a table of 16, in every 128 bits, by the bytes of index, which are below 16.
template <class A>
inline xsimd::batch<std::uint32_t, A> look_up_bytes(xsimd::batch<std::uint32_t, A> table,
                                                    xsimd::batch<std::uint32_t, A> index) {
    if constexpr (sizeof(table) == 64)
        return _mm512_shuffle_epi8(table, index);
    else if constexpr (sizeof(table) == 32)
        return _mm256_shuffle_epi8(table, index);
    else
        return _mm_shuffle_epi8(table, index);
}
// By halves of bytes: a third of the instructions of the scalar form, which the sampler spends half its time in.
template <class A>
inline xsimd::batch<std::uint32_t, A> reverse_bits(xsimd::batch<std::uint32_t, A> x) {
    using U = xsimd::batch<std::uint32_t, A>;
    const auto table = [](std::uint32_t a, std::uint32_t b, std::uint32_t c, std::uint32_t d) {
        alignas(kAlignment) std::uint32_t words[U::size];
        for (std::size_t i = 0; i < U::size; i += 4) {
            words[i] = a;
            words[i + 1] = b;
            words[i + 2] = c;
            words[i + 3] = d;
        }
        return U::load_aligned(words);
    };
    const U reversed = table(0x0C040800U, 0x0E060A02U, 0x0D050901U, 0x0F070B03U);
    const U last_byte_first = table(0x00010203U, 0x04050607U, 0x08090A0BU, 0x0C0D0E0FU);
    const U half(0x0F0F0F0FU);
    const U turned = look_up_bytes(reversed << 4, x & half) | look_up_bytes(reversed, (x >> 4) & half);
    return look_up_bytes(turned, last_byte_first);
}

// --- conversion and memory ---
// 24 high bits of x as a number in [0, 1); never 1, whatever x.
template <class F>
inline F to_unit(UInt<F> x) {
    if constexpr (is_batch<F>)
        return xsimd::to_float(xsimd::bitwise_cast<xsimd::batch<std::int32_t, typename F::arch_type>>(x >> 8)) *
               F(0x1p-24F);
    else
        return static_cast<F>(x >> 8) * F(0x1p-24);
}
// Truncation of a non-negative number below 2^31.
template <class F>
inline UInt<F> to_uint(F x) {
    if constexpr (is_batch<F>)
        return xsimd::bitwise_cast<UInt<F>>(xsimd::to_int(x));
    else
        return static_cast<std::uint32_t>(x);
}
template <class F>
inline F to_number(UInt<F> x) {  // x < 2^31
    if constexpr (is_batch<F>)
        return xsimd::to_float(xsimd::bitwise_cast<xsimd::batch<std::int32_t, typename F::arch_type>>(x));
    else
        return static_cast<F>(x);
}
// xsimd 8.1's batch::gather never reaches its hardware kernels, which are declared after their use, and goes lane by
// lane (15 instead of 9 cycles for 16 lanes).
template <class F, class T>
inline F gather(const T* table, UInt<F> index) {
    if constexpr (is_batch<F>) {
        static_assert(std::is_same_v<T, float>, "batches gather float tables");
        using A = typename F::arch_type;
        const auto signed_index = xsimd::bitwise_cast<xsimd::batch<std::int32_t, A>>(index);
        if constexpr (requires { xsimd::kernel::gather(table, signed_index, A{}); })
            return xsimd::kernel::gather(table, signed_index, A{});
        else
            return F::gather(table, signed_index);
    } else {
        return static_cast<F>(table[index]);
    }
}
// Through the float kernel, which keeps bits: xsimd 8.1's kernels for integers cannot be called.
template <class F>
inline UInt<F> gather_uint(const std::uint32_t* table, UInt<F> index) {
    if constexpr (is_batch<F>)
        return xsimd::bitwise_cast<UInt<F>>(gather<F>(reinterpret_cast<const float*>(table), index));
    else
        return table[index];
}

}  // namespace footlight
