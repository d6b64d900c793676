"""Bakes from a detailed mesh: what lies over the source arrives in the target's layout and frames."""

import sys
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cagemap.errors import MissingLibraryError, ParameterError
from cagemap.files.images.image import read_image, write_image
from cagemap.files.meshes.formats import write_mesh
from cagemap.files.result.folder import read_result
from cagemap.maps.masks import Masks
from cagemap.mesh import ControlMesh
from cagemap.numerics.arrays import encode_srgb
from cagemap.subdivision import Level, refine
from cagemap.surface.closest_points import closest_points
from cagemap.surface.triangle_surface import TriangleSurface
from cagemap.surface.triangles import triangles, vertex_normals
from cagemap.transfer import BakeOptions, prepare_transfer
from cagemap.transfer.detail import (
    Detail,
    bake_detail_heights,
    bake_detail_normals,
    bake_detail_texture,
    bake_detail_values,
    bake_detail_vectors,
    detail_over,
    own_transfer,
)
from cagemap.transfer.exact_corners import (
    LookupTargets,
    corner_samples,
    lookup_matrix,
    make_lookups_exact,
    surface_targets,
)
from cagemap.transfer.rays import ambient_occlusion
from cagemap.transfer.texels import texel_coordinates

from command_line import Run
from refusals import refuses
from transfer_scenes import crossed_cube, identity_map, plane

SIZE = 64
PLAIN = BakeOptions(supersample=1)


def to(wanted: np.ndarray) -> Callable[[np.ndarray], LookupTargets]:
    """Lookups are to read these values (k, c), all channels alike."""
    k, c = wanted.shape
    return lambda _: (wanted, np.broadcast_to(np.eye(c), (k, c, c)))


def waves(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A height over the unit square, and its gradient."""
    x, y = points[:, 0], points[:, 1]
    height = 0.02 * np.sin(9 * x) * np.cos(7 * y)
    return height, np.column_stack([0.18 * np.cos(9 * x) * np.cos(7 * y), -0.14 * np.sin(9 * x) * np.sin(7 * y)])


def texel_points() -> np.ndarray:
    """(SIZE * SIZE, 2) texture coordinates of texels' centres."""
    across = (np.arange(SIZE) + 0.5) / SIZE
    x, y = np.meshgrid(across, 1 - across)
    return np.column_stack([x.ravel(), y.ravel()])


@pytest.fixture(scope="module")
def flat() -> Level:
    return plane(10, 10)


@pytest.fixture(scope="module")
def wavy(flat: Level) -> Detail:
    fine = plane(60, 60)  # its edges are as long as a texel: no texel takes several samples
    height, _ = waves(fine.positions)
    places = fine.positions + height[:, None] * (0.0, 0.0, 1.0)
    return detail_over(own_transfer(flat).point_map.source, places, triangles(np.asarray(fine.faces)))


def test_a_height_field_over_a_plane_gives_its_heights_and_its_slopes(flat: Level, wavy: Detail) -> None:
    transfer = own_transfer(flat)
    height, slope = waves(texel_points())
    heights = bake_detail_heights(transfer, wavy, size=SIZE, options=PLAIN).pixels
    # The detail is linear between its vertices, 1/60 apart: 0.02 * (9^2 + 7^2) / (8 * 60^2).
    np.testing.assert_allclose(heights.ravel(), height, rtol=0, atol=9e-5)
    expected = np.column_stack([-slope, np.ones(len(slope))])
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    normals = 2.0 * bake_detail_normals(transfer, wavy, size=SIZE, dtype=np.float32, options=PLAIN) - 1.0
    assert np.einsum("kd,kd->k", normals.reshape(-1, 3), expected).min() > 0.999
    down = bake_detail_normals(transfer, wavy, size=SIZE, green="down", dtype=np.float32, options=PLAIN)
    np.testing.assert_allclose(2.0 * down - 1.0, normals * (1, -1, 1), atol=1e-6)
    refuses(ParameterError, "up or down", bake_detail_normals, transfer, wavy, size=SIZE, green="left", options=PLAIN)


@pytest.mark.parametrize("space", ["tangent", "object"])
def test_vectors_lead_to_the_detail(flat: Level, wavy: Detail, space: str) -> None:
    vectors = bake_detail_vectors(own_transfer(flat), wavy, size=SIZE, space=space, options=PLAIN).pixels
    own = vectors.reshape(-1, 3)[:, [0, 2, 1]] if space == "tangent" else vectors.reshape(-1, 3)
    reached = np.column_stack([texel_points(), np.zeros(SIZE**2)]) + own
    _, _, distance = closest_points(wavy.surface.tree, wavy.surface.scale * reached)
    near = np.abs(texel_points()[:, None] - flat.positions[:, :2]).max(axis=2).min(axis=1) * SIZE < 1.0
    assert distance[~near].max() < 1e-7  # single precision
    # Where texels are looked up at vertices, it is the lookup that leads there.
    lookups = lookup_matrix(texel_coordinates(flat.positions[:, :2], SIZE, SIZE), SIZE, SIZE) @ own
    _, _, distance = closest_points(wavy.surface.tree, wavy.surface.scale * (flat.positions + lookups))
    assert distance.max() < 3e-6
    # Integers hold the same, in their own range.
    whole = bake_detail_vectors(
        own_transfer(flat), wavy, size=SIZE, space=space, scale=0.1, dtype=np.uint16, options=PLAIN
    )
    np.testing.assert_allclose((whole.pixels / 65535 - whole.midlevel) * whole.scale, vectors, atol=1e-6)


@pytest.mark.parametrize("right", [False, True])
@pytest.mark.parametrize("shared", [False, True])
def test_vectors_lead_to_the_detail_of_the_half_that_the_masks_allow(
    flat: Level, wavy: Detail, right: bool, shared: bool
) -> None:
    uvs = np.abs(flat.uvs * (2.0, 1.0) - (1.0, 0.0)).round(9)  # the left half is mirrored over the right one
    welded, numbers = np.unique(uvs, axis=0, return_inverse=True)
    target = flat.with_uvs(welded, numbers[flat.uv_indices]) if shared else flat.with_uvs(uvs, flat.uv_indices)
    allowed = (flat.positions[:, 0] > 0.45) if right else (flat.positions[:, 0] < 0.55)
    transfer = prepare_transfer(target, flat, identity_map(flat), Masks(target=allowed))
    vectors = bake_detail_vectors(transfer, wavy, size=SIZE, space="object", options=PLAIN).pixels.reshape(-1, 3)
    lookups = lookup_matrix(texel_coordinates(uvs[allowed], SIZE, SIZE), SIZE, SIZE) @ vectors
    _, _, distance = closest_points(wavy.surface.tree, wavy.surface.scale * (flat.positions[allowed] + lookups))
    assert distance.max() < 3e-6


def test_lookups_become_exact_by_the_least_change() -> None:
    rng = np.random.default_rng(2)
    image = rng.normal(size=(20, 30, 2)).astype(np.float32)
    places, wanted = rng.uniform((0, 0), (30, 20), (40, 2)), rng.normal(size=(40, 2))
    before = image.copy()
    make_lookups_exact(image, places, to(wanted))
    lookups = lookup_matrix(places, 20, 30).toarray()
    np.testing.assert_allclose(lookups @ image.reshape(-1, 2), wanted, atol=0.05)
    least = np.linalg.lstsq(lookups, wanted - lookups @ before.reshape(-1, 2))[0]
    assert np.abs((image - before).reshape(-1, 2) - least).max() < 0.05 * np.abs(least).max()
    # What is right already stays as it is, to the last bit.
    again = image.copy()
    make_lookups_exact(again, places, to(lookups @ again.reshape(-1, 2).astype(np.float64)))
    np.testing.assert_array_equal(again, image)


def test_many_corners_in_few_texels_need_no_matrix_of_all_their_pairs() -> None:
    """A fine surface and a small image: 4000 corners in 9 texels would be 16 million numbers."""
    rng = np.random.default_rng(3)
    image, places = np.zeros((3, 3, 1), dtype=np.float32), rng.uniform(0, 3, (4000, 2))
    wanted = rng.normal(size=(4000, 1))
    tracemalloc.start()
    make_lookups_exact(image, places, to(wanted))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 10e6
    least = np.linalg.lstsq(lookup_matrix(places, 3, 3).toarray(), wanted)[0]
    np.testing.assert_allclose(image.reshape(-1, 1), least, atol=1e-3)


def test_displaced_corners_that_share_their_texels_lie_on_the_surface_and_may_slide_along_it() -> None:
    """Twelve corners in one texel, over a plane that they are all as far from; feet of their own pull them apart."""
    rng = np.random.default_rng(5)
    normal, along = np.array([0.6, 0.0, 0.8]), np.array([0.8, 0.0, -0.6])
    corners = np.array([3 * along, [0, 3, 0], -3 * along, [0, -3, 0]]) + 0.1 * normal
    surface = TriangleSurface(corners, np.array([[0, 1, 2], [0, 2, 3]]))
    assert np.einsum("d,td->t", normal, surface.normals).min() > 0.999
    places = 2.0 + rng.random((12, 2)) * 0.9
    points = rng.uniform(-0.5, 0.5, (12, 1)) * along + rng.uniform(-0.5, 0.5, (12, 1)) * np.array([0, 1.0, 0])
    scattered = 0.1 * normal + rng.normal(0.0, 0.2, (12, 1)) * along
    heights, frame = {}, np.broadcast_to(np.stack([along, [0, 1, 0], normal]), (12, 3, 3))
    for slides in (True, False):
        image = np.zeros((5, 5, 3), dtype=np.float32)
        normals = np.broadcast_to(normal, (12, 3))
        make_lookups_exact(
            image, places, surface_targets(surface, points, normals, scattered, np.full(12, slides), frame)
        )
        heights[slides] = lookup_matrix(places, 5, 5) @ image.reshape(-1, 3)
    np.testing.assert_allclose(heights[True][:, 2], 0.1, atol=2e-3)
    assert np.abs(heights[True][:, :2]).max() < 1e-3  # what does not matter does not move
    assert np.abs(heights[False][:, 0]).max() > 0.02  # ... and what does, does


def test_detail_grows_and_turns_with_the_target(wavy: Detail) -> None:
    source = plane(10, 10)
    turn = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])
    target = replace(source, positions=3.0 * source.positions @ turn.T)
    transfer, own = prepare_transfer(target, source, identity_map(source)), own_transfer(source)
    for bake in (bake_detail_heights, bake_detail_vectors):
        given = bake(own, wavy, size=SIZE, options=PLAIN).pixels
        np.testing.assert_allclose(bake(transfer, wavy, size=SIZE, options=PLAIN).pixels, 3.0 * given, atol=1e-6)
    given = bake_detail_vectors(own, wavy, size=SIZE, space="object", options=PLAIN).pixels
    turned = bake_detail_vectors(transfer, wavy, size=SIZE, space="object", options=PLAIN).pixels
    np.testing.assert_allclose(turned, 3.0 * given @ turn.T, atol=1e-6)
    normals = [bake_detail_normals(side, wavy, size=SIZE, dtype=np.float32, options=PLAIN) for side in (own, transfer)]
    np.testing.assert_allclose(normals[0], normals[1], atol=1e-6)


def test_a_surface_over_itself_is_flat() -> None:
    box = refine(crossed_cube(), 4).finest
    transfer = own_transfer(box)
    detail = Detail(transfer.point_map.source)
    assert np.abs(bake_detail_vectors(transfer, detail, size=SIZE, options=PLAIN).pixels).max() < 1e-9
    assert np.abs(bake_detail_heights(transfer, detail, size=SIZE, options=PLAIN).pixels).max() < 1e-9
    normals = bake_detail_normals(transfer, detail, size=SIZE, options=PLAIN)
    assert np.abs(normals.astype(int) - (128, 128, 255)).max() <= 1


def test_what_does_not_follow_stays_flat(flat: Level, wavy: Detail) -> None:
    follow = (flat.positions[:, 0] < 0.5).astype(float)
    held = replace(wavy, follow=follow)
    heights = bake_detail_heights(own_transfer(flat), held, size=SIZE, options=PLAIN).pixels[:, :, 0]
    whole = bake_detail_heights(own_transfer(flat), wavy, size=SIZE, options=PLAIN).pixels[:, :, 0]
    assert (heights[:, 32:] == 0).all()
    np.testing.assert_array_equal(heights[:, :25], whole[:, :25])


def test_a_scale_of_zero_is_refused(flat: Level, wavy: Detail) -> None:
    for bake in (bake_detail_heights, bake_detail_vectors):
        with pytest.raises(ParameterError, match="scale: expected a number other than 0"):
            bake(own_transfer(flat), wavy, size=SIZE, scale=0.0)


def test_values_at_the_detail_s_vertices_arrive(flat: Level, wavy: Detail) -> None:
    # Linear in x and y: nothing is lost between vertices.
    places = wavy.surface.positions / wavy.surface.scale
    baked = bake_detail_values(own_transfer(flat), wavy, places[:, :2], size=SIZE, dtype=np.float32, options=PLAIN)
    np.testing.assert_allclose(baked.reshape(-1, 2), texel_points(), rtol=0, atol=1e-6)  # single precision
    with pytest.raises(ParameterError, match="one a vertex of the detail"):
        bake_detail_values(own_transfer(flat), wavy, np.zeros(4), size=SIZE)


def test_the_detail_s_own_texture_arrives(flat: Level, wavy: Detail) -> None:
    places = wavy.surface.positions / wavy.surface.scale
    uvs = 0.8 * places[:, [1, 0]] + 0.1  # mirrored: u grows with y
    v, u = np.meshgrid(1 - (np.arange(96) + 0.5) / 96, (np.arange(96) + 0.5) / 96, indexing="ij")
    picture = np.stack([u, v], axis=2).astype(np.float32)
    baked = bake_detail_texture(own_transfer(flat), wavy, picture, uvs, wavy.surface.triangles, size=SIZE)
    np.testing.assert_allclose(baked.reshape(-1, 2), 0.8 * texel_points()[:, ::-1] + 0.1, rtol=0, atol=2e-6)
    tiles = {1001: picture, 1002: picture + 1}
    shifted = uvs[wavy.surface.triangles].mean(axis=1)[:, 0] > 0.5
    both = np.concatenate([uvs, uvs + np.array([1.0, 0.0])])
    over = wavy.surface.triangles + len(uvs) * shifted[:, None]
    baked = bake_detail_texture(own_transfer(flat), wavy, tiles, both, over, size=SIZE)
    second = baked.reshape(-1, 2)[:, 0] > 1.0
    assert 0.4 < second.mean() < 0.6
    np.testing.assert_allclose(baked.reshape(-1, 2) - second[:, None], 0.8 * texel_points()[:, ::-1] + 0.1, atol=2e-6)
    labels = np.array([3.0, 200.0], dtype=np.float32)[np.random.default_rng(7).integers(0, 2, (96, 96, 1))]
    asked = BakeOptions(filter="nearest")
    baked = bake_detail_texture(
        own_transfer(flat), wavy, labels, uvs, wavy.surface.triangles, size=SIZE // 4, options=asked
    )
    assert set(np.unique(baked)) == {3.0, 200.0}
    with pytest.raises(ParameterError, match="triangles of the detail"):
        bake_detail_texture(own_transfer(flat), wavy, picture, uvs, wavy.surface.triangles[1:], size=SIZE)


def test_the_detail_s_own_texture_is_sampled_smoothly(flat: Level) -> None:
    """Detail of three texels comes through a shift by half a texel."""
    fine = plane(8, 8)
    detail = detail_over(own_transfer(flat).point_map.source, fine.positions, triangles(np.asarray(fine.faces)))
    rows, columns = np.indices((96, 96)) + 0.5
    wave = lambda y, x: (0.5 + 0.2 * np.sin(1.4 * x) + 0.2 * np.cos(1.1 * y + 0.4 * x))[..., None]  # noqa: E731
    texture, uvs, inside = wave(rows, columns).astype(np.float32), fine.positions[:, :2] + 0.5 / 96, np.s_[6:-6, 6:-6]
    off = {}
    for kind in ("linear", "smooth"):
        options, corners = BakeOptions(filter=kind), triangles(np.asarray(fine.faces))
        baked = bake_detail_texture(own_transfer(flat), detail, texture, uvs, corners, size=96, options=options)
        off[kind] = np.sqrt(np.mean((baked - wave(rows - 0.5, columns + 0.5))[inside] ** 2))
    assert off["smooth"] < off["linear"] / 3


def test_corners_outside_the_image_change_nothing_in_it() -> None:
    over = plane(10, 10, lambda points: 2.0 * points - 0.5)
    uvs, samples, triangle, inside = corner_samples(own_transfer(over), 0)
    assert len(uvs) == len(samples.triangle) == len(triangle) == len(inside) == 25
    assert uvs.min() >= 0
    assert uvs.max() <= 1
    empty = np.ones((4, 4, 1), dtype=np.float32)
    make_lookups_exact(empty, np.zeros((0, 2)), to(np.zeros((0, 1))))
    assert (empty == 1).all()


def test_every_tile_of_a_layout_gets_the_detail_that_lies_there(wavy: Detail) -> None:
    level = plane(10, 10)
    transfer = own_transfer(level.with_uvs(level.uvs * (2.0, 1.0), level.uv_indices))  # two tiles side by side
    for tile in (1001, 1002):
        places = (texel_points() + np.array([tile - 1001, 0])) * (0.5, 1.0)
        heights = bake_detail_heights(transfer, wavy, size=SIZE, options=replace(PLAIN, tile=tile)).pixels
        np.testing.assert_allclose(heights.ravel(), waves(places)[0], rtol=0, atol=9e-5)
        vectors = bake_detail_vectors(
            transfer, wavy, size=SIZE, space="object", options=replace(PLAIN, tile=tile)
        ).pixels
        reached = np.column_stack([places, np.zeros(len(places))]) + vectors.reshape(-1, 3)
        _, _, distance = closest_points(wavy.surface.tree, wavy.surface.scale * reached)
        assert np.median(distance) < 1e-7
        assert distance.max() < 5e-3


def test_occlusion_is_the_hidden_part_of_the_sky() -> None:
    pytest.importorskip("embreex")
    # A floor and a wall at a right angle: half of the sky is hidden at the wall's foot, none of it far away.
    far = 1000.0
    floor = np.array([(0, 0, -far), (0, 0, far), (far, 0, far), (far, 0, -far)], dtype=float)
    wall = np.array([(0, -1, -far), (0, -1, far), (0, far, far), (0, far, -far)], dtype=float) - (1e-3, 0, 0)
    probe = np.array([(0, 0, 0), (1e-2, 0, 1e-2), (1e-2, 0, -1e-2)]) + np.array([0.05, 1e-3, 0])
    faces = np.array([(0, 1, 2), (0, 2, 3)])
    surface = TriangleSurface(
        np.concatenate([floor, wall, probe]),
        np.concatenate([faces, faces[:, ::-1] + 4, [(8, 9, 10)]]),
    )
    assert surface.vertex_normals[8][1] > 0.99
    open_part = ambient_occlusion(surface, 2048)
    assert open_part[8:] == pytest.approx(0.5, abs=0.02)
    sphere = refine(crossed_cube(), 3)
    assert ambient_occlusion(TriangleSurface.from_faces(sphere.finest.positions, sphere.finest.faces)).min() > 0.95


def test_without_embreex_occlusion_says_so(monkeypatch: pytest.MonkeyPatch, wavy: Detail) -> None:
    monkeypatch.setitem(sys.modules, "embreex", None)
    monkeypatch.setitem(sys.modules, "embreex.rtcore_scene", None)
    refuses(MissingLibraryError, "ambient occlusion", ambient_occlusion, wavy.surface)


def test_detail_elsewhere_is_refused(flat: Level) -> None:
    surface = own_transfer(flat).point_map.source
    fine = plane(20, 20)
    for places in (100.0 * fine.positions + np.array([0, 0, 30]), fine.positions + np.array([5.0, 0, 0])):
        refuses(ParameterError, "lies on the source", detail_over, surface, places, triangles(np.asarray(fine.faces)))


@pytest.mark.slow
def test_through_the_command_line(run: Run, result_folder: Path) -> None:
    place = result_folder.parent
    refinement = refine(read_result(result_folder).source.refinement.control, 3)
    faces = np.asarray(refinement.finest.faces)
    x = refinement.finest.positions
    size = np.ptp(x, axis=0).max()
    bumps = x + 0.01 * size * np.sin(20 * x[:, :1] / size) * vertex_normals(x, triangles(faces))
    colors = (x - x.min(axis=0)) / np.ptp(x, axis=0)
    detailed = ControlMesh.from_faces(bumps, faces.tolist())
    write_mesh(place / "high.obj", replace(detailed, vertex_colors=colors))
    run.refused("transfer R --bake normal -o o.png", says="--detail")
    run.refused("transfer R --bake shine --detail high.obj -o o.png", says="vector-displacement")
    run.done("transfer R --bake normal,displacement,vector-displacement,colors --detail high.obj --size 64 -o o.png")
    heights = read_image(place / "o_displacement.png").pixels
    assert heights.dtype == np.uint16
    assert np.ptp(heights.astype(int)) > 40_000
    as_bytes = read_image(place / "o_colors.png").pixels
    assert as_bytes.shape == (64, 64, 3)
    run.done("transfer R --bake colors --detail high.obj --size 64 -o linear.exr")
    np.testing.assert_allclose(encode_srgb(read_image(place / "linear.exr").pixels) * 255, as_bytes, atol=2)
    normals = read_image(place / "o_normal.png").pixels / 65535
    assert (2 * normals[:, :, 2] - 1).mean() > 0.7
    assert normals[:, :, 0].std() > 0.01
    run.refused("wrap R -o w.obj --detail high.obj", says="expected an image to bake")
    u, v = np.meshgrid((np.arange(256) + 0.5) / 256, 1 - (np.arange(256) + 0.5) / 256)
    write_image(place / "skin.png", np.rint(255 * np.stack([u, v, u * 0], axis=2)).astype(np.uint8))
    write_mesh(place / "scan.obj", detailed.with_uvs(colors[:, :2], faces.ravel()))
    own = ("--detail", "scan.obj", "--size", "64")
    run.refused("transfer R --bake texture", *own, "-o", "t.png", says="expected both or neither")
    run.refused(
        "transfer R --bake normal --detail-texture skin.png", *own, "-o", "t.png", says="expected both or neither"
    )
    run.done("transfer R --bake texture --detail-texture skin.png", *own, "-o", "t.png")
    baked, expected = (read_image(place / name).pixels.astype(float) for name in ("t.png", "o_colors.png"))
    assert np.median(np.abs(baked - expected)[:, :, :2]) < 2
    spots = np.random.default_rng(8).integers(0, 2, (256, 256, 1), dtype=np.uint8) * np.uint8(77)
    write_image(place / "spots.png", spots)
    asked = ("transfer", "R", "--bake", "texture", "--detail-texture", "spots.png", *own, "-o", "s.png", "--filter")
    run.done(*asked, "nearest")
    assert set(np.unique(read_image(place / "s.png").pixels)) == {0, 77}
    assert "for '--filter'" in run(*asked, "cubic").err
    run.refused("wrap R -o w.obj --detail-texture skin.png --baked b.png", says="expected --detail, and no --texture")
    run.done("wrap R -o w2.obj --detail-texture skin.png --baked b.png", *own)
    assert read_image(place / "b.png").pixels.shape == (64, 64, 3)
    done = run.done("wrap R -o w.obj --normal-map wn.png --vector-displacement wv.exr --size 64")
    assert "tangent space" in done.out
    assert read_image(place / "wv.exr").pixels.dtype == np.float32
