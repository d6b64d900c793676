"""What the studio knows, as one frozen value that every page shows."""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

from cagemap.errors import ParameterError
from cagemap.files.images.image import UDIM_MARK
from cagemap.studio.landmarks import History, LandmarkList, Proposal
from cagemap.studio.workspace import IMAGES

Mode = Literal["texture", "colours", "checker", "plain", "baked"]
MODES: tuple[Mode, ...] = ("texture", "colours", "checker", "plain", "baked")
# Ends the name of one of several tiles.
_TILE = re.compile(r"\.1\d{3}$")
# Ends the name of a mesh that a layout was made for.
_UNWRAPPED = "_unwrapped"
# Messages that stay in the page; older ones go.
MOST_MESSAGES = 5


@dataclass(frozen=True)
class Files:
    """What is open.

    Attributes
    ----------
    target, source : Path
        Control meshes.
    texture : Path or None
        Image over the source's UVs.
    landmarks : Path
        Where landmarks are saved.
    result : Path
        RESULT folder of the finish.
    schemes : (str or None, str or None)
        How target and source are subdivided, "none" for a mesh as it is; None: as the file says.
    ups : (str or None, str or None)
        Axis of target and source that points up in the view, "y" or "z"; None: as a USD file says, else y.
    parts : (str or None, str or None)
        Part of either file that is meant, as `cagemap match --part` takes it; None: the whole file. A file of several
        pieces is opened with its largest one where none is named, and that one is named here from then on.
    welds : (str or None, str or None)
        Tolerance that either file was welded with when it was opened, as `cagemap match --weld` takes it.
    """

    target: Path
    source: Path
    texture: Path | None
    landmarks: Path
    result: Path
    schemes: tuple[str | None, str | None] = (None, None)
    ups: tuple[str | None, str | None] = (None, None)
    parts: tuple[str | None, str | None] = (None, None)
    welds: tuple[str | None, str | None] = (None, None)


@dataclass(frozen=True)
class View:
    """How the models are shown.

    Attributes
    ----------
    mode : str
        "texture": the source's image, on the target through the map; "colours" and "checker": a pattern of the source,
        there and through the map; "plain": each model as it is; "baked": an image that was baked, in the target's own
        layout.
    cages : bool
        Control meshes as lines.
    symmetric : bool
        A landmark beside the mirror plane of two symmetric models brings its counterpart.
    doubts : bool
        Doubtful places of the map in red.
    linked : bool
        Turning one model turns the other.
    rest : bool
        Parts of the files that are not open, in grey.
    baked : Path or None
        The image that "baked" shows.
    layout : Path or None
        The mesh that has the layout, where the target has none itself.
    pose : str
        Pose of the source's animations that both models are in; '': as their files have them.
    """

    mode: Mode = "texture"
    cages: bool = False
    symmetric: bool = True
    doubts: bool = True
    linked: bool = True
    rest: bool = True
    baked: Path | None = None
    layout: Path | None = None
    pose: str = ""


@dataclass(frozen=True)
class MapState:
    """The map as far as it is known.

    Attributes
    ----------
    revision : int
        Counts maps that were found to the end; 0 while there is none.
    answers : tuple of str
        The landmark-free answers, best first; empty while there was no match without landmarks.
    chosen : int
        Which answer the map started from.
    confidence : str
        What the search says about the first answer.
    strain : dict of str to float
        Per landmark name: how far the map would move it if let go, of the model's size.
    contradictions : dict of str to str
        Landmark pairs that contradict the others, and why.
    notes : tuple of str
        Warnings of the map.
    seconds : float
        What the last map took.
    suggestion : int or None
        Control vertex of the target at which one more landmark would tell most.
    rough : bool
        Whether it is a first look, while the search goes on.
    poses : tuple of str
        Of the source's animations.
    """

    revision: int = 0
    answers: tuple[str, ...] = ()
    chosen: int = 0
    confidence: str = ""
    strain: dict[str, float] = field(default_factory=dict)
    contradictions: dict[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    seconds: float = 0.0
    suggestion: int | None = None
    rough: bool = False
    poses: tuple[str, ...] = ()

    def under_names(self, before: LandmarkList, now: LandmarkList) -> MapState:
        """What is known of landmarks, under the names that they have now."""
        names = {
            item.name: same.name
            for item in before.items
            if (same := now.get(item.number)) is not None and replace(item, name=same.name) == same
        }
        strain = {names.get(name, name): value for name, value in self.strain.items()}
        contradictions = {names.get(name, name): why for name, why in self.contradictions.items()}
        return replace(self, strain=strain, contradictions=contradictions)


@dataclass(frozen=True)
class RunningJob:
    """Something that runs.

    Attributes
    ----------
    title : str
        What it is, for people.
    stage : str
        What it does now.
    fraction : float or None
        Done, from 0 to 1, where known.
    """

    title: str
    stage: str = ""
    fraction: float | None = None


@dataclass(frozen=True)
class Probe:
    """A place that was asked about, and where the map takes it.

    Attributes
    ----------
    target, source : (x, y, z) or None
        In file units.
    text : str
        The parts that they belong to.
    """

    target: tuple[float, float, float] | None
    source: tuple[float, float, float] | None
    text: str = ""


@dataclass(frozen=True)
class Message:
    """A line for the user.

    Attributes
    ----------
    kind : str
        "error" or "note".
    text : str
    """

    kind: Literal["error", "note"]
    text: str


@dataclass(frozen=True)
class Output:
    """A file that the finish wrote, or its RESULT folder."""

    path: Path
    what: str


@dataclass(frozen=True)
class Studio:
    """All of it.

    Attributes
    ----------
    files : Files or None
        None until two models are chosen.
    history : History
    selected : int or None
        Number of the selected landmark.
    proposal : Proposal or None
        What the map proposes for the landmark that waits for its other place.
    view : View
    map : MapState
    preview_job, finish_job : RunningJob or None
        What runs.
    probe : Probe or None
    messages : tuple of Message
    outputs : tuple of Output
    saved : bool
        Whether the landmark file holds the landmarks as they are.
    """

    files: Files | None = None
    history: History = field(default_factory=History)
    selected: int | None = None
    proposal: Proposal | None = None
    view: View = View()
    map: MapState = MapState()
    preview_job: RunningJob | None = None
    finish_job: RunningJob | None = None
    probe: Probe | None = None
    messages: tuple[Message, ...] = ()
    outputs: tuple[Output, ...] = ()
    saved: bool = True

    @property
    def wish(self) -> tuple[object, ...]:
        """What decides the map of a finish: models, and landmarks or the answer that is chosen without any."""
        files, present = self.files, self.history.present
        models = None if files is None else (files.target, files.source, files.schemes, files.parts)
        return models, present.complete, present.curves, 0 if present.decides else self.map.chosen

    @property
    def images(self) -> tuple[Path, ...]:
        """Images among the outputs that cover the target's layout, tiles as one: none of the wrapped cage's."""
        made = (output.path for output in self.outputs if output.what != "wrap")
        images = (path for path in made if path.suffix.lower() in IMAGES)
        return tuple(dict.fromkeys(path.with_stem(_TILE.sub(f".{UDIM_MARK}", path.stem)) for path in images))


# Fields of what is known of two models that are opened, before anything is.
AFRESH: dict[str, object] = {
    name: getattr(Studio(), name) for name in ("history", "selected", "proposal", "map", "probe", "outputs", "saved")
}


def map_view(view: View) -> View:
    """The view without any baked image or pose."""
    return replace(view, mode="texture" if view.mode == "baked" else view.mode, baked=None, layout=None, pose="")


def baked_view(state: Studio, image: Path | None) -> View:
    """The view that shows an image that was baked; None: the map, as a texture where a baked image was shown."""
    if image is None:
        return map_view(state.view)
    return replace(state.view, mode="baked", baked=image, layout=layout_of(state, image), pose="")


def layout_of(state: Studio, image: Path) -> Path | None:
    """The mesh with the layout that an image was baked into, where one was made for it."""
    meshes = (output.path for output in state.outputs if output.path.stem.endswith(_UNWRAPPED))
    return next((path for path in meshes if image.stem.startswith(path.stem.removesuffix(_UNWRAPPED))), None)


def changed_view(state: Studio, **fields: object) -> View:
    """The view with other fields; a baked image, where none was chosen, is the first of the last bake.

    Raises
    ------
    ParameterError
        If there is no baked image.
    """
    view = replace(map_view(state.view) if fields.get("pose") else state.view, **fields)  # type: ignore[arg-type]
    if view.mode != "baked" or view.baked is not None:
        return view
    if not state.images:
        raise ParameterError("Show: expected a baked image, there is none yet. Press Bake.")
    return baked_view(replace(state, view=view), state.images[0])


def with_message(messages: tuple[Message, ...], kind: Literal["error", "note"], text: str) -> tuple[Message, ...]:
    """Return the messages with one more; one that is there already moves to the end."""
    new = Message(kind, text.encode("utf-8", "backslashreplace").decode())  # names of files may be no text
    return (*(old for old in messages if old != new), new)[-MOST_MESSAGES:]
