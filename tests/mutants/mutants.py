"""Wrong renderers: the text of the core that each of them has changed, and the laws that have to reject it."""

from dataclasses import dataclass

AGREEMENT = "tests/laws/test_agreement.py::"
EXACT = "tests/laws/test_exact.py::"
FILM = "tests/laws/test_film.py::"
FURNACE = "tests/laws/test_furnace.py::"
GEOMETRY = "tests/laws/test_geometry.py::"
LIGHTS = "tests/laws/test_lights.py::"


@dataclass(frozen=True, slots=True)
class Mutant:
    """A renderer that is wrong in one place."""

    name: str
    file: str  # under core/
    text: str  # occurs once in the file
    becomes: str
    tests: tuple[str, ...]  # pytest node ids, parameters included; each of them fails

    def applied_to(self, source: str) -> str:
        """The file's text with the mistake in it."""
        if source.count(self.text) != 1:
            raise ValueError(
                f"{self.name}: its text occurs {source.count(self.text)} times in core/{self.file}, not once"
            )
        return source.replace(self.text, self.becomes)


# Mutants of one file stand together: what one has rebuilt, the next rebuilds anyway.
MUTANTS = (
    # --- surfaces ---
    Mutant(
        "cosine dropped",
        "bsdf/lambert.h",
        "return {reflectance * pdf, pdf};",
        "return {reflectance * select(above, F(1 / kPi), F(0)), pdf};",
        (FURNACE + "test_lambert_reflects_exactly_its_reflectance[0.5]",),
    ),
    Mutant(
        "cosine made positive instead of clamped",
        "bsdf/lambert.h",
        "        const Mask<F> above = (wo.z > F(0)) & (wi.z > F(0));\n"
        "        const F pdf = select(above, cosine_hemisphere_pdf(wi.z), F(0));",
        "        const F pdf = select(wo.z > F(0), cosine_hemisphere_pdf(abs(wi.z)), F(0));",
        (GEOMETRY + "test_g12_tilted_normal_in_closed_form[60.0-light]",),
    ),
    Mutant(
        "energy compensation dropped",
        "bsdf/ggx.h",
        "const F lost = F(1) / ggx_albedo(cos_o, clamped_alpha()) - F(1);",
        "const F lost = F(0) * cos_o;",
        (FURNACE + "test_b03_white_metal[1.0]",),
    ),
    Mutant(
        "lobes not chosen by the probability they are weighted with",
        "material/surface_bsdf.h",
        "took_specular = u_lobe < p_specular_;",
        "took_specular = u_lobe < p_specular_ * F(0.5);",
        (FURNACE + "test_b03_white_metal[0.0]",),
    ),
    Mutant(
        "density of a lobe without the probability of its choice",
        "material/surface_bsdf.h",
        "r.pdf = r.pdf + specular.pdf * p_specular_;",
        "r.pdf = r.pdf + specular.pdf;",
        (FURNACE + "test_b04_white_plastic[0.0-0.5]",),
    ),
    Mutant(
        "bounces into the face",
        "pipeline/scatter.cpp",
        "Mask<FloatV> alive = sample.valid & is_unit & (dot(g.geometric, wi) > FloatV(0.0F));",
        "Mask<FloatV> alive = sample.valid & is_unit;",
        (GEOMETRY + "test_g12_tilted_normal_in_closed_form[60.0-bsdf]",),
    ),
    # --- paths ---
    Mutant(
        "roulette without compensation",
        "pipeline/scatter.cpp",
        "throughput = throughput * (FloatV(1.0F) / survive);",
        "",
        (FURNACE + "test_s03_closed_room_is_a_geometric_series[5]",),
    ),
    Mutant(
        "path one edge short",
        "pipeline/scatter.cpp",
        "static_cast<int>(w.bounce) + 2 <= options.max_depth;",
        "static_cast<int>(w.bounce) + 3 <= options.max_depth;",
        (FURNACE + "test_s03_closed_room_is_a_geometric_series[2]",),
    ),
    Mutant(
        "shadow rays end far before the light",
        "pipeline/scatter.cpp",
        "constexpr float kShadowRounding = 0x1p-18F;",
        "constexpr float kShadowRounding = 0x1p-10F;",
        (LIGHTS + "test_g04_a_cover_close_to_the_light_blocks_it[rect-0.0001]",),
    ),
    Mutant(
        "rays start on the surface",
        "pipeline/surface.cpp",
        "constexpr float kClearance = 4.0F;",
        "constexpr float kClearance = 0.0F;",
        (GEOMETRY + "test_g03_convex_body_never_hits_itself[bsdf-False-4.0-1.0]",),
    ),
    Mutant(
        "rays start on the wrong side",
        "pipeline/surface.cpp",
        "constexpr float kClearance = 4.0F;",
        "constexpr float kClearance = -4.0F;",
        (GEOMETRY + "test_g03_convex_body_never_hits_itself[bsdf-False-4.0-1.0]",),
    ),
    Mutant(
        "rays from a far instance too close to it",
        "pipeline/surface.cpp",
        "constexpr float kReturnError = gamma(4);",
        "constexpr float kReturnError = 0.0F;",
        (GEOMETRY + "test_g03_a_far_instance_seen_edge_on",),
    ),
    Mutant(
        "normals of instances by the transform of points",
        "pipeline/surface.cpp",
        "return select(is_world, n, cofactor[0] * n.x + cofactor[1] * n.y + cofactor[2] * n.z);",
        "return select(is_world, n, row[0] * n.x + row[1] * n.y + row[2] * n.z);",
        (AGREEMENT + "test_mt8_instances_are_copies",),
    ),
    Mutant(
        "half-transparent cards cast full shadows",
        "accel/accel.cpp",
        "rtcSetGeometryOccludedFilterFunction(handle, filter_opacity);",
        "",
        (AGREEMENT + "test_mt13_strategies_agree[orchard]",),
    ),
    Mutant(
        "rays slip between triangles",
        "accel/accel.cpp",
        "rtcSetSceneFlags(scene, RTC_SCENE_FLAG_ROBUST);",
        "rtcSetSceneFlags(scene, RTC_SCENE_FLAG_NONE);",
        (GEOMETRY + "test_g05_rays_at_edges_and_vertices[vertices]",),
    ),
    # --- lights ---
    Mutant(
        "light chosen without its probability",
        "pipeline/scatter.cpp",
        "const FloatV pdf = light.pdf * choice.probability;",
        "const FloatV pdf = light.pdf;",
        (LIGHTS + "test_l15_negative_light_cancels",),
    ),
    Mutant(
        "light samples weigh as if there were no others",
        "pipeline/scatter.cpp",
        "light_strategy_weight(scene.options.strategy, light, pdf, e.pdf);",
        "light_strategy_weight(scene.options.strategy, light, pdf, FloatV(0.0F));",
        (LIGHTS + "test_l01_sphere_light_at_any_distance[0.5-mis]",),
    ),
    Mutant(
        "weights of multiple importance sampling squared",
        "light/mis.h",
        "return select(a >= b, F(1), ratio) / (F(1) + ratio);",
        "const F weight = select(a >= b, F(1), ratio) / (F(1) + ratio);\n    return weight * weight;",
        (LIGHTS + "test_l01_sphere_light_at_any_distance[0.5-mis]",),
    ),
    Mutant(
        "half the density of a sphere light",
        "light/sphere.h",
        "return hit_where(c.outside, row.radiance, uniform_cone_pdf(c.one_minus_cos));",
        "return hit_where(c.outside, row.radiance, F(0.5) * uniform_cone_pdf(c.one_minus_cos));",
        (LIGHTS + "test_l01_sphere_light_at_any_distance[0.1-light]",),
    ),
    Mutant(
        "cone of a sphere light by 1 - cos",
        "light/sphere.h",
        "cone_one_minus_cos(sin2)",
        "F(1) - safe_sqrt(F(1) - sin2)",
        (LIGHTS + "test_l01_sphere_light_at_any_distance[0.0003-light]",),
    ),
    Mutant(
        "disk lights emit from both sides",
        "light/disk.h",
        "const F height = -dot(to_center, row.n);",
        "const F height = abs(dot(to_center, row.n));",
        (AGREEMENT + "test_g17_lights_under_negative_scales[disk-signs2]",),
    ),
    Mutant(
        "mirrored lights emit from their dark side",
        "light/light_table.cpp",
        "return unit(determinant(m) < 0 ? n : -n);",
        "return unit(-n);",
        (AGREEMENT + "test_g17_lights_under_negative_scales[rect-signs0]",),
    ),
    Mutant(
        "normalize ignored",
        "light/light_table.cpp",
        "row.radiance = desc.normalize ? scaled(desc.emission, 1 / area) : desc.emission;",
        "row.radiance = desc.emission;",
        (LIGHTS + "test_l23_disk_light_under_scale[stretch1-True-light]",),
    ),
    Mutant(
        "rotation of a dome ignored",
        "light/light_table.cpp",
        "const Matrix4& m = desc.transform;",
        "const Matrix4 m;",
        (LIGHTS + "test_dome_orientation",),
    ),
    Mutant(
        "rows of a dome weighted by their centre",
        "light/dome_image.cpp",
        "width / (2 * kPi * shares[y]);",
        "width / (2 * kPi * kPi / height * std::sin(kPi * (y + 0.5) / height));",
        (LIGHTS + "test_l08_light_at_the_pole[first row-light]",),
    ),
    # --- camera and film ---
    Mutant(
        "lens sampled more densely in its middle",
        "pipeline/camera_rays.h",
        "const F lx = disk.x * F(c.lens_radius), ly = disk.y * F(c.lens_radius);",
        "const F radius = disk.radius * F(c.lens_radius);\n    const F lx = disk.x * radius, ly = disk.y * radius;",
        (GEOMETRY + "test_g21_an_edge_out_of_focus_in_closed_form",),
    ),
    Mutant(
        "exposure ignored",
        "pipeline/renderer.cpp",
        ".exposure = static_cast<float>(camera.exposure_scale),",
        ".exposure = 1.0F,",
        (EXACT + "test_mt4_exposure_times_a_power_of_two[20]",),
    ),
    Mutant(
        "both replicates draw the same numbers",
        "pipeline/generate.cpp",
        "pixel_key(scene.options.seed, owner.x, owner.y, owner.sample & 1U);",
        "pixel_key(scene.options.seed, owner.x, owner.y, 0U);",
        (FILM + "test_c2_the_error_figure_is_honest[room]",),
    ),
    Mutant(
        "error without the weights of the replicates",
        "film/film.cpp",
        "difference * difference * (a * b) / ((a + b) * (a + b));",
        "difference * difference;",
        (FILM + "test_c2_the_error_figure_is_honest[room]",),
    ),
    Mutant(
        "mean over one replicate's samples",
        "film/film.cpp",
        "    const auto count = static_cast<double>(r.count[0] + r.count[1]);\n    return count > 0",
        "    const auto count = static_cast<double>(r.count[0]);\n    return count > 0",
        (FILM + "test_f01_ten_thousand_equal_samples_keep_their_value",),
    ),
    Mutant(
        "samples counted twice when films are merged",
        "film/film.cpp",
        "color_[i].count[r] += other.color_[i].count[r];",
        "color_[i].count[r] += 2 * other.color_[i].count[r];",
        (EXACT + "test_mt10_chunks_of_samples[8-room]",),
    ),
    Mutant(
        "sums in single precision, which depend on the order",
        "film/exact_sum.h",
        "        const double sum = high + x;\n"
        "        const double rest = sum - high;\n"
        "        low += (high - (sum - rest)) + (x - rest);\n"
        "        high = sum;",
        "        high = static_cast<float>(high + x);",
        (EXACT + "test_mt10_five_chunks_in_any_order", FILM + "test_f01_ten_thousand_equal_samples_keep_their_value"),
    ),
)
