"""Wrong landmark pairs: found, named and not followed; correct ones left alone."""

from dataclasses import replace

import numpy as np
import pytest
from examples.shapes import torus, voxels

from cagemap import BasisConfig, Landmarks, MatchResult, Surface, match, prepare_surface, update_match
from cagemap.deform.config import ElasticConfig, GraphConfig, LandmarkConfig
from cagemap.deform.graph import ElasticGraph, cluster_graph
from cagemap.deform.placement import Placement
from cagemap.deform.problem import PreparedPair, Problem, level_graph
from cagemap.files.result.manifest import landmark_messages
from cagemap.maps.hypotheses.confidence import TWO
from cagemap.maps.landmarks import check
from cagemap.maps.landmarks.check import DISTANCES, SIDES, LandmarkCheck, LandmarkSuspect, large_handles
from cagemap.maps.landmarks.suspects import exchanged_sides, misplaced_pairs, orientation_agreement, place_by_distances
from cagemap.maps.pair import Pair, no_progress, point_pairs
from cagemap.maps.point_map import PointMap
from cagemap.mesh import ControlMesh
from cagemap.mesh.cage_points import CagePoints
from cagemap.mesh.mesh_report import FileVertex
from cagemap.mesh.schemes import Plain
from cagemap.mesh.topology import handle_count
from cagemap.pipeline import prepare_pair
from cagemap.subdivision import finest_mesh, refine

from example_once import example_pair
from quick_match import QUICK

LEVEL = 1  # 1700 and 2200 vertices
VERTICES = LandmarkConfig.distance_vertices


@pytest.fixture(scope="module")
def pair() -> tuple[Surface, Surface, Landmarks]:
    example = example_pair(texture_size=64)
    basis = BasisConfig(count=40)
    return (
        prepare_surface(example.target, LEVEL, basis),
        prepare_surface(example.source, LEVEL, basis),
        example.landmarks,
    )


@pytest.fixture(scope="module")
def graphs(pair: tuple[Surface, Surface, Landmarks]) -> tuple[ElasticGraph, ElasticGraph]:
    return level_graph(pair[0], LEVEL), level_graph(pair[1], LEVEL)


def measured(graph: ElasticGraph, landmarks: np.ndarray) -> np.ndarray:
    """Distances from landmarks to the vertices of a coarse graph, as `Problem.landmark_distances` has them."""
    return cluster_graph(graph, VERTICES, landmarks)[0].distances(np.arange(len(landmarks)))


def misplaced(graphs: tuple[ElasticGraph, ElasticGraph], landmarks: Landmarks) -> list[int]:
    return misplaced_pairs(measured(graphs[0], landmarks.target), measured(graphs[1], landmarks.source)).tolist()


def with_source(landmarks: Landmarks, changes: dict[int, int]) -> Landmarks:
    source = landmarks.source.copy()
    source[list(changes)] = list(changes.values())
    return replace(landmarks, source=source)


def farthest(surface: Surface, vertex: int, avoid: np.ndarray) -> int:
    positions = surface.refinement.finest.positions[: surface.control.n_vertices]
    distances = np.linalg.norm(positions - positions[vertex], axis=1)
    distances[avoid] = 0
    return int(np.argmax(distances))


def test_correct_pairs_are_left_alone(pair, graphs):
    _, _, landmarks = pair
    assert misplaced(graphs, landmarks) == []
    assert misplaced((graphs[1], graphs[0]), landmarks.reversed()) == []


def test_a_pair_on_the_wrong_limb_is_found_whichever_it_is(pair, graphs):
    _, source, landmarks = pair
    for i in range(0, len(landmarks), 4):
        wrong = with_source(landmarks, {i: farthest(source, landmarks.source[i], landmarks.source)})
        assert misplaced(graphs, wrong) == [i]


@pytest.mark.parametrize(
    ("first", "second"),
    [("nose_tip", "tail_tip"), ("hoof_front_L", "hoof_front_R"), ("knee_L", "knee_R")],
)
def test_two_exchanged_pairs_are_both_found(pair, graphs, first, second):
    _, _, landmarks = pair
    i, j = landmarks.names.index(first), landmarks.names.index(second)
    exchanged = with_source(landmarks, {i: landmarks.source[j], j: landmarks.source[i]})
    assert sorted(misplaced(graphs, exchanged)) == sorted([i, j])


FEET = ["nose_tip", "tail_tip", "chest", "poll", "hoof_front_L", "hoof_front_R", "hoof_hind_L", "hoof_hind_R"]


def among_few(landmarks: Landmarks, first: str, second: str) -> tuple[Landmarks, Landmarks]:
    """Eight pairs, and the same with two exchanged."""
    few = landmarks.without([i for i, name in enumerate(landmarks.names) if name not in FEET])
    i, j = few.names.index(first), few.names.index(second)
    return few, with_source(few, {i: few.source[j], j: few.source[i]})


def turned(graphs: tuple[ElasticGraph, ElasticGraph], landmarks: Landmarks) -> list[str]:
    vertices = landmarks.target, landmarks.source
    distances, marks = [], []
    for graph, at in zip(graphs, vertices, strict=True):
        distances.append(measured(graph, at))
        marks.append((graph.positions[at], graph.normals[at]))
    return sorted(landmarks.names[i] for i in exchanged_sides((distances[0], distances[1]), *marks) or ())


@pytest.mark.parametrize(("first", "second"), [("hoof_front_L", "hoof_front_R"), ("hoof_hind_L", "hoof_hind_R")])
def test_feet_exchanged_among_few_pairs_are_told_by_their_sense(pair, graphs, first, second):
    few, exchanged = among_few(pair[2], first, second)
    assert misplaced(graphs, exchanged) == []  # as far from everything as before
    assert turned(graphs, exchanged) == [first, second]
    assert turned(graphs, few) == []
    assert turned((graphs[1], graphs[0]), few.reversed()) == []


def test_landmarks_mirrored_as_a_whole_are_no_exchange_of_two(pair, graphs):
    few, _ = among_few(pair[2], "hoof_front_L", "hoof_front_R")
    left = [i for i, name in enumerate(few.names) if name.endswith("_L")]
    right = [few.names.index(few.names[i][:-1] + "R") for i in left]
    there = {i: few.source[j] for i, j in zip([*left, *right], [*right, *left], strict=True)}
    assert turned(graphs, with_source(few, there)) == []


def outliers(target: Surface, source: Surface, landmarks: Landmarks) -> tuple[dict[str, str], list[str]]:
    """Names of the pairs that a match leaves out with the evidence, and its notes about others."""
    problem = Problem.of_landmarks(prepare_pair(target, source, QUICK), landmarks)
    found, notes = check.landmark_outliers(problem, no_progress)
    return {landmarks.names[i]: evidence for i, evidence in found.items()}, notes


@pytest.mark.slow
def test_exchanged_feet_are_left_out_and_named(pair):
    _, exchanged = among_few(pair[2], "hoof_front_L", "hoof_front_R")
    found = match(pair[0], pair[1], exchanged, QUICK)
    assert [(suspect.name, suspect.evidence) for suspect in found.suspects] == [
        ("hoof_front_L", SIDES),
        ("hoof_front_R", SIDES),
    ]
    assert all("opposite sense" in str(suspect) for suspect in found.suspects)


def test_an_exchange_that_the_map_does_not_mind_is_kept_and_told(pair, monkeypatch):
    _, exchanged = among_few(pair[2], "hoof_front_L", "hoof_front_R")
    monkeypatch.setattr(check, "coarse_map_cost", lambda problem: 1e-4)
    left_out, notes = outliers(pair[0], pair[1], exchanged)
    assert left_out == {}
    assert "'hoof_front_L', 'hoof_front_R' seem to be exchanged" in notes[0]


@pytest.fixture(scope="module")
def bridged(pair: tuple[Surface, Surface, Landmarks]) -> Surface:
    """The target with its fore hooves grown together: a face of each is gone, and a tube of four joins what is left."""
    mesh, landmarks = pair[0].control, pair[2]
    faces = np.split(mesh.face_indices, mesh.face_offsets[1:-1])
    hooves = [landmarks.target[landmarks.names.index(f"hoof_front_{side}")] for side in "LR"]
    gone = [next(i for i, face in enumerate(faces) if len(face) == 4 and vertex in face) for vertex in hooves]
    one, other = faces[gone[0]], faces[gone[1]][::-1]
    turns = [np.roll(other, k) for k in range(4)]
    other = min(turns, key=lambda turn: np.linalg.norm(mesh.positions[one] - mesh.positions[turn], axis=1).sum())
    tube = np.column_stack([one, np.roll(one, -1), np.roll(other, -1), other])
    kept = [face for i, face in enumerate(faces) if i not in gone]
    grown = ControlMesh.from_faces(mesh.positions, [*kept, *tube], name="grown together")
    assert (handle_count(mesh), handle_count(grown)) == (0, 1)
    return prepare_surface(grown, LEVEL, BasisConfig(count=40))


def test_where_parts_have_grown_together_no_landmark_is_left_out(pair, bridged):
    _, exchanged = among_few(pair[2], "hoof_front_L", "hoof_front_R")
    left_out, notes = outliers(bridged, pair[1], exchanged)
    assert left_out == {}
    assert "'hoof_front_R'" in notes[0]
    assert "one surface has handles that the other lacks" in notes[0]


@pytest.mark.slow
def test_a_small_handle_is_none_that_parts_have_grown_together_by() -> None:

    def cube_with(*spans: int) -> ControlMesh:
        block = [(x, y, z) for x in range(24) for y in range(24) for z in range(24)]
        for y, span in enumerate(spans):  # a handle on top, over so many cubes
            ends = [(2, 5 * y + 2, 24), (2 + span, 5 * y + 2, 24)]
            block += [*ends, *((2 + x, 5 * y + 2, 25) for x in range(span + 1))]
        return voxels(block)

    for spans, large in (((), 0), ((2,), 0), ((2, 3, 2), 0), ((20,), 1), ((2, 20, 3), 1)):
        mesh = cube_with(*spans)
        assert (handle_count(mesh), large_handles(mesh, LandmarkConfig())) == (len(spans), large)


def test_cells_cut_handles_open() -> None:
    mesh = torus(8, 5)
    assert handle_count(mesh, np.arange(mesh.n_faces)) == 0
    assert handle_count(mesh, np.arange(mesh.n_faces) // 20) == 0  # two tubes
    assert handle_count(mesh, (np.arange(mesh.n_faces) == 7).astype(np.int64)) == 1  # a torus with a hole, and a face
    assert handle_count(mesh, np.zeros(mesh.n_faces, dtype=np.int64)) == 1


def test_fewer_than_six_pairs_are_not_judged(pair, graphs):
    _, source, landmarks = pair
    five = landmarks.without(range(5, len(landmarks)))
    assert misplaced(graphs, with_source(five, {2: farthest(source, five.source[2], five.source)})) == []


def test_a_place_by_distances_does_not_ask_the_given_place(pair, graphs):
    _, source, landmarks = pair
    target = measured(graphs[0], landmarks.target)
    everywhere = np.arange(len(landmarks))
    wrong = with_source(landmarks, {3: farthest(source, landmarks.source[3], landmarks.source)})
    found = []
    for given in (landmarks, wrong):
        _, node, _ = place_by_distances(target, measured(graphs[1], given.source), everywhere)
        found.append(cluster_graph(graphs[1], VERTICES, given.source)[0].positions[node[3]])
    assert np.linalg.norm(found[0] - found[1]) < 0.1  # two spacings of the coarse graph, whose cells differ
    assert np.linalg.norm(found[0] - graphs[1].positions[wrong.source[3]]) > 0.5


def test_mirrored_landmarks_turn_the_other_way_round(pair, graphs):
    _, _, landmarks = pair
    target, source = (
        (graph.positions[vertices], graph.normals[vertices])
        for graph, vertices in zip(graphs, (landmarks.target, landmarks.source), strict=True)
    )
    mirror = np.array([-1.0, 1.0, 1.0])
    assert orientation_agreement(target, source) > 0.4
    assert orientation_agreement(target, (source[0] * mirror, source[1] * mirror)) < -0.4


def test_landmarks_that_seem_mirrored_have_two_answers_unless_they_cost_nothing(pair, followed, monkeypatch):
    target, source, landmarks = pair
    prepared = prepare_pair(target, source, QUICK)
    points = Pair(target, source, point_pairs(target, source, landmarks))
    near = np.asarray(followed.point_map.images.positions[: prepared.mesh.n])
    other = Placement(near * [-1.0, 1.0, 1.0], 3e-4, name="another")
    monkeypatch.setattr(check, "search_placements", lambda problem, progress: (other,))
    monkeypatch.setattr(check, "orientation_agreement", lambda *given: -1.0)
    problem = Problem(prepared, points.landmarks)
    known = LandmarkCheck(notes=("another note",))
    dear, cheap = Placement(near, 9e-4), Placement(near, 3.1e-4)
    doubt, kept = check.check_mirrored(problem, dear, (), known, no_progress)
    assert doubt.verdict == TWO
    assert kept.notes == ("another note", check.MIRRORED)
    assert [reading.cost for reading in doubt.answers] == [dear.cost, other.cost]
    assert doubt.signs == {"cost": 1e4 * dear.cost, "turned": 0.0, "runner_up": dear.cost / other.cost}
    none, kept = check.check_mirrored(problem, cheap, (), known, no_progress)
    assert none is None
    assert kept is known


@pytest.mark.slow
def test_a_pair_that_strains_is_kept_and_named(pair):
    """A landmark slid along a limb says what shape alone cannot: it is met, and the strain is told."""
    target, source, landmarks = pair
    places = source.operators.scale * source.refinement.finest.positions[: source.control.n_vertices]
    i = landmarks.names.index("knee_L")
    away = np.linalg.norm(places - places[landmarks.source[i]], axis=1)
    away[landmarks.source] = 0.0
    slid = with_source(landmarks, {i: int(np.flatnonzero(away > 0.12)[np.argmin(away[away > 0.12])])})
    found = match(target, source, slid, QUICK)
    assert found.suspects == ()
    assert found.quality.landmark_errors.max() < 1e-12
    assert len(found.landmark_check.strains) == len(landmarks)
    assert int(np.argmax(found.landmark_check.strains)) == i
    assert any("knee_L" in note and "kept" in note for note in found.landmark_check.notes)


def test_strain_is_measured_on_clusters_of_the_users_graph(pair):
    surface, _, landmarks = pair
    moved = landmarks.target.copy()
    moved[3] = np.flatnonzero(np.isin(np.arange(surface.control.n_vertices), landmarks.target, invert=True))[0]
    found = PointMap.from_vertices(*[surface.finest_triangles] * 2, np.arange(len(surface.vertices)))
    strains = []
    for graph in (GraphConfig(), GraphConfig(joining_rounds=0)):
        prepared = PreparedPair.build(surface, surface, elastic=ElasticConfig(graph=graph))
        problem = Problem.of_landmarks(prepared, Landmarks(landmarks.names, landmarks.target, moved))
        strains.append(check.check_on_map(problem, found, {}, ()).strains)
    assert not np.allclose(*strains)


@pytest.mark.slow
def test_a_suspect_of_a_plain_mesh_names_the_vertex_that_was_given(monkeypatch) -> None:
    """Most vertices of a plain mesh are on no coarse level; steps of the search use others near them."""
    monkeypatch.setattr("cagemap.maps.pair.NEAR_VERTICES", 1000)  # so that a small mesh has a coarser level for them
    mesh = replace(finest_mesh(refine(torus(14, 10), 2)), scheme=Plain())
    surface = prepare_surface(mesh, 0, BasisConfig(count=40))
    given = np.flatnonzero(surface.hierarchy.on_level(0, np.arange(mesh.n_vertices)) < 0)[::40]
    names = tuple(f"point {vertex}" for vertex in given)
    problem = Problem.of_landmarks(prepare_pair(surface, surface), Landmarks(names, given, given))
    found = PointMap.from_vertices(surface.finest_triangles, surface.finest_triangles, np.arange(mesh.n_vertices))
    (suspect,) = check.check_on_map(problem, found, {2: DISTANCES}, ()).suspects
    said = mesh.file_vertex(given[2])
    assert (suspect.name, suspect.source_vertex, suspect.nearest_vertex) == (names[2], said, said)


def test_a_suspect_between_vertices_of_a_cage_names_the_nearest_control_vertex(pair) -> None:
    surface, _, landmarks = pair
    control = surface.control
    points = CagePoints.of_vertices(landmarks.target)
    corners = control.face_indices[control.face_offsets[5] :][:3]
    points.corners[2], points.weights[2] = corners, [0.5, 0.3, 0.2]
    between = Landmarks.of_points(landmarks.names, points, points, control.name, control.name)
    problem = Problem.of_landmarks(prepare_pair(surface, surface), between)
    found = PointMap.from_vertices(*[surface.finest_triangles] * 2, np.arange(len(surface.vertices)))
    (suspect,) = check.check_on_map(problem, found, {2: DISTANCES}, ()).suspects
    assert suspect.source_vertex.number in corners
    assert suspect.source_vertex == suspect.nearest_vertex == control.file_vertex(suspect.source_vertex.number)


def test_pairs_out_of_proportion_are_kept_where_the_map_is_no_better_without(pair, monkeypatch):
    target, source, landmarks = pair
    wrong = with_source(landmarks, {3: farthest(source, landmarks.source[3], landmarks.source)})
    costs = iter((1.1e-4, 1e-4))  # with all, without the suspected: correct ears of a walking fox had this ratio
    monkeypatch.setattr(check, "coarse_map_cost", lambda problem: next(costs))
    left_out, notes = outliers(target, source, wrong)
    assert left_out == {}
    assert wrong.names[3] in notes[0]


@pytest.fixture(scope="module")
def followed(pair) -> MatchResult:
    return match(*pair, QUICK)


@pytest.fixture(scope="module")
def misled(pair) -> tuple[int, Landmarks, MatchResult]:
    target, source, landmarks = pair
    wrong = with_source(landmarks, {3: farthest(source, landmarks.source[3], landmarks.source)})
    return 3, wrong, match(target, source, wrong, QUICK)


def test_correct_pairs_are_all_met(followed):
    assert followed.suspects == ()
    assert followed.quality.landmark_errors.max() < 1e-12
    assert landmark_messages(followed.manifest) == []


def test_a_wrong_pair_is_named_and_not_followed(pair, followed, misled):
    number, wrong, found = misled
    _, source, landmarks = pair
    assert [suspect.name for suspect in found.suspects] == [wrong.names[number]]
    suspect = found.suspects[0]
    assert suspect.evidence == DISTANCES
    assert suspect.source_vertex == source.control.file_vertex(wrong.source[number])
    assert f"away from source vertex {suspect.source_vertex}, to near vertex {suspect.nearest_vertex}" in str(suspect)
    # The map sends the landmark to about where it belongs, and is nearly the map of the correct pairs.
    places = source.operators.scale * source.refinement.finest.positions
    assert np.linalg.norm(places[suspect.nearest_vertex.number] - places[landmarks.source[number]]) < 0.15
    assert suspect.distance > 0.5
    assert found.trusted.names == tuple(np.delete(np.array(wrong.names, dtype=object), number))
    assert found.quality.landmark_errors.max() < 1e-12
    images = [result.point_map.pull_back(places) for result in (followed, found)]
    assert np.linalg.norm(images[0] - images[1], axis=1).mean() < 0.03


def test_the_result_tells_of_it(misled):
    number, wrong, found = misled
    assert len(found.landmark_errors) == len(wrong)
    assert found.landmark_errors[number] == found.suspects[0].distance
    (message,) = landmark_messages(found.manifest)
    assert wrong.names[number] in message
    assert "`check_landmarks=False`" in message


@pytest.mark.slow
def test_trusted_landmarks_are_met_even_if_wrong(pair, misled):
    _, wrong, _ = misled
    found = match(pair[0], pair[1], wrong, replace(QUICK, check_landmarks=False))
    assert found.suspects == ()
    assert found.quality.landmark_errors.max() < 1e-12


def test_few_pairs_are_said_not_to_be_checked(pair):
    left_out, notes = outliers(pair[0], pair[1], pair[2].without(range(5, len(pair[2]))))
    assert left_out == {}
    assert "too few" in notes[0]


def test_shuffled_pairs_are_kept_and_noted(pair):
    shuffled = replace(pair[2], source=np.random.default_rng(33).permutation(pair[2].source))
    left_out, notes = outliers(pair[0], pair[1], shuffled)
    assert left_out == {}
    assert "contradict" in notes[0]


@pytest.mark.slow
def test_landmarks_of_another_mesh_are_asked_about(pair):
    target, source, landmarks = pair
    # The same numbers on a mesh whose vertices are numbered otherwise, as the landmarks of another cage are.
    count = target.control.n_vertices
    moved = (landmarks.target + count // 3) % count
    foreign = Landmarks(landmarks.names, moved, landmarks.source, "another", landmarks.source_name)
    result = match(target, source, foreign, QUICK)
    assert result.quality.flipped_area > 0.05
    warning = result.quality.match_warnings[-1]
    assert warning in result.quality.warnings
    assert warning.startswith("are these landmarks of these meshes?")
    assert f"{100 * result.quality.flipped_area:.0f} % of the target is folded over" in warning


@pytest.mark.parametrize(
    ("folded", "count", "asked"), [(0.2, 23, True), (0.02, 23, False), (0.2, 0, False), (0.9, 9, False)]
)
def test_the_question_whose_landmarks_these_are_is_asked_of_maps_that_fold(folded, count, asked):
    warnings = check.foreign_warnings(folded, count, 2)
    assert bool(warnings) == asked
    if asked:
        assert "20 % of the target is folded over and 2 of 23 landmarks were left out" in warnings[0]


def test_a_suspect_stays_out_only_while_its_pair_is_the_same() -> None:
    names = ("a", "b", "c")
    before = Landmarks(names, np.array([3, 5, 9]), np.array([1, 2, 4]), "t.obj", "s.obj")
    suspect = LandmarkSuspect(
        "b", 1, 0.2, nearest_vertex=FileVertex(7), source_vertex=FileVertex(2), evidence=DISTANCES
    )
    judged = LandmarkCheck((suspect,), strains=np.array([0.3, 0.0, 0.1]))
    moved_up = Landmarks(("b", "d", "c"), np.array([5, 3, 9]), np.array([2, 1, 6]), "t.obj", "s.obj")
    assert [s.pair for s in judged.for_changed(before, moved_up).suspects] == [0]
    # Strains go with their pairs, whatever these are called; what moved has none.
    np.testing.assert_array_equal(judged.for_changed(before, moved_up).strains, [0.0, 0.3, 0.0])
    corrected = Landmarks(names, np.array([3, 5, 9]), np.array([1, 7, 4]), "t.obj", "s.obj")
    assert judged.for_changed(before, corrected).suspects == ()


def test_notes_on_pairs_that_changed_and_on_all_pairs_are_dropped() -> None:
    before = Landmarks(("a", "b", "c"), np.array([3, 5, 9]), np.array([1, 2, 4]))
    strain, kept = "landmark 'b' strains the map around it", "the distances of 'a', 'c' to the other landmarks differ"
    judged = LandmarkCheck(notes=(check.TOO_FEW, check.CONTRADICTION, strain, kept, check.MIRRORED))
    assert judged.for_changed(before, before).notes == judged.notes
    moved = Landmarks(("a", "b", "c"), np.array([3, 6, 9]), np.array([1, 2, 4]))
    assert judged.for_changed(before, moved).notes == (kept,)
    assert judged.for_changed(before, before.without([0])).notes == (strain,)
    added = before.joined_with(Landmarks(("d",), np.array([8]), np.array([8])))
    assert judged.for_changed(before, added).notes == (strain, kept)


@pytest.mark.slow
def test_an_update_checks_the_pairs_that_changed_and_keeps_what_was_known(pair, followed):
    _, source, landmarks = pair
    before = replace(followed, landmark_check=LandmarkCheck(notes=("a note", check.CONTRADICTION)))
    wrong = with_source(landmarks, {3: farthest(source, landmarks.source[3], landmarks.source)})
    updated = update_match(before, wrong, QUICK)
    assert [suspect.pair for suspect in updated.suspects] == [3]
    assert updated.landmark_check.notes == ("a note",)
    trusting = update_match(before, wrong, replace(QUICK, check_landmarks=False))
    assert trusting.suspects == ()


@pytest.mark.parametrize("count", [4, 12])
def test_an_update_notes_that_pairs_are_too_few_or_contradict_each_other(pair, followed, count: int) -> None:
    target, source, landmarks = pair
    shuffled = replace(landmarks, source=np.random.default_rng(33).permutation(landmarks.source))
    problem = Problem.of_landmarks(prepare_pair(target, source, QUICK), shuffled.without(range(count, len(landmarks))))
    judged = check.check_changes(problem, np.zeros(0, dtype=np.int64), LandmarkCheck(), followed.point_map)
    assert judged.notes == (check.TOO_FEW if count < 6 else check.CONTRADICTION,)
    assert check.landmark_outliers(problem, no_progress) == ({}, list(judged.notes))
