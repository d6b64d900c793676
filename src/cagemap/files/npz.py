"""Archives of named arrays (``.npz``), read without pickles and checked by specifications (type, shape, range).

Specifications name the sizes in shapes; a name is one size in all arrays of a file. Compiled kernels rely on these
checks: no index is out of range, and no number is NaN unless allowed.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from cagemap.errors import FormatError
from cagemap.files.ownership import mark
from cagemap.numerics.arrays import as_float64
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

    `numpy.savez` cannot write arrays named ``file`` or ``allow_pickle``.

    ``later``: computes more arrays while the first ones are written.
    """
    method = zipfile.ZIP_DEFLATED if compressed else zipfile.ZIP_STORED
    with zipfile.ZipFile(path, "w", method) as archive, ThreadPool(1) as pool:
        archive.comment = mark().encode()
        more = pool.submit(later)
        _put(archive, arrays)
        _put(archive, more.result())


def _put(archive: zipfile.ZipFile, arrays: Mapping[str, NDArray[Any]]) -> None:
    for name, array in arrays.items():
        with archive.open(f"{name}.npy", "w", force_zip64=True) as stream:
            np.lib.format.write_array(stream, np.asanyarray(array), allow_pickle=False)


def write_npy(path: Path, array: NDArray[Any]) -> None:
    """Write one array to a temporary file of `cagemap.files.atomic`.

    NumPy writes to a file through a C buffer and reports no error if the last part of it does not fit on the disk.
    """
    content = io.BytesIO()
    np.lib.format.write_array(content, np.asanyarray(array), allow_pickle=False)
    path.write_bytes(content.getbuffer())


def read_npz(path: Path, remedy: str) -> Arrays:
    """Read all arrays of an archive."""
    try:
        with zipfile.ZipFile(path) as archive:
            return {
                name.removesuffix(".npy"): read_npy(archive.read(name), path, remedy) for name in archive.namelist()
            }
    except FormatError:
        raise
    except Exception as error:  # a damaged directory raises errors of many types
        raise FormatError(f"{path}: is damaged, or no archive of arrays ({error}). {remedy}") from error


def read_npy(content: bytes, path: Path, remedy: str) -> NDArray[Any]:
    """The array in the content of an ``.npy`` file."""
    try:
        return np.lib.format.read_array(io.BytesIO(content), allow_pickle=False)
    except Exception as error:  # the header is Python text; a damaged one raises errors of many types
        raise FormatError(f"{path}: is damaged, or no array of numbers ({error}). {remedy}") from error


# Squares and volumes of larger numbers overflow.
_LARGEST = 1e100
# Tolerance of barycentric coordinates: beyond [0, 1], and of their sum.
_BARYCENTRIC_ROUNDING = 1e-6


@dataclass(frozen=True)
class ArraySpec:
    """Specification of an array: shape, range, and whether it may be missing."""

    shape: tuple[str | int, ...]  # a name is a size that is the same in all arrays of a file; "3|4" allows either
    below: str = ""  # name of the size that entries are indices into; empty for floats
    optional: bool = False  # the array may be missing
    nan: bool = False  # unknown values are NaN; infinite ones are allowed too
    share: bool = False  # values are from 0 to 1


@dataclass(frozen=True, eq=False)
class Archive:
    """Arrays of a file, which are checked when they are taken."""

    path: Path
    arrays: Mapping[str, NDArray[Any]] = field(repr=False)
    remedy: str  # last sentence of every message

    def refuse(self, problem: str) -> NoReturn:
        """Raise a FormatError that names the file."""
        raise FormatError(f"{self.path}: {problem}. {self.remedy}")

    def take(self, specs: Mapping[str, ArraySpec], sizes: dict[str, int]) -> dict[str, NDArray[Any]]:
        """Arrays checked by their specs, as read-only int64 or float64; arrays without a spec are left out.

        ``sizes``: known sizes by name; sizes found in the arrays are added.
        """
        missing = [name for name, spec in specs.items() if name not in self.arrays and not spec.optional]
        if missing:
            self.refuse(f"lacks {', '.join(map(repr, missing))}")
        present = {name: spec for name, spec in specs.items() if name in self.arrays}
        for name, spec in present.items():
            self._check_shape(name, spec, sizes)
        return {name: self._check_values(name, spec, sizes) for name, spec in present.items()}

    def check_offsets(self, name: str, offsets: NDArray[Any], count: int) -> None:
        """Refuse offsets that do not begin with 0, descend, or do not end with ``count``."""
        if not len(offsets) or offsets[0] != 0 or offsets[-1] != count or np.any(np.diff(offsets) < 0):
            self.refuse(f"'{name}' does not count from 0 to {count} in ascending order")

    def _check_shape(self, name: str, spec: ArraySpec, sizes: dict[str, int]) -> None:
        shape = self.arrays[name].shape
        fits = len(shape) == len(spec.shape)
        for size, wanted in zip(shape, spec.shape, strict=False):
            if isinstance(wanted, int):
                fits &= size == wanted
            elif "|" in wanted:
                fits &= str(size) in wanted.split("|")
            else:
                base, _, more = wanted.partition("+")
                fits &= sizes.setdefault(base, size - int(more or 0)) + int(more or 0) == size
        if not fits:
            expected = ", ".join(
                str(sizes.get(size, size)) if isinstance(size, str) and "+" not in size else str(size)
                for size in spec.shape
            )
            self.refuse(f"{name} has shape {shape}, expected ({expected})")

    def _check_values(self, name: str, spec: ArraySpec, sizes: dict[str, int]) -> NDArray[Any]:
        array = self.arrays[name]
        if spec.below:
            base, _, more = spec.below.partition("+")
            limit = sizes.get(base, 0) + int(more or 0)  # 0 if the array that it indexes is missing
            if array.dtype.kind not in "iu":
                self.refuse(f"{name} holds {array.dtype}, expected whole numbers")
            if array.size and not (0 <= int(array.min()) and int(array.max()) < limit):
                self.refuse(f"{name} counts past 0 to {limit - 1}")
            checked: NDArray[Any] = np.ascontiguousarray(array, dtype=np.int64)
        else:
            if array.dtype.kind not in "fiu":
                self.refuse(f"{name} holds {array.dtype}, expected numbers")
            checked = np.ascontiguousarray(as_float64(array))
            if not spec.nan and array.size and not max(-float(checked.min()), float(checked.max())) <= _LARGEST:
                self.refuse(f"{name} holds NaN, infinite or absurdly large numbers")
            if spec.share and array.size and not (checked.min() >= 0.0 and checked.max() <= 1.0):
                self.refuse(f"{name} holds numbers outside 0 to 1")
        checked.flags.writeable = False
        return checked


def lie_in_triangles(barycentric: NDArray[Any]) -> bool:
    """Whether barycentric coordinates (n, 3) are of points inside triangles, up to rounding."""
    sums = barycentric.sum(axis=1)
    return bool(np.all(barycentric >= -_BARYCENTRIC_ROUNDING) and np.all(np.abs(sums - 1) <= _BARYCENTRIC_ROUNDING))
