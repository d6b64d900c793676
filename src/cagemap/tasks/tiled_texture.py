"""Images over a mesh that may have several UDIM tiles."""

from __future__ import annotations

import logging
from pathlib import Path

from cagemap.files.images.image import Image, read_texture, set_of_tile, texture_files
from cagemap.mesh import ControlMesh
from cagemap.transfer.texture import tile_cells

_log = logging.getLogger(__name__)


def read_texture_of(mesh: ControlMesh, path: Path) -> Image | dict[int, Image]:
    """`read_texture`; logs a warning if one tile of a set is repeated over several tiles of the mesh's layout."""
    texture = read_texture(path)
    if isinstance(texture, Image) and len(texture_files(set_of_tile(path))) > 1:
        cells = tile_cells(mesh.uv_corners()[0])
        if (cells != cells[:1]).any():
            text = "%s is repeated over all tiles of the layout of %s: give %s for the whole set"
            _log.warning(text, path, mesh.name, set_of_tile(path))
    return texture
