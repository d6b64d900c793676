"""What the docs promise exists."""

import ast
import importlib
import inspect
import re
import tomllib
from pathlib import Path

import click
import pytest
import typer

import cagemap
from cagemap.cli.app import app
from cagemap.errors import OPTION_NAMES, use_option_names

from locations import ROOT

SOURCE = ROOT / "src" / "cagemap"
ABOVE = ("cli", "tasks", "studio", "jobs")  # packages that know of the command line
CODE_WIDTH = 88  # columns of code that a page shows without cutting it
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


def test_packages_are_loaded_when_their_names_are_used(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("example", "pictures", "research", "tasks", "wrap"):
        package = importlib.import_module(f"cagemap.{name}")
        monkeypatch.delattr(cagemap, name)  # as after `import cagemap` alone
        assert getattr(cagemap, name) is package
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        cagemap.nothing  # noqa: B018


def documents() -> list[Path]:
    pages = sorted((ROOT / "docs").glob("*.md"))
    return [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *pages, *sorted((ROOT / "docs" / "lab").glob("*.md"))]


def code_lines(text: str) -> list[str]:
    """Lines of code between fences, and lines that are indented by four outside them."""
    lines, fence = [], None
    for line in text.splitlines():
        if line.startswith("```"):
            fence = None if fence is not None else line[3:]
        elif fence is not None and not fence.startswith("{"):
            lines.append(line)
        elif fence is None and line.startswith("    "):
            lines.append(line[4:])
    return lines


@pytest.mark.parametrize("document", documents(), ids=lambda path: path.name)
def test_code_is_not_cut_at_the_right(document: Path) -> None:
    lines = code_lines(document.read_text(encoding="utf-8"))
    assert [line for line in lines if len(line) > CODE_WIDTH] == []


@pytest.mark.parametrize("document", documents(), ids=lambda path: path.name)
def test_links_between_documents_resolve(document: Path) -> None:
    text = document.read_text(encoding="utf-8")
    for link in re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", text):
        if "://" not in link:
            assert (document.parent / link).exists(), f"{document.name} links to {link}"


COMMANDS: dict[str, click.Command] = typer.main.get_command(app).commands  # type: ignore[attr-defined]


@pytest.mark.parametrize("document", documents(), ids=lambda path: path.name)
def test_commands_and_options_that_pages_name_exist(document: Path) -> None:
    text = document.read_text(encoding="utf-8")
    for command in re.findall(r"cagemap ([a-z]+) (?:-|RESULT|MESH|[A-Z\[])", text):
        assert command in COMMANDS, f"{document.name} names `cagemap {command}`"
    if document.name == "cli.md":
        options = {flag for command in COMMANDS.values() for one in command.params for flag in one.opts}
        options |= {flag for one in typer.main.get_command(app).params for flag in one.opts}
        written = set(re.findall(r"(?<![\w-])--[a-z][a-z-]*", text))
        assert written <= options | {"--help"}, written - options
        assert [name for name in COMMANDS if f"cagemap {name}" not in text] == []


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


def test_the_architecture_names_every_package_in_the_order_of_imports() -> None:
    """As the contract of import-linter has it, lowest first; `|` stands between packages of one layer."""
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    (picture,) = re.findall(r"^```text\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    shown = [name for line in picture.splitlines() for name in re.findall(r"\w+", re.split(r" {3,}", line.strip())[0])]
    contract = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"][
        "contracts"
    ][0]
    layers = [sorted(re.findall(r"\w+", layer)) for layer in reversed(contract["layers"])]
    assert {*shown} == {path.parent.name for path in SOURCE.glob("*/__init__.py")} | {
        "diffusion_net",
        "errors",
        "match_config",
        "pipeline",
        "research",
    }
    ranks = {name: rank for rank, layer in enumerate(layers) for name in layer}
    assert [ranks[name] for name in shown] == sorted(ranks[name] for name in shown)


USER_PAGES = (
    "../README tutorial gallery cli studio concepts choosing landmarks curves scans limits formats jobs wrapping"
    " rigs blender conventions api researchers"
)


@pytest.mark.parametrize(
    ("pages", "most"), [(USER_PAGES, 12_000), ("recipes", 1000), ("accuracy", 1500), ("architecture", 900)]
)
def test_pages_are_short(pages: str, most: int) -> None:
    """Words with a letter or digit, code included; who adds a paragraph takes one out, or writes it into docs/lab."""
    texts = [(ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8") for name in pages.split()]
    assert sum(bool(re.search(r"\w", word)) for text in texts for word in text.split()) <= most


def test_the_changelog_is_one_page() -> None:
    assert len((ROOT / "CHANGELOG.md").read_text(encoding="utf-8").splitlines()) <= 120


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
    assert len(rows) == 6
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
    """Packages below it use Python names; `cagemap.errors.OPTION_NAMES` translates them, without unused entries."""
    below = [path for path in SOURCE.glob("*/**/*.py") if path.relative_to(SOURCE).parts[0] not in ABOVE]
    texts = {
        node.value
        for path in below
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    }
    assert len(below) > 150
    assert [text for text in texts if re.search(r"(^|[\s(`>])--[a-z]{2}", text)] == []
    assert [python for python in OPTION_NAMES if not any(python in text for text in texts)] == []
    assert use_option_names("allow it (`force=True`).") == "allow it (--force)."
