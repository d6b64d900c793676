"""Options for research: fields of configurations, set by ``--set NAME=VALUE`` or a TOML file."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, get_origin

from cagemap.errors import ParameterError, wrong_values
from cagemap.files.text import flatten_entries, read_toml
from cagemap.tasks.requests.options import Option, option_fields

# The field with parameters of the method, and the prefix of their names.
_PARAMETERS, _METHOD = "parameter", "method"


def settings_of(request: type) -> dict[str, tuple[str, Any, Option]]:
    """Fields of research options, their types and options, by what is typed after ``--set``: "target.schedule".

    Parameters of the method are not listed.
    """
    sides = re.compile("^(target|source)_")
    return {
        sides.sub(r"\1.", field.name): (field.name, kind, option)
        for field, kind, option in option_fields(request)
        if option.setting and field.name != _PARAMETERS
    }


def moved_options(request: type) -> dict[str, str]:
    """Current spelling of options that became settings, by their former flags."""
    moved: dict[str, str] = {}
    for name, (field, kind, option) in settings_of(request).items():
        moved[option.flag(field)] = f"--set {name}={'yes' if kind is bool else 'VALUE'}"
    return moved | ({f"--{_PARAMETERS}": f"--set {_METHOD}.NAME=VALUE"} if moved else {})


def read_settings(request: type, words: Sequence[str]) -> dict[str, Any]:
    """Fields of a request from words after ``--set``; the last value of a name is used.

    ``words``: ``NAME=VALUE``, or the name of a ``.toml`` file of such names, with tables for sides and method. Files
        named in a ``.toml`` are relative to it.
    """
    if not words:
        return {}
    from pydantic import TypeAdapter, ValidationError  # here, since it takes 0.05 s and few commands need it

    known = settings_of(request)
    values: dict[str, Any] = {}
    parameters: dict[str, str] = {}
    for name, value, folder in _pairs(words):
        if name.startswith(f"{_METHOD}."):
            parameters[name.removeprefix(f"{_METHOD}.")] = str(value)
            continue
        if name not in known:
            raise ParameterError(
                f"--set {name}: expected one of {', '.join(sorted(known))}, or {_METHOD}.NAME for a parameter of the "
                "method. Other options are typed without --set."
            )
        field, kind, option = known[name]
        several = get_origin(kind) is tuple
        bounded: Any = Annotated[kind, option]
        try:
            given = (value,) if several and isinstance(value, str) else value
            checked = TypeAdapter(bounded, config={"allow_inf_nan": False}).validate_python(given)
        except ValidationError as error:
            raise ParameterError(f"--set {name}: {wrong_values(error)[0][1]}") from None
        checked = tuple(_in_folder(folder, item) for item in checked) if several else _in_folder(folder, checked)
        values[field] = (*values.get(field, ()), *checked) if several else checked
    stated = tuple(f"{name}={value}" for name, value in parameters.items())
    return values | ({_PARAMETERS: stated} if stated else {})


def _in_folder(folder: Path, value: Any) -> Any:
    """A file in a folder; other values are unchanged."""
    return folder / value if isinstance(value, Path) else value


def _pairs(words: Sequence[str]) -> Iterator[tuple[str, Any, Path]]:
    """Name, value and the folder of files that the value names."""
    for word in words:
        name, equals, value = word.partition("=")
        if equals and name and value:
            yield name.strip(), value, Path()
        elif not equals and word.endswith(".toml"):
            table = read_toml(Path(word), "a file of settings")[1]
            yield from ((name, value, Path(word).parent) for name, value in flatten_entries("", table).items())
        else:
            raise ParameterError(f"--set: expected NAME=VALUE or a .toml file, got '{word}'.")
