// Stage: shadow rays, and the light of those that get through.
#include "pipeline/worker.h"

namespace footlight {

void shadow(Worker& w) noexcept {
    const CommittedScene& scene = w.scene;
    const ShadowColumns& s = w.shadows;
    const RowList& list = w.shadow_rays;
    const bool opacity = scene.effects.active(Effect::opacity);
    if (opacity)
        for (std::size_t i = 0; i < list.count; i += kLanes) {
            const UIntV rows = list.load(i);
            const PathKey<FloatV> key{gather_uint<FloatV>(w.surfaces.key.data(), rows),
                                      gather_uint<FloatV>(w.surfaces.reversed_index.data(), rows)};
            alignas(kAlignment) float u[kLanes];
            sample_1d(key, w.bounce, Dim::shadow_opacity).store_aligned(u);
            for (std::size_t k = i; k < std::min(i + kLanes, list.count); ++k) w.opacity_u[list.rows[k]] = u[k - i];
        }
    const RayColumns rays{{s.origin.x.data(), s.origin.y.data(), s.origin.z.data()},
                          {s.direction.x.data(), s.direction.y.data(), s.direction.z.data()},
                          nullptr,
                          s.tfar.data()};
    const double begin = thread_seconds();
    scene.accel.occluded(rays, list.rows.data(), list.count, s.light.data(), opacity ? w.opacity_u.data() : nullptr,
                         w.occluded.data());
    w.ledger.embree_seconds += thread_seconds() - begin;
    w.ledger.shadow_rays += list.count;
    for (std::size_t i = 0; i < list.count; ++i) {
        if (w.occluded[i] != 0) continue;
        const std::uint32_t row = list.rows[i];
        const std::uint32_t slot = w.surfaces.slot[row];
        w.samples.radiance.x[slot] += s.contribution.x[row];
        w.samples.radiance.y[slot] += s.contribution.y[row];
        w.samples.radiance.z[slot] += s.contribution.z[row];
    }
}

}  // namespace footlight
