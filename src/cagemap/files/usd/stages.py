"""Opening of USD files, errors of damaged ones, and the layers and images that they refer to.

USD is an extra, ``cagemap[usd]``, imported when a USD file is read or written.
"""

from __future__ import annotations

import glob
import itertools
import logging
import posixpath
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np

from cagemap.errors import FormatError
from cagemap.files.images.image import texture_files
from cagemap.files.text import text_name
from cagemap.files.usd.crate import check_crate

logger = logging.getLogger(__name__)

USD_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")


def is_usd(path: Path) -> bool:
    """Whether a file's name ends as those of USD do."""
    return path.suffix.lower() in USD_SUFFIXES


class _UsdModules:
    """The package ``pxr``, imported when it is first used."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):  # `inspect` and `copy` ask for names that any object may lack
            raise AttributeError(name)
        return getattr(usd_modules(), name)


pxr: Any = _UsdModules()


def usd_modules() -> Any:
    """The ``pxr`` package, with the modules that are used."""
    try:
        import pxr
        import pxr.Usd
        import pxr.UsdGeom
        import pxr.UsdShade
        import pxr.UsdSkel
        import pxr.UsdUtils
    except ImportError:
        raise FormatError(
            "USD files: expected the package usd-core, which is not installed. Install cagemap[usd] or usd-core."
        ) from None
    return pxr


def identifiers(names: Iterable[str], taken: Iterable[str] = ()) -> list[str]:
    """Valid, unique names of prims and primvars: other characters become ``_``, repeated names get numbers."""
    used, unique = set(taken), list[str]()
    for name in names:
        word = pxr.Tf.MakeValidIdentifier(name)
        free = itertools.chain([word], (f"{word}_{number}" for number in itertools.count(2)))
        unique.append(next(candidate for candidate in free if candidate not in used))
        used.add(unique[-1])
    return unique


def open_stage(path: str | Path, *, warn: bool = True) -> Any:
    """Open a USD file; with ``warn``, warns of missing files that it refers to."""
    stage, reasons = _open_with_messages(Path(path))
    for reason in reasons if warn else ():
        logger.warning("%s: %s", path, reason)
    return stage


def _open_with_messages(file: Path) -> tuple[Any, list[str]]:
    """The stage of a file, and what USD says of files that it refers to."""
    check_crate(file)
    # Collects USD's messages, which would name its own source files on the console
    diagnostics = pxr.UsdUtils.CoalescingDiagnosticDelegate()
    try:
        stage = pxr.Usd.Stage.Open(text_name(file))
        reasons = (
            entry.commentary.partition(" (instantiating stage ")[0]
            for entry in diagnostics.TakeUncoalescedDiagnostics()
        )
        return stage, list(dict.fromkeys(reasons))
    except (pxr.Tf.ErrorException, UnicodeDecodeError) as error:
        raise FormatError(f"{file}: cannot be read as USD ({_reason(error)}). Export it again.") from None


@contextmanager
def open_each_once() -> Iterator[None]:
    """Have `open_stage` open every file once in the block, so that its warnings are not repeated."""
    cache = pxr.Usd.StageCache()
    with pxr.Usd.StageCacheContext(cache):
        yield


def other_files(path: str | Path) -> list[Path]:
    """Existing files of the other layers that a USD file is composed of, and of all images that its layers name."""
    stage, _ = _open_with_messages(Path(path))  # a variable, since its layers are freed with the stage
    with damage_as_error(path):
        layers = [layer for layer in stage.GetUsedLayers() if layer.realPath]
        assets = (layer.ComputeAbsolutePath(asset) for layer in layers for asset in _layer_paths(layer.realPath))
        files = {
            *(Path(layer.realPath) for layer in layers),
            *(tile for name in assets for tile in texture_files(name)),
        }
    own = Path(stage.GetRootLayer().realPath)
    return sorted(file for file in files if file.is_file() and file != own)  # entries of a .usdz are no files


def _reason(error: Exception) -> str:
    """The last line of an error of USD; the type's name if its message is not valid text."""
    try:
        last = (str(error).strip().splitlines() or [type(error).__name__])[-1]
        place, _, words = last.rpartition(" : '")
        return words.removesuffix("'") if place else last
    except UnicodeDecodeError:
        return type(error).__name__


@contextmanager
def damage_as_error(file: str | Path) -> Iterator[None]:
    """Turn errors of damaged values into a FormatError; USD unpacks values only when they are read.

    NumPy's warnings of signalling NaN are switched off: readers check that values are finite.
    """
    diagnostics = pxr.UsdUtils.CoalescingDiagnosticDelegate()  # as in `_open_with_messages`
    try:
        with np.errstate(invalid="ignore"):
            yield
    except FormatError:
        raise
    except (pxr.Tf.ErrorException, RuntimeError, UnicodeDecodeError, TypeError, ValueError) as error:
        raise FormatError(f"{file}: holds values that are damaged ({_reason(error)}). Export it again.") from None
    finally:
        for entry in diagnostics.TakeUncoalescedDiagnostics():
            logger.debug("%s: %s", file, entry.commentary)


_LAYERS = (".usd", ".usda", ".usdc")


def asset_paths(name: str, content: bytes) -> tuple[str, ...]:
    """All asset paths in a USD file, as written; none of them is opened.

    Paths of a package to its own entries are left out.

    ``name``: of the file; its suffix gives the format.
    """
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"layer{Path(name).suffix}"
        file.write_bytes(content)
        try:
            if file.suffix.lower() != ".usdz":
                return _layer_paths(str(file))
            holder = pxr.Sdf if hasattr(pxr.Sdf, "ZipFile") else pxr.Usd  # of older versions, such as 24.8
            entries = list(holder.ZipFile.Open(str(file)).GetFileNames())
            paths_of = {entry: _layer_paths(f"{file}[{entry}]") for entry in entries if entry.lower().endswith(_LAYERS)}
        except (pxr.Tf.ErrorException, UnicodeDecodeError, AttributeError):
            raise FormatError(f"{name}: cannot be read as USD. Export it again.") from None
    if any(entry.lower().endswith(".usdz") for entry in entries):
        raise FormatError(f"{name}: expected a package of layers and images, got a package within it. Flatten it.")
    return tuple(path for entry, paths in paths_of.items() for path in paths if not _is_entry(entry, path, entries))


def _layer_paths(path: str) -> tuple[str, ...]:
    """All asset paths of a layer; expressions both as written and as evaluated in this layer."""
    sublayers, references, payloads = pxr.UsdUtils.ExtractExternalReferences(path)
    composed = pxr.Sdf.Layer.FindOrOpen(path).GetCompositionAssetDependencies()
    return tuple(sorted({*sublayers, *references, *payloads, *composed}))


def _is_entry(layer: str, path: str, entries: list[str]) -> bool:
    """Whether a path in a package's layer is one of its entries, or a pattern of tiles among them."""
    wanted = posixpath.normpath(posixpath.join(posixpath.dirname(layer), path))
    pattern = glob.escape(wanted).replace("<UDIM>", "????")
    return any(fnmatchcase(entry, pattern) for entry in entries)
