"""Commands from requests: a dataclass whose fields are annotated with typer's options says each of them once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import MISSING, Field, fields
from functools import wraps
from inspect import Parameter, Signature
from typing import Annotated, Any, TypeVar, get_args, get_origin, get_type_hints

Request = TypeVar("Request")


def asks(kind: type[Request]) -> Callable[[Callable[[Request], None]], Callable[..., None]]:
    """Make a command of a function that takes a request: typer sees the request's fields as its parameters.

    A field that may be None need not be given; a tuple of any length is an option that may be repeated.
    """
    hints = get_type_hints(kind, include_extras=True)
    shown = {field.name: _shown(hints[field.name]) for field in fields(kind)}  # type: ignore[arg-type]
    parameters = [
        Parameter(field.name, Parameter.KEYWORD_ONLY, default=_default(field, hints), annotation=shown[field.name])
        for field in fields(kind)  # type: ignore[arg-type]
    ]

    def command_of(run: Callable[[Request], None]) -> Callable[..., None]:
        @wraps(run)
        def command(**given: Any) -> None:
            run(kind(**{name: tuple(value) if isinstance(value, list) else value for name, value in given.items()}))

        vars(command).update(__signature__=Signature(parameters))
        command.__annotations__ = {**shown, "return": None}
        return command

    return command_of


def _default(field: Field[Any], hints: dict[str, Any]) -> Any:
    if field.default is not MISSING:
        return list(field.default) if isinstance(field.default, tuple) else field.default
    optional = type(None) in get_args(get_args(hints[field.name])[0])
    return None if optional else Parameter.empty


def _shown(hint: Any) -> Any:
    """A field's annotation as typer knows it: tuples of any length are lists."""
    own, *options = get_args(hint)
    if get_origin(own) is tuple and get_args(own)[-1] is ...:
        own = list[get_args(own)[0]]  # type: ignore[misc]
    return Annotated[own, *options]
