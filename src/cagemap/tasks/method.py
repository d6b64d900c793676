"""Parameters of the method, bases and levels of both surfaces, and symmetry files of `cagemap match`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import is_dataclass, replace
from pathlib import Path
from typing import Any

from cagemap.errors import ParameterError, values_of
from cagemap.files.landmarks.points import read_symmetry
from cagemap.maps.pair import SymmetryPair
from cagemap.mesh import ControlMesh, Plain
from cagemap.operators import LAPLACIANS
from cagemap.pipeline import MatchConfig, choose_level, default_basis
from cagemap.spectral import BasisConfig
from cagemap.spectral.surface import DEFAULT_VERTICES, MOST_LEVELS
from cagemap.tasks.mesh_commands import require_size
from cagemap.tasks.requests.match import MatchRequest

# The field of `MatchConfig` that holds each method's parameters.
_OWN = {"elastic": "start", "hfm": "hfm", "paper": "paper"}

_SWITCHES = {"yes": True, "true": True, "no": False, "false": False}


def with_parameters(config: MatchConfig, settings: Sequence[str]) -> MatchConfig:
    """The configuration with parameters of its method set from texts such as ``laplacian=0.01``."""
    method_config = getattr(config, _OWN[config.method])
    values = _named_values(method_config)
    for setting in settings:
        name, equals, text = setting.partition("=")
        if not equals or name not in values:
            raise ParameterError(
                f"--set method: expected NAME=VALUE with one of {', '.join(sorted(values))} for {config.method}, "
                f"got {setting!r}."
            )
        several = isinstance(values[name], tuple)
        kind = type(values[name][0] if several else values[name])
        convert = _SWITCHES.__getitem__ if kind is bool else kind
        try:
            numbers = tuple(convert(word) for word in (text.lower().split(",") if several else [text.lower()]))
        except (ValueError, KeyError):
            form = {int: "a whole number", bool: "yes or no"}.get(kind, "a number")
            form = f"{form}, or several with commas between them" if several else form
            raise ParameterError(f"--set method.{name}: expected {form}, got {text!r}.") from None
        values[name] = numbers if several else numbers[0]
    with values_of("--set method"):
        return replace(config, **{_OWN[config.method]: _with_values(method_config, values)})


def used_parameters(config: MatchConfig) -> dict[str, Any]:
    """All parameters of the method that a match used, by the names of `with_parameters`."""
    return _named_values(getattr(config, _OWN[config.method]))


def read_symmetries(target: Sequence[Path], source: Sequence[Path]) -> tuple[SymmetryPair, ...]:
    """Pairs of self-maps of both control meshes from files, paired in order."""
    if len(target) != len(source):
        raise ParameterError(
            "--set target.symmetry and source.symmetry: expected as many files for one side as for the other, got "
            f"{len(target)} and {len(source)}. A symmetry is used where both surfaces have it."
        )
    return tuple((read_symmetry(first), read_symmetry(second)) for first, second in zip(target, source, strict=True))


def _named_values(config: Any) -> dict[str, Any]:
    """Numbers of a configuration and of its nested configurations, by name."""
    values: dict[str, Any] = {}
    for name, value in vars(config).items():
        values |= _named_values(value) if is_dataclass(value) else {name: value}
    return values


def _with_values(config: Any, values: dict[str, Any]) -> Any:
    """The configuration with numbers set by name, also in nested configurations."""
    changed = {
        name: _with_values(value, values) if is_dataclass(value) else values[name]
        for name, value in vars(config).items()
    }
    return replace(config, **changed)


SIDES = ("target", "source")


def basis_config(request: MatchRequest, level: int = MOST_LEVELS, side: str = "") -> BasisConfig:
    """Parameters of a surface's basis up to a level; options of ``side`` override those of both."""
    basis, literal = default_basis(request.method, level), False
    for before, option in dict.fromkeys(
        (("", "--set "), (f"{side}_" * bool(side), f"--set {side}." if side else "--set "))
    ):
        k, schedule, accuracy, laplacian = (
            getattr(request, before + name) for name in ("k", "schedule", "accuracy", "laplacian")
        )
        if schedule is not None:  # parsed first, so that its refusal names its option
            schedule = parse_schedule(schedule, f"{option}schedule")
        try:
            if k is not None:  # a number of functions replaces an earlier schedule
                basis = replace(basis, count=k, schedule=None)
            basis = replace(
                basis, schedule=schedule or basis.schedule, accuracy=basis.accuracy if accuracy is None else accuracy
            )
        except ParameterError as error:
            raise ParameterError(f"{option}{str(error).replace('count:', 'k:', 1)}") from None
        basis = with_laplacian(basis, laplacian, f"{option}laplacian")
        literal |= getattr(request, f"{before}literal")
    if side and literal and basis.schedule is None:
        raise ParameterError(f"--set literal: expected a schedule of the {side} with it, as in Definition 2, got none")
    # Schedules and other search levels, which may be above the default one, need the finest level's operators.
    exact = basis.schedule is not None or any("search_vertices" in text for text in request.parameter)
    return replace(basis, literal=literal and basis.schedule is not None, vertices=None if exact else basis.vertices)


def side_bases(
    request: MatchRequest, levels: tuple[int, int] = (MOST_LEVELS, MOST_LEVELS)
) -> tuple[BasisConfig, BasisConfig]:
    """Parameters of the target's and the source's basis for given finest levels."""
    return basis_config(request, levels[0], SIDES[0]), basis_config(request, levels[1], SIDES[1])


def with_laplacian(basis: BasisConfig, text: str | None, option: str) -> BasisConfig:
    """The basis with a Laplacian given by name, such as ``alexa-wardetzky`` or ``alexa-wardetzky:2``."""
    if text is None:
        return basis
    name, colon, number = text.partition(":")
    try:
        stabilisation = float(number) if colon else 1.0
    except ValueError:
        name = ""
    if name not in LAPLACIANS or (colon and name == "mean"):
        raise ParameterError(
            f"{option}: expected {', '.join(LAPLACIANS)}, the last two with :LAMBDA after it where it is not 1, "
            f"got {text!r}."
        )
    return replace(basis, laplacian=name, stabilisation=stabilisation)


def require_level_or_vertices(request: MatchRequest) -> None:
    """Refuse requests with both a level and a number of vertices."""
    for prefix in ("", "target_", "source_"):
        if None not in (getattr(request, f"{prefix}level"), getattr(request, f"{prefix}vertices")):
            before = f"--set {prefix[:-1]}." if prefix else "--"
            words = [f"{before}{name}" for name in ("level", "vertices")]
            raise ParameterError(
                f"{' and '.join(words)}: expected one of them, got both. {words[1]} chooses the level."
            )


def side_levels(request: MatchRequest, controls: Sequence[ControlMesh]) -> tuple[int, int]:
    """Finest levels of target and source; plain meshes have 0, whatever ``--level`` is."""
    levels = []
    for side, control in zip(SIDES, controls, strict=True):
        level, vertices = getattr(request, f"{side}_level"), getattr(request, f"{side}_vertices")
        if level is None and vertices is None:
            level = None if isinstance(control.scheme, Plain) else request.level
        wanted = vertices or request.vertices or DEFAULT_VERTICES
        levels.append(choose_level(control, wanted) if level is None else level)
    return levels[0], levels[1]


def require_levels(request: MatchRequest, controls: Sequence[ControlMesh], levels: tuple[int, int]) -> None:
    """Refuse levels that a mesh does not have or that are too large, by the option that states them."""
    for side, control, level in zip(SIDES, controls, levels, strict=True):
        option = "--level " if getattr(request, f"{side}_level") is None else f"--set {side}.level="
        if level == 0 and not isinstance(control.scheme, Plain):
            raise ParameterError(
                f"{option}0: expected 1 or more: level 0 is the control mesh, and only a plain mesh (scheme none) is "
                "matched as it is."
            )
        require_size(control, level, option)


def basis_parameters(basis: BasisConfig) -> dict[str, Any]:
    """Parameters of a basis for the manifest: schedule or number of functions, accuracy, Laplacian."""
    how = {"accuracy": basis.accuracy, "laplacian": basis.laplacian}
    if basis.laplacian != "mean":
        how["stabilisation"] = basis.stabilisation
    if basis.schedule is not None:
        return {"k": sum(basis.schedule), "schedule": list(basis.schedule), "literal": basis.literal, **how}
    return {"k": basis.count, **how}


def parse_schedule(text: str, option: str = "--schedule") -> tuple[int, ...]:
    """Numbers of basis functions per level from text such as ``100,50,50,50``."""
    try:
        schedule = tuple(int(part) for part in text.split(","))
    except ValueError:
        schedule = ()
    if not schedule or min(schedule) < 0 or max(schedule) < 1:
        raise ParameterError(
            f"{option}: expected numbers of basis functions for level 0, 1, ... such as 100,50,50,50, got {text!r}."
        )
    return schedule
