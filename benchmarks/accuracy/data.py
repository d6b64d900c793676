"""Pairs of the accuracy benchmark."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cagemap.files.landmarks.pairs import read_landmarks
from cagemap.files.meshes.obj import read_obj
from cagemap.mesh import ControlMesh
from cagemap.mesh.landmarks import Landmarks

REPOSITORY = Path(__file__).resolve().parents[2]
DATA = REPOSITORY.parent / "shared" / "data"


@dataclass(frozen=True)
class HumanPair:
    """Two connectivities of one body in two identities; forward, the first is the source and the second the target."""

    first: str
    second: str
    identities: tuple[str, str] = ("male_young", "female_old_heavy")

    @property
    def key(self) -> str:
        return f"{self.first}__{self.second}"

    def meshes(self) -> tuple[ControlMesh, ControlMesh]:
        """First and second control mesh."""
        names = zip((self.first, self.second), self.identities, strict=True)
        first, second = (read_obj(DATA / "humans" / f"{name}_{identity}.obj") for name, identity in names)
        return first, second

    def neutrals(self) -> tuple[np.ndarray, np.ndarray]:
        """Control positions of both where their surfaces coincide; in the files' unit, which both share."""
        first, second = (read_obj(DATA / "humans" / f"{name}_neutral.obj") for name in (self.first, self.second))
        return first.positions, second.positions

    def landmarks(self, count: int) -> Landmarks:
        """Farthest point landmarks with the second mesh as target."""
        path = DATA / "humans" / "landmarks" / f"{self.key}_fps{count}.json"
        return read_landmarks(path, f"{self.second}_neutral.obj", f"{self.first}_neutral.obj")[0]


HUMANS = {
    pair.key: pair
    for pair in (
        HumanPair("female1605", "male1591"),
        HumanPair("base", "soma18056"),
        HumanPair("anny10pc", "anny5pc"),
        HumanPair("base", "female1605"),
        HumanPair("base", "male1591"),
        HumanPair("base", "proxy741"),
        HumanPair("base", "anny10pc"),
    )
}
# Mean error (x100 of sqrt(area)), 95th percentile, with 14 landmarks.
BARS = {"female1605__male1591": (0.7, 2.2), "base__soma18056": (0.9, 3.0), "anny10pc__anny5pc": (0.9, 2.5)}
ANIMALS = ("zebra__horse", "spot__cow", "wolf__red_fox", "blub__fish1", "horse__cow", "wolf__horse")


def animal_pair(key: str) -> tuple[ControlMesh, ControlMesh, Landmarks]:
    """Source, target and named landmarks of two animals."""
    source, target = key.split("__")
    landmarks = read_landmarks(DATA / "animals" / "landmarks" / f"{key}.json", f"{target}.obj", f"{source}.obj")[0]
    return read_obj(DATA / "animals" / f"{source}.obj"), read_obj(DATA / "animals" / f"{target}.obj"), landmarks
