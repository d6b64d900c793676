"""Normal maps and vector displacement: unchanged under the identity, turned with the map, flat stays flat."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cagemap.errors import ParameterError
from cagemap.files.images.image import read_image, write_image
from cagemap.subdivision import Level, refine
from cagemap.transfer import BakeOptions, prepare_transfer
from cagemap.transfer.textured_surface import TexturedSurface, tangent_frames
from cagemap.transfer.vectors import (
    bake_normal_map,
    bake_vector_displacement,
    looks_like_normal_map,
    share_of_normals,
)

from command_line import Run
from locations import FIXTURES
from refusals import refuses
from transfer_scenes import crossed_cube, identity_map, plane, plane_map, spectrum

SIZE = 48
# Texel by texel: where triangles are smaller than texels, a bake otherwise averages inside of them.
PLAIN = BakeOptions(supersample=1)


def normal_map(seed: int, dtype: str = "uint8", size: int = SIZE) -> np.ndarray:
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.linspace(0, 6, size), np.linspace(0, 6, size))
    a, b = rng.uniform(0.5, 1.5, 2)
    vectors = np.stack([0.4 * np.sin(a * x + y), 0.4 * np.cos(b * y), np.ones_like(x)], axis=2)
    vectors /= np.linalg.norm(vectors, axis=2, keepdims=True)
    one = np.iinfo(dtype).max
    return np.rint((0.5 * vectors + 0.5) * one).astype(dtype)


@pytest.fixture(scope="module")
def box() -> Level:
    return refine(crossed_cube(), 4).finest


def turned(level: Level, turn: np.ndarray, scale: float = 1.0) -> Level:
    return replace(level, positions=scale * level.positions @ turn.T)


TURN = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])


def test_tangent_maps_do_not_change_with_a_turn_of_the_target_and_object_maps_turn(box: Level) -> None:
    moved = turned(box, TURN, 2.0)
    transfer = prepare_transfer(moved, box, identity_map(box))
    texture = normal_map(2, "uint16")
    tangent = bake_normal_map(transfer, texture, size=SIZE, options=PLAIN)
    assert np.abs(tangent.astype(int) - texture.astype(int)).max() <= 2
    baked = bake_normal_map(transfer, texture, size=SIZE, space="object", options=PLAIN)
    decode = lambda pixels: 2 * (pixels / 65535) - 1  # noqa: E731
    np.testing.assert_allclose(decode(baked), decode(texture) @ TURN.T, atol=1e-4)


def test_a_layout_turned_and_mirrored_gets_turned_and_mirrored_normals() -> None:
    # The target's layout is the source's, turned by a quarter or mirrored: x of the texture becomes y, or minus x.
    texture = np.zeros((8, 8, 3), np.float32)
    texture[:] = (0.6, 0.0, 0.8)
    texture = 0.5 * texture + 0.5
    source = plane(6, 6)
    for uv, expected in (
        (lambda p: np.column_stack([1 - p[:, 1], p[:, 0]]), (0.0, 0.6, 0.8)),
        (lambda p: np.column_stack([1 - p[:, 0], p[:, 1]]), (-0.6, 0.0, 0.8)),
        (lambda p: p, (0.6, 0.0, 0.8)),
    ):
        target = plane(6, 6, uv)
        transfer = prepare_transfer(target, source, plane_map(target, 6, 6, lambda p: p))
        baked = 2 * bake_normal_map(transfer, texture, size=16) - 1
        np.testing.assert_allclose(baked, np.broadcast_to(expected, baked.shape), atol=1e-5)


def test_flat_stays_flat_under_any_map() -> None:
    rng = np.random.default_rng(3)
    target, source = plane(7, 7), plane(9, 9)
    bumpy = replace(source, positions=source.positions + 0.05 * rng.normal(size=source.positions.shape))
    transfer = prepare_transfer(target, bumpy, plane_map(target, 9, 9, lambda p: 0.1 + 0.8 * p))
    texture = np.zeros((16, 16, 3), np.float32)
    texture[:] = (0.5, 0.5, 1.0)
    baked = bake_normal_map(transfer, texture, size=20)
    np.testing.assert_allclose(baked, np.broadcast_to([0.5, 0.5, 1.0], baked.shape), atol=1e-5)


@pytest.mark.parametrize("space", ["tangent", "object"])
def test_vector_displacement_comes_back_and_scales(box: Level, space: str) -> None:
    texture = np.random.default_rng(5).normal(0, 0.1, (SIZE, SIZE, 3)).astype(np.float32)
    transfer = prepare_transfer(box, box, identity_map(box))
    baked = bake_vector_displacement(transfer, texture, size=SIZE, space=space, options=PLAIN)
    np.testing.assert_allclose(baked.pixels, texture, rtol=0, atol=1e-6)  # single precision
    double = prepare_transfer(turned(box, np.eye(3), 2.0), box, identity_map(box))
    np.testing.assert_allclose(
        bake_vector_displacement(double, texture, size=SIZE, space=space, options=PLAIN).pixels,
        2 * texture,
        rtol=0,
        atol=1e-5,
    )
    whole = (2**15 + 1e4 * texture).astype(np.uint16)
    kept = bake_vector_displacement(double, whole, size=SIZE, space=space, scale=0.3, options=PLAIN)
    assert np.abs(kept.pixels.astype(int) - whole.astype(int)).max() <= 1
    assert kept.scale == pytest.approx(0.6, rel=1e-9)


@pytest.mark.parametrize(("dtype", "warned"), [("uint8", True), ("uint16", True), ("float32", False)])
def test_rotated_vectors_outside_the_range_of_integers_are_reported(box, dtype, warned, caplog):
    texture = np.ones((SIZE, SIZE, 3), np.float32)  # the longest vector; rotated by 45 degrees, its x is 0.71
    given = texture if dtype == "float32" else (texture * np.iinfo(dtype).max).astype(dtype)
    half = np.sqrt(0.5)
    for turn, expected in ((np.eye(3), False), (np.array([[half, half, 0], [-half, half, 0], [0, 0, 1]]), warned)):
        transfer = prepare_transfer(turned(box, turn), box, identity_map(box))
        bake_vector_displacement(transfer, given, size=SIZE, space="object", midlevel=0.5, options=PLAIN)
        assert ("are clipped" in caplog.text) == expected


@pytest.mark.parametrize("kind", ["normals", "vectors"])
def test_fine_detail_that_shrinks_becomes_its_mean_and_no_moire(kind: str) -> None:
    """Squares of 3 texels that lean to either side, shrunk by 40: 16 samples a side would hit them by chance."""
    level = plane(4, 4)
    transfer = prepare_transfer(level, level, identity_map(level))
    squares = (np.arange(960) // 3) % 2
    leaning = (squares[:, None] + squares) % 2 == 0
    # Steep ones, whose mean is short: rounded to 8 bits it would be off by 0.02.
    sides = [np.array([0.995, 0.0, 0.0999]), np.array([-0.975, 0.0, 0.2222])]
    if kind == "vectors":
        vectors = np.where(leaning[..., None], *sides)[..., [0, 2, 1]].astype(np.float32)
        found = bake_vector_displacement(transfer, vectors, size=24).pixels[..., [0, 2, 1]]
        expected = sum(sides) / 2
    else:
        stored = [np.rint((0.5 * side + 0.5) * 255).astype(np.uint8) for side in sides]
        image = np.where(leaning[..., None], *stored)
        found = 2 * (bake_normal_map(transfer, image, size=24, dtype=np.uint16) / 65535) - 1
        mean = sum(side.astype(float) for side in stored) / 255 - 1
        expected = mean / np.linalg.norm(mean)
    np.testing.assert_allclose(found[2:-2, 2:-2], np.broadcast_to(expected, (20, 20, 3)), atol=0.004)


@pytest.mark.parametrize("supersample", [None, 2, 3])
def test_normals_have_unit_length_where_triangles_are_smaller_than_texels(supersample: int | None) -> None:
    level = plane(64, 64)
    transfer = prepare_transfer(level, level, plane_map(level, 64, 64, lambda p: 0.9 * p[:, ::-1] ** 1.3))
    directions = np.random.default_rng(6).normal(size=(64, 64, 3)) + np.array([0.0, 0.0, 2.0])
    texture = (0.5 + 0.5 * directions / np.linalg.norm(directions, axis=2, keepdims=True)).astype(np.float32)
    baked = bake_normal_map(transfer, texture, size=40, options=BakeOptions(supersample=supersample))
    np.testing.assert_allclose(np.linalg.norm(2 * baked - 1, axis=2), 1, atol=1e-6)


@pytest.mark.slow
def test_a_checker_of_normals_shrunk_by_four_does_not_alias() -> None:
    """Squares of 8 texels become squares of 2, turned by a little; beside their own frequencies is next to nothing."""
    squares = np.arange(512) // 8
    sign = np.where((squares[:, None] + squares) % 2, 1.0, -1.0)
    vectors = np.stack([0.3 * sign, 0.0 * sign, np.full_like(sign, np.sqrt(0.91))], axis=2)
    texture = (0.5 * vectors + 0.5).astype(np.float32)
    turn = np.array([[np.cos(0.17), -np.sin(0.17)], [np.sin(0.17), np.cos(0.17)]])
    level, size = plane(32, 32), 84
    point_map = plane_map(level, 32, 32, lambda p: 0.5 + (p - 0.5) @ turn.T * (4 * size / 512))
    transfer = prepare_transfer(level, plane(32, 32), point_map)
    small, large = (
        bake_normal_map(transfer, texture, size=s, space="object").astype(float)[..., 0] for s in (size, 8 * size)
    )
    expected, found = spectrum(large, size), spectrum(small, size)
    beside = found[expected < 0.01 * expected.max()]
    assert beside.max() < 0.03 * expected.max()  # 0.09 with a box of 16 samples
    assert found.max() > 0.6 * expected.max()


def test_frames_are_those_of_mikktspace_on_a_plane() -> None:
    frames = tangent_frames(TexturedSurface.from_level(plane(3, 3)))
    np.testing.assert_allclose(frames.tangents, np.broadcast_to([1.0, 0, 0], frames.tangents.shape), atol=1e-12)
    assert (frames.signs == 1).all()
    mirrored = tangent_frames(TexturedSurface.from_level(plane(3, 3, lambda p: np.column_stack([-p[:, 0], p[:, 1]]))))
    np.testing.assert_allclose(mirrored.tangents, np.broadcast_to([-1.0, 0, 0], frames.tangents.shape), atol=1e-12)
    assert (mirrored.signs == -1).all()
    at = mirrored.at(np.array([0]), np.array([[0.2, 0.3, 0.5]]))[0]
    np.testing.assert_allclose(at[:, 1], [0, 1, 0], atol=1e-12)  # bitangent: along v, whatever the handedness


def test_frames_are_those_of_the_reference_implementation() -> None:
    """Tangents of npm mikktspace 1.1.1 for our normals: half the layout mirrored, half with places numbered twice."""
    with np.load(FIXTURES / "mikktspace.npz") as stored:
        faces, layout = stored["faces"].astype(np.int64), stored["uv_indices"].astype(np.int64)
        level = Level(stored["positions"], faces, np.arange(len(faces))).with_uvs(stored["uvs"], layout)
        reference = stored["tangents"].astype(np.float64)
    frames = tangent_frames(TexturedSurface.from_level(level))
    own = frames.tangents[frames.groups]
    # Single precision: 0.03 degrees.
    assert np.einsum("tcd,tcd->tc", own, reference[:, :, :3]).min() > np.cos(np.radians(0.05))
    np.testing.assert_array_equal(np.broadcast_to(frames.signs[:, None], own.shape[:2]), reference[:, :, 3])


def test_what_holds_no_directions_is_refused(box: Level) -> None:
    transfer = prepare_transfer(box, box, identity_map(box))
    refuses(ParameterError, "three channels", bake_normal_map, transfer, np.zeros((8, 8, 1), np.uint8), size=8)
    refuses(ParameterError, "tangent or object", bake_normal_map, transfer, normal_map(1), size=8, space="world")


@pytest.mark.slow
def test_through_the_command_line(run: Run, result_folder: Path) -> None:
    place = result_folder.parent
    texture = normal_map(6, size=64)
    write_image(place / "n.png", texture)
    run.refused("transfer R --texture n.png -o o.png", says="--normal-map")
    assert not (place / "o.png").exists()
    for words in (("--texture", "n.png", "--as-color"), ("--normal-map", "n.png", "--green", "down")):
        run.done("transfer R", *words, "-o", "o.png")
        # The islands are inset by a margin; inside them each texel comes back.
        inner = read_image(place / "o.png").pixels[38:60, 4:18].astype(int)
        assert np.abs(inner - texture[38:60, 4:18]).max() <= 2
    run.done("transfer R --vector-displacement n.png --space object -o v.exr --bits 32")


def test_texels_that_are_not_numbers_are_no_painted_ones() -> None:
    image = (normal_map(6, size=64) / 255.0).astype(np.float32)
    image[20:] = np.nan
    assert looks_like_normal_map(image)
    assert share_of_normals(image) == 1.0
