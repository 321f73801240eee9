// Python binding of Renderer: commit, samples of tiles, images, the bill.
#include <nanobind/stl/array.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/string_view.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <chrono>
#include <stdexcept>
#include <string>

#include "pipeline/renderer.h"
#include "python/arrays.h"
#include "python/bindings.h"

namespace footlight {

namespace {

using namespace nb::literals;

template <class List>
std::string names_of(const List& list) {
    std::string names;
    for (const auto& entry : list) names += (names.empty() ? "" : ", ") + std::string(entry.name);
    return names;
}

template <class List>
const auto& find_name(const List& list, const std::string& name, const char* option) {
    for (const auto& entry : list)
        if (entry.name == name) return entry;
    throw std::invalid_argument(std::string(option) + ": unknown '" + name + "'; allowed: " + names_of(list));
}

Aov aov_of(const std::string& name) { return find_name(kAovs, name, "aov").aov; }

RenderOptions make_options(int width, int height, std::uint32_t seed, int max_depth, const std::string& pixel_filter,
                           double filter_width, const std::string& strategy, const std::vector<std::string>& aovs,
                           int threads, const std::vector<std::string>& force_effects) {
    RenderOptions options{.width = width,
                          .height = height,
                          .seed = seed,
                          .max_depth = max_depth,
                          .pixel_filter = find_name(kPixelFilters, pixel_filter, "pixel_filter").filter,
                          .filter_width = filter_width,
                          .strategy = find_name(kStrategies, strategy, "strategy").strategy,
                          .threads = threads,
                          .force_effects = force_effects};
    for (const std::string& name : aovs) options.aovs |= bit(aov_of(name));
    return options;
}

// The renderer with the seconds its commit took.
struct PyRenderer {
    Renderer renderer;
    double commit_seconds;
};

void construct(PyRenderer* self, const Scene& scene, const RenderOptions& options) {
    const nb::gil_scoped_release release;
    const auto begin = std::chrono::steady_clock::now();
    auto* renderer = new (&self->renderer) Renderer(scene, options);
    static_cast<void>(renderer);
    self->commit_seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
}

Film& film_with(PyRenderer& self, Aov aov) {
    Film& film = self.renderer.film();
    if (aov != Aov::color && aov != Aov::error && aov != Aov::sample_count && !contains(film.aovs(), aov))
        throw std::invalid_argument("aov: '" + std::string(aov_info(aov).name) +
                                    "' was not asked for in RenderOptions.aovs");
    return film;
}

nb::ndarray<nb::numpy, float> read_rect(PyRenderer& self, const std::string& name, const Rect& rect) {
    const Aov aov = aov_of(name);
    Film& film = film_with(self, aov);
    std::vector<float> values;
    {
        const nb::gil_scoped_release release;
        values = film.read(aov, rect.x, rect.y, rect.width, rect.height);
    }
    return to_numpy(std::move(values), {static_cast<std::size_t>(rect.height), static_cast<std::size_t>(rect.width),
                                        static_cast<std::size_t>(aov_info(aov).channels)});
}

bool render(PyRenderer& self, std::uint32_t sample_begin, std::uint32_t sample_end, int tile_begin, int tile_end) {
    if (tile_begin < 0 || tile_end > self.renderer.tiles())
        throw std::invalid_argument("tiles " + std::to_string(tile_begin) + " to " + std::to_string(tile_end) +
                                    "; allowed: 0 to " + std::to_string(self.renderer.tiles()));
    const nb::gil_scoped_release release;
    return self.renderer.render(sample_begin, sample_end, tile_begin, tile_end);
}

int checked_tile(PyRenderer& self, int tile) {
    if (tile < 0 || tile >= self.renderer.tiles())
        throw std::invalid_argument("tile " + std::to_string(tile) + "; allowed: 0 to " +
                                    std::to_string(self.renderer.tiles() - 1));
    return tile;
}

nb::list effect_list(const Effects& effects) {
    nb::list result;
    for (const EffectInfo& info : kEffects) {
        const EffectState& state = effects[info.effect];
        nb::dict entry;
        entry["name"] = info.name;
        entry["active"] = state.active();
        std::string reason(state.called_for ? info.adds : info.absent);
        if (!state.called_for && state.forced) reason = "forced; " + reason;
        if (state.path_count > state.paths.size())
            reason += "; asked for by " + std::to_string(state.path_count) + " prims";
        entry["reason"] = reason;
        entry["paths"] = state.paths;
        result.append(entry);
    }
    return result;
}

nb::dict stats(PyRenderer& self) {
    const Ledger ledger = self.renderer.ledger();
    const SceneCounts counts = self.renderer.counts();
    nb::dict cpu, rays, guards, bytes, result;
    for (const std::string& stage : self.renderer.pipeline())
        for (std::size_t i = 0; i < kStageNames.size(); ++i)
            if (kStageNames[i] == stage) cpu[stage.c_str()] = ledger.seconds[i];
    rays["closest"] = ledger.closest_rays;
    rays["shadow"] = ledger.shadow_rays;
    for (std::size_t i = 0; i < kGuardNames.size(); ++i) guards[std::string(kGuardNames[i]).c_str()] = ledger.guards[i];
    bytes["geometry"] = counts.geometry_bytes;
    bytes["bvh"] = counts.bvh_bytes;
    result["cpu_seconds"] = cpu;
    result["embree_cpu_seconds"] = ledger.embree_seconds;
    result["rays"] = rays;
    result["samples"] = ledger.samples;
    result["guards"] = guards;
    result["bytes"] = bytes;
    result["triangles"] = counts.triangles;
    result["instances"] = counts.instances;
    result["lights"] = counts.lights;
    return result;
}

}  // namespace

void bind_renderer(nb::module_& module) {
    nb::class_<RenderOptions>(module, "RenderOptions", "What shapes the image besides the scene.")
        .def(
            "__init__",
            [](RenderOptions* self, int width, int height, std::uint32_t seed, int max_depth,
               const std::string& pixel_filter, double filter_width, const std::string& strategy,
               const std::vector<std::string>& aovs, int threads, const std::vector<std::string>& force_effects) {
                new (self) RenderOptions(make_options(width, height, seed, max_depth, pixel_filter, filter_width,
                                                      strategy, aovs, threads, force_effects));
            },
            nb::kw_only(), "width"_a = 1280, "height"_a = 720, "seed"_a = 0, "max_depth"_a = 8,
            "pixel_filter"_a = "blackman-harris", "filter_width"_a = 0.0, "strategy"_a = "mis",
            "aovs"_a = std::vector<std::string>{"color"}, "threads"_a = 0,
            "force_effects"_a = std::vector<std::string>{},
            "width, height [pixels]; max_depth: edges of a path; filter_width: full width [pixels], 0: the filter's "
            "own;\n"
            "threads: 0 is all; force_effects: effects that run although nothing calls for them. ValueError on unknown "
            "names.");

    nb::class_<PyRenderer>(
        module, "Renderer",
        "A committed scene and its film. The same image to the bit for any threads, tiles or order of samples.")
        .def("__init__", &construct, "scene"_a, "options"_a, nb::keep_alive<1, 2>())
        .def_prop_ro(
            "tiles", [](const PyRenderer& self) { return self.renderer.tiles(); },
            "Number of 64x64 tiles, row-major from the top left.")
        .def(
            "tile_rect",
            [](PyRenderer& self, int tile) {
                const Rect r = self.renderer.tile(checked_tile(self, tile));
                return std::make_tuple(r.x, r.y, r.width, r.height);
            },
            "tile"_a, "(x, y, width, height) of a tile [pixels].")
        .def("render", &render, "sample_begin"_a, "sample_end"_a, "tile_begin"_a, "tile_end"_a,
             "Traces samples [begin, end) of tiles [begin, end); each (tile, sample) once. False if cancelled.")
        .def(
            "cancel", [](PyRenderer& self) { self.renderer.cancel(); }, "From any thread: render() returns soon.")
        .def(
            "read",
            [](PyRenderer& self, const std::string& aov) {
                const Film& film = self.renderer.film();
                return read_rect(self, aov, {0, 0, film.width(), film.height()});
            },
            "aov"_a, "The image so far, (H, W, channels) float32.")
        .def(
            "read_tile",
            [](PyRenderer& self, const std::string& aov, int tile) {
                return read_rect(self, aov, self.renderer.tile(checked_tile(self, tile)));
            },
            "aov"_a, "tile"_a, "One tile of the image so far, (h, w, channels) float32.")
        .def(
            "state",
            [](PyRenderer& self) {
                const std::string bytes = self.renderer.film().state();
                return nb::bytes(bytes.data(), bytes.size());
            },
            "The film's exact partial sums.")
        .def(
            "merge",
            [](PyRenderer& self, const nb::bytes& state) {
                self.renderer.film().merge(std::string(state.c_str(), state.size()));
            },
            "state"_a, "Adds the partial sums of another render of the same image; exact in any order.")
        .def(
            "error",
            [](PyRenderer& self) {
                const FilmError e = self.renderer.film().error();
                nb::dict result;
                result["mean"] = e.mean;
                result["p95"] = e.p95;
                return result;
            },
            "Relative standard error over 16x16 tiles: mean and 95th percentile; NaN before two samples per pixel.")
        .def("stats", &stats, "CPU seconds per stage, rays, samples, guards, bytes.")
        .def_prop_ro("seconds",
                     [](const PyRenderer& self) {
                         nb::dict result;
                         result["commit"] = self.commit_seconds;
                         return result;
                     })
        .def_prop_ro("effects", [](const PyRenderer& self) { return effect_list(self.renderer.effects()); })
        .def_prop_ro("pipeline", [](const PyRenderer& self) { return self.renderer.pipeline(); })
        .def_prop_ro(
            "left_out",
            [](const PyRenderer& self) {
                std::vector<std::tuple<std::string, std::string>> result;
                for (const LeftOut& l : self.renderer.left_out()) result.emplace_back(l.path, l.reason);
                return result;
            },
            "(path, reason) of what commit could not use.");

    module.attr("AOVS") = [] {
        nb::dict result;
        for (const AovInfo& info : kAovs) result[std::string(info.name).c_str()] = info.meaning;
        return result;
    }();
    module.attr("PIXEL_FILTERS") = [] {
        std::vector<std::string> names;
        for (const auto& info : kPixelFilters) names.emplace_back(info.name);
        return names;
    }();
    module.attr("STRATEGIES") = [] {
        std::vector<std::string> names;
        for (const auto& info : kStrategies) names.emplace_back(info.name);
        return names;
    }();
}

}  // namespace footlight
