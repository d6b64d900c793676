"""A character and its bare body as files, matched once for all tests."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from cagemap.character.values import Character, Part, Rig
from cagemap.files.meshes.formats import write_mesh
from cagemap.mesh import ControlMesh
from cagemap.mesh.landmarks import Landmarks
from cagemap.tasks.bodies import Bodies, match_bodies
from cagemap.tasks.progress import Stages

from example_character import bare_body, character, write_character


@pytest.fixture(scope="session")
def body() -> ControlMesh:
    return bare_body(1)


@pytest.fixture(scope="session")
def kept() -> dict[object, Bodies]:
    """Matches of the tests before."""
    return {}


@pytest.fixture(autouse=True)
def matched_once(kept: dict[object, Bodies], monkeypatch: pytest.MonkeyPatch) -> None:
    """Two bodies that an earlier test has matched are not matched again."""

    def match_or_take(
        target: Part, source: Part, landmarks: Landmarks, stages: Stages, rig: Rig | None = None, answer: int = 0
    ) -> Bodies:
        meshes = (target.mesh, source.mesh)
        arrays = ((mesh.positions.tobytes(), mesh.face_indices.tobytes(), mesh.material_names) for mesh in meshes)
        key = (answer, landmarks.names, *landmarks.places, *arrays)
        if key not in kept:
            kept[key] = match_bodies(target, source, landmarks, stages, rig, answer)
        return replace(kept[key], given=(target, source))

    monkeypatch.setattr("cagemap.tasks.carry_character.match_bodies", match_or_take)


@pytest.fixture
def files(tmp_path: Path, body: ControlMesh, monkeypatch: pytest.MonkeyPatch) -> Character:
    """C.glb, a character, and B.glb, its bare body, where the test stands."""
    monkeypatch.chdir(tmp_path)
    made = character(body)
    write_character(Path("C.glb"), made)
    write_mesh("B.glb", body)
    return made
