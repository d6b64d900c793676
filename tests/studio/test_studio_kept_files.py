"""Files of the studio's session: landmarks saved, kept and read again, and nothing outside its folders."""

import json
import zipfile
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cagemap.errors import FormatError, ParameterError
from cagemap.files.landmarks.pairs import write_landmarks
from cagemap.files.landmarks.point_formats import POINT_FORMS
from cagemap.mesh.landmarks import Landmarks
from cagemap.studio.autosave import FileTracker, autosave_path, read_autosave, write_autosave
from cagemap.studio.finish import FinishOptions
from cagemap.studio.landmark_files import autosaved_landmarks, earlier_landmarks, side_file
from cagemap.studio.landmarks import LandmarkList
from cagemap.studio.opening import default_files
from cagemap.studio.page.actions import Actions
from cagemap.studio.session import Session
from cagemap.studio.state import Files
from cagemap.tasks.requests.catalogue import Value

from refusals import refuses
from studio_boxes import add_landmarks, click, click_between, mapped, session_of, until


def test_saved_landmarks_are_read_again_and_a_persons_file_is_kept(opened: Session) -> None:
    files = opened.state.files
    add_landmarks(opened, 0, 3, 5)
    assert not opened.state.saved
    assert autosave_path(files.landmarks).is_file()
    theirs = {"source": "b.obj", "target": "a.obj", "pairs": [{"name": "mine", "source": 1, "target": 1}]}
    files.landmarks.write_text(json.dumps(theirs))
    opened.save()
    assert opened.state.saved
    assert not autosave_path(files.landmarks).exists()
    assert json.loads(files.landmarks.with_name(f"{files.landmarks.name}.before-studio").read_text()) == theirs
    before = opened.state.history.present.complete_landmarks
    opened.remove(1)
    opened.load(files.landmarks)
    assert [item.name for item in opened.state.history.present.complete_landmarks] == [item.name for item in before]
    opened.undo()
    assert len(opened.state.history.present.complete_landmarks) == 2


def test_a_landmark_is_kept_before_a_page_shows_it(opened: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    change, shown = opened._change, list[bool]()

    def watched(**changes: object) -> None:
        if "history" in changes:
            shown.append(autosave_path(opened.state.files.landmarks).is_file())
        change(**changes)

    monkeypatch.setattr(opened, "_change", watched)
    click(opened, "target", 2)  # half a landmark
    assert shown == [True]
    opened.undo()


def test_a_landmark_file_of_other_models_is_kept(opened: Session) -> None:
    landmarks = opened.state.files.landmarks
    add_landmarks(opened, 0)
    opened.save()
    ours = landmarks.read_text()
    write_landmarks(landmarks, Landmarks(("mine",), np.array([1]), np.array([1]), "c.obj", "d.obj"))
    theirs = landmarks.read_text()
    kept = landmarks.with_name(f"{landmarks.name}.before-studio")
    for _ in range(2):  # what it saves itself is replaced as ever
        opened.save()
        assert kept.read_text() == theirs
        assert landmarks.read_text() == ours
        assert not landmarks.with_name(f"{kept.name}-2").exists()


def test_what_another_studio_saves_or_keeps_meanwhile_is_not_lost(opened: Session) -> None:
    landmarks = opened.state.files.landmarks
    usual = autosave_path(landmarks)
    add_landmarks(opened, 0, 3)
    opened.save()
    write_landmarks(landmarks, Landmarks(("theirs",), np.array([1]), np.array([1]), "b.obj", "a.obj"))
    write_autosave(usual, LandmarkList(opened.state.history.present.items[:1]))
    saved, kept = landmarks.read_text(), usual.read_text()
    for vertex in (5, 6):
        click(opened, "target", vertex)
    own = usual.with_name(f"{usual.name}.1")
    assert usual.read_text() == kept
    assert len(read_autosave(own, (8, 8)).items) == len(opened.state.history.present.items)
    assert not usual.with_name(f"{usual.name}.2").exists()
    assert [own.name in message.text for message in opened.state.messages].count(True) == 1
    opened.save()
    assert landmarks.with_name(f"{landmarks.name}.before-studio").read_text() == saved
    assert "changed by others" in "".join(message.text for message in opened.state.messages)
    assert usual.read_text() == kept
    assert not own.exists()


def test_a_landmark_file_that_cannot_be_read_costs_no_map(opened: Session) -> None:
    files = opened.state.files
    files.landmarks.write_text("{")
    opened.open(files)
    until(lambda: opened.state.map.revision >= 1, opened)
    assert any("expected JSON" in message.text for message in opened.state.messages)


def test_no_finish_begins_with_landmarks_that_were_not_saved(opened: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object) -> None:
        raise FormatError("full: no room. Make some.")

    add_landmarks(opened, 0)
    with monkeypatch.context() as patch:
        patch.setattr("cagemap.studio.session.save_landmarks", refused)
        opened.finish(FinishOptions())
    assert opened.state.finish_job is None
    assert "no room" in opened.state.messages[-1].text


PER_MESH = [f"both{form.ending}" for form in POINT_FORMS]


@pytest.mark.parametrize("name", ["", "other.json", *PER_MESH])
def test_a_click_between_vertices_stays_where_it_was(opened: Session, boxes: Path, name: str) -> None:
    clicked = [click_between(opened, side) for side in ("target", "source")]
    item = opened.state.history.present.complete_landmarks[0]
    for place, position, side in ((item.target, clicked[0], "target"), (item.source, clicked[1], "source")):
        assert np.linalg.norm(np.array(place.position) - position) < 0.01 * opened.scene.shape(side).radius
        assert max(place.weights) < 0.9
    opened.save(name)
    opened.remove(1)
    if name not in PER_MESH:
        assert opened.state.files.landmarks.name == (name or "b__a.json")
        opened.load(Path(name or "b__a.json"))
    else:
        assert opened.state.files.landmarks.name == "b__a.json"
        opened.load(side_file(Path(name), "target"), side_file(Path(name), "source"))
        for side in ("target", "source"):  # Wrap's form has no mark, so that nothing is written over it
            side_file(boxes / name, side).unlink()
        said = [message.text for message in opened.state.messages if "order alone" in message.text]
        assert bool(said) == (name == "both.txt")
    again = opened.state.history.present.complete_landmarks[0]
    for side in ("target", "source"):
        np.testing.assert_allclose(again.place_on(side).position, item.place_on(side).position, atol=1e-6)
    for refused in ("refused.md", "refused"):
        opened.save(refused)
        assert "Choose such a name" in opened.state.messages[-1].text
        assert not (boxes / refused).exists()


def test_a_loaded_file_adds_no_mirrored_landmark(opened: Session, boxes: Path) -> None:
    for vertex in range(5):
        click(opened, "target", vertex)
        click(opened, "source", vertex)
    opened.save("five.json")
    opened.remove(5)
    click(opened, "target", 4)
    assert (len(opened.state.history.present), opened.state.history.present.open_landmark.number) == (5, 5)
    with opened._lock:
        opened._scene = replace(opened.scene, mirrors=2 * (np.array([0, 1, 2, 3, 7, 5, 6, 4]),))
    opened.change_view(symmetric=True)
    try:
        opened.load(Path("five.json"))
        assert len(opened.state.history.present.complete_landmarks) == len(opened.state.history.present) == 5
    finally:
        opened.change_view(symmetric=False)
        with opened._lock:
            opened._scene = replace(opened.scene, mirrors=(None, None))
        (boxes / "five.json").unlink()


def test_curves_of_a_file_are_used_and_saved_again(opened: Session, boxes: Path) -> None:
    curve = {"name": "rim", "source": [0, 1, 2, 3], "target": [0, 1, 2, 3], "closed": True}
    corners = opened.scene.target.control.face_indices[:4].tolist()
    curve |= {"source": corners, "target": corners}
    given = {"source": "b.obj", "target": "a.obj", "pairs": [], "curves": [curve]}
    (boxes / "rim.json").write_text(json.dumps(given))
    mapped(opened, opened.load, Path("rim.json"))
    opened.click("target", np.array([0.0, 0.0, 5.0]), np.array([0.0, 0.0, -1.0]))
    assert [pair.name for pair in opened.state.history.present.curves] == ["rim"]
    kept = read_autosave(autosave_path(opened.state.files.landmarks), (8, 8))
    assert [pair.name for pair in kept.curves] == ["rim"]
    np.testing.assert_array_equal(kept.curves[0].target.points.vertices, corners)
    for name in ("other.json", "both.points.json"):
        opened.save(name)
    assert json.loads((boxes / "other.json").read_text())["curves"] == [curve]
    opened.load(Path("both.target.points.json"), Path("both.source.points.json"))
    np.testing.assert_array_equal(opened.state.history.present.curves[0].source.points.vertices, corners)


@pytest.mark.slow
def test_a_kill_of_the_session_loses_nothing(opened: Session, boxes: Path) -> None:
    click(opened, "target", 4)
    opened.rename(1, "corner")
    with closing(session_of(boxes)) as other:
        other.open(opened.state.files)
        until(lambda: other.state.history.present.items, other)
        assert other.state.history.present == opened.state.history.present
        until(lambda: any("recovered" in message.text for message in other.state.messages), other)


def test_errors_are_messages_and_paths_outside_are_refused(opened: Session) -> None:
    opened.load(Path("../elsewhere.json"))
    assert opened.state.messages[-1].kind == "error"
    assert "got one outside" in opened.state.messages[-1].text
    opened.accept()  # nothing waits
    opened.mirror(1)  # nothing to mirror
    assert opened.state.messages[-1].kind == "error"


@pytest.mark.parametrize("path", ["../x.json", "/etc/passwd", "a/../../x.json", "bad\0name", "~/../../x"])
def test_no_word_of_the_page_reaches_outside(opened: Session, boxes: Path, path: str) -> None:
    def listed() -> set[Path]:
        return set(boxes.parent.rglob("*"))

    before, files, history = listed(), opened.state.files, opened.state.history
    opened.save(path)
    opened.load(Path(path))
    opened.load(files.target, Path(path))
    for key, option in opened.options.items():
        named: dict[str, Value] = {"file": Path(path), "files": (Path(path),), "named files": (("a", Path(path)),)}
        named |= {"name or file": f"not:{path}.png"}
        if option.kind in named:
            opened.finish(FinishOptions(option_values={key: named[option.kind]}))
    opened.finish(FinishOptions(maps=(("roughness", Path(path)),)))
    opened.finish(FinishOptions(name=path))
    for name in ("target", "source", "texture", "landmarks", "result"):
        opened.open(replace(files, **{name: Path(path)}))
    assert opened.state.messages[-1].kind == "error"
    assert opened.state.files == files
    assert opened.state.history == history
    assert opened.state.finish_job is None
    assert listed() == before


def test_an_autosave_of_the_name_to_save_as_is_moved_aside(opened: Session, boxes: Path) -> None:
    theirs = autosave_path(boxes / "other.json")
    theirs.write_text("unsaved")
    add_landmarks(opened, 0)
    opened.save("other.json")
    click(opened, "target", 3)
    assert theirs.with_name(f"{theirs.name}.1").read_text() == "unsaved"
    for path in boxes.glob(".*autosave*"):
        path.unlink()
    opened.save("b__a.json")


def test_files_are_added_under_free_names(session: Session, boxes: Path) -> None:
    workspace = session.workspace
    first, second = workspace.add("../x.obj", b"1"), workspace.add("x.obj", b"2")
    assert (first.name, second.name) == ("x.obj", "x (2).obj")
    assert first.parent == second.parent == boxes.resolve()
    assert not session.add_file("x.sh", b"rm")
    for path in (first, second):
        path.unlink()


@pytest.mark.parametrize(
    "line",
    [b"mtllib ../out.mtl", b" mtllib own.mtl /etc/passwd\r", b"mtllib \\\n..\\out.mtl", b"v 0 0 0\rmtllib ../out.mtl"],
)
def test_an_added_mesh_names_no_file_outside_the_folders(session: Session, boxes: Path, line: bytes) -> None:
    before = sorted(boxes.iterdir())
    refuses(ParameterError, "got one outside", session.workspace.add, "x.obj", b"v 0 0 0\n" + line + b"\nv 1 0 0\n")
    assert sorted(boxes.iterdir()) == before
    added = session.workspace.add("x.obj", b"mtllib my own.mtl\n")
    added.unlink()


@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    [
        "(subLayers = [@../out.usda@])",
        'def "a"(references = @/out.usda@){}',
        'def "a"(payload = @./../out.usda@){}',
        'def "a"(references = @elsewhere.usda@){}',
        'def "a"(references = @./x.usda:SDF_FORMAT_ARGS:a=b@){}',
        'def "a" {\nasset f = @/etc/passwd@\n}',
        'def "a" {\nasset[] f.timeSamples = {0: [@../out.png@]}\n}',
        'def "a"(clips = {dictionary b = {string templateAssetPath = "../out.###.usda"}}){}',
        '(expressionVariables = {string A = "x"})\ndef "a"(references = @`"./${A}.usda"`@){}',
    ],
)
def test_an_added_usd_file_names_no_file_outside_the_folders(session: Session, boxes: Path, words: str) -> None:
    pytest.importorskip("pxr.Usd", reason="usd-core is not installed")
    before = sorted(boxes.iterdir())
    text = "#usda 1.0\n" + words.replace("){}", "){\n}\n")
    refuses(ParameterError, "got one outside", session.workspace.add, "x.usda", text.encode())
    assert sorted(boxes.iterdir()) == before


@pytest.mark.slow
def test_an_added_usd_file_may_name_files_beside_it_and_a_package_its_own(session: Session, tmp_path: Path) -> None:
    pytest.importorskip("pxr.Usd", reason="usd-core is not installed")
    text = b'#usda 1.0\ndef "a" {\nasset f = @./textures/a.png@\n}\n'
    session.workspace.add("x.usda", text).unlink()
    refuses(FormatError, "cannot be read as USD", session.workspace.add, "x.usda", b"no layer")
    layer, image, package = tmp_path / "a.usda", tmp_path / "a.png", tmp_path / "p.usdz"
    layer.write_bytes(text.replace(b"./textures/", b""))
    image.write_bytes(b"png")
    for entry, named in (("a.png", True), ("b.png", False)):
        with zipfile.ZipFile(package, "w") as writer:
            writer.write(layer, "a.usda")
            writer.write(image, entry)
        if named:
            session.workspace.add("p.usdz", package.read_bytes()).unlink()
        else:
            refuses(ParameterError, r"got one outside: a\.png", session.workspace.add, "p.usdz", package.read_bytes())


def test_an_autosave_names_the_files_that_its_landmarks_are_of(opened: Session) -> None:
    click(opened, "target", 0)
    kept = autosave_path(opened.state.files.landmarks)
    assert json.loads(kept.read_text())["models"] == ["a.obj, 8 vertices", "b.obj, 8 vertices"]
    other = replace(opened.state.files, source=opened.state.files.source.with_name("b.glb"))
    refuses(FormatError, r"b\.obj, 8 vertices", autosaved_landmarks, other, opened.scene, FileTracker())
    opened.undo()


def test_a_loaded_landmark_file_of_a_model_with_another_ending_is_kept(opened: Session) -> None:
    landmarks = opened.state.files.landmarks
    write_landmarks(landmarks, Landmarks(("mine",), np.array([1]), np.array([1]), "a.obj", "b.glb"))
    theirs = landmarks.read_text()
    opened.load(landmarks)
    opened.save()
    assert landmarks.with_name(f"{landmarks.name}.before-studio").read_text() == theirs


def test_landmarks_in_the_first_folder_are_read_where_there_are_none_beside_the_target(opened, boxes, tmp_path):
    """Earlier versions saved them there, also for pairs of other folders."""
    name, folder, scene = "b__a.json", tmp_path / "anna", opened.scene
    folder.mkdir()
    files = default_files(folder / "a.obj", boxes / "b.obj", None)
    earlier = tmp_path / name

    def read(files: Files = files) -> tuple[LandmarkList, list[str]] | None:
        return earlier_landmarks(files, scene, FileTracker(), tmp_path)

    assert read() is None
    for vertex, other in ((1, "b.glb"), (9, "b.obj")):  # other models
        write_landmarks(earlier, Landmarks(("nose",), np.array([vertex]), np.array([1]), "a.obj", other), force=True)
        assert read() is None
    write_landmarks(earlier, Landmarks(("nose",), np.array([1]), np.array([1]), "a.obj", "b.obj"), force=True)
    landmarks, notes = read()
    assert [item.name for item in landmarks.items] == ["nose"]
    assert "saved beside the target" in notes[-1]
    assert read(replace(files, landmarks=folder / "own.json")) is None
    files.landmarks.write_text("{}")
    assert read() is None
    files.landmarks.unlink()
    earlier.rename(tmp_path / "else.json")
    earlier.symlink_to(tmp_path / "else.json")
    assert read() is None


def test_a_pair_that_is_opened_on_the_page_has_its_landmarks_of_earlier_versions(boxes: Path, tmp_path: Path) -> None:
    with closing(session_of(tmp_path)) as session:
        (tmp_path / "anna").mkdir()
        for name in ("anna/a.obj", "b.obj"):
            (tmp_path / name).write_bytes((boxes / Path(name).name).read_bytes())
        write_landmarks(tmp_path / "b__a.json", Landmarks(("nose",), np.array([1]), np.array([1]), "a.obj", "b.obj"))
        sent = {"do": "open", "target": "anna/a.obj", "source": "b.obj", "schemes": ["", ""]}
        Actions(session).handle(json.dumps(sent))
        until(lambda: session.state.map.revision >= 1, session)
        assert [item.name for item in session.state.history.present.items] == ["nose"]
        assert not session.state.saved
        session.save()
        assert (tmp_path / "anna" / "b__a.json").is_file()


def test_files_that_are_dropped_again_are_used_again_and_an_obj_names_the_new_material_file(tmp_path: Path) -> None:
    with closing(session_of(tmp_path)) as session:
        mesh = b"mtllib x.mtl\nv 0 0 0\n"
        for name, content in (("x.mtl", b"newmtl a\n"), ("x.obj", mesh)):
            assert session.add_file(name, content) == session.add_file(name, content) == tmp_path.resolve() / name
        assert session.add_file("x.mtl", b"newmtl b\n").name == "x (2).mtl"
        again = session.add_file("x.obj", mesh)
        assert (again.name, again.read_bytes()) == ("x (2).obj", b"mtllib x (2).mtl\nv 0 0 0\n")


def test_files_of_the_folder_that_are_dropped_are_not_copied_for_folders_in_names(tmp_path: Path) -> None:
    contents = {"x.png": b"image", "x.obj.mtl": b"newmtl a\nmap_Kd maps/x.png\n", "x.obj": b"mtllib ./x.obj.mtl\n"}
    with closing(session_of(tmp_path)) as session:
        for name, content in contents.items():
            (tmp_path / name).write_bytes(content)
        for name, content in contents.items():
            assert session.add_file(name, content, "a drop") == tmp_path.resolve() / name


def test_files_of_a_drop_name_its_images_and_buffers_as_they_were_added(tmp_path: Path) -> None:
    """Another file of the same name was added before: it is neither replaced nor used."""
    with closing(session_of(tmp_path)) as session:
        for name in ("skin.png", "my skin.png", "häme 1.bin"):
            (tmp_path / name).write_bytes(b"another's")
        mtl = b"newmtl a\nKd 1 1 1\nmap_Kd -s 1 1 1 skin.png\nmap_Bump my skin.png\nmap_Ks other skin.png\n"
        gltf = b'{"buffers": [{"uri": "h%C3%A4me%201.bin"}], "images": [{"uri": "skin.png"}, {"name": "skin.png"}]}'
        contents = {"skin.png": b"1", "my skin.png": b"2", "other skin.png": b"3", "häme 1.bin": b"4"}
        for name, content in (contents | {"a.mtl": mtl, "a.gltf": gltf}).items():
            session.add_file(name, content, "a drop")
        assert [message.text for message in session.state.messages if message.kind == "error"] == []
        mtl = mtl.replace(b"1 skin.png", b"1 skin (2).png").replace(b"my skin.png", b"my skin (2).png")
        assert (tmp_path / "a.mtl").read_bytes() == mtl
        gltf = gltf.replace(b"1.bin", b"1%20%282%29.bin").replace(b'i": "skin.', b'i": "skin%20%282%29.')
        assert (tmp_path / "a.gltf").read_bytes() == gltf
        assert (tmp_path / "häme 1 (2).bin").read_bytes() == b"4"


@pytest.mark.parametrize(
    ("name", "written", "kept"),
    [
        ("a.gltf", b'{"uri": "textures/skin.png"}', b'{"uri": "skin%20%282%29.png"}'),
        ("a.gltf", b'{"uri": "textures\\/own.png"}', b'{"uri": "own.png"}'),
        ("a.gltf", b'{"uri": "h\\u00e4me.bin"}', b'{"uri": "h%C3%A4me.bin"}'),
        ("a.gltf", b'{"uri": "old skin.png"}', None),
        ("a.ply", b"comment TextureFile skin.png\r\n\xe0", b"comment TextureFile skin (2).png\r\n\xe0"),
        (
            "a.mtl",
            b"map_Kd -type sphere -s 1 .5 1e0 C:\\my maps\\skin.png",
            b"map_Kd -type sphere -s 1 .5 1e0 skin (2).png",
        ),
        ("a.mtl", b"map_Kd old skin.png", None),
        ("a.mtl", b"map_Kd 2 heads.png", b"map_Kd 2 heads (2).png"),
        ("a.mtl", b"map_Kd 2 skin.png", None),
        ("a.mtl", b"bump -bm 1 maps/skin.png # a/comment", b"bump -bm 1 skin (2).png # a/comment"),
        ("a.mtl", b"map_Kd" + 40 * b" -e" + b" skin.jpg", None),
        ("a.mtl", b"map_Kd h\xe4me.png\r\nmap_Ks skin.png\r\n", b"map_Kd h\xe4me.png\r\nmap_Ks skin (2).png\r\n"),
        ("a.obj", b"mtllib one.mtl \\\n two.mtl\n", b"mtllib one (2).mtl\nmtllib two.mtl\n"),
        ("a.obj", b"mtllib maps/my one.mtl\n", None),
        ("a.obj", b"mtllib maps/two.mtl\n", b"mtllib two.mtl\n"),
    ],
)
def test_statements_of_a_file_name_files_of_its_drop(
    tmp_path: Path, name: str, written: bytes, kept: bytes | None
) -> None:
    with closing(session_of(tmp_path)) as session:
        for given in ("skin.png", "2 heads.png", "one.mtl"):
            (tmp_path / given).write_bytes(b"another's")
        for given in ("skin.png", "own.png", "2 heads.png", "häme.bin", "one.mtl", "two.mtl"):
            session.add_file(given, b"new", "a drop")
        assert session.add_file(name, written, "a drop").read_bytes() == (kept or written)


def test_a_note_says_which_images_a_dropped_fbx_file_does_not_name(tmp_path: Path) -> None:
    with closing(session_of(tmp_path)) as session:
        for name in ("skin.png", "nose.json"):
            (tmp_path / name).write_bytes(b"another's")
        for name in ("own.png", "skin.png", "nose.json", "a.fbx"):
            session.add_file(name, b"new", "a drop")
        (note,) = [message.text for message in session.state.messages if message.text.startswith("a.fbx")]
        assert "skin (2).png" in note
        assert "own.png" not in note
        assert "nose" not in note


def test_an_obj_that_is_dropped_alone_keeps_its_material_file(tmp_path: Path) -> None:
    """The material file of another drop had the name that its model's has."""
    with closing(session_of(tmp_path)) as session:
        actions, added = Actions(session), list[list[str]]()
        first, second = b"mtllib a.mtl\nv 0 0 0\n", b"mtllib a.mtl\nv 1 0 0\n"
        drops = ((b"newmtl a\n", first), (b"newmtl b\n", second), (None, first))
        for drop, contents in enumerate(drops):
            for name, content in zip(("a.mtl", "a.obj"), contents, strict=True):
                if content is not None:
                    head = json.dumps({"name": name, "role": None, "drop": str(drop)}).encode()
                    actions.handle(head + b"\n" + content)
            added.append(sorted(path.name for path in tmp_path.iterdir()))
        assert added == [["a.mtl", "a.obj"], *[["a (2).mtl", "a (2).obj", "a.mtl", "a.obj"]] * 2]
        assert (tmp_path / "a (2).obj").read_bytes() == b"mtllib a (2).mtl\nv 1 0 0\n"
