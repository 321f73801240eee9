// Stage: the nearest hit of every living ray, sorted into misses, lights and surfaces by lobe set.
#include "pipeline/worker.h"

namespace footlight {

void intersect(Worker& w) noexcept {
    const CommittedScene& scene = w.scene;
    PathColumns& p = w.paths;
    const bool camera = w.bounce == 0;
    const RayColumns rays{{p.origin.x.data(), p.origin.y.data(), p.origin.z.data()},
                          {p.direction.x.data(), p.direction.y.data(), p.direction.z.data()},
                          camera ? w.camera_tnear.data() : nullptr,
                          camera ? w.camera_tfar.data() : nullptr};
    const HitColumns hits{w.hits.id.data(), w.hits.instance.data(), w.hits.t.data(), w.hits.u.data(), w.hits.v.data()};
    const float* opacity_u = scene.effects.active(Effect::opacity) ? w.opacity_u.data() : nullptr;
    const double begin = thread_seconds();
    // Camera rays of one packet are neighbours in the image.
    scene.accel.intersect(rays, w.living.rows.data(), w.living.count, camera ? RayKind::camera : RayKind::bounce,
                          camera || scene.few_triangles, opacity_u, hits);
    w.ledger.embree_seconds += thread_seconds() - begin;
    w.ledger.closest_rays += w.living.count;

    w.misses.clear();
    w.light_hits.clear();
    for (RowList& list : w.by_lobe_set) list.clear();
    const std::uint32_t* mesh_of_triangle = scene.geometry.mesh_of_triangle.data();
    const LobeSet* lobe_set_of_mesh = scene.lobe_set_of_mesh.data();
    for (std::uint32_t i = 0; i < w.living.count; ++i) {
        const std::uint32_t id = w.hits.id[i];
        if (id == kMiss)
            w.misses.push(i);
        else if ((id & kLightBit) != 0)
            w.light_hits.push(i);
        else
            w.by_lobe_set[static_cast<std::size_t>(lobe_set_of_mesh[mesh_of_triangle[id]])].push(i);
    }
}

}  // namespace footlight
