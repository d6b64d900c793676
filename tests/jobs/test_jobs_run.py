"""Running a plan: nothing twice, nothing half, and what fails costs only what needs it."""

import logging
import signal
import struct
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from cagemap.errors import ParameterError
from cagemap.files.atomic import write_whole
from cagemap.files.meshes.formats import referred_files
from cagemap.files.ownership import mark
from cagemap.files.result.manifest import file_hash, stated_inputs
from cagemap.jobs.plan import Plan, Task, content_hash
from cagemap.jobs.run import (
    TaskOutcome,
    _block_interrupts,
    _outcome_of,
    execute,
    kept_outcome,
    missing_tasks,
    open_client,
    run_plan,
)

from forked import forking
from library_runner import write_name


def task(
    root: Path, name: str, needs: tuple[str, ...] = (), kind: str = "match", key: str = "k", **request: Any
) -> Task:
    request |= {"root": str(root), "log": str(root / "log")}
    return Task(kind, name, key, needs, request, (f"{name}/out.txt",), (name, name))


def ran(root: Path) -> list[str]:
    log = root / "log"
    return log.read_text().splitlines() if log.exists() else []


@pytest.fixture
def forked_workers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Workers are forks of a process that has loaded what they need."""
    for module in ("nanny", "process"):
        monkeypatch.setattr(f"distributed.{module}.get_mp_context", forking)


def no_crew() -> Any:
    raise AssertionError("nobody is needed")


def test_a_task_is_done_once_and_kept(tmp_path: Path) -> None:
    one = task(tmp_path, "one")
    first, second = execute(one, tmp_path, write_name), execute(one, tmp_path, write_name)
    assert (first.state, second.state) == ("done", "kept")
    assert second.figures == {"said": "one"}
    assert ran(tmp_path) == ["one"]
    assert run_plan(Plan(tmp_path, (one,), ()), write_name, no_crew) == {"one": second}


def test_another_key_or_a_lost_output_means_that_it_is_done_again(tmp_path: Path) -> None:
    one = task(tmp_path, "one")
    execute(one, tmp_path, write_name)
    assert kept_outcome(tmp_path, task(tmp_path, "one", key="other")) is None
    (tmp_path / "one" / "out.txt").write_text("half")
    assert kept_outcome(tmp_path, one) is None
    assert execute(one, tmp_path, write_name).state == "done"
    (tmp_path / "one" / "out.txt").unlink()
    assert execute(one, tmp_path, write_name).state == "done"
    for note in (tmp_path / ".cagemap" / "done").iterdir():
        note.write_text('{"key": 3')
    assert kept_outcome(tmp_path, one) is None


def test_a_layer_to_which_another_task_adds_may_change_its_size(tmp_path: Path) -> None:
    one = replace(task(tmp_path, "one"), layer="one/out.txt")
    execute(one, tmp_path, write_name)
    write_whole(tmp_path / "one" / "out.txt", f"{mark()} more", force=True)
    assert kept_outcome(tmp_path, one) is not None
    with (tmp_path / "one" / "out.txt").open("a") as layer:
        layer.write("edited")
    assert kept_outcome(tmp_path, one) is None


def test_a_lost_layer_gets_the_results_of_all_its_tasks_again(tmp_path: Path) -> None:
    layer = tmp_path / "pair" / "look.usda"

    def add(one: Task) -> dict[str, Any]:
        before = layer.read_text().split("\n")[1:] if layer.is_file() else []
        write_whole(layer, "\n".join([mark(), *before, one.name]), force=True)
        return {}

    tasks = [replace(task(tmp_path, name), outputs=("pair/look.usda",), layer="pair/look.usda") for name in "ab"]
    assert [execute(one, tmp_path, add).state for one in tasks] == ["done", "done"]
    assert missing_tasks(Plan(tmp_path, tuple(tasks), ())) == []
    layer.unlink()
    assert missing_tasks(Plan(tmp_path, tuple(tasks), ())) == tasks
    assert [execute(one, tmp_path, add).state for one in tasks] == ["done", "done"]
    assert layer.read_text().split("\n")[1:] == ["a", "b"]


def gltf(file: str, stated: str) -> bytes:
    text = f'{{"buffers": [{{"uri": "{stated}"}}, {{"uri": "data:,{"x" * 2000}"}}]}}'.encode()
    return (b"" if file == "a.gltf" else struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text), len(text), b"JSON")) + text


def fbx(stated: str) -> bytes:
    name = stated.encode()
    head = b"Kaydara FBX Binary  \0" + bytes(range(256)) + b"S" + bytes([len(name), 0, 0, 0])
    return head + name + b"S" + 400 * b"n" + b".png"


LAYERS = b"""#usda 1.0
def Xform "a" (\n references = @b.usda@</b>\n payload = @c.usda@</c>\n)
{
    def Shader "s" {\nasset inputs:a = @./skin.<UDIM>.png@\nasset inputs:b = @eye.png@\n}
}
"""
REFERRED = [
    ("a.obj", b"mtllib other part.mtl\nv 0 0 0\n", ["other part.mtl"]),
    ("a.usda", b"#usda 1.0\n(\n    subLayers = [@./other.usda@]\n)\n", ["other.usda"]),
    ("a.usda", LAYERS, ["b.usda", "c.usda", "skin.1002.png", "eye.png"]),
    ("a.fbx", fbx("C:\\work\\häute\\skin 1.PNG"), ["skin 1.PNG"]),
    ("a.fbx", fbx("C:/skin.tga"), ["textures/skin.tga"]),
    ("a.fbx", fbx("maps/a.jpg"), ["maps/a.jpg"]),
    *(
        (file, gltf(file, stated), ["größe 1.bin"])
        for file in ("a.gltf", "a.glb", "a.VRM")
        for stated in (r"gr\u00f6\u00dfe 1.bin", "gr%C3%B6%C3%9Fe%201.bin", r"maps\\..\/größe 1.bin")
    ),
]


@pytest.mark.parametrize(("file", "content", "others"), REFERRED, ids=lambda value: str(value)[:30])
def test_hashes_of_a_mesh_follow_each_file_that_it_names(file, content, others, tmp_path):
    if file == "a.usda":
        pytest.importorskip("pxr.Usd", reason="usd-core is not installed")
    (tmp_path / "maps").mkdir()
    (tmp_path / file).write_bytes(content)

    def hashes(changed: str = "") -> set[str]:
        for other in others:
            (tmp_path / other).parent.mkdir(exist_ok=True)
            (tmp_path / other).write_text("#usda 1.0\n" + ("# changed\n" if other == changed else ""))
        hashed = {content_hash(str(tmp_path / file))}
        if content.startswith((b"glTF", b"{")):
            hashed.add(stated_inputs({"m": tmp_path / file}, tmp_path)["m"]["sha256"])
        return hashed

    before = hashes()
    assert not [other for other in others if before & hashes(other)]


def test_a_gltf_that_is_cut_short_or_gone_names_no_files(tmp_path: Path) -> None:
    for file in (tmp_path / "a.gltf", tmp_path / "a.glb"):
        file.write_bytes(gltf(file.name, "a.bin")[:19])  # its reader says so
        assert content_hash(str(file))
        file.unlink()
        assert referred_files(file) == []


def test_a_usd_package_counts_by_its_own_content(tmp_path: Path) -> None:
    pytest.importorskip("pxr.Usd", reason="usd-core is not installed")
    from pxr import UsdUtils

    (tmp_path / "a.usda").write_text('#usda 1.0\ndef "b" {\n}\n')
    assert UsdUtils.CreateNewUsdzPackage(str(tmp_path / "a.usda"), str(tmp_path / "a.usdz"))
    assert content_hash(str(tmp_path / "a.usdz")) == f"a.usdz {file_hash(tmp_path / 'a.usdz')}"


def test_what_came_of_a_file_that_changed_meanwhile_is_not_kept(tmp_path: Path) -> None:
    mesh = tmp_path / "cow.obj"
    mesh.write_text("as it was planned")
    one = replace(task(tmp_path, "one"), input_hashes={str(mesh): content_hash(str(mesh))})
    assert execute(one, tmp_path, write_name).state == "done"

    def save_meanwhile(task: Task) -> dict[str, Any]:
        mesh.write_text("as it is now")
        return write_name(task)

    outcome = execute(replace(one, key="another"), tmp_path, save_meanwhile)
    assert (outcome.state, outcome.message.partition(":")[0]) == ("failed", str(mesh))
    # Nor is what it replaced.
    assert kept_outcome(tmp_path, one) is None


def test_what_a_pattern_or_a_folder_became_is_noted(tmp_path: Path) -> None:
    """`skin.png` is written as several files, shapes as a folder; the notes of a RESULT are not the task's own."""
    many = task(tmp_path, "one", files=["one/skin_a.png", "one/skin_b.png", "one/RESULT/manifest.json"])
    (tmp_path / "one" / "RESULT").mkdir(parents=True)
    assert execute(many, tmp_path, write_name).files == ("one/skin_a.png", "one/skin_b.png")
    (tmp_path / "one" / "RESULT" / "manifest.json").write_text("another task's note")
    assert execute(many, tmp_path, write_name).state == "kept"
    (tmp_path / "one" / "skin_b.png").unlink()
    assert execute(many, tmp_path, write_name).state == "done"
    nothing = task(tmp_path, "none", files=[])
    assert "none was written" in execute(nothing, tmp_path, write_name).message


def test_folders_of_outputs_are_made(tmp_path: Path) -> None:
    outputs = ("pair/albedo/skin.png", "../beside/points.json")
    one = replace(task(tmp_path / "out", "one"), outputs=outputs)
    (tmp_path / "out").mkdir()
    made = execute(one, tmp_path / "out", write_name)
    assert made.files == outputs
    result = replace(task(tmp_path / "out", "two"), outputs=("two/RESULT/map.npz",))
    failed = execute(result, tmp_path / "out", lambda _: {})
    assert (made.state, failed.state) == ("done", "failed")
    assert all(0 < outcome.seconds < 60 for outcome in (made, failed))
    assert (tmp_path / "out" / "two").is_dir()
    assert not (tmp_path / "out" / "two" / "RESULT").exists()


def test_a_task_that_only_comes_after_a_failed_one_is_done(tmp_path: Path) -> None:
    failed = TaskOutcome("one", "failed", "no texture")
    assert execute(replace(task(tmp_path, "two"), predecessors=("one",)), tmp_path, write_name, failed).state == "done"
    assert execute(task(tmp_path, "three", ("one",)), tmp_path, write_name, failed).state == "skipped"


def test_a_table_of_an_earlier_run_is_replaced_unless_edited(tmp_path: Path) -> None:
    def write_table(told: Task) -> dict[str, Any]:
        write_whole(tmp_path / "one" / "out.txt", told.key, force=told.request.get("force", False))
        if told.key == "bad":
            raise ParameterError("bad")
        return {}

    table = tmp_path / "one" / "out.txt"
    for key, state in (("k", "done"), ("changed", "done"), ("bad", "failed")):
        assert execute(task(tmp_path, "one", key=key), tmp_path, write_table).state == state
        assert table.read_text() == key
    table.write_text("changed")  # as the last finished run left it
    assert execute(task(tmp_path, "one", key="mended"), tmp_path, write_table).state == "done"
    table.write_text("edited")
    edited = execute(task(tmp_path, "one", key="again"), tmp_path, write_table)
    assert edited.state == "failed"
    assert edited.failure["remedy"] == "Give another name, or move it away."  # `cagemap run` has no --force
    assert table.read_text() == "edited"
    table.write_text("mended")  # as the last finished run left it, but a further output is there already
    (tmp_path / "one" / "more.txt").write_text("foreign")
    more = replace(task(tmp_path, "one", key="more"), outputs=("one/out.txt", "one/more.txt"))
    assert execute(more, tmp_path, write_table).state == "failed"
    assert table.read_text() == "mended"


@pytest.mark.parametrize(
    ("trouble", "words", "code"),
    [
        ("bad mesh", "expected a mesh", "format"),
        ("bug", "internal error, KeyError", "internal"),
        ("full disk", "No space left", "system"),
    ],
)
def test_a_failure_is_an_outcome_and_leaves_no_note(tmp_path: Path, trouble: str, words: str, code: str) -> None:
    one = task(tmp_path, "one", trouble=trouble)
    outcome = execute(one, tmp_path, write_name)
    assert outcome.state == "failed"
    assert words in outcome.message
    assert outcome.code == outcome.failure["code"] == code
    assert str(outcome).startswith(f"one: failed ({code}): ")
    assert kept_outcome(tmp_path, one) is None
    after = execute(task(tmp_path, "two", needs=("one",)), tmp_path, write_name, outcome)
    assert after.state == "skipped"
    assert "one" in after.message
    assert ran(tmp_path) == ["one"]


def test_two_runs_at_once_do_a_task_once(tmp_path: Path) -> None:
    one = task(tmp_path, "one", sleep=0.3)
    barrier = threading.Barrier(2)

    def run(_: int) -> TaskOutcome:
        barrier.wait()
        return execute(one, tmp_path, write_name)

    with ThreadPoolExecutor(2) as pool:
        states = sorted(outcome.state for outcome in pool.map(run, range(2)))
    assert states == ["done", "kept"]
    assert ran(tmp_path) == ["one"]


def test_leftovers_of_a_killed_run_are_removed_and_a_user_s_files_are_not(tmp_path: Path) -> None:
    folder = tmp_path / "one"
    (tmp_path / ".one.k2_ab8xz.part").mkdir(parents=True)
    folder.mkdir()
    (folder / ".out.x7c9_d0e.part.txt").write_text("half")
    (folder / "thesis.tex").write_text("mine")
    (folder / ".out.old.parts").mkdir()  # nearly such a name
    (folder / ".out.old.parts" / "photo.raw").write_text("mine")
    (folder / ".out.mine.part.txt").write_text("mine")
    execute(task(tmp_path, "one"), tmp_path, write_name)
    assert sorted(path.name for path in folder.iterdir()) == [
        ".out.mine.part.txt",
        ".out.old.parts",
        "out.txt",
        "thesis.tex",
    ]
    assert (folder / ".out.old.parts" / "photo.raw").read_text() == "mine"
    assert not (tmp_path / ".one.k2_ab8xz.part").exists()


def test_preparations_of_what_is_done_are_not_repeated(tmp_path: Path) -> None:
    prepare, match = task(tmp_path, "prepare", kind="prepare"), task(tmp_path, "match", ("prepare",))
    plan = Plan(tmp_path, (prepare, match), (("match", "match"),))
    assert [t.name for t in missing_tasks(plan)] == ["prepare", "match"]
    execute(match, tmp_path, write_name)
    assert missing_tasks(plan) == []


@pytest.mark.slow
@pytest.mark.usefixtures("forked_workers")
def test_dead_workers_and_bad_tasks_cost_only_what_needs_them(tmp_path: Path) -> None:
    tasks = (
        task(tmp_path, "good"),
        task(tmp_path, "unlucky", trouble="die once"),
        task(tmp_path, "deadly", trouble="die"),
        task(tmp_path, "bad", trouble="bad mesh"),
        *(task(tmp_path, f"after-{name}", (name,)) for name in ("good", "unlucky", "deadly", "bad")),
    )
    finished: list[str] = []
    with open_client(workers=2) as connect:
        outcomes = run_plan(
            Plan(tmp_path, tasks, ()), write_name, connect, lambda outcome, done, total: finished.append(outcome.name)
        )
    states = {name: outcome.state for name, outcome in outcomes.items()}
    expected = {"good": "done", "unlucky": "done", "deadly": "failed", "bad": "failed"}
    after = {"done": "done", "failed": "skipped"}
    assert states == expected | {f"after-{name}": after[state] for name, state in expected.items()}
    assert "worker died" in outcomes["deadly"].message
    assert outcomes["deadly"].failure["place"] == ""
    assert sorted(finished) == sorted(states)


@pytest.mark.slow
@pytest.mark.usefixtures("forked_workers")
def test_what_waits_on_a_worker_that_dies_is_not_blamed_for_it(tmp_path: Path) -> None:
    import dask

    tasks = (task(tmp_path, "deadly", trouble="die"), *(task(tmp_path, f"good-{k}") for k in range(3)))
    # All wait on the one that dies; of workers that start as fast as forks do, Dask seldom blames the others.
    slow_start = {"distributed.worker.preload": ["import time; time.sleep(4)"]}
    with dask.config.set(slow_start), open_client(workers=1) as connect:
        outcomes = run_plan(Plan(tmp_path, tasks, ()), write_name, connect)
    assert {name: outcome.state for name, outcome in outcomes.items()} == {
        "deadly": "failed",
        "good-0": "done",
        "good-1": "done",
        "good-2": "done",
    }


def test_an_outcome_that_is_lost_with_its_worker_is_none() -> None:
    from distributed import KilledWorker

    last_worker: Any = None

    def fetched() -> TaskOutcome:
        raise KilledWorker("one", last_worker, 3)

    assert _outcome_of(SimpleNamespace(status="finished", result=fetched)) is None


@pytest.mark.slow
@pytest.mark.usefixtures("forked_workers")
def test_a_worker_that_nobody_starts_again_is_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cagemap.jobs.run.LOST_WORKER_SECONDS", 1)
    with open_client(workers=1) as connect:
        client = connect()
        client.sync(client.cluster.workers[0].close)
        outcomes = run_plan(Plan(tmp_path, (task(tmp_path, "one"),), ()), write_name, connect)
    assert outcomes["one"].state == "done"


def test_the_dashboard_s_address_is_told_and_workers_share_the_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    import distributed
    from distributed.system import MEMORY_LIMIT

    asked: dict[str, Any] = {"callbacks": {}}

    @contextmanager
    def cluster(**options: Any) -> Iterator[SimpleNamespace]:
        asked.update(options)
        yield SimpleNamespace(periodic_callbacks=asked["callbacks"])

    @contextmanager
    def client(cluster: SimpleNamespace) -> Iterator[SimpleNamespace]:
        yield SimpleNamespace(
            dashboard_link="http://127.0.0.1:4321/status", loop=SimpleNamespace(add_callback=lambda started: None)
        )

    monkeypatch.setattr(distributed, "LocalCluster", cluster)
    monkeypatch.setattr(distributed, "Client", client)
    bokeh = ModuleType("bokeh")
    bokeh.__spec__ = ModuleSpec("bokeh", None)
    monkeypatch.setitem(sys.modules, "bokeh", bokeh)
    told: list[str] = []
    with open_client(None, 3, told.append) as connect:
        assert not told
        connect()
        connect()
    assert told == ["Dask's dashboard: http://127.0.0.1:4321/status"]
    assert list(asked["callbacks"]) == ["replace lost workers"]
    assert asked["n_workers"] * asked["memory_limit"] == pytest.approx(MEMORY_LIMIT, abs=3)
    assert asked["silence_logs"] == logging.CRITICAL  # in workers too: outcomes say what went wrong


@pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="Windows has no signal masks")
def test_workers_inherit_that_ctrl_c_is_blocked() -> None:
    with ThreadPoolExecutor(1) as thread:
        thread.submit(_block_interrupts).result()
        assert signal.SIGINT in thread.submit(signal.pthread_sigmask, signal.SIG_BLOCK, ()).result()
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())


def test_an_interrupted_start_of_dask_has_nothing_to_close_at_exit(monkeypatch: pytest.MonkeyPatch) -> None:
    import distributed
    from distributed.deploy.spec import close_clusters

    def interrupted(**_: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(distributed, "LocalCluster", interrupted)
    left_out: list[object] = []
    monkeypatch.setattr("atexit.unregister", left_out.append)
    with pytest.raises(KeyboardInterrupt), open_client(None, 1) as connect:
        connect()
    assert left_out == [close_clusters]
