// Refines control meshes with OpenSubdiv, for the tests to compare with: a stream of text in, a stream of text out.
//
// In, for every mesh: scheme boundary uv_mode creasing triangles levels, then counts and arrays as `read` below has them.
// Out, for every level from 1: vertices, faces, and UVs with their indices, 17 digits.
#include <opensubdiv/far/primvarRefiner.h>
#include <opensubdiv/far/topologyDescriptor.h>

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

static bool one_mesh() {
    int scheme, boundary, uv_mode, creasing, triangles, levels;
    if (!(std::cin >> scheme >> boundary >> uv_mode >> creasing >> triangles >> levels)) return false;
    std::vector<double> positions = read<double>(3), uvs = read<double>(2);
    std::vector<int> sizes = read<int>(), indices = read<int>(), uv_indices = read<int>();
    std::vector<int> creases = read<int>(2), corners = read<int>();
    std::vector<float> crease_sharpness = read<float>(), corner_sharpness = read<float>();

    Sdc::Options options;
    options.SetVtxBoundaryInterpolation(Sdc::Options::VtxBoundaryInterpolation(boundary));
    options.SetFVarLinearInterpolation(Sdc::Options::FVarLinearInterpolation(uv_mode));
    options.SetCreasingMethod(Sdc::Options::CreasingMethod(creasing));
    options.SetTriangleSubdivision(Sdc::Options::TriangleSubdivision(triangles));

    typedef Far::TopologyDescriptor Descriptor;
    Descriptor descriptor;
    descriptor.numVertices = int(positions.size() / 3);
    descriptor.numFaces = int(sizes.size());
    descriptor.numVertsPerFace = sizes.data();
    descriptor.vertIndicesPerFace = indices.data();
    descriptor.numCreases = int(crease_sharpness.size());
    descriptor.creaseVertexIndexPairs = creases.data();
    descriptor.creaseWeights = crease_sharpness.data();
    descriptor.numCorners = int(corner_sharpness.size());
    descriptor.cornerVertexIndices = corners.data();
    descriptor.cornerWeights = corner_sharpness.data();
    Descriptor::FVarChannel channel;
    channel.numValues = int(uvs.size() / 2);
    channel.valueIndices = uv_indices.data();
    descriptor.numFVarChannels = 1;
    descriptor.fvarChannels = &channel;

    typedef Far::TopologyRefinerFactory<Descriptor> Factory;
    Far::TopologyRefiner *refiner =
        Factory::Create(descriptor, Factory::Options(Sdc::SchemeType(scheme), options));
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
            std::printf("\n");
        }
    }
    delete refiner;
    return true;
}

int main() {
    while (one_mesh()) {
    }
    return 0;
}
