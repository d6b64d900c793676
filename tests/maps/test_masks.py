"""Masks: what of two surfaces is matched and transferred; what lies outside stays the target's own."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples.shapes import cube, icosahedron, pyramid
from hypothesis import given, settings
from hypothesis import strategies as st

from cagemap.deform.data import SurfaceSamples, source_to_target, target_to_source
from cagemap.deform.graph import mesh_graph
from cagemap.errors import FormatError, ParameterError
from cagemap.files.images.image import write_image
from cagemap.files.result.folder import read_result, write_result
from cagemap.files.values.attributes import write_attributes
from cagemap.maps.masks import Masks, face_mask, soft_edge, vertex_mask
from cagemap.maps.quality import NOTHING_JOINED, measure_quality
from cagemap.mesh import ControlMesh
from cagemap.pipeline import MatchConfig
from cagemap.subdivision import refine
from cagemap.surface.triangle_surface import SurfacePoints, TriangleSurface
from cagemap.tasks.masks import mask_file, read_mask, read_masks
from cagemap.tasks.requests.transfer import TransferRequest
from cagemap.transfer import BakeOptions, bake_texture, prepare_transfer
from cagemap.transfer.displacement import to_grey
from cagemap.transfer.masks import bake_mask, blend, painted_mask, with_alpha

from example_result import identity_result
from refusals import refuses
from transfer_scenes import identity_map, plane


def _surface(mesh: ControlMesh, level: int) -> TriangleSurface:
    finest = refine(mesh, level).finest
    return TriangleSurface.from_faces(finest.positions, finest.faces)


def test_a_set_of_faces_does_not_leak_and_a_vertex_group_is_refined() -> None:
    refinement = refine(cube(), 3)
    mask = face_mask(refinement, np.eye(6)[2])
    faces, parents = refinement.finest.faces, refinement.finest.face_parents
    assert np.all(mask[np.unique(faces[parents != 2])] == 0)
    inside = np.setdiff1d(faces[parents == 2], faces[parents != 2])
    assert len(inside) == 49
    assert np.all(mask[inside] == 1)
    group = np.array([0, 0, 0, 0, 1, 1, 1, 1.0])
    np.testing.assert_allclose(vertex_mask(refinement, group), refinement.prolong(group, 0, 3), atol=1e-15)
    refuses(ParameterError, "8 numbers from 0 to 1, one a control vertex", vertex_mask, refinement, np.full(8, 1.5))
    refuses(ParameterError, "6 numbers from 0 to 1, one a control face", face_mask, refinement, np.ones(8))
    words = "face mask: expected a mesh refined at least once, got its control mesh. Refine it once"
    refuses(ParameterError, words, face_mask, refine(pyramid(), 0), np.ones(5))


def test_masks_that_the_map_does_not_join_leave_the_figures_of_the_target_s_mask() -> None:
    result = identity_result()
    upper = (result.target.vertices[:, 2] > 0).astype(np.float64)
    apart, own = (measure_quality(result.point_map, masks=Masks(upper, source)) for source in (1.0 - upper, None))
    assert apart.flipped_area == own.flipped_area
    assert apart.trusted_area == own.trusted_area
    assert apart.warnings[0] == NOTHING_JOINED
    assert NOTHING_JOINED not in own.warnings


@pytest.mark.slow
@settings(max_examples=30)
@given(width=st.floats(0.0, 1.0), face=st.integers(0, 5))
def test_a_soft_edge_lies_inside_and_rises_no_faster_than_its_width(width: float, face: int) -> None:
    surface = _surface(cube(), 3)
    mask = face_mask(refine(cube(), 3), np.eye(6)[face])
    soft = soft_edge(surface, mask, width)
    assert np.all(soft[mask == 0] == 0)
    assert np.all((soft <= mask) & (soft >= 0))
    a, b = surface.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).T
    lengths = np.linalg.norm(surface.positions[a] - surface.positions[b], axis=1)
    if width > 0:
        assert np.all(np.abs(soft[a] - soft[b]) <= 1e-12 + lengths / max(width, 1e-9))
    else:
        np.testing.assert_array_equal(soft, mask)


def test_masks_of_other_surfaces_and_of_nothing_are_refused() -> None:
    masks = Masks(np.ones(5), None)
    refuses(ParameterError, "target mask: expected 6 numbers", masks.require_fit, 6, 3)
    refuses(ParameterError, "source mask: expected some", Masks(None, np.zeros(3)).require_fit, 6, 3)
    refuses(ParameterError, "method elastic", MatchConfig, method="hfm", masks=masks)
    with pytest.raises(ParameterError, match="finite width"):
        soft_edge(TriangleSurface(np.eye(3), np.array([[0, 1, 2]])), np.zeros(3), np.inf)


def test_a_correspondence_counts_as_the_product_of_its_ends() -> None:
    """Neither way does what is masked pull, nor is it pulled."""
    surface = _surface(icosahedron(), 3)
    graph = mesh_graph(surface, surface.triangles)
    moved = 1.05 * surface.positions
    low, left = (surface.positions[:, k] > 0 for k in (2, 0))
    masks = Masks(low.astype(float), left.astype(float))
    nearest = SurfacePoints.nearest(surface, moved, surface.vertex_normals, normal_weight=0.03)
    plain, _, _ = target_to_source(graph.areas, nearest, surface.vertex_normals)
    blocks, _, closest = target_to_source(graph.areas, nearest, surface.vertex_normals, masks)
    ends = low * masks.source  # every vertex of the ball lies over itself
    np.testing.assert_allclose(blocks, plain * ends[:, None, None], atol=1e-9)
    pullers = SurfaceSamples.at_vertices(surface, surface.n, masks.source)
    places = surface, pullers, moved, surface.vertex_normals
    _, _, back, _ = source_to_target(*places, closest=closest, alpha=1e-3, masks=masks)
    # Around the mask's border a puller's foot has corners on both sides.
    for side in (low, left):
        ring = np.zeros(surface.n, dtype=bool)
        ring[surface.triangles[np.any(side[surface.triangles], axis=1)]] = True
        assert np.all(back[~ring] == 0)
    assert back[low & left].sum() > 0.2


def test_figures_are_those_of_what_counts() -> None:
    level = plane(16, 16)
    here = identity_map(level)
    half = level.positions[:, 0] > 0.5
    folded = level.positions.copy()
    folded[half, 0] = 1.0 - folded[half, 0]
    target = TriangleSurface.from_faces(level.positions, level.faces)
    number = np.argmin(((target.positions * target.scale**-1)[:, None] - folded[None]) ** 2 @ np.ones(3), axis=0)
    point_map = type(here).from_vertices(target, here.source, number)
    whole = measure_quality(point_map)
    mask = (level.positions[:, 0] < 0.4).astype(float)
    part = measure_quality(point_map, masks=Masks(mask, mask))
    assert whole.flipped_area > 0.3
    assert part.flipped_area == 0.0
    assert whole.coverage < 0.6
    assert part.coverage > 0.95
    assert any("folded" in text for text in whole.warnings)
    assert part.warnings == ()


def test_what_was_painted_is_read_where_it_lies() -> None:
    level = plane(8, 8)
    image = np.zeros((64, 64), dtype=np.uint8)
    image[:, :32] = 255  # left half
    np.testing.assert_array_equal(
        painted_mask(level, image), (level.positions[:, 0] < 0.5).astype(float) + 0.5 * (level.positions[:, 0] == 0.5)
    )
    seen = np.dstack([image, image, image, np.full_like(image, 51)])  # a fifth of it, by its alpha
    np.testing.assert_allclose(painted_mask(level, seen)[0], 0.2, atol=1e-12)


def test_a_bake_is_blended_by_both_masks() -> None:
    level = plane(8, 8)
    left = (level.positions[:, 0] <= 0.5).astype(float)
    lower = (level.positions[:, 1] <= 0.5).astype(float)
    transfer = prepare_transfer(level, level, identity_map(level), Masks(left, lower))
    weight = bake_mask(transfer, size=64, options=BakeOptions())
    assert np.all(weight[33:, :31] == 1)
    assert np.all(weight[:23] == 0)  # above the first row of faces beyond the border
    assert np.all(weight[:, 41:] == 0)
    rng = np.random.default_rng(0)
    texture, base = (rng.integers(0, 256, (64, 64, 3), dtype=np.uint8) for _ in range(2))
    baked = bake_texture(transfer, texture, size=64)
    mixed = blend(baked, base, weight)
    np.testing.assert_array_equal(mixed[:23], base[:23])
    np.testing.assert_array_equal(mixed[33:, :31], texture[33:, :31])
    faded = with_alpha(baked, weight)
    assert faded.shape == (64, 64, 4)
    np.testing.assert_array_equal(faded[..., 3:], np.rint(255 * weight))
    half = np.full((64, 64, 1), 0.5, dtype=np.float32)
    np.testing.assert_array_equal(with_alpha(faded, half)[..., 3], np.rint(0.5 * faded[..., 3]))
    refuses(ParameterError, "base image: expected 64 x 64", blend, baked, base[:32], weight)


def test_options_name_parts_files_and_images(tmp_path: Path) -> None:
    mesh = replace(cube(), face_groups=np.array([0, 0, 0, 0, 0, 1]), group_names=("body", "face"), name="cube.obj")
    here = tmp_path / "cube.obj"

    def read(text: str, edge: float | None = None) -> np.ndarray:
        given = read_mask(text, edge, mesh, here, "--target-mask")
        return given.on(refine(mesh, 2), _surface(mesh, 2))

    front = face_mask(refine(mesh, 2), np.eye(6)[5])
    np.testing.assert_array_equal(read("face", 0.0), front)
    assert np.all(read("face") <= front)
    np.testing.assert_array_equal(read("not:face", 0.0), face_mask(refine(mesh, 2), 1 - np.eye(6)[5]))
    np.testing.assert_array_equal(read("body,face"), 1.0)
    write_attributes(tmp_path / "group.npz", {"face": np.linspace(0, 1, 8)})
    write_attributes(tmp_path / "set.csv", {"face": np.eye(6)[5]})
    np.testing.assert_allclose(read(str(tmp_path / "group.npz")), vertex_mask(refine(mesh, 2), np.linspace(0, 1, 8)))
    np.testing.assert_array_equal(read(str(tmp_path / "set.csv"), 0.0), front)
    assert mask_file("not:face.png") == Path("face.png")
    assert mask_file("face") is None
    write_attributes(tmp_path / "long.npy", {"long": np.linspace(0, 1, 9)})
    write_image(tmp_path / "painted.png", np.zeros((4, 4, 1), dtype=np.uint8))
    for text, message in (
        ("nose", "there is none"),
        (str(tmp_path / "long.npy"), "8 numbers from 0 to 1"),
        (str(tmp_path / "painted.png"), "no texture coordinates"),
    ):
        refuses(ParameterError, message, read, text)
    refuses(FormatError, "no such file", read, str(tmp_path / "missing.npz"))
    with pytest.raises(ParameterError, match="--mask-edge"):
        read_masks(TransferRequest(here, here, mask_edge=0.1), (mesh, mesh), (here, here))


def test_blending_goes_by_bands_of_rows() -> None:
    rng = np.random.default_rng(6)
    baked, base = (rng.integers(0, 256, (600, 3, 2), dtype=np.uint8) for _ in range(2))
    weight = rng.random((600, 3, 1))
    np.testing.assert_array_equal(blend(baked, base, weight), np.rint(base + weight * (baked - base.astype(float))))
    late = np.zeros((600, 4, 3), dtype=np.uint8)
    late[-1, -1, 0] = 90
    refuses(ParameterError, "grey image", to_grey, late)


def test_a_damaged_mask_is_refused(tmp_path: Path) -> None:
    result = identity_result()
    mask = np.ones(len(result.target.vertices))
    good = replace(result, masks=Masks(mask))
    write_result(tmp_path / "GOOD", good)
    np.testing.assert_array_equal(read_result(tmp_path / "GOOD").masks.target, mask)
    bad = replace(result, masks=Masks(mask * 2))
    write_result(tmp_path / "BAD", bad)
    refuses(FormatError, "target_mask holds numbers outside 0 to 1", read_result, tmp_path / "BAD")
