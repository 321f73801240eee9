// Stage: camera rays for every sample of the batch.
#include <limits>

#include "pipeline/worker.h"

namespace footlight {

void generate(Worker& w) noexcept {
    PathColumns& paths = w.paths;
    const CommittedScene& scene = w.scene;
    const bool lens = scene.effects.active(Effect::depth_of_field);
    const std::size_t count = w.living.count;
    for (std::uint32_t i = 0; i < count; ++i) {
        const SampleOwner& owner = w.owners[i];
        w.living.rows[i] = i;
        paths.slot[i] = i;
        // Even samples belong to replicate 0, odd ones to replicate 1.
        paths.key[i] = pixel_key(scene.options.seed, owner.x, owner.y, owner.sample & 1U);
        paths.reversed_index[i] = reverse_bits(owner.sample >> 1);
    }
    w.living.pad();
    for (std::size_t i = 0; i < count; i += kLanes) {
        const PathKey<FloatV> key{UIntV::load_aligned(&paths.key[i]), UIntV::load_aligned(&paths.reversed_index[i])};
        alignas(kAlignment) float px[kLanes], py[kLanes];
        for (std::size_t k = 0; k < static_cast<std::size_t>(kLanes); ++k) {
            const SampleOwner& owner = w.owners[std::min(i + k, count - 1)];
            px[k] = static_cast<float>(owner.x) + 0.5F;
            py[k] = static_cast<float>(owner.y) + 0.5F;
        }
        const Uniform2<FloatV> u = sample_2d(key, 0, Dim::pixel);
        const FloatV x = FloatV::load_aligned(px) + scene.filter.sample(u.u);
        const FloatV y = FloatV::load_aligned(py) + scene.filter.sample(u.v);
        CameraRay<FloatV> ray;
        if (lens) {
            const Uniform2<FloatV> on_lens = sample_2d(key, 0, Dim::lens);
            ray = lens_ray(scene.camera, x, y, on_lens.u, on_lens.v);
        } else {
            ray = pinhole_ray(scene.camera, x, y);
        }
        paths.origin.store(i, ray.origin);
        paths.direction.store(i, ray.direction);
        paths.throughput.store(i, gray(FloatV(1.0F)));
        FloatV(0.0F).store_aligned(&paths.pdf[i]);
        ray.tnear.store_aligned(&w.camera_tnear[i]);
        ray.tfar.store_aligned(&w.camera_tfar[i]);
        w.samples.radiance.store(i, gray(FloatV(0.0F)));
        FloatV(0.0F).store_aligned(&w.samples.alpha[i]);
        FloatV(std::numeric_limits<float>::infinity()).store_aligned(&w.samples.depth[i]);
        if (scene.with_aovs) {
            w.samples.normal.store(i, gray(FloatV(0.0F)));
            w.samples.albedo.store(i, gray(FloatV(0.0F)));
            w.samples.position.store(i, gray(FloatV(0.0F)));
        }
    }
}

void draw_opacity(Worker& w) noexcept {
    for (std::size_t i = 0; i < w.living.count; i += kLanes) {
        const UIntV rows = w.living.load(i);
        const PathKey<FloatV> key{gather_uint<FloatV>(w.paths.key.data(), rows),
                                  gather_uint<FloatV>(w.paths.reversed_index.data(), rows)};
        alignas(kAlignment) float u[kLanes];
        sample_1d(key, w.bounce, Dim::opacity).store_aligned(u);
        for (std::size_t k = i; k < std::min(i + kLanes, w.living.count); ++k) w.opacity_u[w.living.rows[k]] = u[k - i];
    }
}

}  // namespace footlight
