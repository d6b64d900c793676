"""The options of commands as values for the studio's page, read off the requests that say each of them once."""

from __future__ import annotations

from dataclasses import MISSING, fields
from enum import StrEnum
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Union, cast, get_args, get_origin, get_type_hints

from typer.models import OptionInfo

from cagemap.cli.job_file import COMMANDS, WRITTEN
from cagemap.cli.options import NameOrFile, OneOf, SomeOf
from cagemap.studio.options import Kind, Option, Options, Value, catalogue


def all_options() -> Options:
    """Every option of the commands that a finish runs."""
    return catalogue(option for command, request in COMMANDS.items() for option in options_of(command, request))


def options_of(command: str, request: type) -> tuple[Option, ...]:
    """Options of one command; what is no option of the command line is left out."""
    hints = get_type_hints(request, include_extras=True)
    found = []
    for field in fields(request):
        if get_origin(hints[field.name]) is not Annotated:
            continue
        kind, *said = get_args(hints[field.name])
        info = next((one for one in said if isinstance(one, OptionInfo)), None)
        if info is not None:
            default = None if field.default is MISSING else field.default
            found.append(_option(command, field.name, kind, info, said, default))
    return tuple(found)


def _option(command: str, name: str, kind: Any, info: OptionInfo, said: list[Any], default: Any) -> Option:
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
    # In an annotation, typer takes the first name for a default; without any it makes one of the parameter's.
    flags = (
        [info.default, *(info.param_decls or ())] if isinstance(info.default, str) else ["--" + name.replace("_", "-")]
    )
    flag = next((one for one in flags if one.startswith("--")), flags[0])
    on, _, off = flag.partition("/")
    return Option(
        command,
        name,
        off if off and default else on,
        info.help or "",
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
