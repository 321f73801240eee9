// The film: exact per-pixel sums of two replicates, and the images and errors read from them.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "film/aov.h"
#include "film/exact_sum.h"
#include "math/vec.h"

namespace footlight {

// What one path brings back. Columns are indexed by the path's slot in its batch; unrequested AOVs are empty.
struct SampleColumns {
    std::array<const float*, 3> radiance;
    const float* alpha;
    const float* depth;  // infinite where nothing is hit
    std::array<const float*, 3> normal;
    std::array<const float*, 3> albedo;
    std::array<const float*, 3> position;  // relative to the render origin
};

// Relative standard error of a pixel: sqrt(mean variance of a 16x16 tile) / mean of the tile, or a tenth of the image's
// mean where the tile is darker than that.
struct FilmError {
    double mean;  // over tiles; NaN before both replicates have samples
    double p95;   // 95th percentile over tiles
};

class Film {
  public:
    // origin: the render origin in world space, added back to the position AOV.
    Film(int width, int height, AovSet aovs, Vec3<double> origin);

    [[nodiscard]] int width() const { return width_; }
    [[nodiscard]] int height() const { return height_; }
    [[nodiscard]] AovSet aovs() const { return aovs_; }

    // Adds sample `slot` of the columns to pixel (x, y). Different pixels may be added from different threads.
    void add(int x, int y, std::uint32_t sample, const SampleColumns& columns, std::uint32_t slot) noexcept;

    // One AOV of a rectangle of pixels as width * height * channels floats, rows from the top.
    [[nodiscard]] std::vector<float> read(Aov aov, int x, int y, int width, int height) const;
    [[nodiscard]] FilmError error() const;

    // The partial sums as bytes, and their exact merge. Throws std::invalid_argument if the bytes are of another film.
    [[nodiscard]] std::string state() const;
    void merge(const std::string& state);

  private:
    struct Replicates {
        ExactSum sum[2][3];
        std::uint64_t count[2] = {0, 0};
    };
    struct Nearest {
        float depth;
        float position[3];
    };
    struct PixelVariance {
        double variance[3];
    };
    [[nodiscard]] std::size_t index(int x, int y) const {
        return static_cast<std::size_t>(y) * static_cast<std::size_t>(width_) + static_cast<std::size_t>(x);
    }
    // Variance of the pixel means of one 16x16 tile, per channel; NaN without two replicates.
    [[nodiscard]] PixelVariance tile_variance(int tile_x, int tile_y) const;
    [[nodiscard]] double pixel_mean(const Replicates& r, int channel) const;

    int width_, height_;
    AovSet aovs_;
    Vec3<double> origin_;
    std::vector<Replicates> color_;
    std::vector<ExactSum> alpha_;
    std::vector<ExactSum> normal_, albedo_;  // 3 per pixel
    std::vector<Nearest> nearest_;
};

}  // namespace footlight
