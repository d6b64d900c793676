"""Nothing that cagemap did not write is deleted or overwritten, and nothing that it was given is lost."""

import json
import os
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from examples.shapes import cube

from cagemap.errors import FormatError, ParameterError
from cagemap.files.atomic import atomic_path
from cagemap.files.images.image import read_image, write_image
from cagemap.files.landmarks.pairs import write_landmarks
from cagemap.files.meshes.formats import read_mesh, write_mesh
from cagemap.files.npz import write_npz
from cagemap.files.ownership import is_own
from cagemap.files.result.folder import read_result, write_result
from cagemap.files.result.manifest import MANIFEST, stated_inputs
from cagemap.files.values.attributes import read_attributes, write_attributes
from cagemap.report import build_page
from cagemap.report.figures import Gallery
from cagemap.tasks.match import MatchRequest, run_match
from cagemap.tasks.mesh_commands import run_refine
from cagemap.tasks.progress import Stages
from cagemap.tasks.report import run_report
from cagemap.tasks.requests.mesh_commands import RefineRequest
from cagemap.tasks.requests.report import ReportRequest
from cagemap.tasks.requests.suggest import SuggestRequest
from cagemap.tasks.requests.wrap import WrapRequest
from cagemap.tasks.suggest import run_suggest
from cagemap.tasks.wrap import run_wrap

from example_once import example_pair
from example_result import identity_result, textured_cube
from refusals import refuses
from transfer_command import transfer

CUBE = """# modelled by hand
mtllib box paint.mtl
o body
v -1 -1 -1
v -1 -1 1
v -1 1 -1
v -1 1 1
v 1 -1 -1
v 1 -1 1
v 1 1 -1
v 1 1 1
vn -1 0 0
vn 1 0 0
g left
usemtl skin
s 1
f 2//1 4//1 3//1 1//1  # that side
g rest
usemtl lid
f 5//2 7//2 8//2 6//2
f 5 6 2 1
f 3 4 \\
  8 7
f 3 -2 -4 -8
f 2 6 8 4
mtllib box paint.mtl
"""
PAINT = "newmtl skin\nKd 1 0 0\nKs 0.5 0.5 0.5\nmap_Kd skin.png\nnewmtl lid\nillum 2\n"


@pytest.fixture
def place(tmp_path: Path) -> Path:
    """A result, a texture for it, and work of the user's."""
    write_result(tmp_path / "R", identity_result())
    write_image(tmp_path / "t.png", np.full((16, 24, 3), 90, np.uint8))
    (tmp_path / "thesis.tex").write_text("years")
    return tmp_path


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def texture_of(place: Path, output: str, **options: Any) -> tuple[str, list[str]]:
    return transfer(place / output, place / "R", texture=place / "t.png", size=16, **options)


def test_a_folder_with_a_foreign_manifest_is_left_alone(place: Path) -> None:
    work = place / "app"
    (work / "sub").mkdir(parents=True)
    (work / "manifest.json").write_text('{"name": "a web app"}')
    (work / "sub" / "photo.raw").write_bytes(b"\0\1")
    before = contents(work)
    refuses(FormatError, r"manifest\.json: exists.*force=True", write_result, work, identity_result())
    assert contents(work) == before
    write_result(work, identity_result(), force=True)
    assert (work / "sub" / "photo.raw").exists()
    assert read_result(work).landmarks.names


def test_a_rerun_keeps_the_users_files_in_the_result_folder(place: Path) -> None:
    shutil.copytree(place / "R", place / "R" / "older")
    shutil.copy(place / "thesis.tex", place / "R" / "notes.tex")
    result = identity_result()
    renamed = replace(result.landmarks, names=("new", "c", "d", "e"))
    write_result(place / "R", replace(result, landmarks=renamed))
    assert read_result(place / "R").landmarks.names[0] == "new"
    assert read_result(place / "R" / "older").landmarks.names[0] == "a <b>"
    assert (place / "R" / "notes.tex").read_text() == "years"


def test_a_manifest_that_somebody_edited_is_theirs(place: Path) -> None:
    file = place / "R" / MANIFEST
    file.write_text(file.read_text().replace('"made for other poses"', '"my own remark"'))
    refuses(FormatError, "changed since", write_result, place / "R", identity_result())
    assert "my own remark" in file.read_text()


def test_a_result_of_a_version_without_marks_is_replaced(place: Path) -> None:
    file = place / "R" / MANIFEST
    manifest = json.loads(file.read_text())
    file.write_text(json.dumps({name: manifest[name] for name in manifest if name not in ("written_by", "files")}))
    np.savez(place / "R" / "map.npz", **dict(np.load(place / "R" / "map.npz")))
    write_result(place / "R", identity_result())
    assert is_own(file)


def test_match_refuses_a_foreign_folder_before_it_works(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def never(*_: object, **__: object) -> None:
        raise AssertionError("worked before it looked")

    monkeypatch.setattr("cagemap.tasks.match.read_inputs", never)
    (tmp_path / "manifest.json").write_text("[]")
    mesh, pairs = tmp_path / "a.obj", tmp_path / "l.json"
    for output, words in ((tmp_path, "not overwritten"), (tmp_path / "none" / "R", "does not exist")):
        refuses(FormatError, words, run_match, MatchRequest(mesh, mesh, output, pairs), Stages())


def test_unwrapping_leaves_the_model_beside_the_image_alone(place: Path) -> None:
    (place / "box.obj").write_text(CUBE)
    (place / "box.mtl").write_text(PAINT)
    before = contents(place)
    texture_of(place, "box.png", unwrap=True)
    after = contents(place)
    assert [name for name in before if after[name] != before[name]] == ["R/manifest.json"]
    assert {"box.png", "box_unwrapped.obj", "box_unwrapped.mtl"} <= set(after)


def unwrapped(place: Path, folder: str) -> tuple[str, list[str]]:
    """The text of an unwrapped mesh whose original lies in another folder, and what was warned of."""
    (place / "models").mkdir()
    (place / "models" / "box.obj").write_text(CUBE)
    (place / "models" / "box paint.mtl").write_text(PAINT)
    result = identity_result()
    target = replace(result.target.control, name="box.obj")
    control = read_mesh(place / "models" / "box.obj")
    assert control.face_indices.tolist() == target.face_indices.tolist()
    inputs = stated_inputs({"target": place / "models" / "box.obj"}, place / "R")
    write_result(place / "R", replace(result, provenance={**result.provenance, "inputs": inputs}))
    _, warnings = texture_of(place, f"{folder}/skin.png", unwrap=True)
    return (place / folder / "skin_unwrapped.obj").read_text(), warnings


@pytest.mark.parametrize("folder", [".", "models"])
def test_an_unwrapped_mesh_keeps_everything_its_file_had(place: Path, folder: str) -> None:
    text, warnings = unwrapped(place, folder)
    assert warnings == []
    kept = [line for line in CUBE.splitlines() if not line.startswith(("f ", "  ", "mtllib"))]
    lines = text.splitlines()
    assert [line for line in lines if line in kept] == kept
    assert [line for line in lines if line.startswith("mtllib")] == ["mtllib skin_unwrapped.mtl"]
    materials = (place / folder / "skin_unwrapped.mtl").read_text().splitlines()[1:]
    white, image = "Kd 1.0 1.0 1.0", "map_Kd skin.png"
    assert materials == ["newmtl skin", white, "Ks 0.5 0.5 0.5", image, "newmtl lid", white, "illum 2", image]
    faces = [line for line in lines if line.startswith("f ")]
    assert all(corner.count("/") == 2 for corner in faces[0].partition("#")[0].split()[1:])
    assert faces[0].endswith("# that side")
    laid_out, original = read_mesh(place / folder / "skin_unwrapped.obj"), read_mesh(place / "models" / "box.obj")
    np.testing.assert_array_equal(laid_out.face_indices, original.face_indices)
    np.testing.assert_array_equal(laid_out.face_materials, original.face_materials)
    assert laid_out.material_names == original.material_names
    assert laid_out.uvs is not None


@pytest.mark.slow
def test_an_unwrapped_mesh_shows_each_baked_image_on_every_face(place: Path) -> None:
    result = read_result(place / "R")
    bare = replace(result.target.control, face_materials=None, material_names=(), material_colors=None)
    write_result(place / "R", replace(result, target=result.target.with_control(bare)))

    def materials_of(name: str, **options: Any) -> list[str]:
        transfer(place / f"{name}.png", size=16, unwrap=True, **options)
        text = (place / f"{name}_unwrapped.obj").read_text()
        assert text.index(f"mtllib {name}_unwrapped.mtl\n") < text.index("usemtl baked\n") < text.index("f ")
        return (place / f"{name}_unwrapped.mtl").read_text().splitlines()[1:]

    image, white = place / "t.png", "Kd 1.0 1.0 1.0"
    assert materials_of("my skin", texture=image) == ["newmtl baked", white, "map_Kd my skin.png"]
    maps = (("Base_Color", image), ("roughness", image), ("odd", image))
    named = ["newmtl baked", white, "map_Kd m_Base_Color.png", "map_Pr m_roughness.png"]
    assert materials_of("m", maps=maps) == named
    normals = ["newmtl baked", "norm n.png", "map_Bump n.png"]
    assert materials_of("n", normal_map=image) == normals
    assert materials_of("c", material_colors=True) == ["newmtl baked", white, "map_Kd c.png"]
    assert materials_of("ao", bake=("ao",), rays=4) == ["newmtl baked", white, "map_Ka ao.png", "map_Kd ao.png"]


def test_a_foreign_material_file_is_not_replaced(place: Path) -> None:
    for name in ("fine.mtl", "a_unwrapped.mtl"):
        (place / name).write_text(PAINT)
    before = contents(place)
    refuses(FormatError, r"fine\.mtl: exists", write_mesh, place / "fine.obj", textured_cube("box.obj"))
    refuses(FormatError, r"a_unwrapped\.mtl: exists", texture_of, place, "a.png", unwrap=True)
    assert contents(place) == before
    _, warnings = texture_of(place, "b.png", unwrap=True)
    assert "no groups, names or normals" in warnings[0]
    assert read_mesh(place / "b_unwrapped.obj").uvs is not None


@pytest.mark.parametrize("force", [False, True])
def test_outputs_are_no_inputs(place: Path, force: bool) -> None:
    write_mesh(place / "box.obj", cube())
    os.symlink(place / "t.png", place / "link.png")
    write_npz(place / "shapes.npz", {"smile": np.zeros((8, 3))})
    (place / "faces").mkdir()
    before = contents(place)

    def shapes(given: str, to: str, **options: Any) -> object:
        return transfer(place / to, blend_shapes=(place / given,), force=force, **options)

    attempts: list[Callable[[], object]] = [
        lambda: texture_of(place, "t.png", force=force),
        lambda: texture_of(place, "link.png", force=force),
        lambda: shapes("shapes.npz", "shapes.npz"),
        lambda: shapes("faces", "faces"),
        lambda: shapes("shapes.npz", "other.npz", usd=place / "shapes.npz"),
        lambda: run_refine(RefineRequest(place / "box.obj", 1, place / "box.obj", force=force), Stages()),
        lambda: run_report(ReportRequest(place / "R", place / "R" / MANIFEST, force=force), Stages()),
        lambda: run_report(ReportRequest(place / "R", place / "t.png", place / "t.png", force), Stages()),
    ]
    for attempt in attempts:
        refuses(FormatError, r"is an input too|expected the name of a page|expected a.* name ending in", attempt)
    mesh = MatchRequest(place / "box.obj", place / "box.obj", place / "R", place / "R" / MANIFEST, force=force)
    refuses(FormatError, "is an input too", run_match, mesh, Stages())
    assert contents(place) == before


@pytest.mark.slow
@pytest.mark.parametrize("force", [False, True])
def test_what_a_match_read_is_no_output_of_what_follows(place: Path, force: bool) -> None:
    models, result = place / "models", identity_result()
    models.mkdir()
    write_mesh(models / "large.obj", result.target.control)
    write_mesh(models / "a_unwrapped.obj", result.source.control)
    files = {"target": models / "large.obj", "source": models / "a_unwrapped.obj"}
    inputs = stated_inputs(files, place / "R")
    write_result(place / "R", replace(result, provenance={**result.provenance, "inputs": inputs}))
    write_npz(place / "shapes.npz", {"smile": np.zeros((8, 3))})
    (place / "bad.png").write_text("no image")
    before = contents(place)

    def made(output: Path, **options: Any) -> object:
        return transfer(output, place / "R", force=force, **options)

    def wrapped(output: Path, **options: Any) -> object:
        return run_wrap(WrapRequest((place / "R",), output, force=force, **options), Stages())

    attempts: list[Callable[[], object]] = [
        lambda: made(models / "large.obj", source_uvs=True),
        lambda: made(models / "a.png", texture=place / "t.png", size=16, unwrap=True),
        lambda: made(models, blend_shapes=(place / "shapes.npz",)),
        lambda: run_suggest(SuggestRequest(place / "R", models / "large.obj", 1, force=force), Stages()),
        lambda: wrapped(models / "large.obj"),
        lambda: wrapped(models, blend_shapes=True),
        lambda: wrapped(place / "w.obj", normal_map=place / "t.png", texture=place / "t.png", baked=place / "b.png"),
    ]
    for attempt in attempts:
        refuses(FormatError, "is an input too", attempt)
    layer = models / "large.obj"
    refuses(FormatError, "ending in .usda", made, place / "a.png", texture=place / "t.png", usd=layer)
    with pytest.raises(FormatError, match=r"n\.png: two outputs have this name"):
        wrapped(place / "w.obj", normal_map=place / "n.png", displacement=place / "n.png")
    with pytest.raises(ParameterError, match="colours"):  # and no mesh without its image
        wrapped(place / "w.obj", colors=place / "n.png")
    with pytest.raises(FormatError, match="no such file"):
        wrapped(place / "w.obj", normal_map=place / "n.png", detail=place / "gone.obj")
    with pytest.raises(FormatError, match=r"thesis\.tex"):  # nor without that of a damaged file
        wrapped(place / "w.obj", normal_map=place / "n.png", detail=place / "thesis.tex")
    refuses(FormatError, r"bad\.png", wrapped, place / "w.obj", texture=place / "bad.png", baked=place / "n.png")
    assert contents(place) == before


def test_no_command_overwrites_what_it_did_not_write(place: Path) -> None:
    write_mesh(place / "box.obj", cube())
    for name in ("mine.obj", "mine.png", "mine.html", "mine.npz"):
        (place / name).write_text("mine")
    np.save(place / "v.npy", np.arange(8.0))
    (place / "painted.png").write_bytes((place / "t.png").read_bytes())
    write_image(place / "painted.png", read_image(place / "t.png").pixels + np.uint8(1))
    edited = bytearray((place / "painted.png").read_bytes())
    edited[60] ^= 1
    (place / "painted.png").write_bytes(edited)
    before = contents(place)
    attempts: list[Callable[[], object]] = [
        lambda: texture_of(place, "mine.png"),
        lambda: texture_of(place, "painted.png"),
        lambda: run_refine(RefineRequest(place / "box.obj", 1, place / "mine.obj"), Stages()),
        lambda: run_report(ReportRequest(place / "R", place / "mine.html"), Stages()),
        lambda: transfer(place / "mine.npz", attribute=place / "v.npy"),
    ]
    for attempt in attempts:
        refuses(FormatError, r"was not written by cagemap.*force=True", attempt)
    assert contents(place) == before
    texture_of(place, "mine.png", force=True)
    transfer(place / "mine.npz", attribute=place / "v.npy", force=True)
    run_refine(RefineRequest(place / "box.obj", 1, place / "mine.obj", force=True), Stages())
    for name in ("mine.png", "mine.npz", "mine.obj"):
        assert is_own(place / name)


def test_own_files_of_every_format_are_replaced(tmp_path: Path) -> None:
    control = textured_cube("box.obj")
    pair = example_pair(8)
    page = build_page(identity_result(), Gallery("map", (), (), (), ""))
    pixels = {"png": np.uint8, "tif": np.float32, "exr": np.float16, "jpg": np.uint8}

    def write_all() -> None:
        write_mesh(tmp_path / "a.obj", control)
        write_mesh(tmp_path / "a.ply", control)
        write_landmarks(tmp_path / "l.json", pair.landmarks)
        write_attributes(tmp_path / "v.npz", {"file": np.arange(3.0), "allow_pickle": np.arange(4)})
        for suffix, dtype in pixels.items():
            write_image(tmp_path / f"a.{suffix}", np.full((70, 90, 3), 0.5).astype(dtype))
        with atomic_path(tmp_path / "r.html") as temporary:
            temporary.write_text(page)

    write_all()
    before = contents(tmp_path)
    assert len(before) == 10
    assert all(is_own(tmp_path / name) for name in before)
    write_all()
    assert set(read_attributes(tmp_path / "v.npz")) == {"file", "allow_pickle"}
    for name, content in before.items():  # one bit of anybody else's makes it theirs, wherever it is
        for at in (len(content) // 2, len(content) - 1 if name.endswith(("obj", "html")) else len(content) // 2):
            changed = bytearray(content)
            changed[at] ^= 1
            (tmp_path / name).write_bytes(changed)
            if not name.endswith(".npz"):  # of an archive the directory counts, which holds checksums of the rest
                assert not is_own(tmp_path / name), name
    assert read_image(tmp_path / "a.exr").pixels.shape == (70, 90, 3)


def test_links_are_followed_and_permissions_kept(place: Path) -> None:
    (place / "store").mkdir()
    write_image(place / "store" / "baked.png", np.zeros((4, 4, 3), np.uint8))
    (place / "store" / "baked.png").chmod(0o640)
    os.symlink(place / "store" / "baked.png", place / "baked.png")
    texture_of(place, "baked.png")
    assert (place / "baked.png").is_symlink()
    assert read_image(place / "store" / "baked.png").pixels.shape == (16, 16, 3)
    assert (place / "store" / "baked.png").stat().st_mode & 0o777 == 0o640
    shutil.move(place / "R", place / "store" / "R")
    os.symlink(place / "store" / "R", place / "R")
    write_result(place / "R", identity_result())
    assert (place / "R").is_symlink()
    assert not [path.name for path in place.rglob("*") if path.name.startswith(".")]


def test_devices_and_read_only_files_are_not_replaced(place: Path) -> None:
    os.mkfifo(place / "pipe.png")
    refuses(FormatError, "device or a pipe", texture_of, place, "pipe.png", force=True)
    texture_of(place, "kept.png")
    (place / "kept.png").chmod(0o444)
    refuses(FormatError, "read-only", texture_of, place, "kept.png", force=True)


def test_manifests_name_files_relative_to_themselves(place: Path) -> None:
    texture_of(place, "baked.png")
    (entry,) = read_result(place / "R").manifest["transfers"]
    assert (entry["image"], entry["output"]) == ("../t.png", "../baked.png")
    assert str(place) not in (place / "R" / MANIFEST).read_text()
