// Stages: light that paths run into, on lights (light_hit), emissive surfaces (emission) and the sky (escape).
#include "light/mis.h"
#include "pipeline/worker.h"

namespace footlight {

namespace {

// Weight of light found by following the BSDF, against finding it by sampling lights.
FloatV found_weight(Strategy strategy, FloatV bsdf_pdf, FloatV light_pdf) {
    // pdf 0 marks rays that nothing else could have drawn: from the camera or a mirror.
    const Mask<FloatV> alone = bsdf_pdf == FloatV(0.0F);
    switch (strategy) {
        case Strategy::light:
            return select(alone, FloatV(1.0F), FloatV(0.0F));
        case Strategy::bsdf:
            return FloatV(1.0F);
        case Strategy::mis:
            break;
    }
    return select(alone, FloatV(1.0F), balance_heuristic(bsdf_pdf, light_pdf));
}

struct Arrivals {
    UIntV path;
    Vec3<FloatV> origin, direction;
    Rgb<FloatV> throughput;
    FloatV pdf;
};

Arrivals load_arrivals(const Worker& w, UIntV hit_rows) {
    const UIntV path = gather_uint<FloatV>(w.living.rows.data(), hit_rows);
    const Vec3<FloatV> throughput = w.paths.throughput.gather_rows(path);
    return {path,
            w.paths.origin.gather_rows(path),
            w.paths.direction.gather_rows(path),
            {throughput.x, throughput.y, throughput.z},
            gather<FloatV>(w.paths.pdf.data(), path)};
}

void add_radiance(Worker& w, UIntV path, Rgb<FloatV> radiance, std::size_t lanes) {
    alignas(kAlignment) float r[kLanes], g[kLanes], b[kLanes];
    alignas(kAlignment) std::uint32_t rows[kLanes];
    radiance.r.store_aligned(r);
    radiance.g.store_aligned(g);
    radiance.b.store_aligned(b);
    path.store_aligned(rows);
    for (std::size_t k = 0; k < lanes; ++k) {
        const std::uint32_t slot = w.paths.slot[rows[k]];
        w.samples.radiance.x[slot] += r[k];
        w.samples.radiance.y[slot] += g[k];
        w.samples.radiance.z[slot] += b[k];
    }
}

}  // namespace

void light_hit(Worker& w) noexcept {
    const CommittedScene& scene = w.scene;
    w.light_hits.pad();
    for (std::size_t i = 0; i < w.light_hits.count; i += kLanes) {
        const UIntV hit = w.light_hits.load(i);
        const Arrivals a = load_arrivals(w, hit);
        const UIntV light = gather_uint<FloatV>(w.hits.id.data(), hit) & UIntV(~kLightBit);
        const FloatV t = gather<FloatV>(w.hits.t.data(), hit);
        const LightHit<FloatV> found = hit_light<FloatV>(scene.lights, light, a.origin, a.direction, t);
        const FloatV weight =
            found_weight(scene.options.strategy, a.pdf, found.pdf * select_pmf<FloatV>(scene.lights, light));
        const std::size_t lanes = std::min<std::size_t>(kLanes, w.light_hits.count - i);
        add_radiance(w, a.path, a.throughput * found.radiance * weight, lanes);
        if (w.bounce > 0) continue;
        const FloatV depth = -dot(a.origin + a.direction * t, broadcast<FloatV>(scene.camera.back));
        alignas(kAlignment) float depths[kLanes];
        depth.store_aligned(depths);
        alignas(kAlignment) std::uint32_t rows[kLanes];
        a.path.store_aligned(rows);
        for (std::size_t k = 0; k < lanes; ++k) {
            const std::uint32_t slot = w.paths.slot[rows[k]];
            w.samples.alpha[slot] = 1.0F;
            w.samples.depth[slot] = depths[k];
            if (!scene.with_aovs) continue;
            const std::uint32_t row = rows[k];
            const float distance = w.hits.t[w.light_hits.rows[i + k]];
            w.samples.position.x[slot] = w.paths.origin.x[row] + w.paths.direction.x[row] * distance;
            w.samples.position.y[slot] = w.paths.origin.y[row] + w.paths.direction.y[row] * distance;
            w.samples.position.z[slot] = w.paths.origin.z[row] + w.paths.direction.z[row] * distance;
        }
    }
}

void emission(Worker& w) noexcept {
    const CommittedScene& scene = w.scene;
    const Geometry& geometry = scene.geometry;
    const bool faces_are_lights = !geometry.light_of_triangle.empty();
    for (RowList& list : w.by_lobe_set) {
        list.pad();
        for (std::size_t i = 0; i < list.count; i += kLanes) {
            const UIntV hit = list.load(i);
            const UIntV triangle = gather_uint<FloatV>(w.hits.id.data(), hit);
            const UIntV mesh = gather_uint<FloatV>(geometry.mesh_of_triangle.data(), triangle);
            const Rgb<FloatV> emitted =
                scene.materials.load_emission<FloatV>(gather_uint<FloatV>(geometry.meshes.material.data(), mesh));
            if (!any(max_component(emitted) > FloatV(0.0F))) continue;
            const Arrivals a = load_arrivals(w, hit);
            FloatV weight(1.0F);
            if (faces_are_lights) {
                const UIntV light = gather_uint<FloatV>(geometry.light_of_triangle.data(), triangle);
                // Emission that is no light, of instances say, has no other strategy to share its weight with.
                const Mask<FloatV> alone = equal<FloatV>(light, UIntV(kNoLight));
                const UIntV row = select(alone, UIntV(0U), light);
                const FloatV t = gather<FloatV>(w.hits.t.data(), hit);
                const FloatV pdf = hit_light<FloatV>(scene.lights, row, a.origin, a.direction, t).pdf *
                                   select_pmf<FloatV>(scene.lights, row);
                weight = select(alone, weight, found_weight(scene.options.strategy, a.pdf, pdf));
            }
            add_radiance(w, a.path, a.throughput * emitted * weight, std::min<std::size_t>(kLanes, list.count - i));
        }
    }
}

void escape(Worker& w) noexcept {
    const CommittedScene& scene = w.scene;
    w.misses.pad();
    for (std::size_t i = 0; i < w.misses.count; i += kLanes) {
        const Arrivals a = load_arrivals(w, w.misses.load(i));
        Rgb<FloatV> radiance = gray(FloatV(0.0F));
        for (const std::uint32_t light : scene.lights.infinite) {
            if (w.bounce == 0 && !scene.lights.info[light].visible_to_camera) continue;
            const LightHit<FloatV> found = escape_light<FloatV>(scene.lights, light, a.direction);
            // What is never sampled has no other strategy to share its weight with.
            const float pmf = scene.lights.info[light].sampled ? select_pmf<float>(scene.lights, light) : 0.0F;
            const FloatV weight = found_weight(scene.options.strategy, a.pdf, found.pdf * FloatV(pmf));
            radiance = radiance + found.radiance * weight;
        }
        add_radiance(w, a.path, a.throughput * radiance, std::min<std::size_t>(kLanes, w.misses.count - i));
    }
}

}  // namespace footlight
