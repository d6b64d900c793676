"""Landmarks as the studio edits them: places on one or both models, with a history that undo walks back."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Literal

from cagemap.mesh.curves import Curves
from cagemap.mesh.landmarks import Landmarks

Side = Literal["target", "source"]
SIDES: tuple[Side, Side] = ("target", "source")
# Steps that undo can walk back.
LONGEST_HISTORY = 500
_MIRRORED = (("_L", "_R"), (".L", ".R"), ("_left", "_right"), ("left_", "right_"), ("L_", "R_"))


def other(side: Side) -> Side:
    """The model across."""
    return "source" if side == "target" else "target"


@dataclass(frozen=True)
class Place:
    """A point of a model: on its control mesh, and where that lies on the smooth surface.

    Attributes
    ----------
    position : (x, y, z)
        Of the smooth surface, in the units of the model's file.
    corners : (a, b, c)
        Control vertices of the triangle that holds the point.
    weights : (u, v, w)
        Theirs, not negative, with sum 1.
    """

    position: tuple[float, float, float]
    corners: tuple[int, int, int]
    weights: tuple[float, float, float]


@dataclass(frozen=True)
class Landmark:
    """One landmark; complete when it has its place on both models.

    Attributes
    ----------
    number : int
        Stays with the landmark while others come and go: its colour and the digits on the models.
    name : str
    target, source : Place or None
    """

    number: int
    name: str
    target: Place | None = None
    source: Place | None = None

    @property
    def complete(self) -> bool:
        """Whether both models have it."""
        return self.target is not None and self.source is not None

    def on(self, side: Side) -> Place | None:
        """Return the place on one model."""
        return self.target if side == "target" else self.source

    def at(self, side: Side, place: Place | None) -> Landmark:
        """Return the landmark with another place on one model."""
        return replace(self, target=place) if side == "target" else replace(self, source=place)


@dataclass(frozen=True)
class LandmarkList:
    """All landmarks in the order of their making; at most one is incomplete, the one being placed.

    Attributes
    ----------
    items : tuple of Landmark
    curves : Curves or None
        Of the file that they came from; shown, used and saved again as they are.
    elsewhere : Landmarks or None
        Pairs and curves of the file that do not lie on the open parts, in the files' numbers; saved again as they are.
    """

    items: tuple[Landmark, ...] = ()
    curves: Curves | None = None
    elsewhere: Landmarks | None = None

    def __len__(self) -> int:
        return len(self.items)

    @property
    def complete(self) -> tuple[Landmark, ...]:
        """Landmarks that both models have."""
        return tuple(item for item in self.items if item.complete)

    @property
    def decides(self) -> bool:
        """Whether there is anything for a map to go by."""
        return bool(self.complete) or self.curves is not None

    @property
    def goes_by(self) -> tuple[object, ...]:
        """What a map goes by: places and curves, whatever they are called."""
        return tuple((item.target, item.source) for item in self.complete), self.curves

    @property
    def open(self) -> Landmark | None:
        """The landmark that waits for its other place."""
        return next((item for item in self.items if not item.complete), None)

    def get(self, number: int | None) -> Landmark | None:
        """Return the landmark of that number, if there is one."""
        return next((item for item in self.items if item.number == number), None)

    def _with(self, changed: Landmark) -> LandmarkList:
        return replace(self, items=tuple(changed if item.number == changed.number else item for item in self.items))


def place(landmarks: LandmarkList, side: Side, where: Place) -> LandmarkList:
    """Answer a click on a model: complete or correct the open landmark, or begin a new one."""
    waiting = landmarks.open
    if waiting is not None:
        return landmarks._with(waiting.at(side, where))
    number = 1 + max((item.number for item in landmarks.items), default=0)
    name = _free_name(landmarks, f"landmark {number}")
    return replace(landmarks, items=(*landmarks.items, Landmark(number, name).at(side, where)))


def begin(landmarks: LandmarkList, side: Side, where: Place) -> LandmarkList:
    """Begin a new landmark in place of the one that waits for its other place, if there is one."""
    waiting = landmarks.open
    return place(landmarks if waiting is None else remove(landmarks, waiting.number), side, where)


def move(landmarks: LandmarkList, number: int, side: Side, where: Place) -> LandmarkList:
    """Move one end of a landmark."""
    item = landmarks.get(number)
    return landmarks if item is None else landmarks._with(item.at(side, where))


def remove(landmarks: LandmarkList, number: int) -> LandmarkList:
    """Leave a landmark out."""
    return replace(landmarks, items=tuple(item for item in landmarks.items if item.number != number))


def rename(landmarks: LandmarkList, number: int, name: str) -> LandmarkList:
    """Give a landmark another name; names are unique, so a taken one gets a number behind it."""
    item = landmarks.get(number)
    name = name.strip()
    if item is None or not name or name == item.name:
        return landmarks
    return landmarks._with(replace(item, name=_free_name(landmarks, name)))


def mirror(
    landmarks: LandmarkList,
    number: int,
    across: Callable[[Side, Place], Place | None],
    taken: Callable[[Side, Place, Place], bool] = lambda *_: False,
) -> LandmarkList:
    """Add a landmark's counterpart across the models' mirror planes, unless another landmark has its place.

    Parameters
    ----------
    across : callable
        The mirror image of a place on one model, None where it is the place itself or the model has no mirror plane.
    taken : callable
        Whether two places of one model are about the same.
    """
    item = landmarks.get(number)
    if item is None or item.target is None or item.source is None:
        return landmarks
    target, source = across("target", item.target), across("source", item.source)
    if target is None or source is None:
        return landmarks
    images: tuple[tuple[Side, Place], ...] = (("target", target), ("source", source))
    others = [(side, image, one.on(side)) for one in landmarks.items for side, image in images]
    if any(place is not None and taken(side, image, place) for side, image, place in others):
        return landmarks
    new = 1 + max(entry.number for entry in landmarks.items)
    name = _free_name(landmarks, mirrored_name(item.name))
    return replace(landmarks, items=(*landmarks.items, Landmark(new, name, target, source)))


def mirrored_name(name: str) -> str:
    """Left for right and right for left in a name; a name without either gets ``_mirrored``."""
    for left, right in _MIRRORED:
        for one, two in ((left, right), (right, left)):
            if name.endswith(one) and one[0] in "_.":
                return name[: -len(one)] + two
            if name.startswith(one) and one[-1] == "_":
                return two + name[len(one) :]
    return f"{name}_mirrored"


@dataclass(frozen=True)
class Proposal:
    """Where the map puts the missing end of the landmark that waits for it."""

    number: int
    side: Side
    place: Place


def keep_elsewhere(landmarks: LandmarkList, before: LandmarkList) -> LandmarkList:
    """Keep what lies on other parts where a new list says nothing of them; a name that is taken gets a number."""
    said, kept = (Landmarks.none() if one.elsewhere is None else one.elsewhere for one in (landmarks, before))
    pairs = Landmarks.none() if len(said) else replace(kept, curves=Curves.none())
    curves = Curves.none() if len(said.curves) else kept.curves
    here = landmarks.curves or Curves.none()
    pairs = replace(pairs, names=_apart(pairs.names, (item.name for item in landmarks.items)))
    curves = replace(curves, names=_apart(curves.names, (*here.names, *said.curves.names)))
    both = said.joined_with(replace(pairs, curves=curves))
    return replace(landmarks, elsewhere=both if len(both) + len(both.curves) else None)


def _apart(names: tuple[str, ...], others: Iterable[str]) -> tuple[str, ...]:
    """Names, with a number behind those that others have."""
    known = set(others)
    taken = known | set(names)
    made = []
    for name in names:
        made.append(_free(taken, name) if name in known else name)
        taken.add(made[-1])
    return tuple(made)


def _free_name(landmarks: LandmarkList, wanted: str) -> str:
    taken = {item.name for item in landmarks.items}
    taken.update(() if landmarks.elsewhere is None else landmarks.elsewhere.names)
    return _free(taken, wanted)


def _free(taken: set[str], wanted: str) -> str:
    if wanted not in taken:
        return wanted
    return next(name for k in range(2, len(taken) + 3) if (name := f"{wanted} ({k})") not in taken)


@dataclass(frozen=True)
class History:
    """A list of landmarks and the ones before and after it.

    Attributes
    ----------
    present : LandmarkList
    past, future : tuple of LandmarkList
        Nearest last.
    """

    present: LandmarkList = LandmarkList()
    past: tuple[LandmarkList, ...] = ()
    future: tuple[LandmarkList, ...] = ()

    def then(self, landmarks: LandmarkList) -> History:
        """Go on with another list; what was undone is forgotten."""
        if landmarks == self.present:
            return self
        return History(landmarks, (*self.past, self.present)[-LONGEST_HISTORY:])

    def renamed(self, number: int, name: str) -> History:
        """Go on with another name of a landmark; names are typed letter by letter, which is one step together."""
        before = self.past[-1].get(number) if self.past else None
        item = self.present.get(number)
        typing = (
            before is not None
            and item is not None
            and before.name != item.name
            and self.past[-1]._with(replace(before, name=item.name)) == self.present
        )
        base = replace(self, present=self.past[-1], past=self.past[:-1]) if typing else self
        return base.then(rename(base.present, number, name))

    def undo(self) -> History:
        """One step back, if there is one."""
        if not self.past:
            return self
        return History(self.past[-1], self.past[:-1], (*self.future, self.present))

    def redo(self) -> History:
        """One step forward again, if there is one."""
        if not self.future:
            return self
        return History(self.future[-1], (*self.past, self.present), self.future[:-1])
