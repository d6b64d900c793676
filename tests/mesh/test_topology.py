"""Connectivity of control meshes, compared with a slow twin that goes face by face; measures of known shapes."""

from collections import defaultdict
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from examples.shapes import bipyramid, cube, grid, torus
from hypothesis import given, settings
from hypothesis import strategies as st

from cagemap.mesh import ControlMesh
from cagemap.mesh.checks import check_mesh
from cagemap.mesh.faces import cage_triangles, duplicate_faces, face_areas, face_extents, keep_faces, signed_volume
from cagemap.mesh.topology import boundary_loops, corner_fans, face_components, mesh_topology, turned_faces, uv_islands

from mesh_faults import faces_of, flip, kinds

# --- the slow twin -------------------------------------------------------------------------------------------------


def slow_edges(faces: list[list[int]]) -> dict[tuple[int, int], list[tuple[int, bool]]]:
    """Faces at every edge, and whether each runs from the lower to the higher vertex."""
    edges: dict[tuple[int, int], list[tuple[int, bool]]] = defaultdict(list)
    for f, face in enumerate(faces):
        for a, b in pairwise([*face, face[0]]):
            edges[min(a, b), max(a, b)].append((f, a < b))
    return edges


def slow_groups(count: int, links: list[tuple[int, int]]) -> list[int]:
    group = list(range(count))
    for a, b in links * count:  # enough rounds for any chain
        group[a] = group[b] = min(group[a], group[b])
    return group


def slow_fans(faces: list[list[int]]) -> dict[int, int]:
    """Number of fans at every vertex."""
    edges = slow_edges(faces)
    fans = {}
    for vertex in {v for face in faces for v in face}:
        around = [f for f, face in enumerate(faces) if vertex in face]
        links = [
            (around.index(f), around.index(g))
            for edge, at in edges.items()
            if vertex in edge
            for f, _ in at
            for g, _ in at
        ]
        fans[vertex] = len(set(slow_groups(len(around), links)))
    return fans


def slow_turned(faces: list[list[int]]) -> set[int] | None:
    """Smallest set of faces to turn, by trying all; None if there is none."""
    pairs = [at for at in slow_edges(faces).values() if len(at) == 2]
    best = None
    for choice in range(2 ** len(faces)):
        turned = {f for f in range(len(faces)) if choice >> f & 1}
        if all((a in turned) ^ x ^ (b in turned) ^ y for (a, x), (b, y) in pairs) and (
            best is None or len(turned) < len(best)
        ):
            best = turned
    return best


@st.composite
def soups(draw: st.DrawFn) -> ControlMesh:
    """A few polygons on few vertices, or some faces of a shape with some turned: often not manifold."""
    if draw(st.booleans()):
        corners = st.lists(st.integers(0, 6), min_size=3, max_size=4, unique=True)
        faces = draw(st.lists(corners, min_size=1, max_size=7))
    else:
        shape = faces_of(draw(st.sampled_from([cube(), bipyramid(4), grid(3, 3), torus(3, 3)])))
        faces = draw(st.lists(st.sampled_from(shape), min_size=1, max_size=8, unique_by=tuple))
        faces = [face[::-1] if draw(st.integers(0, 3)) == 0 else face for face in faces]
    positions = np.random.default_rng(len(faces)).random((20, 3))
    return ControlMesh.from_faces(positions, faces)


@pytest.mark.slow
@settings(max_examples=60)
@given(mesh=soups())
def test_connectivity_agrees_with_the_slow_twin(mesh: ControlMesh) -> None:
    copies = duplicate_faces(mesh)
    everything = faces_of(mesh)
    assert copies.tolist() == [
        i for i, face in enumerate(everything) if any(set(face) == set(other) for other in everything[:i])
    ]
    mesh = keep_faces(mesh, np.delete(np.arange(mesh.n_faces), copies))
    faces = faces_of(mesh)
    edges, table = slow_edges(faces), mesh_topology(mesh)
    assert {(a, b): n for (a, b), n in zip(table.edge_vertices.tolist(), table.face_counts.tolist(), strict=True)} == {
        edge: len(at) for edge, at in edges.items()
    }
    for corner, (a, b) in enumerate(zip(mesh.face_indices, mesh.face_indices[mesh.next_corners], strict=True)):
        assert table.edge_vertices[table.edges[corner]].tolist() == sorted([a, b])

    fans = corner_fans(table)
    found = {(int(v), int(f)) for v, f in zip(mesh.face_indices, fans, strict=True)}
    expected_fans = slow_fans(faces)
    assert {v: sum(v == w for w, _ in found) for v in expected_fans} == expected_fans

    turned = turned_faces(table)
    expected = slow_turned(faces)
    assert (turned is None) == (expected is None)
    if turned is not None:
        turned = set(np.flatnonzero(turned).tolist())
        assert len(turned) == len(expected)
        pairs = [at for at in edges.values() if len(at) == 2]
        assert all((a in turned) ^ x ^ (b in turned) ^ y for (a, x), (b, y) in pairs)

    touching = [(i, j) for i, f in enumerate(faces) for j, g in enumerate(faces) if set(f) & set(g)]
    groups = slow_groups(len(faces), touching)
    labels = face_components(mesh).tolist()
    assert [labels.index(label) for label in labels] == [groups.index(group) for group in groups]

    loops = boundary_loops(table, fans)
    rims = {edge for edge, at in edges.items() if len(at) == 1}
    if loops is not None:
        steps = [step for loop in loops for step in zip(loop.tolist(), np.roll(loop, -1).tolist(), strict=True)]
        assert sorted(tuple(sorted(step)) for step in steps) == sorted(rims)
        for a, b in steps:  # along the faces' own half-edges
            assert edges[min(a, b), max(a, b)][0][1] == (a < b)
    else:
        assert any(len(at) > 2 for at in edges.values()) or any(
            len(at) == 2 and at[0][1] == at[1][1] for at in edges.values()
        )

    bad = [
        kind
        for kind in ("non-manifold edges", "non-manifold vertices", "inconsistent orientation")
        if kind in kinds(mesh)
    ]
    assert ("non-manifold edges" in bad) == any(len(at) > 2 for at in edges.values())
    assert ("non-manifold vertices" in bad) == any(n > 1 for n in expected_fans.values())
    assert ("inconsistent orientation" in bad) == bool(expected)


def test_uv_islands_are_cut_by_seams() -> None:
    mesh = cube()
    apart = mesh.with_uvs(np.zeros((24, 2)), np.arange(24))
    labels = uv_islands(apart)
    assert labels.tolist() == [0, 1, 2, 3, 4, 5]
    assert check_mesh(mesh.with_uvs(np.zeros((8, 2)), mesh.face_indices)).uv_islands == 1
    assert uv_islands(mesh) is None


def test_measures_of_known_shapes() -> None:
    mesh = cube()  # [-1, 1]^3
    np.testing.assert_allclose(face_areas(mesh), 4.0, rtol=1e-15)
    np.testing.assert_allclose(face_extents(mesh), 2.0, rtol=1e-15)
    moved = mesh.with_positions(mesh.positions + np.array([7.0, 0, 0]))
    np.testing.assert_allclose(signed_volume(moved), 8.0, rtol=1e-13)  # cancellation of terms ~ 7^3
    np.testing.assert_allclose(signed_volume(flip(moved, np.arange(6))), -8.0, rtol=1e-13)
    mixed = ControlMesh.from_faces(np.zeros((6, 3)), [(0, 1), (0, 1, 2, 3, 4), (5, 4, 3)])
    triangles, faces = cage_triangles(mixed)
    assert triangles.tolist() == [[0, 1, 2], [0, 2, 3], [0, 3, 4], [5, 4, 3]]
    assert faces.tolist() == [1, 1, 1, 2]


def test_ranks_do_not_depend_on_vertices_without_a_face(monkeypatch: pytest.MonkeyPatch) -> None:
    """As UVs that no face uses; memory that is not set held random corners."""
    mesh = grid(3, 3)
    topology = mesh_topology(mesh)
    monkeypatch.setattr(np, "empty", lambda shape, dtype: np.full(shape, len(mesh.face_indices) + 5, dtype=dtype))
    loose = replace(topology, n_vertices=topology.n_vertices + 3)
    np.testing.assert_array_equal(loose.ranks, topology.ranks)
