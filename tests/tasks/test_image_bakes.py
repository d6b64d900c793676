"""Images that `cagemap transfer` bakes: meaning, sizes, labels, several materials on one, and what is doubtful."""

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cagemap.errors import FormatError, ParameterError
from cagemap.files.images.image import read_image, write_image
from cagemap.files.meshes.formats import write_mesh
from cagemap.files.result.folder import write_result
from cagemap.mesh import ControlMesh
from cagemap.subdivision.refinement import finest_mesh
from cagemap.tasks.match import run_match
from cagemap.tasks.material_atlas import _tile_image
from cagemap.tasks.progress import Stages
from cagemap.tasks.requests.match import MatchRequest
from cagemap.tasks.requests.transfer import TransferRequest
from cagemap.tasks.transfer import run_transfer
from cagemap.tasks.wrap import WrapRequest, run_wrap
from cagemap.transfer.texture import SmoothTile

from example_result import identity_result, textured_cube
from refusals import refuses


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a RESULT of two equal cubes."""
    monkeypatch.chdir(tmp_path)
    write_result(tmp_path / "RESULT", identity_result())
    return tmp_path


def transfer(output: str, **options: Any) -> tuple[np.ndarray | None, str, list[str]]:
    """Run a transfer; returns the image, if one was written under this name, the summary and the warnings."""
    summary, warnings = run_transfer(TransferRequest(Path("RESULT"), Path(output), **options), Stages())
    return read_image(Path(output)).pixels if Path(output).is_file() else None, summary, warnings


def half_painted(mesh: ControlMesh) -> ControlMesh:
    """Colours at the vertices of the upper half only."""
    known = mesh.positions[:, 2] > 0
    return replace(mesh, vertex_colors=np.where(known[:, None], [0.2, 0.5, 0.1], np.nan))


@pytest.mark.parametrize("output", ["o.png", "o.exr"])
@pytest.mark.parametrize("own", [True, False])
def test_vertices_without_a_colour_are_baked_grey(place: Path, output: str, own: bool) -> None:
    source = half_painted(textured_cube("small.obj"))
    if own:
        write_result(place / "RESULT", identity_result(3, (textured_cube("large.obj", 2.0), source)), force=True)
    else:
        write_mesh(place / "detail.obj", source)
    detail = None if own else place / "detail.obj"
    pixels, _, warnings = transfer(output, bake=("colors",), detail=detail, size=64)
    assert np.isfinite(pixels).all()
    full = np.iinfo(pixels.dtype).max if pixels.dtype.kind == "u" else 1.0
    assert pixels.min() > 0.005 * full, "no texel is black"
    grey = pixels.reshape(-1, 3).max(axis=0) / full
    if not own:  # subdivision mixes the colours of a cube's vertices
        np.testing.assert_allclose(grey, 0.8 if output == "o.exr" else 0.906, atol=0.01)
    assert any("4 of 8 vertices have no colour and are baked in grey" in text for text in warnings)


def test_a_detail_that_leaves_source_out_is_reported_and_no_other(place: Path) -> None:
    refinement = identity_result().source.refinement
    write_mesh(place / "fine.obj", finest_mesh(refinement))
    write_mesh(place / "cage.obj", textured_cube("cage.obj"))  # its corners are outside the surface
    for name, flat in (("fine", False), ("cage", True)):
        *_, warnings = transfer(f"{name}.png", bake=("normal",), detail=place / f"{name}.obj", size=8)
        assert any("stays flat there" in text for text in warnings) == flat


def test_a_plain_source_is_no_detail_of_itself(place: Path) -> None:
    for name, side in (("target.obj", "target"), ("source.obj", "source")):
        write_mesh(place / name, finest_mesh(getattr(identity_result(), side).refinement))
    run_match(MatchRequest(place / "target.obj", place / "source.obj", place / "R", scheme="none"), Stages())
    request = TransferRequest(place / "R", place / "o.png", detail=Path("source.obj"), size=8, rays=1)
    run_transfer(replace(request, bake=("ao",)), Stages())
    for kind in ("normal", "displacement"):
        baked = replace(request, bake=("ao", kind), force=True)
        refuses(ParameterError, "no detail over itself", run_transfer, baked, Stages())


def waves(size: int = 32) -> np.ndarray:
    """(size, size, 3) directions of a wavy surface in tangent space."""
    x, y = np.meshgrid(np.linspace(0, 9, size), np.linspace(0, 7, size))
    slopes = np.stack([np.sin(x + y), np.cos(2 * y - x), np.full_like(x, 2.0)], axis=2)
    return slopes / np.linalg.norm(slopes, axis=2, keepdims=True)


def test_signed_normals_are_directions_by_name_too(place: Path) -> None:
    write_image(place / "n.exr", waves().astype(np.float32))
    by_option, _, warnings = transfer("option.exr", normal_map=place / "n.exr")
    assert warnings == []
    _, _, warnings = transfer("out.exr", maps=(("normal", place / "n.exr"),))
    assert any("is turned with the map" in text for text in warnings)
    np.testing.assert_array_equal(read_image(place / "out_normal.exr").pixels, by_option)
    refuses(ParameterError, "looks like a normal map", transfer, "never.exr", texture=place / "n.exr")


def test_one_texel_below_zero_does_not_change_the_meaning_of_all(place: Path) -> None:
    encoded = (0.5 * waves() + 0.5).astype(np.float32)
    write_image(place / "n.exr", encoded)
    clean, *_ = transfer("clean.exr", normal_map=place / "n.exr")
    encoded[5, 5, 0] = -1e-4
    write_image(place / "n.exr", encoded)
    ringing, *_ = transfer("ringing.exr", normal_map=place / "n.exr")
    assert np.median(np.abs(ringing - clean)) < 1e-6


def test_a_map_named_normal_that_is_carried_as_colours_is_named(place: Path) -> None:
    directions = np.random.default_rng(3).normal(size=(32, 32, 3))
    directions /= np.linalg.norm(directions, axis=2, keepdims=True)
    write_image(place / "object.png", np.rint(127.5 * directions + 127.5).astype(np.uint8))
    maps = (("normal", place / "object.png"),)
    _, _, warnings = transfer("o.png", maps=maps)
    assert any("object.png is carried as colours: it does not look like a normal map" in text for text in warnings)
    assert transfer("c.png", maps=maps, as_color=True)[2] == []


@pytest.mark.parametrize("name", ["height", "Displacement"])
def test_a_map_named_height_is_carried_unscaled_with_a_warning(place: Path, name: str) -> None:
    write_image(place / "h.png", np.full((8, 8, 1), 140, dtype=np.uint8))
    _, _, warnings = transfer("o.png", maps=((name, place / "h.png"),))
    assert any("the target is 2 times as large as the source" in text and "--displacement" in text for text in warnings)
    assert any("heights are 2 times too small there" in text for text in warnings)
    assert transfer("c.png", maps=((name, place / "h.png"),), as_color=True)[2] == warnings
    cubes = textured_cube("large.obj"), textured_cube("small.obj")
    write_result(place / "RESULT", identity_result(3, cubes), force=True)
    assert transfer("s.png", maps=((name, place / "h.png"),))[2] == []


@pytest.mark.parametrize(
    ("given", "base", "output", "is_right"),
    [
        (np.uint16, np.uint16, "o.png", False),
        (np.float32, np.float32, "o.exr", True),
        (np.float32, np.uint16, "o.exr", False),
        (np.uint16, np.uint16, "o.exr", True),
    ],
)
@pytest.mark.parametrize("channels", [1, 3])
def test_heights_over_a_base_of_another_scale_are_reported(place, given, base, output, is_right, channels):
    names = [f"{name}.{'png' if dtype == np.uint16 else 'exr'}" for name, dtype in (("given", given), ("own", base))]
    for name, dtype in zip(names, (given, base), strict=True):
        write_image(place / name, np.zeros((8, 8, channels), dtype=dtype))
    option = "displacement" if channels == 1 else "vector_displacement"
    bits = 32 if output.endswith("exr") else None
    options = {option: place / names[0], "bases": (("", place / names[1]),), "target_mask": "red", "bits": bits}
    _, _, warnings = transfer(output, **options)
    said = [text for text in warnings if "--base" in text and "keeps its values" in text]
    assert bool(said) != is_right


def test_baked_heights_over_a_base_of_another_scale_are_reported(place: Path) -> None:
    write_mesh(place / "detail.obj", textured_cube("detail.obj"))
    kinds = {"displacement": 1, "vector-displacement": 3}
    for kind, channels in kinds.items():
        write_image(place / f"{kind}.png", np.zeros((8, 8, channels), dtype=np.uint16))
        write_image(place / f"{kind}.exr", np.zeros((8, 8, channels), dtype=np.float32))
        options = {"bake": (kind,), "detail": place / "detail.obj", "target_mask": "red"}
        for suffix in (".png", ".exr"):
            *_, warnings = transfer(f"o_{kind}{suffix}", bases=(("", place / f"{kind}{suffix}"),), **options)
            assert any("keeps its values" in text for text in warnings) == (suffix == ".png")


def test_nearest_says_what_it_does_not_sample(place: Path) -> None:
    for kind, warned in (("nearest", True), ("linear", False)):
        *_, warnings = transfer(f"{kind}.png", bake=("ao",), filter=kind, size=8, rays=1)
        assert any("--filter nearest is not used for ao" in text for text in warnings) == warned
    pixels, *_ = transfer("o.png", material_colors=True, filter="nearest", size=64)
    assert len(np.unique(pixels.reshape(-1, 3), axis=0)) == 2


def test_a_bake_has_the_size_of_the_detail_s_image_or_of_any_base(place: Path) -> None:
    painted = replace(textured_cube("scan.obj"), vertex_colors=np.full((8, 3), 0.5))
    write_mesh(place / "scan.obj", painted)
    write_image(place / "scan.png", np.full((96, 48, 3), 90, dtype=np.uint8))
    scan = {"detail": place / "scan.obj", "detail_texture": place / "scan.png"}
    pixels, *_ = transfer("t.png", bake=("texture",), **scan)
    assert pixels.shape == (96, 96, 3)
    write_image(place / "own.png", np.full((32, 32, 1), 90, dtype=np.uint8))
    masked = {"target_mask": "red", "bases": (("ao", place / "own.png"),)}
    transfer("b.png", bake=("colors", "ao"), detail=place / "scan.obj", rays=1, **masked)
    assert read_image(place / "b_ao.png").pixels.shape[:2] == read_image(place / "b_colors.png").pixels.shape[:2]
    assert read_image(place / "b_ao.png").pixels.shape[:2] == (32, 32)
    wrapped = WrapRequest((Path("RESULT"),), Path("w.obj"), baked=Path("w.png"), **scan)
    run_wrap(wrapped, Stages())
    assert read_image(place / "w.png").pixels.shape == (96, 96, 3)


def test_the_size_of_the_detail_s_image_is_that_of_its_own_bake_alone(
    place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cagemap.tasks.detail_bakes.DEFAULT_SIZE", 16)
    write_mesh(place / "scan.obj", textured_cube("scan.obj"))
    write_image(place / "scan.png", np.full((96, 48, 3), 90, dtype=np.uint8))
    scan = {"detail": place / "scan.obj", "detail_texture": place / "scan.png", "rays": 1}
    run_wrap(
        WrapRequest((Path("RESULT"),), Path("w.obj"), baked=Path("w.png"), occlusion=Path("ao.png"), **scan), Stages()
    )
    transfer("t.png", bake=("texture", "ao"), **scan)
    sizes = {
        name: read_image(place / name).pixels.shape[:2] for name in ("w.png", "ao.png", "t_texture.png", "t_ao.png")
    }
    assert sizes == {"w.png": (96, 96), "t_texture.png": (96, 96), "ao.png": (16, 16), "t_ao.png": (16, 16)}


def test_smooth_lookups_of_the_detail_s_image_are_prepared_once(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not for each tile of the target, and of the tiles in use alone."""
    target, scan = textured_cube("large.obj", 2.0), textured_cube("scan.obj")
    assert target.uvs is not None
    cubes = replace(target, uvs=target.uvs * [3, 1]), textured_cube("small.obj")
    write_result(place / "RESULT", identity_result(2, cubes), force=True)
    write_mesh(place / "scan.obj", scan)
    for tile in (1001, 1002):
        write_image(place / f"scan.{tile}.png", np.full((32, 32, 3), 90, dtype=np.uint8))
    prepared, of = [], SmoothTile.of

    def prepare(pixels: np.ndarray, covered: np.ndarray) -> SmoothTile:
        prepared.append(pixels)
        return of(pixels, covered)

    monkeypatch.setattr(SmoothTile, "of", prepare)
    scan_files = {"detail": place / "scan.obj", "detail_texture": place / "scan.<UDIM>.png"}
    transfer("t.<UDIM>.png", bake=("texture",), size=16, **scan_files)
    assert sorted(file.name for file in place.glob("t.*.png")) == ["t.1001.png", "t.1002.png", "t.1003.png"]
    assert len(prepared) == 1


def test_a_detail_that_is_the_source_bakes_no_rounding_as_heights(place: Path) -> None:
    write_mesh(place / "fine.obj", finest_mesh(identity_result().source.refinement))
    for kind in ("displacement", "vector-displacement"):
        pixels, summary, _ = transfer(f"{kind}.png", bake=(kind,), detail=place / "fine.obj", size=16)
        assert "(value - 0.5) * 1 in" in summary
        assert np.ptp(pixels) <= 1


def test_all_tiles_of_a_base_are_inputs(place: Path) -> None:
    cubes = (
        replace(textured_cube("large.obj", 2.0), uvs=textured_cube("l").uvs * [2, 1] + [1, 0]),
        textured_cube("small.obj"),
    )
    write_result(place / "RESULT", identity_result(1, cubes), force=True)
    for tile in (1001, 1002, 1003):
        write_image(place / f"skin.{tile}.png", np.full((16, 16, 3), 80, dtype=np.uint8))
    given = {"material_colors": True, "source_mask": "red", "bases": (("", place / "skin.1001.png"),), "size": 16}
    refuses(FormatError, r"skin\.1002\.png.* is an input too", transfer, "skin.<UDIM>.png", force=True, **given)


def test_one_tile_of_a_set_is_not_repeated_over_the_others_in_silence(
    place: Path, caplog: pytest.LogCaptureFixture
) -> None:
    target, source = textured_cube("large.obj", 2.0), textured_cube("small.obj")
    assert source.uvs is not None
    for tile in (1001, 1002, 1003):
        write_image(place / f"skin_{tile}.png", np.full((8, 8, 3), 80 + tile - 1000, dtype=np.uint8))
    for scale, n_warnings in (((1, 1), 0), ((3, 1), 1)):
        tiled = source.with_uvs(source.uvs * scale, source.uv_indices)
        write_result(place / "RESULT", identity_result(1, (target, tiled)), force=True)
        write_mesh(place / "scan.obj", tiled, force=True)
        for name in ("skin_1001.png", "skin_<UDIM>.png"):
            texture, scan = place / name, {"detail": place / "scan.obj", "detail_texture": place / name}
            wrapped = WrapRequest((Path("RESULT"),), Path("w.obj"), baked=Path("w.png"), force=True, size=16, **scan)
            for mesh, run in (
                ("small.obj", partial(transfer, "t.png", texture=texture, size=16)),
                ("small.obj", partial(transfer, "t.png", material_colors=True, source_mask=str(texture), size=16)),
                ("scan.obj", partial(transfer, "t.png", bake=("texture",), size=16, **scan)),
                ("scan.obj", partial(run_wrap, wrapped, Stages())),
            ):
                caplog.clear()
                run()
                repeated = [text for record in caplog.records if "repeated" in (text := record.getMessage())]
                assert repeated == n_warnings * (name == "skin_1001.png") * [
                    f"{texture} is repeated over all tiles of the layout of {mesh}: give {place / 'skin_<UDIM>.png'} "
                    "for the whole set"
                ]
    # All that the mask allows may be in one tile.
    caplog.clear()
    transfer("t.png", texture=place / "skin_1001.png", source_mask="red", size=16)
    assert not [record for record in caplog.records if "repeated" in record.getMessage()]


def test_vertices_of_no_face_are_not_counted_as_grey(place: Path) -> None:
    detail = textured_cube("scan.obj")
    positions = np.vstack([detail.positions, np.zeros((2, 3))])
    colors = np.vstack([np.full((8, 3), 0.5), np.full((2, 3), np.nan)])
    write_mesh(place / "scan.obj", replace(detail, positions=positions, vertex_colors=colors))
    *_, warnings = transfer("o.png", bake=("colors",), detail=place / "scan.obj", size=8)
    assert not [text for text in warnings if "grey" in text]


def test_a_bake_between_vertices_fades_into_its_base_with_any_filter(place: Path) -> None:
    write_mesh(place / "scan.obj", replace(textured_cube("scan.obj"), vertex_colors=np.full((8, 3), 0.5)))
    write_image(place / "own.png", np.zeros((32, 32, 3), dtype=np.uint8))
    masked = {"target_mask": "red", "mask_edge": 0.2, "bases": (("", place / "own.png"),), "size": 32}
    baked = {
        kind: transfer(f"{kind}.png", bake=("colors",), detail=place / "scan.obj", filter=kind, **masked)[0]
        for kind in ("smooth", "nearest")
    }
    assert len(np.unique(baked["smooth"])) > 3
    np.testing.assert_array_equal(baked["nearest"], baked["smooth"])


@pytest.mark.parametrize(("low", "high", "times"), [(-1e-8, 1.0 + 1e-7, 1), (0.0, 1.5, 2), (-0.5, 1.2, 3)])
def test_an_image_is_repeated_as_often_as_uvs_leave_it_by_more_than_rounding(low, high, times):
    pixels = np.arange(48, dtype=np.uint8).reshape(4, 4, 3)
    tiled, uvs = _tile_image(pixels, np.array([[low, 0.2], [high, 0.8]]))
    np.testing.assert_array_equal(tiled, np.tile(pixels, (1, times, 1)))
    np.testing.assert_allclose(uvs[:, 0], (np.array([low, high]) - np.floor(low + 1e-4)) / times)
    assert _tile_image(pixels, np.array([[0.0, 0.0], [5000.0, 1.0]])) is None
