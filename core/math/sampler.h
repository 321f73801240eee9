// Random numbers with names: Owen-scrambled Sobol' pairs, one independent pair per (pixel, bounce, purpose).
//
// Nothing consumes numbers by counting, so an absent effect moves no other effect's numbers.
// Scrambling: Burley 2020, "Practical Hash-based Owen Scrambling"; hash constants: Vegdahl 2021, "Building a Better LK
// Hash".
#pragma once

#include "math/simd.h"

namespace footlight {

// The purposes a path draws numbers for. The order is part of the image: append, never reorder.
enum class Dim : std::uint32_t {
    pixel,
    lens,
    light_choice,
    light_uv,
    lobe_choice,
    lobe_uv,
    roulette,
    opacity,
    shadow_opacity
};

template <class F>
struct Uniform2 {
    F u, v;
};

template <class U>
inline U reverse_bits(U x) {
    x = ((x >> 1) & U(0x55555555U)) | ((x & U(0x55555555U)) << 1);
    x = ((x >> 2) & U(0x33333333U)) | ((x & U(0x33333333U)) << 2);
    x = ((x >> 4) & U(0x0F0F0F0FU)) | ((x & U(0x0F0F0F0FU)) << 4);
    x = ((x >> 8) & U(0x00FF00FFU)) | ((x & U(0x00FF00FFU)) << 8);
    return (x >> 16) | (x << 16);
}

// Full-avalanche mix of 32 bits (Ettinger 2018, "hash prospector", lowbias32).
template <class U>
inline U mix_bits(U x) {
    x = x ^ (x >> 16);
    x = x * U(0x7feb352dU);
    x = x ^ (x >> 15);
    x = x * U(0x846ca68bU);
    return x ^ (x >> 16);
}

// Laine-Karras style permutation: each bit is flipped depending on the bits below it.
template <class U>
inline U laine_karras(U x, U seed) {
    x = x ^ (x * U(0x3d20adeaU));
    x = x + seed;
    x = x * ((seed >> 16) | U(1U));
    x = x ^ (x * U(0x05526c56U));
    return x ^ (x * U(0x53a22864U));
}

// Owen scrambling of a 32-bit fraction, the most significant bit first.
template <class U>
inline U owen_scramble(U x, U seed) {
    return reverse_bits(laine_karras(reverse_bits(x), seed));
}

// Second Sobol' dimension from the first: the Pascal matrix mod 2 as a superset sum over bit positions (Lucas).
template <class U>
inline U sobol_second(U first) {
    U x = first;
    x = x ^ ((x << 1) & U(0xAAAAAAAAU));
    x = x ^ ((x << 2) & U(0xCCCCCCCCU));
    x = x ^ ((x << 4) & U(0xF0F0F0F0U));
    x = x ^ ((x << 8) & U(0xFF00FF00U));
    return x ^ ((x << 16) & U(0xFFFF0000U));
}

// Identity of one path for the sampler: which pixel and replicate (key), which point of their sequence (index,
// bit-reversed).
template <class F>
struct PathKey {
    UInt<F> key;
    UInt<F> reversed_index;
};

// The key of pixel (x, y) in one of the two replicates of a render's seed.
inline std::uint32_t pixel_key(std::uint32_t seed, std::uint32_t x, std::uint32_t y, std::uint32_t replicate) {
    std::uint32_t h = mix_bits(seed + 0x9e3779b9U);
    h = mix_bits(h ^ (x * 0x8da6b343U + 1U));
    h = mix_bits(h ^ (y * 0xd8163841U + 1U));
    return mix_bits(h + replicate * 0xcb1ab31fU);
}

template <class F>
inline UInt<F> dimension_seed(UInt<F> key, std::uint32_t bounce, Dim dim) {
    return mix_bits(key ^ UInt<F>(mix_bits(bounce * 0x9e3779b9U + static_cast<std::uint32_t>(dim) * 0x85ebca6bU + 1U)));
}

// One number in [0, 1).
template <class F>
inline F sample_1d(PathKey<F> path, std::uint32_t bounce, Dim dim) {
    const UInt<F> seed = dimension_seed<F>(path.key, bounce, dim);
    const UInt<F> point = laine_karras(path.reversed_index, seed);
    return to_unit<F>(owen_scramble(point, mix_bits(seed + UInt<F>(0x68bc21ebU))));
}

// A point of [0, 1)^2. The index shuffle decorrelates the pairs of different dimensions from each other (padding).
template <class F>
inline Uniform2<F> sample_2d(PathKey<F> path, std::uint32_t bounce, Dim dim) {
    const UInt<F> seed = dimension_seed<F>(path.key, bounce, dim);
    const UInt<F> point = laine_karras(path.reversed_index, seed);
    const UInt<F> scramble = mix_bits(seed + UInt<F>(0x68bc21ebU));
    return {to_unit<F>(owen_scramble(point, scramble)),
            to_unit<F>(owen_scramble(sobol_second(point), mix_bits(scramble + UInt<F>(0x02e5be93U))))};
}

}  // namespace footlight
