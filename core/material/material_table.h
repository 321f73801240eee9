// UsdPreviewSurface constants turned into the numbers the lobes need, as columns for gathers.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "scene/scene.h"

namespace footlight {

// Which lobes a material needs; scatter is compiled once per entry and runs on batches of one entry.
enum class LobeSet : std::uint8_t { diffuse, glossy, mirror, diffuse_coat, glossy_coat, mirror_coat };
inline constexpr int kLobeSets = 6;

// One row of the table, over any number type.
template <class F>
struct SurfaceParameters {
    Rgb<F> base;      // diffuse_color, or the mesh's own colour
    F diffuse_scale;  // diffuse reflectance = base * diffuse_scale
    Rgb<F> f0;        // specular f0 = f0 + base * base_to_f0
    F base_to_f0;
    F f90;    // 0 where there is no specular lobe
    F alpha;  // GGX roughness, roughness^2
    F coat;   // clearcoat weight
    F coat_alpha;
};

struct MaterialTable {
    std::vector<float> base[3], f0[3], emission[3];
    std::vector<float> diffuse_scale, base_to_f0, f90, alpha, coat, coat_alpha;
    std::vector<LobeSet> lobe_set;

    template <class F>
    [[nodiscard]] Rgb<F> load_emission(UInt<F> row) const {
        return {gather<F>(emission[0].data(), row), gather<F>(emission[1].data(), row),
                gather<F>(emission[2].data(), row)};
    }

    template <class F>
    [[nodiscard]] SurfaceParameters<F> load(UInt<F> row) const {
        const auto column = [&](const std::vector<float>& c) { return gather<F>(c.data(), row); };
        return {{column(base[0]), column(base[1]), column(base[2])},
                column(diffuse_scale),
                {column(f0[0]), column(f0[1]), column(f0[2])},
                column(base_to_f0),
                column(f90),
                column(alpha),
                column(coat),
                column(coat_alpha)};
    }
};

// force_specular, force_coat: choose lobe sets that carry the lobe although no material calls for it.
MaterialTable build_material_table(std::span<const PreviewSurface> materials, bool force_specular, bool force_coat);

// What a material calls for.
[[nodiscard]] bool has_specular(const PreviewSurface& material);
[[nodiscard]] bool has_coat(const PreviewSurface& material);
[[nodiscard]] bool has_emission(const PreviewSurface& material);

}  // namespace footlight
