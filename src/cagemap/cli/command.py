"""Commands from requests: a dataclass whose fields are annotated with typer's options says each of them once."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, fields
from functools import wraps
from importlib.util import LazyLoader, find_spec, module_from_spec
from inspect import Parameter, Signature
from types import MappingProxyType
from typing import Annotated, Any, TypeVar, get_args, get_origin, get_type_hints

from cagemap.cli.progress import Stages
from cagemap.cli.words import say, warn

Request = TypeVar("Request")
# What a command says when it is done, and its warnings.
Outcome = tuple[str, list[str]]

# Modules that SciPy takes up with all of NumPy's names, and no command uses.
UNUSED = ("numpy.f2py", "numpy.testing")


def asks(
    kind: type[Request], *, said: Mapping[str, Any] = MappingProxyType({}), read: Callable[..., Request] | None = None
) -> Callable[[Callable[[Request], None]], Callable[..., None]]:
    """Make a command of a function that takes a request: typer sees the request's fields as its parameters.

    A field without an option is none of the command line's. One that may be None need not be given; a tuple of any
    length is an option that may be repeated, or left out.

    Parameters
    ----------
    kind : type
        The request's dataclass.
    said : mapping of str to type
        What some fields are on the command line, where words are not yet what the field holds.
    read : callable, optional
        Makes the request of the words, by the fields' names; ``kind`` itself where all words are values.
    """
    hints = get_type_hints(kind, include_extras=True)
    parameters = [
        Parameter(
            field.name,
            Parameter.KEYWORD_ONLY,
            default=_default(MISSING if field.name in said else field.default, said.get(field.name, own)),
            annotation=Annotated[_shown(said.get(field.name, own)), *options],
        )
        for field in fields(kind)  # type: ignore[arg-type]
        if get_origin(hints[field.name]) is Annotated
        for own, *options in [get_args(hints[field.name])]
    ]

    def command_of(run: Callable[[Request], None]) -> Callable[..., None]:
        @wraps(run)
        def command(**given: Any) -> None:
            words = {name: tuple(value) if isinstance(value, list) else value for name, value in given.items()}
            run((read or kind)(**words))

        vars(command).update(__signature__=Signature(parameters))
        command.__annotations__ = {one.name: one.annotation for one in parameters} | {"return": None}
        return command

    return command_of


def in_stages(run: Callable[[Request, Stages], Outcome]) -> Callable[[Request], None]:
    """Make a function that shows its stages, and says its outcome, of one that has them."""

    @wraps(run)
    def told(request: Request) -> None:
        load_when_used(UNUSED)
        with Stages() as stages:
            summary, warnings = run(request, stages)
        warn(warnings)
        say(summary)

    return told


def load_when_used(names: Sequence[str]) -> None:
    """Have modules loaded when something in them is first asked for, as importlib's documentation shows it."""
    for name in names:
        found = None if name in sys.modules else find_spec(name)
        if found is None or found.loader is None:
            continue
        found.loader = LazyLoader(found.loader)
        module = module_from_spec(found)
        sys.modules[name] = module
        found.loader.exec_module(module)
        package, _, own = name.rpartition(".")
        setattr(sys.modules[package], own, module)


def _default(default: Any, kind: Any) -> Any:
    """What typer takes where nothing is given."""
    if default is MISSING:
        if _is_many(kind):
            return []
        return None if type(None) in get_args(kind) else Parameter.empty
    return list(default) if isinstance(default, tuple) else default


def _shown(kind: Any) -> Any:
    """A type as typer knows it: tuples of any length are lists."""
    return list[get_args(kind)[0]] if _is_many(kind) else kind  # type: ignore[misc]


def _is_many(kind: Any) -> bool:
    return get_origin(kind) is tuple and get_args(kind)[-1] is ...
