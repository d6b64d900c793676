"""The meshes, what they show, and pairs of them drawn at random."""

from __future__ import annotations

import random
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from benchmarks.accuracy.data import DATA
from benchmarks.accuracy.posed import POSES, Body
from benchmarks.accuracy.posed_animals import landmarks_of

SORTS = ("humans as they stand", "humans, posed", "animals of a kind", "different kinds")
QUADRUPEDS = ("zebra", "horse", "cow", "pig", "wolf", "red_fox", "spot")
FISHES = ("fish1", "blub", "shark")
# Places of the animals that no landmark file has: control vertices, picked by looking.
PLACES = {
    "pig": {
        "nose_tip": 222, "fore_foot_left": 75, "fore_foot_right": 214, "hind_foot_left": 68, "hind_foot_right": 207,
    },
    "shark": {
        "mouth_tip": 204, "dorsal_fin_tip": 48, "tail_upper_tip": 22, "tail_lower_tip": 31,
        "pectoral_fin_tip_left": 77, "pectoral_fin_tip_right": 256,
    },
}  # fmt: skip


@dataclass(frozen=True)
class Model:
    """A mesh of the shared data.

    Attributes
    ----------
    name : str
        Of its file, without the ending.
    kind : str
        "human", "quadruped", "fish", or its own where nothing else is of its kind.
    path : Path
    """

    name: str
    kind: str
    path: Path

    @property
    def body(self) -> Body:
        """Connectivity, identity and pose of a human."""
        cage, _, rest = self.name.partition("_")
        pose = next((pose for pose in POSES if pose and rest.endswith(f"_{pose}")), "")
        return cage, rest.removesuffix(f"_{pose}"), pose

    @property
    def places(self) -> dict[str, int]:
        """Named control vertices of an animal; none of others."""
        if self.kind not in ("quadruped", "fish"):
            return {}
        return PLACES.get(self.name) or landmarks_of(self.name)


@cache
def models() -> tuple[Model, ...]:
    """All meshes of the shared data."""
    found = []
    for path in sorted(DATA.glob("*/*.obj")) + sorted(DATA.glob("humans/posed/*.obj")):
        name = path.stem
        kind = "quadruped" if name in QUADRUPEDS else "fish" if name in FISHES else name
        found.append(Model(name, "human" if "humans" in path.parts else kind, path))
    return tuple(found)


def drawn_pairs(count: int, seed: int) -> list[tuple[Model, Model]]:
    """So many targets and sources of every sort, at random."""
    every = [(target, source) for target in models() for source in models() if target is not source]
    random.Random(seed).shuffle(every)
    return [pair for name in SORTS for pair in [one for one in every if sort_of(*one) == name][:count]]


def sort_of(target: Model, source: Model) -> str:
    """What sort of pair two models are."""
    if target.kind != source.kind:
        return SORTS[3]
    if target.kind != "human":
        return SORTS[2]
    return SORTS[1] if target.body[2] or source.body[2] else SORTS[0]
