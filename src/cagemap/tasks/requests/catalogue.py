"""Requests of match, transfer, wrap and report, and descriptions of their options for the studio."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

from cagemap.files import INVERT_PREFIX
from cagemap.tasks.requests.match import MatchRequest
from cagemap.tasks.requests.options import Option, option_fields, strip_none, validate_request
from cagemap.tasks.requests.report import ReportRequest
from cagemap.tasks.requests.transfer import TransferRequest
from cagemap.tasks.requests.wrap import WrapRequest

Request = MatchRequest | TransferRequest | WrapRequest | ReportRequest
COMMANDS: dict[str, type] = {
    "match": MatchRequest,
    "transfer": TransferRequest,
    "wrap": WrapRequest,
    "report": ReportRequest,
}
# Options that name further output files.
WRITTEN = {
    "transfer": ("usd",),
    "wrap": ("displacement", "vector_displacement", "normal_map", "occlusion", "colors", "baked", "mhclo"),
}
# Options of `wrap` for images, and the images whose bake reads each.
WRAP_IMAGES_OF = {
    "space": ("normal_map", "vector_displacement"),
    "green": ("normal_map",),
    "rays": ("occlusion",),
    "size": ("normal_map", "displacement", "vector_displacement", "occlusion", "colors", "baked"),
}
Kind = Literal[
    "flag", "choice", "several", "whole", "number", "text", "name or file", "file", "files", "named files", "output"
]
NamedFiles = tuple[tuple[str, Path], ...]
Value = bool | str | int | float | Path | tuple[str, ...] | tuple[Path, ...] | NamedFiles | None
# Command and field of its request.
Key = tuple[str, str]


@dataclass(frozen=True)
class CommandOption:
    """One option of a command."""

    # `command`, `name`: name of the request's field
    command: str
    name: str
    flag: str  # as typed; for a switch that is on by default, the flag that turns it off
    help: str  # help text of the command line
    # "several": some of ``choices``; "name or file": a file if it ends in one of ``suffixes``; "output": a file to
    # write, requested with True
    kind: Kind
    default: Value = None
    choices: tuple[str, ...] = ()
    suffixes: tuple[str, ...] = ()
    least: float | None = None
    most: float | None = None

    @property
    def key(self) -> Key:
        """Command and field name."""
        return self.command, self.name

    def placed(self, value: Value, require: Callable[[Path], Path]) -> Value:
        """The value with paths passed through ``require``, which also checks links in folders."""
        if isinstance(value, Path):
            return placed_path(value, require)
        if self.kind == "name or file" and isinstance(value, str):
            name = value.removeprefix(INVERT_PREFIX)
            if Path(name).suffix.lower() not in self.suffixes:
                return value
            return value[: len(value) - len(name)] + str(placed_path(Path(name), require))
        if isinstance(value, tuple):
            return tuple(_placed_one(item, require) for item in value)  # type: ignore[return-value]
        return value


Options = Mapping[Key, CommandOption]


def all_options() -> Options:
    """Every option of the commands in `COMMANDS`."""
    return {option.key: option for command, request in COMMANDS.items() for option in options_of(command, request)}


def request_of(command: str, values: Mapping[str, Value]) -> Request:
    """A command's request from values of some of its fields; the text "8" is accepted for the choice 8."""
    kinds = {field.name: strip_none(kind) for field, kind, _ in option_fields(COMMANDS[command])}
    choices = {name: get_args(kind) for name, kind in kinds.items() if get_origin(kind) is Literal}
    chosen = {
        name: next((choice for choice in choices.get(name, ()) if str(choice) == value), value)
        for name, value in values.items()
    }
    request: Request = validate_request(COMMANDS[command], chosen)
    return request


@cache
def options_of(command: str, request: type) -> tuple[CommandOption, ...]:
    """Options of one command; fields that are no options are left out."""
    return tuple(
        _option(command, field.name, kind, option, None if field.default is MISSING else field.default)
        for field, kind, option in option_fields(request)
        if type(option) is Option
    )


def _option(command: str, name: str, kind: Any, option: Option, default: Any) -> CommandOption:
    plain = strip_none(kind)
    several = get_origin(plain) is tuple
    one = get_args(plain)[0] if several else plain
    choices = get_args(one) if get_origin(one) is Literal else ()
    option_kind: Kind
    if name in WRITTEN.get(command, ()):
        option_kind = "output"
    elif choices:
        option_kind = "several" if several else "choice"
    else:
        option_kind = "name or file" if option.suffixes else _KINDS[plain]
    off = option.option_names(name)[0].partition("/")[2]
    return CommandOption(
        command,
        name,
        off if default and off else option.flag(name),
        option.help,
        option_kind,
        default,
        tuple(map(str, choices)),
        option.suffixes,
        option.min,
        option.max,
    )


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
        return one[0], placed_path(one[1], require)
    return placed_path(one, require) if isinstance(one, Path) else one


def placed_path(path: Path, require: Callable[[Path], Path]) -> Path:
    """A path passed through ``require``, and the links in a folder too."""
    allowed = require(path)
    for file in allowed.iterdir() if allowed.is_dir() else ():
        if file.is_symlink():
            require(file)
    return allowed
