// A render: commit, and the work handed to threads in units of one batch.
#include "pipeline/renderer.h"

#include <immintrin.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include <tbb/enumerable_thread_specific.h>
#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

namespace footlight {

namespace {

// Paths per batch. Of 2048 paths, whose columns (about 300 bytes a path) would stay in a core's L2 cache, too few are
// left after some bounces to fill the packets of eight octants: 8192 are 5 % faster, 16384 are not.
constexpr std::size_t kBatchSize = 8192;
// Above this many triangles rays miss the caches in the BVH, and a large sorted batch is worth its memory traffic.
constexpr std::size_t kSortTriangles = 200'000;
constexpr std::size_t kSortedBatchSize = 16'384;
// Up to so many triangles a packet of bounce rays that share an octant walks the BVH as one: a quarter less time per
// ray for 36 triangles, a tenth for 82, none for 210.
constexpr std::size_t kFewTriangles = 128;
// Small slices are cut so that each thread has several units, but none of fewer paths than this.
constexpr std::size_t kUnitsPerThread = 4;
constexpr std::size_t kSmallestUnit = 2048;

// Flush-to-zero and denormals-are-zero for the lifetime of the object, on this thread only.
class FlushDenormals {
  public:
    FlushDenormals() : saved_(_mm_getcsr()) { _mm_setcsr(saved_ | 0x8040U); }
    ~FlushDenormals() { _mm_setcsr(saved_); }
    FlushDenormals(const FlushDenormals&) = delete;
    FlushDenormals& operator=(const FlushDenormals&) = delete;

  private:
    unsigned saved_;
};

void check(const RenderOptions& o) {
    const auto refuse = [](const std::string& text) { throw std::invalid_argument(text); };
    if (o.width < 1 || o.height < 1 || o.width > 65535 || o.height > 65535)
        refuse("size is " + std::to_string(o.width) + "x" + std::to_string(o.height) + "; allowed: 1 to 65535 each");
    if (o.max_depth < 1) refuse("max_depth is " + std::to_string(o.max_depth) + "; allowed: 1 and above");
    if (!(o.filter_width >= 0 && o.filter_width <= 64))
        refuse("filter_width is " + std::to_string(o.filter_width) + "; allowed: 0 to 64 pixels");
    if (o.threads < 0) refuse("threads is " + std::to_string(o.threads) + "; allowed: 0 (all) and above");
}

double filter_width(const RenderOptions& o) {
    if (o.filter_width > 0) return o.filter_width;
    return kPixelFilters[static_cast<std::size_t>(o.pixel_filter)].default_width;
}

// Makes the opaque faces of the world's emissive meshes lights of the table, so that they can be sampled.
void add_emissive_triangles(LightTable& table, Geometry& geometry, const std::vector<PreviewSurface>& materials) {
    for (const TriangleRange& range : geometry.groups[0].ranges) {
        if (range.has_opacity) continue;
        for (std::uint32_t t = range.first; t < range.first + range.count; ++t) {
            const PreviewSurface& material = materials[geometry.meshes.material[geometry.mesh_of_triangle[t]]];
            if (!has_emission(material)) continue;
            TriangleLightDesc desc;
            desc.path = material.path;
            desc.emission = {material.emissive_color.r, material.emissive_color.g, material.emissive_color.b};
            for (std::size_t c = 0; c < 3; ++c) {
                const float* p = &geometry.positions[std::size_t{geometry.indices[t * std::size_t{3} + c]} * 3];
                desc.corners[c] = {p[0], p[1], p[2]};
            }
            if (!append_triangle(table, desc).empty()) continue;
            geometry.light_of_triangle.resize(geometry.triangle_count(), kNoLight);
            geometry.light_of_triangle[t] = table.size() - 1;
        }
    }
}

LightTable build_lights(const Scene& scene, Geometry& geometry, Vec3<double> origin, double scene_radius,
                        Strategy strategy, std::vector<LeftOut>& left_out) {
    LightTable table;
    for (AnyLight light : scene.lights()) {
        LightDesc& desc = common(light);
        desc.transform = relative_to(desc.transform, origin);
        if (auto* dome = std::get_if<DomeLightDesc>(&light)) dome->compensate = strategy == Strategy::mis;
        if (const std::string reason = append(table, light); !reason.empty()) left_out.push_back({desc.path, reason});
    }
    add_emissive_triangles(table, geometry, scene.materials());
    finalize(table, scene_radius);
    for (const LightInfo& info : table.info)
        if (!info.note.empty()) left_out.push_back({info.path, info.note});
    return table;
}

// Lights have a size too: what infinite lights send through the scene counts against them.
double light_extent(const Scene& scene, Vec3<double> origin) {
    double extent = 0;
    for (const AnyLight& light : scene.lights())
        if (!std::holds_alternative<DomeLightDesc>(light) && !std::holds_alternative<DistantLightDesc>(light))
            extent = std::max(extent, length(translation(common(light).transform) - origin));
    return extent;
}

// 8x8 blocks in Morton order: neighbours in a batch are neighbours in the image.
void append_pixels(std::vector<Pixel>& order, const Rect& tile) {
    for (unsigned code = 0; code < kTileSize * kTileSize; ++code) {
        unsigned x = 0, y = 0;
        for (unsigned b = 0; b < 6; ++b) {
            x |= (code >> (2 * b) & 1U) << b;
            y |= (code >> (2 * b + 1) & 1U) << b;
        }
        if (static_cast<int>(x) < tile.width && static_cast<int>(y) < tile.height)
            order.push_back({static_cast<std::uint16_t>(tile.x + static_cast<int>(x)),
                             static_cast<std::uint16_t>(tile.y + static_cast<int>(y))});
    }
}

}  // namespace

class Renderer::Pool {
  public:
    Pool(const CommittedScene& scene, const Pipeline& pipeline, std::size_t batch_size, int threads)
        : arena(threads > 0 ? threads : tbb::task_arena::automatic),
          workers([&scene, &pipeline, batch_size] { return std::make_unique<Worker>(scene, pipeline, batch_size); }) {}
    tbb::task_arena arena;
    tbb::enumerable_thread_specific<std::unique_ptr<Worker>> workers;
};

Renderer::Renderer(const Scene& scene, RenderOptions options)
    : options_(std::move(options)), filter_(options_.pixel_filter, filter_width(options_)) {
    check(options_);
    const Camera& camera = scene.camera();
    const Vec3<double> origin = translation(camera.camera_to_world);
    effects_ = derive_effects(scene, options_.force_effects);
    camera_ = make_camera_rays(camera, options_.width, options_.height);
    materials_ =
        build_material_table(scene.materials(), effects_[Effect::specular].forced, effects_[Effect::coat].forced);
    tbb::task_arena arena(options_.threads > 0 ? options_.threads : tbb::task_arena::automatic);
    arena.execute([&] {
        geometry_ = build_geometry(scene, origin);
        left_out_ = geometry_.left_out;
        const double radius = std::max(geometry_.scene_radius(), light_extent(scene, origin));
        lights_ = build_lights(scene, geometry_, origin, radius, options_.strategy, left_out_);
        accel_ = std::make_unique<Accel>(geometry_, lights_);
    });
    for (const std::uint32_t material : geometry_.meshes.material)
        lobe_set_of_mesh_.push_back(materials_.lobe_set[material]);

    constexpr AovSet kHitAovs = bit(Aov::normal) | bit(Aov::albedo) | bit(Aov::position);
    const bool delta_lights = std::any_of(lights_.infinite.begin(), lights_.infinite.end(), [&](std::uint32_t i) {
        return lights_.info[i].kind == LightKind::distant && broadcast_row<float>(lights_, i).size_u == 0;
    });
    committed_ = std::make_unique<CommittedScene>(CommittedScene{
        .options = options_,
        .effects = effects_,
        .camera = camera_,
        .filter = filter_,
        .geometry = geometry_,
        .materials = materials_,
        .lobe_set_of_mesh = lobe_set_of_mesh_,
        .lights = lights_,
        .accel = *accel_,
        .exposure = static_cast<float>(camera.exposure_scale),
        .with_aovs = (options_.aovs & kHitAovs) != 0,
        .sort_rays = geometry_.triangle_count() > kSortTriangles,
        .few_triangles = geometry_.triangle_count() <= kFewTriangles && geometry_.instances.empty(),
        .sample_lights = lights_.any_sampled() && (options_.strategy != Strategy::bsdf || delta_lights),
    });
    pipeline_ = assemble_pipeline(*committed_);
    film_ = std::make_unique<Film>(options_.width, options_.height, options_.aovs, origin);
    tiles_x_ = (options_.width + kTileSize - 1) / kTileSize;
    tiles_y_ = (options_.height + kTileSize - 1) / kTileSize;
    batch_size_ = committed_->sort_rays ? kSortedBatchSize : kBatchSize;
    pool_ = std::make_unique<Pool>(*committed_, pipeline_, batch_size_, options_.threads);
}

Renderer::~Renderer() = default;

Rect Renderer::tile(int index) const {
    const int x = index % tiles_x_ * kTileSize, y = index / tiles_x_ * kTileSize;
    return {x, y, std::min(kTileSize, options_.width - x), std::min(kTileSize, options_.height - y)};
}

bool Renderer::render(std::uint32_t sample_begin, std::uint32_t sample_end, int tile_begin, int tile_end) {
    if (sample_end <= sample_begin || tile_end <= tile_begin) return !cancelled_;
    const std::size_t samples = sample_end - sample_begin;
    // Large batches must still leave every thread several units, or the last one is waited for.
    const std::size_t pixels = static_cast<std::size_t>(tile_end - tile_begin) * kTileSize * kTileSize;
    const auto threads = static_cast<std::size_t>(pool_->arena.max_concurrency());
    const std::size_t share = std::max(kSmallestUnit, pixels * samples / (threads * kUnitsPerThread));
    const std::size_t pixels_per_unit = std::max<std::size_t>(1, std::min(batch_size_, share) / samples);
    std::vector<Pixel> order;
    for (int t = tile_begin; t < tile_end; ++t) append_pixels(order, tile(t));
    std::vector<std::span<const Pixel>> units;
    for (std::size_t i = 0; i < order.size(); i += pixels_per_unit)
        units.push_back(std::span(order).subspan(i, std::min(pixels_per_unit, order.size() - i)));
    pool_->arena.execute([&] {
        tbb::parallel_for(std::size_t{0}, units.size(), [&](std::size_t i) {
            if (!cancelled_) run_unit(units[i], sample_begin, sample_end);
        });
    });
    return !cancelled_;
}

void Renderer::run_unit(std::span<const Pixel> pixels, std::uint32_t sample_begin, std::uint32_t sample_end) {
    const FlushDenormals flush;
    Worker& worker = *pool_->workers.local();
    std::size_t count = 0;
    for (const auto& [x, y] : pixels)
        for (std::uint32_t s = sample_begin; s < sample_end; ++s) {
            worker.owners[count++] = {x, y, s};
            if (count == worker.capacity) {
                worker.run(count, *film_);
                count = 0;
            }
        }
    if (count > 0) worker.run(count, *film_);
}

Ledger Renderer::ledger() const {
    Ledger total;
    for (const auto& worker : pool_->workers) total.add(worker->ledger);
    return total;
}

SceneCounts Renderer::counts() const {
    const std::size_t geometry =
        (geometry_.positions.size() + geometry_.normals.size() + geometry_.colors.size()) * sizeof(float) +
        (geometry_.indices.size() + geometry_.mesh_of_triangle.size() + geometry_.normal_corners.size() +
         geometry_.color_corners.size()) *
            sizeof(std::uint32_t);
    return {geometry_.triangle_count(), geometry_.instances.size(), lights_.size(), geometry, accel_->bytes()};
}

}  // namespace footlight
