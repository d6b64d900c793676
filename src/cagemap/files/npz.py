"""Archives of named arrays (``.npz``), read without pickles and checked."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cagemap.errors import FormatError
from cagemap.files.ownership import mark
from cagemap.numerics.threads import ThreadPool

Arrays = dict[str, NDArray[Any]]


def write_npz(
    path: Path,
    arrays: Mapping[str, NDArray[Any]],
    later: Callable[[], Mapping[str, NDArray[Any]]] = dict,
    *,
    compressed: bool = False,
) -> None:
    """Write arrays to a temporary file of `cagemap.files.atomic`, with cagemap's mark as the archive's comment.

    `numpy.savez` would do the same, but for arrays named ``file`` or ``allow_pickle``.

    Parameters
    ----------
    path : Path
    arrays : mapping of str to array
    later : callable, optional
        Makes more arrays, while those are written.
    compressed : bool

    Raises
    ------
    ValueError
        If an array holds objects.
    """
    method = zipfile.ZIP_DEFLATED if compressed else zipfile.ZIP_STORED
    with zipfile.ZipFile(path, "w", method) as archive, ThreadPool(1) as aside:
        archive.comment = mark().encode()
        more = aside.submit(later)
        _put(archive, arrays)
        _put(archive, more.result())


def _put(archive: zipfile.ZipFile, arrays: Mapping[str, NDArray[Any]]) -> None:
    for name, array in arrays.items():
        with archive.open(f"{name}.npy", "w", force_zip64=True) as stream:
            np.lib.format.write_array(stream, np.asanyarray(array), allow_pickle=False)


def write_npy(path: Path, array: NDArray[Any]) -> None:
    """Write one array to a temporary file of `cagemap.files.atomic`.

    NumPy itself writes to a file through a buffer of C's, and says nothing where the rest of it finds no room.
    """
    content = io.BytesIO()
    np.lib.format.write_array(content, np.asanyarray(array), allow_pickle=False)
    path.write_bytes(content.getbuffer())


def read_npz(path: Path, remedy: str) -> Arrays:
    """Read all arrays of an archive.

    Raises
    ------
    FormatError
        If the file is no archive of arrays, or damaged; says ``remedy``.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            return {
                name.removesuffix(".npy"): read_npy(archive.read(name), path, remedy) for name in archive.namelist()
            }
    except FormatError:
        raise
    except Exception as error:  # whatever a damaged directory makes of it
        raise FormatError(f"{path}: is damaged, or no archive of arrays ({error}). {remedy}") from error


def read_npy(content: bytes, path: Path, remedy: str) -> NDArray[Any]:
    """One array from the content of an ``.npy`` file.

    Raises
    ------
    FormatError
        If it is none, is cut short, or holds Python objects; says ``remedy``.
    """
    try:
        return np.lib.format.read_array(io.BytesIO(content), allow_pickle=False)
    except Exception as error:  # the header is Python text, and what is wrong with it fails in as many ways
        raise FormatError(f"{path}: is damaged, or no array of numbers ({error}). {remedy}") from error
