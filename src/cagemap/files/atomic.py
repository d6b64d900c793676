"""Writing so that a reader never sees half a file: write beside, flush to disk, move into place."""

from __future__ import annotations

import errno
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from cagemap.errors import FormatError

# A full disk and the like; any other error of a block is its own, perhaps about another file.
_STORAGE = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EACCES, errno.EPERM, errno.EIO)


@contextmanager
def atomic_path(final: str | Path) -> Iterator[Path]:
    """Give a temporary name in the folder of ``final``; move it there when the block ends without an error.

    The suffix is kept, since image libraries choose their format by it. After an error, or an interrupt, the
    temporary file is removed and an older ``final`` is untouched.

    Raises
    ------
    FormatError
        If the folder does not exist, cannot be written to, or ``final`` is a folder.
    """
    target = Path(final)
    _require_parent(target)
    if os.path.isdir(target):
        raise FormatError(f"{target}: expected the name of a file to write, got a folder. Give a file name inside it.")
    temporary = _reserve(target)
    try:
        yield temporary
        _flush(temporary)
        os.replace(temporary, target)
    except OSError as error:
        if error.errno in _STORAGE:
            raise _unwritable(target, error) from error
        raise
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def atomic_folder(final: str | Path, marker: str) -> Iterator[Path]:
    """Give a temporary folder beside ``final``; move it there when the block ends without an error.

    An existing ``final`` is replaced only if it is empty or holds the file ``marker``, which says that an earlier run
    wrote it; anything else might be somebody's work.

    Parameters
    ----------
    final : path
        The folder to write.
    marker : str
        Name of the file that every result folder holds, such as ``manifest.json``.

    Raises
    ------
    FormatError
        If ``final`` is a file or a folder that holds something else, or the folder above cannot be written to.
    """
    target = Path(final)
    _require_parent(target)
    _require_replaceable(target, marker)
    try:
        temporary = Path(tempfile.mkdtemp(prefix=f".{target.name}.", suffix=".part", dir=target.parent))
    except OSError as error:
        raise _unwritable(target, error) from error
    try:
        temporary.chmod(0o777 & ~_umask())
        yield temporary
        for path in temporary.rglob("*"):
            if path.is_file():
                _flush(path)
        _require_replaceable(target, marker)
        _swap(temporary, target)
    except OSError as error:
        if error.errno in _STORAGE:
            raise _unwritable(target, error) from error
        raise
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _swap(temporary: Path, target: Path) -> None:
    """Move a finished folder into place; the old one steps aside first and comes back if the move fails."""
    if not target.exists():
        os.replace(temporary, target)
        return
    aside = Path(tempfile.mkdtemp(prefix=f".{target.name}.", suffix=".old", dir=target.parent))
    old = aside / target.name
    os.replace(target, old)
    try:
        os.replace(temporary, target)
    except OSError:
        os.replace(old, target)
        raise
    finally:
        shutil.rmtree(aside, ignore_errors=True)


def _require_parent(target: Path) -> None:
    if not os.path.isdir(target.parent):
        raise FormatError(f"{target}: the folder {target.parent} does not exist. Create it, or give another output.")


def _require_replaceable(target: Path, marker: str) -> None:
    if not os.path.lexists(target):
        return
    if not os.path.isdir(target):
        raise FormatError(f"{target}: expected a folder to write the result to, got a file. Give another name.")
    if any(target.iterdir()) and not (target / marker).is_file():
        raise FormatError(
            f"{target}: the folder holds files but no {marker}, so it is not a result of an earlier run and is not "
            "overwritten. Give another name, or remove the folder yourself."
        )


def _reserve(target: Path) -> Path:
    """Create an empty file of a name that nobody else has, with the permissions that a plain open would give."""
    try:
        handle, name = tempfile.mkstemp(prefix=f".{target.stem}.", suffix=f".part{target.suffix}", dir=target.parent)
    except OSError as error:
        raise _unwritable(target, error) from error
    os.close(handle)
    temporary = Path(name)
    temporary.chmod(0o666 & ~_umask())
    return temporary


def _umask() -> int:
    mask = os.umask(0o077)
    os.umask(mask)
    return mask


def _flush(path: Path) -> None:
    """Make sure that the content is on disk before its name is, so that a power cut leaves the old or the new file."""
    with path.open("rb+") as stream:
        os.fsync(stream.fileno())


def _unwritable(target: Path, error: OSError) -> FormatError:
    reason = error.strerror or type(error).__name__
    return FormatError(
        f"{target}: cannot write there ({reason}). Give an output folder with room that you may write to."
    )
