"""Landmarks as values, with functions that edit them and an undo history."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from cagemap.mesh.curves import CageCurvePairs
from cagemap.mesh.landmarks import Landmarks

Side = Literal["target", "source"]
SIDES: tuple[Side, Side] = ("target", "source")
# A name for the target and one for the source: of a part, a scheme, an axis; None: not given.
SideNames = tuple[str | None, str | None]
# Steps that undo can go back.
MAX_UNDO_STEPS = 500
# Endings and beginnings of names that tell left from right.
_SIDE_AFFIXES = (("_L", "_R"), (".L", ".R"), ("_left", "_right"), ("left_", "right_"), ("L_", "R_"))


def opposite_side(side: Side) -> Side:
    """The other one of target and source."""
    return "source" if side == "target" else "target"


@dataclass(frozen=True)
class Place:
    """A point of a model's control mesh and its position on the refined surface."""

    position: tuple[float, float, float]  # of the refined surface, in the units of the model's file
    corners: tuple[int, int, int]  # control vertices of the triangle that holds the point
    weights: tuple[float, float, float]  # barycentric coordinates, with sum 1


@dataclass(frozen=True)
class Landmark:
    """A landmark; complete when both models have its place."""

    number: int  # fixed; decides the landmark's colour and is drawn on the models
    name: str
    target: Place | None = None
    source: Place | None = None

    @property
    def is_complete(self) -> bool:
        """Whether both models have its place."""
        return self.target is not None and self.source is not None

    def place_on(self, side: Side) -> Place | None:
        """Return the place on one model."""
        return self.target if side == "target" else self.source

    def with_place(self, side: Side, place: Place | None) -> Landmark:
        """Return the landmark with another place on one model."""
        return replace(self, target=place) if side == "target" else replace(self, source=place)


@dataclass(frozen=True)
class LandmarkList:
    """All landmarks in the order of creation; at most one is incomplete."""

    items: tuple[Landmark, ...] = ()
    curves: CageCurvePairs = ()  # curves of the landmark file; used and saved again unchanged
    # pairs and curves on parts that are not open, with the files' vertex numbers; saved again unchanged
    unused_landmarks: Landmarks | None = None

    def __len__(self) -> int:
        return len(self.items)

    @property
    def complete_landmarks(self) -> tuple[Landmark, ...]:
        """Landmarks that both models have."""
        return tuple(item for item in self.items if item.is_complete)

    @property
    def has_constraints(self) -> bool:
        """Whether a map has complete landmarks or curves to follow."""
        return bool(self.complete_landmarks or self.curves)

    @property
    def constraints(self) -> tuple[object, ...]:
        """Places and curves that a map depends on, without names."""
        return tuple((item.target, item.source) for item in self.complete_landmarks), self.curves

    @property
    def open_landmark(self) -> Landmark | None:
        """The landmark whose place on one model is missing."""
        return next((item for item in self.items if not item.is_complete), None)

    def get(self, number: int | None) -> Landmark | None:
        """Return the landmark of that number, if there is one."""
        return next((item for item in self.items if item.number == number), None)

    def _replace_item(self, changed: Landmark) -> LandmarkList:
        return replace(self, items=tuple(changed if item.number == changed.number else item for item in self.items))


def add_place(landmarks: LandmarkList, side: Side, place: Place) -> LandmarkList:
    """Set a place of the open landmark, or start a new landmark."""
    open_landmark = landmarks.open_landmark
    if open_landmark is not None:
        return landmarks._replace_item(open_landmark.with_place(side, place))
    number = 1 + max((item.number for item in landmarks.items), default=0)
    name = _free_landmark_name(landmarks, f"landmark {number}")
    return replace(landmarks, items=(*landmarks.items, Landmark(number, name).with_place(side, place)))


def begin(landmarks: LandmarkList, side: Side, place: Place) -> LandmarkList:
    """Start a new landmark; an open one is removed."""
    open_landmark = landmarks.open_landmark
    return add_place(landmarks if open_landmark is None else remove(landmarks, open_landmark.number), side, place)


def move(landmarks: LandmarkList, number: int, side: Side, place: Place) -> LandmarkList:
    """Move a landmark on one model."""
    item = landmarks.get(number)
    return landmarks if item is None else landmarks._replace_item(item.with_place(side, place))


def remove(landmarks: LandmarkList, number: int) -> LandmarkList:
    """Remove a landmark."""
    return replace(landmarks, items=tuple(item for item in landmarks.items if item.number != number))


def rename(landmarks: LandmarkList, number: int, name: str) -> LandmarkList:
    """Rename a landmark; a number is appended to a name that is in use."""
    item = landmarks.get(number)
    name = name.strip()
    if item is None or not name or name == item.name:
        return landmarks
    return landmarks._replace_item(replace(item, name=_free_landmark_name(landmarks, name)))


def mirror(
    landmarks: LandmarkList,
    number: int,
    mirror_place: Callable[[Side, Place], Place | None],
    is_same_place: Callable[[Side, Place, Place], bool] = lambda *_: False,
) -> LandmarkList:
    """Add a landmark's mirror image, unless another landmark has its place.

    ``mirror_place``: mirror image of a place on one model; None for a place on the mirror plane or a model without one.
    ``is_same_place``: whether two places of one model are close together.
    """
    item = landmarks.get(number)
    if item is None or item.target is None or item.source is None:
        return landmarks
    target, source = mirror_place("target", item.target), mirror_place("source", item.source)
    if target is None or source is None:
        return landmarks
    images: tuple[tuple[Side, Place], ...] = (("target", target), ("source", source))
    pairs = [(side, image, other.place_on(side)) for other in landmarks.items for side, image in images]
    if any(place is not None and is_same_place(side, image, place) for side, image, place in pairs):
        return landmarks
    number = 1 + max(other.number for other in landmarks.items)
    name = _free_landmark_name(landmarks, mirror_name(item.name))
    return replace(landmarks, items=(*landmarks.items, Landmark(number, name, target, source)))


def mirror_name(name: str) -> str:
    """Exchange left and right in a name; append ``_mirrored`` where it has neither."""
    for left, right in _SIDE_AFFIXES:
        for old, new in ((left, right), (right, left)):
            if name.endswith(old) and old[0] in "_.":
                return name[: -len(old)] + new
            if name.startswith(old) and old[-1] == "_":
                return new + name[len(old) :]
    return f"{name}_mirrored"


@dataclass(frozen=True)
class Proposal:
    """The place that the map proposes to complete the open landmark."""

    number: int
    side: Side
    place: Place


def keep_unused_landmarks(landmarks: LandmarkList, before: LandmarkList) -> LandmarkList:
    """Take over unused landmarks from a previous list, if the new one has none.

    A number is appended to a name that is in use.
    """
    new = Landmarks.none() if landmarks.unused_landmarks is None else landmarks.unused_landmarks
    old = Landmarks.none() if before.unused_landmarks is None else before.unused_landmarks
    pairs = Landmarks.none() if len(new) else old
    curves = () if new.curves else old.curves
    pairs = replace(pairs, names=_distinct_names(pairs.names, (item.name for item in landmarks.items)))
    names = _distinct_names([pair.name for pair in curves], [pair.name for pair in landmarks.curves + new.curves])
    curves = tuple(replace(pair, name=name) for pair, name in zip(curves, names, strict=True))
    joined = new.joined_with(replace(pairs, curves=curves))
    return replace(landmarks, unused_landmarks=joined if len(joined) + len(joined.curves) else None)


def _distinct_names(names: Sequence[str], other_names: Iterable[str]) -> tuple[str, ...]:
    """Names with a number appended to those among the other names."""
    others = set(other_names)
    used = others | set(names)
    distinct = []
    for name in names:
        distinct.append(_free_name(used, name) if name in others else name)
        used.add(distinct[-1])
    return tuple(distinct)


def _free_landmark_name(landmarks: LandmarkList, name: str) -> str:
    used = {item.name for item in landmarks.items}
    used.update(() if landmarks.unused_landmarks is None else landmarks.unused_landmarks.names)
    return _free_name(used, name)


def _free_name(used: set[str], name: str) -> str:
    if name not in used:
        return name
    return next(free for k in range(2, len(used) + 3) if (free := f"{name} ({k})") not in used)


@dataclass(frozen=True)
class History:
    """The landmarks with their earlier and undone versions."""

    present: LandmarkList = LandmarkList()
    # `past`, `future`: the version next to the present one is last
    past: tuple[LandmarkList, ...] = ()
    future: tuple[LandmarkList, ...] = ()

    def advance(self, landmarks: LandmarkList) -> History:
        """Add a version; undone versions are dropped."""
        if landmarks == self.present:
            return self
        return History(landmarks, (*self.past, self.present)[-MAX_UNDO_STEPS:])

    def rename_landmark(self, number: int, name: str) -> History:
        """Rename a landmark; consecutive letters typed into one name are one undo step."""
        before = self.past[-1].get(number) if self.past else None
        item = self.present.get(number)
        continues_typing = (
            before is not None
            and item is not None
            and before.name != item.name
            and self.past[-1]._replace_item(replace(before, name=item.name)) == self.present
        )
        base = replace(self, present=self.past[-1], past=self.past[:-1]) if continues_typing else self
        return base.advance(rename(base.present, number, name))

    def undo(self) -> History:
        """Go back one version, if there is one."""
        if not self.past:
            return self
        return History(self.past[-1], self.past[:-1], (*self.future, self.present))

    def redo(self) -> History:
        """Go forward one undone version, if there is one."""
        if not self.future:
            return self
        return History(self.future[-1], (*self.past, self.present), self.future[:-1])
