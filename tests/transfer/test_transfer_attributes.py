"""Displacement, per-vertex and per-face values, material colours, and the files that hold attributes."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples.shapes import cube

from cagemap.errors import FormatError, ParameterError
from cagemap.files.values.attributes import read_attributes, write_attributes
from cagemap.maps.point_map import PointMap
from cagemap.mesh import ControlMesh
from cagemap.numerics.arrays import encode_srgb
from cagemap.subdivision import Level, refine
from cagemap.surface.triangle_surface import TriangleSurface
from cagemap.transfer import (
    BakeOptions,
    Transfer,
    bake_displacement,
    bake_face_colors,
    face_colors,
    prepare_transfer,
    pull_back_faces,
    unwrap,
)
from cagemap.transfer.vectors import bake_vector_displacement

from refusals import refuses
from transfer_scenes import crossed_cube, identity_map, plane, plane_map


def scaled(level: Level, factor: float) -> Level:
    return replace(level, positions=factor * level.positions)


@pytest.fixture
def tripled() -> Transfer:
    """A target three times larger than its source, mapped onto it point by point."""
    level = plane(8, 8)
    return prepare_transfer(scaled(level, 3.0), level, identity_map(level))


def heights(displacement_pixels: np.ndarray, midlevel: float, scale: float) -> np.ndarray:
    one = np.iinfo(displacement_pixels.dtype).max if displacement_pixels.dtype.kind == "u" else 1
    return (displacement_pixels.astype(float) / one - midlevel) * scale


def test_float_heights_grow_with_the_surface(tripled: Transfer) -> None:
    texture = np.random.default_rng(23).normal(0, 0.1, (40, 40, 1)).astype(np.float32)
    baked = bake_displacement(tripled, texture, size=40)
    assert (baked.midlevel, baked.scale) == (0.0, 1.0)
    np.testing.assert_allclose(baked.pixels, 3 * texture, rtol=1e-6, atol=1e-6)


def test_float_heights_outside_0_to_1_are_not_clipped_to_integers(tripled: Transfer) -> None:
    values = np.linspace(-0.5, 0.5, 1600, dtype=np.float32).reshape(40, 40)
    with pytest.raises(ParameterError, match=r"values from 0 to 1 to store as integers, got -0.5 to 0.5"):
        bake_displacement(tripled, values, size=40, dtype=np.uint16)
    with pytest.raises(ParameterError, match="values from 0 to 1"):
        bake_vector_displacement(tripled, values[..., None].repeat(3, axis=2), size=40, dtype=np.uint16)
    baked = bake_displacement(tripled, values + 0.5, size=40, dtype=np.uint16, midlevel=0.5)
    np.testing.assert_allclose(heights(baked.pixels[..., 0], 0.5, baked.scale), 3 * values, atol=1e-4)


@pytest.mark.parametrize("dtype", ["uint8", "uint16"])
def test_integer_heights_keep_their_levels_and_grow_by_the_scale(tripled: Transfer, dtype: str) -> None:
    texture = np.random.default_rng(29).integers(0, np.iinfo(dtype).max, (40, 40), endpoint=True).astype(dtype)
    baked = bake_displacement(tripled, texture, size=40, scale=0.2)
    np.testing.assert_array_equal(baked.pixels[:, :, 0], texture)
    assert baked.midlevel == 0.5
    assert baked.scale == pytest.approx(0.6, rel=1e-12)


def test_from_16_bit_to_float_the_heights_agree(tripled: Transfer) -> None:
    texture = np.random.default_rng(31).integers(0, 65535, (40, 40, 1)).astype(np.uint16)
    baked = bake_displacement(tripled, texture, size=40, scale=0.2, midlevel=0.25, dtype=np.float32)
    expected = 3 * heights(texture, 0.25, 0.2)
    np.testing.assert_allclose(heights(baked.pixels, baked.midlevel, baked.scale), expected, rtol=0, atol=1e-6)


def test_grey_in_colour_channels_is_taken_and_colour_refused(tripled: Transfer) -> None:
    grey = np.random.default_rng(37).integers(0, 255, (20, 20, 1)).astype(np.uint8)
    with_alpha = np.concatenate([grey, grey, grey, 255 - grey], axis=2)
    np.testing.assert_array_equal(bake_displacement(tripled, with_alpha, size=20).pixels, grey)
    colour = with_alpha.copy()
    colour[3, 4, 1] ^= 128
    refuses(ParameterError, "vector displacement", bake_displacement, tripled, colour, size=20)


def test_vertex_values_keep_bounds_sums_and_linear_functions() -> None:
    target, source = plane(7, 5), plane(13, 9)
    transfer = prepare_transfer(target, source, plane_map(target, 13, 9, lambda p: 0.2 + 0.7 * p))
    weights = np.random.default_rng(41).dirichlet(np.full(4, 0.3), len(source.positions))
    pulled = transfer.point_map.pull_back(weights)
    assert pulled.min() >= 0
    np.testing.assert_allclose(pulled.sum(axis=1), 1, rtol=0, atol=1e-12)
    linear = transfer.point_map.pull_back(source.positions @ (1.0, -2.0, 0.0))
    np.testing.assert_allclose(linear, (0.2 + 0.7 * target.positions[:, :2]) @ (1.0, -2.0), rtol=0, atol=1e-12)
    refuses(ParameterError, "a value for each of the", transfer.point_map.pull_back, weights[:-1])


def test_face_values_of_another_mesh_are_refused() -> None:
    level = refine(cube(), 3).finest
    transfer = prepare_transfer(level, level, identity_map(level))
    refuses(ParameterError, "one for every control face", pull_back_faces, transfer, np.arange(5))


def test_a_face_over_several_takes_the_largest_label_and_the_mean_value() -> None:
    # One target face over 10 x 1 source faces; every refined triangle counts with its area.
    target = replace(plane(40, 40), face_parents=np.zeros(1600, dtype=np.int64))
    source = plane(10, 1)
    transfer = prepare_transfer(target, source, plane_map(target, 10, 1, lambda p: p))
    labels = np.array([7, 7, 7, 2, 2, 5, 5, 5, 5, 2])
    assert pull_back_faces(transfer, labels).tolist() == [5]
    np.testing.assert_allclose(pull_back_faces(transfer, labels.astype(float)), [labels.mean()], rtol=1e-9)


def test_a_target_face_without_area_takes_the_value_at_its_image() -> None:
    source = plane(4, 4)
    positions = source.positions.copy()
    positions[source.faces[5]] = positions[source.faces[5, 0]]
    surfaces = (TriangleSurface.from_faces(places, source.faces) for places in (positions, source.positions))
    point_map = PointMap.from_vertices(*surfaces, np.arange(len(positions)))
    transfer = prepare_transfer(replace(source, positions=positions), source, point_map)
    np.testing.assert_allclose(pull_back_faces(transfer, 1.5 + np.arange(16))[5], 6.5)
    assert pull_back_faces(transfer, np.arange(16))[5] == 5


def test_material_colours_are_sharp_and_antialiased() -> None:
    source, target = plane(2, 1), plane(16, 16)
    transfer = prepare_transfer(target, source, plane_map(target, 2, 1, lambda p: p))
    colors = np.array([[0.0, 0.2, 1.0], [1.0, 0.2, 0.0]])
    baked = bake_face_colors(transfer, colors, size=(32, 25))  # the boundary runs through the middle of column 12
    first, second = (np.rint(255 * encode_srgb(color)) for color in colors)
    assert (baked[:, :12] == first).all()
    assert (baked[:, 13:] == second).all()
    np.testing.assert_array_equal(
        baked[:, 12], np.broadcast_to(np.rint(255 * encode_srgb(colors.mean(axis=0))), (32, 3))
    )
    linear = bake_face_colors(transfer, colors, size=(32, 25), dtype=np.float32)
    np.testing.assert_allclose(linear[:, 12], np.broadcast_to(colors.mean(axis=0), (32, 3)), atol=1e-7)


@pytest.mark.parametrize("supersample", [1, 2, 3, 4])
def test_face_colors_are_averaged_in_linear_light(supersample: int) -> None:
    level = plane(8, 8)
    transfer = prepare_transfer(level, level, identity_map(level))
    colors = np.repeat((np.arange(64) % 8 >= 4)[:, None], 3, axis=1).astype(float)  # the right half is white
    baked = bake_face_colors(transfer, colors, size=9, options=BakeOptions(supersample=supersample))
    np.testing.assert_array_equal(baked[:, 4], 188)  # the boundary runs through the middle of column 4


@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_nearest_does_not_mix_face_colors(dtype: type) -> None:
    control = unwrap(crossed_cube())
    target = refine(control, 3).finest
    colors = np.random.default_rng(47).random((6, 3))
    options = BakeOptions(filter="nearest")
    transfer = prepare_transfer(target, target, identity_map(target))
    baked = bake_face_colors(transfer, colors, size=64, dtype=dtype, options=options)
    assert len(np.unique(baked.reshape(-1, 3), axis=0)) == 6


def test_antialiasing_everywhere_changes_nothing_away_from_boundaries() -> None:
    control = unwrap(crossed_cube())
    target = refine(control, 3).finest
    transfer = prepare_transfer(target, target, identity_map(target))
    colors = np.random.default_rng(47).random((6, 3))
    adaptive = bake_face_colors(transfer, colors, size=64, options=BakeOptions(supersample=1))
    full = bake_face_colors(transfer, colors, size=64, options=BakeOptions(supersample=4))
    same = np.abs(adaptive.astype(int) - full).max(axis=2) <= 1
    assert same.mean() > 0.9
    pure = {tuple(c) for c in np.rint(255 * encode_srgb(colors)).astype(int)}
    assert sum(tuple(t) in pure for t in adaptive.reshape(-1, 3)) > 0.8 * 64 * 64


def test_srgb_encoding_has_its_known_values() -> None:
    np.testing.assert_allclose(
        encode_srgb(np.array([0, 0.0031308, 0.214041, 1, 2])), [0, 0.040450, 0.5, 1, 1], atol=1e-5
    )


def test_face_colours_come_from_materials() -> None:
    shape: ControlMesh = cube()
    refuses(ParameterError, r"\.mtl", face_colors, shape)
    materials = np.array([0, 1, 1, 0, 0, 1])
    known = replace(
        shape,
        face_materials=materials,
        material_names=("red", "lost"),
        material_colors=np.array([[0.9, 0, 0], [np.nan] * 3]),
    )
    np.testing.assert_array_equal(face_colors(known), np.where(materials[:, None] == 0, (0.9, 0, 0), 0.8))


@pytest.mark.parametrize("suffix", [".npy", ".npz", ".csv"])
def test_attribute_files_come_back(tmp_path: Path, suffix: str) -> None:
    values = np.random.default_rng(53).normal(size=11)
    write_attributes(tmp_path / f"weight{suffix}", {"weight": values})
    assert list(read_attributes(tmp_path / f"weight{suffix}")) == ["weight"]
    np.testing.assert_array_equal(read_attributes(tmp_path / f"weight{suffix}")["weight"], values)


def test_attribute_tables_keep_names_columns_and_integers(tmp_path: Path) -> None:
    attributes = {"group": np.arange(5), "skin": np.random.default_rng(59).random((5, 2))}
    write_attributes(tmp_path / "a.csv", attributes)
    read = read_attributes(tmp_path / "a.csv")
    assert list(read) == ["group", "skin_0", "skin_1"]
    assert read["group"].dtype == np.int64
    np.testing.assert_array_equal(np.column_stack([read["skin_0"], read["skin_1"]]), attributes["skin"])
    (tmp_path / "plain.csv").write_text("1,2\n3,4.5\n")
    np.testing.assert_array_equal(read_attributes(tmp_path / "plain.csv")["plain"], [[1, 2], [3, 4.5]])
    write_attributes(tmp_path / "odd.csv", {"a;b": np.arange(2), "c\td": np.arange(2)})
    assert list(read_attributes(tmp_path / "odd.csv")) == ["a;b", "c\td"]


@pytest.mark.parametrize("delimiter", [";", "\t"])
def test_columns_may_be_separated_as_spreadsheets_do(tmp_path: Path, delimiter: str) -> None:
    rows = [["hip", "knee"], ["1", "0.5"], ["2", "4"]]
    (tmp_path / "a.csv").write_text("\r\n".join(delimiter.join(row) for row in rows) + "\r\n\r\n")
    read = read_attributes(tmp_path / "a.csv")
    np.testing.assert_array_equal(read["hip"], [1, 2])
    np.testing.assert_array_equal(read["knee"], [0.5, 4])


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.csv", b"x,y\n1,2\n3\n", "row 3"),
        ("a.csv", b"x;y\n0,5;2\n", "decimals with a point"),
        ("a.csv", b"x\n1\nnan\n", r"rows \[1\]"),
        ("a.csv", b"x,y\n", "found none"),
        ("a.csv", b"", "found none"),
        ("a.npy", b"no array", "no array of numbers"),
        ("a.npz", b"no archive", "no archive of arrays"),
        ("a.txt", b"1", r"expected values as \.npy"),
        ("a.csv", b"x,x\n1,2\n", "different names"),
        ("a.csv", b"x\n" + b"1" * 200_000 + b"\n", "could not read|finite"),
        ("a.csv", b"x\n" + b"9" * 400 + b"\n", "finite"),
        ("a.csv", b"\xff\xfe\x00", "could not read"),
    ],
)
def test_bad_attribute_files_are_refused(tmp_path: Path, name: str, content: bytes, message: str) -> None:
    (tmp_path / name).write_bytes(content)
    refuses(FormatError, message, read_attributes, tmp_path / name)


def test_attributes_that_do_not_fit_their_file_are_refused(tmp_path: Path) -> None:
    two = {"a": np.zeros(2), "b": np.zeros(3)}
    refuses(FormatError, "one array", write_attributes, tmp_path / "a.npy", two)
    refuses(FormatError, "equally many", write_attributes, tmp_path / "a.csv", two)
    refuses(FormatError, "no such file", read_attributes, tmp_path / "none.csv")
    np.save(tmp_path / "words.npy", np.array(["a", "b"]))
    refuses(FormatError, "expected numbers", read_attributes, tmp_path / "words.npy")
    np.save(tmp_path / "vast.npy", np.array([2**63], np.uint64))
    refuses(FormatError, "below 2\\^63", read_attributes, tmp_path / "vast.npy")
    (tmp_path / "long.csv").write_text("x\n12345678901234567890\n1\n")
    np.testing.assert_array_equal(read_attributes(tmp_path / "long.csv")["x"], [1.2345678901234567e19, 1.0])


def test_a_scale_of_0_is_refused_for_all_displacement(tripled: Transfer) -> None:
    for bake, channels in ((bake_displacement, 1), (bake_vector_displacement, 3)):
        texture = np.zeros((4, 4, channels), dtype=np.float32)
        refuses(ParameterError, "scale: expected a number other than 0", bake, tripled, texture, size=4, scale=0.0)
