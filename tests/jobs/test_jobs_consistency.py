"""A collection's own knowledge: spoiled pairs are found by the detours around them."""

from dataclasses import replace
from itertools import permutations
from pathlib import Path

import numpy as np
import pytest
from examples.shapes import torus

from cagemap.files.result.folder import write_result
from cagemap.files.result.manifest import read_manifest
from cagemap.jobs.consistency import (
    Consistency,
    _detours,
    disagreement,
    measure_consistency,
    read_consistency,
    write_consistency,
)
from cagemap.jobs.detours import add_detours, compose_maps, compose_results, has_detours
from cagemap.jobs.plan import Plan, Task
from cagemap.maps.masks import Masks
from cagemap.maps.point_map import PointMap
from cagemap.maps.result import MatchResult, SpectralMap
from cagemap.spectral import BasisConfig
from cagemap.subdivision import refine
from cagemap.surface.triangle_surface import TriangleSurface
from cagemap.tasks.run_job import run_task

from example_result import identity_result

NAMES = "abcdef"


def map_of(images: np.ndarray) -> PointMap:
    """A map of one torus onto itself that sends vertex i to vertex images[i]."""
    level = refine(torus(), 2).finest
    surface = TriangleSurface.from_faces(level.positions, level.faces)
    return PointMap.from_vertices(surface, surface, images)


def collection(spoiled: tuple[tuple[str, str], ...] = ()) -> dict[tuple[str, str], PointMap]:
    positions = refine(torus(), 2).finest.positions
    mirrored = np.argmin(((positions * [-1, 1, 1])[:, None] - positions[None]) ** 2 @ np.ones(3), axis=1)
    same = map_of(np.arange(len(positions)))
    return {pair: map_of(mirrored) if pair in spoiled else same for pair in permutations(NAMES, 2)}


def test_maps_that_agree_have_no_error() -> None:
    verdict = measure_consistency(collection())
    assert verdict.triples == 6 * 5 * 4
    assert max(verdict.errors.values()) < 1e-12
    assert verdict.doubtful == ()


def test_a_pair_with_left_and_right_exchanged_is_named_and_has_a_way_round() -> None:
    verdict = measure_consistency(collection((("c", "e"),)))
    assert verdict.doubtful == (("c", "e"),)
    way = verdict.detours["c", "e"]
    assert (way[0], way[-1], len(way)) == ("c", "e", 3)
    others = [error for pair, error in verdict.errors.items() if pair != ("c", "e")]
    assert max(others) < 0.1 * verdict.errors["c", "e"]


def test_several_spoiled_pairs_are_all_named() -> None:
    spoiled = ("a", "b"), ("d", "c"), ("f", "a")
    assert set(measure_consistency(collection(spoiled)).doubtful) == set(spoiled)


def test_disagreement_is_the_distance_between_both_ways() -> None:
    maps = collection((("a", "b"),))
    direct = maps["a", "b"]
    expected = np.linalg.norm(direct.images.positions - maps["b", "a"].images.positions, axis=1).mean()
    assert disagreement(direct, maps["a", "c"], maps["c", "b"]) == pytest.approx(expected)


def test_pairs_that_are_in_no_triple_say_nothing() -> None:
    maps = collection()
    verdict = measure_consistency({pair: maps[pair] for pair in [("a", "b"), ("c", "d")]})
    assert verdict == Consistency({}, 0, (), {})


@pytest.mark.parametrize("level", [1, 3])
def test_a_map_at_another_level_is_left_out(level: int) -> None:
    other = refine(torus(), level).finest
    surface = TriangleSurface.from_faces(other.positions, other.faces)
    maps = collection()
    maps["a", "b"] = PointMap.from_vertices(surface, surface, np.arange(surface.n))
    verdict = measure_consistency(maps)
    assert ("a", "b") not in verdict.errors
    assert len(verdict.errors) == 6 * 5 - 1
    assert max(verdict.errors.values()) < 1e-12


def test_a_verdict_is_kept_for_its_own_matches_only(tmp_path: Path) -> None:
    verdict = measure_consistency(collection((("c", "e"),)))
    path = tmp_path / "state" / "consistency.json"
    write_consistency(path, {"match": "key"}, verdict)
    assert read_consistency(path, {"match": "key"}) == verdict
    assert read_consistency(path, {"match": "other"}) is None
    kept = path.read_text()
    infinite = kept.replace(f'"triples": {verdict.triples}', '"triples": 1e999')
    for changed in ("[3", kept.replace('"key"', "{}"), infinite, "[" * 20_000):
        path.write_text(changed)
        assert read_consistency(path, {"match": "key"}) is None


def test_a_way_round_is_the_composition_of_its_maps() -> None:
    good = collection()["a", "b"]
    n = good.target.n
    shifted = PointMap.from_vertices(good.target, good.source, np.roll(np.arange(n), 1))
    twice = PointMap.from_vertices(good.target, good.source, np.roll(np.arange(n), 2))
    found = compose_maps([PointMap(good.target, shifted.images), PointMap(good.source, shifted.images)])
    assert np.abs(found.images.positions - twice.images.positions).max() < 1e-12


def test_outputs_of_a_doubtful_pair_are_made_from_the_way_round(tmp_path: Path) -> None:
    def task(kind: str, pair: tuple[str, str]) -> Task:
        folder = f"{pair[0]}__{pair[1]}"
        request = {"output": str(tmp_path / folder / "RESULT"), "result": str(tmp_path / folder / "RESULT")}
        needs = () if kind == "match" else (f"match {pair}",)
        return Task(kind, f"{kind} {pair}", f"key {kind} {pair}", needs, request, (f"{folder}/out",), pair)

    pairs = (("c", "a"), ("b", "a"), ("c", "b"))  # source, target
    plan = Plan(tmp_path, tuple(task(kind, pair) for pair in pairs for kind in ("match", "transfer")), pairs)
    assert has_detours(plan)
    changed = add_detours(plan, {("a", "c"): ("a", "b", "c")}, "1")
    compose = next(task for task in changed.tasks if task.kind == "compose")
    assert compose.pair == ("c", "a")
    assert compose.needs == ("match ('b', 'a')", "match ('c', 'b')")
    assert [Path(folder).parent.name for folder in compose.request["way"]] == ["b__a", "c__b"]
    bakes = {task.pair: task for task in changed.tasks if task.kind == "transfer"}
    assert bakes["c", "a"].request["result"] == compose.request["output"]
    assert bakes["c", "a"].needs == (compose.name,)
    assert bakes["b", "a"] == next(task for task in plan.tasks if task.kind == "transfer" and task.pair == ("b", "a"))
    order = {task.name: number for number, task in enumerate(changed.tasks)}
    assert all(order[need] < order[task.name] for task in changed.tasks for need in task.needs if need in order)
    assert not has_detours(Plan(tmp_path, (), pairs[:2]))


@pytest.mark.parametrize(("error", "found"), [(0.19, False), (0.21, True)])
def test_a_way_round_is_at_least_twice_as_good(error: float, found: bool) -> None:
    errors = {("a", "c"): error, ("a", "b"): 0.05, ("b", "c"): 0.05}
    assert _detours(errors, [("a", "c")]) == ({("a", "c"): ("a", "b", "c")} if found else {})


def test_a_composed_result_has_the_masks_and_files_of_its_ends() -> None:
    entries = {name: {"path": f"../../../{name}.obj", "sha256": name} for name in "abc"}
    steps = []
    for target, source in (("a", "b"), ("b", "c")):
        result, inputs = identity_result(), {"target": entries[target], "source": entries[source]}
        vertices = len(result.target.vertices)
        masks = Masks(np.full(vertices, 0.25), np.full(vertices, 0.5))
        steps.append(replace(result, masks=masks, provenance={**result.provenance, "inputs": inputs}))
    composed = compose_results(steps, ("a", "b", "c"))
    assert composed.manifest["inputs"] == {"target": entries["a"], "source": entries["c"]}
    np.testing.assert_array_equal(composed.masks.target, steps[0].masks.target)
    np.testing.assert_array_equal(composed.masks.source, steps[1].masks.source)


def steps_through(basis: BasisConfig, count: int = 5) -> list[MatchResult]:
    """Maps from a to b and from b to c, with a basis of b for the second that may be another one."""
    first = identity_result()
    spectral = SpectralMap(np.eye(count, 5), np.arange(float(count)), np.arange(5.0))
    return [first, replace(first, target=replace(first.target, config=basis), known_spectral=spectral)]


@pytest.mark.parametrize(
    ("basis", "count"), [(BasisConfig(count=4), 4), (BasisConfig(count=5, laplacian="alexa-wardetzky"), 5)]
)
def test_functional_maps_are_multiplied_only_over_one_basis(basis: BasisConfig, count: int) -> None:
    composed = compose_results(steps_through(basis, count), ("a", "b", "c"))
    assert composed.known_spectral is None
    known = compose_results(steps_through(BasisConfig(count=5)), ("a", "b", "c")).known_spectral
    np.testing.assert_array_equal(known.functional_map, np.eye(5))


def test_warnings_of_a_composed_map_are_shown(tmp_path: Path) -> None:
    result = identity_result()
    images = result.point_map.images
    one_point = replace(images, triangle=np.zeros_like(images.triangle))
    for name in ("ab", "bc"):
        write_result(tmp_path / name, replace(result, point_map=PointMap(result.point_map.target, one_point)))
    request = {"way": [tmp_path / "ab", tmp_path / "bc"], "names": ["a", "b", "c"], "output": str(tmp_path / "R")}
    figures = run_task(Task("compose", "compose", "k", (), request))
    assert figures["warnings"]
    assert figures["warnings"] == read_manifest(tmp_path / "R")["quality"]["warnings"]
    assert "composed of the maps" in figures["notes"][0]
