// Python binding of subdivide(): numpy arrays in, a dict of numpy arrays out.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <stdexcept>
#include <string>
#include <string_view>
#include <tuple>
#include <utility>
#include <vector>

#include "subdiv/subdivide.h"

namespace nb = nanobind;

namespace footlight {

void bind_subdiv(nb::module_& module);

namespace {

using Floats = nb::ndarray<const float, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Rows = nb::ndarray<const float, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Points = nb::ndarray<const float, nb::shape<-1, 3>, nb::c_contig, nb::device::cpu>;
using Ints = nb::ndarray<const std::int32_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using PrimvarArgument = std::tuple<std::string, Rows, std::optional<Ints>>;

template <class Enum, std::size_t N>
Enum named(std::string_view what, const std::array<std::string_view, N>& names, const std::string& name) {
    for (std::size_t i = 0; i < N; ++i) {
        if (names[i] == name) {
            return static_cast<Enum>(i);
        }
    }
    throw std::invalid_argument("subdivide: unknown " + std::string(what) + " \"" + name + "\"");
}

// Names in the order of the enumerators of subdivide.h.
constexpr std::array<std::string_view, 2> kSchemes = {"catmullClark", "loop"};
constexpr std::array<std::string_view, 3> kBoundaries = {"none", "edgeOnly", "edgeAndCorner"};
constexpr std::array<std::string_view, 6> kFaceVarying = {"none",         "cornersOnly", "cornersPlus1",
                                                          "cornersPlus2", "boundaries",  "all"};
constexpr std::array<std::string_view, 2> kTriangleRules = {"catmullClark", "smooth"};
constexpr std::array<std::string_view, 3> kKinds = {"vertex", "varying", "faceVarying"};

template <class Array>
auto view(const Array& array) {
    return std::span(array.data(), array.size());
}

template <class Array>
auto view(const std::optional<Array>& array) {
    return array ? view(*array) : decltype(view(*array)){};
}

// A numpy array that owns the vector's storage: (rows, width), or (rows,) for width 0.
template <class T>
nb::object to_numpy(std::vector<T>&& values, std::size_t width) {
    auto* owned = new std::vector<T>(std::move(values));
    const nb::capsule owner(owned, [](void* p) noexcept { delete static_cast<std::vector<T>*>(p); });
    if (width == 0) {
        return nb::cast(nb::ndarray<nb::numpy, T>(owned->data(), {owned->size()}, owner));
    }
    return nb::cast(nb::ndarray<nb::numpy, T>(owned->data(), {owned->size() / width, width}, owner));
}

nb::dict to_dict(SubdividedMesh&& mesh) {
    nb::list primvars;
    for (SubdividedPrimvar& primvar : mesh.primvars) {
        const auto width = static_cast<std::size_t>(primvar.width);
        primvars.append(
            nb::make_tuple(to_numpy(std::move(primvar.values), width), to_numpy(std::move(primvar.indices), 3)));
    }
    nb::dict out;
    out["points"] = to_numpy(std::move(mesh.points), 3);
    out["normals"] = to_numpy(std::move(mesh.normals), 3);
    out["triangles"] = to_numpy(std::move(mesh.triangles), 3);
    out["normal_indices"] = to_numpy(std::move(mesh.normal_indices), 3);
    out["face_of_triangle"] = to_numpy(std::move(mesh.face_of_triangle), 0);
    out["primvars"] = primvars;
    return out;
}

nb::dict subdivide_arrays(const Points& points, const Ints& face_counts, const Ints& face_indices,
                          const std::string& scheme, int level, const std::string& boundary,
                          const std::string& face_varying, const std::string& triangle_rule,
                          const std::optional<Ints>& crease_indices, const std::optional<Ints>& crease_lengths,
                          const std::optional<Floats>& crease_sharpnesses, const std::optional<Ints>& corner_indices,
                          const std::optional<Floats>& corner_sharpnesses, const std::optional<Ints>& holes,
                          const std::vector<PrimvarArgument>& primvars) {
    std::vector<SubdivPrimvar> columns;
    for (const auto& [kind, values, indices] : primvars) {
        columns.push_back({named<PrimvarKind>("primvar kind", kKinds, kind), static_cast<int>(values.shape(1)),
                           view(values), view(indices)});
    }
    SubdivCage cage;
    cage.points = view(points);
    cage.face_counts = view(face_counts);
    cage.face_indices = view(face_indices);
    cage.scheme = named<SubdivScheme>("scheme", kSchemes, scheme);
    cage.boundary = named<SubdivBoundary>("boundary", kBoundaries, boundary);
    cage.face_varying = named<SubdivFaceVarying>("face_varying", kFaceVarying, face_varying);
    cage.triangle_rule = named<SubdivTriangleRule>("triangle_rule", kTriangleRules, triangle_rule);
    cage.crease_indices = view(crease_indices);
    cage.crease_lengths = view(crease_lengths);
    cage.crease_sharpnesses = view(crease_sharpnesses);
    cage.corner_indices = view(corner_indices);
    cage.corner_sharpnesses = view(corner_sharpnesses);
    cage.holes = view(holes);
    cage.primvars = columns;
    SubdividedMesh mesh;
    {
        const nb::gil_scoped_release unlocked;
        mesh = subdivide(cage, level);
    }
    return to_dict(std::move(mesh));
}

}  // namespace

void bind_subdiv(nb::module_& module) {
    module.def("subdivide", &subdivide_arrays, nb::arg("points"), nb::arg("face_counts"), nb::arg("face_indices"),
               nb::arg("scheme"), nb::arg("level"), nb::arg("boundary") = "edgeAndCorner",
               nb::arg("face_varying") = "cornersPlus1", nb::arg("triangle_rule") = "catmullClark",
               nb::arg("crease_indices") = nb::none(), nb::arg("crease_lengths") = nb::none(),
               nb::arg("crease_sharpnesses") = nb::none(), nb::arg("corner_indices") = nb::none(),
               nb::arg("corner_sharpnesses") = nb::none(), nb::arg("holes") = nb::none(),
               nb::arg("primvars") = std::vector<PrimvarArgument>{},
               "Subdivides a cage (points (N, 3) float32, counts and indices int32) to its limit surface.\n\n"
               "primvars: (\"vertex\" | \"varying\" | \"faceVarying\", values (M, C) float32, indices int32 or None).\n"
               "Returns points (P, 3), normals (Q, 3), triangles (T, 3), normal_indices (T, 3), face_of_triangle (T,)\n"
               "and primvars [(values (K, C), indices (T, 3))]. Raises ValueError for a bad cage.");
}

}  // namespace footlight
