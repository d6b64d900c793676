"""`cagemap transfer` and `cagemap report` on a small RESULT: what they write, warn of and refuse."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cagemap
from cagemap.files.images.image import read_image, write_image
from cagemap.files.meshes.formats import read_mesh
from cagemap.files.result.folder import read_result, write_result
from cagemap.transfer import carry_uvs

from command_line import Run


def test_transfer_bakes_and_report_shows_it(run: Run, result_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    place = result_folder.parent
    monkeypatch.setattr("cagemap.cli.progress.SILENT_SECONDS", 600.0)
    outcome = run.done("transfer R --texture t.png --size 96 -o baked.png")
    assert outcome.err == ""  # no progress where there is no terminal, at first
    baked = read_image(place / "baked.png").pixels
    assert baked.shape == (96, 96, 3)
    shown = {}
    monkeypatch.setattr("cagemap.tasks.report.write_report", lambda *args, **kwargs: shown.update(kwargs))
    assert run("report R -o r.html").code == 0
    np.testing.assert_array_equal(shown["texture"], read_image(place / "t.png").pixels)
    np.testing.assert_array_equal(shown["baked"], baked)
    (place / "baked.png").unlink()
    assert run("report R -o r.html").code == 0
    assert shown["texture"] is not None
    assert shown["baked"] is None
    (place / "t.png").unlink()
    assert run("report R -o r.html").code == 0
    assert shown["texture"] is None


@pytest.mark.slow
def test_the_report_shows_every_baked_image(run: Run, result_folder: Path) -> None:
    place = result_folder.parent
    result = read_result(result_folder)
    white = np.ones((result.source.control.n_vertices, 3))
    colored = result.source.with_control(replace(result.source.control, vertex_colors=white))
    write_result(result_folder, replace(result, source=colored))
    write_image(place / "h.exr", np.full((8, 12, 1), 0.25, np.float32))
    write_image(place / "v.exr", np.full((8, 12, 3), -0.5, np.float32))
    write_image(place / "n.png", np.full((8, 12, 3), [128, 128, 255], np.uint8))
    for words in (
        "--texture t.png -o t_baked.png",
        "--texture albedo=t.png --texture roughness=t.png -o maps.png",
        "--displacement h.exr -o h_baked.exr",
        "--vector-displacement v.exr -o v_baked.exr",
        "--normal-map n.png -o n_baked.png",
        "--material-colors -o m_baked.png",
        "--bake ao,colors --rays 8 --unwrap -o d.png",
    ):
        run.done(f"transfer R {words} --size 32")
    run.done("report R -o r.html")
    page = (place / "r.html").read_text(encoding="utf-8")
    section = page.partition("Baked images")[2].partition("</details>")[0]
    captions = re.findall("<figcaption>(.*?)</figcaption>", section)
    assert captions == [
        caption
        for name in (
            "texture: t_baked.png",
            "texture albedo: maps_albedo.png",
            "displacement: h_baked.exr",
            "vector displacement: v_baked.exr",
            "normal map: n_baked.png",
            "material colours: m_baked.png",
            "ambient occlusion: d_ao.png",
            "colours: d_colors.png",
        )
        for caption in (name, f"{name}, on the target")
    ]


@pytest.mark.slow
def test_the_report_shows_all_tiles_of_an_image(run: Run, result_folder: Path) -> None:
    result = read_result(result_folder)
    control = result.target.control
    tiled = control.with_uvs(control.uvs * [2.0, 1.0], control.uv_indices)
    write_result(result_folder, replace(result, target=result.target.with_control(tiled)))
    run.done("transfer R --material-colors --size 32 -o m.png")
    run.done("report R -o r.html")
    page = (result_folder.parent / "r.html").read_text(encoding="utf-8")
    assert 'width="64" height="32" alt="material colours: m.&lt;UDIM&gt;.png"' in page


def test_displacement_grows_with_the_model(run: Run, result_folder: Path) -> None:
    heights = np.full((32, 48, 1), 0.25, np.float32)
    write_image(result_folder.parent / "h.exr", heights)
    run.done("transfer R --displacement h.exr --size 32 -o d.exr")
    # The target is twice as large. 1e-3: the image holds float32, areas are summed in another order.
    np.testing.assert_allclose(read_image(result_folder.parent / "d.exr").pixels, 0.5, rtol=1e-3)
    run.refused("transfer R --displacement t.png --size 32 -o d.png", says="grey")


def test_material_colours_are_baked(run: Run, result_folder: Path) -> None:
    run.done("transfer R --material-colors --size 60 -o m.png")
    pixels = read_image(result_folder.parent / "m.png").pixels
    red, green, _ = pixels[45, 10].astype(int)  # face 0: the lower left cell of the layout
    assert red > green + 50
    assert np.ptp(pixels[45, 30].astype(int)) <= 1  # face 1: unknown, grey


def test_a_target_without_uvs_needs_unwrap(run: Run, result_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    place, result = result_folder.parent, read_result(result_folder)
    bare = result.target.with_control(result.target.control.with_uvs(None, None))
    write_result(result_folder, replace(result, target=bare))
    run.refused("transfer R --texture t.png --size 32 -o b.png", says="--unwrap")
    run.done("transfer R --texture t.png --size 32 --unwrap -o b.png")
    laid_out = read_mesh(place / "b_unwrapped.obj")
    assert laid_out.uvs is not None
    shown: dict[str, object] = {}
    monkeypatch.setattr(
        "cagemap.tasks.report.write_report", lambda path, result, **kwargs: shown.update(kwargs, r=result)
    )
    assert run("report R").code == 0
    assert shown["baked"] is not None
    assert shown["r"].target.control.uvs is not None  # type: ignore[attr-defined]


@pytest.mark.slow
def test_a_normal_map_is_not_taken_for_colours_without_a_word(run: Run, result_folder: Path) -> None:
    place = result_folder.parent
    slopes = np.random.default_rng(5).normal(0.0, 0.3, (32, 48, 2))
    normals = np.concatenate([slopes, np.ones((32, 48, 1))], axis=2)
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    write_image(place / "n.png", np.round(255 * (normals + 1) / 2).astype(np.uint8))
    run.refused("transfer R --texture n.png --size 16 -o o.png", says="looks like a normal map")
    sky = np.round(255 * np.random.default_rng(6).random((32, 48, 1)) * [0.5, 0.7, 1.0]).astype(np.uint8)
    for name, pixels in (("t.png", None), ("sky.png", sky), ("grey.png", sky[:, :, :1])):
        if pixels is not None:
            write_image(place / name, pixels)
        assert run("transfer R --texture", name, "--size", 16, "-o", "o.png").err == "", name
    assert run("transfer R --normal-map n.png --size 16 -o o.png").err == ""
    assert "is it a normal map" in run("transfer R --normal-map sky.png --size 16 -o o.png").err


def test_islands_outside_the_square_are_warned_of(run: Run, result_folder: Path) -> None:
    result = read_result(result_folder)
    moved = result.target.control.with_uvs(result.target.control.uvs - [0.4, 0.0], result.target.control.uv_indices)
    write_result(result_folder, replace(result, target=result.target.with_control(moved)))
    outcome = run.done("transfer R --texture t.png --size 32 -o b.png")
    assert "outside the unit square" in outcome.err


def test_layouts_that_lie_over_themselves_are_warned_of(run: Run, result_folder: Path) -> None:

    def doubled(surface: cagemap.Surface) -> cagemap.Surface:
        control = surface.control
        corners = control.uv_indices.reshape(-1, 4).copy()
        half = len(corners) // 2
        corners[half : 2 * half] = corners[:half]
        faces = np.arange(control.n_faces) >= half
        materials = {"face_materials": faces.astype(np.int64), "material_names": ("skin", "eyes")}
        return surface.with_control(replace(control.with_uvs(control.uvs, corners.ravel()), **materials))

    plain = run.done("transfer R --texture t.png --size 32 -o plain.png")
    assert "over" not in plain.err
    result = read_result(result_folder)
    write_result(result_folder, replace(result, target=doubled(result.target), source=doubled(result.source)))
    outcome = run.done("transfer R --texture t.png --size 32 -o b.png")
    assert "50 % of the target's layout lies over other parts" in outcome.err
    assert "materials of the source lie over each other in its layout (skin, eyes)" in outcome.err
    n_faces = result.target.control.n_faces
    np.save(result_folder.parent / "eyes.npy", (np.arange(n_faces) >= n_faces // 2).astype(float))
    layer = run.done("transfer R --texture t.png --target-mask eyes.npy --mask-edge 0 --size 32 -o layer.png")
    assert "the target's layout lies over" not in layer.err
    assert (read_image(result_folder.parent / "layer.png").pixels[..., -1] > 250).mean() > 0.2
    colours = run("transfer R --material-colors --size 32 -o c.png")
    assert "materials of the source" not in colours.err


def test_only_the_first_faces_over_a_seam_are_listed(run, result_folder, monkeypatch):
    def crossed(*sides: Any) -> Any:
        return replace(carry_uvs(*sides), crossed=np.arange(1000))

    monkeypatch.setattr("cagemap.tasks.transfer.carry_uvs", crossed)
    outcome = run.done("transfer R --source-uvs -o laid.obj")
    assert "cross 1000 of" in outcome.err
    assert "0, 1, 2, 3, 4, 5, 6, 7, ... (992 more)" in outcome.err


def test_a_mesh_with_the_source_s_uvs_is_noted_and_what_its_missing_file_held_is_warned_of(run, result_folder):
    outcome = run.done("transfer R --source-uvs -o laid.obj")
    result = read_result(result_folder)
    (entry,) = result.manifest["transfers"]
    assert entry["output"] == "../laid.obj"
    assert f"{result.target.control.name}: the file is no longer where the match read it" in outcome.err


def test_a_base_of_another_colour_space_is_warned_of(run: Run, result_folder: Path) -> None:
    place = result_folder.parent
    np.save(place / "mask.npy", np.repeat([0.0, 1.0], 4))
    write_image(place / "base.exr", np.full((8, 8, 3), 0.5, dtype=np.float32))
    write_image(place / "same.png", np.full((8, 8, 3), 128, dtype=np.uint8))
    for base, warned in (("base.exr", True), ("same.png", False)):
        words = ("--texture", "t.png", "--target-mask", "mask.npy", "--base", base, "-o", f"over_{base}.png")
        outcome = run.done("transfer R", *words)
        assert ("mixed as they are" in outcome.err) is warned, outcome.err
