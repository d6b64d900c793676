"""Atomic writing of files and folders: readers never see half a file, and foreign files are never replaced.

Every file goes through `atomic_path` or `atomic_folder`, which replace only files that carry cagemap's mark
(`cagemap.files.ownership`).
"""

from __future__ import annotations

import errno
import os
import re
import shutil
import stat
import tempfile
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from contextvars import ContextVar
from functools import partial
from pathlib import Path

from cagemap.errors import FormatError
from cagemap.files.ownership import is_own, seal

# Errors of a full disk. Errors in the caller's block that are reported for this output.
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_STORAGE = (*_FULL, errno.EROFS, errno.EACCES, errno.EPERM, errno.EIO, errno.ENAMETOOLONG)
# Seconds after which a temporary file must be locked: it is locked just after it is created.
_SETTLED = 10.0
# Files of one `all_or_nothing` that are locked until its end: a lock is an open file, of which some systems allow 256.
_MAX_LOCKED = 64
# The process's umask, read once: reading sets it for a moment, also for other threads.
_UMASK = os.umask(0o077)
os.umask(_UMASK)
_Check = Callable[[], None]
_Move = Callable[[ExitStack], None]  # adds how the move is undone

Owned = Callable[[Path], bool]
_written: ContextVar[list[Path] | None] = ContextVar("written", default=None)
# Steps that check and move the files of `all_or_nothing` at its end, and the stack that removes temporary files.
_together: ContextVar[tuple[list[tuple[_Check, _Move]], ExitStack] | None] = ContextVar("together", default=None)


@contextmanager
def files_written() -> Iterator[list[Path]]:
    """Collect the paths of files that the block writes, threads of `ThreadPool` included."""
    files: list[Path] = []
    token = _written.set(files)
    try:
        yield files
    finally:
        _written.reset(token)


def _tell(*files: Path) -> None:
    listener = _written.get()
    if listener is not None:
        listener.extend(files)


@contextmanager
def all_or_nothing() -> Iterator[None]:
    """Move the files that `atomic_path` writes into place at the block's end; none after an error.

    Inside another such block, at the end of the outer one. If a move fails, earlier moves are undone; on disks without
    hard links, replaced files cannot be restored.
    """
    if _together.get() is not None:
        yield
        return
    moves: list[tuple[_Check, _Move]] = []
    with ExitStack() as removed:
        token = _together.set((moves, removed))
        try:
            yield
        finally:
            _together.reset(token)
        for check, _ in moves:
            check()
        with ExitStack() as undone:
            for _, move in moves:
                move(undone)
            undone.pop_all()


@contextmanager
def one_at_a_time(folder: Path) -> Iterator[None]:
    """Lock a folder against other processes and threads, where system and disk support locks."""
    try:
        import fcntl

        handle = os.open(folder, os.O_RDONLY)
    except (ImportError, OSError):  # Windows; a folder that cannot be read
        yield
        return
    try:
        with suppress(OSError):  # a network disk without locks
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


def _has_content(path: Path) -> bool:
    return path.stat().st_size > 0


@contextmanager
def atomic_path(
    final: str | Path, *, force: bool = False, owned: Owned = is_own, verify: Callable[[Path], bool] = _has_content
) -> Iterator[Path]:
    """Yield a temporary path in the folder of ``final``; flush and move it there after a block without errors.

    The suffix is kept, since image libraries choose their format by it. After an error, or an interrupt, the
    temporary file is removed and an older ``final`` is untouched. Where ``final`` is a symbolic link, the file that it
    points to is written and the link stays.
    FormatError: see `require_replaceable`; also if the disk is full, or ``verify`` returns False.

    ``owned``: whether an existing file may be replaced without ``force``.
    ``verify``: whether the temporary file is complete. For libraries that do not report a full disk.
    """
    check = partial(require_replaceable, final, force=force, owned=owned)
    check()
    target = _resolve_links(final)
    together = _together.get()
    with ExitStack() as removed:
        temporary = _reserve(target)
        removed.callback(temporary.unlink, missing_ok=True)
        with _hold_lock(temporary):
            with _name_output_in_disk_errors(target, _FULL):
                yield temporary
            if together is None or len(together[0]) < _MAX_LOCKED:
                removed.enter_context(_hold_lock(temporary))  # libraries may have put another file in its place
        with _name_output_in_disk_errors(target):
            if not verify(temporary):
                raise FormatError(
                    f"{target}: could not be written whole; what was there before is kept. Check the room on the disk."
                )
            seal(temporary)
            _flush(temporary)

        def move(undone: ExitStack) -> None:
            check()  # another program may have created the file meanwhile
            with _name_output_in_disk_errors(target):
                if together is not None:
                    _keep_earlier(target, undone, together[1])
                if target.exists():
                    shutil.copymode(target, temporary)
                os.replace(temporary, target)
            _tell(Path(final))

        if together is None:
            move(ExitStack())
        else:
            together[0].append((check, move))
            together[1].push(removed.pop_all())


def _keep_earlier(target: Path, undone: ExitStack, removed: ExitStack) -> None:
    """Keep an earlier file under another name until ``removed`` is closed; ``undone`` puts it back."""
    if not target.exists():
        undone.callback(target.unlink, missing_ok=True)
        return
    kept = target.with_name(f".{target.stem}.{os.urandom(4).hex()}.part{target.suffix}")
    with suppress(OSError):  # a disk without hard links
        os.link(target, kept)
        removed.callback(kept.unlink, missing_ok=True)
        undone.callback(_put_back, kept, target)


def _put_back(kept: Path, target: Path) -> None:
    with suppress(FileNotFoundError):  # another process may have removed it as a leftover
        os.replace(kept, target)


def write_whole(path: str | Path, content: str | bytes, *, force: bool = False, owned: Owned = is_own) -> None:
    """Write a text (UTF-8) or bytes as a file by `atomic_path`: completely, or not at all."""
    data = content.encode() if isinstance(content, str) else content
    with atomic_path(path, force=force, owned=owned, verify=lambda file: file.stat().st_size == len(data)) as temporary:
        temporary.write_bytes(data)


@contextmanager
def atomic_folder(
    final: str | Path, names: Sequence[str], *, force: bool = False, owned: Owned = is_own
) -> Iterator[Path]:
    """Yield a temporary folder; move its files to ``final`` after a block without errors.

    A new folder appears complete. In an existing folder files are replaced one by one, in the order of ``names``, and
    other files are left alone. `all_or_nothing` does not defer them: no command writes a folder inside such a block.

    ``names``: the files that the block writes; the last one marks the folder as complete.
    ``force``, ``owned``: see `atomic_path`.
    """
    require_own_folder(final, names, force=force, owned=owned)
    target = _resolve_links(final)
    _remove_abandoned(target)
    with _name_output_in_disk_errors(target):
        temporary = Path(tempfile.mkdtemp(prefix=f".{target.name}.", suffix=".part", dir=target.parent))
    with ExitStack() as removed:
        removed.callback(shutil.rmtree, temporary, ignore_errors=True)
        removed.enter_context(_hold_lock(temporary))
        temporary.chmod(0o777 & ~_UMASK)
        with _name_output_in_disk_errors(target, _FULL):
            yield temporary
        with _name_output_in_disk_errors(target):
            for name in names:
                seal(temporary / name)
                _flush(temporary / name)
            require_own_folder(final, names, force=force, owned=owned)
            try:
                if not target.is_dir():
                    os.replace(temporary, target)
            except OSError:  # another process may have created the folder just now
                require_own_folder(final, names, force=force, owned=owned)
                if not target.is_dir():
                    raise
            if temporary.is_dir():
                with one_at_a_time(target):
                    for name in names:
                        os.replace(temporary / name, _resolve_links(target / name))
        _tell(*(Path(final) / name for name in names))


def require_replaceable(path: str | Path, *, force: bool = False, owned: Owned = is_own) -> None:
    """Refuse a file name that cannot be written, or whose file must not be replaced.

    Refused are: a missing folder or one without write permission; a folder, a device or a read-only file; a file that
    cagemap did not write, unless ``force`` is given.
    """
    file = Path(path)
    target = _resolve_links(file)
    require_writable_folder(file)
    if not os.path.lexists(target):
        return
    if target.is_dir():
        raise FormatError(f"{file}: expected the name of a file to write, got a folder. Give a file name inside it.")
    status = target.stat()
    if not stat.S_ISREG(status.st_mode):
        raise FormatError(f"{file}: expected the name of a file to write, got a device or a pipe. Give a file name.")
    if not status.st_mode & stat.S_IWUSR:
        raise FormatError(f"{file}: is read-only and not overwritten. Give another name, or make it writable.")
    if not force and status.st_size and not owned(target):
        raise FormatError(
            f"{file}: exists, and was not written by cagemap or was changed since, so it is not overwritten. Give "
            "another name, or allow it (`force=True`)."
        )


def require_own_folder(path: str | Path, names: Iterable[str], *, force: bool = False, owned: Owned = is_own) -> None:
    """Refuse a folder that is not the output of an earlier run, or cannot be written to.

    Refused are: a file; a folder that holds files but none of ``names``; one of ``names`` that cagemap did not write.
    """
    folder = Path(path)
    target = _resolve_links(folder)
    if not os.path.lexists(target):
        require_writable_folder(folder)
        return
    if not target.is_dir():
        raise FormatError(f"{folder}: expected a folder to write the result to, got a file. Give another name.")
    known = list(names)
    require_writable_folder(folder / known[0])
    present = [name for name in known if os.path.lexists(target / name)]
    for name in present:
        require_replaceable(folder / name, force=force, owned=owned)
    if not force and not present and any(target.iterdir()):
        raise FormatError(
            f"{folder}: the folder holds files but no {' and '.join(known)}, so it is not a result of an earlier run "
            "and nothing is written to it. Give another name, or allow it (`force=True`)."
        )


def require_writable_folder(path: str | Path) -> None:
    """Refuse a path whose parent folder is missing or cannot be written to, or whose name is too long."""
    target = _resolve_links(path)
    folder = target.parent
    if not os.path.isdir(folder):
        raise FormatError(f"{path}: the folder {folder} does not exist. Create it, or give another output.")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise FormatError(f"{path}: cannot write to the folder {folder}. Give one that you may write to.")
    try:
        os.lstat(folder / f".{target.name}.12345678.part")  # as long as temporary names
    except OSError as error:
        if error.errno == errno.ENAMETOOLONG:
            raise FormatError(f"{path}: the name is too long. Give a shorter one.") from None


def check_outputs(outputs: Iterable[Path], inputs: Iterable[Path], *, force: bool = False) -> None:
    """Refuse outputs before any work is done: inputs, repeated names, files that must not be replaced."""
    files = list(outputs)
    require_no_input(files, inputs)
    places = [_resolve_links(file) for file in files]
    twice = [file for i, file in enumerate(files) if places[i] in places[:i]]
    if twice:
        raise FormatError(f"{twice[0]}: two outputs have this name, and one would be lost. Give each its own.")
    for file in files:
        require_replaceable(file, force=force)


def require_no_input(outputs: Iterable[Path], inputs: Iterable[Path]) -> None:
    """Refuse an output that is also an input, by whatever path."""
    input_files = list(inputs)
    for output in outputs:
        for file in input_files:
            exist = os.path.exists(output) and os.path.exists(file)
            if os.path.samefile(output, file) if exist else _resolve_links(output) == _resolve_links(file):
                raise FormatError(f"{output}: is an input too ({file}), and would be lost. Give another name.")


def _resolve_links(path: str | Path) -> Path:
    """The path with symbolic links resolved."""
    return Path(os.path.realpath(path))


def _reserve(target: Path) -> Path:
    """Create an empty temporary file beside ``target``, with the permissions of a plain open."""
    _remove_abandoned(target)
    with _name_output_in_disk_errors(target):
        handle, name = tempfile.mkstemp(prefix=f".{target.stem}.", suffix=f".part{target.suffix}", dir=target.parent)
    os.close(handle)
    temporary = Path(name)
    temporary.chmod(0o666 & ~_UMASK)
    return temporary


@contextmanager
def _hold_lock(path: Path) -> Iterator[None]:
    """Hold a shared lock on a temporary file or folder, so that `_remove_abandoned` leaves it."""
    with ExitStack() as closed:
        with suppress(ImportError, OSError):  # Windows; a disk without locks
            import fcntl

            handle = os.open(path, os.O_RDONLY)
            closed.callback(os.close, handle)
            fcntl.flock(handle, fcntl.LOCK_SH)
        yield


def _remove_abandoned(target: Path) -> None:
    """Remove `leftovers` that no process has locked; nothing without locks."""
    with suppress(ImportError, OSError):
        import fcntl

        for left in leftovers(target):
            with suppress(OSError), ExitStack() as closed:  # in use, removed meanwhile, or of another user
                handle = os.open(left, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
                closed.callback(os.close, handle)
                status = os.fstat(handle)
                if time.time() - status.st_mtime < _SETTLED:
                    continue
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if stat.S_ISDIR(status.st_mode):
                    shutil.rmtree(left)
                elif stat.S_ISREG(status.st_mode):
                    left.unlink()


def leftovers(final: str | Path) -> list[Path]:
    """Temporary files and folders of ``final`` that a killed process left, recognised by their names."""
    target = _resolve_links(final)
    patterns = [
        rf"\.{re.escape(target.stem)}\.\w{{8}}\.part{re.escape(target.suffix)}",
        rf"\.{re.escape(target.name)}\.\w{{8}}\.part",
    ]
    siblings = target.parent.iterdir() if target.parent.is_dir() else ()
    return [path for path in siblings if any(re.fullmatch(name, path.name) for name in patterns)]


def _flush(path: Path) -> None:
    """Flush a file's content to disk before it is renamed, so that a power cut leaves the old or the new file."""
    with path.open("rb+") as stream:
        os.fsync(stream.fileno())


@contextmanager
def _name_output_in_disk_errors(target: Path, kinds: Collection[int] = _STORAGE) -> Iterator[None]:
    """Turn an error of the disk, of these kinds, into a FormatError that names the output."""
    try:
        yield
    except OSError as error:
        if error.errno not in kinds:
            raise
        reason = error.strerror or type(error).__name__
        raise FormatError(
            f"{target}: cannot write there ({reason}). Give an output folder with room that you may write to."
        ) from error
