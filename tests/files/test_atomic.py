"""Files and folders are written whole or not at all, and nothing of a failure stays behind."""

import errno
import os
import resource
import signal
import stat
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from examples.shapes import cube

from cagemap.errors import CagemapError, FormatError
from cagemap.files.atomic import (
    all_or_nothing,
    atomic_folder,
    atomic_path,
    require_own_folder,
    require_replaceable,
    write_whole,
)
from cagemap.files.images.image import write_image
from cagemap.files.meshes import obj_write
from cagemap.files.meshes.formats import write_mesh
from cagemap.files.ownership import is_own, mark, seal
from cagemap.files.result.folder import ARRAYS, write_result
from cagemap.files.result.maps import write_map
from cagemap.files.values.attributes import write_attributes
from cagemap.subdivision import refine
from cagemap.subdivision.refinement import finest_mesh

from example_result import identity_result
from refusals import refuses

NAMES = ("map.npz", "manifest.json")


def fail_after(_written: int, error: BaseException | type[BaseException]) -> None:
    raise error


def appear(folder: Path, written: Path) -> None:
    """Finish what is being written just after somebody else has put their work there."""
    for name in NAMES:
        (written / name).touch()
    folder.mkdir()
    (folder / "precious.blend").touch()


@contextmanager
def room_for(size: int) -> Iterator[None]:
    """No file may grow beyond a size, as on a disk that is full."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, before)


def test_content_is_on_the_disk_before_it_has_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    done, rename = [], os.replace
    monkeypatch.setattr(os, "fsync", lambda number: done.append("flush"))
    monkeypatch.setattr(os, "replace", lambda *given: (done.append("rename"), rename(*given)))
    write_whole(tmp_path / "a.txt", "a")
    assert done == ["flush", "rename"]
    done.clear()
    write_result(tmp_path / "R", identity_result(1))
    assert done == ["flush", "flush", "rename"]


FORMATS = [
    *("m.obj", "m.ply", "m.off", "m.glb", "m.usda", "m.usdc"),
    *("i.png", "i.tif", "i.exr", "i.jpg"),
    *("p.npy", "p.npz", "p.mtx", "p.vts"),
    *("v.npz", "v.npy", "v.csv"),
]


def test_what_a_killed_process_left_is_removed_and_what_a_living_one_writes_is_not(tmp_path: Path) -> None:
    killed = (
        "import os, signal, sys\n"
        "from cagemap.files.atomic import atomic_folder, atomic_path\n"
        "with atomic_path(sys.argv[1]), atomic_folder(sys.argv[2], ['a']) as folder:\n"
        "    (folder / 'a').write_text('half')\n"
        "    os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    final, folder = tmp_path / "d.png", tmp_path / "R"
    subprocess.run([sys.executable, "-c", killed, str(final), str(folder)], env=os.environ, check=False)
    names = {path.name.split(".")[1]: path for path in tmp_path.iterdir()}
    assert set(names) == {"d", "R"}  # killed in the middle of both
    others = {tmp_path / name for name in (".d.part.png", ".d.12345678.part.jpg", ".e.12345678.part.png")}
    with atomic_path(final) as living:
        for path in (*names.values(), *others, living):
            path.touch()
            os.utime(path, (1e9, 1e9))
        write_whole(final, f"{mark()}")
        assert set(tmp_path.iterdir()) == {living, final, names["R"], *others}
        living.write_text("x")
        os.utime(final.with_name(living.name), (1e9, 1e9))
    with atomic_folder(folder, ["a"]) as writing:
        (writing / "a").write_text("x")
        os.utime(writing, (1e9, 1e9))
        assert not names["R"].exists()
        write_whole(folder.with_name("S"), "x")
    assert set(tmp_path.iterdir()) == {final, folder, tmp_path / "S", *others}


def test_what_cannot_be_read_again_does_not_replace_the_earlier_file(tmp_path: Path) -> None:
    final = tmp_path / "a.png"
    final.write_text("old")
    for text, verify in (("cut", lambda _: False), ("", None)):
        with pytest.raises(FormatError, match=r"a\.png: could not be written whole; what was there before is kept"):
            with atomic_path(final, force=True, **({"verify": verify} if verify else {})) as temporary:
                temporary.write_text(text)
        assert final.read_text() == "old"
        assert list(tmp_path.iterdir()) == [final]


@pytest.mark.parametrize("name", [*FORMATS, "R"])
def test_a_full_disk_leaves_no_half_of_a_file(tmp_path: Path, name: str) -> None:
    """Whatever library writes: an error, and what was there before; some libraries report nothing."""
    if name.startswith("m.usd"):
        pytest.importorskip("pxr.Usd", reason="usd-core is not installed")
    result, file = identity_result(), tmp_path / name
    level = result.target.refinement.finest
    pixels = np.random.default_rng(0).integers(0, 255, (64, 64, 3)).astype(np.uint8)
    writers: dict[str, Callable[[], object]] = {
        "m": lambda: write_mesh(file, finest_mesh(refine(cube(), 3)), force=True),
        "i": lambda: write_image(file, pixels.astype(np.float32) if name == "i.exr" else pixels, force=True),
        "p": lambda: write_map(file, result.point_map, force=True),
        "v": lambda: write_attributes(file, {"v": level.positions}, force=True),
        "R": lambda: write_result(file, result, force=True),
    }
    with room_for(600), pytest.raises((CagemapError, OSError)):
        writers[name[0]]()
    assert list(tmp_path.iterdir()) == []
    writers[name[0]]()
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    largest = max(map(len, before.values()))
    for size in np.linspace(0, largest - 200, 8).astype(int).tolist():  # dates in usdc and zip differ in length
        with room_for(size), pytest.raises((CagemapError, OSError)):
            writers[name[0]]()
        assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


@pytest.mark.parametrize("moved", [False, True])
def test_file_appears_whole_under_its_name_only(tmp_path: Path, moved: bool) -> None:
    """Also where a library writes beside the temporary file and moves."""
    final = tmp_path / "image.exr"
    with atomic_path(final) as temporary:
        if moved:
            temporary.unlink()
        assert temporary.parent == tmp_path
        assert temporary.suffix == ".exr"  # image libraries choose their format by it
        temporary.write_text("half")
        assert not final.exists()
    assert final.read_text() == "half"
    assert [path.name for path in tmp_path.iterdir()] == ["image.exr"]
    reference = tmp_path / "plain"
    reference.touch()
    assert stat.S_IMODE(final.stat().st_mode) == stat.S_IMODE(reference.stat().st_mode)


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_failure_leaves_the_older_file(tmp_path: Path, error: type[BaseException]) -> None:
    final = tmp_path / "a.txt"
    final.write_text("old")
    with pytest.raises(error), atomic_path(final, force=True) as temporary:
        fail_after(temporary.write_text("new"), error)
    assert final.read_text() == "old"
    assert list(tmp_path.iterdir()) == [final]


def test_files_that_go_together_are_all_left_where_one_may_not_be_replaced(tmp_path: Path) -> None:
    def write_both() -> None:
        with all_or_nothing():
            for name in ("first.txt", "second.txt"):
                write_whole(tmp_path / name, "ours")
            (tmp_path / "second.txt").write_text("somebody else's")

    refuses(FormatError, "not overwritten", write_both)
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"second.txt": "somebody else's"}


def test_files_that_go_together_are_all_left_where_one_cannot_be_moved(tmp_path, monkeypatch):
    """As where another program has the last one open, on Windows."""
    honest = os.replace
    write_whole(tmp_path / "old.txt", f"{mark()} old")
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}

    def replaced(temporary: Path, place: Path) -> None:
        if place.name == "last.txt":
            raise PermissionError(errno.EACCES, "in use")
        honest(temporary, place)

    def write_all() -> None:
        with all_or_nothing():
            for name in ("old.txt", "new.txt", "last.txt"):
                write_whole(tmp_path / name, f"{mark()} ours")

    with monkeypatch.context() as windows:
        windows.setattr(os, "replace", replaced)
        refuses(FormatError, r"last\.txt: cannot write there \(in use\)", write_all)
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before
    write_all()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["last.txt", "new.txt", "old.txt"]
    assert all(path.read_text().endswith("ours") for path in tmp_path.iterdir())


def test_more_files_go_together_than_a_process_may_have_open(tmp_path: Path) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (256, hard))
    try:
        with all_or_nothing():
            for tile in range(1001, 1301):
                write_whole(tmp_path / f"skin.{tile}.txt", "ours")
            assert not list(tmp_path.glob("skin*"))
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    assert len(list(tmp_path.glob("skin*"))) == len(list(tmp_path.iterdir())) == 300


def test_places_that_cannot_be_written_are_named(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match=r"folder .*none does not exist"), atomic_path(tmp_path / "none" / "a.txt"):
        pass
    with pytest.raises(FormatError, match="got a folder"), atomic_path(tmp_path):
        pass
    for length in (245, 300):  # with the temporary name, and without
        refuses(FormatError, "name is too long", require_own_folder, tmp_path / ("n" * length), NAMES)
    refuses(FormatError, "does not exist", require_replaceable, tmp_path / ("n" * 300) / "a.txt")
    full = OSError(errno.ENOSPC, "No space left on device")
    with pytest.raises(FormatError, match=r"cannot write there \(No space left"), atomic_path(tmp_path / "a.txt"):
        fail_after(0, full)
    with pytest.raises(FileNotFoundError), atomic_path(tmp_path / "a.txt"):  # of another file, the caller's business
        fail_after(0, FileNotFoundError(errno.ENOENT, "No such file", "input.png"))
    with pytest.raises(FormatError, match="does not exist"), atomic_folder(tmp_path / "none" / "r", NAMES):
        pass


def test_a_folder_appears_whole_and_an_earlier_result_or_empty_one_is_replaced(tmp_path: Path) -> None:
    new, final = tmp_path / "new", tmp_path / "result"
    final.mkdir()
    for folder, text in ((new, "new"), (final, "first"), (final, "second")):
        with atomic_folder(folder, NAMES) as temporary:
            for name in NAMES:
                (temporary / name).write_text(f"{text} {mark()}")
            assert folder.exists() == (folder is final)
        (folder / f"notes of the {text}.txt").write_text("mine")
    assert stat.S_IMODE(new.stat().st_mode) == stat.S_IMODE(final.stat().st_mode)
    assert (final / "map.npz").read_text().startswith("second")
    with pytest.raises(RuntimeError), atomic_folder(final, NAMES, force=True) as temporary:
        fail_after((temporary / "manifest.json").write_text("third"), RuntimeError())
    notes = ["notes of the first.txt", "notes of the second.txt"]
    assert sorted(path.name for path in final.iterdir()) == ["manifest.json", "map.npz", *notes]
    assert (final / "manifest.json").read_text().startswith("second")
    assert set(tmp_path.iterdir()) == {new, final}


def test_other_folders_and_files_are_never_overwritten(tmp_path: Path) -> None:
    work = tmp_path / "work"
    work.mkdir()
    (work / "precious.blend").touch()
    with (
        pytest.raises(FormatError, match=r"no map\.npz and manifest\.json.*nothing is written"),
        atomic_folder(work, NAMES),
    ):
        pass
    with pytest.raises(FormatError, match="got a file"), atomic_folder(work / "precious.blend", NAMES):
        pass
    # What appears while the result is computed is as precious.
    late = tmp_path / "late"
    with pytest.raises(FormatError, match="nothing is written"), atomic_folder(late, NAMES) as temporary:
        appear(late, temporary)
    assert (work / "precious.blend").exists()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["late", "work"]


def test_a_folder_without_permission_is_refused_by_a_name_that_it_would_get(tmp_path, monkeypatch):
    monkeypatch.setattr("os.access", lambda *_: False)
    with pytest.raises(FormatError, match=r"a\.txt: cannot write to the folder"), atomic_folder(tmp_path, ["a.txt"]):
        pass


def test_of_a_link_the_folder_that_cannot_be_written_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.txt").symlink_to(tmp_path / "closed" / "b.txt")
    (tmp_path / "closed").mkdir()
    monkeypatch.setattr("os.access", lambda path, _: Path(path).name != "closed")
    refuses(FormatError, r"a\.txt: cannot write to the folder .*closed\.", require_replaceable, tmp_path / "a.txt")
    monkeypatch.chdir(tmp_path / "closed")
    refuses(FormatError, r"^b\.txt: cannot write to the folder .*closed\.", require_replaceable, "b.txt")


def test_of_two_writers_of_a_new_folder_both_are_done(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The other one creates the folder between the last look and the move."""
    honest, folder = os.replace, tmp_path / "R"

    def meanwhile(source: Path, target: Path) -> None:
        if Path(target) == folder and not folder.exists():
            folder.mkdir()
            (folder / "a.txt").write_text(f"{mark()}\n")
            seal(folder / "a.txt")
        honest(source, target)

    monkeypatch.setattr("os.replace", meanwhile)
    with atomic_folder(folder, ["a.txt"]) as temporary:
        (temporary / "a.txt").write_text(f"{mark()} ours\n")
    assert "ours" in (folder / "a.txt").read_text()
    assert [path.name for path in tmp_path.iterdir()] == ["R"]


def test_an_archive_with_the_beginning_of_another_end_is_not_ours(tmp_path: Path) -> None:
    write_result(tmp_path / "R", identity_result(1))
    archive = tmp_path / "R" / ARRAYS
    assert is_own(archive)
    for content in (archive.read_bytes() + b"PK\x05\x06", b"", b"x"):
        archive.write_bytes(content)
        assert not is_own(archive)


def test_an_obj_and_its_materials_are_written_together(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also inside another block that writes files together."""
    red = replace(cube(), face_materials=np.zeros(6, np.int64), material_names=("red",))
    with all_or_nothing():
        write_mesh(tmp_path / "box.obj", red)
        assert not (tmp_path / "box.mtl").exists()
    before = [path.read_bytes() for path in sorted(tmp_path.iterdir())]
    assert len(before) == 2
    monkeypatch.setattr(obj_write, "write_whole", lambda *_, **__: fail_after(0, FormatError("full")))
    refuses(FormatError, "full", write_mesh, tmp_path / "box.obj", replace(red, material_names=("blue",)))
    assert [path.read_bytes() for path in sorted(tmp_path.iterdir())] == before


def test_a_permission_error_of_another_file_does_not_name_the_output(tmp_path: Path) -> None:
    denied = PermissionError(errno.EACCES, "Permission denied", "input.png")
    with pytest.raises(PermissionError), atomic_path(tmp_path / "a.txt"):
        fail_after(0, denied)
    with pytest.raises(PermissionError), atomic_folder(tmp_path / "r", NAMES):
        fail_after(0, denied)
    assert not list(tmp_path.iterdir())


def test_writing_does_not_change_the_umask(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another thread's files would get the changed one."""
    (tmp_path / "plain.txt").touch()
    monkeypatch.setattr(os, "umask", partial(fail_after, error=AssertionError))
    write_whole(tmp_path / "a.txt", "ours")
    assert (tmp_path / "a.txt").stat().st_mode == (tmp_path / "plain.txt").stat().st_mode


def test_an_earlier_file_that_was_removed_as_a_leftover_hides_no_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    honest = os.replace
    write_whole(tmp_path / "old.txt", f"{mark()} old")

    def replaced(temporary: Path, place: Path) -> None:
        if place.name == "last.txt":
            for kept in tmp_path.glob(".old.*"):
                kept.unlink()
            raise PermissionError(errno.EACCES, "in use")
        honest(temporary, place)

    def write_both() -> None:
        with all_or_nothing():
            for name in ("old.txt", "last.txt"):
                write_whole(tmp_path / name, f"{mark()} ours")

    monkeypatch.setattr(os, "replace", replaced)
    with pytest.raises(FormatError, match=r"last\.txt: cannot write there \(in use\)"):
        write_both()
