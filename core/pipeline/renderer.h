// A render: the committed scene and its film, traced tile by tile in any order.
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "pipeline/committed_scene.h"
#include "pipeline/ledger.h"
#include "pipeline/worker.h"

namespace footlight {

// Side of the tiles in which an image is rendered and sent [pixels].
inline constexpr int kTileSize = 64;

struct Rect {
    int x, y, width, height;  // [pixels], origin top left
};

struct Pixel {
    std::uint16_t x, y;
};

struct SceneCounts {
    std::size_t triangles, instances, lights, geometry_bytes, bvh_bytes;
};

class Renderer {
  public:
    // Commits the scene: tables, BVH, light choice. Throws std::invalid_argument for options out of range.
    Renderer(const Scene& scene, RenderOptions options);
    ~Renderer();
    Renderer(const Renderer&) = delete;
    Renderer& operator=(const Renderer&) = delete;

    [[nodiscard]] int tiles() const { return tiles_x_ * tiles_y_; }
    [[nodiscard]] Rect tile(int index) const;

    // Samples [sample_begin, sample_end) of tiles [tile_begin, tile_end), row-major from the top left. Each sample of a
    // tile once; in any order and any grouping the film's bits are the same. False if cancelled. One caller at a time.
    bool render(std::uint32_t sample_begin, std::uint32_t sample_end, int tile_begin, int tile_end);
    // From any thread; render() returns soon and every later call returns false at once.
    void cancel() { cancelled_ = true; }

    [[nodiscard]] Film& film() { return *film_; }
    [[nodiscard]] const Effects& effects() const { return effects_; }
    [[nodiscard]] std::vector<std::string> pipeline() const { return stage_names(pipeline_); }
    [[nodiscard]] Ledger ledger() const;
    [[nodiscard]] SceneCounts counts() const;
    [[nodiscard]] const std::vector<LeftOut>& left_out() const { return left_out_; }

  private:
    class Pool;
    // One thread renders these pixels: no other touches their sums.
    void run_unit(std::span<const Pixel> pixels, std::uint32_t sample_begin, std::uint32_t sample_end);

    RenderOptions options_;
    Effects effects_;
    std::vector<LeftOut> left_out_;
    CameraRays camera_;
    FilterSampler filter_;
    Geometry geometry_;
    MaterialTable materials_;
    std::vector<LobeSet> lobe_set_of_mesh_;
    LightTable lights_;
    std::unique_ptr<Accel> accel_;
    std::unique_ptr<CommittedScene> committed_;
    Pipeline pipeline_;
    std::unique_ptr<Film> film_;
    int tiles_x_, tiles_y_;
    std::size_t batch_size_;
    std::unique_ptr<Pool> pool_;
    std::atomic<bool> cancelled_{false};
};

}  // namespace footlight
