"""The command line stays short: options in groups with a line and a default each, research options after `--set`."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command
from typer.testing import CliRunner

from cagemap.cli.app import app
from cagemap.cli.entry import HELP_FILE
from cagemap.errors import FormatError, ParameterError
from cagemap.tasks.requests.match import MatchRequest
from cagemap.tasks.requests.settings import moved_options, read_settings, settings_of

from refusals import refuses

MATCH = ("match", "-t", "t.obj", "-s", "s.obj", "-o", "R")
COMMANDS = {"": get_command(app), **get_command(app).commands}  # type: ignore[attr-defined]


def options(command: str) -> list[Any]:
    return [one for one in COMMANDS[command].params if one.param_type_name == "option"]


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[MatchRequest]:
    """Requests that reach the task, which does nothing."""
    requests: list[MatchRequest] = []
    monkeypatch.setattr("cagemap.tasks.match.run_match", lambda request, stages: requests.append(request) or ("", []))
    return requests


def typed(*words: str) -> None:
    CliRunner().invoke(app, [*MATCH, *words], catch_exceptions=False)


def test_match_has_at_most_35_options_of_its_own() -> None:
    assert len([one for one in options("match") if one.name not in ("verbose", "quiet")]) <= 35


@pytest.mark.parametrize("command", COMMANDS)
def test_every_option_has_a_short_line_of_its_own_and_shows_its_default(command: str) -> None:
    said = [option.help for option in options(command)]
    assert len(set(said)) == len(said)
    context = COMMANDS[command].make_context(command, [], resilient_parsing=True)
    for option in options(command):
        words = option.help.partition("  [default")[0]
        shown = option.get_help_record(context)[1]
        assert words.endswith((".", "...")), (option.opts, words)
        assert 0 < len(words.split()) <= 12, (option.opts, words)
        assert ("[default: " in shown) or ("required]" in shown), (option.opts, shown)
    for argument in set(COMMANDS[command].params) - set(options(command)):
        assert 0 < len(argument.help.split()) <= 12, argument.name


@pytest.mark.parametrize("command", [name for name in COMMANDS if name not in ("", "run")])
def test_help_is_in_groups(command: str) -> None:
    """Only what all commands have is in the last group; that of `run`, which has few options, is the only one."""
    for option in options(command):
        common = option.name in ("help", "verbose", "quiet")
        assert (getattr(option, "rich_help_panel", None) is None) == common, (command, option.opts)


@pytest.mark.parametrize(
    ("command", "titles", "words"),
    [
        (
            "match",
            ["Input:", "Landmarks:", "Output:", "Research:", "Options:"],
            ["--target FILE", "--trust-landmarks", "--output FOLDER", "--set NAME=VALUE"],
        ),
        (
            "transfer",
            ["Arguments:", "What to carry, one of these:", "Input:", "Images:", "Weights and passengers:", "Output:"],
            ["RESULT  Folder", "--texture IMAGE", "--target-mask TEXT", "--rays NUMBER", "--only TEXT", "--usd FILE"],
        ),
    ],
)
def test_groups_are_in_an_order_with_their_options(command: str, titles: list[str], words: list[str]) -> None:
    text = CliRunner().invoke(app, [command, "--help"]).output
    heads = [line for line in text.splitlines() if line.endswith(":") and not line.startswith(" ")]
    assert heads[: len(titles)] == titles
    places = [text.index(f"{part}") for pair in zip(titles, words, strict=False) for part in pair]
    assert places == sorted(places)


def test_settings_reach_the_request_and_the_last_of_one_name_counts(tmp_path: Path, asked: list[MatchRequest]) -> None:
    file = tmp_path / "basis.toml"
    file.write_text(
        'schedule = "9,5"\nliteral = true\n[source]\nk = 12\nsymmetry = ["own.npy"]\n[method]\nrounds = 3\nheat = 4\n'
    )
    words = [str(file), "schedule=100,50", "target.level=3", "accuracy=1e-8", "method.heat=6"]
    words += ["source.symmetry=a.npy", "source.symmetry=b.npy"]
    typed(*(word for one in words for word in ("--set", one)))
    (request,) = asked
    assert request.schedule == "100,50"
    assert request.literal is True
    assert (request.source_k, request.target_level, request.accuracy) == (12, 3, 1e-8)
    assert request.parameter == ("rounds=3", "heat=6")
    assert request.source_symmetry == (tmp_path / "own.npy", Path("a.npy"), Path("b.npy"))
    typed("--set", "source.k=12")
    assert asked[1] == MatchRequest(Path("t.obj"), Path("s.obj"), Path("R"), source_k=12)


def test_a_file_of_settings_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    file = tmp_path / "x.toml"
    refuses(FormatError, r"x\.toml", read_settings, MatchRequest, [str(file)])
    file.write_text("a = " + "[" * 20_000)
    with pytest.raises(FormatError, match=r"x\.toml: expected a TOML file, got brackets within brackets"):
        read_settings(MatchRequest, [str(file)])
    file.write_text("a = = b")
    with pytest.raises(FormatError, match=r"x\.toml: expected a TOML file, got a mistake in it"):
        read_settings(MatchRequest, [str(file)])


@pytest.mark.parametrize("old", moved_options(MatchRequest))
def test_an_option_that_moved_is_refused_with_its_new_spelling(old: str, asked: list[MatchRequest]) -> None:
    new = moved_options(MatchRequest)[old]
    for words in ((old, "3"), (f"{old}=3",)):
        with pytest.raises(ParameterError) as refused:
            typed(*words)
        assert str(refused.value) == f"{old}: is typed differently now. Type {new}."
    assert asked == []
    name = new.removeprefix("--set ").partition("=")[0]
    assert name == "method.NAME" or name in settings_of(MatchRequest)


RENEW = (
    "the text of `cagemap --help` is not that of its commands any more: run COLUMNS=80 python -c "
    '\'import sys; sys.argv[1:] = ["--help"]; from cagemap.cli.app import app; app(prog_name="cagemap")\' > '
    "src/cagemap/cli/help.txt"
)


def test_the_kept_help_is_what_the_commands_say(monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    with pytest.raises(SystemExit):
        app(["--help"], prog_name="cagemap")
    assert capsys.readouterr().out == HELP_FILE.read_text(encoding="utf-8"), RENEW


@pytest.mark.parametrize("word", ["--help", "-h"])
def test_help_loads_no_library(word: str) -> None:
    script = (
        f"import sys; sys.argv = ['cagemap', '{word}']\nfrom cagemap.cli.entry import main\n"
        "try:\n    main()\nexcept SystemExit as ended:\n    assert ended.code == 0\n"
        "slow = {'typer', 'pydantic', 'numpy', 'scipy', 'numba', 'rich', 'embreex', 'OpenImageIO'}\n"
        "assert not slow & set(sys.modules), slow & set(sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout == HELP_FILE.read_text(encoding="utf-8")


def test_commands_load_no_pydantic_before_they_run() -> None:
    script = "import sys, cagemap.cli.app\nassert not {'pydantic', 'numpy', 'rich'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", script], check=True)


def test_a_match_loads_no_library_of_images_and_no_jobs() -> None:
    script = "import sys, cagemap.tasks.match\nassert not {'OpenImageIO', 'cagemap.jobs'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", script], check=True)
