"""Parameters of the method and the symmetry files of `cagemap match`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import is_dataclass, replace
from pathlib import Path
from typing import Any

from cagemap.errors import CagemapError, ParameterError
from cagemap.files.landmarks.symmetry import read_symmetry
from cagemap.maps.pair import SymmetryPair
from cagemap.pipeline import MatchConfig

# The field of `MatchConfig` that holds each method's parameters.
_OWN = {"elastic": "start", "hfm": "hfm", "paper": "paper"}


def with_parameters(config: MatchConfig, settings: Sequence[str]) -> MatchConfig:
    """Set parameters of the method from texts such as ``laplacian=0.01``.

    Raises
    ------
    ParameterError
        If a name is not known, has no meaning for the method, or its value is no number.
    """
    own = getattr(config, _OWN[config.method])
    values = _named_values(own)
    for setting in settings:
        name, given, text = setting.partition("=")
        if not given or name not in values:
            raise ParameterError(
                f"--set method: expected NAME=VALUE with one of {', '.join(sorted(values))} for {config.method}, "
                f"got {setting!r}."
            )
        kind = type(values[name])
        try:
            values[name] = kind(text)
        except ValueError:
            form = "a whole number" if kind is int else "a number"
            raise ParameterError(f"--set method.{name}: expected {form}, got {text!r}.") from None
    try:
        return replace(config, **{_OWN[config.method]: _filled(own, values)})
    except CagemapError as error:
        raise ParameterError(f"--set method: {error}") from None


def used_parameters(config: MatchConfig) -> dict[str, Any]:
    """All parameters of the method that a match used, by the names of `with_parameters`."""
    return _named_values(getattr(config, _OWN[config.method]))


def read_symmetries(target: Sequence[Path], source: Sequence[Path]) -> tuple[SymmetryPair, ...]:
    """Self-maps of both control meshes from files, the first of one side with the first of the other.

    Raises
    ------
    ParameterError
        If one side has more than the other.
    """
    if len(target) != len(source):
        raise ParameterError(
            "--set target.symmetry and source.symmetry: expected as many files for one side as for the other, got "
            f"{len(target)} and {len(source)}. A symmetry is used where both surfaces have it."
        )
    return tuple((read_symmetry(one), read_symmetry(two)) for one, two in zip(target, source, strict=True))


def _named_values(config: Any) -> dict[str, Any]:
    """Numbers of a configuration and of those inside it, by name."""
    values: dict[str, Any] = {}
    for name, value in vars(config).items():
        values |= _named_values(value) if is_dataclass(value) else {name: value}
    return values


def _filled(config: Any, values: dict[str, Any]) -> Any:
    """The configuration with numbers of these names, in those inside it too."""
    changed = {
        name: _filled(value, values) if is_dataclass(value) else values[name] for name, value in vars(config).items()
    }
    return replace(config, **changed)
