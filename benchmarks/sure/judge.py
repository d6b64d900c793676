"""Whether a map is right: by the truth between humans, by named places between animals of a kind; else it is not."""

from __future__ import annotations

import random
from dataclasses import dataclass

import numpy as np

from benchmarks.accuracy.posed import Bodies
from benchmarks.sure.models import Model
from benchmarks.truth import compare_with_truth
from benchmarks.verdicts import verdict
from cagemap.files.meshes.obj import read_obj
from cagemap.maps.point_map import PointMap
from cagemap.mesh.landmarks import Landmarks
from cagemap.pipeline import match
from cagemap.spectral import Surface
from cagemap.spectral.surface import choose_level, prepare_surface

# Largest error of a right map, x100 of sqrt(area): the mean over a human, the median over an animal's named places.
RIGHT = 5.0
# Places that only a limb, a nose or a tail has: one that lands next to another's is exchanged.
EXTREMITIES = ("foot", "fin_tip", "nose", "mouth_tip", "tail_tip", "upper_tip", "lower_tip")


class Surfaces:
    """Prepared surfaces, each made once."""

    def __init__(self, vertices: int) -> None:
        self.bodies = Bodies(vertices)
        self.others: dict[str, Surface] = {}

    def of(self, model: Model) -> Surface:
        if model.kind == "human":
            return self.bodies.surface(model.body)
        if model.name not in self.others:
            control = read_obj(model.path)
            self.others[model.name] = prepare_surface(control, choose_level(control, self.bodies.vertices))
        return self.others[model.name]


@dataclass(frozen=True)
class Judgement:
    """What is known of a map.

    Attributes
    ----------
    by : str
        "truth", "places", or "kind" where the shapes are of different kinds and no map is right.
    error : float or None
        x100 of sqrt(area), see `RIGHT`.
    exchanged : int
        Extremities that land next to another one's place.
    """

    by: str
    error: float | None = None
    exchanged: int = 0

    @property
    def right(self) -> bool:
        return self.error is not None and self.error <= RIGHT and not self.exchanged


def judged(found: PointMap, target: Model, source: Model, surfaces: Surfaces) -> Judgement:
    """Judge a map of two models."""
    if target.kind == source.kind == "human":
        truth = surfaces.bodies.truth(target.body, source.body)
        return Judgement("truth", 100 * compare_with_truth(found, truth).mean)
    if target.kind != source.kind:
        return Judgement("kind")
    shared = sorted(target.places.keys() & source.places.keys())
    at, to = (np.array([side.places[name] for name in shared]) for side in (target, source))
    images, places = found.images.positions[at], found.source.positions[to]
    away = np.linalg.norm(images[:, None] - places, axis=2)
    tips = [i for i, name in enumerate(shared) if any(part in name for part in EXTREMITIES)]
    exchanged = int(np.sum(away[np.ix_(tips, tips)].argmin(axis=1) != np.arange(len(tips))))
    return Judgement("places", 100 * float(np.median(away.diagonal())), exchanged)


def right_landmarks(surfaces: Surfaces, target: Model, source: Model, count: int) -> Landmarks | None:
    """So many pairs of control vertices that are right, or what a person might take for such between kinds; the same
    ones every time.

    Between humans the control vertex nearest to the truth, between animals of a kind named places. Between kinds what
    is foremost, highest and hindmost.
    """
    if not count:
        return None
    choose, sides = random.Random(f"{target.name} {source.name}"), (surfaces.of(target), surfaces.of(source))
    if target.kind == source.kind == "human":
        truth = surfaces.bodies.truth(target.body, source.body)
        known = np.flatnonzero(truth.known[: sides[0].control.n_vertices]).tolist()
        vertices = np.array(choose.sample(known, count))
        true = truth.on(sides[1].triangles(sides[1].finest_level)).positions[vertices]
        cage = sides[1].triangles(sides[1].finest_level).positions[: sides[1].control.n_vertices]
        pairs = list(zip(vertices.tolist(), np.linalg.norm(true[:, None] - cage, axis=2).argmin(axis=1), strict=True))
    elif target.kind == source.kind:
        shared = sorted(target.places.keys() & source.places.keys())
        pairs = [(target.places[name], source.places[name]) for name in choose.sample(shared, count)]
    else:
        heights = [side.control.positions @ np.array([[0, 0, 1], [0, 1, 0], [0, 0, -1]]).T for side in sides]
        pairs = [(int(heights[0][:, i].argmax()), int(heights[1][:, i].argmax())) for i in range(count)]
    names = tuple(f"landmark {i}" for i in range(count))
    return Landmarks(names, *np.array(pairs, dtype=np.int64).T)


def row(surfaces: Surfaces, target: Model, source: Model, landmarks: int) -> dict:
    """What a match with few landmarks or none says of itself, and what is true."""
    found = match(surfaces.of(target), surfaces.of(source), right_landmarks(surfaces, target, source, landmarks))
    true = judged(found.point_map, target, source, surfaces)
    return {
        "target": target.name, "source": source.name, "vertices": surfaces.bodies.vertices, "landmarks": landmarks,
        **verdict(found), "judged_by": true.by, "error": true.error, "exchanged": true.exchanged, "right": true.right,
    }  # fmt: skip
