// Stages: rays in the order of where they start and where they go, so that neighbours in a packet walk the same nodes.
#include "pipeline/worker.h"

namespace footlight {

namespace {

constexpr unsigned kCellBits = 4;  // per axis

std::uint32_t octant(const Column3& d, std::uint32_t row) {
    return (d.x[row] < 0 ? 1U : 0U) | (d.y[row] < 0 ? 2U : 0U) | (d.z[row] < 0 ? 4U : 0U);
}

// Bits 0..3 of x to bits 0, 3, 6, 9.
std::uint32_t spread(std::uint32_t x) {
    x = (x | (x << 4)) & 0x0C3U;
    return (x | (x << 2)) & 0x249U;
}

// Morton order of the origin's cell in the scene's bounds, then the octant of the direction.
struct RayKey {
    static constexpr unsigned bits = 3 * kCellBits + 3;
    const Column3 &origin, &direction;
    Vec3<float> low, scale;

    RayKey(const Column3& origin_in, const Column3& direction_in, const Geometry& geometry)
        : origin(origin_in), direction(direction_in), low(geometry.bounds_min) {
        const Vec3<float> size = geometry.bounds_max - geometry.bounds_min;
        const auto cells_per_unit = [](float s) { return s > 0 ? static_cast<float>(1U << kCellBits) / s : 0.0F; };
        scale = {cells_per_unit(size.x), cells_per_unit(size.y), cells_per_unit(size.z)};
    }

    [[nodiscard]] static std::uint32_t cell(float x, float low, float scale) {
        const float c = (x - low) * scale;
        constexpr auto kLast = static_cast<float>((1U << kCellBits) - 1U);
        return c > 0 ? static_cast<std::uint32_t>(std::min(c, kLast)) : 0U;
    }

    [[nodiscard]] std::uint32_t operator()(std::uint32_t row) const {
        const std::uint32_t code = spread(cell(origin.x[row], low.x, scale.x)) |
                                   spread(cell(origin.y[row], low.y, scale.y)) << 1 |
                                   spread(cell(origin.z[row], low.z, scale.z)) << 2;
        return code << 3 | octant(direction, row);
    }
};

struct OctantKey {
    static constexpr unsigned bits = 3;
    const Column3& direction;

    [[nodiscard]] std::uint32_t operator()(std::uint32_t row) const { return octant(direction, row); }
};

template <class Key>
void sort_rows(RowList& list, const Key& key, SortScratch& scratch) {
    scratch.begin.assign((1U << Key::bits) + 1U, 0U);
    for (std::size_t i = 0; i < list.count; ++i) {
        scratch.key[i] = key(list.rows[i]);
        ++scratch.begin[scratch.key[i] + 1U];
    }
    for (std::size_t k = 1; k < scratch.begin.size(); ++k) scratch.begin[k] += scratch.begin[k - 1];
    for (std::size_t i = 0; i < list.count; ++i) scratch.rows[scratch.begin[scratch.key[i]]++] = list.rows[i];
    std::copy_n(scratch.rows.begin(), list.count, list.rows.begin());
    list.pad();
}

}  // namespace

void sort_paths(Worker& w) noexcept {
    // Camera rays come in image order, which is as good.
    if (w.bounce == 0) return;
    sort_rows(w.living, RayKey(w.paths.origin, w.paths.direction, w.scene.geometry), w.sort_scratch);
}

void sort_paths_by_octant(Worker& w) noexcept {
    if (w.bounce == 0) return;
    sort_rows(w.living, OctantKey{w.paths.direction}, w.sort_scratch);
}

void sort_shadows(Worker& w) noexcept {
    sort_rows(w.shadow_rays, RayKey(w.shadows.origin, w.shadows.direction, w.scene.geometry), w.sort_scratch);
}

}  // namespace footlight
