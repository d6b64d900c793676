"""What the page gives out: the files that a finish wrote, by name, and all of them together."""

from __future__ import annotations

import io
import mimetypes
import zipfile
from collections.abc import Iterable
from pathlib import Path

from cagemap.studio.state import Output

ALL = "all.zip"
# Formats that are packed already.
_PACKED = (".png", ".jpg", ".jpeg", ".exr", ".npz", ".usdz", ".zip")


def content(outputs: Iterable[Output], name: str) -> tuple[bytes, str] | None:
    """Content and media type of an output of that very name; folders, and all together, are zips; None for other names.

    The name is compared, never joined to a folder.
    """
    listed = tuple(outputs)
    if name == ALL and listed:
        return zipped(listed), "application/zip"
    folder = next((one for one in listed if one.path.is_dir() and archive_name(one.path) == name), None)
    if folder is not None:
        return zipped((folder,)), "application/zip"
    found = next((output.path for output in listed if output.path.name == name and output.path.is_file()), None)
    if found is None:
        return None
    return found.read_bytes(), mimetypes.guess_type(found.name)[0] or "application/octet-stream"


def archive_name(folder: Path) -> str:
    """What a folder is called as one file."""
    return f"{folder.name}.zip"


def zipped(outputs: Iterable[Output]) -> bytes:
    """All outputs in one archive, folders with what is in them."""
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        for output in outputs:
            for file in sorted(_files(output.path)):
                kind = zipfile.ZIP_STORED if file.suffix.lower() in _PACKED else zipfile.ZIP_DEFLATED
                archive.write(file, file.relative_to(output.path.parent), kind)
    return packed.getvalue()


def _files(path: Path) -> list[Path]:
    """The file, or the regular files of a folder."""
    if not path.is_dir():
        return [path] if path.is_file() else []
    return [file for file in path.rglob("*") if file.is_file() and not file.is_symlink()]
