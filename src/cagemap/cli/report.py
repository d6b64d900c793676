"""`cagemap report`: RESULT folder in, one HTML page out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from cagemap.cli.progress import Stages
from cagemap.errors import FormatError
from cagemap.files.images import Image, Pixels, read_image, read_texture
from cagemap.files.result import Result, read_result
from cagemap.report import write_report


def run_report(folder: Path, output: Path, texture: Path | None, stages: Stages) -> None:
    """Write the report of a RESULT folder.

    Without ``texture`` the last baked texture that the result knows of is shown, if its files are still there.
    """
    stages("read")
    result = read_result(folder)
    source, baked = _texture_to_show(result, texture)
    stages("draw")
    write_report(output, result, texture=source, baked=baked)


def _texture_to_show(result: Result, texture: Path | None) -> tuple[Pixels | None, Pixels | None]:
    """Pixels of the source's texture and of what was baked from it; None for what is not known."""
    known = [entry for entry in result.manifest.get("transfers", []) if entry.get("kind") == "texture"]
    if texture is not None:
        known = [entry for entry in known if entry.get("image") == str(texture.resolve())]
        return _single(texture), _baked(known[-1]) if known else None
    for entry in reversed(known):
        try:
            return _single(Path(entry["image"])), _baked(entry)
        except FormatError:  # moved or deleted since
            continue
    return None, None


def _single(path: Path) -> Pixels | None:
    """Pixels of a texture that is one image; tiles are not shown."""
    read = read_texture(path)
    return read.pixels if isinstance(read, Image) else None


def _baked(entry: dict[str, Any]) -> Pixels | None:
    # A layout made by --unwrap is not the target's own, and is not stored with the result.
    if entry.get("unwrapped") or len(entry.get("tiles", [0])) != 1:
        return None
    return read_image(entry["output"]).pixels
