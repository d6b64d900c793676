"""The map of the last finish: the next one need not compute it again where nothing that decides it has changed."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from cagemap.files.result.folder import ARRAYS
from cagemap.files.result.manifest import MANIFEST
from cagemap.files.usd.read import USD_SUFFIXES
from cagemap.studio.finish import MAP, Command
from cagemap.studio.state import Output, Studio

# Fields that name files which are not followed; nor are layers that a USD file names.
_MASKS = ("target_mask", "source_mask")
Stamp = tuple[int, int] | None


class LastMap:
    """Remembers what decided the RESULT that a finish wrote, and what its files were then."""

    def __init__(self) -> None:
        self._begun: object = None
        self._made: object = None

    def left_of(self, todo: tuple[Command, ...], state: Studio) -> tuple[Command, ...]:
        """What is left to do of a finish, whose first command is the match."""
        match = todo[0]
        self._begun = _decided_by(match, state)
        if self._begun is not None and self._made == (self._begun, _stamps_of(match.output)):
            return todo[1:]
        self._made = None  # about to be replaced
        return todo

    def written(self, output: Output) -> None:
        """Take note of an output."""
        if output.what == MAP:
            self._made = self._begun, _stamps_of(output.path)


def _decided_by(match: Command, state: Studio) -> object:
    """Command, landmarks and both models' files as they are; None where that is not all."""
    files = state.files
    if files is None or any(getattr(match.request, name, None) for name in _MASKS):
        return None
    models = files.target, files.source
    if any(model.suffix.lower() in (*USD_SUFFIXES, ".gltf") for model in models):
        return None
    return match, state.wish, _stamps(models)


def _stamps_of(result: Path) -> object:
    """Of the map itself: what is made of it is noted in the manifest beside it, which has to be there."""
    return _stamps((result / ARRAYS,)), (result / MANIFEST).is_file()


def _stamps(files: Iterable[Path]) -> tuple[Stamp, ...]:
    """When files were written, and how long they are; None for one that is not there."""
    found: list[Stamp] = []
    for file in files:
        try:
            status = file.stat()
            found.append((status.st_mtime_ns, status.st_size))
        except OSError:
            found.append(None)
    return tuple(found)
