"""Own parts of the body, and pieces of both bodies' meshes: which are carried, and what moves them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from examples.shapes import cube
from scipy import sparse

from cagemap.character.values import Animation, Character, Part, Rig, ShapeTrack
from cagemap.files.gltf.document import read_document, write_document
from cagemap.files.gltf.write import character_glb
from cagemap.files.meshes.formats import write_mesh
from cagemap.mesh import ControlMesh
from cagemap.mesh.faces import face_areas
from cagemap.mesh.parts import extract_faces, join_meshes
from cagemap.mesh.plain import plain_mesh
from cagemap.mesh.schemes import Plain
from cagemap.subdivision import with_options
from cagemap.tasks.bodies import Bodies
from cagemap.tasks.carry_character import _left_out_note, _set_aside, carry_character, with_shape_weights
from cagemap.tasks.compared_parts import compare_parts

from command_line import Run
from example_character import ball, bare_body
from example_rigs import body_moved
from rigged import part_named, rig_done
from usd_characters import shape_keys, with_shape_track


@pytest.mark.slow
def test_a_loose_piece_of_the_body_is_said_to_be_carried_along(run: Run, files: Character, body: ControlMesh) -> None:
    """`rig` has no --part, and leaves nothing out."""
    button = ball("button", body.positions[np.argmax(body.positions[:, 2])] + [0, 0, 0.3], 0.1)
    whole = join_meshes([replace(one, face_objects=None, object_names=()) for one in (body, button)])
    write_mesh("B.glb", replace(whole, name="body"), force=True)
    outcome = run("rig", "B.glb", "--like", "C.glb", "-o", "OUT.glb")
    assert outcome.code == 0
    assert (
        f"1 other piece ({button.n_vertices} vertices, 0.1 % of the area) not matched, but moved along" in outcome.err
    )
    assert "--part" not in outcome.err
    assert ", 1 animation\n" in outcome.out


def test_a_loose_piece_keeps_what_its_vertices_and_corners_have(body: ControlMesh) -> None:
    button = ball("button", body.positions[np.argmax(body.positions[:, 2])] + [0, 0, 0.3], 0.1)
    mesh = join_meshes([replace(one, face_objects=None, object_names=()) for one in (body, button)])
    of_corners = np.random.default_rng(0).random((len(mesh.face_indices), 4))
    of_vertices = np.random.default_rng(1).random((mesh.n_vertices, 3))
    rows, corners = slice(body.n_vertices, None), slice(len(body.face_indices), None)
    given = Part("body", mesh, None, {"open": of_vertices}, of_corners[:, :3], {"open": of_corners[:, 1:]}, of_corners)
    piece = _set_aside(Bodies((given, given), (plain_mesh(mesh),) * 2, None), 1)
    np.testing.assert_array_equal(piece.mesh.positions, mesh.positions[rows])
    np.testing.assert_array_equal(piece.shapes["open"], of_vertices[rows])
    np.testing.assert_array_equal(piece.normals, of_corners[corners, :3])
    np.testing.assert_array_equal(piece.shape_normals["open"], of_corners[corners, 1:])
    np.testing.assert_array_equal(piece.colors, of_corners[corners])


def test_own_parts_lose_the_weights_of_the_rig_that_is_replaced(body: ControlMesh) -> None:
    """The character's body has no weights; a prop moves."""
    moon, three = ball("moon", body.positions.max(axis=0), 0.1), np.tile(np.eye(4), (3, 1, 1))
    hair = Part("hair", ball("hair", np.zeros(3), 0.1), sparse.csr_array(np.tile([0.0, 0.0, 1.0], (42, 1))))
    target = Character((Part("skin", body), hair), Rig(("hips", "chest", "head"), np.array([-1, 0, 1]), three, three))
    of_moon = sparse.csr_array(np.ones((42, 1)))
    source = Character(
        (Part("body", body), Part("moon", moon, of_moon)), Rig(("moon",), np.array([-1]), *2 * [three[:1]])
    )
    made = carry_character(target, source).character
    assert made.rig.names == ("moon",)
    assert part_named(made, "hair").weights is None
    assert part_named(made, "moon").weights.shape == (42, 1)


@pytest.mark.parametrize("cornea_in_target", [False, True])
def test_parts_at_the_places_of_loose_pieces_do_not_hide_those(cornea_in_target: bool) -> None:
    """An eyeball in both meshes; a cornea, a part of one of them, is nearer to the other's eyeball than its own."""
    eyes = [Part("Object_1", ball("Object_1", np.array([x, 0.0, 0.0]), 1.0)) for x in (0.0, 0.2)]
    cornea = Part("Object_4", ball("Object_4", np.array([0.2 * cornea_in_target, 0.05, 0.0]), 1.0))
    placed, own_parts = ([], [cornea]) if cornea_in_target else ([cornea], [])
    found = compare_parts(placed, eyes[1], eyes[1], [eyes[0]], own_parts, body_moved(1.0, np.eye(3), np.zeros(3)))
    assert len(found.faces) == 0
    assert [len(parts) for parts in found.counterparts] == ([1, 1] if cornea_in_target else [2])


def test_passengers_away_from_the_body_are_named_in_one_note(body: ControlMesh) -> None:
    size = float(np.sqrt(face_areas(body).sum()))
    places = body.positions.max(axis=0) + size * np.array([[0.3, 0.0, 0.0], [2.0, 0.0, 0.0], [3.0, 0.0, 0.0]])
    names = "sword", "lamp", "other body"
    props = [Part(name, ball(name, place, 0.1)) for name, place in zip(names, places, strict=True)]
    notes = carry_character(Character((Part("body", body),)), Character((Part("body", body), *props))).notes
    assert [note for note in notes if "on the other body" in note] == [
        "far from body, in body sizes: lamp 2.0, other body 3.0. Their places on the other body are guesses; to leave "
        "them out, name others by --passengers, or export this character alone"
    ]


def test_an_own_part_away_from_the_body_is_named(body: ControlMesh) -> None:
    """A second figure in the body's file would be moved by the nearest limb of the first, without a word."""
    size = float(np.sqrt(face_areas(body).sum()))
    places = body.positions.max(axis=0), body.positions.mean(axis=0) + size * np.array([10.0, 0.0, 0.0])
    own = [Part(name, ball(name, place, 0.1)) for name, place in zip(("sword", "figure"), places, strict=True)]
    rig, weights = Rig(("hips",), np.array([-1]), *2 * [np.eye(4)[None]]), np.ones((body.n_vertices, 1))
    source = Character((Part("body", body, sparse.csr_array(weights)),), rig)
    target = Character((Part("skin", replace(body, name="B.glb")), *own))
    assert not [
        note for note in carry_character(target, Character((Part("body", body),))).notes if "body sizes" in note
    ]
    assert [note for note in carry_character(target, source).notes if "in body sizes" in note] == [
        "far from skin, in body sizes: figure 9.9. They move with it; delete those that do not belong to it from B.glb"
    ]


def test_own_eyes_in_two_unnamed_parts_stand_for_both_eyes_of_the_character() -> None:
    """Carried to a face of other proportions, half a radius away."""
    places = np.array([0.3, 0.0, 0.5]), np.array([-0.3, 0.0, 0.5])
    both = [replace(ball("eyes", place, 0.08), face_objects=None, object_names=()) for place in places]
    eyes, hat = Part("eyes", join_meshes(both)), Part("hat", ball("hat", np.array([0.0, 1.7, 0.0]), 0.6))
    own = [
        Part(f"Object_{k}", ball(f"Object_{k}", place + np.array([0.0, 0.04, 0.0]), 0.07))
        for k, place in enumerate(places)
    ]
    none = Part("pieces", extract_faces(hat.mesh, np.zeros(0, dtype=np.int64)))
    found = compare_parts([eyes, hat], none, none, [], own, body_moved(1.0, np.eye(3), np.zeros(3)))
    assert found.doubles_of_parts == [eyes]
    for part, (counterpart,) in zip(own, found.counterparts, strict=True):
        assert np.linalg.norm(counterpart.mesh.positions.mean(axis=0) - part.mesh.positions.mean(axis=0)) < 0.05


@pytest.mark.parametrize("own_part", [False, True])
def test_a_piece_that_the_body_has_itself_is_not_carried(body: ControlMesh, own_part: bool) -> None:
    """The source's button and ring, onto a body with a button, or beside a part that is a button."""
    places = body.positions[[np.argmax(body.positions[:, 2]), np.argmin(body.positions[:, 2])]]
    balls = ball("button", places[0] + [0, 0, 0.3], 0.1), ball("ring", places[1] - [0, 0, 0.3], 0.1)
    parts = []
    for name, pieces in (("B.glb", () if own_part else balls[:1]), ("C.glb", balls)):
        meshes = [replace(one, face_objects=None, object_names=()) for one in (body, *pieces)]
        mesh = replace(with_options(join_meshes(meshes), "none"), name=name)
        parts.append(Part("body", mesh, shapes={"shift": np.ones((mesh.n_vertices, 3))}))
    own = [Part("button", balls[0])] if own_part else []
    characters = Character((parts[0], *own)), Character((parts[1],))
    carried = carry_character(*characters)
    made, *_, pieces = carried.character.parts
    assert made.mesh.n_vertices == parts[0].mesh.n_vertices
    assert pieces.name == "body pieces"
    np.testing.assert_allclose(pieces.mesh.positions, balls[1].positions, atol=1e-3)
    assert len(pieces.shapes["shift"]) == balls[1].n_vertices
    n_faces = balls[0].n_faces
    assert (
        f"1 piece of C.glb ({n_faces} faces) not carried, since B.glb has its own there or of this kind"
        in carried.notes[-1]
    )
    every = carry_character(*characters, kinds={"body pieces": "rigid"})
    assert every.character.parts[-1].mesh.n_vertices == balls[0].n_vertices + balls[1].n_vertices
    assert not any("not carried" in note for note in every.notes)


def test_pieces_that_are_carried_keep_the_weights_of_their_body(run: Run, files: Character, body: ControlMesh) -> None:
    """Of blend shapes over time, as of the body itself."""
    lash = ball("lash", body.positions[np.argmax(body.positions[:, 2])] + [0, 0, 0.3], 0.1)
    mesh = replace(with_options(join_meshes([body, lash]), "none"), face_objects=None, object_names=(), name="body")
    shapes = {"blink": np.ones((mesh.n_vertices, 3))}
    rows = sparse.csr_array(np.tile([[1.0, 0.0]], (mesh.n_vertices, 1)))
    made = replace(files, parts=(Part("body", mesh, rows, shapes),))
    write_document("C.glb", character_glb(with_shape_track(made, "nod", np.array([[0.0], [1.0]]))), force=True)
    rig_done(run)
    keys = shape_keys(read_document("OUT.glb"), 0)
    assert list(keys) == [("body", "blink"), ("body pieces", "blink")]


def test_own_lashes_keep_the_weights_of_the_shapes_of_their_skin(run: Run, files: Character, body: ControlMesh) -> None:
    skin = replace(files.parts[0], shapes={"blink": np.ones((body.n_vertices, 3))})
    made = with_shape_track(replace(files, parts=(skin,)), "nod", np.array([[0.0], [1.0]]))
    write_document("C.glb", character_glb(made), force=True)
    lash = Part("lash", ball("lash", body.positions[np.argmax(body.positions[:, 2])], 0.1))
    write_document("B.glb", character_glb(Character((Part("body", body), lash))), force=True)
    rig_done(run)
    keys = shape_keys(read_document("OUT.glb"), 0)
    assert list(keys) == [("body", "blink"), ("lash", "blink")]
    given = Part("lash", lash.mesh, None, {"blink": np.ones((lash.mesh.n_vertices, 3))})
    made = with_shape_track(replace(made, parts=(skin, given)), "nod", np.array([[0.0], [1.0]]))
    write_document("C.glb", character_glb(made), force=True)
    (animation,) = rig_done(run).animations
    assert [track.part for track in animation.shape_tracks] == ["body"]  # that part is at rest in the character
    made = with_shape_track(made, "nod", np.array([[0.0], [1.0]]), "lash")
    write_document("C.glb", character_glb(made), force=True)
    (animation,) = rig_done(run).animations
    assert [track.part for track in animation.shape_tracks] == ["lash"]


def test_an_own_part_named_like_one_without_shapes_has_the_weights_of_the_part_that_gave_them() -> None:
    mesh = ball("lash", np.zeros(3), 0.1)
    track = ShapeTrack("skin", ("blink",), np.arange(2.0), np.array([[0.0], [1.0]]))
    skin = Part("skin", mesh, shapes={"blink": np.ones((mesh.n_vertices, 3))}, shape_weights={"blink": 0.5})
    source = Character((skin, Part("lash", mesh)), None, (Animation("wink", (), (track,)),))
    made = replace(source, parts=(skin, replace(skin, name="lash", shape_weights={})))
    found = with_shape_weights(made, source, {"lash": "skin"})
    assert [part.shape_weights for part in found.parts] == 2 * [{"blink": 0.5}]
    (animation,) = found.animations
    assert [one.part for one in animation.shape_tracks] == ["skin", "lash"]
    np.testing.assert_array_equal(animation.shape_tracks[1].values, track.values)


def test_own_shapes_keep_their_weights_at_rest() -> None:
    mesh = ball("skin", np.zeros(3), 0.1)
    offsets = np.ones((mesh.n_vertices, 3))
    source = Character((Part("skin", mesh, shapes={"blink": offsets}, shape_weights={"blink": 0.5, "smile": 0.25}),))
    own = Part("skin", mesh, shapes={"blink": offsets, "smile": offsets}, shape_weights={"smile": 1.0})
    found = with_shape_weights(Character((own, replace(own, name="lash"))), source, {})
    assert [part.shape_weights for part in found.parts] == [{"blink": 0.5, "smile": 1.0}, {"smile": 1.0}]


@pytest.mark.parametrize("influences", [1, None])
def test_a_piece_that_stays_moves_as_that_of_the_character(body: ControlMesh, influences: int | None) -> None:
    """Eyes in the mesh of both bodies: those of the character follow joints of their own, and not the lids."""
    place = body.positions[np.argmax(body.positions[:, 2])] + [0, 0, 0.3]
    eye = ball("eye", place, 0.1)
    meshes = [replace(one, face_objects=None, object_names=()) for one in (body, eye)]
    mesh = with_options(join_meshes(meshes), "none")
    of_eye = np.arange(mesh.n_vertices) >= body.n_vertices
    weights = np.where(of_eye[:, None], [0.0, 0.4, 0.6], [1.0, 0.0, 0.0])
    shapes = {"blink": np.where(of_eye, 0.0, 1.0)[:, None] * np.ones(3), "look": of_eye[:, None] * np.ones(3)}
    source = Part("body", replace(mesh, name="C.glb"), sparse.csr_array(weights), shapes)
    target = Part("body", replace(mesh.with_positions(2.0 * mesh.positions), name="B.glb"))
    rig = Rig(("root", "eye", "pupil"), np.array([-1, 0, 1]), *2 * [np.tile(np.eye(4), (3, 1, 1))])
    carried = carry_character(Character((target,)), Character((source,), rig), influences=influences)
    (made,) = carried.character.parts
    expected = np.where(of_eye[:, None], [0.0, 0.0, 1.0], weights) if influences else weights
    np.testing.assert_allclose(made.weights.toarray(), expected, atol=1e-6)
    for name, offsets in shapes.items():
        np.testing.assert_allclose(made.shapes[name], 2.0 * offsets, atol=1e-3)


@pytest.mark.parametrize("named", [False, True])
@pytest.mark.parametrize("as_part", [False, True])
def test_a_piece_of_the_mesh_moves_as_what_the_character_has_of_its_kind(body, named: bool, as_part: bool) -> None:
    """Eyes in the mesh of the body: the character's are a part or in its mesh, there or, of that name, beside it."""
    place = body.positions[np.argmax(body.positions[:, 2])] + [0, 0, 0.3]
    eye, other = ball("Eyes", place, 0.1), ball("Eyes", place + np.array([0.0, 0.25 * named, 0.0]), 0.1)
    bare = replace(body, name="skin", face_objects=None, object_names=())
    meshes = [with_options(join_meshes([bare, one]), "none") for one in (eye, other)]
    if not named:
        meshes = [replace(mesh, face_materials=None, material_names=(), material_colors=None) for mesh in meshes]
    shapes = [{"look": np.tile([0.0, 0.0, share], (one.n_vertices, 1))} for share, one in ((0.0, body), (0.1, other))]
    weights = [np.tile(row, (one.n_vertices, 1)) for row, one in (([1.0, 0.0], body), ([0.0, 1.0], other))]
    if as_part:
        skin = replace(with_options(body, "none"), name="C.glb")
        source = [Part("body", skin, sparse.csr_array(weights[0]))]
        source += [Part("Eyes", other, sparse.csr_array(weights[1]), shapes[1])]
    else:
        of_all = {"look": np.concatenate([one["look"] for one in shapes])}
        source = [Part("body", replace(meshes[1], name="C.glb"), sparse.csr_array(np.concatenate(weights)), of_all)]
    rig = Rig(("root", "eye"), np.array([-1, 0]), *2 * [np.tile(np.eye(4), (2, 1, 1))])
    target = Part("body", replace(meshes[0], name="B.glb"))
    carried = carry_character(Character((target,)), Character(tuple(source), rig))
    made, *others = carried.character.parts
    of_eye = made.weights.toarray()[body.n_vertices :]
    np.testing.assert_allclose(of_eye, np.tile([0.0, 1.0], (eye.n_vertices, 1)), atol=1e-6)
    np.testing.assert_allclose(made.shapes["look"][body.n_vertices :], shapes[1]["look"], atol=1e-3)
    np.testing.assert_allclose(made.shapes["look"][: body.n_vertices], 0.0, atol=1e-12)
    # Eyes of the mesh get the texture of the skin: the character's part is carried.
    assert [part.name for part in others] == (["Eyes"] if as_part else [])
    assert any(("own pieces of this kind" if others else "has its own") in note for note in carried.notes)


@pytest.mark.parametrize(("has_eyes", "in_one_part"), [(False, True), (True, True), (True, False)])
def test_an_own_eyeball_moves_as_a_whole(body: ControlMesh, has_eyes: bool, in_one_part: bool) -> None:
    """It follows the character's eye joint, or the skin around it on average; so do its iris and a ball in the mesh."""
    top = body.positions[np.argmax(body.positions[:, 1])]
    eye, button = ball("eye", top - [0, 0.4, 0], 0.2), ball("button", top - [0, 2.4, 0], 0.2)
    meshes = [replace(one, face_objects=None, object_names=()) for one in (body, button)]
    iris = ball("iris", np.zeros(3), 0.1)
    iris = iris.with_positions(iris.positions * [1.0, 1.0, 0.1] + top - [0, 0.4, 0.2])
    eyes = [Part("My eyes", eye), Part("Iris", iris)]
    if in_one_part:
        eyes = [Part("My eyes", replace(join_meshes([eye, iris]), face_objects=None, object_names=()))]
    own = Part("body", replace(with_options(join_meshes(meshes), "none"), name="B.glb")), *eyes
    height = body.positions[:, 1] - body.positions[:, 1].min()
    share = height / height.max()
    weights = sparse.csr_array(np.column_stack([1 - share, share, np.zeros(len(share))]))
    of_eye = sparse.csr_array(np.tile([[0.0, 0.0, 1.0]], (eye.n_vertices, 1)))
    parts = Part("body", replace(body, name="C.glb"), weights), *([Part("eye", eye, of_eye)] if has_eyes else [])
    rig = Rig(("root", "head", "look"), np.array([-1, 0, 1]), *2 * [np.tile(np.eye(4), (3, 1, 1))])
    made, *made_eyes = carry_character(Character(own), Character(parts, rig)).character.parts
    of_eyes = np.concatenate([part.weights.toarray() for part in made_eyes])
    for found in (of_eyes, made.weights.toarray()[body.n_vertices :]):
        np.testing.assert_allclose(np.ptp(found, axis=0), 0.0, atol=1e-12)
        np.testing.assert_allclose(found.sum(axis=1), 1.0)
    np.testing.assert_allclose(of_eyes[0, 2], float(has_eyes))


def test_own_lashes_and_teeth_get_shapes(body: ControlMesh) -> None:
    """Lashes those of the skin at their roots, as a whole; a hat those of the skin below; teeth the character's."""
    top = body.positions[np.argmax(body.positions[:, 1])]
    lash = ball("lash", np.zeros(3), 1.0)
    lash = lash.with_positions(lash.positions * [0.1, 0.5, 0.1] + top + [0.0, 0.5, 0.0])
    teeth, hat = ball("teeth", top - [0, 2, 0], 0.2), ball("hat", top - [0, -2, 0], 0.2)
    shapes = {"lift": np.where(body.positions[:, 1:] > top[1] - 0.5, 1.0, 0.0)[:, [0]] * [0.0, 0.5, 0.0]}
    bite = {"bite": np.tile([0.0, 0.0, 0.2], (teeth.n_vertices, 1))}
    own = Part("Eyelashes", lash, shapes={"mine": lash.positions}), Part("My teeth", teeth), Part("hat", hat)
    source = Part("body", replace(body, name="C.glb"), shapes=shapes), Part("teeth", teeth, shapes=bite)
    target = Part("body", replace(body, name="B.glb")), *own
    made = {part.name: part for part in carry_character(Character(target), Character(source)).character.parts}
    assert {name: list(part.shapes) for name, part in made.items()} == {
        "body": ["lift"],
        "Eyelashes": ["mine", "lift"],
        "My teeth": ["bite"],
        "hat": ["lift"],
    }
    np.testing.assert_allclose(made["Eyelashes"].shapes["lift"], np.tile([0.0, 0.5, 0.0], (42, 1)), atol=1e-3)
    np.testing.assert_allclose(made["My teeth"].shapes["bite"], bite["bite"], atol=1e-3)


def test_a_part_where_the_mesh_of_the_body_has_a_piece_is_named(body: ControlMesh) -> None:
    """Eyes of the character, carried to a body whose mesh has eyes without a name."""
    place = body.positions[np.argmax(body.positions[:, 2])] + [0, 0, 0.3]
    eye, hat = ball("eye", place, 0.1), ball("hat", -place, 0.1)
    bare = {"face_objects": None, "object_names": (), "face_materials": None, "material_names": ()}
    meshes = [replace(one, **bare, material_colors=None) for one in (body, eye)]
    target = Character((Part("body", replace(with_options(join_meshes(meshes), "none"), name="B.glb")),))
    source = Character((Part("body", replace(body, name="C.glb")), Part("eye", eye), Part("hat", hat)))
    said = (
        "eye: the mesh of B.glb has own pieces of this kind or place. To leave out the character's, name the others by"
    )
    said += " --passengers"
    assert said in carry_character(target, source).notes
    assert said not in carry_character(target, source, passengers=["eye"]).notes


def test_a_ball_in_the_mesh_keeps_its_shape(body: ControlMesh) -> None:
    """The character has none there: shapes of its body move the ball as a whole."""
    button = ball("button", body.positions[body.face_indices[:2]].mean(axis=0), 0.05)
    meshes = [replace(one, face_objects=None, object_names=()) for one in (body, button)]
    target = Part("body", replace(with_options(join_meshes(meshes), "none"), name="B.glb"))
    source = Part("body", replace(body, name="C.glb"), shapes={"grow": 0.1 * body.positions})
    (made,) = carry_character(Character((target,)), Character((source,))).character.parts
    shifts = made.shapes["grow"][body.n_vertices :]
    assert np.linalg.norm(shifts, axis=1).min() > 0.0
    np.testing.assert_allclose(np.ptp(shifts, axis=0), 0.0, atol=1e-12)


@pytest.mark.slow
def test_feet_that_are_pieces_are_not_carried_to_a_body_with_feet() -> None:
    body = bare_body(2)
    height = body.positions[:, 1]
    corners = (height < np.quantile([height.min(), height.max()], 0.15))[body.face_indices.reshape(-1, 3)]
    parts = [extract_faces(body, np.flatnonzero(faces)) for faces in (~corners.any(axis=1), corners.all(axis=1))]
    whole, cut = (
        Part("body", with_options(replace(mesh, name="C.glb"), "none")) for mesh in (body, join_meshes(parts))
    )
    carried = carry_character(Character((whole,)), Character((cut,)))
    assert [part.name for part in carried.character.parts] == ["body"]
    assert "4 pieces of C.glb" in carried.notes[-1]


def test_pieces_that_are_left_out_are_counted_without_those_that_are_kept() -> None:
    """The kept piece has a smaller number, and the others two sizes."""
    meshes = [ball("a", np.zeros(3), 0.1), cube(), ball("b", np.full(3, 9.0), 0.1)]
    bare = [
        replace(ControlMesh.from_faces(one.positions, [*map(one.face, range(one.n_faces))]), scheme=Plain())
        for one in meshes
    ]
    pieces = Part("lashes", replace(join_meshes(bare), name="C.glb"))
    bodies = Bodies((Part("t", replace(bare[0], name="B.glb")), pieces), (), None)
    text = _left_out_note(bodies, pieces, np.arange(80))
    assert text.startswith("2 pieces of C.glb (6 faces, 80 faces) not carried, since B.glb has its own"), text
