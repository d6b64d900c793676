"""Public names refuse what they cannot use by a named error; values equal themselves alone, and can be hashed."""

import copy
import dataclasses
import importlib
import inspect
import operator
import pickle
import pkgutil
import re
import warnings
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import NoneType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from examples.shapes import creature, cube
from scipy import sparse

import cagemap
from cagemap import (
    BakeOptions,
    BasisConfig,
    CagemapError,
    CatmullClark,
    ControlMesh,
    ElasticConfig,
    Landmarks,
    Masks,
    MatchConfig,
    PointMap,
    SurfacePoints,
    TriangleSurface,
    research,
)
from cagemap.character.roles import find_body
from cagemap.deform.placement import Placement
from cagemap.errors import ParameterError
from cagemap.example import example_pair
from cagemap.files.images.image import Image
from cagemap.maps.functional_maps import LevelMap
from cagemap.mesh.curves import CurvePair
from cagemap.numerics.kinds import _expected, kinds_checked
from cagemap.operators.laplacian import named_laplacian, stiffness, vertex_areas
from cagemap.research import gather_constraints
from cagemap.transfer.rays import ambient_occlusion
from cagemap.wrap.net import WrapConfig

from example_result import identity_result
from refusals import refuses

FUNCTIONS = [name for name in cagemap.__all__ if inspect.isfunction(getattr(cagemap, name))]
# Given to them are arrays and images alone, or a number.
OF_ARRAYS = {"blend", "painted_mask", "thread_limit", "with_alpha"}
# Of `cagemap.research`; some have the names of other functions of `cagemap`.
STEPS = [
    function
    for name in sorted(set(research.__all__) - {"control_mesh", "tensors"})
    if inspect.isfunction(function := getattr(research, name)) and function is not getattr(cagemap, name, None)
]


def checked(function: Callable[..., object]) -> dict[str, tuple[type, ...]]:
    return _expected(inspect.unwrap(function))


def some(kinds: tuple[type, ...]) -> object:
    """A value of one of these kinds, hollow where it is one of ours: no function gets as far as looking into it."""
    known = {int: 1, float: 1.0, str: "x", bool: False, Path: Path("x"), NoneType: None}
    return known[kinds[0]] if kinds[0] in known else object.__new__(kinds[0])


@pytest.mark.parametrize("function", [getattr(cagemap, name) for name in sorted(set(FUNCTIONS) - OF_ARRAYS)] + STEPS)
def test_values_of_another_kind_are_refused_by_the_name_of_their_parameter(function: Callable[..., object]) -> None:
    kinds, name = checked(function), function.__name__
    assert kinds, f"{name} looks at none of its arguments"
    needed = {
        parameter.name: some(kinds.get(parameter.name, (int,)))
        for parameter in inspect.signature(function).parameters.values()
        if parameter.default is inspect.Parameter.empty
    }
    for wrong in kinds:
        refuses(ParameterError, f"^{name}: {wrong}: expected ", function, **{**needed, wrong: object()})


def test_a_refusal_says_what_was_given_and_where_the_right_thing_comes_from() -> None:
    refuses(
        ParameterError,
        r"got a ControlMesh; prepare_surface.MESH, LEVEL. gives one",
        cagemap.prepare_pair,
        cube(),
        cube(),
    )
    with pytest.raises(ParameterError, match=r"control: expected ControlMesh, got 'a.obj'; read_mesh or"):
        cagemap.prepare_surface("a.obj", 1)
    refuses(ParameterError, r"levels: expected a whole number, got 1.5", cagemap.refine, cube(), 1.5)


def test_numbers_of_numpy_and_paths_as_text_are_of_the_right_kind() -> None:
    @kinds_checked
    def function(number: int, factor: float, name: str, path: str | Path, flag: bool, mesh: ControlMesh | None) -> int:
        return number

    for number, path in ((np.int32(1), "a"), (np.uint8(1), Path("a"))):
        assert function(number, np.float32(2), "x", path, np.True_, None) == 1
    assert function(1, 2, "x", "a", True, cube()) == 1
    for wrong in (True, 1.0, "1", None):
        refuses(ParameterError, "number: expected a whole number", function, wrong, 2, "x", "a", True, None)


def test_arguments_that_do_not_fit_are_refused_by_python_with_the_function_s_name() -> None:
    refuses(TypeError, r"^refine\(\) missing 2 required", cagemap.refine)
    refuses(TypeError, r"^refine\(\) got an unexpected keyword argument 'depth'", cagemap.refine, cube(), 1, depth=2)


@cache
def scene() -> Any:
    """A creature on itself."""
    surface = cagemap.prepare_surface(creature(), 1)
    places = np.arange(8) * 5
    landmarks = Landmarks(tuple("abcdefgh"), places, places)
    result = cagemap.match(surface, surface, landmarks)
    return SimpleNamespace(
        mesh=creature(),
        cube=cube(),
        surface=surface,
        refinement=surface.refinement,
        triangles=surface.triangles(surface.finest_level),
        n=len(surface.vertices),
        corners=creature().n_vertices,
        landmarks=landmarks,
        other=cagemap.prepare_surface(cube(), 2),
        pair=cagemap.pair_of(surface, surface, landmarks),
        pairs=cagemap.pair_of(surface, surface, landmarks).landmarks,
        functions=2 * (np.ones((surface.basis.count, 1)),),
        result=result,
        map=result.point_map,
        byte=np.zeros((4, 4, 3), np.uint8),
    )


def marks(target: object, source: object = (1, 2, 3)) -> Landmarks:
    return Landmarks(("a", "b", "c"), target, source)


def constraints(s: Any) -> research.Constraints:
    return gather_constraints(s.pair)


NAN = float("nan")
HOUSE: dict[str, Callable[[Any], object]] = {
    # meshes
    "positions of text": lambda s: ControlMesh.from_faces("abc", [[0, 1, 2]]),
    "positions of one column": lambda s: ControlMesh.from_faces(np.zeros(9), [[0, 1, 2]]),
    "complex positions": lambda s: ControlMesh.from_faces(s.cube.positions * 1j, [[0, 1, 2]]),
    "no positions": lambda s: ControlMesh.from_faces(None, [[0, 1, 2]]),
    "no faces": lambda s: ControlMesh.from_faces(s.cube.positions, None),
    "faces that are no numbers": lambda s: ControlMesh.from_faces(s.cube.positions, np.array([[0, 1, 2, NAN]])),
    "faces of fractions": lambda s: ControlMesh.from_faces(s.cube.positions, [[0, 1, 2.5]]),
    "an empty mesh": lambda s: cagemap.prepare_surface(ControlMesh.from_faces([], []), 1),
    "a face beyond the vertices": lambda s: cagemap.refine(ControlMesh.from_faces(s.cube.positions, [[0, 1, 99]]), 1),
    "a face below 0": lambda s: cagemap.refine(ControlMesh.from_faces(s.cube.positions, [[0, 1, -1]]), 1),
    "places that are no numbers": lambda s: cagemap.prepare_surface(s.mesh.with_positions(s.mesh.positions * NAN), 1),
    "too few positions": lambda s: s.mesh.with_positions(s.mesh.positions[:5]),
    "creases of three vertices": lambda s: s.mesh.with_creases([0, 1, 2], 1.0),
    "more sharpness than creases": lambda s: s.mesh.with_creases([[0, 1]], [1.0, 2.0]),
    "more sharpness than corners": lambda s: s.mesh.with_corners([0], [1.0, 2.0]),
    "no points, evenly spread": lambda s: SurfacePoints.evenly_spread(s.triangles, 0),
    "distances as a matrix": lambda s: cagemap.geodesic_error(s.map, np.arange(s.n), distances=np.zeros((s.n, s.n))),
    "uvs for other corners": lambda s: s.mesh.with_uvs(np.zeros((3, 2)), np.arange(5)),
    "uvs of three": lambda s: s.mesh.with_uvs(np.zeros((3, 3)), np.zeros(len(s.mesh.face_indices), int)),
    "uvs that are not there": lambda s: cagemap.prepare_surface(
        s.mesh.with_uvs(np.zeros((3, 2)), np.full(len(s.mesh.face_indices), 7)), 1
    ),
    "a creasing rule": lambda s: CatmullClark(creasing="x"),
    "too many vertices": lambda s: cagemap.choose_level(s.mesh, 10**12),
    "levels of one": lambda s: cagemap.prepare_surfaces(s.mesh, s.mesh, 1),
    "levels of three": lambda s: cagemap.prepare_surfaces(s.mesh, s.mesh, (1, 1, 1)),
    "operators of faces counted from 1": lambda s: stiffness(np.eye(3), np.array([[1, 2, 3]])),
    "areas of faces below 0": lambda s: vertex_areas(np.eye(3), np.array([[-1, 0, 1]])),
    "operators of pentagons": lambda s: stiffness(np.zeros((5, 3)), np.arange(5)[None]),
    "areas in the plane": lambda s: vertex_areas(np.zeros((3, 2)), np.arange(3)[None]),
    "a surface of faces counted from 1": lambda s: TriangleSurface.from_faces(np.eye(3), np.array([[1, 2, 3]])),
    # configurations
    "a basis of a fraction": lambda s: BasisConfig(count=10.5),
    "an accuracy that is no number": lambda s: BasisConfig(accuracy=NAN),
    "a schedule below 0": lambda s: BasisConfig(schedule=(10, -1)),
    "a schedule as text": lambda s: BasisConfig(schedule="10,5"),
    "more functions than vertices": lambda s: cagemap.prepare_surface(s.cube, 1, BasisConfig(count=5000)),
    "a schedule of too many levels": lambda s: cagemap.prepare_surface(s.cube, 1, BasisConfig(schedule=(4, 4, 4, 4))),
    "a schedule of too many functions": lambda s: cagemap.prepare_surface(s.cube, 1, BasisConfig(schedule=(100, 4))),
    "a method's basis": lambda s: cagemap.default_basis("x"),
    "an answer below 0": lambda s: MatchConfig(answer=-1),
    "an answer that is not there": lambda s: cagemap.match(s.surface, s.surface, s.landmarks, MatchConfig(answer=7)),
    "symmetries of numbers": lambda s: MatchConfig(symmetries=(1,)),
    "a number as symmetries": lambda s: MatchConfig(symmetries=3),
    "a weight below 0": lambda s: ElasticConfig(landmark_weight=-1),
    "a graph of nothing": lambda s: ElasticConfig(coarse_vertices=0),
    "a tile": lambda s: BakeOptions(tile=-4),
    "a tile before the first": lambda s: BakeOptions(tile=1000),
    "a tile after the last": lambda s: BakeOptions(tile=2000),
    "too many samples": lambda s: BakeOptions(supersample=17),
    "a filter": lambda s: BakeOptions(filter="x"),
    "a dilation below 0": lambda s: BakeOptions(dilation=-4),
    "no samples": lambda s: BakeOptions(supersample=0),
    "a Laplacian": lambda s: cagemap.build_operators(s.refinement, "cot"),
    "vertices of a basis": lambda s: BasisConfig(vertices=0),
    "an accuracy as text": lambda s: BasisConfig(accuracy="1e-3"),
    "a stabilisation as text": lambda s: BasisConfig(stabilisation="1"),
    "one number as a schedule": lambda s: BasisConfig(schedule=40),
    "a number of functions that is true": lambda s: BasisConfig(count=True),
    "a literal basis by a word": lambda s: BasisConfig(schedule=(9, 9), literal="no"),
    "a check by a word": lambda s: MatchConfig(check_landmarks="no"),
    "a number as masks": lambda s: MatchConfig(masks=1.0),
    "a number as ZoomOut": lambda s: research.HfmConfig(zoomout=3),
    "a Laplacian's name": lambda s: named_laplacian("cot"),
    "a wrap below level 0": lambda s: WrapConfig(level=-1),
    "an anchor below 0": lambda s: WrapConfig(anchor=-1.0),
    "no rays": lambda s: ambient_occlusion(s.triangles, 0),
    "a size of the texture": lambda s: example_pair(3),
    "a set of UVs": lambda s: s.mesh.with_uv_set("x"),
    "a body of no parts": lambda s: find_body(()),
    "operators below the level that is searched": lambda s: cagemap.prepare_pair(
        cagemap.prepare_surface(s.mesh, 2, BasisConfig(count=5, vertices=10)), s.surface
    ),
    # landmarks
    "landmarks of fractions": lambda s: marks([1.5, 2, 4]),
    "landmarks with a number left out": lambda s: cagemap.pair_of(s.surface, s.surface, [[1, 2], [3]]),
    "areas of polygons": lambda s: vertex_areas(np.eye(3), [[0, 1, 2], [0, 1]]),
    "landmarks as text": lambda s: marks("abc"),
    "landmarks of two rows": lambda s: cagemap.match(s.surface, s.surface, marks([[1, 2, 3]], [[1, 2, 3]])),
    "landmarks below 0": lambda s: cagemap.match(s.surface, s.surface, marks([1, 2, -1])),
    "a landmark twice": lambda s: cagemap.match(s.surface, s.surface, marks([1, 1, 3])),
    "fewer names than landmarks": lambda s: cagemap.match(
        s.surface, s.surface, Landmarks(("a",), np.array([1, 2]), np.array([1, 2]))
    ),
    "a curve of fractions": lambda s: CurvePair.of_vertices("lips", target=[0.5, 1], source=[0, 1]),
    "a number for names": lambda s: Landmarks(4, np.arange(4), np.arange(4)),
    "one name for all": lambda s: Landmarks("nose", np.arange(4), np.arange(4)),
    "an added landmark beyond the mesh": lambda s: cagemap.update_match(s.result, marks([1, 2, 9999])),
    "fewer points on one side": lambda s: cagemap.PointPairs(s.map.images, s.map.images.at(np.arange(3))),
    # maps
    "a map of three": lambda s: PointMap.from_vertices(s.triangles, s.triangles, np.zeros(3, int)),
    "a map beyond the source": lambda s: PointMap.from_vertices(s.triangles, s.triangles, np.full(s.n, s.n)),
    "a map below 0": lambda s: PointMap.from_vertices(s.triangles, s.triangles, np.full(s.n, -1)),
    "a map of fractions": lambda s: PointMap.from_vertices(s.triangles, s.triangles, np.full(s.n, 0.5)),
    "a map of prepared surfaces": lambda s: PointMap.from_vertices(s.surface, s.surface, np.arange(s.n)),
    "triangles of fractions": lambda s: PointMap.from_arrays(
        s.triangles, s.triangles, np.full(s.n, 0.5), np.full((s.n, 3), 1 / 3)
    ),
    "triangles beyond": lambda s: PointMap.from_arrays(
        s.triangles, s.triangles, np.full(s.n, 10**6), np.full((s.n, 3), 1 / 3)
    ),
    "coordinates of 5": lambda s: PointMap.from_arrays(s.triangles, s.triangles, np.zeros(s.n), np.full((s.n, 3), 5.0)),
    "coordinates that are no numbers": lambda s: PointMap.from_arrays(
        s.triangles, s.triangles, np.zeros(s.n), np.full((s.n, 3), NAN)
    ),
    "a matrix of another size": lambda s: PointMap.from_matrix(s.triangles, s.triangles, np.eye(3)),
    "a matrix of nothing": lambda s: PointMap.from_matrix(s.triangles, s.triangles, sparse.csr_array((s.n, s.n))),
    "a matrix as text": lambda s: PointMap.from_matrix(s.triangles, s.triangles, "x"),
    "one number to pull back": lambda s: s.map.pull_back(3.0),
    "a surface in the plane": lambda s: TriangleSurface(s.mesh.positions[:, :2], np.array([[0, 1, 2]])),
    "points in the plane": lambda s: SurfacePoints.nearest(s.triangles, np.zeros((3, 2))),
    "points that are nowhere": lambda s: SurfacePoints.nearest(s.triangles, np.full((3, 3), NAN)),
    "one normal of many points": lambda s: SurfacePoints.nearest(s.triangles, np.zeros((99, 3)), np.ones((1, 3))),
    "normals in the plane": lambda s: SurfacePoints.nearest(s.triangles, np.zeros((3, 3)), np.ones((3, 2))),
    "one guess of many points": lambda s: SurfacePoints.nearest(s.triangles, np.zeros((99, 3)), guess=np.zeros(1, int)),
    "a guess beyond": lambda s: SurfacePoints.nearest(s.triangles, np.zeros((3, 3)), guess=np.full(3, 10**6)),
    "places of three vertices": lambda s: cagemap.project(
        cagemap.prepare_pair(s.surface, s.surface), np.zeros((3, 3)), s.pairs
    ),
    "a held vertex beyond the target": lambda s: cagemap.unfold(s.map, np.array([10**7])),
    "a level beyond": lambda s: s.surface.triangles(9),
    "rows beyond": lambda s: s.surface.basis.rows(1, np.array([10**7])),
    "a level of a fraction": lambda s: s.surface.basis.at(0.5),
    "one number as a function": lambda s: s.surface.basis.project(3.0, 1),
    "a functional map of exchanged sides": lambda s: cagemap.functional_map_of(s.surface, s.other, s.map),
    "a fit of other surfaces": lambda s: cagemap.fit(cagemap.prepare_pair(s.surface, s.other), s.pair),
    "a projection by other surfaces": lambda s: research.project(
        s.pair, np.arange(s.n), cagemap.prepare_pair(s.other, s.surface)
    ),
    # steps of research
    "one number as landmarks": lambda s: research.make_pair(s.surface, s.surface, np.array(3)),
    "a dict of landmarks": lambda s: research.make_pair(s.surface, s.surface, {1: 2, 3: 4}),
    "a triple as landmarks": lambda s: research.make_pair(s.surface, s.surface, [[1, 2, 3]]),
    "no symmetries by None": lambda s: research.make_pair(s.surface, s.surface, symmetries=None),
    "a weight that is no number": lambda s: constraints(s).with_descriptors(*s.functions, weight=NAN),
    "a weight as text": lambda s: constraints(s).with_descriptors(*s.functions, weight="1"),
    "one level for both sides": lambda s: research.functional_map(s.pair, constraints(s), levels=1),
    "levels that are not there": lambda s: research.functional_map(s.pair, constraints(s), levels=(0, 9)),
    "a sparse matrix as a functional map": lambda s: research.point_map(s.pair, sparse.eye_array(9)),
    # masks and images
    "a mask of twos": lambda s: cagemap.vertex_mask(s.refinement, np.full(s.corners, 2.0)),
    "a mask that is no number": lambda s: cagemap.vertex_mask(s.refinement, np.full(s.corners, NAN)),
    "a mask by name": lambda s: cagemap.vertex_mask(s.refinement, "face"),
    "a mask of three faces": lambda s: cagemap.face_mask(s.refinement, np.zeros(3)),
    "an edge of another mask": lambda s: cagemap.soft_edge(s.triangles, np.ones(4), 0.1),
    "a match of another mask": lambda s: cagemap.match(
        s.surface, s.surface, s.landmarks, MatchConfig(masks=Masks(np.ones(3)))
    ),
    "a match of nothing": lambda s: cagemap.match(
        s.surface, s.surface, s.landmarks, MatchConfig(masks=Masks(np.zeros(s.n)))
    ),
    "a painted mask without uvs": lambda s: cagemap.painted_mask(s.refinement.finest, np.zeros((4, 4), np.uint8)),
    "words pulled back": lambda s: s.map.pull_back(np.full(s.n, "a")),
    "complex numbers pulled back": lambda s: s.map.pull_back(np.full(s.n, 1j)),
    "images of two sizes": lambda s: cagemap.blend(s.byte, np.zeros((5, 4, 3), np.uint8), np.zeros((4, 4, 1))),
    "alpha of another size": lambda s: cagemap.with_alpha(s.byte, np.zeros((3, 3))),
    "grey images to blend": lambda s: cagemap.blend(s.byte[..., 0], s.byte[..., 0] * 1.0, np.zeros((4, 4, 1))),
    "a weight to blend by, of another size": lambda s: cagemap.blend(s.byte, s.byte, np.zeros((4, 4))),
    "signed integers to blend": lambda s: cagemap.blend(s.byte.astype(int), s.byte.astype(int), np.zeros((4, 4, 1))),
    "alpha on signed integers": lambda s: cagemap.with_alpha(s.byte.astype(int), np.zeros((4, 4, 1))),
    "an image without uvs": lambda s: cagemap.bake(s.result, s.byte, size=16),
    "an image of float64": lambda s: cagemap.write_image("x.png", np.zeros((4, 4, 3))),
    "an image of nothing": lambda s: cagemap.write_image("x.png", np.zeros((0, 4, 3), np.uint8)),
    "an image as a list": lambda s: cagemap.write_image("x.png", [[1, 2], [3, 4]]),
    "landmarks that are not there": lambda s: cagemap.read_landmarks("none.json", "a", "b"),
    "a mesh that is not there": lambda s: cagemap.read_mesh("none.obj"),
}


@pytest.mark.parametrize("case", HOUSE)
def test_wrong_values_are_refused_by_name(case: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    ready = scene()
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # a warning of NumPy's is a wrong answer to be
        with pytest.raises(CagemapError) as refused:
            HOUSE[case](ready)
    assert len(str(refused.value)) > len("expected, got")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_arrays_of_every_layout_and_type_give_the_same() -> None:
    """Read-only arrays, single precision, lists, every second column: as good as any."""
    s = scene()
    values = np.arange(3.0 * s.n).reshape(s.n, 3) % 7
    wanted = s.map.pull_back(values)
    wide = np.repeat(values, 2, axis=1)
    frozen = values.copy()
    frozen.flags.writeable = False
    for given in (values.tolist(), values.astype(np.float32), np.asfortranarray(values), wide[:, ::2], frozen):
        np.testing.assert_allclose(s.map.pull_back(given), wanted, atol=1e-5)
    images = s.map.triangle, s.map.barycentric
    for triangle in (images[0].astype(np.int32), images[0].astype(float), images[0].tolist()):
        same = PointMap.from_arrays(s.triangles, s.triangles, triangle, images[1])
        np.testing.assert_array_equal(same.triangle, images[0])
    for names in (np.array(["a", "b", "c"]), iter("abc"), ["a", "b", "c"]):
        assert Landmarks(names, [0, 1, 2], [0, 1, 2]).names == ("a", "b", "c")
    levels: Any = np.array([1, 2])
    assert [one.finest_level for one in cagemap.prepare_surfaces(s.mesh, s.mesh, levels)] == [1, 2]
    small = marks(np.array([0, 50, 100], np.uint8), [0, 50, 100])
    assert small.target.dtype == np.int64
    assert operator.eq(*map(tuple, (small.target, small.source)))
    faces = [list(map(int, s.mesh.face(face))) for face in range(s.mesh.n_faces)]
    for positions in (s.mesh.positions.tolist(), s.mesh.positions.astype(np.float32), s.mesh.positions[::1]):
        np.testing.assert_allclose(ControlMesh.from_faces(positions, faces).positions, s.mesh.positions, atol=1e-6)


def test_arrays_that_change_later_change_no_value() -> None:
    s = scene()
    triangle, barycentric = s.map.triangle.copy(), s.map.barycentric.copy()
    points, weights, own = np.array([1, 2, 3]), np.ones(s.n), np.eye(9)
    moved = PointMap.from_arrays(s.triangles, s.triangles, triangle, barycentric)
    named, masks, functional_map = marks(points), Masks(weights), research.functional_map_of(s.pair, own)
    for array in (triangle, barycentric, points, weights, own):
        array[:] = 0
    np.testing.assert_array_equal(moved.images.positions, s.map.images.positions)
    assert (named.target.tolist(), masks.target.min(), functional_map[0, 0]) == ([1, 2, 3], 1.0, 1.0)
    for matrix in (s.surface.operators.mass[1], s.surface.operators.stiffness[1]):
        with pytest.raises(ValueError, match="read-only"):
            matrix *= 2.0


def test_a_map_of_another_surface_is_not_judged() -> None:
    result = identity_result(2)
    coarse = PointMap.from_vertices(result.target.triangles(1), result.source.triangles(1), np.arange(26))
    refuses(ParameterError, r"98 finest vertices of large\.obj, got one of 26", cagemap.judge, result.target, coarse)


ARRAYS = re.compile(r"Array|ndarray|csr_array|csc_array|TriangleSurface|SurfacePoints")


def values_with_arrays() -> list[type]:
    found = []
    for module in pkgutil.walk_packages(cagemap.__path__, "cagemap."):
        if module.name.startswith("cagemap.studio"):  # needs libraries that are not always there
            continue
        for one in vars(importlib.import_module(module.name)).values():
            if isinstance(one, type) and dataclasses.is_dataclass(one) and one.__module__ == module.name:
                # Words of help texts in annotations are no types.
                types = [re.sub(r"""(["']).*?\1""", "", str(field.type)) for field in dataclasses.fields(one)]
                if any(ARRAYS.search(kind) for kind in types):
                    found.append(one)
    return found


def test_values_of_arrays_are_equal_to_themselves_alone_and_hashable() -> None:
    values = values_with_arrays()
    assert len(values) > 50
    # A configuration that may be given arrays compares by what it holds; what starts with _ is no value.
    wrong = [
        one.__name__
        for one in values
        if one.__eq__ is not object.__eq__ and one.__name__[0] != "_" and not one.__name__.endswith("Config")
    ]
    assert wrong == []
    assert all(one.__hash__ is not None for one in values if one.__name__[0] != "_")


def test_configurations_with_arrays_compare_by_what_they_hold_and_stay_short() -> None:
    for options in ({}, {"masks": cagemap.Masks(np.ones(999))}, {"symmetries": (2 * (np.arange(9999),),)}):
        method = "paper" if "symmetries" in options else "elastic"
        config = MatchConfig(method=method, **options)
        for equal in (pickle.loads(pickle.dumps(config)), copy.deepcopy(config)):
            assert config == equal
            assert hash(config) == hash(equal)
        assert len(repr(config)) < 250
        assert config != dataclasses.replace(config, use_symmetry=False)
        assert (config == MatchConfig(method=method)) == (not options)
    assert MatchConfig(masks=cagemap.Masks(np.ones(9))) != MatchConfig(masks=cagemap.Masks(None, np.ones(9)))
    shared = MatchConfig(masks=cagemap.Masks().within(cagemap.Masks(np.ones(9), np.ones(8))))
    assert pickle.loads(pickle.dumps(shared)) == shared != MatchConfig(masks=cagemap.Masks(np.ones(9), np.ones(8)))
    assert MatchConfig() != 0


def test_configurations_show_what_was_chosen_and_signatures_stay_short() -> None:
    config = MatchConfig(answer=1, elastic=ElasticConfig(coarse_vertices=10))
    assert repr(config) == "MatchConfig(elastic=ElasticConfig(coarse_vertices=10), answer=1)"
    assert repr(MatchConfig()) == "MatchConfig()"
    assert len(str(inspect.signature(cagemap.match))) < 300


def test_values_show_themselves_in_a_line() -> None:
    """What a notebook shows of them: no arrays."""
    result = identity_result(1)
    mesh, pair = result.target.control, cagemap.pair_of(result.target, result.source, result.landmarks)
    image = Image(np.zeros((4, 8, 3), dtype=np.uint8), (), "sRGB")
    values = (mesh, result, result.landmarks, pair, cagemap.transfer_of(result), image, result.target.operators)
    values += (pair.landmarks, result.quality, result.spectral, cagemap.Masks(target=np.ones(4)))
    values += (cagemap.weld_mesh(mesh), cagemap.plain_mesh(mesh), gather_constraints(pair))
    values += (LevelMap((0, 0), np.eye(9), np.arange(9)), Placement(np.zeros((9, 3))))
    for value in values:
        assert re.fullmatch(rf"{type(value).__name__}\(.{{10,250}}\)", repr(value)), repr(value)
        assert "array" not in repr(value)
    assert repr(mesh) == f"ControlMesh({mesh.name!r}, {mesh.n_vertices} vertices, {mesh.n_faces} faces)"
    assert repr(cagemap.Masks(np.eye(4)[0])) == "Masks(target: 1 of 4 vertices)"
    assert repr(image) == "Image(4 x 8 x 3 uint8, sRGB)"
