"""Runtime checks of arguments and configurations of the public API, and short representations."""

from __future__ import annotations

import operator
import os
import sys
from collections.abc import Callable, Mapping
from dataclasses import MISSING, fields, is_dataclass
from functools import cache, wraps
from inspect import signature
from numbers import Real
from pathlib import Path
from types import MappingProxyType, NoneType, UnionType
from typing import Any, ClassVar, ParamSpec, TypeAlias, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from cagemap.errors import ParameterError

P = ParamSpec("P")
R = TypeVar("R")

_NAMES: dict[type, str] = {int: "a whole number", float: "a number", str: "a text", Path: "a path"}
_NAMES |= {bool: "True or False", NoneType: "None"}

# Text for messages: how a user gets a value of a class.
_SOURCES = {
    "ControlMesh": "read_mesh or ControlMesh.from_faces gives one",
    "HierarchicalBasis": "a Surface has one, as `surface.basis`",
    "Landmarks": "read_landmarks or Landmarks(names, target, source) gives them",
    "MatchResult": "match or read_result gives one",
    "Operators": "build_operators gives them",
    "Pair": "pair_of or research.make_pair gives one",
    "PointMap": "a result has one, as `result.point_map`; PointMap.from_vertices makes one",
    "PreparedPair": "prepare_pair gives one",
    "Refinement": "refine gives one; a Surface has one, as `surface.refinement`",
    "Surface": "prepare_surface(MESH, LEVEL) gives one, read_mesh(PATH) a mesh",
    "Transfer": "transfer_of gives one",
    "TriangleSurface": "`surface.triangles(level)` gives one",
}


Conversion: TypeAlias = Callable[[Any, str], object]  # a value and the name of its parameter


def kinds_checked(function: Callable[P, R], conversions: Mapping[type, Conversion] = {}) -> Callable[P, R]:
    """Decorator: check cagemap's classes, numbers, strings and paths by annotation, after conversions to a class."""
    parameters = signature(function)

    @wraps(function)
    def checked(*args: P.args, **kwargs: P.kwargs) -> R:
        expected = _expected(function)
        try:
            bound = parameters.bind(*args, **kwargs)
        except TypeError:  # the function itself names the missing or unknown argument
            return function(*args, **kwargs)
        given = bound.arguments
        for name in (name for name in given if name in expected):
            kinds = expected[name]
            for convert in (conversions[kind] for kind in kinds if kind in conversions):
                given[name] = convert(given[name], name)
            value = given[name]
            if not any(_is(value, kind) for kind in kinds):
                names = [_NAMES.get(kind, kind.__name__) for kind in kinds if not (kind is str and Path in kinds)]
                source = next((f"; {_SOURCES[kind.__name__]}" for kind in kinds if kind.__name__ in _SOURCES), "")
                got = repr(value) if isinstance(value, str | Real | NoneType) else f"a {type(value).__name__}"
                raise ParameterError(f"{function.__name__}: {name}: expected {' or '.join(names)}, got {got}{source}")
        return function(*bound.args, **bound.kwargs)

    return checked


def _is(value: object, kind: type) -> bool:
    """Whether a value is of a type; NumPy scalars count as Python's, booleans not as numbers."""
    if kind is int:
        try:
            return operator.index(value) is not None and not isinstance(value, bool)  # type: ignore[arg-type]
        except TypeError:
            return False
    if kind is float:
        return isinstance(value, Real) and not isinstance(value, bool)
    accepted: dict[type, Any] = {bool: bool | np.bool_, Path: os.PathLike}
    return isinstance(value, accepted.get(kind, kind))


@cache
def _expected(function: Callable[..., Any]) -> dict[str, tuple[type, ...]]:
    """Types of the checked parameters; read at the first call, when all modules are imported."""
    kinds = {name: _classes(hint) for name, hint in get_type_hints(function).items() if name != "return"}
    return {name: classes for name, classes in kinds.items() if classes}


def _classes(hint: object) -> tuple[type, ...]:
    """Classes of an annotation; empty if one of them cannot be checked."""
    hints = get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)
    known = [isinstance(kind, type) and (kind in _NAMES or kind.__module__.startswith("cagemap.")) for kind in hints]
    protocols = [getattr(kind, "_is_protocol", False) for kind in hints]
    return tuple(hints) if all(known) and not any(protocols) else ()


class Brief:
    """Base of dataclasses (``repr=False``) whose repr shows only fields that differ from their defaults."""

    def __repr__(self) -> str:
        shown = []
        for field in fields(self):  # type: ignore[arg-type]
            default = field.default_factory() if field.default_factory is not MISSING else field.default
            value = getattr(self, field.name)
            if not (type(value) is type(default) and value == default):
                with np.printoptions(threshold=5, edgeitems=1):
                    shown.append(f"{field.name}={value!r}")
        return f"{type(self).__name__}({', '.join(shown)})"


class Config(Brief):
    """Base of configurations: refuses fields of another kind, and numbers out of range.

    Lists and arrays become tuples, NumPy's numbers Python's, so that configs can be keys and go into JSON files. Only
    limits (``max_...``) may be infinite. Cosines and agreements are from -1 to 1.
    """

    #: Least and most values of fields; others are at least 0, or at least -1 if their default is negative.
    RANGES: ClassVar[Mapping[str, tuple[float, float]]] = MappingProxyType({})

    def __post_init__(self) -> None:
        for field in fields(self):  # type: ignore[arg-type]
            value, default, annotation = getattr(self, field.name), field.default, str(field.type)
            if value is None and annotation.endswith(" | None"):
                continue
            annotation = annotation.removesuffix(" | None")
            several, kind = annotation.startswith("tuple["), annotation.removeprefix("tuple[").split(",")[0].rstrip("]")
            if is_dataclass(default) and not isinstance(value, type(default)):
                raise ParameterError(f"{field.name}: expected {type(default).__name__}, got {value!r}")
            if kind == "bool" and not _is(value, bool):
                raise ParameterError(f"{field.name}: expected True or False, got {value!r}")
            if field.name.endswith(("cosine", "agreement")):
                least, most = -1.0, 1.0
            else:
                negative = isinstance(default, int | float) and default < 0
                least, most = self.RANGES.get(field.name, (-1.0 if negative else 0.0, np.inf))
            listed = isinstance(value, tuple | list | np.ndarray)
            given = tuple(value) if several and listed else (value,)
            given = tuple(one.item() if isinstance(one, np.generic) else one for one in given)
            if kind in ("int", "float", "bool") or (several and listed):
                object.__setattr__(self, field.name, given if several else given[0])
            numbers = [one for one in given if _is(one, int if kind == "int" else float)]
            fits = kind not in ("int", "float") or (listed == several and len(numbers) == len(given))
            largest = most if field.name.startswith("max_") else min(most, sys.float_info.max)
            if not fits or not all(least <= number <= largest for number in numbers):
                noun = f"{'finite ' * (np.inf in numbers)}{'whole ' * (kind == 'int')}number"
                limits = f"of at least {least:g}" if most == np.inf else f"from {least:g} to {most:g}"
                raise ParameterError(
                    f"{field.name}: expected {noun + 's' if several else 'a ' + noun} {limits}, got {value!r}"
                )
