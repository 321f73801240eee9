// numpy arrays at the border: typed views in, owned arrays out.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstdint>
#include <optional>
#include <vector>

#include "math/matrix.h"
#include "scene/scene.h"

namespace footlight {

namespace nb = nanobind;

using Floats3 = nb::ndarray<const float, nb::shape<-1, 3>, nb::c_contig, nb::device::cpu>;
using Floats1 = nb::ndarray<const float, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Indices3 = nb::ndarray<const std::uint32_t, nb::shape<-1, 3>, nb::c_contig, nb::device::cpu>;
using Matrix = nb::ndarray<const double, nb::shape<4, 4>, nb::c_contig, nb::device::cpu>;
using Matrices = nb::ndarray<const double, nb::shape<-1, 4, 4>, nb::c_contig, nb::device::cpu>;
using Image = nb::ndarray<const float, nb::shape<-1, -1, 3>, nb::c_contig, nb::device::cpu>;

// Copies the rows of an array into structs of the same layout.
template <class T, class Array>
std::vector<T> copy_rows(const Array& array) {
    const auto* begin = reinterpret_cast<const T*>(array.data());
    return {begin, begin + array.shape(0)};
}
template <class T, class Array>
std::vector<T> copy_rows(const std::optional<Array>& array) {
    return array ? copy_rows<T>(*array) : std::vector<T>();
}

inline Matrix4 to_matrix(const double* values) {
    Matrix4 m;
    for (int r = 0; r < 4; ++r)
        for (int c = 0; c < 4; ++c) m.m[r][c] = values[r * 4 + c];
    return m;
}
inline std::vector<Matrix4> to_matrices(const Matrices& array) {
    std::vector<Matrix4> result;
    result.reserve(array.shape(0));
    for (std::size_t i = 0; i < array.shape(0); ++i) result.push_back(to_matrix(array.data() + i * 16));
    return result;
}

// A float32 array of this shape that owns its values.
inline nb::ndarray<nb::numpy, float> to_numpy(std::vector<float> values, std::initializer_list<std::size_t> shape) {
    auto* kept = new std::vector<float>(std::move(values));
    const nb::capsule owner(kept, [](void* p) noexcept { delete static_cast<std::vector<float>*>(p); });
    return {kept->data(), shape, owner};
}

}  // namespace footlight
