"""Typer commands from request dataclasses whose fields are annotated with options."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING
from enum import Enum, StrEnum
from importlib.util import LazyLoader, find_spec, module_from_spec
from inspect import Parameter, Signature
from pathlib import Path
from types import NoneType
from typing import Annotated, Any, Literal, TypeVar, get_args, get_origin

import typer
from typer.core import TyperCommand

from cagemap.cli.console import set_verbosity
from cagemap.errors import ParameterError
from cagemap.tasks.requests.options import HEADINGS, RESEARCH, Argument, Option, PythonOnly, option_fields, strip_none
from cagemap.tasks.requests.settings import moved_options, read_settings

Request = TypeVar("Request")

# Parameter with the values of `--set`.
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
VERBOSE = Annotated[
    int,
    typer.Option(
        "--verbose",
        "-v",
        count=True,
        show_default=False,
        help="Print every step and every fallback; -vv: more.  [default: off]",
    ),
]
QUIET = Annotated[
    bool,
    typer.Option(
        "--quiet", "-q", show_default=False, help="Print errors only: no results, warnings or progress.  [default: off]"
    ),
]
# Sections of `--help`, in this order.
_SECTIONS = ("Arguments", *HEADINGS, "Options")
# Names of values in `--help`, by their type.
_METAVARS = {Path: "FILE", int: "NUMBER", float: "NUMBER", str: "TEXT"}

# Modules that SciPy, Numba and readers import, and few commands use.
LAZY_MODULES = ("numpy.f2py", "numpy.testing", "yaml")


def command_of(kind: type[Request], run: Callable[[Request], None]) -> Callable[..., None]:
    """A function for typer, with a request's fields as parameters, that runs the request.

    Its help is the docstring of the request. Fields that may be None are optional; tuples of any length may be
    repeated. A request with fields that are typed otherwise makes itself from what is typed by ``of_words``.
    """
    parameters = [
        Parameter(
            field.name,
            Parameter.KEYWORD_ONLY,
            default=default,
            annotation=Annotated[_typer_type(word_type), typer_parameter(field.name, option, word_type, default)],
        )
        for field, field_type, option in option_fields(kind)
        if not (option.setting or isinstance(option, PythonOnly))
        for word_type in [option.typed or field_type]
        for default in [_typer_default(MISSING if option.typed else field.default, word_type, option)]
    ]
    if moved_options(kind):
        parameters.append(Parameter(_SETTINGS, Parameter.KEYWORD_ONLY, default=[], annotation=_SET))
    parameters += [
        Parameter(name, Parameter.KEYWORD_ONLY, default=default, annotation=annotation)
        for name, default, annotation in (("verbose", 0, VERBOSE), ("quiet", False, QUIET))
    ]

    def command(*, verbose: int, quiet: bool, **given: Any) -> None:
        if verbose or quiet:
            set_verbosity(verbose, quiet)
        values = {name: _field_value(value) for name, value in given.items()}
        settings = read_settings(kind, values.pop(_SETTINGS, ()))
        run(getattr(kind, "of_words", kind)(**values, **settings))

    vars(command).update(__signature__=Signature(parameters))
    command.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters} | {"return": None}
    command.__doc__ = kind.__doc__
    return command


def load_lazily(names: Sequence[str]) -> None:
    """Load modules at first use of their attributes, as importlib's documentation shows."""
    for name in names:
        spec = None if name in sys.modules else find_spec(name)
        if spec is None or spec.loader is None:
            continue
        spec.loader = LazyLoader(spec.loader)
        module = module_from_spec(spec)
        sys.modules[name] = module
        spec.loader.exec_module(module)
        package, _, attribute = name.rpartition(".")
        if package:
            setattr(sys.modules[package], attribute, module)


def typer_parameter(field: str, option: Option, word_type: Any, default: Any) -> Any:
    """A field's option for typer; its help names the default where typer does not."""
    if isinstance(option, Argument):
        return typer.Argument(help=option.help, metavar=str(option.metavar).strip("[]"))
    hides_default = default is None or default is False or default == []
    help_text = option.help
    if hides_default and "[default:" not in help_text:
        help_text += f"  [default: {'off' if default is False else 'none'}]"
    value_type = strip_none(get_args(word_type)[0] if _is_list(word_type) else word_type)
    return typer.Option(
        *option.option_names(field),
        help=help_text,
        min=option.min,
        max=option.max,
        metavar=option.metavar or _METAVARS.get(value_type),
        rich_help_panel=option.group,
        show_default=not hides_default,
    )


def command_class(replacements: Mapping[str, str]) -> type[TyperCommand]:
    """A typer command class with grouped help, which says what replaces renamed options."""

    class Command(TyperCommand):
        def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
            for word in args[: args.index("--")] if "--" in args else args:
                old = word.partition("=")[0]
                if old in replacements:
                    raise ParameterError(f"{old}: is typed differently now. Type {replacements[old]}.")
            return super().parse_args(ctx, args)

        def format_options(self, ctx: Any, formatter: Any) -> None:
            sections: dict[str, list[tuple[str, str]]] = {}
            for parameter in self.get_params(ctx):
                record = parameter.get_help_record(ctx)
                if record is None:
                    continue
                section = getattr(parameter, "rich_help_panel", None) or "Options"
                if parameter.param_type_name == "argument":
                    section, record = "Arguments", (record[0].partition(" ")[0], record[1])  # without its type
                sections.setdefault(section, []).append(record)
            for title in sorted(sections, key=lambda title: _SECTIONS.index(title)):
                with formatter.section(title):
                    formatter.write_dl(sections[title])

    return Command


def _typer_default(default: Any, kind: Any, option: Option) -> Any:
    """The default of a parameter for typer; a metavar in brackets says that an argument may be left out."""
    if default is MISSING:
        if _is_list(kind) and not (isinstance(option, Argument) and str(option.metavar)[0] != "["):
            return []
        return None if type(None) in get_args(kind) else Parameter.empty
    return list(default) if isinstance(default, tuple) else default


def _typer_type(kind: Any) -> Any:
    """A type for typer: tuples of any length become lists, and choices an enumeration."""
    if _is_list(kind):
        return list[get_args(kind)[0]]  # type: ignore[misc]
    choices = get_args(strip_none(kind))
    if get_origin(strip_none(kind)) is not Literal:
        return kind
    are_texts = isinstance(choices[0], str)
    one: Any = StrEnum("Choice", {text: text for text in choices}) if are_texts else type(choices[0])
    return one | None if NoneType in get_args(kind) else one


def _field_value(value: Any) -> Any:
    """A value of typer for a request."""
    if isinstance(value, list):
        return tuple(value)
    return value.value if isinstance(value, Enum) else value


def _is_list(kind: Any) -> bool:
    return get_origin(kind) is tuple and get_args(kind)[-1] is ...
