// The stack of lobes of one surface: coat over specular over diffuse, chosen one at a time in proportion to albedo.
//
// Layers: f = coat * f_coat + (1 - coat * E_coat) (f_spec + (1 - E_spec) f_diffuse), E the directional albedo at wo
// (albedo scaling, so that a white surface reflects all and none reflects more). One-sample MIS over lobes: Villemin
// 2015, section on one-sample MIS; Veach 1997, eq. 9.15: f / (sum of p_i pdf_i), whichever lobe was drawn.
#pragma once

#include <type_traits>

#include "bsdf/ggx.h"
#include "bsdf/lambert.h"
#include "bsdf/mirror.h"
#include "material/material_table.h"

namespace footlight {

// An absent layer.
struct NoLobe {};

template <class F>
struct SurfaceEval {
    Rgb<F> f;  // includes |cos| [1/sr]
    F pdf;     // of sample() [1/sr]; delta lobes excluded
};

template <class F>
struct SurfaceSample {
    Vec3<F> wi;
    Rgb<F> weight;  // f / pdf; 0 where the sample failed
    F pdf;          // [1/sr]; 0 where is_delta
    Mask<F> is_delta;
    Mask<F> valid;
};

// F0 of the clear coat: index of refraction 1.5, as UsdPreviewSurface says.
inline constexpr float kCoatF0 = 0.04F;

template <class F, class Specular, class Coat>
class SurfaceBsdf {
  public:
    static constexpr bool has_specular = !std::is_same_v<Specular, NoLobe>;
    static constexpr bool has_mirror = std::is_same_v<Specular, Mirror<F>>;
    static constexpr bool has_coat = !std::is_same_v<Coat, NoLobe>;

    // wo: local, wo.z > 0.
    SurfaceBsdf(const SurfaceParameters<F>& p, Vec3<F> wo) : wo_(wo), diffuse_{p.base * p.diffuse_scale} {
        if constexpr (has_specular) {
            specular_.f0 = p.f0 + p.base * p.base_to_f0;
            specular_.f90 = gray(p.f90);
            if constexpr (!has_mirror) specular_.alpha = p.alpha;
            const Rgb<F> albedo = specular_.albedo(wo.z);
            below_specular_ = one_minus(albedo);
            specular_weight_ = mean(albedo);
            if constexpr (!has_mirror) specular_compensation_ = specular_.compensation(wo.z);
        }
        if constexpr (has_coat) {
            coat_ = {gray(F(kCoatF0)), gray(F(1)), p.coat_alpha};
            coat_amount_ = p.coat;
            const Rgb<F> albedo = coat_.albedo(wo.z) * p.coat;
            below_coat_ = one_minus(albedo);
            coat_weight_ = mean(albedo);
            coat_compensation_ = coat_.compensation(wo.z);
        }
        choose_lobes();
    }

    // Share of the light from wo that leaves again, whatever the direction.
    [[nodiscard]] Rgb<F> albedo() const { return albedo_; }
    [[nodiscard]] Mask<F> is_black() const { return !(total_weight_ > F(0)); }

    [[nodiscard]] SurfaceEval<F> eval(Vec3<F> wi) const {
        const LobeEval<F> diffuse = diffuse_.eval(wo_, wi);
        SurfaceEval<F> r{diffuse.f, diffuse.pdf * p_diffuse_};
        if constexpr (has_specular) {
            r.f = r.f * below_specular_;
            if constexpr (!has_mirror) {
                const LobeEval<F> specular = specular_.eval(wo_, wi, specular_compensation_);
                r.f = r.f + specular.f;
                r.pdf = r.pdf + specular.pdf * p_specular_;
            }
        }
        if constexpr (has_coat) {
            const LobeEval<F> coat = coat_.eval(wo_, wi, coat_compensation_);
            r.f = r.f * below_coat_ + coat.f * coat_amount_;
            r.pdf = r.pdf + coat.pdf * p_coat_;
        }
        return r;
    }

    [[nodiscard]] SurfaceSample<F> sample(F u_lobe, F u0, F u1) const {
        LobeSample<F> drawn = diffuse_.sample(wo_, u0, u1);
        Mask<F> took_specular = F(0) > F(1);
        if constexpr (has_specular) {
            took_specular = u_lobe < p_specular_;
            const LobeSample<F> specular = specular_.sample(wo_, u0, u1);
            drawn.wi = select(took_specular, specular.wi, drawn.wi);
            drawn.valid = select_mask(took_specular, specular.valid, drawn.valid);
        }
        if constexpr (has_coat) {
            F below = p_diffuse_;
            if constexpr (has_specular) below = below + p_specular_;
            const Mask<F> took_coat = u_lobe >= below;
            const LobeSample<F> coat = coat_.sample(wo_, u0, u1);
            drawn.wi = select(took_coat, coat.wi, drawn.wi);
            drawn.valid = select_mask(took_coat, coat.valid, drawn.valid);
            took_specular = took_specular & (!took_coat);
        }
        const SurfaceEval<F> e = eval(drawn.wi);
        const Mask<F> usable = drawn.valid & (e.pdf > F(0));
        SurfaceSample<F> s{drawn.wi, e.f * (F(1) / select(usable, e.pdf, F(1))), e.pdf, F(0) > F(1), usable};
        if constexpr (has_mirror) {
            // The only direction of a mirror: nothing else can draw it, so its weight stands alone.
            Rgb<F> mirror = specular_.weight(wo_) * (F(1) / select(took_specular, p_specular_, F(1)));
            if constexpr (has_coat) mirror = mirror * below_coat_;
            s.weight = select(took_specular, mirror, s.weight);
            s.pdf = select(took_specular, F(0), s.pdf);
            s.is_delta = took_specular;
            s.valid = select_mask(took_specular, drawn.valid, usable);
        }
        s.weight = select(s.valid, s.weight, gray(F(0)));
        return s;
    }

  private:
    static Rgb<F> one_minus(Rgb<F> a) { return {max(F(1) - a.r, F(0)), max(F(1) - a.g, F(0)), max(F(1) - a.b, F(0))}; }
    static Mask<F> select_mask(Mask<F> m, Mask<F> a, Mask<F> b) { return (m & a) | ((!m) & b); }

    void choose_lobes() {
        albedo_ = diffuse_.reflectance;
        if constexpr (has_specular) albedo_ = albedo_ * below_specular_;
        F diffuse_weight = mean(albedo_);
        if constexpr (has_specular) albedo_ = albedo_ + specular_.albedo(wo_.z);
        if constexpr (has_coat) {
            const F through = mean(below_coat_);
            diffuse_weight = diffuse_weight * through;
            specular_weight_ = specular_weight_ * through;
            albedo_ = albedo_ * below_coat_ + coat_.albedo(wo_.z) * coat_amount_;
        }
        total_weight_ = diffuse_weight;
        if constexpr (has_specular) total_weight_ = total_weight_ + specular_weight_;
        if constexpr (has_coat) total_weight_ = total_weight_ + coat_weight_;
        // A black surface keeps p_diffuse = 0 / 1: nothing is drawn, nothing is NaN.
        const F divisor = select(total_weight_ > F(0), total_weight_, F(1));
        p_diffuse_ = diffuse_weight / divisor;
        if constexpr (has_specular) p_specular_ = specular_weight_ / divisor;
        if constexpr (has_coat) p_coat_ = coat_weight_ / divisor;
    }

    Vec3<F> wo_;
    Lambert<F> diffuse_;
    [[no_unique_address]] Specular specular_;
    [[no_unique_address]] Coat coat_;
    Rgb<F> below_specular_, below_coat_, specular_compensation_, coat_compensation_, albedo_;
    F specular_weight_, coat_weight_, coat_amount_, total_weight_;
    F p_diffuse_, p_specular_, p_coat_;
};

}  // namespace footlight
