"""Which files the page may touch."""

from __future__ import annotations

import glob
import itertools
import os
import re
from collections import Counter
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TypeVar

from cagemap.errors import ParameterError
from cagemap.files import IMAGE_SUFFIXES
from cagemap.files.atomic import write_whole
from cagemap.files.images.image import UDIM_MARK, texture_files
from cagemap.files.meshes.formats import MESH_SUFFIXES
from cagemap.files.meshes.obj import named_material_files
from cagemap.files.usd.read import USD_SUFFIXES, asset_paths

MESHES, IMAGES = MESH_SUFFIXES, IMAGE_SUFFIXES
LANDMARKS = (".json", ".pp", ".fcsv", ".csv", ".txt")
TABLES = (".npy", ".npz", ".csv")
# What may be added through the page.
ADDED = tuple(dict.fromkeys((*MESHES, ".mtl", *IMAGES, *LANDMARKS, *TABLES)))
Named = TypeVar("Named")
# Number of a tile, before an image's ending.
_TILE = re.compile(r"^(.*[._])1\d{3}(\.(?:png|jpe?g|tiff?|exr))$", re.IGNORECASE)
# A listing longer than this helps nobody.
_LONGEST_LISTING = 500
# Entries of a folder that are looked at: somebody may start in a folder of everything.
_MOST_ENTRIES = 20_000


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
            If it lies outside the folders, also by way of links; or, of an image's tiles, any does.
        """
        resolved = self._inside(path)
        for tile in texture_files(resolved) if resolved.suffix.lower() in IMAGES else ():
            self._inside(tile)
        return resolved

    def _inside(self, path: str | Path) -> Path:
        try:
            resolved = (self.folders[0] / path).resolve()
            str(resolved).encode()
        except (OSError, RuntimeError, ValueError) as error:  # a loop of links, a name that no page can show
            raise ParameterError(f"{str(path)!r}: expected the name of a file, got none ({error}).") from None
        if not any(resolved.is_relative_to(folder) for folder in self.folders):
            listed = ", ".join(map(str, self.folders))
            raise ParameterError(
                f"{path}: expected a file in {listed}, got one outside. Start the studio with --folder to add a folder."
            )
        return resolved

    def within(self, value: Named) -> Named:
        """A dataclass with every path of its fields resolved.

        Raises
        ------
        ParameterError
            If one lies outside the folders.
        """
        given = {field.name: getattr(value, field.name) for field in fields(value)}  # type: ignore[arg-type]
        paths = {name: self.require(path) for name, path in given.items() if isinstance(path, Path)}
        return replace(value, **paths)  # type: ignore[type-var]

    def require_outputs(self, output: Path) -> None:
        """Refuse to write where links of its name lead out of the folders: an output, its tiles, what is beside it.

        Raises
        ------
        ParameterError
        """
        self.require(output)
        beside = (file for file in output.parent.glob(f"{glob.escape(output.stem)}*") if file.is_symlink())
        inside = (file for file in output.rglob("*") if file.is_symlink()) if output.is_dir() else ()
        for file in (*beside, *inside):
            self.require(file)

    def listing(self, suffixes: tuple[str, ...]) -> tuple[str, ...]:
        """Names of the files with these suffixes, two folders deep, as `require` takes them.

        Tiles of an image stand there as one, with ``<UDIM>`` for their numbers; with "/" among the suffixes, folders
        that hold such files as well.
        """
        found: dict[Path, None] = {}
        for folder in self.folders:
            entries = itertools.chain(folder.glob("*"), folder.glob("*/*"))
            for path in sorted(itertools.islice(entries, _MOST_ENTRIES)):
                hidden = any(part.startswith(".") for part in path.relative_to(folder).parts)
                if path.suffix.lower() not in suffixes or hidden or not _is_shown(path) or not path.is_file():
                    continue
                if "/" in suffixes and path.parent != folder:
                    found.setdefault(path.parent)
                found.setdefault(path)
        return tuple(self.show(path) for path in itertools.islice(_without_tiles(list(found)), _LONGEST_LISTING))

    def add(self, name: str, content: bytes) -> Path:
        """Put a file into the first folder, under its name or, where that is taken, with a number behind it.

        Raises
        ------
        ParameterError
            If it is of no kind that the studio opens, or a mesh that names a file outside the folders.
        FormatError
            If it is an OBJ that is no text or a damaged USD file, or cannot be written.
        """
        wanted = self.require(Path(name).name)
        if wanted.suffix.lower() not in ADDED:
            raise ParameterError(f"{wanted.name}: expected a file ending in {', '.join(ADDED)}. Add one of these.")
        if wanted.suffix.lower() == ".obj":
            for file in named_material_files(wanted.name, content):
                self.require(file)
        if wanted.suffix.lower() in USD_SUFFIXES:
            for file in asset_paths(wanted.name, content):
                self._require_layer(wanted.name, file)
        names = itertools.chain([wanted], (wanted.with_stem(f"{wanted.stem} ({k})") for k in itertools.count(2)))
        free = next(path for path in names if not path.exists())
        write_whole(free, content)
        return free

    def _require_layer(self, name: str, file: str) -> None:
        """Refuse an asset path of a USD file that may lead out of the folders: by itself, or where USD searches."""
        beside = file.startswith(("./", "../")) or (self.folders[0] / file).is_file()
        try:
            if not beside or any(character in file for character in "[:`"):
                raise ParameterError("it is looked for elsewhere")
            self.require(file)
        except ParameterError:
            raise ParameterError(
                f"{name}: expected a USD file that names files of the studio's folder only, got one outside: {file}. "
                "Add a flattened file or a package (usdcat --flatten, .usdz), or start the studio with --folder."
            ) from None

    def show(self, path: Path) -> str:
        """Name of a path as `listing` gives it: from the first folder on."""
        try:
            return os.path.relpath(path, self.folders[0])
        except ValueError:  # another drive
            return str(path)


def _is_shown(path: Path) -> bool:
    """Whether a page can show the name: those of old archives may be no text."""
    try:
        return bool(str(path).encode())
    except UnicodeEncodeError:
        return False


def _without_tiles(files: list[Path]) -> list[Path]:
    """Files, with one name for all tiles of an image that has a first and another one."""
    names = {file: _TILE.sub(rf"\g<1>{UDIM_MARK}\g<2>", file.name) for file in files}
    patterns = {file: file.with_name(name) for file, name in names.items() if name != file.name}
    sets = Counter(patterns.values())
    first = {pattern for file, pattern in patterns.items() if file.name == pattern.name.replace(UDIM_MARK, "1001")}
    whole = {pattern for pattern in first if sets[pattern] > 1}
    shown = (patterns[file] if patterns.get(file) in whole else file for file in files)
    return list(dict.fromkeys(shown))
