"""Both models posed before any bake: as `cagemap rig` poses them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree
from test_studio_models import attributes_of

from cagemap.character.poses import pose_at
from cagemap.character.values import skinned_positions
from cagemap.errors import ParameterError
from cagemap.files.meshes.formats import write_mesh
from cagemap.mesh import ControlMesh
from cagemap.studio.compute import FindMap, PairFiles, ShowPosed, run_task
from cagemap.studio.landmarks import LandmarkList

from example_character import bare_body, character, write_character
from refusals import refuses

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def body() -> ControlMesh:
    return bare_body(1)


def test_the_target_moves_as_the_source_does(tmp_path: Path, body: ControlMesh) -> None:
    made = character(body)
    write_character(tmp_path / "C.glb", made)
    write_mesh(tmp_path / "B.glb", body)
    pair_files = PairFiles(tmp_path / "B.glb", tmp_path / "C.glb", None, 300, tmp_path, parts=(None, "object:body"))
    cache, found = run_task(None, FindMap(pair_files, LandmarkList()), lambda _: None)
    assert found.map_state.poses == tuple(f"nod, {time:.2g} s" for time in (0.25, 0.5, 0.75))

    def drawn(pose: str) -> list[np.ndarray]:
        task = ShowPosed(pair_files, pose, found.preview_map)
        _, skins = run_task(cache, task, lambda _: None)
        assert isinstance(skins, tuple)
        return [attributes_of(skin, "model")["POSITION"] for skin in skins]

    rest, nodding = drawn(""), drawn("nod, 0.5 s")
    for still, moved in zip(rest, nodding, strict=True):
        assert np.abs(still - moved).max() > 0.02
    assert cKDTree(nodding[0]).query(nodding[1])[0].max() < 2e-3  # one body, so that both are one picture
    wanted = skinned_positions(made.parts[0], made.rig, pose_at(made.rig, made.animations[0], 0.5))
    size = np.linalg.norm(np.ptp(wanted, axis=0)) / 2
    np.testing.assert_allclose(np.ptp(nodding[0], axis=0), np.ptp(wanted, axis=0) / size, atol=5e-3)
    with pytest.raises(ParameterError, match="Pose: expected a pose of the source"):
        run_task(cache, ShowPosed(pair_files, "wave, 1 s", found.preview_map), lambda _: None)
    refuses(ParameterError, "Pose: expected", run_task, None, ShowPosed(pair_files, "nod, 0.5 s", None), lambda _: None)


def test_poses_after_a_cancelled_match_are_those_of_the_map_on_the_page(tmp_path, body, quick_fit):
    """Cancel kills the process, so that the next one has neither the map nor the rotation of the source."""
    turned = body.with_positions(body.positions @ np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]))
    write_character(tmp_path / "C.glb", character(body))
    write_mesh(tmp_path / "B.glb", turned)
    pair_files = PairFiles(tmp_path / "B.glb", tmp_path / "C.glb", None, 300, tmp_path, parts=(None, "object:body"))
    cache, found = run_task(None, FindMap(pair_files, LandmarkList()), lambda _: None)
    for pose in ("", "nod, 0.5 s"):
        task = ShowPosed(pair_files, pose, found.preview_map)
        kept, again = (run_task(cached, task, lambda _: None)[1] for cached in (cache, None))
        assert isinstance(kept, tuple)
        assert isinstance(again, tuple)
        for one, other in zip(kept, again, strict=True):
            attributes = attributes_of(one, "model")
            assert set(attributes) == set(attributes_of(other, "model"))
            for name, values in attributes.items():
                np.testing.assert_allclose(attributes_of(other, "model")[name], values, atol=1e-6)
    assert "_PLACE" in attributes_of(again[0], "model")


def test_other_files_have_no_poses(tmp_path: Path, body: ControlMesh) -> None:
    for name in ("B.obj", "S.obj"):
        write_mesh(tmp_path / name, body)
    pair_files = PairFiles(tmp_path / "B.obj", tmp_path / "S.obj", None, 300, tmp_path)
    _, found = run_task(None, FindMap(pair_files, LandmarkList()), lambda _: None)
    assert found.map_state.poses == ()
