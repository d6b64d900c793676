"""Parts: found by name, taken out whole, paired, matched one by one and stored as one result."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples.shapes import creature, cube, grid, icosahedron, poles, pyramid, torus, triangulated

from cagemap.character.values import Character, Part
from cagemap.errors import InvalidMeshError, ParameterError
from cagemap.files.gltf.document import write_document
from cagemap.files.gltf.write import character_glb
from cagemap.files.images.image import read_image, write_image
from cagemap.files.landmarks.pairs import write_landmarks
from cagemap.files.meshes.formats import write_mesh
from cagemap.files.meshes.obj_write import write_obj
from cagemap.files.result.folder import read_result
from cagemap.files.result.merged_parts import part_numbers
from cagemap.mesh import CatmullClark, ControlMesh, Loop
from cagemap.mesh.cage_points import CagePoints
from cagemap.mesh.landmarks import Landmarks
from cagemap.mesh.parts import connected_parts, extract_faces, find_part, join_meshes, list_parts
from cagemap.studio.models import open_model
from cagemap.subdivision import refine, with_options
from cagemap.tasks import mesh_commands
from cagemap.tasks.import_map import run_map
from cagemap.tasks.match import MatchRequest, matched_levels, read_inputs, run_match
from cagemap.tasks.match_parts import material_pieces, pair_parts, requested_parts, select_parts
from cagemap.tasks.mesh_commands import run_check
from cagemap.tasks.method import side_levels
from cagemap.tasks.progress import Stages
from cagemap.tasks.requests.import_map import MapRequest
from cagemap.tasks.requests.mesh_commands import CheckRequest
from cagemap.tasks.requests.transfer import TransferRequest
from cagemap.tasks.transfer import run_transfer

from plain_meshes import marks_at, named
from refusals import refuses


def _named(mesh: ControlMesh, name: str, shift: float = 0.0) -> ControlMesh:
    return named(mesh.with_positions(mesh.positions + np.array([shift, 0, 0])), name)


def _scene() -> ControlMesh:
    """A body and two eyes; the body's lower half is of another material, one eye is creased."""
    body = _named(cube(), "body")
    body = replace(body, face_materials=np.array([0, 0, 0, 1, 1, 1]), material_names=("skin", "cloth"))
    eye = _named(icosahedron(), "eye_left", 5).with_corners([3], 2)
    other = _named(icosahedron(), "eye_right", -5)
    other = other.with_creases([other.face(4)[:2]], 1.5)
    return join_meshes([body, eye, other])


def test_parts_are_listed_once_with_their_sizes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    parts = {part.title: len(part.faces) for part in list_parts(_scene())}
    assert parts == {
        "object:body": 6,
        "object:eye_left": 20,
        "object:eye_right": 20,
        "material:skin": 3,
        "material:cloth": 3,
        "component:body": 6,
        "component:eye_left": 20,
        "component:eye_right": 20,
    }
    write_obj(tmp_path / "scene.obj", _scene())
    listed = list[str]()
    monkeypatch.setattr(mesh_commands, "list_parts", lambda mesh: (listed.append(mesh.name), list_parts(mesh))[1])
    text, sound = run_check(CheckRequest((tmp_path / "scene.obj",)), Stages())
    assert not sound
    assert listed == ["scene.obj"]
    assert "`find_part`" in text
    assert "object:eye_right     20 faces" in text


def test_parts_are_found_by_name() -> None:
    scene = _scene()
    np.testing.assert_array_equal(find_part(scene, "eye_left").faces, np.arange(6, 26))
    np.testing.assert_array_equal(find_part(scene, "material:cloth").faces, [3, 4, 5])
    assert len(find_part(scene, "largest").faces) == 20
    refuses(ParameterError, "there is none\\. It has object:body", find_part, scene, "nose")
    both = replace(scene, group_names=("body", "rest"), face_groups=np.repeat([1, 0], [6, 40]))
    refuses(ParameterError, "object:body, group:body", find_part, both, "body")
    paths = replace(scene, object_names=("/hero/body", "/hero/eye_left", "/hero/eye_right"))
    for name in ("eye_right", "hero/eye_right"):
        assert find_part(paths, name).name == "/hero/eye_right"


@pytest.mark.parametrize(("scale", "faces"), [(1.0, 20), (9.0, 12)])
def test_the_largest_part_has_most_area_among_those_of_about_as_many_faces(scale: float, faces: int) -> None:
    """A spider's body has fewer faces than a leg; the ground has the largest area and a single face."""
    body = triangulated(cube())
    body = body.with_positions(scale * body.positions)
    ground = ControlMesh.from_faces([[-99, 0, -99], [-99, 0, 99], [99, 0, 99], [99, 0, -99]], [[0, 1, 2, 3]])
    assert len(find_part(join_meshes([ground, icosahedron(), body]), "largest").faces) == faces


@pytest.mark.parametrize(
    ("body", "clothes", "scheme", "faces"),
    [
        ("man-male1591", "man-jeans01", "catmull-clark", 20),
        ("/man/body", "/man/Shirt", "catmull-clark", 20),
        ("teapot", "lid", "catmull-clark", 12),
        ("eyes", "jeans", "catmull-clark", 12),
        ("body", "jeans", "none", 20),
        ("body", "Brown", "none", 12),
    ],
)
@pytest.mark.parametrize("kind", ["object", "group", "material"])
def test_the_largest_part_is_not_named_like_clothes(kind, body, clothes, scheme, faces):
    large = triangulated(cube())
    scene = join_meshes([icosahedron(), large.with_positions(2 * large.positions)])
    labels = {f"face_{kind}s": np.repeat([0, 1], [20, 12]), f"{kind}_names": (body, clothes)}
    assert len(find_part(with_options(replace(scene, **labels), scheme), "largest").faces) == faces


@pytest.mark.parametrize("suffix", ["glb", "obj"])
@pytest.mark.parametrize("part", [None, "largest"])
def test_of_a_clothed_file_without_subdivision_the_body_is_matched(tmp_path, suffix, part):
    body, jeans = _named(triangulated(creature()), "body"), _named(triangulated(cube()), "jeans")
    jeans = jeans.with_positions(0.5 * np.ptp(body.positions, axis=0).max() * jeans.positions)
    path = tmp_path / f"figure.{suffix}"
    write_obj(tmp_path / "figure.obj", join_meshes([jeans, body]))
    plain = [Part(mesh.object_names[0], with_options(mesh, "none")) for mesh in (jeans, body)]
    write_document(tmp_path / "figure.glb", character_glb(Character(tuple(plain))))
    request = MatchRequest(path, path, tmp_path / "R", part=part, scheme="none")
    (pair,) = read_inputs(request).parts
    assert pair.source.n_faces == body.n_faces
    assert open_model(path, "none", None, 300, part).control.n_faces == body.n_faces


def test_titles_of_components_are_unique_where_objects_are_named_by_numbers() -> None:
    scene = replace(_scene(), object_names=("1", "eye", "eye"))
    assert [part.title for part in connected_parts(scene)] == ["component:0", "component:1", "component:2"]
    np.testing.assert_array_equal(find_part(scene, "component:1").faces, np.arange(6, 26))


def test_a_group_of_several_names_is_in_each_of_them() -> None:
    mesh = replace(cube(), face_groups=np.array([0, 0, 1, 1, 2, 2]), group_names=("lips", "lips face", "ear"))
    for name, faces in (("lips", [0, 1, 2, 3]), ("face", [2, 3]), ("group:ear", [4, 5]), ("lips face", [2, 3])):
        np.testing.assert_array_equal(find_part(mesh, name).faces, faces)


def test_a_part_taken_out_is_the_mesh_that_was_joined() -> None:
    scene = _scene()
    eye = extract_faces(scene, find_part(scene, "eye_right").faces)
    expected = _named(icosahedron(), "eye_right", -5)
    np.testing.assert_array_equal(eye.positions, expected.positions)
    np.testing.assert_array_equal(eye.face_indices, expected.face_indices)
    np.testing.assert_array_equal(eye.crease_edges, [expected.face(4)[:2]])
    assert len(eye.corner_vertices) == 0
    np.testing.assert_array_equal(eye.file_vertices, 20 + np.arange(12))
    np.testing.assert_array_equal(eye.file_faces, 26 + np.arange(20))
    again = extract_faces(eye, np.arange(3))
    np.testing.assert_array_equal(again.file_faces, [26, 27, 28])
    left = extract_faces(scene, find_part(scene, "eye_left").faces)
    np.testing.assert_array_equal(left.corner_vertices, [3])


def test_components_are_paired_by_landmarks_then_names_then_what_is_left() -> None:
    target = join_meshes([_named(cube(), "body"), _named(icosahedron(), "eye", 5), _named(pyramid(), "hat", 9)])
    source = join_meshes([_named(torus(4, 4), "ring"), _named(icosahedron(), "eye", 5), _named(cube(), "trunk", 9)])
    vertex = 16 + 12  # the first of the trunk
    pairs, alone, others = pair_parts(target, source, np.array([[0, vertex], [1, vertex + 1]]))
    assert {(one.name, other.name) for one, other in pairs} == {
        ("body", "trunk"),
        ("eye", "eye"),
        ("hat", "ring"),
    }
    assert (alone, others) == ((), ())
    fewer = join_meshes([_named(cube(), "trunk", 9)])
    pairs, alone, others = pair_parts(target, fewer, np.array([[0, 0]]))
    assert [(one.name, other.name) for one, other in pairs] == [("body", "trunk")]
    assert {part.name for part in alone} == {"eye", "hat"}
    assert others == ()
    assert len(connected_parts(target)) == 3


def test_materials_are_paired_by_name_and_their_pieces_by_landmarks() -> None:
    eyes = [
        replace(_named(icosahedron(), name, x), face_materials=np.zeros(20, np.int64), material_names=("eye",))
        for name, x in (("l", 5), ("r", -5))
    ]
    body = replace(
        _named(cube(), "body"), face_materials=np.array([0, 0, 0, 1, 1, 1]), material_names=("skin", "cloth")
    )
    scene = join_meshes([body, *eyes])
    assert [(part.name, len(part.faces)) for part in material_pieces(scene)] == [
        ("skin", 3),
        ("cloth", 3),
        ("eye 0", 20),
        ("eye 1", 20),
    ]
    pairs, alone, _ = pair_parts(scene, scene, np.zeros((0, 2), np.int64), (material_pieces(scene),) * 2)
    assert {(one.name, other.name) for one, other in pairs} == {("skin", "skin"), ("cloth", "cloth")}
    assert [part.name for part in alone] == ["eye 0", "eye 1"]  # which is which, no name says
    crossed = np.array([[8, 20], [20, 8]])
    pairs, alone, _ = pair_parts(scene, scene, crossed, (material_pieces(scene),) * 2)
    assert ("eye 0", "eye 1") in {(one.name, other.name) for one, other in pairs}
    assert alone == ()
    found, _ = select_parts(scene, scene, _landmarks(crossed), "material", "material")
    assert sorted(part.target.n_faces for part in found) == [3, 3, 20, 20]
    found, (note,) = select_parts(scene, scene, _landmarks(crossed), "material", "eye")
    assert [part.target.n_faces for part in found] == [20, 20]
    assert "skin" in note
    assert "cloth" in note
    with pytest.raises(ParameterError, match="--part material: expected parts that go together by name"):
        select_parts(scene, scene, Landmarks.none(), "material", "eye")


def test_objects_that_are_subdivided_differently_are_taken_one_at_a_time() -> None:
    scene = replace(_scene(), object_schemes=(CatmullClark("edge_only"), Loop(), CatmullClark()))
    (inputs,), _ = select_parts(scene, scene, Landmarks.none(), "body", "eye_left")
    assert inputs.target.scheme == CatmullClark("edge_only")
    assert inputs.source.scheme == Loop()
    assert inputs.source.object_schemes == ()
    with pytest.raises(ParameterError, match="expected a part that is subdivided in one way"):
        select_parts(scene, scene, Landmarks.none(), None, "body")


@pytest.mark.parametrize("level", [1, 2, 3])
def test_refined_parts_stand_where_they_are_said_to(level: int) -> None:
    for parts, scheme in (
        ([cube(), pyramid(), poles(5), grid(2, 3)], CatmullClark()),
        ([icosahedron(), icosahedron().with_positions(icosahedron().positions * 2)], Loop()),
    ):
        joined = refine(join_meshes(parts), level, scheme).finest
        for part, numbers in zip(parts, part_numbers(parts, level, loop=scheme == Loop()), strict=True):
            own = refine(part, level, scheme).finest
            np.testing.assert_allclose(joined.positions[numbers.vertices], own.positions, atol=1e-15)
            np.testing.assert_array_equal(joined.faces[numbers.faces], numbers.vertices[own.faces])


def _landmarks(pairs: np.ndarray) -> Landmarks:
    names = tuple(f"point {number}" for number in range(len(pairs)))
    return Landmarks(names, pairs[:, 0], pairs[:, 1])


def test_landmarks_follow_the_part_and_what_is_left_alone_is_said() -> None:
    scene = _scene()
    pairs = np.repeat([[0], [2], [5], [8], [11], [30]], 2, axis=1)
    (inputs,), notes = select_parts(scene, scene, _landmarks(pairs), "body", "body")
    np.testing.assert_array_equal(inputs.landmarks.target, [0, 2, 5])
    assert notes == ("3 of 6 landmarks lie on other parts and are left out",)
    chosen, notes = select_parts(scene, scene, _landmarks(pairs), "each", "each")
    assert [len(part.landmarks) for part in chosen] == [2, 1, 3]  # the larger parts first
    assert notes == ()
    lone = extract_faces(scene, find_part(scene, "body").faces)
    _, notes = select_parts(scene, lone, _landmarks(np.array([[0, 0]])), "each", "each")
    (note,) = notes
    assert note.startswith("left alone")
    assert note.count(" faces)") == 2


@pytest.mark.parametrize("every", ["each", "material"])
def test_parts_of_one_side_find_what_goes_with_them_on_the_other(every: str) -> None:
    assert (
        requested_parts(None, every, None) == requested_parts(None, None, every) == requested_parts(every, None, None)
    )
    assert requested_parts(None, every, "body") == (every, "body")
    scene, name = _scene(), "body" if every == "each" else "material:cloth"
    faces = len(find_part(scene, name).faces)
    for words in ((every, name), (name, every)):
        (chosen,), (note,) = select_parts(scene, scene, _landmarks(np.array([[7, 7]])), *words)
        assert chosen.target.n_faces == chosen.source.n_faces == faces
        assert note.endswith("of the target" if words[0] == every else "of the source")
    lone = extract_faces(scene, find_part(scene, "eye_left").faces)
    for pair in (scene, lone), (lone, scene):
        (found,), notes = select_parts(*pair, _landmarks(np.zeros((0, 2), dtype=np.int64)), "each", "each")
        assert found.target.n_faces == found.source.n_faces == lone.n_faces
        assert len(notes) == 1


def test_landmarks_between_vertices_follow_the_part_too() -> None:
    scene = _scene()
    eye = find_part(scene, "eye_left").faces
    corners = np.array([scene.face(int(eye[3])), scene.face(int(find_part(scene, "eye_right").faces[3]))])
    points = CagePoints(corners, np.array([[0.2, 0.3, 0.5]] * 2))
    landmarks = Landmarks(("a", "b"), points.vertices, points.vertices, target_points=points, source_points=points)
    (inputs,), _ = select_parts(scene, scene, landmarks, "eye_left", "eye_left")
    assert inputs.landmarks.names == ("a",)
    np.testing.assert_allclose(
        inputs.landmarks.target_points.of(inputs.target.positions), points.of(scene.positions)[:1], atol=1e-15
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two scenes of a creature and a ball that share landmarks, with UVs in two columns and a texture."""
    folder = tmp_path_factory.mktemp("parts")
    pieces = []
    for column, (mesh, name) in enumerate([(creature(), "body"), (poles(6), "ball")]):
        piece = _named(mesh, name, 9.0 * column)
        corners = np.arange(len(mesh.face_indices))
        size = 2 ** int(np.ceil(np.log2(np.sqrt(mesh.n_faces))))
        place = np.column_stack([mesh.corner_faces % size, mesh.corner_faces // size])
        unit = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])[corners - mesh.face_offsets[mesh.corner_faces]]
        cells = (place + 0.1 + 0.8 * unit) / size
        pieces.append(piece.with_uvs((cells + np.array([column, 0])) / [2, 1], corners))
    scene = join_meshes(pieces)
    write_obj(folder / "source.obj", scene)
    write_obj(folder / "target.obj", scene.with_positions(scene.positions * [1, 1.05, 1]))
    count = creature().n_vertices
    picked = np.concatenate([np.linspace(0, count - 1, 8).astype(int), count + np.arange(0, poles(6).n_vertices, 3)])
    write_landmarks(folder / "landmarks.json", marks_at(picked, "target.obj", "source.obj"))
    image = np.zeros((64, 128, 3), dtype=np.uint8)
    image[:, :64], image[:, 64:] = (200, 30, 30), (30, 30, 200)
    write_image(folder / "texture.png", image)
    return folder


def _match(folder: Path, name: str, **options: object) -> tuple[str, list[str]]:
    request = MatchRequest(
        folder / "target.obj",
        folder / "source.obj",
        folder / name,
        folder / "landmarks.json",
        level=1,
        k=30,
        **options,
    )
    return run_match(request, Stages())


def test_a_file_of_several_pieces_says_how_to_go_on(folder: Path) -> None:
    refuses(InvalidMeshError, "`find_part` NAME", _match, folder, "REFUSED")


@pytest.mark.slow
def test_each_part_is_matched_and_one_texture_baked(folder: Path) -> None:
    _match(folder, "EACH", part="each")
    result = read_result(folder / "EACH")
    assert len(result.manifest["parts"]) == 2
    # The scenes differ by a stretch: every vertex maps close to itself, on its own piece.
    stretched = result.target.vertices / [1, 1.05, 1]
    assert np.median(np.linalg.norm(result.image() - stretched, axis=1)) < 0.1
    assert np.array_equal(result.image()[:, 0] > 5, result.target.vertices[:, 0] > 5)
    with Stages() as stages:
        request = TransferRequest(folder / "EACH", folder / "baked.png", texture=folder / "texture.png")
        run_transfer(request, stages)
    baked = read_image(folder / "baked.png").pixels.astype(int)
    control = result.target.control
    centres = np.add.reduceat(control.uvs[control.uv_indices], control.face_offsets[:-1]) / control.face_sizes[:, None]
    columns, rows = (centres * [1, -1] * 128 + [0, 128]).astype(int).T
    on_body = control.face_objects == control.object_names.index("body")
    # The two colours differ by 170; where a lookup reaches across the middle of the image they mix a little.
    assert np.abs(baked[rows, columns][on_body] - [200, 30, 30]).max() <= 20
    assert np.abs(baked[rows, columns][~on_body] - [30, 30, 200]).max() <= 20


def test_the_level_of_one_part_is_that_of_its_own_size(folder: Path) -> None:
    files = [folder / name for name in ("target.obj", "source.obj", "R", "landmarks.json")]
    wanted = 400
    inputs = read_inputs(MatchRequest(*files, target_part="body", source_part="ball", vertices=wanted))
    request = MatchRequest(*files, vertices=wanted)
    assert matched_levels(request, inputs) == side_levels(request, (creature(), poles(6))) == (1, 2)
    each = read_inputs(MatchRequest(*files, part="each", vertices=wanted))
    assert matched_levels(request, each) == (1, 1)  # one file, one level


def test_one_part_can_be_matched_alone(folder: Path) -> None:
    _, warnings = _match(folder, "BALL", part="ball")
    result = read_result(folder / "BALL")
    assert result.target.control.n_vertices == poles(6).n_vertices
    np.testing.assert_array_equal(
        result.target.control.file_vertices, creature().n_vertices + np.arange(poles(6).n_vertices)
    )
    assert any("lie on other parts" in warning for warning in warnings)


@pytest.mark.parametrize("sides", [("triangles", "mixed"), ("mixed", "triangles")])
def test_plain_parts_of_quads_and_of_triangles_become_one_mesh_of_triangles(tmp_path, sides):
    ball = _named(triangulated(poles(6)), "ball", 9.0)
    scenes = {name: join_meshes([_named(body, "body"), ball]) for name, body in _bodies().items()}
    for name, scene in scenes.items():
        write_obj(tmp_path / f"{name}.obj", scene)
    np.save(tmp_path / "numbers.npy", scenes[sides[1]].positions)
    files = [tmp_path / f"{side}.obj" for side in sides]
    _, warnings = run_match(MatchRequest(*files, tmp_path / "R", scheme="none", part="each"), Stages())
    assert "mixed.obj: faces of different sizes are split into triangles" in warnings
    result = read_result(tmp_path / "R")
    np.testing.assert_allclose(result.image(), result.target.vertices, rtol=0, atol=1e-6)
    for side in (result.target, result.source):
        assert side.control.is_triangle_mesh
        assert set(side.control.file_faces) == set(range(scenes[sides[side is result.source]].n_faces))
    request = TransferRequest(tmp_path / "R", tmp_path / "carried.npz", attribute=tmp_path / "numbers.npy")
    run_transfer(request, Stages())
    np.testing.assert_allclose(
        np.load(tmp_path / "carried.npz")["numbers"], scenes[sides[0]].positions, rtol=0, atol=1e-6
    )


def _bodies() -> dict[str, ControlMesh]:
    return {"triangles": triangulated(creature()), "mixed": creature()}


def test_a_map_of_a_plain_mesh_of_triangles_and_quads_can_be_used(tmp_path: Path) -> None:
    mixed = with_options(pyramid(), "none")
    write_mesh(tmp_path / "mixed.obj", mixed)
    np.save(tmp_path / "m.npy", np.arange(mixed.n_vertices))
    np.save(tmp_path / "labels.npy", np.arange(mixed.n_faces))
    write_usd = tmp_path / "mixed.usda"
    pytest.importorskip("pxr.Usd", reason="usd-core is not installed")
    write_mesh(write_usd, mixed)
    _, warnings = run_map(MapRequest(tmp_path / "m.npy", write_usd, write_usd, tmp_path / "R"), Stages())
    assert "mixed.usda: faces of different sizes are split into triangles" in warnings
    assert read_result(tmp_path / "R").target.control.is_triangle_mesh
    request = TransferRequest(tmp_path / "R", tmp_path / "carried.npz", attribute=tmp_path / "labels.npy")
    run_transfer(request, Stages())
    np.testing.assert_array_equal(np.load(tmp_path / "carried.npz")["labels"], np.arange(mixed.n_faces))
