// A batch: the state of many paths as columns, and the lists that say which rows each stage works on.
#pragma once

#include <cstdint>
#include <vector>

#include "math/sampler.h"
#include "math/vec.h"

namespace footlight {

// Columns are padded by one register, so that the last group of lanes may be read and written whole.
template <class T>
using Column = std::vector<T, xsimd::aligned_allocator<T, kAlignment>>;

template <class T>
inline Column<T> make_column(std::size_t rows) {
    return Column<T>(rows + kLanes);
}

// Three columns of a vector or a colour.
struct Column3 {
    Column<float> x, y, z;
    explicit Column3(std::size_t rows)
        : x(make_column<float>(rows)), y(make_column<float>(rows)), z(make_column<float>(rows)) {}

    [[nodiscard]] Vec3<FloatV> load(std::size_t i) const {
        return {FloatV::load_aligned(&x[i]), FloatV::load_aligned(&y[i]), FloatV::load_aligned(&z[i])};
    }
    [[nodiscard]] Rgb<FloatV> load_rgb(std::size_t i) const {
        const Vec3<FloatV> v = load(i);
        return {v.x, v.y, v.z};
    }
    [[nodiscard]] Vec3<FloatV> gather_rows(UIntV rows) const {
        return {gather<FloatV>(x.data(), rows), gather<FloatV>(y.data(), rows), gather<FloatV>(z.data(), rows)};
    }
    void store(std::size_t i, Vec3<FloatV> v) {
        v.x.store_aligned(&x[i]);
        v.y.store_aligned(&y[i]);
        v.z.store_aligned(&z[i]);
    }
    void store(std::size_t i, Rgb<FloatV> c) { store(i, Vec3<FloatV>{c.r, c.g, c.b}); }
};

// Rows a stage works on: indices into the columns of the stage before.
struct RowList {
    Column<std::uint32_t> rows;
    std::size_t count = 0;

    explicit RowList(std::size_t capacity) : rows(make_column<std::uint32_t>(capacity)) {}
    void clear() { count = 0; }
    void push(std::uint32_t row) { rows[count++] = row; }
    // Appends first + lane for every bit set.
    void push_lanes(std::uint32_t first, std::uint32_t bits) {
        for (; bits != 0; bits &= bits - 1) push(first + static_cast<std::uint32_t>(std::countr_zero(bits)));
    }
    // Fills the rest of the last group with a row that exists, so that gathers stay in bounds.
    void pad() {
        for (int i = 0; i < kLanes; ++i) rows[count + static_cast<std::size_t>(i)] = count > 0 ? rows[count - 1] : 0;
    }
    [[nodiscard]] UIntV load(std::size_t i) const { return UIntV::load_unaligned(&rows[i]); }
};

// Memory of a counting sort of rows.
struct SortScratch {
    std::vector<std::uint32_t> key, rows, begin;
    explicit SortScratch(std::size_t n) : key(n), rows(n) {}
};

// Rows [begin, end).
struct RowRange {
    std::size_t begin = 0, end = 0;
};

// The lanes of group i that belong to the first `count` rows, as bits.
inline std::uint32_t lanes_below(std::size_t i, std::size_t count) {
    const std::size_t left = count - i;
    return left >= static_cast<std::size_t>(kLanes) ? (1U << kLanes) - 1U : (1U << left) - 1U;
}

// Rays on their way, one row per living path.
struct PathColumns {
    Column3 origin, direction, throughput;
    Column<float>
        pdf;  // of the direction, from the surface that scattered it [1/sr]; 0: nothing else could have drawn it
    Column<std::uint32_t> key, reversed_index, slot;

    explicit PathColumns(std::size_t n)
        : origin(n),
          direction(n),
          throughput(n),
          pdf(make_column<float>(n)),
          key(make_column<std::uint32_t>(n)),
          reversed_index(make_column<std::uint32_t>(n)),
          slot(make_column<std::uint32_t>(n)) {}
};

// What the rays met.
struct HitRows {
    Column<std::uint32_t> id, instance;
    Column<float> t, u, v;

    explicit HitRows(std::size_t n)
        : id(make_column<std::uint32_t>(n)),
          instance(make_column<std::uint32_t>(n)),
          t(make_column<float>(n)),
          u(make_column<float>(n)),
          v(make_column<float>(n)) {}
};

// Surface points, sorted by lobe set.
struct SurfaceColumns {
    Column3 position;   // relative to the render origin
    Column3 wo;         // unit, towards the viewer
    Column3 geometric;  // unit face normal on the side of wo
    Column3 shading;    // unit shading normal on the side of wo
    Column3 color;      // base colour
    Column3 throughput;
    Column<float> offset;  // distance along `geometric` that clears the surface [stage units]
    Column<std::uint32_t> material, key, reversed_index, slot;

    explicit SurfaceColumns(std::size_t n)
        : position(n),
          wo(n),
          geometric(n),
          shading(n),
          color(n),
          throughput(n),
          offset(make_column<float>(n)),
          material(make_column<std::uint32_t>(n)),
          key(make_column<std::uint32_t>(n)),
          reversed_index(make_column<std::uint32_t>(n)),
          slot(make_column<std::uint32_t>(n)) {}
};

// Rays towards lights, one per row of surfaces, and what they bring if nothing is in the way.
struct ShadowColumns {
    Column3 origin, direction, contribution;
    Column<float> tfar;
    Column<std::uint32_t> light;  // row of the light that is asked for

    explicit ShadowColumns(std::size_t n)
        : origin(n), direction(n), contribution(n), tfar(make_column<float>(n)), light(make_column<std::uint32_t>(n)) {}
};

// What each path brings back, by slot.
struct SampleRows {
    Column3 radiance;
    Column<float> alpha, depth;
    Column3 normal, albedo, position;

    SampleRows(std::size_t n, bool with_aovs)
        : radiance(n),
          alpha(make_column<float>(n)),
          depth(make_column<float>(n)),
          normal(with_aovs ? n : 0),
          albedo(with_aovs ? n : 0),
          position(with_aovs ? n : 0) {}
};

// Where a path's sample goes.
struct SampleOwner {
    std::uint16_t x, y;
    std::uint32_t sample;
};

}  // namespace footlight
