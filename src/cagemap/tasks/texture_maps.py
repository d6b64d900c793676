"""Named maps of a material on the command line: ``--texture albedo=skin.png --texture roughness=rough.png``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from cagemap.errors import ParameterError
from cagemap.files.images.image import UDIM_MARK, with_udim_mark


def texture_and_maps(
    given: Sequence[str], option: str = "--texture"
) -> tuple[Path | None, tuple[tuple[str, Path], ...]]:
    """Tell a single image from the named maps of a material: ``albedo=skin.png``."""
    named = [(name, Path(path)) for name, sign, path in (text.partition("=") for text in given) if sign and path]
    if len(given) == 1 and (not named or Path(given[0]).exists()):
        return Path(given[0]), ()
    if not given:
        return None, ()
    require_map_names(named if len(named) == len(given) else [("", Path(text)) for text in given], option)
    return None, tuple(named)


def require_map_names(maps: Sequence[tuple[str, Path]], option: str = "--texture") -> None:
    """Refuse several images that their names do not tell apart."""
    names = [name for name, _ in maps]
    if not all(names) or len({name.casefold() for name in names}) != len(names):
        given = ", ".join(f"{name}={path}" if name else str(path) for name, path in maps)
        raise ParameterError(
            f"{option}: expected one image, or several as NAME=IMAGE with a name of its own each, got {given}."
        )
    if any(not name.replace("_", "").replace("-", "").isalnum() for name in names):
        raise ParameterError(f"{option}: expected names of letters, digits, - and _, since files are named by them.")


def map_path(output: Path, name: str) -> Path:
    """Image of one of several maps: its name comes before the tile number and the suffix."""
    output = with_udim_mark(output)
    if not name:
        return output
    stem, dot, rest = output.name.partition(UDIM_MARK) if UDIM_MARK in output.name else (output.stem, "", output.suffix)
    if dot:
        return output.with_name(f"{stem.rstrip('._')}_{name}.{UDIM_MARK}{rest}")
    return output.with_name(f"{stem}_{name}{rest}")
