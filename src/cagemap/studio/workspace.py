"""Which files the page may touch, and the autosave beside the landmark file."""

from __future__ import annotations

import itertools
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cagemap.errors import FormatError, ParameterError
from cagemap.files.atomic import atomic_path
from cagemap.files.marks import mark
from cagemap.files.text import read_text
from cagemap.studio.landmarks import Landmark, LandmarkList, Place

MESHES = (".obj", ".ply")
IMAGES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".exr")
LANDMARKS = (".json", ".pp", ".fcsv", ".csv", ".txt")
# What may be added through the page.
ADDED = (*MESHES, ".mtl", *IMAGES, *LANDMARKS)
_AUTOSAVE = "cagemap-studio-autosave"
# A listing longer than this helps nobody.
_LONGEST_LISTING = 500


@dataclass(frozen=True)
class Workspace:
    """The folders that were chosen when the studio was started; nothing outside them is read or written.

    Attributes
    ----------
    folders : tuple of Path
        Resolved; the first is where new files go.
    """

    folders: tuple[Path, ...]

    @classmethod
    def of(cls, *folders: Path) -> Workspace:
        """Workspace of some folders, each once."""
        return cls(tuple(dict.fromkeys(folder.resolve() for folder in folders)))

    def require(self, path: str | Path) -> Path:
        """Resolve a path, relative ones against the first folder.

        Raises
        ------
        ParameterError
            If it lies outside the folders, also by way of links.
        """
        resolved = (self.folders[0] / path).resolve()
        if not any(resolved.is_relative_to(folder) for folder in self.folders):
            listed = ", ".join(map(str, self.folders))
            raise ParameterError(
                f"{path}: expected a file in {listed}, got one outside. Start the studio with --folder to add a folder."
            )
        return resolved

    def listing(self, suffixes: tuple[str, ...]) -> tuple[str, ...]:
        """Names of the files with these suffixes, two folders deep, as `require` takes them."""
        found: list[str] = []
        for number, folder in enumerate(self.folders):
            files = [path for pattern in ("*", "*/*") for path in folder.glob(pattern)]
            for path in sorted(files):
                hidden = any(part.startswith(".") for part in path.relative_to(folder).parts)
                if path.suffix.lower() in suffixes and not hidden and path.is_file():
                    found.append(str(path.relative_to(folder)) if number == 0 else str(path))
        return tuple(found[:_LONGEST_LISTING])

    def add(self, name: str, content: bytes) -> Path:
        """Put a file into the first folder, under its name or, where that is taken, with a number behind it.

        Raises
        ------
        ParameterError
            If it is of no kind that the studio opens.
        FormatError
            If it cannot be written.
        """
        wanted = self.require(Path(name).name)
        if wanted.suffix.lower() not in ADDED:
            raise ParameterError(f"{wanted.name}: expected a file ending in {', '.join(ADDED)}. Add one of these.")
        names = itertools.chain([wanted], (wanted.with_stem(f"{wanted.stem} ({k})") for k in itertools.count(2)))
        free = next(path for path in names if not path.exists())
        with atomic_path(free) as temporary:
            temporary.write_bytes(content)
        return free

    def show(self, path: Path) -> str:
        """Name of a path as `listing` gives it."""
        first = self.folders[0]
        return str(path.relative_to(first)) if path.is_relative_to(first) else str(path)


def autosave_path(landmarks: Path) -> Path:
    """Where unsaved landmarks are kept."""
    return landmarks.with_name(f".{landmarks.name}.autosave")


def write_autosave(path: Path, landmarks: LandmarkList) -> None:
    """Keep all landmarks, also the one that waits for its other place."""
    items = [
        {"number": item.number, "name": item.name, "target": _entry(item.target), "source": _entry(item.source)}
        for item in landmarks.items
    ]
    with atomic_path(path) as temporary:
        temporary.write_text(
            json.dumps({"format": _AUTOSAVE, "mark": mark(), "items": items}, indent=1), encoding="utf-8"
        )


def read_autosave(path: Path, vertices: tuple[int, int]) -> LandmarkList:
    """Read kept landmarks; a file that cannot be used is moved aside, so that the next autosave does not replace it.

    Parameters
    ----------
    vertices : (int, int)
        Control vertices of target and source.

    Raises
    ------
    FormatError
        If the file is not one of ours, is damaged, or was made for other models.
    """
    try:
        data = json.loads(read_text(path, "an autosave of the studio"))
        if data["format"] != _AUTOSAVE:
            raise KeyError("format")
        items = tuple(
            Landmark(
                int(entry["number"]),
                str(entry["name"]),
                _place(entry["target"], vertices[0]),
                _place(entry["source"], vertices[1]),
            )
            for entry in data["items"]
        )
    except (ValueError, KeyError, TypeError) as error:
        aside = next(name for k in itertools.count(1) if not (name := path.with_name(f"{path.name}.{k}")).exists())
        path.rename(aside)
        raise FormatError(
            f"{path}: expected an autosave of the studio for these models, found something else ({error!r}). "
            f"It was moved to {aside.name}."
        ) from None
    return LandmarkList(items)


def _entry(place: Place | None) -> dict[str, Any] | None:
    return None if place is None else {"position": place.position, "corners": place.corners, "weights": place.weights}


def _place(entry: Any, vertices: int) -> Place | None:
    if entry is None:
        return None
    x, y, z = map(float, entry["position"])
    a, b, c = map(int, entry["corners"])
    u, v, w = map(float, entry["weights"])
    if not 0 <= min(a, b, c) <= max(a, b, c) < vertices:
        raise ValueError(f"control vertices {a}, {b}, {c} of a model that has {vertices}")
    return Place((x, y, z), (a, b, c), (u, v, w))
