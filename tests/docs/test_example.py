"""The built-in pair: sound cages, real islands, landmarks that mean the same, paint that does not show the seams."""

from functools import cache

import numpy as np
import pytest
from examples.creatures.creatures import deer, pony
from examples.creatures.modelling import Creature, mirror_vertices
from examples.creatures.paint import paint_displacement, paint_texture
from examples.creatures.unwrap import flatten

from cagemap.example import example_pair
from cagemap.mesh import ControlMesh
from cagemap.mesh.checks import check_mesh
from cagemap.mesh.landmarks import check_landmarks
from cagemap.pictures import sample_texture
from cagemap.subdivision import refine, triangles
from cagemap.surface.triangles import triangle_areas, triangle_neighbors

from transfer_scenes import check_distance, check_layout, islands_of


@cache
def model(name: str) -> Creature:
    return {"pony": pony, "deer": deer}[name]()


@pytest.fixture(params=["pony", "deer"])
def creature(request: pytest.FixtureRequest) -> Creature:
    return model(request.param)


def mesh_islands(mesh: ControlMesh) -> int:
    return len(np.unique(islands_of(triangle_neighbors(triangles(refine(mesh, 1).finest.uv_indices)))))


def directed_edges(mesh: ControlMesh) -> set[tuple[int, int]]:
    return set(zip(mesh.face_indices.tolist(), mesh.face_indices[mesh.next_corners].tolist(), strict=True))


def test_is_closed_of_genus_0_and_oriented(creature: Creature) -> None:
    report = check_mesh(creature.mesh)
    assert report.is_valid
    assert (report.genus, report.boundary_loops) == (0, ())


def test_faces_outward(creature: Creature) -> None:
    finest = refine(creature.mesh, 2).finest
    corners = finest.positions[triangles(finest.faces)]
    volume = np.linalg.det(corners).sum() / 6
    size = np.ptp(finest.positions, axis=0).prod()
    assert volume > 0.05 * size  # a creature fills a good part of its box; turned inside out it is negative


def test_is_mirror_symmetric(creature: Creature) -> None:
    mesh = creature.mesh
    other = mirror_vertices(mesh)
    np.testing.assert_array_equal(mesh.positions[other], mesh.positions * [-1, 1, 1])
    np.testing.assert_allclose(creature.channels[other], creature.channels, atol=1e-15)
    assert {(other[b], other[a]) for a, b in directed_edges(mesh)} == directed_edges(mesh)


def test_connectivities_differ_and_have_polygons() -> None:
    first, second = model("pony").mesh, model("deer").mesh
    assert first.n_vertices != second.n_vertices
    assert first.n_faces != second.n_faces
    shares = []
    for mesh in (first, second):
        assert 200 <= mesh.n_faces <= 600
        sizes = np.bincount(mesh.face_sizes, minlength=9)
        assert sizes[4] > 0.9 * mesh.n_faces  # mostly quads
        assert sizes[3] > 0
        assert sizes[5:].sum() > 0
        shares.append(tuple(sizes))
    assert shares[0] != shares[1]


def test_stands_up_and_faces_forward(creature: Creature) -> None:
    positions, mark = creature.mesh.positions, creature.landmarks
    assert positions[mark["nose_tip"], 2] == pytest.approx(positions[:, 2].max(), abs=0.05)
    assert positions[mark["ear_tip_L"], 1] > 0.97 * positions[:, 1].max()
    assert positions[mark["hoof_hind_R"], 1] < 0.05 * positions[:, 1].max()
    assert positions[mark["tail_tip"], 2] < positions[mark["croup"], 2]
    assert positions[mark["eye_L"], 0] > 0  # facing +Z with +Y up, its own left is at +x


@pytest.mark.slow
def test_islands_are_apart_and_not_turned_over(creature: Creature) -> None:
    check_layout(creature.mesh)
    check_distance(creature.mesh, 512, 2.0)  # the islands keep 4 texels


def test_has_many_islands() -> None:
    counts = [mesh_islands(model(name).mesh) for name in ("pony", "deer")]
    assert min(counts) >= 12
    assert counts[0] != counts[1]


def test_texels_are_about_equally_large(creature: Creature) -> None:
    finest = refine(creature.mesh, 1).finest
    corners = finest.uvs[triangles(finest.uv_indices)]
    flat = np.linalg.det(corners[:, 1:] - corners[:, :1])
    density = np.sqrt(flat / triangle_areas(finest.positions, triangles(finest.faces)))
    low, high = np.percentile(density, [5, 95]) / np.median(density)
    assert low > 0.6
    assert high < 1.7


def test_landmarks_mean_the_same_on_both() -> None:
    pair = example_pair(16)
    marks = pair.landmarks
    check_landmarks(marks, pair.target, pair.source)
    assert len(marks) >= 20
    assert (marks.target_name, marks.source_name) == ("deer", "pony")
    for mesh, vertices in ((pair.target, marks.target), (pair.source, marks.source)):
        assert len(set(vertices.tolist())) == len(marks)
        other = dict(zip(marks.names, mirror_vertices(mesh)[vertices], strict=True))
        for name, vertex in zip(marks.names, vertices, strict=True):
            partner = {"_L": "_R", "_R": "_L"}.get(name[-2:])
            expected = marks.names.index(name[:-2] + partner) if partner else marks.names.index(name)
            assert other[name] == vertices[expected]
            assert mesh.positions[vertex, 0] * {"_L": 1, "_R": -1}.get(name[-2:], 0) >= 0
    # The figures' proportions differ, their order from nose to tail does not.
    along = ["nose_tip", "poll", "withers", "back", "croup", "tail_base", "tail_tip"]
    for mesh, vertices in ((pair.target, marks.target), (pair.source, marks.source)):
        z = mesh.positions[vertices[[marks.names.index(name) for name in along]], 2]
        assert np.all(np.diff(z) < 0)


def seam_samples(mesh: ControlMesh) -> tuple[np.ndarray, np.ndarray]:
    """UVs of points on seams, seen from one side and from the other."""
    start, end = mesh.face_indices, mesh.face_indices[mesh.next_corners]
    corner = {(int(a), int(b)): i for i, (a, b) in enumerate(zip(start, end, strict=True))}
    following = mesh.next_corners
    one, other = [], []
    for (a, b), i in corner.items():
        j = corner[b, a]
        here, there = mesh.uv_indices[[i, following[i]]], mesh.uv_indices[[following[j], j]]
        if a < b and not np.array_equal(here, there):
            share = np.linspace(0.1, 0.9, 9)[:, None]
            one.append(mesh.uvs[here[0]] * (1 - share) + mesh.uvs[here[1]] * share)
            other.append(mesh.uvs[there[0]] * (1 - share) + mesh.uvs[there[1]] * share)
    return np.concatenate(one), np.concatenate(other)


def test_paint_is_full_and_runs_on_across_seams() -> None:
    source = model("pony")
    texture, displacement = paint_texture(source, 512), paint_displacement(source, 512)
    assert texture.sum(axis=2).min() > 60  # texels outside the islands have the coat's colour, not black
    assert -0.02 <= displacement.min() < -0.01
    assert 0.015 < displacement.max() <= 0.03
    one, other = seam_samples(source.mesh)
    difference = np.abs(sample_texture(texture / 255.0, one) - sample_texture(texture / 255.0, other)).max(axis=1)
    # Texels are 0.007 long here: only samples on a colour's edge may differ. A shifted seam gives 0.2 on average.
    assert np.mean(difference) < 0.02
    assert np.mean(difference > 0.25) < 0.02
    relief = [sample_texture(displacement[:, :, None].astype(np.float64), uv)[:, 0] for uv in (one, other)]
    assert np.mean(np.abs(relief[0] - relief[1])) < 4e-4


def test_flatten_spreads_the_distortion_of_a_dome() -> None:
    # The conformal map alone makes areas at the pole 0.40 of those at the border, where the dome stands at 80 degrees;
    # the rigid iterations bring that to 0.74.
    ring, sector = 12, 24
    polar = np.radians(80) * np.repeat(np.arange(1, ring + 1), sector) / ring
    turn = 2 * np.pi * np.tile(np.arange(sector), ring) / sector
    dome = np.stack([np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), np.cos(polar)], axis=1)
    points = np.vstack([[[0.0, 0.0, 1.0]], dome])
    inner = 1 + np.arange((ring - 1) * sector)
    beside = inner + np.where((inner - 1) % sector == sector - 1, 1 - sector, 1)
    cap = np.stack([np.zeros(sector, np.int64), inner[:sector], beside[:sector]], axis=1)
    faces = np.concatenate(
        [cap, np.stack([inner, inner + sector, beside + sector], 1), np.stack([inner, beside + sector, beside], 1)]
    )
    flat = flatten(points, faces)
    ratio = np.linalg.det(flat[faces[:, 1:]] - flat[faces[:, :1]]) / triangle_areas(points, faces)
    assert ratio.min() > 0
    assert ratio[:sector].mean() / ratio[-sector:].mean() > 0.6
