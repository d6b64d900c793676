"""Options of the command line as values: what the page shows a control for, and how a value is said to a command."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

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
class Option:
    """One option of a command.

    Attributes
    ----------
    command, name : str
        Name of the request's field.
    flag : str
        How it is typed; of a switch that is on by default, what turns it off.
    help : str
        As the command line explains it.
    kind : str
        "several" are words of ``choices`` with commas between them; "name or file" is a file where it ends in one of
        ``suffixes``; "output" names a file to write, and is asked for with True.
    default : value
    choices, suffixes : tuple of str
    least, most : float or None
    """

    command: str
    name: str
    flag: str
    help: str
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

    def words(self, value: Value) -> list[str]:
        """What is typed for a value; nothing for the default one."""
        if value is None or value == self.default:
            return []
        if self.kind == "flag":
            return [self.flag]
        if self.kind == "several" and isinstance(value, tuple):
            return [self.flag, ",".join(map(str, value))]
        if isinstance(value, tuple):
            return [word for one in value for word in (self.flag, _said(one))]
        return [self.flag, str(value)]

    def placed(self, value: Value, require: Callable[[Path], Path]) -> Value:
        """A value with its paths as ``require`` gives them; files in a folder as well.

        Raises
        ------
        ParameterError
            If one lies elsewhere.
        """
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


Options = Mapping[Key, Option]


def catalogue(options: Iterable[Option]) -> dict[Key, Option]:
    """Options by command and field."""
    return {option.key: option for option in options}


def _said(one: object) -> str:
    if isinstance(one, tuple):
        name, path = one
        return f"{name}={path}" if name else str(path)
    return str(one)


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
