"""Frames of a moving source: each map starts from the last one's."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples.shapes import torus

from cagemap import pipeline
from cagemap.deform.config import RefitConfig
from cagemap.deform.problem import PreparedPair
from cagemap.errors import CagemapError, FormatError, ParameterError
from cagemap.files.meshes.formats import read_mesh, write_mesh
from cagemap.maps.masks import Masks
from cagemap.maps.point_map import PointMap
from cagemap.maps.quality import measure_quality
from cagemap.mesh import ControlMesh
from cagemap.mesh.landmarks import Landmarks
from cagemap.pipeline import MatchConfig, MatchResult, match_next, match_pair, prepare_pair, prepare_surface
from cagemap.spectral.surface import prepare_checked
from cagemap.tasks.progress import Stages
from cagemap.tasks.requests.wrap import WrapRequest
from cagemap.tasks.wrap import run_wrap

from plain_meshes import renumbered
from quick_match import QUICK

LEVEL = 1
ANGLES = (0.0, 0.1, 0.2)


def moved(positions: np.ndarray, angle: float) -> np.ndarray:
    """Points of a dented body, twisted about x."""
    x, y, z = positions.T
    y = y * (1 + 0.3 * np.sin(x))
    cosine, sine = np.cos(angle * x), np.sin(angle * x)
    return np.column_stack([x, cosine * y - sine * z, sine * y + cosine * z])


def frame(angle: float, seed: int) -> tuple[ControlMesh, np.ndarray]:
    """A frame with its vertices in another order, and the number of each vertex of the body in it."""
    body = torus(12, 8)
    return renumbered(replace(body.with_positions(moved(body.positions, angle)), name=f"frame{seed}.obj"), seed)


def error(result: MatchResult, number: np.ndarray) -> float:
    """Mean distance between the images of the cage's vertices and their true ones, of sqrt(area)."""
    source = result.source
    images = result.image()[: len(number)] - source.refinement.finest.positions[number]
    return float(np.linalg.norm(images, axis=1).mean()) * source.scale


@pytest.mark.slow
def test_the_map_follows_a_motion_and_returns() -> None:
    frames = [frame(angle, seed) for seed, angle in enumerate(ANGLES)]
    surfaces = [prepare_surface(mesh, LEVEL) for mesh, _ in frames]
    target = prepare_surface(torus(12, 8).with_positions(moved(torus(12, 8).positions, 0.0)), LEVEL)
    first = result = match_pair(prepare_pair(target, surfaces[0]))
    assert error(first, frames[0][1]) < 1e-6
    for place in (1, 2):
        result = match_next(result, surfaces[place])
        assert error(result, frames[place][1]) < 0.02
    assert result.quality.flipped_area < 0.001
    for place in (1, 0):
        result = match_next(result, surfaces[place])
    assert error(result, frames[0][1]) < 0.02


@pytest.mark.slow
def test_landmarks_of_a_frame_are_held() -> None:
    (still, _), (mesh, number) = frame(0.0, 0), frame(0.1, 1)
    target = prepare_surface(torus(12, 8).with_positions(moved(torus(12, 8).positions, 0.0)), LEVEL)
    before = match_pair(prepare_pair(target, prepare_surface(still, LEVEL)))
    result = match_next(before, prepare_surface(mesh, LEVEL), np.array([[3, number[3]], [40, number[40]]]))
    assert result.landmark_errors.max() < 1e-6


@pytest.mark.slow
def test_a_map_that_folds_is_matched_afresh(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(RefitConfig, "RANGES", {"max_folded_frame": (-1.0, 1.0)})
    config = replace(QUICK, elastic=replace(QUICK.elastic, refit=RefitConfig(max_folded_frame=-1.0)))
    still, moving = (prepare_surface(frame(angle, seed)[0], LEVEL) for seed, angle in enumerate(ANGLES[:2]))
    before, asked = match_pair(prepare_pair(still, still)), list[object]()

    def matched(prepared: PreparedPair, landmarks: Landmarks, config: MatchConfig, **progress: object) -> MatchResult:
        asked.extend((prepared.target, prepared.source, len(landmarks), config))
        return before

    monkeypatch.setattr(pipeline, "match_pair", matched)
    assert match_next(before, moving, config=config) is before
    assert asked == [still, moving, 0, config]


def test_the_next_frame_has_the_target_s_mask_and_the_method_elastic() -> None:
    surface = prepare_surface(torus(12, 8), LEVEL)
    mask = (surface.vertices[:, 0] > 0).astype(float)
    config = replace(QUICK, masks=Masks(mask))
    finest = surface.finest_triangles
    point_map = PointMap.from_vertices(finest, finest, np.arange(finest.n))
    quality = measure_quality(point_map)
    before = MatchResult(surface, surface, Landmarks.none(), point_map, quality, masks=config.masks)
    np.testing.assert_array_equal(match_next(before, surface, config=QUICK).masks.target, mask)
    other = replace(QUICK, masks=Masks(1.0 - mask))
    np.testing.assert_array_equal(match_next(before, surface, config=other).masks.target, 1.0 - mask)
    with pytest.raises(ParameterError, match="match_next: expected the method elastic"):
        match_next(before, surface, config=MatchConfig(method="hfm"))


def test_a_frame_is_not_overwritten_by_its_wrap(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cagemap.tasks.wrap.match_files", lambda *_, **__: pytest.fail("was matched"))
    cage, moving = tmp_path / "cage.obj", tmp_path / "frame.obj"
    for path in (cage, moving):
        write_mesh(path, torus(12, 8))
    with pytest.raises(FormatError, match=r"frame\.obj"):
        run_wrap(WrapRequest((moving,), moving, target=cage, force=True), Stages())


@pytest.mark.slow
def test_wrap_writes_the_cage_in_the_shape_of_every_frame(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cagemap.tasks.method.DEFAULT_VERTICES", 1000)
    cage, output = tmp_path / "cage.obj", tmp_path / "shapes"
    body = torus(12, 8)
    write_mesh(cage, body.with_positions(moved(body.positions, 0.0)))
    frames = tuple(tmp_path / f"frame{seed}.obj" for seed in range(2))
    for seed, path in enumerate(frames):
        write_mesh(path, frame(ANGLES[seed], seed)[0])
    with pytest.raises(ParameterError, match="--blend-shapes"):
        run_wrap(WrapRequest(frames, tmp_path / "one.obj", target=cage), Stages())
    with pytest.raises(ParameterError, match="frames of a motion"):
        run_wrap(WrapRequest(frames, output, target=cage, source=frames[0], blend_shapes=True), Stages())
    with pytest.raises(ParameterError, match="got several frames"):
        run_wrap(WrapRequest(frames, output, target=cage, map=tmp_path / "m.npz", blend_shapes=True), Stages())
    (tmp_path / "again").mkdir()
    write_mesh(tmp_path / "again" / "frame0.obj", frame(ANGLES[0], 0)[0])
    again = (*frames, tmp_path / "again" / "frame0.obj")
    with monkeypatch.context() as no_work:
        no_work.delattr("cagemap.tasks.wrap.match_files")
        with pytest.raises(ParameterError, match="different names"):
            run_wrap(WrapRequest(again, output, target=cage, blend_shapes=True), Stages())
        write_mesh(tmp_path / "again" / "cage.obj", body)
        for target, taken, found in (
            ("again/cage.obj", "again", "is an input too"),
            ("cage.obj", "old.obj", "a folder"),
        ):
            write_mesh(tmp_path / "old.obj", body)
            with pytest.raises(CagemapError, match=found):
                run_wrap(WrapRequest(frames, tmp_path / taken, target=tmp_path / target, blend_shapes=True), Stages())
    stages, notes, prepared = Stages(), list[str](), list[str]()
    monkeypatch.setattr(stages, "note", notes.append)
    monkeypatch.setattr(
        "cagemap.tasks.match.prepare_checked",
        lambda mesh, *options: prepared.append(mesh.name) or prepare_checked(mesh, *options),
    )
    run_wrap(WrapRequest(frames, output, target=cage, blend_shapes=True), stages)
    assert sorted(prepared) == ["cage.obj", "frame0.obj", "frame1.obj"]  # the target once
    assert [note.partition(": ")[0] for note in notes] == ["frame 1 of 2, frame0.obj", "frame 2 of 2, frame1.obj"]
    assert "follows the last frame" in notes[1]
    written = read_mesh(output / "frame1.obj")
    assert np.abs(written.positions - moved(body.positions, ANGLES[1])).mean() < 0.03
