"""Requests of match, transfer, wrap and report, and their options as values for the studio's page."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING, dataclass
from enum import StrEnum
from functools import cache
from importlib import import_module
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, Union, cast, get_args, get_origin

from pydantic import TypeAdapter

from cagemap.errors import ParameterError
from cagemap.tasks.progress import Outcome, Stages
from cagemap.tasks.requests.matching import MatchRequest
from cagemap.tasks.requests.options import NameOrFile, OneOf, Option, SomeOf, options_in
from cagemap.tasks.requests.results import ReportRequest, TransferRequest, WrapRequest

Request = MatchRequest | TransferRequest | WrapRequest | ReportRequest
COMMANDS: dict[str, type] = {
    "match": MatchRequest,
    "transfer": TransferRequest,
    "wrap": WrapRequest,
    "report": ReportRequest,
}
# Options that name files to write beside the output.
WRITTEN = {
    "transfer": ("usd",),
    "wrap": ("displacement", "vector_displacement", "normal_map", "occlusion", "colors", "baked", "mhclo"),
}
Kind = Literal[
    "flag", "choice", "several", "whole", "number", "text", "name or file", "file", "files", "named files", "output"
]
NamedFiles = tuple[tuple[str, Path], ...]
Value = bool | str | int | float | Path | tuple[str, ...] | tuple[Path, ...] | NamedFiles | None
# Command and field of its request.
Key = tuple[str, str]
# Before the name or file of a mask: everything but that.
_NOT = "not:"


@dataclass(frozen=True)
class CommandOption:
    """One option of a command."""

    # `command`, `name`: name of the request's field
    command: str
    name: str
    flag: str  # how it is typed; of a switch that is on by default, what turns it off
    help: str  # as the command line explains it
    # "several" are some of ``choices``; "name or file" is a file where it ends in one of ``suffixes``; "output" names a
    # file to write, and is asked for with True
    kind: Kind
    default: Value = None
    choices: tuple[str, ...] = ()
    suffixes: tuple[str, ...] = ()
    least: float | None = None
    most: float | None = None

    @property
    def key(self) -> Key:
        """What it is found by."""
        return self.command, self.name

    def require(self, value: Value) -> None:
        """Refuse a number outside its range."""
        if not isinstance(value, int | float):
            return
        if (self.least is not None and value < self.least) or (self.most is not None and value > self.most):
            most = "or more" if self.most is None else f"to {self.most}"
            raise ParameterError(f"{self.flag}: expected {self.least} {most}, got {value}. Correct it.")

    def placed(self, value: Value, require: Callable[[Path], Path]) -> Value:
        """A value with its paths as ``require`` gives them; files in a folder as well."""
        if isinstance(value, Path):
            return _placed(value, require)
        if self.kind == "name or file" and isinstance(value, str):
            name = value.removeprefix(_NOT)
            if Path(name).suffix.lower() not in self.suffixes:
                return value
            return value[: len(value) - len(name)] + str(_placed(Path(name), require))
        if isinstance(value, tuple):
            return tuple(_placed_one(one, require) for one in value)  # type: ignore[return-value]
        return value


Options = Mapping[Key, CommandOption]


def catalogue(options: Iterable[CommandOption]) -> dict[Key, CommandOption]:
    """Options by command and field."""
    return {option.key: option for option in options}


def all_options() -> Options:
    """Every option of the commands in `COMMANDS`."""
    return catalogue(option for command, request in COMMANDS.items() for option in options_of(command, request))


def request_of(options: Options, command: str, values: Mapping[str, Value]) -> Request:
    """The request of a command with some values of its fields."""
    for name, value in values.items():
        if (command, name) in options:
            options[command, name].require(value)
    request: Request = _validator(COMMANDS[command]).validate_python(dict(values))
    return request


def run_request(request: Request, stages: Stages) -> Outcome:
    """Do a request of `COMMANDS`; returns a summary and warnings."""
    command = next(name for name, kind in COMMANDS.items() if isinstance(request, kind))
    run: Callable[[Request, Stages], Outcome] = getattr(import_module(f"cagemap.tasks.{command}"), f"run_{command}")
    return run(request, stages)


@cache
def _validator(request: type) -> TypeAdapter[Any]:
    return TypeAdapter(request)  # building one takes longer than everything else about a request


@cache
def options_of(command: str, request: type) -> tuple[CommandOption, ...]:
    """Options of one command; what is no option of the command line is left out."""
    return tuple(
        _option(command, field.name, kind, info, said, None if field.default is MISSING else field.default)
        for field, kind, said, info in options_in(request)
    )


def _option(command: str, name: str, kind: Any, info: Option, said: list[Any], default: Any) -> CommandOption:
    plain = _without_none(kind)
    one_of = next((one for one in said if isinstance(one, OneOf)), None)
    some_of = next((one for one in said if isinstance(one, SomeOf)), None)
    file_too = next((one for one in said if isinstance(one, NameOrFile)), None)
    choices: tuple[object, ...] = ()
    if one_of is not None:
        choices = one_of.choices
    elif isinstance(plain, type) and issubclass(plain, StrEnum):
        choices = tuple(plain)
    own: Kind
    if name in WRITTEN.get(command, ()):
        own = "output"
    elif some_of is not None:
        own, choices = "several", some_of.parts
    elif choices:
        own = "choice"
    else:
        own = "name or file" if file_too is not None else _KINDS[plain]
    flags = info.names or ("--" + name.replace("_", "-"),)
    flag = next((one for one in flags if one.startswith("--")), flags[0])
    on, _, off = flag.partition("/")
    return CommandOption(
        command,
        name,
        off if off and default else on,
        info.help,
        own,
        cast(Value, str(default) if own == "choice" and default is not None else default),
        tuple(map(str, choices)),
        () if file_too is None else file_too.suffixes,
        info.min,
        info.max,
    )


def _without_none(kind: Any) -> Any:
    if get_origin(kind) in (Union, UnionType):
        kinds = [one for one in get_args(kind) if one is not NoneType]
        return kinds[0] if len(kinds) == 1 else kind
    return kind


_KINDS: dict[Any, Kind] = {
    bool: "flag",
    int: "whole",
    float: "number",
    str: "text",
    Path: "file",
    tuple[str, ...]: "text",
    tuple[Path, ...]: "files",
    tuple[tuple[str, Path], ...]: "named files",
}


def _placed_one(one: object, require: Callable[[Path], Path]) -> object:
    if isinstance(one, tuple):
        return one[0], _placed(one[1], require)
    return _placed(one, require) if isinstance(one, Path) else one


def _placed(path: Path, require: Callable[[Path], Path]) -> Path:
    found = require(path)
    for file in found.iterdir() if found.is_dir() else ():
        if file.is_symlink():
            require(file)
    return found
