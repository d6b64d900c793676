"""`cagemap report`: RESULT folder in, one HTML page out."""

from __future__ import annotations

import logging
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

from cagemap.cli.progress import Stages
from cagemap.errors import FormatError
from cagemap.files.atomic import check_outputs
from cagemap.files.images import Image, Pixels, read_image, read_texture
from cagemap.files.meshes import read_mesh
from cagemap.files.result import ARRAYS, MANIFEST, Result, read_result
from cagemap.report import write_report

_log = logging.getLogger(__name__)


def run_report(folder: Path, output: Path, texture: Path | None, stages: Stages, *, force: bool = False) -> None:
    """Write the report of a RESULT folder.

    Without ``texture`` the last baked texture that the result knows of is shown, if its files are still there.
    """
    stages("read result")
    check_outputs([output], [folder / MANIFEST, folder / ARRAYS], force=force)
    result = read_result(folder)
    known = [entry for entry in result.manifest.get("transfers", []) if entry.get("kind") == "texture"]
    if texture is None:
        known = [entry for entry in known if (folder / entry["image"]).is_file()]
        texture = folder / known[-1]["image"] if known else None
    if texture is not None:
        check_outputs([output], [texture], force=force)
    pixels = None if texture is None else _single(texture)
    baked = None
    for entry in known:
        if texture is not None and _same(folder / entry["image"], texture):
            try:
                result, baked = _baked(folder, result, entry)
            except FormatError as error:
                _log.info("the texture is shown vertex by vertex, what was baked is not there any more: %s", error)
                continue
    stages("draw")
    write_report(output, result, texture=pixels, baked=baked, force=force)


def _single(path: Path) -> Pixels | None:
    """Pixels of a texture that is one image; tiles are not shown."""
    read = read_texture(path)
    return read.pixels if isinstance(read, Image) else None


def _same(a: Path, b: Path) -> bool:
    return os.path.realpath(a) == os.path.realpath(b)


def _baked(folder: Path, result: Result, entry: dict[str, Any]) -> tuple[Result, Pixels | None]:
    """What was baked, and the result with the layout that it was baked into."""
    if len(entry.get("tiles", [0])) != 1:
        return result, None
    pixels = read_image(folder / entry["output"]).pixels
    if entry.get("mesh") is None:
        return result, pixels
    laid_out = read_mesh(folder / entry["mesh"])
    control = result.target.control.with_uvs(laid_out.uvs, laid_out.uv_indices)
    return replace(result, target=result.target.with_control(control)), pixels
