// One thread's batch and the pipeline run over it.
#pragma once

#include <memory>
#include <span>
#include <vector>

#include "pipeline/batch.h"
#include "pipeline/committed_scene.h"
#include "pipeline/ledger.h"

namespace footlight {

struct Worker;

// A stage of the pipeline: its place in the bill and its work on a batch.
struct Stage {
    StageId id;
    void (*run)(Worker&) noexcept;
};

// The stages that a scene's effects call for, in order; they repeat until no path of the batch lives.
struct Pipeline {
    std::vector<Stage> bounce;
};
Pipeline assemble_pipeline(const CommittedScene& scene);
std::vector<std::string> stage_names(const Pipeline& pipeline);

// Everything a stage may touch. Stages hand rows on through the lists: living -> misses, light_hits, surfaces ->
// living.
struct Worker {
    const CommittedScene& scene;
    const Pipeline& pipeline;
    Ledger ledger;
    std::uint32_t bounce = 0;

    std::size_t capacity;
    std::vector<SampleOwner> owners;  // by slot
    SampleRows samples;

    PathColumns paths;
    RowList living;
    Column<float> camera_tnear, camera_tfar;  // by row of paths, for camera rays
    Column<float> opacity_u;                  // by row of paths or shadow rays; only with Effect::opacity

    HitRows hits;
    RowList misses, light_hits;  // rows of hits
    RowList by_lobe_set[kLobeSets];

    SurfaceColumns surfaces;
    std::size_t surface_count = 0;
    RowRange lobe_set_runs[kLobeSets];  // of surfaces; each begins at a full register

    ShadowColumns shadows;
    RowList shadow_rays;
    std::vector<std::uint8_t> occluded;

    SortScratch sort_scratch;

    Worker(const CommittedScene& scene, const Pipeline& pipeline, std::size_t capacity);
    // Runs of lobe sets begin at full registers: room for one partly filled register each.
    [[nodiscard]] std::size_t rows() const { return capacity + kLobeSets * kLanes; }

    // Rows [0, count) of `owners` are filled: traces these samples and adds them to the film.
    void run(std::size_t count, Film& film);
};

// The stages. `generate` and `film` frame every batch; the others are chosen by assemble_pipeline.
void generate(Worker& worker) noexcept;
void draw_opacity(Worker& worker) noexcept;
void sort_paths(Worker& worker) noexcept;
void sort_paths_by_octant(Worker& worker) noexcept;
void intersect(Worker& worker) noexcept;
void escape(Worker& worker) noexcept;
void light_hit(Worker& worker) noexcept;
void emission(Worker& worker) noexcept;
void surface(Worker& worker) noexcept;
void scatter(Worker& worker) noexcept;
void sort_shadows(Worker& worker) noexcept;
void shadow(Worker& worker) noexcept;

}  // namespace footlight
