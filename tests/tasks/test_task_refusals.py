"""Commands that their files do not allow: every message says which option or file, what is wrong, and what to do."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from examples.shapes import cube, pyramid
from scipy import sparse

from cagemap.character.values import Character, Part, Rig
from cagemap.errors import ParameterError
from cagemap.files.gltf.document import write_document
from cagemap.files.gltf.write import character_glb
from cagemap.files.meshes.formats import write_mesh
from cagemap.files.result.folder import write_result
from cagemap.mesh import ControlMesh
from cagemap.tasks.face import run_face
from cagemap.tasks.import_map import _surface, run_map
from cagemap.tasks.progress import Stages
from cagemap.tasks.requests.face import FaceRequest
from cagemap.tasks.requests.import_map import MapRequest
from cagemap.tasks.requests.wrap import WrapRequest
from cagemap.tasks.wrap import run_wrap

from example_result import identity_result, textured_cube
from refusals import Refusal
from transfer_command import transfer

EVEN = "0.5,0.5"


def result(place: Path, *meshes: ControlMesh) -> Path:
    """A RESULT of two meshes, boxes if none are given."""
    write_result(place / "R", identity_result(2, (meshes[0], meshes[0]) if meshes else None), force=True)
    return place / "R"


def weights(place: Path, joints: str, *meshes: ControlMesh, **options: Any) -> None:
    """Carry weights of two joints."""
    (place / "w.csv").write_text("\n".join([joints, *[EVEN] * 8]))
    result(place, *meshes)
    transfer(place / "o.npz", weights=place / "w.csv", **options)


def masked_in_part(place: Path) -> None:
    """The mesh was one of several in a file that is gone."""
    part = replace(textured_cube("large.obj"), file_vertices=np.arange(8), file_faces=np.arange(6))
    np.save(place / "v.npy", np.ones(8))
    result(place, part)
    transfer(place / "o.npy", attribute=place / "v.npy", target_mask="red")


def on_another_base(place: Path) -> None:
    for name, columns in (("v", 2), ("b", 3)):
        np.savez(place / f"{name}.npz", heat=np.ones((8, columns)))
    (place / "R").mkdir()
    result(place)
    transfer(place / "o.npz", attribute=place / "v.npz", bases=(("", place / "b.npz"),), target_mask="red")


def map_of_level(place: Path) -> None:
    write_mesh(place / "box.obj", cube())
    np.save(place / "m.npy", np.arange(8))
    run_map(MapRequest(place / "m.npy", place / "box.obj", place / "box.obj", place / "Q", level=0), Stages())


def held_everywhere(place: Path) -> None:
    np.save(place / "w.npy", np.zeros(8))
    run_wrap(WrapRequest((result(place),), output=place / "n.obj", weights=place / "w.npy"), Stages())


def wrapped_with_holes(place: Path) -> None:
    holes = replace(textured_cube("large.obj"), hole_faces=np.array([2]))
    run_wrap(WrapRequest((result(place, holes),), output=place / "n.obj", fit_level=1), Stages())


def neck_of_a_corner(place: Path) -> None:
    """The neck moves one vertex of a box."""
    joints = np.tile(np.eye(4), (2, 1, 1))
    rig = Rig(("spine", "neck"), np.array([-1, 0]), joints, joints)
    moved = np.eye(2)[np.r_[1, [0] * 7]]
    write_document(place / "h.glb", character_glb(Character((Part("box", cube(), sparse.csr_array(moved)),), rig)))
    run_face(FaceRequest(place / "h.glb", place / "o.glb"), Stages())


UNEVEN = replace(cube(), positions=cube().positions * np.linspace(1, 2, 8)[:, None], name="bare.obj")
REFUSED = {
    "a mask of a file that is gone": Refusal(
        masked_in_part,
        "--target-mask: large.obj was matched in part ... its file is not where the match read it",
        "Put it back.",
    ),
    "a base of another shape": Refusal(
        on_another_base, "b.npz: expected heat of shape (8, 2) ... got shape (8, 3) ... Give the target's own values."
    ),
    "weights of joints without sides": Refusal(
        lambda place: weights(place, "hip,knee", mirror=True),
        "--mirror: expected joints of both sides, such as arm.L and arm.R ... got none by their names",
        "Rename them, or leave it out.",
    ),
    "weights of a mesh without a mirror plane": Refusal(
        lambda place: weights(place, "arm.L,arm.R", UNEVEN, mirror=True),
        "--mirror:  ... expected a target with a mirror plane, bare.obj has none ... Leave it out.",
    ),
    "fewer influences than one": Refusal(
        lambda place: weights(place, "hip,knee", influences=-1),
        "w.csv: influences:  ... expected at least 1 joint a vertex, got -1 ... on the command line 0, keeps all.",
    ),
    "a map of level 0": Refusal(map_of_level, "--level:  ... expected 1 or more, got 0 ... Leave it out"),
    "a wrap that is held everywhere": Refusal(
        held_everywhere, "weights:  ... expected a part of the target that follows the source ... Give weights above 0"
    ),
    "a net of a level with holes": Refusal(
        wrapped_with_holes, "large.obj:  ... has hole faces, so that only level 0 can be a net ... Give level 0."
    ),
    **{
        f"a wrap that reads no --{option}": Refusal(
            lambda place, option=option, value=value: run_wrap(
                WrapRequest((result(place),), output=place / "n.obj", **{option: value}), Stages()
            ),
            f"--{option}: expected with --",
            f"only, got none of them. Leave --{option} out.",
        )
        for option, value in {"size": 32, "rays": 3, "green": "down", "space": "object"}.items()
    },
    "a neck that moves no face": Refusal(
        neck_of_a_corner, "part 'box':  ... its neck and head joints move no whole face ... Give the head alone."
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_files_do_not_allow_is_refused(name: str, tmp_path: Path) -> None:
    REFUSED[name].check(tmp_path)
    assert not list(tmp_path.glob("[noQ]*"))


@pytest.mark.parametrize(
    ("target", "options", "says"), [("a.glb", {}, "a cage to wrap"), ("a.obj", {"colors": "c.png"}, "colours")]
)
def test_what_cannot_be_wrapped_is_refused_before_the_match(tmp_path, monkeypatch, target, options, says):
    for name in (target, "b.obj"):
        write_mesh(tmp_path / name, textured_cube(name))
    monkeypatch.setattr("cagemap.tasks.match.match_inputs", lambda *_: pytest.fail("matched first"))
    images = {name: tmp_path / file for name, file in options.items()}
    with pytest.raises(ParameterError, match=says):
        run_wrap(
            WrapRequest((), tmp_path / "o.obj", target=tmp_path / target, source=tmp_path / "b.obj", **images), Stages()
        )


def test_a_cage_of_mixed_faces_is_not_split_for_a_map() -> None:
    assert _surface(pyramid(), 1).control.n_faces == pyramid().n_faces
