// Subdivision through OpenSubdiv's Far layer; the only file that includes OpenSubdiv.
#include "subdiv/subdivide.h"

#include <opensubdiv/far/error.h>
#include <opensubdiv/far/primvarRefiner.h>
#include <opensubdiv/far/topologyDescriptor.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <memory>
#include <stdexcept>
#include <string>
#include <utility>

namespace footlight {
namespace {

namespace Far = OpenSubdiv::Far;
namespace Sdc = OpenSubdiv::Sdc;

constexpr int kMaxLevel = 10;                // OpenSubdiv's own limit (4 bits, less the limit masks)
constexpr std::int32_t kMaxValence = 65535;  // Vtr counts corners and neighbours in 16 bits

// Weights and sums in double, so that a plane stays a plane after rounding to float.
template <int N>
struct Value {
    std::array<double, N> v{};

    void Clear() { v.fill(0.0); }
    void AddWithWeight(const Value& other, double weight) {
        for (int i = 0; i < N; ++i) {
            v[i] += weight * other.v[i];
        }
    }
};

using Vec = Value<3>;
using Refiner = Far::PrimvarRefinerReal<double>;

Vec operator-(const Vec& a, const Vec& b) { return {{a.v[0] - b.v[0], a.v[1] - b.v[1], a.v[2] - b.v[2]}}; }
double dot(const Vec& a, const Vec& b) { return a.v[0] * b.v[0] + a.v[1] * b.v[1] + a.v[2] * b.v[2]; }
double length(const Vec& a) { return std::sqrt(dot(a, a)); }
Vec cross(const Vec& a, const Vec& b) {
    return {{a.v[1] * b.v[2] - a.v[2] * b.v[1], a.v[2] * b.v[0] - a.v[0] * b.v[2], a.v[0] * b.v[1] - a.v[1] * b.v[0]}};
}

void refuse(const std::string& what) { throw std::invalid_argument("subdivide: " + what); }

void check_range(const char* name, std::span<const std::int32_t> indices, std::size_t end) {
    for (std::size_t i = 0; i < indices.size(); ++i) {
        if (indices[i] < 0 || std::cmp_greater_equal(indices[i], end)) {
            refuse(std::string(name) + "[" + std::to_string(i) + "] = " + std::to_string(indices[i]) +
                   " is outside [0, " + std::to_string(end) + ")");
        }
    }
}

void check_faces(const SubdivCage& cage) {
    std::size_t corners = 0;
    for (std::size_t f = 0; f < cage.face_counts.size(); ++f) {
        const std::int32_t count = cage.face_counts[f];
        if (count < 3 || count > kMaxValence) {
            refuse("face_counts[" + std::to_string(f) + "] = " + std::to_string(count) + " is outside [3, 65535]");
        }
        if (cage.scheme == SubdivScheme::loop && count != 3) {
            refuse("loop needs triangles, face_counts[" + std::to_string(f) + "] = " + std::to_string(count));
        }
        corners += static_cast<std::size_t>(count);
    }
    if (corners != cage.face_indices.size()) {
        refuse("face_indices has " + std::to_string(cage.face_indices.size()) + " entries, face_counts ask for " +
               std::to_string(corners));
    }
    check_range("face_indices", cage.face_indices, cage.points.size() / 3);
}

void check_valence(const SubdivCage& cage) {
    std::vector<std::int32_t> valence(cage.points.size() / 3, 0);
    for (const std::int32_t p : cage.face_indices) {
        if (++valence[static_cast<std::size_t>(p)] > kMaxValence) {
            refuse("point " + std::to_string(p) + " has more than 65535 faces");
        }
    }
}

void check_primvars(const SubdivCage& cage) {
    for (std::size_t i = 0; i < cage.primvars.size(); ++i) {
        const SubdivPrimvar& primvar = cage.primvars[i];
        const std::string name = "primvars[" + std::to_string(i) + "]";
        if (primvar.width < 1 || primvar.width > 4) {
            refuse(name + " has " + std::to_string(primvar.width) + " floats per value, allowed are 1 to 4");
        }
        const std::size_t count = primvar.values.size() / static_cast<std::size_t>(primvar.width);
        const bool by_corner = primvar.kind == PrimvarKind::face_varying;
        if (by_corner && !primvar.indices.empty()) {
            if (primvar.indices.size() != cage.face_indices.size()) {
                refuse(name + " has " + std::to_string(primvar.indices.size()) + " indices, the cage has " +
                       std::to_string(cage.face_indices.size()) + " corners");
            }
            check_range(name.c_str(), primvar.indices, count);
        } else if (const std::size_t wanted = by_corner ? cage.face_indices.size() : cage.points.size() / 3;
                   count != wanted) {
            refuse(name + " has " + std::to_string(count) + " values, wanted are " + std::to_string(wanted));
        }
    }
}

void check(const SubdivCage& cage, int level) {
    if (level < 1 || level > kMaxLevel) {
        refuse("level " + std::to_string(level) + " is outside [1, 10]");
    }
    if (cage.points.size() % 3 != 0 || cage.points.empty() || cage.face_counts.empty()) {
        refuse("a cage needs points (3 floats each) and faces");
    }
    check_faces(cage);
    check_valence(cage);
    check_range("holes", cage.holes, cage.face_counts.size());
    check_range("corner_indices", cage.corner_indices, cage.points.size() / 3);
    check_range("crease_indices", cage.crease_indices, cage.points.size() / 3);
    if (cage.corner_indices.size() != cage.corner_sharpnesses.size()) {
        refuse("corner_indices and corner_sharpnesses differ in size");
    }
    check_primvars(cage);
}

// Creases as OpenSubdiv wants them: pairs of points, one weight each.
struct Creases {
    std::vector<Far::Index> pairs;
    std::vector<float> weights;
};

Creases crease_edges(const SubdivCage& cage) {
    std::size_t points = 0;
    std::size_t edges = 0;
    for (std::size_t i = 0; i < cage.crease_lengths.size(); ++i) {
        const std::int32_t n = cage.crease_lengths[i];
        if (n < 2) {
            refuse("crease_lengths[" + std::to_string(i) + "] = " + std::to_string(n) + " is below 2");
        }
        points += static_cast<std::size_t>(n);
        edges += static_cast<std::size_t>(n) - 1;
    }
    const bool per_crease = cage.crease_sharpnesses.size() == cage.crease_lengths.size();
    if (points != cage.crease_indices.size() || (!per_crease && cage.crease_sharpnesses.size() != edges)) {
        refuse("crease_lengths, crease_indices and crease_sharpnesses do not fit one another");
    }
    Creases creases;
    std::size_t first = 0;
    for (std::size_t i = 0; i < cage.crease_lengths.size(); ++i) {
        const auto n = static_cast<std::size_t>(cage.crease_lengths[i]);
        for (std::size_t k = 0; k + 1 < n; ++k) {
            creases.weights.push_back(cage.crease_sharpnesses[per_crease ? i : creases.weights.size()]);
            creases.pairs.push_back(cage.crease_indices[first + k]);
            creases.pairs.push_back(cage.crease_indices[first + k + 1]);
        }
        first += n;
    }
    return creases;
}

Sdc::Options options_of(const SubdivCage& cage) {
    static constexpr std::array kBoundary = {Sdc::Options::VTX_BOUNDARY_NONE, Sdc::Options::VTX_BOUNDARY_EDGE_ONLY,
                                             Sdc::Options::VTX_BOUNDARY_EDGE_AND_CORNER};
    static constexpr std::array kFaceVarying = {
        Sdc::Options::FVAR_LINEAR_NONE,          Sdc::Options::FVAR_LINEAR_CORNERS_ONLY,
        Sdc::Options::FVAR_LINEAR_CORNERS_PLUS1, Sdc::Options::FVAR_LINEAR_CORNERS_PLUS2,
        Sdc::Options::FVAR_LINEAR_BOUNDARIES,    Sdc::Options::FVAR_LINEAR_ALL};
    Sdc::Options options;
    options.SetVtxBoundaryInterpolation(kBoundary.at(static_cast<std::size_t>(cage.boundary)));
    options.SetFVarLinearInterpolation(kFaceVarying.at(static_cast<std::size_t>(cage.face_varying)));
    options.SetTriangleSubdivision(cage.triangle_rule == SubdivTriangleRule::smooth ? Sdc::Options::TRI_SUB_SMOOTH
                                                                                    : Sdc::Options::TRI_SUB_CATMARK);
    return options;
}

std::unique_ptr<Far::TopologyRefiner> refine(const SubdivCage& cage, int level) {
    std::vector<Far::Index> identity;
    std::vector<Far::TopologyDescriptor::FVarChannel> channels;
    for (const SubdivPrimvar& primvar : cage.primvars) {
        if (primvar.kind != PrimvarKind::face_varying) {
            continue;
        }
        if (primvar.indices.empty() && identity.empty()) {
            identity.resize(cage.face_indices.size());
            for (std::size_t i = 0; i < identity.size(); ++i) {
                identity[i] = static_cast<Far::Index>(i);
            }
        }
        Far::TopologyDescriptor::FVarChannel channel;
        channel.numValues = static_cast<int>(primvar.values.size()) / primvar.width;
        channel.valueIndices = primvar.indices.empty() ? identity.data() : primvar.indices.data();
        channels.push_back(channel);
    }
    const Creases creases = crease_edges(cage);
    Far::TopologyDescriptor topology;
    topology.numVertices = static_cast<int>(cage.points.size() / 3);
    topology.numFaces = static_cast<int>(cage.face_counts.size());
    topology.numVertsPerFace = cage.face_counts.data();
    topology.vertIndicesPerFace = cage.face_indices.data();
    topology.numCreases = static_cast<int>(creases.weights.size());
    topology.creaseVertexIndexPairs = creases.pairs.data();
    topology.creaseWeights = creases.weights.data();
    topology.numCorners = static_cast<int>(cage.corner_indices.size());
    topology.cornerVertexIndices = cage.corner_indices.data();
    topology.cornerWeights = cage.corner_sharpnesses.data();
    topology.numHoles = static_cast<int>(cage.holes.size());
    topology.holeIndices = cage.holes.data();
    topology.numFVarChannels = static_cast<int>(channels.size());
    topology.fvarChannels = channels.data();

    // Its messages would go to stdout; what it cannot use it leaves out, or returns nothing.
    Far::SetErrorCallback([](Far::ErrorType, const char*) {});
    Far::SetWarningCallback([](const char*) {});
    using Factory = Far::TopologyRefinerFactory<Far::TopologyDescriptor>;
    const auto scheme = cage.scheme == SubdivScheme::loop ? Sdc::SCHEME_LOOP : Sdc::SCHEME_CATMARK;
    std::unique_ptr<Far::TopologyRefiner> refiner(
        Factory::Create(topology, Factory::Options(scheme, options_of(cage))));
    if (refiner == nullptr) {
        refuse("OpenSubdiv does not accept the topology");
    }
    Far::TopologyRefiner::UniformOptions uniform(level);
    uniform.fullTopologyInLastLevel = true;
    refiner->RefineUniform(uniform);
    return refiner;
}

template <int N>
std::vector<Value<N>> widen(std::span<const float> values) {
    std::vector<Value<N>> out(values.size() / N);
    for (std::size_t i = 0; i < out.size(); ++i) {
        std::copy_n(values.data() + i * N, N, out[i].v.data());
    }
    return out;
}

template <int N>
std::vector<float> narrow(const std::vector<Value<N>>& values) {
    std::vector<float> out(values.size() * N);
    for (std::size_t i = 0; i < values.size(); ++i) {
        for (int k = 0; k < N; ++k) {
            out[i * N + static_cast<std::size_t>(k)] = static_cast<float>(values[i].v[k]);
        }
    }
    return out;
}

// Values at the last level, before the limit.
template <int N>
std::vector<Value<N>> interpolate(const Far::TopologyRefiner& topology, const SubdivPrimvar& primvar, int channel) {
    const Refiner refiner(topology);
    std::vector<Value<N>> values = widen<N>(primvar.values);
    for (int level = 1; level <= topology.GetMaxLevel(); ++level) {
        const Far::TopologyLevel& fine = topology.GetLevel(level);
        const int count =
            primvar.kind == PrimvarKind::face_varying ? fine.GetNumFVarValues(channel) : fine.GetNumVertices();
        std::vector<Value<N>> next(static_cast<std::size_t>(count));
        switch (primvar.kind) {
            case PrimvarKind::vertex:
                refiner.Interpolate(level, values, next);
                break;
            case PrimvarKind::varying:
                refiner.InterpolateVarying(level, values, next);
                break;
            case PrimvarKind::face_varying:
                refiner.InterpolateFaceVarying(level, values, next, channel);
                break;
        }
        values = std::move(next);
    }
    return values;
}

template <int N>
std::vector<float> limit_values(const Far::TopologyRefiner& topology, const SubdivPrimvar& primvar, int channel) {
    std::vector<Value<N>> values = interpolate<N>(topology, primvar, channel);
    if (primvar.kind == PrimvarKind::varying) {
        return narrow<N>(values);
    }
    std::vector<Value<N>> limit(values.size());
    if (primvar.kind == PrimvarKind::vertex) {
        Refiner(topology).Limit(values, limit);
    } else {
        Refiner(topology).LimitFaceVarying(values, limit, channel);
    }
    return narrow<N>(limit);
}

std::vector<float> limit_values(const Far::TopologyRefiner& topology, const SubdivPrimvar& primvar, int channel) {
    switch (primvar.width) {
        case 1:
            return limit_values<1>(topology, primvar, channel);
        case 2:
            return limit_values<2>(topology, primvar, channel);
        case 3:
            return limit_values<3>(topology, primvar, channel);
        default:
            return limit_values<4>(topology, primvar, channel);
    }
}

// The refined faces that are there, each cut into triangles: `corner(face, k)` is appended for its corners.
template <class Corner>
void append_triangles(const Far::TopologyLevel& level, const Corner& corner, std::vector<std::uint32_t>& out) {
    for (int f = 0; f < level.GetNumFaces(); ++f) {
        if (level.IsFaceHole(f)) {
            continue;
        }
        for (int k = 2; k < level.GetFaceVertices(f).size(); ++k) {
            out.insert(out.end(), {corner(f, 0), corner(f, k - 1), corner(f, k)});
        }
    }
}

std::vector<std::uint32_t> cage_faces(const Far::TopologyRefiner& topology) {
    const int last = topology.GetMaxLevel();
    const Far::TopologyLevel& level = topology.GetLevel(last);
    std::vector<std::uint32_t> faces;
    append_triangles(
        level,
        [&](int face, int) {
            for (int l = last; l > 0; --l) {
                face = topology.GetLevel(l).GetFaceParentFace(face);
            }
            return static_cast<std::uint32_t>(face);
        },
        faces);
    for (std::size_t t = 0; t < faces.size() / 3; ++t) {
        faces[t] = faces[3 * t];
    }
    faces.resize(faces.size() / 3);
    return faces;
}

// Normals: exact from the limit tangents where the surface is smooth; where sharp edges or a sharp corner remain at the
// last level, the surface has no one normal, and each smooth sector between sharp edges gets the mean of its faces'
// normals weighted by their angle at the point.
class Normals {
  public:
    Normals(const Far::TopologyLevel& level, const std::vector<Vec>& points) : level_(level), points_(points) {}

    void run(const std::vector<Vec>& tangents_u, const std::vector<Vec>& tangents_v) {
        values_.resize(points_.size());
        for (int f = 0; f < level_.GetNumFaces(); ++f) {
            first_corner_.push_back(corner_normals_.size());
            for (const Far::Index v : level_.GetFaceVertices(f)) {
                corner_normals_.push_back(static_cast<std::uint32_t>(v));
            }
        }
        for (int v = 0; v < level_.GetNumVertices(); ++v) {
            const auto i = static_cast<std::size_t>(v);
            const Vec n = cross(tangents_u[i], tangents_v[i]);
            const double len = length(n);
            if (level_.GetVertexFaces(v).size() > 0 && (has_sharp_edge(v) || !std::isnormal(len))) {
                set_sectors(v);
            } else if (std::isnormal(len)) {
                values_[i] = {{n.v[0] / len, n.v[1] / len, n.v[2] / len}};
            }
        }
    }

    const std::vector<Vec>& values() const { return values_; }
    std::uint32_t of_corner(int face, int k) const {
        return corner_normals_[first_corner_[static_cast<std::size_t>(face)] + static_cast<std::size_t>(k)];
    }

  private:
    bool is_sharp(Far::Index edge) const {
        return level_.GetEdgeFaces(edge).size() != 2 || level_.GetEdgeSharpness(edge) > 0.0F;
    }

    bool has_sharp_edge(Far::Index v) const {
        const Far::ConstIndexArray edges = level_.GetVertexEdges(v);
        const bool inner = std::any_of(edges.begin(), edges.end(),
                                       [&](Far::Index e) { return !level_.IsEdgeBoundary(e) && is_sharp(e); });
        const bool cone = !level_.IsVertexBoundary(v) && level_.GetVertexSharpness(v) > 0.0F;
        return inner || cone || level_.IsVertexNonManifold(v);
    }

    // The faces of v fall into sectors: joined where they share an edge at v that is not sharp.
    void set_sectors(Far::Index v) {
        const Far::ConstIndexArray faces = level_.GetVertexFaces(v);
        std::vector<int> sector(static_cast<std::size_t>(faces.size()));
        for (int i = 0; i < faces.size(); ++i) {
            sector[static_cast<std::size_t>(i)] = i;
        }
        for (const Far::Index e : level_.GetVertexEdges(v)) {
            const Far::ConstIndexArray sides = level_.GetEdgeFaces(e);
            if (!is_sharp(e)) {
                join(sector, faces.FindIndex(sides[0]), faces.FindIndex(sides[1]));
            }
        }
        bool first = true;
        for (int i = 0; i < faces.size(); ++i) {
            if (std::find(sector.begin(), sector.begin() + i, sector[static_cast<std::size_t>(i)]) !=
                sector.begin() + i) {
                continue;
            }
            add_sector(v, sector, sector[static_cast<std::size_t>(i)], first);
            first = false;
        }
    }

    static void join(std::vector<int>& sector, int a, int b) {
        if (a < 0 || b < 0) {
            return;
        }
        const int from = sector[static_cast<std::size_t>(b)];
        const int to = sector[static_cast<std::size_t>(a)];
        std::replace(sector.begin(), sector.end(), from, to);
    }

    void add_sector(Far::Index v, const std::vector<int>& sector, int id, bool first) {
        const Far::ConstIndexArray faces = level_.GetVertexFaces(v);
        const Far::ConstLocalIndexArray corners = level_.GetVertexFaceLocalIndices(v);
        Vec sum;
        for (int i = 0; i < faces.size(); ++i) {
            if (sector[static_cast<std::size_t>(i)] == id) {
                sum.AddWithWeight(angle_normal(faces[i], corners[i]), 1.0);
            }
        }
        const double len = length(sum);
        if (std::isnormal(len)) {
            sum = {{sum.v[0] / len, sum.v[1] / len, sum.v[2] / len}};
        }
        std::size_t slot = static_cast<std::size_t>(v);
        if (first) {
            values_[slot] = sum;
            return;
        }
        slot = values_.size();
        values_.push_back(sum);
        for (int i = 0; i < faces.size(); ++i) {
            if (sector[static_cast<std::size_t>(i)] == id) {
                corner_normals_[first_corner_[static_cast<std::size_t>(faces[i])] + corners[i]] =
                    static_cast<std::uint32_t>(slot);
            }
        }
    }

    // The unit normal of the face at its k-th corner times the angle there (Thürmer and Wüthrich 1998).
    Vec angle_normal(Far::Index face, int k) const {
        const Far::ConstIndexArray corners = level_.GetFaceVertices(face);
        const int n = corners.size();
        const Vec& here = points_[static_cast<std::size_t>(corners[k])];
        const Vec to_next = points_[static_cast<std::size_t>(corners[(k + 1) % n])] - here;
        const Vec to_last = points_[static_cast<std::size_t>(corners[(k + n - 1) % n])] - here;
        Vec normal = cross(to_next, to_last);
        const double len = length(normal);
        const double scale = std::isnormal(len) ? std::atan2(len, dot(to_next, to_last)) / len : 0.0;
        for (double& x : normal.v) {
            x *= scale;
        }
        return normal;
    }

    const Far::TopologyLevel& level_;
    const std::vector<Vec>& points_;
    std::vector<Vec> values_;
    std::vector<std::size_t> first_corner_;
    std::vector<std::uint32_t> corner_normals_;
};

void set_surface(const Far::TopologyRefiner& topology, const SubdivCage& cage, SubdividedMesh& mesh) {
    const Far::TopologyLevel& level = topology.GetLevel(topology.GetMaxLevel());
    SubdivPrimvar cage_points;
    cage_points.values = cage.points;
    const std::vector<Vec> refined = interpolate<3>(topology, cage_points, 0);
    std::vector<Vec> points(refined.size());
    std::vector<Vec> tangents_u(refined.size());
    std::vector<Vec> tangents_v(refined.size());
    Refiner(topology).Limit(refined, points, tangents_u, tangents_v);

    Normals normals(level, points);
    normals.run(tangents_u, tangents_v);
    mesh.points = narrow<3>(points);
    mesh.normals = narrow<3>(normals.values());
    append_triangles(
        level, [&](int f, int k) { return static_cast<std::uint32_t>(level.GetFaceVertices(f)[k]); }, mesh.triangles);
    append_triangles(
        level, [&](int f, int k) { return normals.of_corner(f, k); }, mesh.normal_indices);
}

}  // namespace

SubdividedMesh subdivide(const SubdivCage& cage, int level) {
    check(cage, level);
    const std::unique_ptr<Far::TopologyRefiner> topology = refine(cage, level);
    const Far::TopologyLevel& last = topology->GetLevel(level);
    SubdividedMesh mesh;
    set_surface(*topology, cage, mesh);
    mesh.face_of_triangle = cage_faces(*topology);
    int channel = 0;
    for (const SubdivPrimvar& primvar : cage.primvars) {
        SubdividedPrimvar out;
        out.width = primvar.width;
        out.values = limit_values(*topology, primvar, channel);
        if (primvar.kind == PrimvarKind::face_varying) {
            append_triangles(
                last, [&](int f, int k) { return static_cast<std::uint32_t>(last.GetFaceFVarValues(f, channel)[k]); },
                out.indices);
            ++channel;
        } else {
            out.indices = mesh.triangles;
        }
        mesh.primvars.push_back(std::move(out));
    }
    return mesh;
}

}  // namespace footlight
