// The surrounding sphere at infinity: one colour, or a latitude-longitude image.
#pragma once

#include <vector>

#include "light/light_sample.h"
#include "math/distribution.h"
#include "math/warp.h"

namespace footlight {

// The image of a dome, and what is drawn from it.
//
// Orientation (UsdLux DomeLight, OpenEXR): +Y of the light is the top row, +Z the centre column, +X a quarter left of
// it. Radiance is the bilinear interpolation of texels in u and v; it wraps in u and stays constant beyond the first
// and last row of texel centres. The density is interpolated from the same texels in u and in cos(theta), so it is
// positive wherever radiance can be (of a compensated dome: wherever it can exceed the mean), integrates to 1 exactly,
// and no sine of a polar angle ever divides anything.
struct DomeImage {
    std::uint32_t width = 0, height = 0;
    std::vector<float> texels;   // (height, width, 4): radiance r, g, b and density [1/sr]
    std::vector<float> heights;  // (2, height): 1 - cos of row centres from the top pole, then from the bottom pole
    std::vector<float> rows;     // (height, 5): see RowColumn
    Distribution2D table;
};

// A row's share of the sphere, for sampling. Heights are 1 - cos from the pole that is nearer, so none loses its
// digits.
enum RowColumn : std::uint32_t { row_height, row_sign, row_up, row_down, row_split, row_columns };
// row_height  of the row's centre, from the nearer pole
// row_sign    1 if that is the top pole, -1 if the bottom
// row_up      height to the centre of the row above (to the pole, for the first row)
// row_down    height to the centre of the row below (to the pole, for the last row)
// row_split   part of the row's share that lies above its centre

// Row: u, v, n the image's X, Y, Z axes; density the constant density [1/sr] of a dome without image;
// radiance that of a dome without image.
template <class F>
struct DomeLight {
    static constexpr LightKind kind = LightKind::dome;
    static constexpr bool is_infinite = true;

    // A dome of one colour needs no table: every direction is as good.
    static LightSample<F> sample(const LightRow<F>& row, Vec3<F> /*p*/, F u0, F u1) {
        return {uniform_sphere(u0, u1), infinity<F>(), row.radiance, row.density, row.density > F(0), Mask<F>(false)};
    }
    static LightHit<F> escape(const LightRow<F>& row, Vec3<F> /*wi*/) {
        return hit_where(row.density > F(0), row.radiance, row.density);
    }

    static LightHit<F> escape(const DomeImage& image, const LightRow<F>& row, Vec3<F> wi) {
        const F dx = dot(wi, row.u), dy = dot(wi, row.v), dz = dot(wi, row.n);
        const F width = F(static_cast<float>(image.width)), height = F(static_cast<float>(image.height));
        const F sine = sqrt(dx * dx + dz * dz);
        const F s = (F(0.5) - atan2(dx, dz) * F(0.5 / kPi)) * width - F(0.5);
        const F t = atan2(sine, dy) * F(1 / kPi) * height - F(0.5);
        const F left = floor(s), top = floor(t);
        // comparisons that a direction which is not a number fails: its lookup is wrong, but inside the image
        const F right = left + F(1), below = top + F(1);
        const F x0 = select(left >= F(0), left, width - F(1)), x1 = select(right < width, right, F(0));
        const F y0 = select(top >= F(0), top, F(0)), y1 = select(below < height, below, height - F(1));

        const F from_pole = sine * sine / (F(1) + abs(dy));  // 1 - cos
        const F half = select(dy >= F(0), F(0), height);
        const F h0 = gather<F>(image.heights.data(), to_uint(half + y0));
        const F h1 = gather<F>(image.heights.data(), to_uint(half + y1));
        const F down = select(y0 == y1, F(0), clamp((from_pole - h0) / select(h0 == h1, F(1), h1 - h0), F(0), F(1)));

        const UInt<F> w(image.width);
        const UInt<F> row0 = to_uint(y0) * w, row1 = to_uint(y1) * w, column0 = to_uint(x0), column1 = to_uint(x1);
        const F fx = s - left, fy = t - top;
        LightHit<F> found{gray(F(0)), F(0)};
        const auto add = [&](UInt<F> texel, F radiance_weight, F density_weight) {
            const UInt<F> at = texel << 2;
            const float* data = image.texels.data();
            found.radiance =
                found.radiance +
                Rgb<F>{gather<F>(data, at), gather<F>(data + 1, at), gather<F>(data + 2, at)} * radiance_weight;
            found.pdf = fma(gather<F>(data + 3, at), density_weight, found.pdf);
        };
        add(row0 + column0, (F(1) - fx) * (F(1) - fy), (F(1) - fx) * (F(1) - down));
        add(row0 + column1, fx * (F(1) - fy), fx * (F(1) - down));
        add(row1 + column0, (F(1) - fx) * fy, (F(1) - fx) * down);
        add(row1 + column1, fx * fy, fx * down);
        return found;
    }

    // A texel is drawn by its share of the light, then a point of its tent: the density is the interpolation above.
    static LightSample<F> sample(const DomeImage& image, const LightRow<F>& row, F u0, F u1) {
        const DiscreteSample2D<F> texel = image.table.sample(u0, u1);
        const UInt<F> at = texel.row * UInt<F>(row_columns);
        const auto column = [&](RowColumn c) { return gather<F>(image.rows.data() + c, at); };
        const F y = to_number<F>(texel.row), split = column(row_split);
        const Mask<F> above = texel.v < split;
        const F v =
            select(above, texel.v / max(split, F(0x1p-100F)), (texel.v - split) / max(F(1) - split, F(0x1p-100F)));
        // beyond the outermost centres the share is constant, elsewhere it falls off linearly
        const F up = select(y == F(0), F(1) - v, F(1) - sqrt(v));
        const F down = select(y == F(static_cast<float>(image.height - 1)), v, F(1) - sqrt(F(1) - v));
        const F step = select(above, -column(row_up) * up, column(row_down) * down);
        const F from_pole = max(fma(column(row_sign), step, column(row_height)), F(0));
        const F cosine = column(row_sign) * (F(1) - from_pole), sine = safe_sqrt(from_pole * (F(2) - from_pole));

        const Mask<F> left = texel.u < F(0.5);
        const F root = sqrt(F(2) * select(left, texel.u, F(1) - texel.u));
        const F aside = select(left, root - F(1), F(1) - root);
        const F x = (to_number<F>(texel.column) + F(0.5) + aside) * F(1.0F / static_cast<float>(image.width));
        const SinCos<F> angle = sin_cos_turn(x - floor(x));  // of minus the longitude
        const Vec3<F> wi = row.u * (-sine * angle.sin) + row.v * cosine + row.n * (sine * angle.cos);
        const LightHit<F> found = escape(image, row, wi);
        return {wi, infinity<F>(), found.radiance, found.pdf, found.pdf > F(0), Mask<F>(false)};
    }
};

}  // namespace footlight
