// Refines control meshes with OpenSubdiv, for the tests to compare with: a stream of text in, a stream of text out.
//
// In, for every mesh: scheme boundary uv_mode creasing triangles levels, then counts and arrays as `read` below has them.
// Out, for every level from 1: vertices, UVs, faces with their UV indices and whether they are holes; then of the last
// level the limits as `print_limits` has them. 17 digits.
#include <opensubdiv/far/primvarRefiner.h>
#include <opensubdiv/far/topologyDescriptor.h>

#include <algorithm>
#include <cstdio>
#include <iostream>
#include <vector>

using namespace OpenSubdiv;

struct Point {
    double x[3];
    void Clear() { x[0] = x[1] = x[2] = 0; }
    void AddWithWeight(Point const &p, double w) {
        for (int i = 0; i < 3; ++i) x[i] += w * p.x[i];
    }
};

template <class T> std::vector<T> read(int per_item = 1) {
    int n;
    std::cin >> n;
    std::vector<T> values(size_t(n) * per_item);
    for (T &value : values) std::cin >> value;
    return values;
}

static void print(std::vector<Point> const &points) {
    std::printf("%zu\n", points.size());
    for (Point const &p : points) std::printf("%.17g %.17g %.17g\n", p.x[0], p.x[1], p.x[2]);
}

// A row of weights.
struct Row {
    std::vector<double> x;
    void Clear() { std::fill(x.begin(), x.end(), 0.0); }
    void AddWithWeight(Row const &r, double w) {
        for (size_t i = 0; i < x.size(); ++i) x[i] += w * r.x[i];
    }
};

struct Mesh {
    std::vector<int> sizes, indices, creases, corners, holes;
    std::vector<float> crease_sharpness, corner_sharpness;
};

typedef Far::TopologyDescriptor Descriptor;
typedef Far::TopologyRefinerFactory<Descriptor> Factory;

static Descriptor described(Mesh const &mesh, int vertices) {
    Descriptor descriptor;
    descriptor.numVertices = vertices;
    descriptor.numFaces = int(mesh.sizes.size());
    descriptor.numVertsPerFace = mesh.sizes.data();
    descriptor.vertIndicesPerFace = mesh.indices.data();
    descriptor.numCreases = int(mesh.crease_sharpness.size());
    descriptor.creaseVertexIndexPairs = mesh.creases.data();
    descriptor.creaseWeights = mesh.crease_sharpness.data();
    descriptor.numCorners = int(mesh.corner_sharpness.size());
    descriptor.cornerVertexIndices = mesh.corners.data();
    descriptor.cornerWeights = mesh.corner_sharpness.data();
    descriptor.numHoles = int(mesh.holes.size());
    descriptor.holeIndices = mesh.holes.data();
    return descriptor;
}

// The ring of a vertex, itself first, and the matrix that takes the ring to that of its child, from refining it once.
static void print_ring(Far::TopologyLevel const &level, int vertex, Factory::Options options) {
    Mesh mesh;
    std::vector<int> ring(1, vertex);
    auto local = [&](int v) {
        int at = int(std::find(ring.begin(), ring.end(), v) - ring.begin());
        if (at == int(ring.size())) ring.push_back(v);
        return at;
    };
    for (int face : level.GetVertexFaces(vertex)) {
        mesh.sizes.push_back(level.GetFaceVertices(face).size());
        for (int v : level.GetFaceVertices(face)) mesh.indices.push_back(local(v));
    }
    for (int edge : level.GetVertexEdges(vertex)) {
        if (level.GetEdgeSharpness(edge) < 10 || level.IsEdgeBoundary(edge)) continue;
        for (int v : level.GetEdgeVertices(edge)) mesh.creases.push_back(local(v));
        mesh.crease_sharpness.push_back(10);
    }
    int n = int(ring.size());
    Far::TopologyRefiner *refiner = Factory::Create(described(mesh, n), options);
    refiner->RefineUniform(Far::TopologyRefiner::UniformOptions(1));
    Far::TopologyLevel const &coarse = refiner->GetLevel(0);
    std::vector<Row> identity(n), finer(refiner->GetLevel(1).GetNumVertices());
    for (Row &row : identity) row.x.assign(n, 0.0);
    for (Row &row : finer) row.x.assign(n, 0.0);
    for (int i = 0; i < n; ++i) identity[i].x[i] = 1;
    Far::PrimvarRefinerReal<double>(*refiner).Interpolate(1, identity, finer);
    std::vector<int> child(n);
    child[0] = coarse.GetVertexChildVertex(0);
    for (int edge : coarse.GetVertexEdges(0)) {
        Far::ConstIndexArray ends = coarse.GetEdgeVertices(edge);
        child[ends[0] ? ends[0] : ends[1]] = coarse.GetEdgeChildVertex(edge);
    }
    for (int face : coarse.GetVertexFaces(0)) {
        Far::ConstIndexArray vertices = coarse.GetFaceVertices(face);
        if (vertices.size() == 4) child[vertices[(vertices.FindIndex(0) + 2) % 4]] = coarse.GetFaceChildVertex(face);
    }
    std::printf("%d", n);
    for (int v : ring) std::printf(" %d", v);
    for (int i = 0; i < n; ++i)
        for (double weight : finer[child[i]].x) std::printf(" %.17g", weight);
    std::printf("\n");
    delete refiner;
}

// For every vertex its limit and two tangents, its rule, how many faces it has, and whether it is semi-sharp and on the
// boundary. Where OpenSubdiv's masks are not the limit of its refinement (infinite darts, interior valence 2, and of
// tangents boundaries with many faces) also its ring: 0 in place of a ring for all others.
static void print_limits(Far::TopologyRefiner &refiner, std::vector<Point> const &points, Factory::Options options) {
    Far::TopologyLevel const &level = refiner.GetLevel(refiner.GetMaxLevel());
    int n = level.GetNumVertices();
    std::vector<Point> limits(n), first(n), second(n);
    Far::PrimvarRefinerReal<double>(refiner).Limit(points, limits, first, second);
    for (int v = 0; v < n; ++v) {
        for (Point const *p : {&limits[v], &first[v], &second[v]}) std::printf("%.17g %.17g %.17g ", p->x[0], p->x[1], p->x[2]);
        bool semi = level.GetVertexSharpness(v) > 0 && level.GetVertexSharpness(v) < 10;
        int sharp = 0;
        for (int edge : level.GetVertexEdges(v)) {
            float s = level.GetEdgeSharpness(edge);
            semi = semi || (s > 0 && s < 10);
            sharp += s >= 10 && !level.IsEdgeBoundary(edge);
        }
        int faces = level.GetVertexFaces(v).size(), rule = int(level.GetVertexRule(v));
        bool boundary = level.IsVertexBoundary(v);
        std::printf("%d %d %d %d %d\n", rule, faces, int(semi), int(boundary), sharp);
        bool odd = !semi && (boundary ? rule == Sdc::Crease::RULE_CREASE && !sharp && faces > 2
                                      : rule == Sdc::Crease::RULE_DART || (faces == 2 && rule == Sdc::Crease::RULE_SMOOTH));
        if (odd) print_ring(level, v, options);
        else std::printf("0\n");
    }
}

static bool one_mesh() {
    int scheme, boundary, uv_mode, creasing, triangles, levels;
    if (!(std::cin >> scheme >> boundary >> uv_mode >> creasing >> triangles >> levels)) return false;
    std::vector<double> positions = read<double>(3), uvs = read<double>(2);
    Mesh mesh;
    mesh.sizes = read<int>();
    mesh.indices = read<int>();
    std::vector<int> uv_indices = read<int>();
    mesh.creases = read<int>(2);
    mesh.corners = read<int>();
    mesh.crease_sharpness = read<float>();
    mesh.corner_sharpness = read<float>();
    mesh.holes = read<int>();

    Sdc::Options options;
    options.SetVtxBoundaryInterpolation(Sdc::Options::VtxBoundaryInterpolation(boundary));
    options.SetFVarLinearInterpolation(Sdc::Options::FVarLinearInterpolation(uv_mode));
    options.SetCreasingMethod(Sdc::Options::CreasingMethod(creasing));
    options.SetTriangleSubdivision(Sdc::Options::TriangleSubdivision(triangles));

    Descriptor descriptor = described(mesh, int(positions.size() / 3));
    Descriptor::FVarChannel channel;
    channel.numValues = int(uvs.size() / 2);
    channel.valueIndices = uv_indices.data();
    descriptor.numFVarChannels = 1;
    descriptor.fvarChannels = &channel;

    Factory::Options choices(Sdc::SchemeType(scheme), options);
    Far::TopologyRefiner *refiner = Factory::Create(descriptor, choices);
    if (!refiner) return false;
    Far::TopologyRefiner::UniformOptions uniform(levels);
    uniform.fullTopologyInLastLevel = true;
    refiner->RefineUniform(uniform);

    std::vector<Point> points(positions.size() / 3), values(uvs.size() / 2);
    for (size_t i = 0; i < positions.size(); ++i) points[i / 3].x[i % 3] = positions[i];
    for (size_t i = 0; i < values.size(); ++i) {
        values[i].x[0] = uvs[2 * i];
        values[i].x[1] = uvs[2 * i + 1];
        values[i].x[2] = 0;
    }
    Far::PrimvarRefinerReal<double> refine(*refiner);
    for (int l = 1; l <= levels; ++l) {
        Far::TopologyLevel const &level = refiner->GetLevel(l);
        std::vector<Point> finer(level.GetNumVertices()), finer_values(level.GetNumFVarValues(0));
        refine.Interpolate(l, points, finer);
        refine.InterpolateFaceVarying(l, values, finer_values, 0);
        points.swap(finer);
        values.swap(finer_values);
        print(points);
        print(values);
        std::printf("%d %d\n", level.GetNumFaces(), level.GetFaceVertices(0).size());
        for (int f = 0; f < level.GetNumFaces(); ++f) {
            for (int v : level.GetFaceVertices(f)) std::printf("%d ", v);
            for (int v : level.GetFaceFVarValues(f, 0)) std::printf("%d ", v);
            std::printf("%d\n", int(level.IsFaceHole(f)));
        }
    }
    print_limits(*refiner, points, choices);
    delete refiner;
    return true;
}

int main() {
    while (one_mesh()) {
    }
    return 0;
}
