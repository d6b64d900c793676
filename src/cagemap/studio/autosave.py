"""Unsaved landmarks in a hidden file, with the vertex numbers of the models' files."""

from __future__ import annotations

import itertools
import json
import math
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from cagemap.errors import FormatError
from cagemap.files.atomic import write_whole
from cagemap.files.landmarks.curves import pair_entries
from cagemap.files.landmarks.pairs import format_pairs, parse_landmarks
from cagemap.files.ownership import mark
from cagemap.files.result.manifest import file_hash
from cagemap.files.text import read_text, whole_characters
from cagemap.mesh.cage_points import CagePoints
from cagemap.mesh.landmarks import Landmarks
from cagemap.studio.landmarks import SIDES, Landmark, LandmarkList, Place, SideNames

_FORMAT = "cagemap-studio-autosave"
_NUMBERING = "of the files"
_WEIGHT_SUM_TOLERANCE = 1e-3


def autosave_path(landmarks: Path) -> Path:
    """Autosave of a landmark file."""
    return landmarks.with_name(f".{landmarks.name}.autosave")


class FileTracker:
    """Remembers the files that this session last read or wrote, to detect changes by others."""

    def __init__(self) -> None:
        self._hashes: dict[Path, str] = {}
        self._autosaves: dict[Path, Path] = {}

    def record(self, path: Path) -> None:
        """Remember a file as it is now; called before reading and after writing."""
        if path.is_file():
            self._hashes[path] = file_hash(path)

    def is_changed(self, path: Path) -> bool:
        """Whether a file has content that the session neither read nor wrote."""
        return path.is_file() and file_hash(path) != self._hashes.get(path)

    def autosave(self, landmarks: Path, present: LandmarkList, parts: SideNames, models: SideNames) -> tuple[str, ...]:
        """Write unsaved landmarks, under another name if a second studio uses the autosave; return notes."""
        default = autosave_path(landmarks)
        path = self._autosaves.get(default, default)
        notes: tuple[str, ...] = ()
        if self.is_changed(path):
            path = self._autosaves[default] = _unused_name(default)
            notes = (f"another studio has {landmarks.name} open; unsaved landmarks of this one are in {path.name}",)
        write_autosave(path, present, parts, models)
        self.record(path)
        return notes

    def remove_autosave(self, landmarks: Path) -> None:
        """Remove this session's autosave, not that of others."""
        default = autosave_path(landmarks)
        path = self._autosaves.pop(default, default)
        if not self.is_changed(path):
            path.unlink(missing_ok=True)


def write_autosave(
    path: Path, landmarks: LandmarkList, parts: SideNames = (None, None), models: SideNames = (None, None)
) -> None:
    """Write all landmarks, including the incomplete one.

    ``landmarks``: with the files' vertex numbers.
    ``models``: names by which `read_autosave` recognises target and source.
    """
    unused = Landmarks.none() if landmarks.unused_landmarks is None else landmarks.unused_landmarks
    content = {
        "format": _FORMAT,
        "numbers": _NUMBERING,
        "mark": mark(),
        "models": models,
        "parts": parts,
        "items": list(map(asdict, landmarks.items)),
        "pairs": list(map(json.loads, format_pairs(unused))),
        "curves": list(map(json.loads, pair_entries(path, landmarks.curves + unused.curves))),
    }
    write_whole(path, json.dumps(content, indent=1))


def read_autosave_parts(path: Path) -> SideNames:
    """Parts that were open at the time of an autosave; none for an unreadable file."""
    try:
        data = json.loads(read_text(path, "an autosave of the studio"))
        target, source = data["parts"]
    except (ValueError, KeyError, TypeError, RecursionError, FormatError):
        return None, None
    return target if isinstance(target, str) else None, source if isinstance(source, str) else None


def read_autosave(path: Path, vertices: tuple[int, int], models: SideNames = (None, None)) -> LandmarkList:
    """Landmarks with the files' vertex numbers, and curves of all parts; an unusable file is renamed.

    ``vertices``: vertex counts of the target's and the source's file.
    ``models``: see `write_autosave`; None: any model.
    FormatError if the file is no autosave, is damaged, or was made for other models.
    """
    try:
        data = json.loads(read_text(path, "an autosave of the studio"))
        if (data["format"], data["numbers"]) != (_FORMAT, _NUMBERING):
            raise KeyError("format")
        for name, recorded in zip(models, data.get("models", models), strict=True):
            if name is not None and recorded not in (None, name):
                raise ValueError(f"landmarks of {recorded}")
        items = tuple(
            Landmark(
                int(entry["number"]),
                whole_characters(str(entry["name"])),
                _from_entry(entry["target"], vertices[0]),
                _from_entry(entry["source"], vertices[1]),
            )
            for entry in data["items"]
        )
        unused = parse_landmarks(path, {"pairs": data["pairs"], "curves": data["curves"]})
        for side, count in zip(SIDES, vertices, strict=True):
            points = getattr(unused, f"{side}_points"), *(getattr(pair, side).points for pair in unused.curves)
            if CagePoints.joined(points).corners.max(initial=-1) >= count:
                raise ValueError(f"landmarks of a model that has more than {count} vertices")
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError, FormatError) as error:
        raise FormatError(
            f"{path}: expected an autosave of the studio for these models, found something else ({error!r}). "
            f"It was moved to {move_aside(path).name}."
        ) from None
    return LandmarkList(items, unused.curves, replace(unused, curves=()) if len(unused) else None)


def move_aside(path: Path) -> Path:
    """Rename an autosave to an unused name; return the new path."""
    return path.rename(_unused_name(path))


def _unused_name(path: Path) -> Path:
    return next(name for k in itertools.count(1) if not (name := path.with_name(f"{path.name}.{k}")).exists())


def _from_entry(entry: Any, vertices: int) -> Place | None:
    if entry is None:
        return None
    x, y, z = map(float, entry["position"])
    a, b, c = map(int, entry["corners"])
    u, v, w = map(float, entry["weights"])
    if not 0 <= min(a, b, c) <= max(a, b, c) < vertices:
        raise ValueError(f"vertices {a}, {b}, {c} of a model that has {vertices}")
    if not (all(map(math.isfinite, (x, y, z, u, v, w))) and abs(u + v + w - 1.0) < _WEIGHT_SUM_TOLERANCE):
        raise ValueError(f"a place at {x}, {y}, {z} with weights {u}, {v}, {w}")
    return Place((x, y, z), (a, b, c), (u, v, w))
