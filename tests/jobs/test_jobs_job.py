"""Job files: every mistake at once, with its line; and the plan that a right one leads to."""

from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from examples.shapes import cube, icosahedron, torus

from cagemap.errors import FormatError, InvalidMeshError
from cagemap.files.meshes.formats import write_mesh
from cagemap.jobs.job import read_job
from cagemap.jobs.job_checks import find_line
from cagemap.jobs.job_schema import Scheme
from cagemap.jobs.plan import Plan, Task, plan_job
from cagemap.jobs.tree import shape_distribution, spanning_tree
from cagemap.mesh.schemes import SCHEMES
from cagemap.tasks.requests.catalogue import COMMANDS, WRITTEN

from job_text import table
from refusals import refuses

HEAD = 'output = "out"\n[options]\nvertices = 500\n'
ASSETS = "".join(table("assets", name=name, file=f"{name}.obj") for name in "abc")
PAIR, PAIRS = table("pairs", source="a", target="b"), table("pairs", source="all", target=["a", "b"])


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, mesh in (("a", cube()), ("b", torus()), ("c", icosahedron())):
        write_mesh(tmp_path / f"{name}.obj", mesh)
    (tmp_path / "a.png").write_bytes(b"not read here")
    return tmp_path


def plan_of(folder: Path, text: str, version: str = "1") -> Plan:
    (folder / "job.toml").write_text(text)
    return plan_job(read_job(folder / "job.toml", COMMANDS, WRITTEN), version, spanning_tree)


MISTAKES = """output = "out"
[options]
vertexes = 500  # options.vertexes: there is no such entry. Check its spelling, or remove it.
vertices = "many"  # options.vertices: expected a whole number, got 'many'. Correct it.
level = -5  # options.level: expected 1 or more, got -5. Correct it.
[[assets]]
name = "a"
file = "a.obj"
scheme = "quads"  # assets.0.scheme: expected 'catmull-clark', 'loop', 'bilinear' or 'none', got 'quads'. Correct it.
[[assets]]
name = "a"  # assets.1.name: 'a' is taken. Give another name.
file = "gone.obj"  # assets.1.file: gone.obj does not exist. Check the path.
[[pairs]]
source = "a"
target = "zebra"  # pairs.0.target: no asset is called 'zebra'. Check the name, or add it.
landmark = "typo.json"  # pairs.0.landmark: there is no such entry. Check its spelling, or remove it.
[[outputs]]
command = "transfer"
texture = "gone.png"  # outputs.0.texture: gone.png does not exist. Check the path.
maps = [["x", "{source.typo}"]]  # outputs.0.maps: no asset has a file 'typo' for {source.typo}.
bits = 17  # outputs.0.bits: expected 8, 16 or 32, got 17. Correct it.
size = 0  # outputs.0.size: expected 1 or more, got 0. Correct it.
space = "world"  # outputs.0.space: expected 'tangent' or 'object', got 'world'. Correct it.
result = "a.obj"  # outputs.0.result: there is no such entry. Check its spelling, or remove it.
[[outputs]]
command = "report"
output = "../a.html"  # outputs.1.output: expected a name inside the pair's folder, got '../a.html'.
"""
UNKNOWN = "command = 'raport'  # outputs.2.command: expected 'transfer', 'wrap' or 'report', got 'raport'.\n"


def refusal(folder: Path, text: str) -> list[str]:
    with pytest.raises(FormatError) as caught:
        plan_of(folder, text)
    return str(caught.value).splitlines()


def test_all_problems_are_named_at_once_with_their_lines(folder: Path) -> None:
    def listed(text: str) -> list[str]:
        lines = (line.partition("  # ")[2] for line in text.splitlines())
        return [f"  line {number}: {words}" for number, words in enumerate(lines, 1) if words]

    def check(found: list[str], expected: list[str]) -> None:
        for line, words in zip(found, expected, strict=True):
            assert line.startswith(words)

    head, *found = refusal(folder, MISTAKES)
    check(found, listed(MISTAKES))
    assert head.endswith(f"{len(found)} problems; nothing was started.")
    assert not (folder / "out").exists()
    text = f"{MISTAKES}[[outputs]]\n{UNKNOWN}"  # an unknown command hides problems, but only those of outputs
    shown = [line for line in listed(text) if ": outputs." not in line or ".command: " in line]
    check(refusal(folder, text)[1:], shown)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("output = 3\n" + ASSETS + PAIRS, "line 1: output"),
        ("output = 'out'\nassets = []\n" + PAIRS, "assets"),
        (HEAD + ASSETS + "[[pairs]]\nsource = 'a'\n", "expected both source and target"),
        (HEAD + ASSETS + "[[pairs]]\nsource = 'a'\ntarget = 'b'\ntree = 'all'\n", "source and target, or tree"),
        (HEAD + ASSETS.replace('"a"', '"../a"') + PAIRS, "name"),
        ("output = ", "TOML"),
        (HEAD.replace('"out"', '"a.obj"') + ASSETS + PAIRS, "got the file a.obj"),
        (HEAD + ASSETS.replace("a.obj", "n" * 300) + PAIRS, r"assets\.0\.file: n+ does not exist"),
        (
            HEAD + ASSETS + PAIRS + table("outputs", command="transfer", texture="n" * 300),
            r"outputs\.0\.texture: n+ does not exist",
        ),
        (
            HEAD.replace('"out"', f"'out/{'n' * 300}'") + ASSETS + PAIRS,
            "line 1: output: .* is too long. Give a shorter",
        ),
        (f"{HEAD}{ASSETS}{PAIRS}[carry]\nsource = 'a'\nfolder = 'a.obj'\n", r"carry\.folder: .* got the file a\.obj"),
        (f"{HEAD}{ASSETS}{PAIRS}[carry]\nsource = 'a'\nfolder = '{'ä' * 130}'\n", r"carry\.folder: .* is too long"),
        (
            HEAD + ASSETS + PAIRS + table("outputs", command="report", output="n" * 240 + "{target}.html"),
            r"outputs\.0\.output: .* is too long",
        ),
        (f"{HEAD}{ASSETS}{PAIRS}{PAIR}options = {{ method = 'hfm' }}\n", "asked for twice"),
        *(
            (HEAD + ASSETS + rule, r"pairs\.0: expected two different assets, got 'a' alone")
            for rule in (table("pairs", source="a", target=["a"]), table("pairs", tree=["a", "a"]))
        ),
        (
            HEAD + ASSETS + PAIRS + table("outputs", command="wrap", map="a.png"),
            r"outputs\.0\.map: there is no such entry",
        ),
    ],
)
def test_files_of_another_form_are_refused(folder: Path, text: str, words: str) -> None:
    refuses(FormatError, words, plan_of, folder, text)


def test_a_missing_job_file_is_named(tmp_path: Path) -> None:
    (tmp_path / "empty.toml").touch()
    refuses(FormatError, "assets: is missing", read_job, tmp_path / "empty.toml", COMMANDS)
    refuses(FormatError, "expected a job file, there is no such file", read_job, tmp_path / "job.toml", COMMANDS)


def test_missing_files_of_options_are_named_from_the_job_s_own_folder(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = HEAD + ASSETS + PAIRS + table("outputs", command="transfer", weights="gone.csv")
    (folder / "job.toml").write_text(text, encoding="utf-8")
    monkeypatch.chdir(folder)
    refuses(FormatError, r"outputs\.0\.weights: gone\.csv does not exist", read_job, "job.toml", COMMANDS)


def test_files_are_beside_the_file_that_a_linked_job_file_points_to(folder: Path, tmp_path_factory) -> None:
    (folder / "job.toml").write_text(HEAD + ASSETS + PAIRS, encoding="utf-8")
    link = tmp_path_factory.mktemp("elsewhere") / "night.toml"
    link.symlink_to(folder / "job.toml")
    job = read_job(link, COMMANDS)
    assert (job.assets["a"].file, job.output) == (folder / "a.obj", folder / "out")


def test_a_job_file_may_begin_with_a_byte_order_mark(folder: Path) -> None:
    (folder / "job.toml").write_text(HEAD + ASSETS + PAIRS, encoding="utf-8-sig")
    assert read_job(folder / "job.toml", COMMANDS).output == folder / "out"


def test_a_job_file_that_may_not_be_read_is_named(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(path: Path, **_: object) -> None:
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(Path, "stat", refuse)
    refuses(FormatError, r"cannot be read.*Check its permissions", read_job, folder / "job.toml", COMMANDS)


def test_lines_are_found_in_nested_tables() -> None:
    text = "a = 1\n[b.c]\nd = 2\n[[e]]\nf = 3\n[[e]]\n[e.g]\nh = 4\n"
    lines = {
        ("a",): 1,
        ("b", "c", "d"): 3,
        ("e", 0, "f"): 5,
        ("e", 0, "f", "deeper"): 5,
        ("e", 1): 6,
        ("e", 1, "g", "h"): 8,
    }
    assert {place: find_line(text, place) for place in lines} == lines


def test_every_surface_is_prepared_once_and_every_pair_matched_after(folder: Path) -> None:
    plan = plan_of(folder, HEAD + ASSETS + PAIRS)
    assert set(plan.pairs) == {("b", "a"), ("c", "a"), ("a", "b"), ("c", "b")}
    kinds = [task.kind for task in plan.tasks]
    assert (kinds.count("prepare"), kinds.count("match")) == (3, 4)
    seen: set[str] = set()
    for task in plan.tasks:
        assert set(task.needs) <= seen
        seen.add(task.name)
    assert len(seen) == len(plan.tasks)
    assert all(task.request["vertices"] == 500 for task in plan.tasks if task.kind == "match")


def test_files_beside_an_output_go_to_the_pair_and_a_report_comes_last(folder: Path) -> None:
    text = HEAD + ASSETS + PAIR + table("outputs", command="report")
    text += table("outputs", command="wrap", output="w.obj", displacement="{target}.exr")
    text += table("outputs", command="wrap", output="v.obj")
    tasks = [task for task in plan_of(folder, text).tasks if task.kind in ("wrap", "report")]
    assert [task.outputs for task in tasks] == [
        ("a__b/w.obj", "a__b/b.exr"),
        ("a__b/v.obj",),
        ("a__b/report.html",),
    ]
    assert tasks[0].request["displacement"] == str(folder / "out" / "a__b" / "b.exr")
    assert [task.predecessors for task in tasks] == [(), (tasks[0].name,), (tasks[1].name,)]
    refuses(FormatError, r"two outputs of a -> b write a__b/b\.exr", plan_of, folder, text.replace("v.obj", "b.exr"))
    refuses(FormatError, "expected a name inside the pair", plan_of, folder, text.replace("{target}.exr", "../b.exr"))


def test_outputs_of_a_pair_may_add_to_one_layer(folder: Path) -> None:
    text = HEAD + ASSETS + PAIR
    for output in ("color", "height"):
        text += table("outputs", command="transfer", output=f"{output}.png", usd="layers/{target}.usda")
    tasks = [task for task in plan_of(folder, text).tasks if task.kind == "transfer"]
    assert [task.outputs[1] for task in tasks] == 2 * ["a__b/layers/b.usda"]
    assert [task.layer for task in tasks] == 2 * ["a__b/layers/b.usda"]
    with pytest.raises(FormatError, match=r"two outputs of a -> b write a__b/layers/b\.usda"):
        plan_of(folder, text + table("outputs", command="wrap", output="layers/b.usda"))
    words = r"two outputs of a -> b write a__b/layers/b\.usdc\. .*\.usda"
    refuses(FormatError, words, plan_of, folder, text.replace(".usda", ".usdc"))
    text = HEAD + ASSETS + PAIR + table("outputs", command="transfer", output="a.png", usd="b.usdc")
    text += table("outputs", command="wrap", output="b.usdc")  # no layer to which it adds
    refuses(FormatError, r"write a__b/b\.usdc\. Rename one\.$", plan_of, folder, text)


def test_outputs_go_to_the_pairs_that_have_what_they_ask_for(folder: Path) -> None:
    assets = ASSETS.replace('file = "a.obj"', 'file = "a.obj"\nfiles = { color = "a.png" }')
    output = table("outputs", command="transfer", texture="{source.color}", output="{target}.png")
    plan = plan_of(folder, HEAD + assets + PAIRS + output)
    baked = [task for task in plan.tasks if task.kind == "transfer"]
    assert [task.outputs for task in baked] == [("a__b/b.png",)]
    assert baked[0].request["texture"] == str(folder / "a.png")
    assert len(plan.omitted_outputs) == 3
    refuses(FormatError, "two outputs of", plan_of, folder, HEAD + assets + PAIRS + 2 * output)
    with pytest.raises(FormatError, match="two outputs of"):
        plan_of(folder, HEAD + assets + PAIRS + output + output.replace('"{target}.png"', '"./{target}.png"'))
    elsewhere = output.replace("{target}.png", "more/{target}.png")
    tasks = plan_of(folder, HEAD + assets + PAIRS + output + elsewhere).tasks
    names = [task.name for task in tasks if task.kind == "transfer"]
    assert names == ["transfer a -> b: b.png", "transfer a -> b: more/b.png"]
    with pytest.raises(FormatError, match=r"is called picture\.jpg"):
        plan_of(folder, HEAD + assets + PAIRS + output.replace("{target}.png", "picture.jpg"))


def test_keys_follow_content_options_and_code_and_nothing_else(folder: Path) -> None:
    output = '[[outputs]]\ncommand = "report"\n'
    text = HEAD + ASSETS + PAIRS + output

    def keys(text: str, version: str = "1") -> dict[tuple[str, ...], str]:
        tasks = plan_of(folder, text, version).tasks
        return {(task.kind, *(task.pair or (task.request["asset"],))): task.key for task in tasks}

    before = keys(text)
    assert keys(text) == before
    assert not set(keys(text, "2").values()) & set(before.values())
    assert not set(keys(text.replace("500", "600")).values()) & set(before.values())
    content = (folder / "c.obj").read_text()
    (folder / "c.obj").write_text("# another byte\n" + content)
    after = keys(text)
    assert {name for name in before if before[name] != after[name]} == {name for name in before if "c" in name}


def test_tasks_know_the_files_that_they_are_given(folder: Path) -> None:
    plan = plan_of(folder, HEAD + ASSETS + PAIRS)
    for task in plan.tasks:
        given = [value for value in task.request.values() if isinstance(value, str) and Path(value).is_file()]
        assert set(task.input_hashes) == set(given)
    assert any(task.input_hashes for task in plan.tasks if task.kind == "match")


@pytest.mark.parametrize(
    ("names", "pairs"),
    [
        (("man", "man__a", "a__b", "b"), (("man", "a__b"), ("man__a", "b"))),
        (("Man", "man__a", "a__b", "b"), (("Man", "a__b"), ("man__a", "b"))),
    ],
)
def test_pairs_that_would_share_a_folder_are_refused(names, pairs, folder):
    text = HEAD + "".join(f'[[assets]]\nname = "{name}"\nfile = "a.obj"\n' for name in names)
    text += "".join(f'[[pairs]]\nsource = "{source}"\ntarget = "{target}"\n' for source, target in pairs)
    shown = [f"{source} -> {target}" for source, target in pairs]
    refuses(FormatError, f"{shown[0]} and {shown[1]} would be written to one folder", plan_of, folder, text)


def test_assets_whose_names_differ_only_in_capitals_are_refused(folder: Path) -> None:
    text = HEAD + ASSETS.replace('"b"', '"A"') + '[[pairs]]\nsource = "a"\ntarget = "A"\n'
    refuses(FormatError, r"assets\.1\.name: 'A' is taken", plan_of, folder, text)


def test_a_tree_joins_all_along_shapes_that_are_alike(folder: Path) -> None:
    write_mesh(folder / "d.obj", cube())
    text = HEAD + ASSETS + '[[assets]]\nname = "d"\nfile = "d.obj"\n[[pairs]]\ntree = "all"\n'
    pairs = set(plan_of(folder, text).pairs)
    assert len(pairs) == 6
    assert {("a", "d"), ("d", "a")} <= pairs
    assert {(b, a) for a, b in pairs} == pairs
    assert set(plan_of(folder, text.replace('"all"', '["a", "a", "d"]')).pairs) == {("a", "d"), ("d", "a")}


def test_shapes_are_compared_whatever_their_place_and_size() -> None:
    mesh = torus()
    moved = type(mesh)(**{**mesh.__dict__, "positions": 7.0 * mesh.positions[:, [2, 0, 1]] + 3.0})
    assert abs(shape_distribution(mesh) - shape_distribution(moved)).max() < 1e-9
    assert abs(shape_distribution(mesh) - shape_distribution(cube())).mean() > 0.02


def test_a_mesh_without_area_is_no_part_of_a_tree() -> None:
    flat = cube().with_positions(np.zeros((8, 3)))
    refuses(InvalidMeshError, "faces with an area", shape_distribution, flat)


def test_relative_files_start_from_the_job_file(folder: Path) -> None:
    (folder / "textures").mkdir()
    (folder / "textures" / "c.png").write_bytes(b"not read here")
    output = '[[outputs]]\ncommand = "transfer"\ntexture = "textures/{source}.png"\noutput = "{target}.png"\n'
    plan = plan_of(folder, HEAD + ASSETS + PAIRS + output)
    textures = {task.request["texture"] for task in plan.tasks if task.kind == "transfer"}
    assert str(folder / "textures" / "c.png") in textures


@pytest.mark.parametrize("prefix", ["", "not:"])
def test_a_mask_is_a_file_beside_the_job_and_counts_by_its_content(folder: Path, prefix: str) -> None:
    def match(text: str) -> Task:
        return next(task for task in plan_of(folder, text).tasks if task.kind == "match")

    text = HEAD + f'target_mask = "{prefix}m.csv"\nsource_mask = "object:head"\n' + ASSETS + PAIRS
    refuses(FormatError, r"options\.target_mask: .*m\.csv does not exist", match, text)
    (folder / "m.csv").write_text("1\n")
    before = match(text)
    assert before.request["target_mask"] == f"{prefix}{folder / 'm.csv'}"
    assert before.request["source_mask"] == "object:head"
    assert str(folder / "m.csv") in before.input_hashes
    (folder / "m.csv").write_text("0\n")
    assert match(text).key != before.key


def test_an_asset_has_a_scheme_of_its_own(folder: Path) -> None:
    def tasks(assets: str, pairs: str = PAIRS) -> list[Task]:
        return list(plan_of(folder, HEAD + assets + pairs).tasks)

    scan = ASSETS.replace('file = "b.obj"', 'file = "b.obj"\nscheme = "none"')
    before, after = tasks(ASSETS), tasks(scan)
    prepared = [task for task in after if task.kind == "prepare"]
    assert {task.request["asset"]: task.request["options"].get("scheme") for task in prepared} == {
        "a": None,
        "b": "none",
        "c": None,
    }
    assert len(prepared) == 3  # one surface of b, as target and as source
    known = {task.key for task in before}
    for task in after:
        assert (task.key not in known) == ("b" in (task.pair or (task.request["asset"],))), task.name
    asked = {task.pair: task.request for task in after if task.kind == "match"}
    assert (asked["a", "b"].get("source_scheme"), asked["a", "b"]["target_scheme"]) == (None, "none")
    assert (asked["b", "a"]["source_scheme"], asked["b", "a"].get("target_scheme")) == ("none", None)
    said = [task for task in tasks(scan, PAIRS + 'options = { target_scheme = "loop" }\n') if task.kind == "match"]
    assert {task.request["target_scheme"] for task in said} == {"loop"}


def test_a_part_of_a_pair_takes_precedence_over_that_of_an_asset(folder: Path) -> None:
    assets = ASSETS.replace('file = "b.obj"', 'file = "b.obj"\npart = "body"')
    plan = plan_of(folder, HEAD + assets + PAIRS + 'options = { target_part = "head" }\n')
    asked = {task.pair: task.request for task in plan.tasks if task.kind == "match"}
    assert asked["a", "b"]["target_part"] == "head"
    assert (asked["b", "a"]["source_part"], asked["b", "a"]["target_part"]) == ("body", "head")


@pytest.mark.parametrize(
    "option", ['laplacian = "alexa-wardetzky"', "target_accuracy = 1e-4", 'parameter = ["search_vertices=900"]']
)
def test_what_changes_a_basis_is_prepared(folder: Path, option: str) -> None:
    tasks = plan_of(folder, HEAD + f"{option}\n" + ASSETS + PAIRS).tasks
    name = option.split()[0]
    assert any(name in task.request["options"] for task in tasks if task.kind == "prepare")


def test_schemes_of_assets_are_those_of_meshes() -> None:
    assert get_args(Scheme) == tuple(SCHEMES)


@pytest.mark.parametrize("name", ["a.%(UDIM)d.png", "a.<UDIM>.png"])
def test_tiles_are_files_of_an_asset_and_count_by_their_content(folder: Path, name: str) -> None:
    text = HEAD + ASSETS.replace('"a.obj"', f'"a.obj"\nfiles = {{ color = "{name}" }}') + PAIRS
    text += '[[outputs]]\ncommand = "transfer"\ntexture = "{source.color}"\noutput = "t.png"\n'
    refuses(FormatError, r"assets\.0\.files\.color: .* does not exist", plan_of, folder, text)
    keys = []
    for content in (b"one", b"two"):
        (folder / "a.1002.png").write_bytes(content)
        keys.append(next(task.key for task in plan_of(folder, text).tasks if task.kind == "transfer"))
    assert keys[0] != keys[1]


def test_shapes_of_a_folder_count_by_name_and_content(folder: Path) -> None:
    text = HEAD + ASSETS + PAIRS + '[[outputs]]\ncommand = "transfer"\nblend_shapes = ["shapes"]\noutput = "s.npz"\n'
    (folder / "shapes").mkdir()
    keys = []
    for name, content in (("smile.obj", "v 0 0 0\n"), ("smile.obj", "v 0 0 1\n"), ("grin.obj", "v 0 0 1\n")):
        for file in (folder / "shapes").iterdir():
            file.unlink()
        (folder / "shapes" / name).write_text(content)
        keys.append(next(task.key for task in plan_of(folder, text).tasks if task.kind == "transfer"))
    assert len(set(keys)) == 3


def test_point_files_of_a_pair_take_precedence_over_landmarks_of_assets(folder: Path) -> None:
    assets = ASSETS.replace('.obj"', '.obj"\nlandmarks = "asset.json"')
    options = 'options = { target_points = "t.json", source_points = "s.json" }\n'
    for name in ("asset", "t", "s"):
        (folder / f"{name}.json").write_text("{}")
    (task, *_) = [task for task in plan_of(folder, HEAD + assets + PAIRS + options).tasks if task.kind == "match"]
    assert [Path(task.request[f"{side}_points"]).name for side in ("target", "source")] == ["t.json", "s.json"]
