"""Options of `cagemap match` that set the method's parameters, by name, and those that concern one side."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, get_type_hints

from cagemap.errors import CagemapError, ParameterError
from cagemap.files.symmetry import read_symmetry
from cagemap.functional_map import MapWeights
from cagemap.maps.elastic.config import StartConfig
from cagemap.maps.pair import SymmetryPair
from cagemap.maps.spectral.constraints import DescriptorConfig
from cagemap.maps.spectral.hierarchical import Growth, HierarchyConfig
from cagemap.maps.spectral.paper import PaperConfig
from cagemap.pipeline import MatchConfig

GROWTH_FORM = "FIRST:FACTOR:COORDINATE_WEIGHT:NORMAL_WEIGHT"
GROWTHS_EXAMPLE = "15:1.35:0.33:0.1,20:1.5:1:0.3"

_PARTS = ("descriptors", "weights")
# The parameters of each method's spectral map.
_OWN = {"elastic": "start", "hfm": "hierarchy", "paper": "paper"}


def with_parameters(config: MatchConfig, settings: Sequence[str]) -> MatchConfig:
    """Set parameters of the spectral methods from texts such as ``laplacian=0.01`` or ``growths=20:1.5:1:0.3``.

    Raises
    ------
    ParameterError
        If a name is not known, has no meaning for the method, or its value is no number.
    """
    own: Any = getattr(config, _OWN[config.method])
    values = _named_values(own)
    for setting in settings:
        name, given, text = setting.partition("=")
        kinds: dict[str, Callable[[str], Any]] = {
            **_kinds(type(own)),
            **_kinds(DescriptorConfig),
            **_kinds(MapWeights),
            "growths": _growths,
            "further": _growth,
            "growth": _growth,
        }
        kind = kinds.get(name)
        if not given or name not in values or kind is None:
            raise ParameterError(
                f"--parameter: expected NAME=VALUE with one of {', '.join(sorted(values))} for {config.method}, "
                f"got {setting!r}."
            )
        try:
            values[name] = kind(text)
        except ValueError:
            forms: dict[Any, str] = {
                int: "a whole number",
                float: "a number",
                _growths: f"{GROWTH_FORM} for each growth, with commas between them, such as {GROWTHS_EXAMPLE}",
                _growth: f"{GROWTH_FORM}, such as {GROWTHS_EXAMPLE.split(',')[0]}",
            }
            raise ParameterError(f"--parameter {name}: expected {forms[kind]}, got {text!r}.") from None
    try:
        parts = {part: _filled(getattr(own, part), values) for part in _PARTS}
        ways = {name: Growth(**values[name]) for name in ("growth", "further") if name in values}
        own = replace(_filled(own, values), **parts, **ways)
        if isinstance(own, HierarchyConfig):
            own = replace(own, growths=tuple(Growth(**growth) for growth in values["growths"]))
    except CagemapError as error:
        raise ParameterError(f"--parameter: {error}") from None
    return replace(config, **{_OWN[config.method]: own})


def used_parameters(config: MatchConfig) -> dict[str, Any]:
    """All parameters of the spectral method that a match used, by the names of `with_parameters`."""
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
            "--target-symmetry and --source-symmetry: expected as many files for one side as for the other, got "
            f"{len(target)} and {len(source)}. A symmetry is used where both surfaces have it."
        )
    return tuple((read_symmetry(one), read_symmetry(two)) for one, two in zip(target, source, strict=True))


def _named_values(config: HierarchyConfig | PaperConfig | StartConfig) -> dict[str, Any]:
    flat = asdict(config)
    for part in _PARTS:
        flat.update(flat.pop(part))
    return flat


def _growths(text: str) -> list[dict[str, Any]]:
    """Growths from texts such as ``15:1.35:0.33:0.1,20:1.5:1:0.3``.

    Raises
    ------
    ValueError
        If one is not four numbers, the first of them whole.
    """
    return [_growth(growth) for growth in text.split(",")]


def _growth(text: str) -> dict[str, Any]:
    """One of them."""
    values, kinds = text.split(":"), _kinds(Growth)
    if len(values) != len(kinds):
        raise ValueError(text)
    return {name: kinds[name](value) for name, value in zip(kinds, values, strict=True)}


def _kinds(config: type) -> dict[str, type]:
    return {name: kind for name, kind in get_type_hints(config).items() if kind in (int, float)}


def _filled(config: Any, values: dict[str, Any]) -> Any:
    return replace(config, **{name: values[name] for name in _kinds(type(config))})
