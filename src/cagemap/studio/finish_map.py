"""The map of a finish: whether it can be used again, and how it differs from the map on the page."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cagemap.deform.config import SearchConfig
from cagemap.errors import CagemapError
from cagemap.files.meshes.formats import is_in_several_files
from cagemap.files.result.folder import ARRAYS, read_result
from cagemap.files.result.manifest import MANIFEST
from cagemap.studio.finish import MAP_TITLE, Command
from cagemap.studio.recorded_match import MASK_FIELDS
from cagemap.studio.scene import Scene
from cagemap.studio.state import Output, StudioState


class WrittenMap:
    """Remembers the inputs and files of the last finish's map."""

    def __init__(self) -> None:
        self._inputs: object = None
        self._written: object = None

    def remaining_commands(self, commands: tuple[Command, ...], state: StudioState) -> tuple[Command, ...]:
        """The commands without the first one, the match, if its RESULT is up to date."""
        match = commands[0]
        self._inputs = _match_inputs(match, state)
        if self._inputs is not None and self._written == (self._inputs, _result_stamps(match.output)):
            return commands[1:]
        self._written = None
        return commands

    def record(self, output: Output) -> None:
        """Remember a written map; other outputs are ignored."""
        if output.title == MAP_TITLE:
            self._written = self._inputs, _result_stamps(output.path)


def _match_inputs(match: Command, state: StudioState) -> object:
    """Everything that the map depends on; None if not all of it is tracked."""
    files = state.files
    if files is None or any(getattr(match.request, name, None) for name in MASK_FIELDS):  # not tracked
        return None
    models = files.target, files.source
    if any(map(is_in_several_files, models)):  # the stamps do not include the further files
        return None
    return match, state.map_inputs, tuple(map(_file_stamp, models))


def _result_stamps(result: Path) -> object:
    """Stamp of the map, and whether a manifest exists; later commands change the manifest itself."""
    return _file_stamp(result / ARRAYS), (result / MANIFEST).is_file()


def _file_stamp(file: Path) -> tuple[int, int] | None:
    """Time of change in nanoseconds and size; None for a missing file."""
    try:
        status = file.stat()
    except OSError:
        return None
    return status.st_mtime_ns, status.st_size


def map_difference_notes(scene: Scene | None, outputs: tuple[Output, ...]) -> tuple[str, ...]:
    """Warn if a finish has another map than the page."""
    result = next((output.path for output in outputs if output.title == MAP_TITLE), None)
    if scene is None or scene.preview_map is None or result is None:
        return ()
    try:
        match = read_result(result)
    except CagemapError:  # reported where the result is used
        return ()
    n = scene.target.control.n_vertices
    preview_images = scene.preview_map.pull_back(scene.source.triangles, scene.source.positions)[:n]
    images = match.point_map.images.positions  # at unit area
    if len(images) < n:
        return ()
    difference = np.linalg.norm(images[:n] - match.source.scale * preview_images, axis=1).mean()
    if difference < SearchConfig.min_answer_distance:  # as for two answers of one search
        return ()
    return (
        f"the baked map differs from the map on the page by {100 * difference:.0f} % of the source's size on average. "
        "Match again shows what a match from the start finds; or set a landmark where they differ, then Bake again",
    )
