"""Tasks of the preview and their results, which go from process to process."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from cagemap.studio.landmarks import LandmarkList, SideNames
from cagemap.studio.models import OpenedModel
from cagemap.studio.scene import Scene
from cagemap.studio.skins import PreviewMap
from cagemap.studio.state import MapState
from cagemap.tasks.match import ComputedMatch


@dataclass(frozen=True)
class PairFiles:
    """Files of the open pair, and how the preview opens them."""

    target: Path
    source: Path
    texture: Path | None
    vertices: int  # approximate number of vertices of each previewed surface
    folder: Path  # receives FBX models as GLB, and an image that is inside the source's file
    # `schemes`, `ups`, `parts`: see `cagemap.studio.state.Files`
    schemes: SideNames = (None, None)
    ups: SideNames = (None, None)
    parts: SideNames = (None, None)


@dataclass(frozen=True)
class OpenModels:
    """Open both models."""

    pair_files: PairFiles


@dataclass(frozen=True)
class FindMap:
    """Compute the map."""

    pair_files: PairFiles
    landmarks: LandmarkList
    # Match from the start in place of an update of the last map. A chosen answer is kept where there are fewer than
    # three landmarks.
    fresh: bool = False
    answer: int | None = None  # choose one of the alignments that are found without landmarks
    # the one chosen before, for a process without a map; or the name of that of an opened RESULT
    chosen_answer: int | str = 0


@dataclass(frozen=True)
class ShowBaked:
    """Draw a baked image on the target, in a UV set of its own (None: the first) or a file's layout."""

    pair_files: PairFiles
    image: Path
    layout: Path | None
    uv_set: str | None
    preview_map: PreviewMap | None


@dataclass(frozen=True)
class ShowImage:
    """Draw both models with another image of the source, that of ``pair_files``."""

    pair_files: PairFiles
    preview_map: PreviewMap | None


@dataclass(frozen=True)
class ShowPosed:
    """Draw both models in a pose of the source's animations; '': unposed."""

    pair_files: PairFiles
    pose: str
    preview_map: PreviewMap | None


Task = OpenModels | FindMap | ShowBaked | ShowImage | ShowPosed


@dataclass(frozen=True, eq=False)
class OpenedPair:
    """Result of `OpenModels`."""

    target: OpenedModel
    source: OpenedModel
    skins: tuple[bytes, bytes]

    @property
    def scene(self) -> Scene:
        """A scene without a map."""
        target, source = self.target, self.source
        return Scene(
            target.shape,
            source.shape,
            (target.mirror, source.mirror),
            self.skins,
            part_choices=(target.part_choices, source.part_choices),
            dense=(target.dense, source.dense),
            has_colors=source.look.colors is not None,
        )


@dataclass(frozen=True)
class MapUpdate:
    """Result of `FindMap`."""

    preview_map: PreviewMap
    skins: tuple[bytes, bytes | None]  # target and source as drawn with the map; None: the source as before
    map_state: MapState  # without the revision
    computed: ComputedMatch | None = None  # the map as a match from the start; None after an update


@dataclass(frozen=True)
class ImageUpdate:
    """Result of `ShowImage`: target and source as drawn, the image's file and what was logged about it."""

    skins: tuple[bytes, bytes]
    texture: Path | None
    notes: tuple[str, ...]


TaskResult = OpenedPair | MapUpdate | ImageUpdate | bytes | tuple[bytes, bytes]
