// The effects a scene calls for, and who asked.
#include "pipeline/effects.h"

#include <algorithm>
#include <set>
#include <stdexcept>

#include "material/material_table.h"

namespace footlight {

namespace {

bool is_light_effect(Effect e) { return e == Effect::area_lights || e == Effect::distant_lights || e == Effect::dome; }

void force(Effects& effects, const std::string& name) {
    bool found = name == "all";
    for (const EffectInfo& info : kEffects) {
        if (info.name != name && name != "all") continue;
        found = true;
        if (!is_light_effect(info.effect)) effects.states[static_cast<std::size_t>(info.effect)].forced = true;
    }
    if (found) return;
    std::string allowed = "all";
    for (const EffectInfo& info : kEffects) allowed += ", " + std::string(info.name);
    throw std::invalid_argument("force_effects: unknown effect '" + name + "'; allowed: " + allowed);
}

Effect effect_of(const AnyLight& light) {
    if (std::holds_alternative<DomeLightDesc>(light)) return Effect::dome;
    return std::holds_alternative<DistantLightDesc>(light) ? Effect::distant_lights : Effect::area_lights;
}

}  // namespace

Effects derive_effects(const Scene& scene, const std::vector<std::string>& forced) {
    Effects effects;
    const auto call = [&](Effect effect, const std::string& path) {
        EffectState& state = effects.states[static_cast<std::size_t>(effect)];
        state.called_for = true;
        if (++state.path_count <= EffectState::kMaxPaths) state.paths.push_back(path);
    };
    std::vector<bool> placed(scene.meshes().size(), false);
    for (const Instances& instances : scene.instances()) {
        for (const std::uint32_t mesh : instances.meshes) placed[mesh] = true;
        if (instances.transforms.size() > 1) call(Effect::instances, instances.path);
    }
    std::set<std::uint32_t> bound;
    for (std::size_t i = 0; i < scene.meshes().size(); ++i) {
        if (!placed[i]) continue;
        const Mesh& mesh = scene.meshes()[i];
        const PreviewSurface& material = scene.materials()[mesh.material];
        bound.insert(mesh.material);
        if (!mesh.normals.empty()) call(Effect::shading_normals, mesh.path);
        if (material.diffuse_from_primvar && !mesh.colors.empty()) call(Effect::vertex_color, mesh.path);
        const auto below_one = [](float o) { return o < 1.0F; };
        if (material.opacity_from_primvar &&
            std::any_of(mesh.opacities.values.begin(), mesh.opacities.values.end(), below_one))
            call(Effect::opacity, mesh.path);
    }
    // Only bound materials call for anything: an unused one must not change what runs.
    for (const std::uint32_t index : bound) {
        const PreviewSurface& material = scene.materials()[index];
        if (has_specular(material)) call(Effect::specular, material.path);
        if (has_coat(material)) call(Effect::coat, material.path);
        if (has_emission(material)) call(Effect::emission, material.path);
        if (material.opacity < 1.0F) call(Effect::opacity, material.path);
    }
    const Camera& camera = scene.camera();
    if (camera.f_stop > 0 && camera.focus_distance > 0) call(Effect::depth_of_field, camera.path);
    for (const AnyLight& light : scene.lights()) call(effect_of(light), common(light).path);
    for (const std::string& name : forced) force(effects, name);
    return effects;
}

}  // namespace footlight
