"""Surfaces that the figures are drawn from, each prepared once."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, Normalize

from benchmarks.accuracy.data import DATA, HUMANS, REPOSITORY, HumanPair
from benchmarks.truth import true_map
from cagemap.files.meshes.obj import read_obj
from cagemap.maps.pair import Pair
from cagemap.mesh import ControlMesh
from cagemap.pictures import Model, Skin, View, frame, render
from cagemap.pipeline import pair_of, prepare_surface
from cagemap.spectral import BasisConfig, Surface
from cagemap.surface.triangle_surface import TriangleSurface

OUTPUT = REPOSITORY / "docs" / "paper"
# The schedule of Fig. 13's pair and of the trolls (Table 1).
SCHEDULE = (100, 50, 50, 50)
PAIR = HUMANS["female1605__male1591"]
# Pixels of a panel of 2.4 by 3.2 inches: 300 to an inch.
PANEL = (720, 960)
STANDING = View("from the front", 20.0, 6.0)


def human(name: str) -> ControlMesh:
    return read_obj(DATA / "humans" / f"{name}.obj")


def animal(name: str) -> ControlMesh:
    return read_obj(DATA / "animals" / f"{name}.obj")


@cache
def prepared(name: str, level: int, schedule: tuple[int, ...] | None = SCHEDULE) -> Surface:
    """A surface of `data/humans` or `data/animals`, by a fixed schedule or with a basis of one level."""
    mesh = human(name) if (DATA / "humans" / f"{name}.obj").is_file() else animal(name)
    config = BasisConfig() if schedule is None else BasisConfig(schedule=schedule[: level + 1])
    return prepare_surface(mesh, level, config)


@dataclass(frozen=True)
class Judged:
    """Two surfaces whose true map is known, at their finest levels.

    Attributes
    ----------
    places : (n2, 3)
        Source vertices, unit area.
    images : (n1, 3)
        Where the target's vertices belong on the source.
    known : (n1,) bool
    """

    places: np.ndarray
    images: np.ndarray
    known: np.ndarray

    @classmethod
    def of(cls, pair: HumanPair, target: Surface, source: Surface) -> Judged:
        """Source is the pair's first mesh."""
        neutrals = [
            TriangleSurface.from_faces(
                surface.refinement.prolong(neutral, 0, surface.finest_level), surface.refinement.finest.faces
            )
            for surface, neutral in zip((source, target), pair.neutrals(), strict=True)
        ]
        truth = true_map(neutrals[1], neutrals[0])
        places = source.triangles(source.finest_level)
        return cls(places.positions, truth.on(places).positions, truth.known)

    def errors(self, images: np.ndarray) -> np.ndarray:
        """(n,) distances to the true images, x100 of sqrt(area), of the first vertices of the target; NaN if unknown."""
        n = len(images)
        away = 100.0 * np.linalg.norm(images - self.images[:n], axis=1)
        return np.where(self.known[:n], away, np.nan)

    def error(self, images: np.ndarray) -> float:
        """Mean of `errors` where the truth is known."""
        return float(np.nanmean(self.errors(images)))


def with_landmarks(target: Surface, source: Surface, count: int) -> Pair:
    """`PAIR` forward, with a number of farthest point landmarks and the mirror planes of both."""
    return pair_of(target, source, PAIR.landmarks(count))


def picture(
    positions: np.ndarray,
    triangles: np.ndarray,
    colors: np.ndarray,
    view: View = STANDING,
    size: tuple[int, int] = PANEL,
) -> np.ndarray:
    """One panel: a surface with colours (n, 3) at its vertices."""
    width, height = size
    camera = frame(positions, view, aspect=width / height)
    return render(Model(positions, triangles), Skin(vertex_colors=colors), camera, width=width, height=height)


def color_scale(axis: Axes, scale: np.ndarray, low: float, high: float, label: str) -> None:
    """Bar beside a panel that tells what the colours of `cagemap.pictures.scalar_colors` mean."""
    colors = ScalarMappable(Normalize(low, high), LinearSegmentedColormap.from_list("scale", scale))
    axis.figure.colorbar(colors, ax=axis, shrink=0.6, label=label)


def verdict(holds: bool, claim: str, but: str = "") -> str:
    """What is said of a claim of the paper, from what was measured."""
    return f"'{claim}' holds" if holds else f"**Does not hold here:** '{claim}'" + (f", {but}" if but else "")


def folder() -> Path:
    OUTPUT.mkdir(parents=True, exist_ok=True)
    return OUTPUT
