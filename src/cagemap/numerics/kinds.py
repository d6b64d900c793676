"""The doors of public functions: a value of another kind is refused by name, before it fails somewhere inside."""

from __future__ import annotations

import operator
import os
from collections.abc import Callable
from functools import cache, wraps
from inspect import signature
from numbers import Real
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, ParamSpec, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from cagemap.errors import ParameterError

P = ParamSpec("P")
R = TypeVar("R")

# Where a value of a kind comes from.
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
    "Surface": "prepare_surface gives one",
    "Transfer": "transfer_of gives one",
    "TriangleSurface": "`surface.triangles(level)` gives one",
}


def kinds_checked(function: Callable[P, R]) -> Callable[P, R]:
    """Refuse arguments that are of none of the kinds that the function's annotations name.

    Classes, numbers, texts and paths are looked at; arrays, sequences and callables are the function's own business.

    Raises
    ------
    ParameterError
    """
    parameters = signature(function)

    @wraps(function)
    def door(*args: P.args, **kwargs: P.kwargs) -> R:
        expected = _expected(function)
        try:
            given = parameters.bind(*args, **kwargs).arguments
        except TypeError:  # too many arguments or too few: the function itself says so by its name
            given = {}
        for name, value in given.items():
            kinds = expected.get(name)
            if kinds and not any(_is(value, kind) for kind in kinds):
                raise ParameterError(_message(function.__name__, name, kinds, value))
        return function(*args, **kwargs)

    return door


def _message(function: str, name: str, kinds: tuple[type, ...], value: object) -> str:
    names = [_NAMES.get(kind, kind.__name__) for kind in kinds if not (kind is str and Path in kinds)]
    remedy = next((f"; {_SOURCES[kind.__name__]}" for kind in kinds if kind.__name__ in _SOURCES), "")
    return f"{function}: {name}: expected {' or '.join(names)}, got {_word(value)}{remedy}"


_NAMES = {int: "a whole number", float: "a number", str: "a text", Path: "a path", bool: "True or False"}
_NAMES[NoneType] = "None"


def _word(value: object) -> str:
    return repr(value) if isinstance(value, str | Real | NoneType) else f"a {type(value).__name__}"


def _is(value: object, kind: type) -> bool:
    if kind is bool:
        return isinstance(value, bool | np.bool_)
    if kind is int:
        try:
            operator.index(value)  # type: ignore[arg-type]
        except TypeError:
            return False
        return not isinstance(value, bool)
    if kind is float:
        return isinstance(value, Real) and not isinstance(value, bool)
    return isinstance(value, os.PathLike) if kind is Path else isinstance(value, kind)


@cache
def _expected(function: Callable[..., Any]) -> dict[str, tuple[type, ...]]:
    """Kinds of each parameter that can be told apart; annotations are looked up once, when all modules are there."""
    hints = get_type_hints(function)
    kinds = {name: _classes(hint) for name, hint in hints.items() if name != "return"}
    return {name: found for name, found in kinds.items() if found}


def _classes(hint: object) -> tuple[type, ...]:
    """The classes of an annotation; none where one of its kinds is no class of ours and no plain one."""
    hints = get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)
    plain = (int, float, str, bool, Path, NoneType)
    known = [isinstance(one, type) and (one in plain or one.__module__.startswith("cagemap.")) for one in hints]
    protocols = [getattr(one, "_is_protocol", False) for one in hints]
    return tuple(hints) if all(known) and not any(protocols) else ()
