"""What is not saved yet, kept beside the landmark file, in the numbers of the models' files."""

from __future__ import annotations

import itertools
import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

from cagemap.errors import FormatError
from cagemap.files.atomic import write_whole
from cagemap.files.landmarks.curves import pair_entries
from cagemap.files.landmarks.pairs import entered, entries
from cagemap.files.ownership import mark
from cagemap.files.result.manifest import file_hash
from cagemap.files.text import read_text, whole_characters
from cagemap.mesh.curves import Curves
from cagemap.mesh.landmarks import Landmarks
from cagemap.studio.landmarks import Landmark, LandmarkList, Place

_AUTOSAVE = "cagemap-studio-autosave"
_NUMBERS = "of the files"
# How far weights of three corners may be from 1 in sum.
_SUM = 1e-3

Parts = tuple[str | None, str | None]


def autosave_path(landmarks: Path) -> Path:
    """Where unsaved landmarks are kept."""
    return landmarks.with_name(f".{landmarks.name}.autosave")


class Owned:
    """Files as this session has read or written them last, so that what others write there is not lost."""

    def __init__(self) -> None:
        self._known: dict[Path, str] = {}
        self._autosaves: dict[Path, Path] = {}

    def know(self, path: Path) -> None:
        """Take a file for the session's own as it is now, before it is read or after it is written."""
        if path.is_file():
            self._known[path] = file_hash(path)

    def is_other(self, path: Path) -> bool:
        """Whether a file holds something that the session has neither read nor written."""
        return path.is_file() and file_hash(path) != self._known.get(path)

    def keep(self, landmarks: Path, present: LandmarkList, parts: Parts) -> tuple[str, ...]:
        """Write what is not saved of a landmark file; to another name, said once, where a second studio writes too."""
        usual = autosave_path(landmarks)
        path = self._autosaves.get(usual, usual)
        said: tuple[str, ...] = ()
        if self.is_other(path):
            path = self._autosaves[usual] = _free(usual)
            said = (f"another studio has {landmarks.name} open; what is not saved here is kept as {path.name}",)
        write_autosave(path, present, parts)
        self.know(path)
        return said

    def saved(self, landmarks: Path) -> None:
        """Remove what the session has kept, and nobody else's."""
        usual = autosave_path(landmarks)
        path = self._autosaves.pop(usual, usual)
        if not self.is_other(path):
            path.unlink(missing_ok=True)


def write_autosave(path: Path, landmarks: LandmarkList, parts: Parts = (None, None)) -> None:
    """Keep all landmarks, also the one that waits for its other place.

    Parameters
    ----------
    path : Path
    landmarks : LandmarkList
        In the files' numbers.
    parts : (str or None, str or None)
        That are open.
    """
    items = [
        {"number": item.number, "name": item.name, "target": _entry(item.target), "source": _entry(item.source)}
        for item in landmarks.items
    ]
    others = Landmarks.none() if landmarks.elsewhere is None else landmarks.elsewhere
    curves = (landmarks.curves or Curves.none()).joined_with(others.curves)
    kept = {
        "format": _AUTOSAVE,
        "numbers": _NUMBERS,
        "mark": mark(),
        "parts": parts,
        "items": items,
        "pairs": list(map(json.loads, entries(others))),
        "curves": list(map(json.loads, pair_entries(path, curves))),
    }
    write_whole(path, json.dumps(kept, indent=1))


def kept_parts(path: Path) -> Parts:
    """Parts that were open when landmarks were kept; none without a readable autosave, which `read_autosave` names."""
    try:
        data = json.loads(read_text(path, "an autosave of the studio"))
        target, source = data["parts"]
    except (ValueError, KeyError, TypeError, RecursionError, FormatError):
        return None, None
    return target if isinstance(target, str) else None, source if isinstance(source, str) else None


def read_autosave(path: Path, vertices: tuple[int, int]) -> LandmarkList:
    """Read kept landmarks; a file that cannot be used is moved aside, so that the next autosave does not replace it.

    Parameters
    ----------
    path : Path
    vertices : (int, int)
        Vertices of the target's and the source's file.

    Returns
    -------
    landmarks : LandmarkList
        In the files' numbers; which curves lie on the open parts is not known yet.

    Raises
    ------
    FormatError
        If the file is not one of ours, is damaged, or was made for other models.
    """
    try:
        data = json.loads(read_text(path, "an autosave of the studio"))
        if (data["format"], data["numbers"]) != (_AUTOSAVE, _NUMBERS):
            raise KeyError("format")
        items = tuple(
            Landmark(
                int(entry["number"]),
                whole_characters(str(entry["name"])),
                _place(entry["target"], vertices[0]),
                _place(entry["source"], vertices[1]),
            )
            for entry in data["items"]
        )
        others = entered(path, {"pairs": data["pairs"], "curves": data["curves"]})
        sides = (others.target_points, others.curves.target), (others.source_points, others.curves.source)
        for (points, lines), count in zip(sides, vertices, strict=True):
            if max(points.corners.max(initial=-1), lines.points.corners.max(initial=-1)) >= count:
                raise ValueError(f"landmarks of a model that has more than {count} vertices")
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError, FormatError) as error:
        raise FormatError(
            f"{path}: expected an autosave of the studio for these models, found something else ({error!r}). "
            f"It was moved to {set_aside(path).name}."
        ) from None
    curves = others.curves if len(others.curves) else None
    return LandmarkList(items, curves, replace(others, curves=Curves.none()) if len(others) else None)


def set_aside(path: Path) -> Path:
    """Move an autosave out of the way of the next one; returns where it is."""
    return path.rename(_free(path))


def _free(path: Path) -> Path:
    """The name of a file beside it that is not there."""
    return next(name for k in itertools.count(1) if not (name := path.with_name(f"{path.name}.{k}")).exists())


def _entry(place: Place | None) -> dict[str, Any] | None:
    return None if place is None else {"position": place.position, "corners": place.corners, "weights": place.weights}


def _place(entry: Any, vertices: int) -> Place | None:
    if entry is None:
        return None
    x, y, z = map(float, entry["position"])
    a, b, c = map(int, entry["corners"])
    u, v, w = map(float, entry["weights"])
    if not 0 <= min(a, b, c) <= max(a, b, c) < vertices:
        raise ValueError(f"vertices {a}, {b}, {c} of a model that has {vertices}")
    if not (all(map(math.isfinite, (x, y, z, u, v, w))) and abs(u + v + w - 1.0) < _SUM):
        raise ValueError(f"a place at {x}, {y}, {z} with weights {u}, {v}, {w}")
    return Place((x, y, z), (a, b, c), (u, v, w))
