"""Meshes of the benchmark: human control meshes whose true map is known, and one cage for the basis."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from benchmarks.speed.measure import REPOSITORY

DATA = REPOSITORY.parent / "shared" / "data"


@dataclass(frozen=True)
class HumanPair:
    """Two connectivities of one body; the neutral identities coincide, so that the true map is known."""

    source: str
    target: str

    @property
    def source_file(self) -> Path:
        """Control mesh that gives."""
        return DATA / "humans" / f"{self.source}_male_young.obj"

    @property
    def target_file(self) -> Path:
        """Control mesh that receives, another identity."""
        return DATA / "humans" / f"{self.target}_female_old_heavy.obj"

    @property
    def neutral_files(self) -> tuple[Path, Path]:
        """Target and source where they coincide."""
        return DATA / "humans" / f"{self.target}_neutral.obj", DATA / "humans" / f"{self.source}_neutral.obj"

    @property
    def landmarks(self) -> Path:
        """14 landmarks."""
        return DATA / "humans" / "landmarks" / f"{self.source}__{self.target}_fps14.json"


# Small cages refined often, and large cages refined seldom: sizes in between each other's.
PROXIES = HumanPair("female1605", "male1591")  # 25k at level 2, 99k at 3, 395k at 4
BODIES = HumanPair("base", "soma18056")  # 54k + 72k at level 1, 214k + 289k at 2, 856k + 1155k at 3
PAIRS = {"proxies": PROXIES, "bodies": BODIES}
# Loop of a closed triangle mesh; 421k vertices at level 5.
BASIS_CAGE = DATA / "animals" / "cow.obj"
