// Stage: at every surface point one sample towards a light and one of the BSDF, with roulette on the path that goes on.
#include "light/light.h"
#include "material/surface_bsdf.h"
#include "math/frame.h"
#include "pipeline/worker.h"

namespace footlight {

namespace {

// Roulette: from this bounce on a path goes on with probability min(1, gain * throughput). Least error times seconds on
// a Cornell box among start 1 to 8 and gain 1 to 4. The floor bounds the weight of a survivor to a thousandfold.
constexpr std::uint32_t kRouletteStart = 2;
constexpr float kRouletteGain = 3.0F;
constexpr float kRouletteFloor = 1e-3F;
// Shadow rays end before the light by 64 roundings of the coordinates at their ends: a surface on which the light lies
// does not shadow it, a cover close before it does. The light itself is left out by its row.
constexpr float kShadowRounding = 0x1p-18F;

// One group of surface points in registers.
struct Group {
    std::size_t first;    // row of surfaces
    std::uint32_t lanes;  // bits of rows that exist
    Vec3<FloatV> origin;  // of spawned rays, clear of the surface
    Vec3<FloatV> geometric;
    Frame<FloatV> frame;
    Rgb<FloatV> throughput;
    PathKey<FloatV> key;
};

struct Scattering {
    bool sample_lights;
    bool continue_path;
    bool write_aovs;
};

Mask<FloatV> any_light(Rgb<FloatV> c) { return (c.r != FloatV(0.0F)) | (c.g != FloatV(0.0F)) | (c.b != FloatV(0.0F)); }

// Counts the rows of a group that a guard caught.
void count(Worker& w, Guard guard, Mask<FloatV> caught, std::uint32_t lanes) {
    const std::uint32_t bits = lane_bits(caught) & lanes;
    if (bits != 0) w.ledger.guard(guard) += static_cast<std::uint64_t>(std::popcount(bits));
}

FloatV light_strategy_weight(Strategy strategy, const LightSample<FloatV>& light, FloatV light_pdf, FloatV bsdf_pdf) {
    switch (strategy) {
        case Strategy::light:
            return FloatV(1.0F);
        case Strategy::bsdf:
            // Following the BSDF never finds a delta light.
            return select(light.is_delta, FloatV(1.0F), FloatV(0.0F));
        case Strategy::mis:
            break;
    }
    return light_weight(light, light_pdf, bsdf_pdf);
}

template <class Bsdf>
void sample_towards_light(Worker& w, const Group& g, const Bsdf& bsdf) {
    const CommittedScene& scene = w.scene;
    const FloatV u_choice = scene.lights.size() > 1 ? sample_1d(g.key, w.bounce, Dim::light_choice) : FloatV(0.0F);
    const LightChoice<FloatV> choice = select_light(scene.lights, u_choice);
    const Uniform2<FloatV> u = sample_2d(g.key, w.bounce, Dim::light_uv);
    const LightSample<FloatV> light = sample_light<FloatV>(scene.lights, choice.index, g.origin, u.u, u.v);
    const SurfaceEval<FloatV> e = bsdf.eval(to_local(g.frame, light.wi));
    const FloatV pdf = light.pdf * choice.probability;
    const FloatV weight = light_strategy_weight(scene.options.strategy, light, pdf, e.pdf);
    const Rgb<FloatV> contribution = g.throughput * e.f * light.radiance * (weight / pdf);
    const Mask<FloatV> has_density = (pdf > FloatV(0.0F)) & is_finite(pdf);
    count(w, Guard::bad_pdf, light.valid & (!has_density), g.lanes);
    const Mask<FloatV> lit =
        light.valid & has_density & (dot(g.geometric, light.wi) > FloatV(0.0F)) & any_light(contribution);
    const std::uint32_t bits = lane_bits(lit) & g.lanes;
    if (bits == 0) return;
    ShadowColumns& s = w.shadows;
    s.origin.store(g.first, g.origin);
    s.direction.store(g.first, light.wi);
    const FloatV from_center = max(max(abs(g.origin.x), abs(g.origin.y)), abs(g.origin.z));
    (light.distance * FloatV(1.0F - kShadowRounding) - from_center * FloatV(kShadowRounding))
        .store_aligned(&s.tfar[g.first]);
    choice.index.store_aligned(&s.light[g.first]);
    s.contribution.store(g.first, contribution);
    w.shadow_rays.push_lanes(static_cast<std::uint32_t>(g.first), bits);
}

template <class Bsdf>
void continue_path(Worker& w, const Group& g, const Bsdf& bsdf) {
    FloatV u_lobe(0.0F);
    if constexpr (Bsdf::has_specular || Bsdf::has_coat) u_lobe = sample_1d(g.key, w.bounce, Dim::lobe_choice);
    const Uniform2<FloatV> u = sample_2d(g.key, w.bounce, Dim::lobe_uv);
    const SurfaceSample<FloatV> sample = bsdf.sample(u_lobe, u.u, u.v);
    const Vec3<FloatV> wi = to_world(g.frame, sample.wi);
    Rgb<FloatV> throughput = g.throughput * sample.weight;
    // Rounding leaves a direction a few 1e-7 off unit length; what is further off, or not a number, is a defect.
    const Mask<FloatV> is_unit = abs(length_squared(wi) - FloatV(1.0F)) < FloatV(1e-3F);
    count(w, Guard::bad_direction, sample.valid & (!is_unit), g.lanes);
    // A direction that leaves by the shading normal but enters by the face would let light leak through.
    Mask<FloatV> alive = sample.valid & is_unit & (dot(g.geometric, wi) > FloatV(0.0F));
    const FloatV largest = max_component(throughput);
    const Mask<FloatV> sound = is_finite(largest);
    count(w, Guard::bad_weight, alive & (!sound), g.lanes);
    alive = alive & sound & (largest > FloatV(0.0F));
    if (w.bounce >= kRouletteStart) {
        const FloatV survive = clamp(largest * FloatV(kRouletteGain), FloatV(kRouletteFloor), FloatV(1.0F));
        alive = alive & (sample_1d(g.key, w.bounce, Dim::roulette) < survive);
        throughput = throughput * (FloatV(1.0F) / survive);
    }
    const std::uint32_t bits = lane_bits(alive) & g.lanes;
    if (bits == 0) return;
    PathColumns& p = w.paths;
    p.origin.store(g.first, g.origin);
    p.direction.store(g.first, wi);
    p.throughput.store(g.first, throughput);
    sample.pdf.store_aligned(&p.pdf[g.first]);
    g.key.key.store_aligned(&p.key[g.first]);
    g.key.reversed_index.store_aligned(&p.reversed_index[g.first]);
    UIntV::load_aligned(&w.surfaces.slot[g.first]).store_aligned(&p.slot[g.first]);
    w.living.push_lanes(static_cast<std::uint32_t>(g.first), bits);
}

void write_aovs(Worker& w, const Group& g, Rgb<FloatV> albedo) {
    SurfaceColumns& s = w.surfaces;
    SampleRows& samples = w.samples;
    alignas(kAlignment) float depth[kLanes], rgb[3][kLanes];
    (-dot(s.position.load(g.first), broadcast<FloatV>(w.scene.camera.back))).store_aligned(depth);
    albedo.r.store_aligned(rgb[0]);
    albedo.g.store_aligned(rgb[1]);
    albedo.b.store_aligned(rgb[2]);
    for (std::size_t k = 0; k < static_cast<std::size_t>(kLanes) && (g.lanes >> k & 1U) != 0; ++k) {
        const std::size_t row = g.first + k;
        const std::uint32_t slot = s.slot[row];
        samples.alpha[slot] = 1.0F;
        samples.depth[slot] = depth[k];
        if (!w.scene.with_aovs) continue;
        samples.normal.x[slot] = s.shading.x[row];
        samples.normal.y[slot] = s.shading.y[row];
        samples.normal.z[slot] = s.shading.z[row];
        samples.albedo.x[slot] = rgb[0][k];
        samples.albedo.y[slot] = rgb[1][k];
        samples.albedo.z[slot] = rgb[2][k];
        samples.position.x[slot] = s.position.x[row];
        samples.position.y[slot] = s.position.y[row];
        samples.position.z[slot] = s.position.z[row];
    }
}

// The whole run of one lobe set: the lobes are template arguments, nothing asks per point which ones there are.
template <class Specular, class Coat>
void scatter_run(Worker& w, RowRange run, Scattering what) {
    const SurfaceColumns& s = w.surfaces;
    for (std::size_t i = run.begin; i < run.end; i += kLanes) {
        const Vec3<FloatV> geometric = s.geometric.load(i);
        const Group g{.first = i,
                      .lanes = lanes_below(i, run.end),
                      .origin = s.position.load(i) + geometric * FloatV::load_aligned(&s.offset[i]),
                      .geometric = geometric,
                      .frame = make_frame(s.shading.load(i)),
                      .throughput = s.throughput.load_rgb(i),
                      .key = {UIntV::load_aligned(&s.key[i]), UIntV::load_aligned(&s.reversed_index[i])}};
        SurfaceParameters<FloatV> parameters = w.scene.materials.load<FloatV>(UIntV::load_aligned(&s.material[i]));
        parameters.base = s.color.load_rgb(i);
        const SurfaceBsdf<FloatV, Specular, Coat> bsdf(parameters, to_local(g.frame, s.wo.load(i)));
        if (what.write_aovs) write_aovs(w, g, bsdf.albedo());
        if (what.sample_lights) sample_towards_light(w, g, bsdf);
        if (what.continue_path) continue_path(w, g, bsdf);
    }
}

void scatter_lobe_set(Worker& w, LobeSet set, RowRange run, Scattering what) {
    using Glossy = GgxReflection<FloatV>;
    using Smooth = Mirror<FloatV>;
    switch (set) {
        case LobeSet::diffuse:
            return scatter_run<NoLobe, NoLobe>(w, run, what);
        case LobeSet::glossy:
            return scatter_run<Glossy, NoLobe>(w, run, what);
        case LobeSet::mirror:
            return scatter_run<Smooth, NoLobe>(w, run, what);
        case LobeSet::diffuse_coat:
            return scatter_run<NoLobe, Glossy>(w, run, what);
        case LobeSet::glossy_coat:
            return scatter_run<Glossy, Glossy>(w, run, what);
        case LobeSet::mirror_coat:
            return scatter_run<Smooth, Glossy>(w, run, what);
    }
}

}  // namespace

void scatter(Worker& w) noexcept {
    const RenderOptions& options = w.scene.options;
    w.living.clear();
    w.shadow_rays.clear();
    // The edge that reached these points is number bounce + 1; both kinds of sample add one.
    const bool another_edge = static_cast<int>(w.bounce) + 2 <= options.max_depth;
    const Scattering what{.sample_lights = another_edge && w.scene.sample_lights,
                          .continue_path = another_edge,
                          .write_aovs = w.bounce == 0};
    for (int set = 0; set < kLobeSets; ++set)
        if (w.lobe_set_runs[set].begin < w.lobe_set_runs[set].end)
            scatter_lobe_set(w, static_cast<LobeSet>(set), w.lobe_set_runs[set], what);
    w.living.pad();
    w.shadow_rays.pad();
}

}  // namespace footlight
