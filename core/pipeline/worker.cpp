// One thread's batch: its columns, the pipeline run over it, and the way of its samples to the film.
#include "pipeline/worker.h"

#include <cmath>

namespace footlight {

Worker::Worker(const CommittedScene& scene_in, const Pipeline& pipeline_in, std::size_t capacity_in)
    : scene(scene_in),
      pipeline(pipeline_in),
      capacity(capacity_in),
      owners(capacity_in),
      samples(rows(), scene_in.with_aovs),
      paths(rows()),
      living(rows()),
      camera_tnear(make_column<float>(rows())),
      camera_tfar(make_column<float>(rows())),
      opacity_u(make_column<float>(scene_in.effects.active(Effect::opacity) ? rows() : 0)),
      hits(rows()),
      misses(rows()),
      light_hits(rows()),
      by_lobe_set{RowList(rows()), RowList(rows()), RowList(rows()), RowList(rows()), RowList(rows()), RowList(rows())},
      surfaces(rows()),
      shadows(rows()),
      shadow_rays(rows()),
      occluded(rows()),
      sort_scratch(rows()) {}

namespace {

void bill(Worker& w, StageId id, void (*stage)(Worker&) noexcept) {
    const double begin = thread_seconds();
    stage(w);
    w.ledger.seconds[static_cast<std::size_t>(id)] += thread_seconds() - begin;
}

// A sample that is not a number is counted and left out of the sum, but stays a sample.
void drop_bad_samples(Worker& w, std::size_t count) {
    Column3& radiance = w.samples.radiance;
    for (std::size_t i = 0; i < count; ++i)
        if (!std::isfinite(radiance.x[i] + radiance.y[i] + radiance.z[i])) {
            radiance.x[i] = radiance.y[i] = radiance.z[i] = 0.0F;
            ++w.ledger.guard(Guard::bad_radiance);
        }
}

void add_to_film(Worker& w, std::size_t count, Film& film) {
    SampleRows& s = w.samples;
    if (w.scene.exposure != 1.0F)
        for (std::size_t i = 0; i < count; ++i) {
            s.radiance.x[i] *= w.scene.exposure;
            s.radiance.y[i] *= w.scene.exposure;
            s.radiance.z[i] *= w.scene.exposure;
        }
    drop_bad_samples(w, count);
    const auto pointers = [](const Column3& c) {
        return std::array<const float*, 3>{c.x.data(), c.y.data(), c.z.data()};
    };
    const SampleColumns columns{.radiance = pointers(s.radiance),
                                .alpha = s.alpha.data(),
                                .depth = s.depth.data(),
                                .normal = pointers(s.normal),
                                .albedo = pointers(s.albedo),
                                .position = pointers(s.position)};
    for (std::uint32_t i = 0; i < count; ++i) {
        const SampleOwner& owner = w.owners[i];
        film.add(owner.x, owner.y, owner.sample, columns, i);
    }
}

}  // namespace

void Worker::run(std::size_t count, Film& film) {
    living.count = count;
    bill(*this, StageId::generate, generate);
    for (bounce = 0; static_cast<int>(bounce) < scene.options.max_depth && living.count > 0; ++bounce)
        for (const Stage& stage : pipeline.bounce) bill(*this, stage.id, stage.run);
    const double begin = thread_seconds();
    add_to_film(*this, count, film);
    ledger.samples += count;
    ledger.seconds[static_cast<std::size_t>(StageId::film)] += thread_seconds() - begin;
}

Pipeline assemble_pipeline(const CommittedScene& scene) {
    const Effects& effects = scene.effects;
    Pipeline pipeline;
    const auto add = [&](StageId id, void (*run)(Worker&) noexcept, bool wanted = true) {
        if (wanted) pipeline.bounce.push_back({id, run});
    };
    add(StageId::opacity, draw_opacity, effects.active(Effect::opacity));
    add(StageId::sort, scene.sort_rays ? sort_paths : sort_paths_by_octant);
    add(StageId::intersect, intersect);
    add(StageId::escape, escape, effects.active(Effect::dome) || effects.active(Effect::distant_lights));
    add(StageId::light_hit, light_hit, effects.active(Effect::area_lights));
    add(StageId::emission, emission, effects.active(Effect::emission));
    add(StageId::surface, surface);
    add(StageId::scatter, scatter);
    add(StageId::sort, sort_shadows, scene.sort_rays && scene.sample_lights);
    add(StageId::shadow, shadow, scene.sample_lights);
    return pipeline;
}

std::vector<std::string> stage_names(const Pipeline& pipeline) {
    const auto name = [](StageId id) { return std::string(kStageNames[static_cast<std::size_t>(id)]); };
    std::vector<std::string> names{name(StageId::generate)};
    for (const Stage& stage : pipeline.bounce) names.push_back(name(stage.id));
    names.push_back(name(StageId::film));
    return names;
}

}  // namespace footlight
