"""Random creased cages, refined by OpenSubdiv itself (Debian's libosd-dev) and by us."""

import shutil
import subprocess
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from examples.shapes import bipyramid, cube, disk, grid, icosahedron, poles, pyramid, torus, triangulated
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from cagemap.mesh import Bilinear, CatmullClark, ControlMesh, Loop, Scheme
from cagemap.mesh.topology import layout_topology
from cagemap.subdivision import Level, refine
from cagemap.subdivision.face_varying import control_layout
from cagemap.subdivision.topology import control_state, control_topology

from locations import FIXTURES

PROGRAM = FIXTURES / "opensubdiv" / "refine.cpp"
SCHEMES = {Bilinear: 0, CatmullClark: 1, Loop: 2}
BOUNDARIES = ("none", "edge_only", "edge_and_corner")
UV_MODES = ("none", "corners_only", "corners_plus1", "corners_plus2", "boundaries", "all")
CREASINGS = ("uniform", "chaikin")
TRIANGLES = ("catmull_clark", "smooth")
# OpenSubdiv keeps sharpness in float32 (6e-8 of at most 10), and coordinates are below 5.
TOLERANCE = 1e-6

# Positions, UVs, faces, UV indices and holes of a level.
TheirLevel = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]
Oracle = Callable[[ControlMesh, Scheme, int], list[TheirLevel]]


@pytest.fixture(scope="module")
def opensubdiv(tmp_path_factory: pytest.TempPathFactory) -> Oracle:
    compiler = shutil.which("g++") or shutil.which("c++")
    if compiler is None:
        pytest.skip("no C++ compiler to build the OpenSubdiv comparison with")
    program = tmp_path_factory.mktemp("opensubdiv") / "refine"
    built = subprocess.run([compiler, "-O0", "-o", program, PROGRAM, "-losdCPU"], capture_output=True, text=True)
    if built.returncode:
        pytest.skip("OpenSubdiv is not installed (Debian: libosd-dev)")

    def run(mesh: ControlMesh, scheme: Scheme, levels: int) -> list[TheirLevel]:
        done = subprocess.run(
            [program], input=_as_text(mesh, scheme, levels), capture_output=True, text=True, check=True
        )
        return _read(np.array(done.stdout.split(), dtype=np.float64), levels)

    return run


def _as_text(mesh: ControlMesh, scheme: Scheme, levels: int) -> str:
    options = [
        SCHEMES[type(scheme)],
        BOUNDARIES.index(scheme.boundary),
        UV_MODES.index(scheme.uv_interpolation),
        CREASINGS.index(scheme.creasing),
        TRIANGLES.index(scheme.triangles),
        levels,
    ]
    arrays = [
        (mesh.positions, 3),
        (mesh.uvs, 2),
        (mesh.face_sizes, 1),
        (mesh.face_indices, 1),
        (mesh.uv_indices, 1),
        (mesh.crease_edges, 2),
        (mesh.corner_vertices, 1),
        (mesh.crease_sharpness, 1),
        (mesh.corner_sharpness, 1),
        (np.zeros(0) if mesh.hole_faces is None else mesh.hole_faces, 1),
    ]
    words = [str(option) for option in options]
    for array, per_item in arrays:
        words += [str(array.size // per_item), *(repr(value) for value in array.ravel().tolist())]
    return " ".join(words)


def _read(numbers: np.ndarray, levels: int) -> list[TheirLevel]:
    """All levels from the program's output."""
    result, at = [], 0

    def take(count: int) -> np.ndarray:
        nonlocal at
        at += count
        return numbers[at - count : at]

    for _ in range(levels):
        positions = take(3 * int(take(1)[0])).reshape(-1, 3)
        uvs = take(3 * int(take(1)[0])).reshape(-1, 3)[:, :2]
        count, size = take(2).astype(int)
        rows = take(count * (2 * size + 1)).astype(int).reshape(count, 2 * size + 1)
        result.append((positions, uvs, rows[:, :size], rows[:, size:-1], rows[:, -1] != 0))
    assert at == len(numbers)
    return result


SHAPES = [
    cube(),
    torus(4, 5),
    poles(3),
    poles(7),
    disk(5),
    grid(4, 3),
    pyramid(),
    icosahedron(),
    bipyramid(6),
    triangulated(disk(6)),
    triangulated(grid(3, 3)),
    triangulated(torus(4, 4)),
]
# Whether an edge has just lost all its sharpness changes the surface at once (its sharpness then counts in the blend of
# its vertex). Decimals with one digit meet that edge exactly under Chaikin's means, where OpenSubdiv's float32 decides.
SHARPNESS = st.sampled_from([0.31, 0.53, 1.0, 1.43, 2.0, 2.71, 10.0])


@st.composite
def cages(draw: st.DrawFn) -> ControlMesh:
    """A shape with disturbed vertices, UV islands, creases and corners."""
    mesh = draw(st.sampled_from(SHAPES))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    positions = mesh.positions + 0.15 * rng.standard_normal(mesh.positions.shape)
    # UVs of a vertex: one for each island of its faces, and here and there another for the first few of them.
    centres = np.stack([mesh.positions[mesh.face(face)].mean(axis=0) for face in range(mesh.n_faces)])
    sides = (centres @ rng.standard_normal((3, draw(st.integers(0, 2))))) > rng.uniform(-0.5, 0.5)
    islands = sides @ (1 << np.arange(sides.shape[1]))
    parted = rng.random(mesh.n_vertices) < draw(st.sampled_from([0.0, 0.1, 0.4]))
    topology = control_topology(mesh)
    own = parted[mesh.face_indices] & (topology.ranks < rng.integers(1, 4, mesh.n_vertices)[mesh.face_indices])
    keys = mesh.face_indices * 16 + islands[mesh.corner_faces] + 8 * own
    used, uv_indices = np.unique(keys, return_inverse=True)
    # OpenSubdiv makes two of a value around whose vertex another comes in between, or one, by where it starts counting.
    layout = layout_topology(mesh, uv_indices, len(used))
    assume(layout.ranks.min() >= 0)
    mesh = mesh.with_positions(positions).with_uvs(rng.random((len(used), 2)), uv_indices)
    edges = np.column_stack([mesh.face_indices, mesh.face_indices[mesh.next_corners]])
    edges = np.unique(np.sort(edges, axis=1), axis=0)
    chosen = draw(st.lists(st.integers(0, len(edges) - 1), max_size=8, unique=True))
    mesh = mesh.with_creases(edges[chosen], [draw(SHARPNESS) for _ in chosen])
    corners = draw(st.lists(st.integers(0, mesh.n_vertices - 1), max_size=3, unique=True))
    holes = draw(st.lists(st.integers(0, mesh.n_faces - 1), max_size=2, unique=True))
    mesh = replace(mesh, hole_faces=np.array(sorted(holes), dtype=np.int64)) if holes else mesh
    return mesh.with_corners(corners, [draw(SHARPNESS) for _ in corners])


@st.composite
def schemes(draw: st.DrawFn, mesh: ControlMesh) -> Scheme:
    kinds = [CatmullClark, CatmullClark, Bilinear] + ([Loop, Loop, Loop] if mesh.is_triangle_mesh else [])
    return draw(st.sampled_from(kinds))(
        draw(st.sampled_from(BOUNDARIES)),
        draw(st.sampled_from(UV_MODES)),
        draw(st.sampled_from(CREASINGS)),
        draw(st.sampled_from(TRIANGLES)),
    )


def _canonical(faces: np.ndarray, *beside: np.ndarray) -> list[np.ndarray]:
    """Faces turned so that their lowest vertex is first, in lexicographic order; and other corner values likewise."""
    turns = (np.argmin(faces, axis=1)[:, None] + np.arange(faces.shape[1])) % faces.shape[1]
    turned = np.take_along_axis(faces, turns, axis=1)
    order = np.lexsort(turned.T[::-1])
    return [turned[order], *(np.stack([v[np.arange(len(v)), t] for t in turns.T], 1)[order] for v in beside)]


def _agree(ours: Level, holes: np.ndarray, theirs: TheirLevel) -> None:
    """Compare a level."""
    positions, uvs, faces, uv_indices, their_holes = theirs
    gaps, order = cKDTree(positions).query(ours.positions)
    assume(len(np.unique(order)) == len(positions))  # vertices in nearly one place cannot be told apart
    assert gaps.max() < TOLERANCE
    per_corner = np.repeat(holes[:, None], ours.faces.shape[1], axis=1)
    mine, my_uvs, my_holes = _canonical(order[ours.faces], ours.uvs[ours.uv_indices], per_corner)
    expected, their_uvs, their_holes = _canonical(
        faces, uvs[uv_indices], np.repeat(their_holes[:, None], faces.shape[1], 1)
    )
    np.testing.assert_array_equal(mine, expected)
    np.testing.assert_array_equal(my_holes, their_holes)
    np.testing.assert_allclose(my_uvs, their_uvs, rtol=0, atol=TOLERANCE)


def _forgets_to_follow(mesh: ControlMesh, scheme: Scheme) -> bool:
    """Whether OpenSubdiv, by a fault at semi-sharp seams, keeps a UV sharp after the one it followed is smooth."""
    state = control_state(mesh, scheme)
    layout, _ = control_layout(mesh, state, scheme)
    if layout.follows is None or not state.is_sharp:
        return False
    following = layout.follows != np.arange(len(layout.follows))
    table, edges = state.topology, state.edges
    seam = layout.topology.edge_corners[layout.topology.edges, 1] < 0
    semi = seam & ((edges > 0) & (edges < 10))[table.edges]
    ends = np.concatenate([layout.topology.vertices[semi], layout.topology.vertices[table.following[semi]]])
    return bool(following[ends].any())


def _compare(data: st.DataObject, opensubdiv: Oracle) -> None:
    mesh = data.draw(cages())
    scheme = data.draw(schemes(mesh))
    assume(not _forgets_to_follow(mesh, scheme))
    ours, theirs = refine(mesh, 3, scheme), opensubdiv(mesh, scheme, 3)
    for level, their_level in enumerate(theirs, 1):
        _agree(ours.levels[level], ours.holes(level), their_level)


@pytest.mark.slow
@settings(max_examples=60)
@given(data=st.data())
def test_random_creased_cages(data: st.DataObject, opensubdiv: Oracle) -> None:
    _compare(data, opensubdiv)
