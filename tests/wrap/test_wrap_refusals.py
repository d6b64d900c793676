"""Nets and plain targets that cannot be fitted: every message says by what, what is wrong, and what to do."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples.shapes import cube

from cagemap import refine
from cagemap.errors import FormatError, ParameterError
from cagemap.files.images.image import write_image
from cagemap.files.meshes.formats import write_mesh
from cagemap.mesh.schemes import Plain
from cagemap.surface.triangle_surface import SurfacePoints, TriangleSurface
from cagemap.tasks import run
from cagemap.tasks import wrap as task
from cagemap.tasks.match import MatchRequest
from cagemap.tasks.progress import Stages
from cagemap.tasks.requests.wrap import WrapRequest
from cagemap.wrap.fit import fit_net, mend
from cagemap.wrap.net import ControlNet, MendConfig, Samples, WrapConfig, control_net

from command_line import Run
from example_result import identity_result, textured_cube
from refusals import Refusal
from textured_files import write_textured_scene


def box(follow: float) -> tuple[ControlNet, Samples]:
    """A box on itself, with one weight for all of its samples."""
    target = refine(cube(), 2)
    surface = TriangleSurface.from_faces(target.finest.positions, target.finest.faces)
    net, images = control_net(target, 0, surface.scale), SurfacePoints.from_vertices(surface, np.arange(surface.n))
    return net, Samples.choose(net, images, np.full(surface.n, follow), np.zeros(surface.n, dtype=bool), WrapConfig())


def free_everywhere(_: object) -> None:
    fit_net(*box(0.0), WrapConfig())


def released_everywhere(_: object) -> None:
    """Two corners of a small box change places, and mending releases all that is near a fold."""
    net, samples = box(1.0)
    folded = net.graph.positions.copy()
    folded[[0, 1]] = folded[[1, 0]]
    mend(net, samples, WrapConfig(mending=MendConfig(small=1.0, max_small_fold=0.0, release_rings=3)), folded)


REFUSED = {
    "a net that nothing holds": Refusal(
        free_everywhere, "weights: ", "expected a part of the target that follows the source", "Give weights above 0."
    ),
    "a net that folds everywhere": Refusal(
        released_everywhere,
        "wrap: expected a net that folds in few places",
        "got folds at all of its points, so that none follows the source",
        "Look at the map",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_net_that_cannot_be_fitted_is_refused(name: str) -> None:
    REFUSED[name].check(None)


BEFORE_A_MATCH = {
    "--fairness 0": "fairness: expected",
    "--symmetric --fit-level 1": "--symmetric: expected --fit-level 0",
    "--symmetric -t odd.obj": "odd.obj: expected a mirror symmetric mesh for --symmetric",
    "--weights two.csv": "two.csv: expected one column of weights",
    "--weights short.npy": "expected a weight for each of the 8 control vertices",
    "--target-mask hand": "expected a part named 'hand'",
    "--fit-level 9": "--fit-level: expected a level below the map's own",
    "--mhclo a.clo": "a.clo: expected a name ending in .mhclo or .proxy",
    "--texture deep.exr --baked b.jpg": "b.jpg",
    "--texture i.png --baked b.png -t bare.obj": "bare.obj: expected texture coordinates to bake into",
    "--texture i.png --baked b.png -s bare.obj": "bare.obj: expected texture coordinates of the source",
    **dict.fromkeys(
        ("--texture none.gltf --baked b.png -s parts.obj", "--texture half.gltf --baked b.png -s parts.obj"),
        "expected a colour image on most of parts.obj for its UV set in use, found none. Give an image made for these "
        "UVs, or the RESULT of `cagemap match` with another --source-uv-set.",
    ),
}


@pytest.mark.parametrize("words", BEFORE_A_MATCH)
def test_a_wrap_that_cannot_end_is_refused_before_its_match(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: str
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("cagemap.tasks.match.match_inputs", lambda *given: pytest.fail("it was matched"))
    cage = textured_cube("t.obj")
    odd = cage.positions + 0.2 * np.random.default_rng(1).random((8, 3))
    for name, mesh in (("t", cage), ("s", cage), ("odd", cage.with_positions(odd))):
        write_mesh(tmp_path / f"{name}.obj", mesh)
    write_mesh(tmp_path / "bare.obj", replace(cage, uvs=None, uv_indices=None))
    write_image(tmp_path / "deep.exr", np.zeros((2, 2, 3), np.float32))
    write_image(tmp_path / "i.png", np.zeros((2, 2, 3), np.uint8))
    np.savetxt(tmp_path / "two.csv", np.ones((8, 2)), delimiter=",", header="a,b", comments="")
    np.save(tmp_path / "short.npy", np.ones(7))
    numbers, names = np.array([0, 0, 0, 0, 1, 2]), ("skin", "red", "other")
    of_parts = replace(cage, face_materials=numbers, material_names=names, material_colors=np.full((3, 3), np.nan))
    write_mesh(tmp_path / "parts.obj", of_parts)
    scene = write_textured_scene(tmp_path)
    red = scene["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]
    other = {"name": "other", "pbrMetallicRoughness": {"baseColorTexture": red | {"texCoord": 1}}}
    half = [{"name": "skin"}, scene["materials"][0], other]  # images of two UV sets cannot be joined
    for name, materials in (("half", half), ("none", half[:1])):
        (tmp_path / f"{name}.gltf").write_text(json.dumps(scene | {"materials": materials}))
    sides = [f"{side} {file}" for side, file in (("-t", "t.obj"), ("-s", "s.obj")) if f" {side} " not in words]
    run.refused(f"wrap -o new.obj {' '.join(sides)} {words}", says=BEFORE_A_MATCH[words])
    assert not [file for file in tmp_path.iterdir() if file.stem in ("new", "a", "b")]


def test_a_bake_that_fails_leaves_no_mesh_without_its_images(
    run: Run, result_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*given: object) -> None:
        raise FormatError("d.exr: no room")

    monkeypatch.setattr(task, "bake_wrapped", fail)
    run.refused("wrap R -o new.obj --mhclo new.mhclo --displacement d.exr", says="no room")
    assert not list(result_folder.parent.glob("new.*"))


@pytest.mark.parametrize("count", [1, 2])
def test_warnings_of_several_frames_have_their_names(monkeypatch: pytest.MonkeyPatch, count: int) -> None:
    given: list[MatchRequest] = []

    def matched(one: MatchRequest, stages: Stages, last_frame: object, require: object) -> object:
        given.append(one)
        assert (last_frame is None) == (len(given) == 1)
        return identity_result()

    monkeypatch.setattr(task, "match_files", matched)
    monkeypatch.setattr(task, "result_warnings", lambda result: ["it folds"])
    sources, pairs = [Path(f"{number}.obj") for number in range(count)], Path("l.json")
    request = WrapRequest((), Path("o.obj"), Path("t.obj"), sources[0], pairs)
    _, warnings = task._match_sources(request, Path("t.obj"), sources, Path("R"), Stages())
    assert [one.landmarks for one in given] == [pairs, None][:count]
    assert warnings == (["it folds"] if count == 1 else ["0.obj: it folds", "1.obj: it folds"])


def test_with_a_map_nothing_is_refined(tmp_path: Path) -> None:
    for name in ("t.obj", "s.obj"):
        write_mesh(tmp_path / name, replace(cube(), scheme=Plain()))
    np.save(tmp_path / "map.npy", np.arange(8))
    request = WrapRequest(
        (), target=tmp_path / "t.obj", source=tmp_path / "s.obj", map=tmp_path / "map.npy", output=tmp_path / "new.obj"
    )
    stages = list[str]()
    with pytest.raises(ParameterError, match="expected a cage to wrap, got a plain mesh"):
        run(request, stages.append)
    assert stages == ["read"]


def test_of_blend_shapes_no_folder_is_left(
    result_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plain = replace(textured_cube("t.obj"), scheme=Plain())
    monkeypatch.setattr(task, "read_result", lambda _: identity_result(1, (plain, textured_cube("s.obj"))))
    with pytest.raises(ParameterError, match="expected a cage to wrap, got a plain mesh"):
        run(WrapRequest(results=(result_folder,), output=tmp_path / "shapes", blend_shapes=True))
    assert not (tmp_path / "shapes").exists()
