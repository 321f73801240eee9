// The effects a scene calls for: one closed list, derived from the scene, each with the prims that asked for it.
#pragma once

#include <array>
#include <string>
#include <string_view>
#include <vector>

#include "scene/scene.h"

namespace footlight {

enum class Effect {
    specular,
    coat,
    emission,
    opacity,
    vertex_color,
    shading_normals,
    instances,
    depth_of_field,
    area_lights,
    distant_lights,
    dome,
};

struct EffectInfo {
    Effect effect;
    std::string_view name;
    std::string_view adds;    // what runs because of it
    std::string_view absent;  // why it is not needed when it is not
};

inline constexpr std::array<EffectInfo, 11> kEffects{{
    {Effect::specular, "specular", "GGX or mirror lobe over the diffuse one",
     "no material reflects specularly (ior 1, metallic 0)"},
    {Effect::coat, "coat", "second GGX lobe on top", "no material has clearcoat above 0"},
    {Effect::emission, "emission", "emission stage, light samples", "no material emits"},
    {Effect::opacity, "opacity", "opacity numbers and a filter on rays", "every surface is opaque"},
    {Effect::vertex_color, "vertex_color", "colour lookup per hit", "no bound mesh takes its colour from a primvar"},
    {Effect::shading_normals, "shading_normals", "normal interpolation per hit", "no mesh has normals"},
    {Effect::instances, "instances", "instance transforms per hit", "nothing is placed more than once"},
    {Effect::depth_of_field, "depth_of_field", "lens sample per camera ray", "the camera is a pinhole (f_stop 0)"},
    {Effect::area_lights, "area_lights", "light_hit stage, light samples", "no rect, disk, sphere or cylinder light"},
    {Effect::distant_lights, "distant_lights", "escape stage, light samples", "no distant light"},
    {Effect::dome, "dome", "escape stage, light samples", "no dome light"},
}};

struct EffectState {
    bool called_for = false;
    bool forced = false;             // runs although nothing calls for it; the image must not change
    std::vector<std::string> paths;  // who asked, at most kMaxPaths of them
    std::size_t path_count = 0;

    static constexpr std::size_t kMaxPaths = 16;
    [[nodiscard]] bool active() const { return called_for || forced; }
};

struct Effects {
    std::array<EffectState, kEffects.size()> states;
    [[nodiscard]] const EffectState& operator[](Effect e) const { return states[static_cast<std::size_t>(e)]; }
    [[nodiscard]] bool active(Effect e) const { return (*this)[e].active(); }
};

// forced: names of effects to run regardless, or "all". Throws std::invalid_argument for an unknown name. Lights cannot
// be forced: without one there is nothing to run.
Effects derive_effects(const Scene& scene, const std::vector<std::string>& forced);

}  // namespace footlight
