"""From many rough ways to lie on the source to the few that are fitted to the end, ranked by what they cost."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np

from cagemap.geometry.closest import build_tree, closest_points
from cagemap.maps.elastic.config import Stage
from cagemap.maps.elastic.constants import PULLERS, SHEET_VERTICES
from cagemap.maps.elastic.curves import CurvePull
from cagemap.maps.elastic.data import Pullers, deformed_normals
from cagemap.maps.elastic.fit import CoarseFit, coarse_cost, coarse_fit, fine_fit
from cagemap.maps.elastic.graph import ElasticGraph, extrapolate
from cagemap.maps.elastic.prepared import CoarseShape, PreparedPair
from cagemap.maps.hypotheses.confidence import Reading
from cagemap.maps.hypotheses.starts import SourcePlaces, Start, rigid_starts, spectral_starts
from cagemap.maps.pair import Pair
from cagemap.maps.spectral.samples import Samples, spread
from cagemap.numerics.arrays import FloatArray
from cagemap.numerics.threads import in_threads, thread_limit

One = TypeVar("One")

# Source vertices that rough fits are matched with.
PLACES = 3000


@dataclass(frozen=True)
class HypothesesConfig:
    """Parameters of the search; the defaults are the measured ones.

    Attributes
    ----------
    rough_vertices : int
        Size of the graph on which all starts are tried.
    rough : Stage
        Of those trials: from stiff, which turns and shifts as a whole, to soft.
    alike : float
        Mean distance of two starts, of sqrt(area), below which one of them is enough.
    different : float
        Mean distance of two fits, of sqrt(area), from which on they are two answers.
    coarse, finished : int
        How many different ones go on to the coarse stage of the fit, and from there to its end.
    hopeless : float
        A fit that costs this many times the best one is not finished.
    """

    rough_vertices: int = 400
    rough: Stage = field(default_factory=lambda: Stage(14, (1.0, 2e-4), 1e-2, momentum=0.6))
    alike: float = 0.03
    different: float = 0.08
    coarse: int = 4
    finished: int = 3
    hopeless: float = 2.5


@dataclass(frozen=True)
class _Candidate:
    name: str
    doubt: float
    fit: CoarseFit

    @property
    def rank(self) -> float:
        return self.doubt * self.fit.cost


def found_readings(
    prepared: PreparedPair,
    pair: Pair,
    config: HypothesesConfig = HypothesesConfig(),
    progress: Callable[[str], None] = lambda stage: None,
) -> tuple[Reading, ...]:
    """Different ways in which the target lies on the source, fitted, cheapest first.

    Landmarks of the pair, if there are any, are held by all of them. Positions are those of the vertices of the level
    that is deformed.

    Parameters
    ----------
    prepared : PreparedPair
    pair : Pair
    config : HypothesesConfig
    progress : callable
    """
    progress("hypotheses")
    shape = prepared.coarse(pair.target_landmarks, pair.landmarks.curves)
    rough = _rough_fits(prepared, pair, shape, config)
    progress("coarse fits")
    candidates = _coarse_fits(prepared, pair, shape, rough, config)
    progress("elastic fits")
    pullers = Pullers.choose(prepared.sheet, int(PULLERS * prepared.rest.graph.n), prepared.rest.masks)

    def finish(candidate: _Candidate) -> Reading:
        ended = fine_fit(prepared, shape, [candidate.fit], pair.landmarks)
        return Reading(candidate.name, reading_cost(prepared, pullers, ended), ended, candidate.doubt)

    readings = sorted(in_threads(finish, candidates), key=lambda reading: reading.doubt * reading.cost)
    return tuple(_different(readings, lambda reading: reading.positions, prepared.rest.graph.areas, config.different))


def reading_cost(prepared: PreparedPair, pullers: Pullers, positions: FloatArray) -> float:
    """What a fitted mesh costs: `coarse_cost`, and the mean squared distance of source points from the mesh.

    The last tells a limb that lies beside its counterpart, or a body squeezed into a part of the other.
    """
    rest, config = prepared.rest, prepared.elastic
    cost = coarse_cost(rest, prepared.sheet, positions, rest.field.solve(positions), config)
    tree = build_tree(positions, prepared.mesh.triangles)
    _, _, distance = closest_points(tree, pullers.points, pullers.planes, normal_weight=config.normal_weight)
    return cost + float(pullers.areas @ distance**2)


def _rough_fits(prepared: PreparedPair, pair: Pair, shape: CoarseShape, config: HypothesesConfig) -> list[_Candidate]:
    """The different ends of all rigid starts on a small graph, cheapest first, brought to the coarse graph."""
    staged = replace(prepared.elastic, coarse=config.rough, coarse_vertices=config.rough_vertices)
    curves = CurvePull.on_mesh(prepared.mesh, pair.landmarks.curves)
    rough = CoarseShape.build(prepared.rest.graph, pair.target_landmarks, staged, prepared.rest.masks, curves)
    small, sheet, places = rough.rest.graph, prepared.sheet, pair.landmarks.source.positions

    def trial(start: Start) -> _Candidate:
        with thread_limit(1):  # the starts are spread over the cores: a step of one is too short to be
            return _Candidate(start.name, start.doubt, coarse_fit(rough, sheet, start.positions, places, staged))

    starts = rigid_starts(small.positions, sheet.positions)
    tried = in_threads(trial, _different(starts, lambda start: start.positions, small.areas, config.alike))
    ranked = sorted(tried, key=lambda one: one.rank)
    kept = _different(ranked, lambda one: one.fit.positions, small.areas, config.different)[: config.coarse]
    # What starts of several names lead to has the first one's, which is the simplest.
    firsts = [
        next(t for t in tried if _apart(t.fit.positions, one.fit.positions, small.areas) < config.different)
        for one in kept
    ]
    return [
        _Candidate(first.name, first.doubt, _on(small, one.fit, shape.rest.graph))
        for first, one in zip(firsts, kept, strict=True)
    ]


def _coarse_fits(
    prepared: PreparedPair, pair: Pair, shape: CoarseShape, rough: Sequence[_Candidate], config: HypothesesConfig
) -> list[_Candidate]:
    """The cheapest coarse fit of each rough one: from where it is, or from what spectral upsampling makes of it."""
    graph, sheet, places, elastic = shape.rest.graph, prepared.sheet, pair.landmarks.source.positions, prepared.elastic
    target, source, on_source = _spectral_samples(prepared, shape)

    def improve(candidate: _Candidate) -> _Candidate:
        with thread_limit(1):
            return _cheapest(candidate)

    def _cheapest(candidate: _Candidate) -> _Candidate:
        own = coarse_fit(shape, sheet, candidate.fit.positions, places, elastic)
        normals = deformed_normals(graph, own.maps)
        starts = spectral_starts(candidate.name, own.positions, normals, target, source, on_source)
        others = [coarse_fit(shape, sheet, start.positions, places, elastic) for start in starts]
        return replace(candidate, fit=min([own, *others], key=lambda ended: ended.cost))

    improved = sorted(in_threads(improve, rough), key=lambda one: one.rank)
    kept = _different(improved, lambda one: one.fit.positions, graph.areas, config.different)
    hopeful = [one for one in kept if one.fit.cost <= config.hopeless * kept[0].fit.cost]
    return hopeful[: config.finished]


def _spectral_samples(prepared: PreparedPair, shape: CoarseShape) -> tuple[Samples, Samples, SourcePlaces]:
    """Basis rows of the coarse graph's vertices and of some vertices of the source, and where the latter lie."""
    sheet_level = prepared.source.refinement.coarsest_level(SHEET_VERTICES)
    vertices = spread(prepared.sheet.n, PLACES)
    at = SourcePlaces.build(prepared.sheet.positions, prepared.sheet.vertex_normals, vertices)
    sides = (
        (prepared.target, prepared.levels[0], shape.vertices, shape.rest.graph.areas),
        (prepared.source, sheet_level, vertices, np.ones(len(vertices))),
    )
    target, source = (
        Samples(surface.basis.rows(level, chosen), areas, np.zeros((len(chosen), 0)))
        for surface, level, chosen, areas in sides
    )
    return target, source, at


def _different(
    ranked: Sequence[One], positions_of: Callable[[One], FloatArray], areas: FloatArray, least: float
) -> list[One]:
    """Those that are at a mean distance of at least ``least`` from every better one."""
    kept: list[One] = []
    for one in ranked:
        if all(_apart(positions_of(one), positions_of(better), areas) >= least for better in kept):
            kept.append(one)
    return kept


def _apart(first: FloatArray, second: FloatArray, areas: FloatArray) -> float:
    """Mean distance of two placements of the same vertices."""
    return float(areas @ np.linalg.norm(first - second, axis=1))


def _on(small: ElasticGraph, ended: CoarseFit, graph: ElasticGraph) -> CoarseFit:
    """A fit of a small graph as rough positions of a larger one."""
    positions = extrapolate(small, ended.positions, ended.maps, graph)
    return CoarseFit(ended.cost, positions, np.zeros((graph.n, 3, 3)))
