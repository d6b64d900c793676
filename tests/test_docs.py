"""What the docs promise exists."""

from __future__ import annotations

import ast
import importlib
import inspect
import re
from pathlib import Path

import pytest
import typer

import cagemap
from cagemap.cli.app import app
from cagemap.errors import OPTIONS, in_options

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "src" / "cagemap"
ABOVE = ("cli", "studio", "library")  # rooms that know of the command line
PAPER_MAP = (ROOT / "docs" / "paper_map.md").read_text(encoding="utf-8")


def paper_map_rows() -> list[list[str]]:
    rows = [line.strip("| ").split(" | ") for line in PAPER_MAP.splitlines() if line.startswith("| ")]
    return [row for row in rows[1:] if not set(row[0]) <= {"-", " "}]


def find(path: str) -> object:
    """Import the longest prefix that is a module, then take attributes."""
    parts = path.split(".")
    for cut in range(len(parts), 0, -1):
        try:
            found: object = importlib.import_module(".".join(parts[:cut]))
        except ModuleNotFoundError:
            continue
        for name in parts[cut:]:
            found = getattr(found, name)
        return found
    raise ModuleNotFoundError(path)


@pytest.mark.parametrize("row", paper_map_rows(), ids=lambda row: row[0])
def test_paper_map_links_exist(row: list[str]) -> None:
    assert len(row) == 4, f"expected four cells: {row}"
    functions, tests = (re.findall(r"`([^`]+)`", cell) for cell in row[2:])
    assert functions
    assert tests
    for function in functions:
        assert find(function) is not None
    for test in tests:
        file, _, name = test.partition("::")
        text = (ROOT / file).read_text(encoding="utf-8")
        assert not name or re.search(rf"^def {name}\(", text, re.MULTILINE), f"{test} does not exist"


def test_paper_map_covers_every_equation_lemma_and_definition() -> None:
    numbers: set[int] = set()
    named: set[str] = set()
    for row in paper_map_rows():
        for first, last in re.findall(r"eqs?\. (\d+)(?:-(\d+))?", row[0]):
            numbers |= set(range(int(first), int(last or first) + 1))
        named |= set(re.findall(r"Lemma \d|Definition \d", row[0]))
    assert numbers == set(range(1, 17))
    assert named == {f"Lemma {i}" for i in range(1, 6)} | {f"Definition {i}" for i in range(1, 4)}


def test_the_public_names_are_one_list() -> None:
    """What can be imported, what `dir` shows, what type checkers see and what docs/api.md documents."""
    assert dir(cagemap) == list(cagemap.__all__)
    for name in cagemap.__all__:
        assert getattr(cagemap, name).__name__ == name
    seen_by_checkers = re.findall(
        r"^    from cagemap\.\S+ import (\w+) as \1$", inspect.getsource(cagemap), re.MULTILINE
    )
    assert sorted(seen_by_checkers) == list(cagemap.__all__)
    page = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")
    documented = re.findall(r"\.\. auto(?:function|class|exception):: cagemap\.(\w+)$", page, re.MULTILINE)
    assert sorted(documented) == list(cagemap.__all__)


def documents() -> list[Path]:
    return [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]


@pytest.mark.parametrize("document", documents(), ids=lambda path: path.name)
def test_links_between_documents_resolve(document: Path) -> None:
    text = document.read_text(encoding="utf-8")
    for link in re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", text):
        if "://" not in link:
            assert (document.parent / link).exists(), f"{document.name} links to {link}"


@pytest.mark.parametrize("document", documents(), ids=lambda path: path.name)
def test_every_command_option_is_documented_and_exists(document: Path) -> None:
    from typer.main import get_command

    options = {"--help", "--version"}
    names = set()
    root = get_command(app)
    options |= {option for parameter in root.params for option in parameter.opts}
    for name, command in root.commands.items():  # type: ignore[attr-defined]
        names.add(name)
        for parameter in command.params:
            options |= {*parameter.opts, *parameter.secondary_opts}
    text = document.read_text(encoding="utf-8")
    for command in re.findall(r"cagemap ([a-z]+) (?:-|RESULT|MESH|[A-Z\[])", text):
        assert command in names, f"{document.name} names `cagemap {command}`"
    if document.name == "cli.md":
        missing = {option for option in options if option.startswith("--") and option not in text}
        assert missing <= {"--symmetry", "--version"}, missing
        written = set(re.findall(r"(?<![\w-])--[a-z][a-z-]*", text))
        assert written <= options, written - options


@pytest.mark.parametrize("document", documents(), ids=lambda path: path.name)
def test_every_program_that_figures_come_from_is_there(document: Path) -> None:
    for module in re.findall(r"python -m (benchmarks[\w.]*|examples[\w.]*)", document.read_text(encoding="utf-8")):
        place = ROOT / module.rstrip(".").replace(".", "/")
        assert place.with_suffix(".py").exists() or (place / "__main__.py").exists(), f"{document.name}: {module}"


def command_lines() -> list[str]:
    """Lines of all documents that a reader may type, what is optional left out."""
    lines = []
    for document in documents():
        text = document.read_text(encoding="utf-8").replace("\\\n", " ")
        blocks = re.findall(r"^```\w*\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
        lines += [line for block in blocks for line in block.splitlines()]
        lines += re.findall(r"^    (\S.*)$", text, re.MULTILINE)
    typed = (re.sub(r"\[.*?\]|\.\.\.", "", line.split("#")[0]) for line in lines if line.startswith("cagemap "))
    return [" ".join(line.split()) for line in typed]


@pytest.mark.parametrize("line", command_lines())
def test_every_command_line_can_be_typed_as_it_stands(line: str) -> None:
    """No option is spelt wrongly, misses its value or has one too many, and no argument is missing."""
    commands, (name, *words) = typer.main.get_command(app).commands, line.split()[1:]  # type: ignore[attr-defined]
    if name in commands:  # options of the whole program come before the command
        commands[name].make_context(name, ["3" if word in ("L", "N") else word for word in words])


def test_the_architecture_names_every_file_of_the_maps_room() -> None:
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8").split("## Inside the maps room")[1]
    rooms = {path.parent.name for path in (ROOT / "src" / "cagemap" / "maps").glob("*/__init__.py")}
    for room in rooms:
        row = next(line for line in text.splitlines() if line.startswith(f"| `maps.{room}`"))
        files = {path.stem for path in (ROOT / "src" / "cagemap" / "maps" / room).glob("*.py")} - {"__init__"}
        assert files <= set(re.findall(r"`(\w+)`", row)), room
    above = text.split("| room |")[0]
    files = {path.stem for path in (ROOT / "src" / "cagemap" / "maps").glob("*.py")} - {"__init__"}
    assert files <= set(re.findall(r"`(\w+)`", above))


def stated_names(document: str) -> list[str]:
    """Names of files and of Python in a document's sentences and tables; formulas and commands have spaces or signs."""
    prose = re.sub(r"^```.*?^```$", "", (ROOT / document).read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    return [name for name in re.findall(r"`([^`\n]+)`", prose) if re.fullmatch(r"[\w./\[\]()=]+", name)]


def is_there(name: str, sources: str) -> bool:
    """Whether a file or folder, a path of names below the package or its maps room, or a name in it exists."""
    if "/" in name or name.endswith((".py", ".md")):
        return any((top / name).exists() for top in (ROOT, SOURCE)) or ("/" not in name and any(SOURCE.rglob(name)))
    plain = re.sub(r"[\[(].*", "", name).strip(".")
    if (ROOT / plain.replace(".", "/")).with_suffix(".py").exists():
        return True
    if plain.startswith("maps.") or plain.count(".") > 1:
        return any(can_be_found(f"{top}.{plain}") for top in ("cagemap", "cagemap.maps"))
    defined = (rf"^\s*(def |class |){part}(\b[^.]|\.py)" for part in plain.removeprefix("cagemap.").split("."))
    return all(re.search(pattern, sources, re.MULTILINE) for pattern in defined)


def can_be_found(path: str) -> bool:
    try:
        find(path)
    except (ModuleNotFoundError, AttributeError):
        return False
    return True


# What the documents name that is not of the package: words of Python, of pytest and of the paper.
FOREIGN = {"T12", "P12", "C12", "S", "W", "M", "eq=False", "slow", "shared_data"}


def test_every_name_that_developers_are_told_is_there() -> None:
    paths = list(SOURCE.rglob("*.py"))
    rooms = {part for path in paths for part in path.relative_to(SOURCE).parts}
    sources = "\n".join([*rooms, *(path.read_text(encoding="utf-8") for path in paths)])
    for document in ("docs/architecture.md", "CONTRIBUTING.md"):
        names = stated_names(document)
        assert len(names) > 30
        assert [name for name in names if name not in FOREIGN and not is_there(name, sources)] == []


def test_the_values_are_where_the_architecture_says_and_hold_it() -> None:
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    rows = [line.strip("| ").split(" | ") for line in text.split("| value |")[1].split("\n\n")[0].splitlines()[2:]]
    assert len(rows) > 10
    for values, room, holds in rows:
        classes = [find_class(name, room) for name in re.findall(r"`(\w+)`", values)]
        for name in re.findall(r"`\.?([a-z]\w*)[^`]*`", holds):
            assert any(name in dir(one) or name in one.__annotations__ for one in classes) or can_be_found(
                f"cagemap.{name}"
            ), (values, name)


def find_class(name: str, room: str) -> type:
    """A class that a file of a room defines."""
    folder = SOURCE.joinpath(*room.split("."))
    for path in folder.glob("*.py"):
        if re.search(rf"^class {name}\b", path.read_text(encoding="utf-8"), re.MULTILINE):
            found = getattr(importlib.import_module(f"cagemap.{room}.{path.stem}"), name)
            assert isinstance(found, type)
            return found
    raise AssertionError(f"no class {name} in {room}")


def test_only_the_command_line_names_its_options() -> None:
    """Rooms below it say what Python calls a thing; `cagemap.errors.OPTIONS` translates, and has nothing unused."""
    below = [path for path in SOURCE.glob("*/**/*.py") if path.relative_to(SOURCE).parts[0] not in ABOVE]
    texts = {
        node.value
        for path in below
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    }
    assert len(below) > 150
    assert [text for text in texts if re.search(r"(^|[\s(`>])--[a-z]{2}", text)] == []
    assert [python for python in OPTIONS if not any(python in text for text in texts)] == []
    assert in_options("allow it (`force=True`).") == "allow it (--force)."
