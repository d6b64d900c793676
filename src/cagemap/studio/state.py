"""The state of the studio: one frozen value that all pages show."""

from __future__ import annotations

import re
import time
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

from cagemap.errors import ParameterError
from cagemap.files import IMAGE_SUFFIXES
from cagemap.files.images.image import UDIM_MARK
from cagemap.files.usd.results import preview_inputs
from cagemap.studio.landmarks import History, LandmarkList, Proposal, SideNames
from cagemap.studio.recorded_match import RecordedMatch

Mode = Literal["texture", "colours", "checker", "plain", "baked"]
MODES: tuple[Mode, ...] = ("texture", "colours", "checker", "plain", "baked")
MessageKind = Literal["error", "note"]
NO_SCHEME = "none"  # of a model that is not subdivided
_TILE_NUMBER = re.compile(r"\.1\d{3}$")
# Ends the name of a copy of the target with a new UV layout.
_UNWRAPPED_ENDING = "_unwrapped.obj"
# Outputs that show colours: titles of commands, and kinds of images baked from a detailed mesh.
_COLOR_TITLES, _COLOR_BAKES = ("texture", "material colours"), ("colors", "texture")
# Older messages disappear from the page.
MAX_MESSAGES = 100


@dataclass(frozen=True)
class Files:
    """Files of the open pair, and how they are opened."""

    # `target`, `source`: control meshes
    target: Path
    source: Path
    texture: Path | None  # image over the source's UVs
    landmarks: Path  # file that landmarks are saved to
    result: Path  # RESULT folder of the finish
    # subdivision scheme of target and source, "none" for a plain mesh; None: as stated in the file
    schemes: SideNames = (None, None)
    # up axis of target and source, "y" or "z"; None: as stated in the file, else by the shape or format
    ups: SideNames = (None, None)
    # Part of each file, as `cagemap match --part` takes it; None: the whole file. Opening a file of several pieces
    # without a part sets this to its largest piece.
    parts: SideNames = (None, None)
    # tolerance that each file was welded with when it was opened, as `cagemap match --weld` takes it
    welds: SideNames = (None, None)
    recorded_match: RecordedMatch | None = None  # the match of an opened RESULT

    def without_answer(self) -> Files:
        """The files without the alignment of an opened RESULT, which is of these models as they were matched."""
        return replace(self, recorded_match=self.recorded_match and self.recorded_match.without_answer())


@dataclass(frozen=True)
class View:
    """How the models are shown."""

    # "texture": the source's image or colours, on the target through the map (see `shown.shown_mode`); "colours" and
    # "checker": patterns on the source, on the target through the map; "plain": both models without the map; "baked": a
    # baked image in the target's own layout
    mode: Mode = "texture"
    cages: bool = False  # show control meshes as lines
    symmetric: bool = True  # add the mirror image of a new landmark on symmetric models
    doubts: bool = True  # show doubtful places of the map in red
    linked: bool = True  # both models turn together
    other_parts: bool = True  # show parts that are not open, in grey
    baked: Path | None = None  # image of mode "baked"
    pose: str = ""  # name of the pose in which both models are shown, one of `MapState.poses`; '' for none


@dataclass(frozen=True)
class MapState:
    """What is known about the current map."""

    revision: int = 0  # number of finished maps; 0 before the first
    # names of the alignments found without landmarks, best first; empty if there was no such search
    answers: tuple[str, ...] = ()
    chosen_answer: int = 0  # the one that the map started from
    # name of the answer that an opened RESULT was computed from, until the preview has looked for it; else ''
    sought_answer: str = ""
    confidence: str = ""  # message of the search about the first answer
    # for each landmark name, how far the landmark would move without its constraint, in units of the model's size
    strain: dict[str, float] = field(default_factory=dict)
    # for each landmark name that contradicts the others, the reason
    contradictions: dict[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()  # warnings of the match
    suggestion: int | None = None  # control vertex of the target where the next landmark helps most
    # Whether the map shown is not checked yet: a rough one, or an update. The rest is of the one before.
    unchecked: bool = False
    # whether a match with these landmarks finds this map; False for a map that was only updated
    from_start: bool = False
    poor: str = ""  # worst finding of a map that should not be used as it is; '' for others
    poses: tuple[str, ...] = ()  # names of poses of the source's animations
    first_seconds: float = 0.0  # how long the first map took, from the models' being open; 0 before it

    @property
    def answer_name(self) -> str:
        """Name of the chosen answer; '' if there was no search."""
        return self.answers[self.chosen_answer] if self.chosen_answer < len(self.answers) else ""

    def as_unchecked(self) -> MapState:
        """Return the state for a map that is not checked, with what is known of the last checked one."""
        return replace(self, unchecked=True, from_start=False)

    def following(self, shown: MapState, seconds: float) -> MapState:
        """Return the state as the one after ``shown``; ``seconds``: since the computation began."""
        if self.unchecked:
            return shown.as_unchecked()
        return replace(self, revision=shown.revision + 1, first_seconds=shown.first_seconds or seconds)

    def without_findings(self) -> MapState:
        """Return the state without what was found about the last checked map; answers, suggestion and poses stay."""
        return replace(self, confidence="", strain={}, contradictions={}, notes=(), poor="")

    def rename_landmarks(self, before: LandmarkList, now: LandmarkList) -> MapState:
        """Return the state with the new names of landmarks that kept their number and places."""
        names = {
            item.name: renamed.name
            for item in before.items
            if (renamed := now.get(item.number)) is not None and replace(item, name=renamed.name) == renamed
        }
        strain = {names.get(name, name): value for name, value in self.strain.items()}
        contradictions = {names.get(name, name): reason for name, reason in self.contradictions.items()}
        return replace(self, strain=strain, contradictions=contradictions)


@dataclass(frozen=True)
class RunningJob:
    """A running computation, as the page shows it."""

    title: str
    stage: str = ""
    fraction: float | None = None  # share that is done, from 0 to 1; None if unknown
    begun: float = field(default_factory=time.monotonic, compare=False)  # when the computation began


@dataclass(frozen=True)
class Probe:
    """A point under the mouse and its image under the map."""

    # `target`, `source`: in file units
    target: tuple[float, float, float] | None
    source: tuple[float, float, float] | None
    text: str = ""  # names of the parts of both points


@dataclass(frozen=True)
class Message:
    """A message to the user."""

    kind: MessageKind
    text: str


@dataclass(frozen=True)
class Output:
    """A file or folder that a finish wrote, with the command's title."""

    path: Path
    title: str
    uv_set: str | None = None  # the target's UV set that its images are in; None: the first


@dataclass(frozen=True)
class StudioState:
    """Everything that the pages show."""

    files: Files | None = None  # None until two models are chosen
    # target and source as they were chosen; ``files`` has the files that FBX models are converted to
    models: tuple[Path, ...] = ()
    history: History = field(default_factory=History)
    selected: int | None = None  # number of the selected landmark
    proposal: Proposal | None = None  # place that the map proposes to complete the open landmark
    view: View = View()
    map: MapState = MapState()
    # `preview_job`, `finish_job`: running computations
    preview_job: RunningJob | None = None
    finish_job: RunningJob | None = None
    probe: Probe | None = None
    messages: tuple[Message, ...] = ()
    # the last error, if the user has done something else since: the status line no longer shows it
    answered_error: Message | None = None
    outputs: tuple[Output, ...] = ()
    saved: bool = True  # whether the landmark file holds the current landmarks

    @property
    def map_inputs(self) -> tuple[object, ...]:
        """Everything that the map of a finish depends on."""
        files, present = self.files, self.history.present
        models = None if files is None else (files.target, files.source, files.schemes, files.parts)
        answer = 0 if present.has_constraints else self.map.chosen_answer
        return models, present.complete_landmarks, present.curves, answer

    @property
    def error(self) -> Message | None:
        """The last message, if it is an error that the user has not answered by another action."""
        last = self.messages[-1] if self.messages else None
        return last if last is not None and last.kind == "error" and last is not self.answered_error else None

    @property
    def baked_images(self) -> tuple[Path, ...]:
        """Written images in the target's layout."""
        return baked_images(self.outputs)


_PAIR_FIELDS = ("history", "selected", "proposal", "map", "probe", "outputs", "saved")
# Values of the fields that depend on the open pair, for a newly opened one.
INITIAL_FIELDS: dict[str, object] = {name: getattr(StudioState(), name) for name in _PAIR_FIELDS}


def baked_images(outputs: Iterable[Output]) -> tuple[Path, ...]:
    """Images in the target's layout, tiles as one; without those of the wrapped cage."""
    paths = (output.path for output in outputs if output.title != "wrap")
    images = (path for path in paths if path.suffix.lower() in IMAGE_SUFFIXES)
    return tuple(dict.fromkeys(path.with_stem(_TILE_NUMBER.sub(f".{UDIM_MARK}", path.stem)) for path in images))


def color_images(outputs: Iterable[Output]) -> tuple[Path, ...]:
    """Baked images that show colours: textures, material colours and vertex colours, not normals or heights."""
    return tuple(image for output in outputs for image in baked_images((output,)) if _is_of_colors(output.title, image))


def first_image(outputs: Iterable[Output]) -> Path | None:
    """The first baked image of colours, else of another kind; None without any."""
    outputs = tuple(outputs)
    return next(iter(color_images(outputs) or baked_images(outputs)), None)


def _is_of_colors(title: str, image: Path) -> bool:
    """Whether an image of an output is one of colours; the names of a material's maps tell theirs."""
    kind = image.stem.removesuffix(f".{UDIM_MARK}").rpartition("_")[2]
    if title in _COLOR_TITLES:
        return preview_inputs([kind]).get(kind, "diffuseColor") == "diffuseColor"
    return title == "detail" and kind in _COLOR_BAKES


def map_view(view: View) -> View:
    """The view without a baked image or pose."""
    return replace(view, mode="texture" if view.mode == "baked" else view.mode, baked=None, pose="")


def baked_view(view: View, image: Path | None) -> View:
    """The view with a baked image; without an image the map as a texture."""
    return map_view(view) if image is None else replace(view, mode="baked", baked=image, pose="")


def layout_mesh(state: StudioState, image: Path) -> Path | None:
    """The mesh written with the UV layout of a baked image, if there is one."""
    meshes = (output.path for output in state.outputs if output.path.name.endswith(_UNWRAPPED_ENDING))
    return next((path for path in meshes if image.stem.startswith(path.name.removesuffix(_UNWRAPPED_ENDING))), None)


def image_uv_set(state: StudioState, image: Path) -> str | None:
    """The target's UV set of a baked image; None: the first."""
    return next((output.uv_set for output in state.outputs if baked_images((output,)) == (image,)), None)


def update_view(state: StudioState, **fields: object) -> View:
    """The view with changed fields; mode "baked" shows the first image of colours by default, else another one.

    ParameterError if there is no baked image.
    """
    view = replace(map_view(state.view) if fields.get("pose") else state.view, **fields)  # type: ignore[arg-type]
    if view.mode != "baked" or view.baked is not None:
        return view
    image = first_image(state.outputs)
    if image is None:
        raise ParameterError("Show: expected a baked image, there is none yet. Press Bake.")
    return baked_view(view, image)


def add_message(messages: tuple[Message, ...], kind: MessageKind, text: str) -> tuple[Message, ...]:
    """Append a message; an equal earlier one is removed."""
    new = Message(kind, text.encode("utf-8", "backslashreplace").decode())  # file names may have invalid characters
    return (*(old for old in messages if old != new), new)[-MAX_MESSAGES:]
