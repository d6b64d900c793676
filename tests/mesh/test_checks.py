"""Checks of control meshes: every validator fires on its fault, names the elements, and passes on valid meshes."""

import re
from dataclasses import replace

import numpy as np
import pytest
from examples.shapes import bipyramid, cube, grid, pyramid, tetrahedron, torus
from hypothesis import given, settings
from test_obj import polygon_meshes

from cagemap.errors import InvalidMeshError
from cagemap.mesh import ControlMesh
from cagemap.mesh.checks import check_mesh, require_valid
from cagemap.mesh.faces import keep_faces, with_openings_closed
from cagemap.mesh.mesh_report import MeshReport, place_text
from cagemap.mesh.parts import join_meshes
from cagemap.mesh.topology import boundary_loops, corner_fans, handle_count, mesh_topology

from mesh_faults import SHAPES, elements, faces_of, flip, kinds, moebius_strip, with_faces
from refusals import refuses


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("scale", [1e-50, 1e-6, 1.0, 1e6, 1e50])
def test_valid_shapes_pass_at_every_scale_and_place(name: str, scale: float) -> None:
    build, genus, loops = SHAPES[name]
    mesh = build()
    moved = mesh.with_positions(scale * (mesh.positions + np.array([3.0, -40.0, 500.0])))
    require_valid(moved)
    report = check_mesh(moved)
    assert report.is_valid
    assert report.genus == genus
    assert f"  {2 - 2 * genus - loops}  (genus {genus})\n" in str(report)
    assert handle_count(mesh) == genus
    assert len(report.boundary_loops) == loops
    assert report.component_sizes == (mesh.n_faces,)
    assert report.euler_characteristic == 2 - 2 * genus - loops


def test_report_counts_what_subdivision_looks_at() -> None:
    creased = cube().with_creases([[0, 1]], [2.0]).with_corners([3, 5], [1.0, 10.0])
    assert "sharp                 1 creased edge, 2 sharp vertices" in str(check_mesh(creased))
    assert "sharp" not in str(check_mesh(cube()))


def test_report_reads_as_a_table() -> None:
    faces = [*faces_of(pyramid()), [0, 1, 2, 3, 4, 1], [0, 1]]
    mesh = replace(ControlMesh.from_faces(pyramid().positions, faces), name="roof.obj")
    assert "7  (4 triangles, 1 quad, 1 n-gon of up to 6 corners, 1 of fewer than 3 corners)" in str(check_mesh(mesh))
    mesh = replace(pyramid(), name="roof.obj")
    text = str(check_mesh(mesh))
    assert text.splitlines()[0] == "roof.obj"
    rows = dict(
        line[2:].split(maxsplit=1) for line in text.splitlines()[1:] if line.split()[0] in ("faces", "problems")
    )
    assert rows["faces"] == "5  (4 triangles, 1 quad)"
    assert rows["problems"] == "none"
    broken = str(check_mesh(flip(mesh, 1)))
    assert "1. inconsistent orientation" in broken
    assert "Flip these faces" in broken


def test_elements_at_fault_are_named_with_their_places() -> None:
    mesh = pyramid()
    loose = ControlMesh.from_faces([*mesh.positions, [7.0, 8.0, 9.25]], faces_of(mesh))
    assert "vertices: 5 at (7, 8, 9.25). Delete" in str(check_mesh(loose))
    fin = ControlMesh.from_faces([*mesh.positions, [3.0, 0.0, 0.0]], [*faces_of(mesh), [0, 1, 5]])
    middle = place_text(mesh.positions[:2].mean(axis=0))
    assert f"(0, 1) at {middle}. Delete face(s) 5" in str(check_mesh(fin))
    turned = place_text(mesh.positions[faces_of(mesh)[1]].mean(axis=0))
    assert f"faces: 1 at {turned}. Flip" in str(check_mesh(flip(mesh, 1)))
    many = str(check_mesh(ControlMesh.from_faces([*mesh.positions, *np.eye(3), *np.ones((8, 3))], faces_of(mesh))))
    assert "12 at (1, 1, 1), ... (3 more). Delete" in many


def test_vertices_of_valence_two_and_coincident_vertices_are_valid() -> None:
    # Two quads that share the two consecutive edges around vertex 8, which halves an edge of a cube.
    split = cube()
    faces = faces_of(split)
    a, b = faces[0][0], faces[0][1]
    middle = 0.5 * (split.positions[a] + split.positions[b])
    longer = []
    for face in faces:
        corners = [(x, 8) if {x, y} == {a, b} else (x,) for x, y in zip(face, face[1:] + face[:1], strict=True)]
        longer.append([v for corner in corners for v in corner])
    mesh = ControlMesh.from_faces([*split.positions, middle + np.array([0.0, 0.1, 0.1])], longer)
    assert check_mesh(mesh).valence_range == (2, 3)
    require_valid(mesh)
    pinched = torus(12, 5)
    positions = pinched.positions.copy()
    positions[7] = positions[32]
    require_valid(pinched.with_positions(positions))


def test_flipped_faces_are_the_fewer_ones_numbered_as_in_the_file() -> None:
    mesh, turned = torus(9, 7), [3, 20, 41]
    copied = flip(ControlMesh.from_faces(mesh.positions, [faces_of(mesh)[0], *faces_of(mesh)]), turned)
    assert elements(copied, "inconsistent orientation") == (3, 20, 41)  # copies of faces come before them
    rest = np.setdiff1d(np.arange(mesh.n_faces), turned)
    assert elements(flip(mesh, rest), "inconsistent orientation") == (3, 20, 41)


@pytest.mark.parametrize("name", ["cube", "torus", "tetrahedron", "ring of voxels"])
def test_mesh_turned_inside_out_is_refused(name: str) -> None:
    mesh = SHAPES[name][0]()
    assert elements(flip(mesh, np.arange(mesh.n_faces)), "inside out") == ()


def test_open_mesh_turned_inside_out_is_refused_but_a_sheet_is_not() -> None:
    box = keep_faces(cube(), np.arange(1, 6))
    require_valid(box)
    assert elements(flip(box, np.arange(5)), "inside out") == ()
    sheet = grid()
    require_valid(flip(sheet, np.arange(sheet.n_faces)))


def test_openings_are_closed_before_the_inside_is_judged() -> None:
    for cut in ([0], [0, 12], [3, 20, 21]):
        mesh = torus(8, 5)
        open_mesh = keep_faces(mesh, np.setdiff1d(np.arange(mesh.n_faces), cut))
        topology = mesh_topology(open_mesh)
        loops = boundary_loops(topology, corner_fans(topology))
        assert loops is not None
        closed = check_mesh(with_openings_closed(open_mesh, loops))
        assert closed.is_valid, str(closed)
        assert closed.boundary_loops == ()


def test_one_sided_surface_is_refused() -> None:
    mesh = moebius_strip()
    assert kinds(mesh) == ["one-sided surface"]
    assert elements(mesh, "one-sided surface") == ()
    assert check_mesh(mesh).genus is None


def test_edges_of_three_faces_are_named() -> None:
    mesh = cube()
    a, b = faces_of(mesh)[0][:2]
    fin = ControlMesh.from_faces([*mesh.positions, [0.0, 0.0, 9.0]], [*faces_of(mesh), [a, b, 8]])
    assert elements(fin, "non-manifold edges") == ((min(a, b), max(a, b)),)


def test_a_face_too_many_is_named_and_its_edges_are_not_to_be_split() -> None:
    """A wall inside a tube of two cubes, and a fin that stands out of it."""
    tube = [[x, y, z] for x in (0, 1, 2) for y in (0, 1) for z in (0, 1)]
    sides = [[4 * x + k for k in (0, 1, 3, 2)] for x in range(3)]
    around = [
        [4 * x + a, 4 * x + b, 4 * x + 4 + b, 4 * x + 4 + a]
        for x in (0, 1)
        for a, b in ((1, 0), (3, 1), (2, 3), (0, 2))
    ]
    faces = [sides[0], sides[2][::-1], *around]
    assert check_mesh(ControlMesh.from_faces(tube, faces)).is_valid
    for wall in (sides[1], sides[1][::-1]):
        (problem,) = [p for p in check_mesh(ControlMesh.from_faces(tube, [*faces, wall])).problems if "edges" in p.kind]
        assert problem.remedy == "Delete face(s) 10, which hang on such edges alone."
    fin = ControlMesh.from_faces([*tube, [1, 5, 0]], [[4, 6, 12], *faces])
    report = check_mesh(fin)
    assert "Delete face(s) 0," in report.problems[0].remedy
    assert "-  (2 boundary edges)" in str(report)


def test_a_tiny_edge_of_many_faces_is_to_be_merged() -> None:
    """Two cubes that share an edge: split it where it is long, merge its ends where it is almost a point."""
    for height, words in ((1.0, "split the edge"), (1e-4, "Merge the two vertices of edge(s) (0, 1)")):
        boxes = []
        for sign in (1, -1):
            corners = [[0, 0, 0], [0, 0, height], [sign, 0, 0], [sign, 0, 1], [0, sign, 0], [0, sign, 1]]
            numbers = np.array([0, 1, *range(2 + 4 * len(boxes), 6 + 4 * len(boxes))])
            walls = [[0, 1, 3, 2], [0, 4, 5, 1], [2, 3, 5, 4], [0, 2, 4], [1, 5, 3]]
            boxes.append((corners, [numbers[wall].tolist() for wall in walls]))
        points = boxes[0][0] + boxes[1][0][2:]
        (problem, *_) = [
            p
            for p in check_mesh(ControlMesh.from_faces(points, boxes[0][1] + boxes[1][1])).problems
            if "edges" in p.kind
        ]
        assert words in problem.remedy, problem.remedy


def test_slits_are_noted_and_openings_are_not() -> None:
    mesh = grid(4, 4)
    assert check_mesh(mesh).notes == ()
    hole = keep_faces(mesh, np.setdiff1d(np.arange(16), [5]))
    for size in (0.1, 1.0, 10.0):
        assert check_mesh(hole.with_positions(size * hole.positions)).notes == ()
    corners = hole.face_indices.copy()
    positions = hole.positions.copy()
    a, b, c, d = faces_of(mesh)[5]
    positions[[c, d]] = positions[[b, a]] + 1e-9
    (note,) = check_mesh(replace(hole, positions=positions, face_indices=corners)).notes
    assert "slit of 4 edges" in note
    assert "note: the boundary has a slit" in str(check_mesh(replace(hole, positions=positions)))


def test_many_slits_are_one_note() -> None:
    sliver = np.array([[0, 0, 0], [1, 0, 0], [0.5, 1e-4, 0]])
    points = np.concatenate([sliver + np.array([0, 0, i]) for i in range(11)])
    (note,) = check_mesh(ControlMesh.from_faces(points, np.arange(33).reshape(11, 3))).notes
    assert note.startswith("the boundary has 11 slits of 3 edges at vertices ")
    assert "(3 more)" in note


def test_vertices_where_two_pieces_touch_are_named() -> None:
    two = ControlMesh.from_faces(
        [*tetrahedron().positions, [2, 2, 2], [3, 1, 1], [1, 3, 1]],
        [*faces_of(tetrahedron()), (0, 5, 4), (0, 6, 5), (0, 4, 6), (4, 5, 6)],
    )
    assert kinds(two) == ["non-manifold vertices"]
    assert elements(two, "non-manifold vertices") == (0,)


def test_two_openings_may_not_meet_in_a_vertex() -> None:
    mesh = grid(4, 4)
    inner = [f for f, face in enumerate(faces_of(mesh)) if 12 in face]
    holes = keep_faces(mesh, np.setdiff1d(np.arange(16), [inner[0], inner[-1]]))
    assert elements(holes, "non-manifold vertices") == (12,)
    loops = check_mesh(holes).boundary_loops
    # Split there, the two holes of four edges are one of eight.
    assert sorted(len(loop) for loop in loops) == [8, 16]


@pytest.mark.parametrize("face", [[0, 1], [3], [0, 1, 2, 1], [5, 5, 6]])
def test_degenerate_faces_are_named(face: list[int]) -> None:
    assert elements(with_faces(cube(), face), "degenerate faces") == (6,)


def test_isolated_vertices_are_named() -> None:
    positions = np.insert(cube().positions, 3, [1e9, 0, 0], axis=0)
    indices = cube().face_indices + (cube().face_indices >= 3)
    mesh = replace(cube(), positions=positions, face_indices=indices)
    assert kinds(mesh) == ["isolated vertices"]
    assert elements(mesh, "isolated vertices") == (3,)


def beside(a: ControlMesh, b: ControlMesh) -> ControlMesh:
    shifted = [[v + a.n_vertices for v in face] for face in faces_of(b)]
    return ControlMesh.from_faces(np.concatenate([a.positions, b.positions]), [*faces_of(a), *shifted])


def test_several_components_are_counted_and_copies_recognised() -> None:
    apart = beside(cube(), tetrahedron())
    assert kinds(apart) == ["several components"]
    assert elements(apart, "several components") == (0, 6)
    assert check_mesh(apart).component_sizes == (6, 4)
    swapped = ControlMesh.from_faces(apart.positions, faces_of(apart)[6:] + faces_of(apart)[:6])
    assert check_mesh(swapped).component_sizes == (4, 6)  # in the order of the faces, not of the vertices
    assert "copy" not in str(check_mesh(apart).problems[0])
    assert "is a copy of another" in str(check_mesh(beside(cube(), cube())).problems[0])


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_positions_that_are_not_numbers_are_named(value: float) -> None:
    mesh = torus()
    positions = mesh.positions.copy()
    positions[[4, 9], 1] = value
    assert elements(mesh.with_positions(positions), "positions that are not numbers") == (4, 9)


def test_meshes_without_extent_area_or_volume_are_refused() -> None:
    mesh = torus()
    assert kinds(mesh.with_positions(np.ones_like(mesh.positions))) == ["no size"]
    line = mesh.positions * [1.0, 0, 0] @ np.array([[1.0, 2, 3], [0, 0, 0], [0, 0, 0]]) + 0.7
    assert kinds(mesh.with_positions(line)) == ["no area"]
    tilt = np.array([[1.0, 0.3, 0.2], [0.1, 1.0, 0.7], [0, 0, 0]])
    assert kinds(bipyramid(5).with_positions(bipyramid(5).positions @ tilt)) == ["no volume"]
    assert kinds(mesh.with_positions(1e200 * mesh.positions)) == ["size"]
    assert kinds(mesh.with_positions(1e-200 * mesh.positions)) == ["size"]
    # A flat sheet is a surface like any other.
    require_valid(grid().with_positions(grid().positions @ tilt))


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_faces_without_area_are_named_and_thin_ones_accepted(scale: float) -> None:
    mesh = bipyramid(6)
    face = faces_of(mesh)[0]
    positions = mesh.positions.copy()
    positions[face[0]] = 0.3 * positions[face[1]] + 0.7 * positions[face[2]]  # on one line, up to rounding
    flat = mesh.with_positions(scale * (positions + np.array([0.1, 0.2, 0.3])))
    assert 0 in elements(flat, "faces without area")
    off = 1e-11 * np.ptp(mesh.positions, axis=0).max()
    positions[face[0], 0] += off  # no more than a hair above the line
    assert 0 in elements(mesh.with_positions(scale * positions), "faces without area")
    # The smallest quads of the soma18056 cages hold 2e-9 of the area; ten times less must pass.
    small = grid(5, 5)
    positions = small.positions.copy()
    inner = np.array(faces_of(small)[12])
    centre = positions[inner].mean(axis=0)
    positions[inner] = centre + 1e-5 * np.ptp(positions, axis=0).max() * (positions[inner] - centre)
    require_valid(small.with_positions(scale * positions))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"positions": np.zeros((8, 2))}, r"shape \(n, 3\)"),
        ({"positions": np.zeros((8, 3), dtype=np.float32)}, "float64"),
        ({"face_offsets": np.array([0, 4, 4, 8, 12, 16, 24])}, "corners on every face.*faces: 1"),
        ({"face_offsets": np.array([0, 4, 8])}, "from 0 to 24"),
        ({"face_offsets": np.array([0]), "face_indices": np.zeros(0, dtype=np.int64)}, "at least one face"),
        ({"face_indices": np.arange(24)}, r"numbers from 0 to 7.*faces: 2, 3, 4, 5"),
        ({"face_indices": np.array([8, *cube().face_indices[1:]])}, r"numbers from 0 to 7.*faces: 0\."),
        ({"face_indices": np.array([-1, *cube().face_indices[1:]])}, r"numbers from 0 to 7.*faces: 0\."),
        ({"face_indices": np.zeros(24)}, "integer arrays"),
        ({"uvs": np.zeros((4, 2))}, "or neither"),
        ({"uvs": np.zeros((4, 2)), "uv_indices": np.zeros(23, dtype=np.int64)}, "one UV index per corner"),
        ({"uvs": np.zeros((4, 2)), "uv_indices": np.arange(24) // 4}, "UV indices from 0 to 3.*faces: 4, 5"),
        ({"uvs": np.full((4, 2), np.nan), "uv_indices": np.arange(24) % 4}, "finite texture"),
        ({"face_materials": np.zeros(5, dtype=np.int64), "material_names": ("a",)}, "material per face"),
        ({"face_materials": np.arange(6), "material_names": ("a", "b")}, "numbers from 0 to 1.*faces: 2, 3, 4, 5"),
        ({"material_colors": np.zeros((2, 3))}, "material_colors"),
        (
            {"crease_sharpness": np.ones(2)},
            r"expected crease_edges of shape \(k, 2\) together with crease_sharpness",
        ),
        ({"corner_vertices": np.array(3), "corner_sharpness": np.array(1.0)}, r"corner_vertices of shape \(k,\)"),
        ({"corner_vertices": np.array([1, -3]), "corner_sharpness": np.ones(2)}, "got others in 1 corner, corners: -3"),
        ({"corner_vertices": np.array([1, 2]), "corner_sharpness": np.ones(3)}, r"one sharpness per corner \(2\)"),
    ],
)
def test_arrays_that_do_not_fit_are_refused(change: dict[str, object], message: str) -> None:
    mesh = replace(cube(), **change)
    refuses(InvalidMeshError, message, require_valid, mesh)
    assert str(check_mesh(mesh))


@pytest.mark.slow
@pytest.mark.filterwarnings("error")
@settings(max_examples=60)
@given(mesh=polygon_meshes())
def test_any_arrays_get_a_verdict(mesh: ControlMesh) -> None:
    """Degenerate faces, positions up to 1e308, anything: problems, not exceptions and not warnings."""
    assert str(check_mesh(mesh))


def test_every_vertex_list_is_plain_python() -> None:
    report = check_mesh(keep_faces(cube(), np.arange(5)))
    assert isinstance(report, MeshReport)
    assert all(type(v) is int for loop in report.boundary_loops for v in loop)
    assert report == check_mesh(keep_faces(cube(), np.arange(5)))  # a value: equal if the contents are


def test_a_refusal_names_the_way_round_where_there_is_one() -> None:
    refuses(InvalidMeshError, r"Or use `plain_mesh`, which repairs the mesh", require_valid, flip(cube(), 1))
    pieces = join_meshes([tetrahedron(), tetrahedron()])  # a scan with a floating piece, and a cage with its eyes
    refuses(InvalidMeshError, r"Or use `plain_mesh`, which repairs the mesh", require_valid, pieces)
    with pytest.raises(InvalidMeshError, match=r"pieces not wanted\.[^`]*$"):
        require_valid(join_meshes([cube(), cube()]))
    flat = cube().with_positions(cube().positions * [1.0, 1.0, 0.0])
    with pytest.raises(InvalidMeshError) as refused:
        require_valid(flat)
    assert "plain_mesh" not in str(refused.value)


def test_places_far_from_the_origin_are_exact() -> None:
    assert place_text((100000.25, 0.123456, -2.0)) == "(100000.25, 0.1235, -2)"
    assert place_text((-8.674e-19, 9.247, 0.1576)) == "(0, 9.247, 0.1576)"
    assert place_text((np.inf, 1.0, np.nan)) == "(inf, 1, nan)"
    assert place_text((np.nan, 1.0, 0.0)) == "(nan, 1, 0)"
    assert place_text((2e-5, 1e-6, 0.0)) == "(2e-05, 1e-06, 0)"


def test_a_problem_says_whether_its_elements_are_vertices() -> None:
    mesh = pyramid()
    loose = check_mesh(ControlMesh.from_faces([*mesh.positions, [7.0, 8.0, 9.25]], faces_of(mesh)))
    assert [problem.of_vertices for problem in (*loose.problems, *check_mesh(flip(mesh, 1)).problems)] == [True, False]


def test_elements_are_numbered_as_in_the_file() -> None:
    torn = keep_faces(grid(4, 4), np.setdiff1d(np.arange(16), [5]))
    positions = torn.positions.copy()
    a, b, c, d = faces_of(grid(4, 4))[5]
    positions[[c, d]] = positions[[b, a]] + 1e-9
    fin = [[0, 1, 30], [30, 1, 31]]
    sheet = ControlMesh.from_faces([*positions, *np.random.default_rng(2).random((7, 3))], [*faces_of(torn), *fin])
    sheet = replace(flip(sheet, 3), file_vertices=100 + np.arange(32), file_faces=200 + np.arange(17))
    alone = replace(sheet, file_vertices=None, file_faces=None)
    found, own = check_mesh(sheet), check_mesh(alone)
    kinds = [problem.kind for problem in found.problems]
    assert kinds == [problem.kind for problem in own.problems]
    assert {"isolated vertices", "inconsistent orientation"} <= set(kinds)
    for one, other in zip(found.problems, own.problems, strict=True):
        shift = 100 if one.of_vertices or np.ndim(one.elements) == 2 else 200
        np.testing.assert_array_equal(one.elements, shift + np.array(other.elements))
        assert one.places == other.places
    slit = replace(torn.with_positions(positions), file_vertices=100 + np.arange(25))
    report = check_mesh(slit)
    assert min(min(loop) for loop in report.boundary_loops) == 100
    assert re.search(r"slit of 4 edges at vertices 1\d\d, 1\d\d, 1\d\d, 1\d\d,", report.notes[0])
    third = ControlMesh.from_faces(
        [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (0, -1, 0)], [(0, 1, 2), (1, 0, 3), (0, 1, 4)]
    )
    (edges, *_) = check_mesh(replace(third, file_vertices=10 + np.arange(5), file_faces=20 + np.arange(3))).problems
    assert edges.elements == ((10, 11),)
    assert "(10, 11) delete the inner ones of faces 20, 21, 22" in edges.remedy


def test_broken_positions_and_creases_of_a_part_are_numbered_as_in_the_file() -> None:
    mesh = replace(grid(2, 2), file_vertices=100 + np.arange(9), file_faces=200 + np.arange(4))
    (creases,) = check_mesh(mesh.with_creases([[0, 8]], 1.0)).problems
    assert creases.elements == ((100, 108),)
    positions = mesh.positions.copy()
    positions[4, 2] = np.nan
    (broken,) = check_mesh(mesh.with_positions(positions)).problems
    assert broken.elements == (104,)
    assert "104 at (" in str(broken)
    (uvs,) = check_mesh(mesh.with_uvs(np.full((70, 2), np.nan), np.arange(16))).problems
    assert uvs.elements[-1] == 69
