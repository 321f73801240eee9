// The lights as one closed family: how one is chosen, sampled, and recognised by a ray that finds it.
//
// Conventions, for every light:
// - wi is unit and points from the shaded point p to the light. Positions are relative to the render origin.
// - radiance is what arrives at p along wi without occlusion; it may be negative. No cosine at p is in it.
// - pdf is per solid angle at p [1/sr], of this light alone: multiply by the probability of choosing it.
// - sample_light and hit_light (or escape_light) answer the same radiance and pdf for the same wi.
// - rect and disk emit along their local -Z only; sphere and cylinder outward, the cylinder (axis X) without caps. The
//   other side, and the inside, is dark: radiance 0 and pdf 0.
// - triangle is a face of an emissive mesh and emits from both sides; rays find it as a surface.
// - distant emits along -Z; the dome inward, +Y up (see dome.h). Both are infinitely far.
// - a distant light of angle 0 is a delta light: is_delta, pdf 1, radiance is an irradiance; no ray ever finds it.
// - there is no length constant: all scaled by a power of two, the answers are the same bits.
#pragma once

#include <tuple>

#include "light/cylinder.h"
#include "light/disk.h"
#include "light/distant.h"
#include "light/dome.h"
#include "light/light_table.h"
#include "light/mis.h"
#include "light/rect.h"
#include "light/sphere.h"
#include "light/triangle.h"

namespace footlight {

// The closed list, in the order of LightKind.
template <class F>
using LightTypes = std::tuple<RectLight<F>, DiskLight<F>, SphereLight<F>, CylinderLight<F>, DistantLight<F>,
                              DomeLight<F>, TriangleLight<F>>;

// Calls visit.operator()<Light>() for every light type whose kind is in the mask.
template <class F, class Visit>
inline void for_each_light_type(std::uint32_t kinds, Visit visit) {
    const auto visit_one = [&]<class Light>() {
        if ((kinds >> static_cast<std::uint32_t>(Light::kind) & 1U) != 0) visit.template operator()<Light>();
    };
    [&]<std::size_t... I>(std::index_sequence<I...>) {
        (visit_one.template operator()<std::tuple_element_t<I, LightTypes<F>>>(), ...);
    }
    (std::make_index_sequence<std::tuple_size_v<LightTypes<F>>>());
}

// --- choice ---
template <class F>
struct LightChoice {
    UInt<F> index;
    F probability;  // 0 only when the table is empty
};

// u in [0, 1).
template <class F>
inline LightChoice<F> select_light(const LightTable& table, F u) {
    if (table.size() <= 1) return {UInt<F>(0U), F(static_cast<float>(table.size()))};
    const DiscreteSample<F> chosen = table.selection.sample(u);
    return {chosen.index, chosen.probability};
}

template <class F>
inline F select_pmf(const LightTable& table, UInt<F> index) {
    if (table.size() <= 1) return F(static_cast<float>(table.size()));
    return table.selection.probability<F>(index);
}

// --- lanes that share one light, or not ---
inline bool same_in_all_lanes(std::uint32_t /*index*/) { return true; }
template <class A>
inline bool same_in_all_lanes(xsimd::batch<std::uint32_t, A> index) {
    const xsimd::batch<std::uint32_t, A> first(index.get(0));
    return all(equal<xsimd::batch<float, A>>(index, first));
}
inline std::uint32_t first_lane(std::uint32_t index) { return index; }
template <class A>
inline std::uint32_t first_lane(xsimd::batch<std::uint32_t, A> index) {
    return index.get(0);
}

// --- sampling towards a light ---
// One light for all lanes: its row is broadcast, and only its own code runs.
template <class F>
inline LightSample<F> sample_one_light(const LightTable& table, std::uint32_t light, Vec3<F> p, F u0, F u1) {
    for (const LightTable::Dome& dome : table.domes)
        if (dome.light == light) return DomeLight<F>::sample(dome.image, broadcast_row<F>(table, light), u0, u1);
    LightSample<F> result = no_light_sample<F>();
    for_each_light_type<F>(1U << static_cast<std::uint32_t>(table.info[light].kind),
                           [&]<class Light>() { result = Light::sample(broadcast_row<F>(table, light), p, u0, u1); });
    return result;
}

// A light per lane, index < table.size(). u0, u1 in [0, 1).
template <class F>
inline LightSample<F> sample_light(const LightTable& table, UInt<F> index, Vec3<F> p, F u0, F u1) {
    if (same_in_all_lanes(index)) return sample_one_light<F>(table, first_lane(index), p, u0, u1);
    const LightRow<F> row = gather_row<F>(table, index);
    LightSample<F> result = no_light_sample<F>();
    for_each_light_type<F>(table.kinds, [&]<class Light>() {
        const Mask<F> mask = row.kind == F(static_cast<float>(Light::kind));
        if (any(mask)) result = select_sample<F>(mask, Light::sample(row, p, u0, u1), result);
    });
    for (const LightTable::Dome& dome : table.domes) {
        const Mask<F> mask = equal<F>(index, UInt<F>(dome.light));
        if (any(mask)) result = select_sample<F>(mask, DomeLight<F>::sample(dome.image, row, u0, u1), result);
    }
    return result;
}

// --- rays that find a light ---
// A finite light, hit by the ray from p along the unit direction wi at this distance.
template <class F>
inline LightHit<F> hit_light(const LightTable& table, UInt<F> index, Vec3<F> p, Vec3<F> wi, F distance) {
    const bool uniform = same_in_all_lanes(index);
    const std::uint32_t first = first_lane(index);
    const LightRow<F> row = uniform ? broadcast_row<F>(table, first) : gather_row<F>(table, index);
    const std::uint32_t kinds = uniform ? 1U << static_cast<std::uint32_t>(table.info[first].kind) : table.kinds;
    LightHit<F> result = no_light_hit<F>();
    for_each_light_type<F>(kinds, [&]<class Light>() {
        if constexpr (!Light::is_infinite) {
            const Mask<F> mask = row.kind == F(static_cast<float>(Light::kind));
            if (any(mask)) result = select_hit<F>(mask, Light::hit(row, p, wi, distance), result);
        }
    });
    return result;
}

// An infinite light (one of table.infinite), in the direction wi of a ray that left the scene.
template <class F>
inline LightHit<F> escape_light(const LightTable& table, std::uint32_t light, Vec3<F> wi) {
    const LightRow<F> row = broadcast_row<F>(table, light);
    for (const LightTable::Dome& dome : table.domes)
        if (dome.light == light) return DomeLight<F>::escape(dome.image, row, wi);
    LightHit<F> result = no_light_hit<F>();
    for_each_light_type<F>(1U << static_cast<std::uint32_t>(table.info[light].kind), [&]<class Light>() {
        if constexpr (Light::is_infinite) result = Light::escape(row, wi);
    });
    return result;
}

// Distance from o along the unit direction d to a disk, sphere or cylinder light, or infinity. Rects are triangles.
template <class F>
inline F intersect_light(const LightTable& table, std::uint32_t light, Vec3<F> o, Vec3<F> d) {
    F t = infinity<F>();
    for_each_light_type<F>(1U << static_cast<std::uint32_t>(table.info[light].kind), [&]<class Light>() {
        if constexpr (requires { Light::intersect(broadcast_row<F>(table, light), o, d); })
            t = Light::intersect(broadcast_row<F>(table, light), o, d);
    });
    return t;
}

// Weight of a sampled light direction against the density with which the BSDF would have drawn it. A delta light cannot
// be found otherwise: its density is never compared.
template <class F>
inline F light_weight(const LightSample<F>& sample, F pdf, F bsdf_pdf) {
    return select(sample.is_delta, F(1), balance_heuristic(pdf, bsdf_pdf));
}

}  // namespace footlight
