// UsdPreviewSurface constants turned into the numbers the lobes need.
#include "material/material_table.h"

#include "bsdf/fresnel.h"
#include "bsdf/ggx_distribution.h"

namespace footlight {

namespace {

LobeSet lobe_set_of(const PreviewSurface& m, bool specular, bool coat) {
    const bool mirror = has_specular(m) && m.roughness * m.roughness < static_cast<float>(kGgxMinAlpha);
    if (!specular) return coat ? LobeSet::diffuse_coat : LobeSet::diffuse;
    if (mirror) return coat ? LobeSet::mirror_coat : LobeSet::mirror;
    return coat ? LobeSet::glossy_coat : LobeSet::glossy;
}

}  // namespace

bool has_specular(const PreviewSurface& m) {
    if (m.use_specular_workflow) return max_component(m.specular_color) > 0;
    return m.metallic > 0 || m.ior != 1.0F;
}

bool has_coat(const PreviewSurface& m) { return m.clearcoat > 0; }

bool has_emission(const PreviewSurface& m) { return max_component(m.emissive_color) > 0; }

MaterialTable build_material_table(std::span<const PreviewSurface> materials, bool force_specular, bool force_coat) {
    MaterialTable table;
    for (const PreviewSurface& m : materials) {
        // Metalness workflow: f0 = mix(dielectric, base, metallic), diffuse = base (1 - metallic).
        // Specular workflow: f0 = specular_color, diffuse = base.
        const bool metalness = !m.use_specular_workflow;
        const float dielectric = (1 - m.metallic) * dielectric_f0(m.ior);
        const Rgb<float> f0 = metalness ? gray(dielectric) : m.specular_color;
        const float base[3] = {m.diffuse_color.r, m.diffuse_color.g, m.diffuse_color.b};
        const float specular[3] = {f0.r, f0.g, f0.b};
        const float emission[3] = {m.emissive_color.r, m.emissive_color.g, m.emissive_color.b};
        for (int c = 0; c < 3; ++c) {
            table.base[c].push_back(base[c]);
            table.f0[c].push_back(specular[c]);
            table.emission[c].push_back(emission[c]);
        }
        table.diffuse_scale.push_back(metalness ? 1 - m.metallic : 1.0F);
        table.base_to_f0.push_back(metalness ? m.metallic : 0.0F);
        table.f90.push_back(has_specular(m) ? 1.0F : 0.0F);
        table.alpha.push_back(m.roughness * m.roughness);
        table.coat.push_back(m.clearcoat);
        table.coat_alpha.push_back(m.clearcoat_roughness * m.clearcoat_roughness);
        table.lobe_set.push_back(lobe_set_of(m, has_specular(m) || force_specular, has_coat(m) || force_coat));
    }
    return table;
}

}  // namespace footlight
