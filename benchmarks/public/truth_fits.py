"""``python -m benchmarks.public.truth_fits SET FOLDER --pairs N``: signs of fits that start from the true map.

Without a search a pair takes a few seconds. With ``--exchange K`` the limb of the set's landmark K and that of the next
one are exchanged left to right on the source before the fit: a wrong map.
"""

from __future__ import annotations

import argparse
import random
from itertools import permutations
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from benchmarks.public.measure import Shape, Shapes, geodesic_errors, receiver
from benchmarks.public.sets import SETS
from cagemap.deform.fit import evaluate_placement, fine_fit
from cagemap.deform.problem import Problem
from cagemap.deform.refit import finish_placement
from cagemap.maps.geodesic import HeatDistances
from cagemap.maps.hypotheses.confidence import jump_lengths, jump_share, median_distortion
from cagemap.maps.projection.project import map_of_places
from cagemap.mesh.landmarks import Landmarks
from cagemap.pipeline import prepare_pair

# Points judged; weight of normals, of sqrt(area); length of an exchanged limb from its tip.
POINTS, NORMAL_WEIGHT, LIMB = 120, 0.05, 0.35


def true_places(target: Shape, source: Shape, ids: np.ndarray, to: np.ndarray, mesh) -> np.ndarray:
    """(n, 3) positions of a mesh's vertices on the source, from the nearest points ``ids``, which lie at ``to``."""
    known = target.places.at(np.searchsorted(target.marks.ids, ids))
    normals = known.interpolate(target.places.surface.vertex_normals)
    tree = cKDTree(np.hstack([known.positions, NORMAL_WEIGHT * normals]))
    distance, nearest = tree.query(np.hstack([mesh.positions, NORMAL_WEIGHT * mesh.vertex_normals]), k=3)
    weights = 1 / np.maximum(distance, 1e-3) ** 2
    places = source.places.at(np.searchsorted(source.marks.ids, to)).positions
    return np.einsum("nk,nkd->nd", weights / weights.sum(axis=1, keepdims=True), places[nearest])


def exchanged(target: Shape, standing: Shape, ids: np.ndarray, tips: tuple[int, int]) -> np.ndarray:
    """Points ``ids``, those of two limbs replaced by their mirror images on a shape that stands upright."""
    known = target.places.at(np.searchsorted(target.marks.ids, ids))
    to, mirror = ids.copy(), standing.places.positions * [-1, 1, 1]
    mirror[:, 0] += standing.places.positions[:, 0].min() + standing.places.positions[:, 0].max()
    opposite = standing.marks.ids[cKDTree(standing.places.positions).query(mirror)[1]]
    for tip in tips:
        at = np.array([np.abs(ids - tip).argmin()])
        distances = HeatDistances(target.places.surface).from_points(known.at(at))
        limb = np.flatnonzero(known.interpolate(distances)[:, 0] < LIMB)
        limb = limb[np.isin(ids[limb], standing.marks.ids)]
        images = opposite[np.searchsorted(standing.marks.ids, ids[limb])]
        both = np.isin(images, ids)
        to[limb[both]] = images[both]
    return to


def main() -> None:
    """One line for each pair: cost x 1e4, stretch, share of jumps and mean error x100, before and after the refit."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.public.truth_fits", description=__doc__)
    parser.add_argument("set", choices=["faust_r", "smal_r"])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--pairs", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--exchange", type=int)
    arguments = parser.parse_args()
    public = SETS[arguments.set]
    shapes, names = Shapes(public, arguments.folder, "none", 0), sorted(public.shapes(arguments.folder))
    (marks,) = public.landmarks.values()
    standing = next(name for name in names if name.strip("0123456789_") == "horse" or name.startswith("tr_reg"))
    for pair in random.Random(arguments.seed).sample(list(permutations(names, 2)), arguments.pairs):
        target, source = shapes.pair(*pair)
        ids = np.intersect1d(target.marks.ids, source.marks.ids)
        to, k = ids, arguments.exchange
        if k is not None:
            to = exchanged(target, shapes[standing], ids, marks[k : k + 2])
        problem = Problem.of_landmarks(prepare_pair(target.surface, source.surface), Landmarks.none())
        prepared = problem.prepared
        placed = evaluate_placement(prepared, fine_fit(problem, true_places(target, source, ids, to, prepared.mesh)))
        at, values = receiver(source, POINTS), [f"cost {1e4 * placed.cost:.2f}"]
        for fitted in (placed, finish_placement(problem, placed)):
            found = map_of_places(problem, fitted.map_positions)
            jumps = jump_share(prepared, jump_lengths(prepared, found))
            error = 100 * geodesic_errors(found.images, target, source, at).mean()
            values.append(f"stretched {median_distortion(found):.3f}, jumps {100 * jumps:.1f} %, mean {error:.2f}")
        print(" <- ".join(pair), *values, sep="; ", flush=True)


if __name__ == "__main__":
    main()
