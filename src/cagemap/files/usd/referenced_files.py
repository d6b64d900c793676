"""Which other files a USD file names: layers, payloads, clips, images."""

from __future__ import annotations

import glob
import posixpath
import tempfile
from fnmatch import fnmatchcase
from pathlib import Path

from cagemap.errors import FormatError
from cagemap.files.usd.read import usd_modules

_LAYERS = (".usd", ".usda", ".usdc")


def asset_paths(name: str, content: bytes) -> tuple[str, ...]:
    """Asset paths of a USD file, in any place that holds them, as they are written; none of them is opened.

    Paths of a package to its own entries are left out.

    ``name``: of the file; its ending says how it is read.
    """
    pxr = usd_modules()
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"layer{Path(name).suffix}"
        file.write_bytes(content)
        try:
            if file.suffix.lower() != ".usdz":
                return _of_layer(str(file))
            entries = list(pxr.Sdf.ZipFile.Open(str(file)).GetFileNames())
            found = {entry: _of_layer(f"{file}[{entry}]") for entry in entries if entry.lower().endswith(_LAYERS)}
        except (pxr.Tf.ErrorException, UnicodeDecodeError, AttributeError):
            raise FormatError(f"{name}: cannot be read as USD. Export it again.") from None
    if any(entry.lower().endswith(".usdz") for entry in entries):
        raise FormatError(f"{name}: expected a package of layers and images, got a package within it. Flatten it.")
    return tuple(path for entry, paths in found.items() for path in paths if not _is_entry(entry, path, entries))


def _of_layer(path: str) -> tuple[str, ...]:
    """Every asset path of one layer; expressions as they are written and as they read in this layer."""
    pxr = usd_modules()
    sublayers, references, payloads = pxr.UsdUtils.ExtractExternalReferences(path)
    composed = pxr.Sdf.Layer.FindOrOpen(path).GetCompositionAssetDependencies()
    return tuple(sorted({*sublayers, *references, *payloads, *composed}))


def _is_entry(layer: str, path: str, entries: list[str]) -> bool:
    """Whether a path of a package's layer is one of its entries, or of tiles among them."""
    wanted = posixpath.normpath(posixpath.join(posixpath.dirname(layer), path))
    pattern = glob.escape(wanted).replace("<UDIM>", "????")
    return any(fnmatchcase(entry, pattern) for entry in entries)
