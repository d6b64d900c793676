"""Typer commands made from request dataclasses, whose fields are annotated with their options."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, fields
from functools import wraps
from importlib.util import LazyLoader, find_spec, module_from_spec
from inspect import Parameter, Signature
from types import MappingProxyType
from typing import Annotated, Any, TypeVar, get_args, get_origin, get_type_hints

import typer
from typer.core import TyperCommand

from cagemap.cli.console import say, warn
from cagemap.cli.progress import ShownStages
from cagemap.errors import ParameterError
from cagemap.tasks.progress import Outcome, Stages
from cagemap.tasks.requests.options import INPUT, LANDMARKS, OUTPUT, RESEARCH, Argument, Option
from cagemap.tasks.requests.settings import moved_options, read_settings

Request = TypeVar("Request")

# The parameter that holds what was said after `--set`.
_SETTINGS = "settings"
_SET = Annotated[
    list[str],
    typer.Option(
        "--set",
        metavar="NAME=VALUE",
        help="Research option, such as target.schedule=100,50, or a .toml file; may be repeated.  [default: none]",
        show_default=False,
        rich_help_panel=RESEARCH,
    ),
]
# Sections of `--help`, in this order.
_SECTIONS = ("Arguments", INPUT, LANDMARKS, OUTPUT, RESEARCH, "Options")

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
    moved = moved_options(kind)
    grouped = bool(moved)  # long enough to need headings
    parameters = [
        Parameter(
            field.name,
            Parameter.KEYWORD_ONLY,
            default=default,
            annotation=Annotated[
                _shown(said.get(field.name, own)),
                *(of_typer(option, default, grouped=grouped) for option in options),
            ],
        )
        for field in fields(kind)  # type: ignore[arg-type]
        if get_origin(hints[field.name]) is Annotated
        for own, *options in [get_args(hints[field.name])]
        if not any(isinstance(option, Option) and option.setting for option in options)
        for default in [_default(MISSING if field.name in said else field.default, said.get(field.name, own))]
    ]
    if moved:
        parameters.append(Parameter(_SETTINGS, Parameter.KEYWORD_ONLY, default=[], annotation=_SET))

    def command_of(run: Callable[[Request], None]) -> Callable[..., None]:
        @wraps(run)
        def command(**given: Any) -> None:
            words = {name: tuple(value) if isinstance(value, list) else value for name, value in given.items()}
            settings = read_settings(kind, words.pop(_SETTINGS, ()))
            run((read or kind)(**words, **settings))

        vars(command).update(__signature__=Signature(parameters), moved=moved)
        command.__annotations__ = {one.name: one.annotation for one in parameters} | {"return": None}
        return command

    return command_of


def in_stages(run: Callable[[Request, Stages], Outcome]) -> Callable[[Request], None]:
    """Make a function that shows its stages, and says its outcome, of one that has them."""

    @wraps(run)
    def told(request: Request) -> None:
        load_when_used(UNUSED)
        with ShownStages() as stages:
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


def of_typer(option: Any, default: Any, *, grouped: bool = False) -> Any:
    """A request's option as typer has it; its help says the default where typer does not."""
    if not isinstance(option, Option):
        return option
    kind: Any = typer.Argument if isinstance(option, Argument) else typer.Option
    unsaid = kind is typer.Option and (default is None or default is False or default == [])
    shown = f"  [default: {'off' if default is False else 'none'}]" if unsaid and "[default:" not in option.help else ""
    return kind(
        *option.names,
        help=option.help + shown,
        min=option.min,
        max=option.max,
        metavar=option.metavar,
        rich_help_panel=option.group if grouped else None,
        show_default=not unsaid,
    )


def command_class(moved: Mapping[str, str]) -> type[TyperCommand]:
    """A command whose help has a section for each group, and that says how options which moved are typed now.

    Parameters
    ----------
    moved : mapping of str to str
        Old spellings, and what to type instead.
    """

    class Command(TyperCommand):
        def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
            for word in args[: args.index("--")] if "--" in args else args:
                old = word.partition("=")[0]
                if old in moved:
                    raise ParameterError(f"{old}: is typed differently now. Type {moved[old]}.")
            return super().parse_args(ctx, args)

        def format_options(self, ctx: Any, formatter: Any) -> None:
            sections: dict[str, list[tuple[str, str]]] = {}
            for parameter in self.get_params(ctx):
                record = parameter.get_help_record(ctx)
                if record is not None:
                    usual = "Arguments" if parameter.param_type_name == "argument" else "Options"
                    sections.setdefault(getattr(parameter, "rich_help_panel", None) or usual, []).append(record)
            for title in sorted(sections, key=lambda title: _SECTIONS.index(title)):
                with formatter.section(title):
                    formatter.write_dl(sections[title])

    return Command


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
