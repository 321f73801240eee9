// The film: exact per-pixel sums of two replicates, and the images and errors read from them.
#include "film/film.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <stdexcept>

namespace footlight {

namespace {

// Side of the squares over which the error is pooled: 256 pixels keep the estimate within a few per cent.
constexpr int kErrorTile = 16;
// Tiles darker than this share of the image's mean are measured against it: noise in the black is not what is seen.
constexpr double kDarkTile = 0.1;

bool nearer(const float depth, const float* position, float other_depth, const float* other) {
    if (depth != other_depth) return depth < other_depth;
    // Equal depths: order by position, so that the choice does not depend on which sample came first.
    return std::lexicographical_compare(position, position + 3, other, other + 3);
}

template <class T>
void append(std::string& bytes, const std::vector<T>& values) {
    bytes.append(reinterpret_cast<const char*>(values.data()), values.size() * sizeof(T));
}

template <class T>
const char* take(const char* at, std::vector<T>& values) {
    std::memcpy(values.data(), at, values.size() * sizeof(T));
    return at + values.size() * sizeof(T);
}

struct StateHeader {
    std::uint32_t magic = 0x464c4d31;  // "FLM1"
    std::int32_t width = 0, height = 0;
    AovSet aovs = 0;
};

}  // namespace

Film::Film(int width, int height, AovSet aovs, Vec3<double> origin)
    : width_(width), height_(height), aovs_(aovs), origin_(origin) {
    const std::size_t pixels = static_cast<std::size_t>(width) * static_cast<std::size_t>(height);
    color_.resize(pixels);
    if (contains(aovs, Aov::alpha)) alpha_.resize(pixels);
    if (contains(aovs, Aov::normal)) normal_.resize(pixels * 3);
    if (contains(aovs, Aov::albedo)) albedo_.resize(pixels * 3);
    if (contains(aovs, Aov::depth) || contains(aovs, Aov::position))
        nearest_.resize(pixels, {std::numeric_limits<float>::infinity(), {0, 0, 0}});
}

void Film::add(int x, int y, std::uint32_t sample, const SampleColumns& columns, std::uint32_t slot) noexcept {
    const std::size_t pixel = index(x, y);
    Replicates& color = color_[pixel];
    const unsigned replicate = sample & 1U;
    for (int c = 0; c < 3; ++c) color.sum[replicate][c].add(columns.radiance[c][slot]);
    ++color.count[replicate];
    if (!alpha_.empty()) alpha_[pixel].add(columns.alpha[slot]);
    for (int c = 0; c < 3; ++c) {
        if (!normal_.empty()) normal_[pixel * 3 + c].add(columns.normal[c][slot]);
        if (!albedo_.empty()) albedo_[pixel * 3 + c].add(columns.albedo[c][slot]);
    }
    if (!nearest_.empty()) {
        Nearest& nearest = nearest_[pixel];
        const float position[3] = {columns.position[0][slot], columns.position[1][slot], columns.position[2][slot]};
        if (nearer(columns.depth[slot], position, nearest.depth, nearest.position)) {
            nearest.depth = columns.depth[slot];
            std::copy_n(position, 3, nearest.position);
        }
    }
}

double Film::pixel_mean(const Replicates& r, int channel) const {
    ExactSum sum = r.sum[0][channel];
    sum.add(r.sum[1][channel]);
    const auto count = static_cast<double>(r.count[0] + r.count[1]);
    return count > 0 ? sum.value() / count : 0.0;
}

Film::PixelVariance Film::tile_variance(int tile_x, int tile_y) const {
    PixelVariance result{{0, 0, 0}};
    const int x1 = std::min(width_, (tile_x + 1) * kErrorTile), y1 = std::min(height_, (tile_y + 1) * kErrorTile);
    std::size_t pixels = 0;
    for (int y = tile_y * kErrorTile; y < y1; ++y)
        for (int x = tile_x * kErrorTile; x < x1; ++x, ++pixels) {
            const Replicates& r = color_[index(x, y)];
            const auto a = static_cast<double>(r.count[0]), b = static_cast<double>(r.count[1]);
            for (int c = 0; c < 3; ++c) {
                // With equal counts this is (A - B)^2 / 4: the variance of (A + B) / 2, or more where A and B share
                // strata (sampler.h, shared_by_replicates).
                const double difference = r.sum[0][c].value() / a - r.sum[1][c].value() / b;
                result.variance[c] += difference * difference * (a * b) / ((a + b) * (a + b));
            }
        }
    for (double& v : result.variance) v /= static_cast<double>(pixels);
    return result;
}

std::vector<float> Film::read(Aov aov, int x0, int y0, int width, int height) const {
    const int channels = aov_info(aov).channels;
    std::vector<float> image(static_cast<std::size_t>(width) * static_cast<std::size_t>(height) *
                             static_cast<std::size_t>(channels));
    float* out = image.data();
    if (aov == Aov::error) {
        const int first_x = x0 / kErrorTile, first_y = y0 / kErrorTile;
        const int columns = (x0 + width - 1) / kErrorTile - first_x + 1;
        const int rows = (y0 + height - 1) / kErrorTile - first_y + 1;
        std::vector<PixelVariance> tiles;
        for (int ty = 0; ty < rows; ++ty)
            for (int tx = 0; tx < columns; ++tx) tiles.push_back(tile_variance(first_x + tx, first_y + ty));
        for (int y = y0; y < y0 + height; ++y)
            for (int x = x0; x < x0 + width; ++x) {
                const auto& tile =
                    tiles[static_cast<std::size_t>((y / kErrorTile - first_y) * columns + x / kErrorTile - first_x)];
                for (const double v : tile.variance) *out++ = static_cast<float>(std::sqrt(v));
            }
        return image;
    }
    for (int y = y0; y < y0 + height; ++y)
        for (int x = x0; x < x0 + width; ++x) {
            const std::size_t pixel = index(x, y);
            const Replicates& r = color_[pixel];
            const auto count = static_cast<double>(r.count[0] + r.count[1]);
            const double scale = count > 0 ? 1.0 / count : 0.0;
            switch (aov) {
                case Aov::color:
                    for (int c = 0; c < 3; ++c) *out++ = static_cast<float>(pixel_mean(r, c));
                    break;
                case Aov::alpha:
                    *out++ = static_cast<float>(alpha_[pixel].value() * scale);
                    break;
                case Aov::normal:
                    for (std::size_t c = 0; c < 3; ++c)
                        *out++ = static_cast<float>(normal_[pixel * 3 + c].value() * scale);
                    break;
                case Aov::albedo:
                    for (std::size_t c = 0; c < 3; ++c)
                        *out++ = static_cast<float>(albedo_[pixel * 3 + c].value() * scale);
                    break;
                case Aov::depth:
                    *out++ = nearest_[pixel].depth;
                    break;
                case Aov::position: {
                    const Nearest& n = nearest_[pixel];
                    const bool hit = std::isfinite(n.depth);
                    *out++ = hit ? static_cast<float>(n.position[0] + origin_.x) : 0.0F;
                    *out++ = hit ? static_cast<float>(n.position[1] + origin_.y) : 0.0F;
                    *out++ = hit ? static_cast<float>(n.position[2] + origin_.z) : 0.0F;
                    break;
                }
                case Aov::sample_count:
                    *out++ = static_cast<float>(count);
                    break;
                case Aov::error:
                    break;
            }
        }
    return image;
}

FilmError Film::error() const {
    struct Tile {
        double deviation, mean;
    };
    std::vector<Tile> tiles;
    double image_mean = 0;
    for (int ty = 0; ty * kErrorTile < height_; ++ty)
        for (int tx = 0; tx * kErrorTile < width_; ++tx) {
            const PixelVariance v = tile_variance(tx, ty);
            const double variance = (v.variance[0] + v.variance[1] + v.variance[2]) / 3;
            if (std::isnan(variance)) return {variance, variance};
            double mean = 0;
            int pixels = 0;
            for (int y = ty * kErrorTile; y < std::min(height_, (ty + 1) * kErrorTile); ++y)
                for (int x = tx * kErrorTile; x < std::min(width_, (tx + 1) * kErrorTile); ++x, ++pixels)
                    for (int c = 0; c < 3; ++c) mean += pixel_mean(color_[index(x, y)], c) / 3;
            tiles.push_back({std::sqrt(variance), std::abs(mean) / pixels});
            image_mean += tiles.back().mean;
        }
    image_mean /= static_cast<double>(tiles.size());
    if (!(image_mean > 0)) return {0, 0};
    std::vector<double> errors;
    double sum = 0;
    for (const Tile& tile : tiles) {
        errors.push_back(tile.deviation / std::max(tile.mean, kDarkTile * image_mean));
        sum += errors.back();
    }
    const std::size_t rank = std::min(errors.size() - 1, errors.size() * 95 / 100);
    std::nth_element(errors.begin(), errors.begin() + static_cast<std::ptrdiff_t>(rank), errors.end());
    return {sum / static_cast<double>(errors.size()), errors[rank]};
}

std::string Film::state() const {
    const StateHeader header{.width = width_, .height = height_, .aovs = aovs_};
    std::string bytes(reinterpret_cast<const char*>(&header), sizeof header);
    append(bytes, color_);
    append(bytes, alpha_);
    append(bytes, normal_);
    append(bytes, albedo_);
    append(bytes, nearest_);
    return bytes;
}

void Film::merge(const std::string& state) {
    Film other(width_, height_, aovs_, origin_);
    const StateHeader expected{.width = width_, .height = height_, .aovs = aovs_};
    const std::size_t size = sizeof expected + color_.size() * sizeof(Replicates) +
                             (alpha_.size() + normal_.size() + albedo_.size()) * sizeof(ExactSum) +
                             nearest_.size() * sizeof(Nearest);
    if (state.size() != size || std::memcmp(state.data(), &expected, sizeof expected) != 0)
        throw std::invalid_argument("film state is of another image: size or AOVs differ");
    const char* at = state.data() + sizeof expected;
    at = take(at, other.color_);
    at = take(at, other.alpha_);
    at = take(at, other.normal_);
    at = take(at, other.albedo_);
    take(at, other.nearest_);
    for (std::size_t i = 0; i < color_.size(); ++i)
        for (int r = 0; r < 2; ++r) {
            for (int c = 0; c < 3; ++c) color_[i].sum[r][c].add(other.color_[i].sum[r][c]);
            color_[i].count[r] += other.color_[i].count[r];
        }
    for (std::size_t i = 0; i < alpha_.size(); ++i) alpha_[i].add(other.alpha_[i]);
    for (std::size_t i = 0; i < normal_.size(); ++i) normal_[i].add(other.normal_[i]);
    for (std::size_t i = 0; i < albedo_.size(); ++i) albedo_[i].add(other.albedo_[i]);
    for (std::size_t i = 0; i < nearest_.size(); ++i)
        if (nearer(other.nearest_[i].depth, other.nearest_[i].position, nearest_[i].depth, nearest_[i].position))
            nearest_[i] = other.nearest_[i];
}

}  // namespace footlight
