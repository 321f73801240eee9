// Random numbers with names: Owen-scrambled Sobol' pairs, one independent pair per (pixel, bounce, purpose).
//
// Nothing consumes numbers by counting, so an absent effect moves no other effect's numbers.
// A pixel has two replicates, which the film tells apart to measure its error: sequences of their own for every purpose
// but those of `shared_by_replicates`.
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

// Fractions are kept with their digits in the order of the index they come from, the first digit lowest, and are turned
// round last: Owen scrambling of such a fraction, as a number in [0, 1).
template <class F>
inline F owen_scrambled(UInt<F> digits, UInt<F> seed) {
    return to_unit<F>(reverse_bits(laine_karras(digits, seed)));
}

// Second Sobol' dimension of a point, from its index, which is the first: the Pascal matrix mod 2 as a superset sum
// over bit positions (Lucas).
template <class U>
inline U sobol_second(U index) {
    U x = index;
    x = x ^ ((x >> 1) & U(0x55555555U));
    x = x ^ ((x >> 2) & U(0x33333333U));
    x = x ^ ((x >> 4) & U(0x0F0F0F0FU));
    x = x ^ ((x >> 8) & U(0x00FF00FFU));
    return x ^ (x >> 16);
}

// 1 where an odd number of bits is set, else 0.
template <class U>
inline U parity(U x) {
    x = x ^ (x >> 16);
    x = x ^ (x >> 8);
    x = x ^ (x >> 4);
    x = x ^ (x >> 2);
    return (x ^ (x >> 1)) & U(1U);
}

// Identity of one path for the sampler: which pixel and replicate (key; its lowest bit is the replicate), which point
// of their sequence (index < 2^31, bit-reversed).
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
    return (mix_bits(h) & ~1U) | replicate;
}

template <class F>
inline UInt<F> dimension_seed(UInt<F> key, std::uint32_t bounce, Dim dim) {
    return mix_bits(key ^ UInt<F>(mix_bits(bounce * 0x9e3779b9U + static_cast<std::uint32_t>(dim) * 0x85ebca6bU + 1U)));
}

// Purposes whose points in both replicates together are one sequence, of twice as many strata. Where that lowers the
// error, it is also overstated: halves of one sequence are further apart than two sequences. Directions at the first
// surface: 13 % less variance on a Cornell box, an error overstated by 11 % there and by up to 15 % on the stages of
// the laws. Later directions gain nothing; the pixel position gains as much at edges, overstated by up to 45 %.
inline bool shared_by_replicates(std::uint32_t bounce, Dim dim) {
    return bounce == 0 && (dim == Dim::light_uv || dim == Dim::lobe_uv);
}

// The index in the shared sequence of point `index` of a replicate. A replicate has the points whose third Sobol'
// dimension (Joe and Kuo 2008: x^2 + x + 1, first digits 1 1 0 1 1 0 ...) begins with its number: of every two
// successive points one, and again a net, though one that may hold two points in a stratum (t = 1).
template <class U>
inline U index_among_both(U index, U replicate) {
    constexpr std::uint32_t kThird = 0x6DB6DB6DU;  // digits 1 and up
    return (index << 1) | (parity(index & U(kThird)) ^ replicate);
}

// One number in [0, 1).
template <class F>
inline F sample_1d(PathKey<F> path, std::uint32_t bounce, Dim dim) {
    const UInt<F> seed = dimension_seed<F>(path.key, bounce, dim);
    const UInt<F> index = reverse_bits(laine_karras(path.reversed_index, seed));
    return owen_scrambled<F>(index, mix_bits(seed + UInt<F>(0x68bc21ebU)));
}

// A point of [0, 1)^2. The index shuffle decorrelates the pairs of different dimensions from each other (padding).
template <class F>
inline Uniform2<F> sample_2d(PathKey<F> path, std::uint32_t bounce, Dim dim) {
    const bool shared = shared_by_replicates(bounce, dim);
    const UInt<F> key = shared ? path.key & UInt<F>(~1U) : path.key;
    const UInt<F> seed = dimension_seed<F>(key, bounce, dim);
    UInt<F> index = reverse_bits(laine_karras(path.reversed_index, seed));
    if (shared) index = index_among_both(index, path.key & UInt<F>(1U));
    const UInt<F> scramble = mix_bits(seed + UInt<F>(0x68bc21ebU));
    return {owen_scrambled<F>(index, scramble),
            owen_scrambled<F>(sobol_second(index), mix_bits(scramble + UInt<F>(0x02e5be93U)))};
}

}  // namespace footlight
