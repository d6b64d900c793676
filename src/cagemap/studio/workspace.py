"""The folders that the page may read and write, and the files in them."""

from __future__ import annotations

import glob
import itertools
import json
import os
import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from types import MappingProxyType
from typing import TypeVar
from urllib.parse import quote

from cagemap.errors import ParameterError
from cagemap.files import IMAGE_SUFFIXES
from cagemap.files.atomic import write_whole
from cagemap.files.images.image import UDIM_MARK, texture_files
from cagemap.files.meshes.formats import MESH_SUFFIXES
from cagemap.files.meshes.obj import MATERIAL_FILE_LINE, named_material_files
from cagemap.files.meshes.obj_materials import image_options
from cagemap.files.usd.stages import USD_SUFFIXES, asset_paths

LANDMARK_SUFFIXES = (".json", ".pp", ".fcsv", ".csv", ".txt")
TABLE_SUFFIXES = (".npy", ".npz", ".csv")
# Files that can be added through the page.
UPLOAD_SUFFIXES = tuple(
    dict.fromkeys((*MESH_SUFFIXES, ".mtl", ".bin", *IMAGE_SUFFIXES, *LANDMARK_SUFFIXES, *TABLE_SUFFIXES))
)
DataclassT = TypeVar("DataclassT")
# Regular expression of the text before a referenced file name and its options, by suffix of the referring file.
_NAMING_STATEMENTS = {
    ".obj": rb"^[ \t]*mtllib[ \t]+",
    ".mtl": rb"^[ \t]*(?i:map_|bump|disp|decal|norm|refl)\S*[ \t]+",
    ".gltf": rb'"uri"\s*:\s*"',
    ".ply": rb"^comment TextureFile ",
}
_MATERIAL_FILE_LINE = re.compile(MATERIAL_FILE_LINE.pattern.encode())
# A tile's number before an image's ending.
_TILE_NUMBER = re.compile(r"^(.*[._])1\d{3}(\.(?:png|jpe?g|tiff?|exr))$", re.IGNORECASE)
_MAX_LISTED_FILES = 500
# Bounds the time of a listing in very large folders.
_MAX_LISTED_ENTRIES = 20_000


@dataclass(frozen=True)
class Workspace:
    """Folders chosen at the start of the studio; nothing outside them is read or written."""

    folders: tuple[Path, ...]  # resolved; new files are written to the first

    @classmethod
    def of(cls, *folders: Path) -> Workspace:
        """Workspace of folders, without repetitions."""
        return cls(tuple(dict.fromkeys(folder.resolve() for folder in folders)))

    def resolve(self, path: str | Path) -> Path:
        """Return the absolute path; relative ones start at the first folder.

        ParameterError if it, or a tile of an image, lies outside the folders, also through links. Files that a model
        names are not looked at: who may place links in the folders may read them.
        """
        resolved = self._resolve_one(path)
        for tile in texture_files(resolved) if resolved.suffix.lower() in IMAGE_SUFFIXES else ():
            self._resolve_one(tile)
        return resolved

    def _resolve_one(self, path: str | Path) -> Path:
        try:
            resolved = (self.folders[0] / path).resolve()
            str(resolved).encode()
        except (OSError, RuntimeError, ValueError) as error:  # a loop of links, or an invalid name
            raise ParameterError(f"{str(path)!r}: expected the name of a file, got none ({error}).") from None
        if not any(resolved.is_relative_to(folder) for folder in self.folders):
            listed = ", ".join(map(str, self.folders))
            raise ParameterError(
                f"{path}: expected a file in {listed}, got one outside. Start the studio with --folder to add a folder."
            )
        return resolved

    def resolve_paths(self, value: DataclassT) -> DataclassT:
        """Resolve every path among a dataclass's fields.

        ParameterError if one lies outside the folders.
        """
        values = {field.name: getattr(value, field.name) for field in fields(value)}  # type: ignore[arg-type]
        paths = {name: self.resolve(item) for name, item in values.items() if isinstance(item, Path)}
        return replace(value, **paths)  # type: ignore[type-var]

    def require_outputs(self, output: Path) -> None:
        """Refuse an output whose links, or those of files next to it, lead outside."""
        self.resolve(output)
        siblings = (file for file in output.parent.glob(f"{glob.escape(output.stem)}*") if file.is_symlink())
        contents = (file for file in output.rglob("*") if file.is_symlink()) if output.is_dir() else ()
        for file in (*siblings, *contents):
            self.resolve(file)

    def list_files(self, suffixes: tuple[str, ...]) -> tuple[str, ...]:
        """Names of the files with these suffixes in the folders and their subfolders.

        An image's tiles are one name with ``<UDIM>``. With "/" among the suffixes, subfolders with such files are
        listed too.
        """
        paths: dict[Path, None] = {}
        for folder in self.folders:
            entries = itertools.chain(folder.glob("*"), folder.glob("*/*"))
            for path in sorted(itertools.islice(entries, _MAX_LISTED_ENTRIES)):
                hidden = any(part.startswith(".") for part in path.relative_to(folder).parts)
                if path.suffix.lower() not in suffixes or hidden or not _has_text_name(path) or not path.is_file():
                    continue
                if "/" in suffixes and path.parent != folder:
                    paths.setdefault(path.parent)
                paths.setdefault(path)
        return tuple(map(self.display_name, itertools.islice(_merge_tiles(list(paths)), _MAX_LISTED_FILES)))

    def add(self, name: str, content: bytes, added_names: Mapping[str, str] = MappingProxyType({})) -> Path:
        """Write a new file into the first folder, numbered if a file of other content has the name.

        ``added_names``: names under which files of the same drop were added, by the given ones: an OBJ, MTL, glTF or
            PLY file names these.
        ParameterError if the studio does not open such files, or a mesh refers to a file outside the folders.
        FormatError if it is an OBJ that is no text or a damaged USD file, or cannot be written.
        """
        path = self.resolve(Path(name).name)
        if path.suffix.lower() not in UPLOAD_SUFFIXES:
            raise ParameterError(
                f"{path.name}: expected a file ending in {', '.join(UPLOAD_SUFFIXES)}. Add one of these."
            )
        if path.suffix.lower() == ".obj":
            for file in named_material_files(path.name, content):
                self.resolve(file)
        # A file that is already there, dropped again with files of the same names, is used as it is.
        if any(given != written for given, written in added_names.items()) or not _has_content(path, content):
            content = _with_added_names(path.suffix.lower(), content, added_names)
        if path.suffix.lower() in USD_SUFFIXES:
            for file in asset_paths(path.name, content):
                self._require_layer(path.name, file)
        names = itertools.chain([path], (path.with_stem(f"{path.stem} ({k})") for k in itertools.count(2)))
        chosen = next(path for path in names if not path.exists() or _has_content(path, content))
        if not chosen.exists():
            write_whole(chosen, content)
        return chosen

    def _require_layer(self, name: str, file: str) -> None:
        """Refuse an asset path that USD may resolve to a file outside the folders."""
        is_local = file.startswith(("./", "../")) or (self.folders[0] / file).is_file()
        try:
            if not is_local or any(character in file for character in "[:`"):
                raise ParameterError("it is looked for elsewhere")
            self.resolve(file)
        except ParameterError:
            raise ParameterError(
                f"{name}: expected a USD file that names files of the studio's folder only, got one outside: {file}. "
                "Add a flattened file or a package (usdcat --flatten, .usdz), or start the studio with --folder."
            ) from None

    def display_name(self, path: Path) -> str:
        """Path relative to the first folder, as `list_files` gives it."""
        return relative_path(path, self.folders[0])


def relative_path(path: Path, folder: Path) -> str:
    """Path relative to a folder; the absolute one on another drive."""
    try:
        return os.path.relpath(path, folder)
    except ValueError:
        return str(path)


def _has_content(path: Path, content: bytes) -> bool:
    return path.is_file() and path.stat().st_size == len(content) and path.read_bytes() == content


def _with_added_names(suffix: str, content: bytes, added_names: Mapping[str, str]) -> bytes:
    """A file's content in which references to files of the same drop are their names as added, without folders."""
    if suffix not in _NAMING_STATEMENTS or not added_names:
        return content
    if suffix == ".obj":
        content = _MATERIAL_FILE_LINE.sub(_split_material_files, content)
    names = {given: quote(written) if suffix == ".gltf" else written for given, written in added_names.items()}
    names |= {form: name for given, name in names.items() for form in (quote(given), json.dumps(given)[1:-1])}
    # The part of a name that is replaced; the name ends there, or before a comment.
    replaced = re.compile(rf"(?:.*[/\\])?({'|'.join(map(re.escape, names))})(?=$|[ \t]+#)")

    def renamed(statement: re.Match[bytes]) -> bytes:
        line = statement[2].decode(errors="surrogateescape")
        name = image_options(line)[1] if suffix == ".mtl" else line.strip()
        if (found := replaced.match(name)) is None:
            return statement[0]
        before, _, after = line.rpartition(name)
        line = before + names[found[1]] + name[found.end() :] + after
        return statement[1] + line.encode(errors="surrogateescape")

    return re.sub(rb'(%s)([^"\n]*)' % _NAMING_STATEMENTS[suffix], renamed, content, flags=re.MULTILINE)


def _split_material_files(line: re.Match[bytes]) -> bytes:
    """One ``mtllib`` line for each file of a line, since the names as added may have spaces."""
    words = re.sub(rb"\\[ \t]*\n", b" ", line[1]).split()
    several = len(words) > 1 and all(word.lower().endswith(b".mtl") for word in words)
    return b"".join(b"mtllib %s\n" % word for word in words) if several else line[0]


def _has_text_name(path: Path) -> bool:
    """Whether the name is valid text; names from old archives may not be."""
    try:
        return bool(str(path).encode())
    except UnicodeEncodeError:
        return False


def _merge_tiles(files: list[Path]) -> list[Path]:
    """Replace an image's tiles by one name, where tile 1001 and another one exist."""
    names = {file: _TILE_NUMBER.sub(rf"\g<1>{UDIM_MARK}\g<2>", file.name) for file in files}
    patterns = {file: file.with_name(name) for file, name in names.items() if name != file.name}
    counts = Counter(patterns.values())
    firsts = {pattern for file, pattern in patterns.items() if file.name == pattern.name.replace(UDIM_MARK, "1001")}
    tiled = {pattern for pattern in firsts if counts[pattern] > 1}
    return list(dict.fromkeys(patterns[file] if patterns.get(file) in tiled else file for file in files))
