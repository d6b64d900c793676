"""Run a method on a pair and compare."""

from __future__ import annotations

import subprocess
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.accuracy.data import HumanPair, animal_pair
from benchmarks.truth import Truth, compare_with_truth, round_trip, true_map
from cagemap.maps.pair import PointPairs
from cagemap.maps.point_map import PointMap
from cagemap.mesh.landmarks import Landmarks
from cagemap.pipeline import MatchConfig, choose_level, default_basis, match, prepare_surfaces
from cagemap.spectral import Surface
from cagemap.spectral.surface import ENOUGH
from cagemap.subdivision import Refinement, level_triangles, refine
from cagemap.surface.triangle_surface import SurfacePoints, TriangleSurface

WORKER = Path(__file__).resolve().parents[1] / "speed" / "pyfm_worker.py"


@dataclass(frozen=True)
class Side:
    """A refined surface with its neutral shape; prepared for our own methods, which need a level of at least 1."""

    surface: Surface | None
    positions: np.ndarray
    triangles: np.ndarray
    neutral: np.ndarray


def human_rows(
    pair: HumanPair, vertices: int, counts: list[int], method: str, pyfm: str | None, seconds: float
) -> list[dict]:
    """One row of figures for every number of landmarks and direction."""
    sides = _refined_sides(pair, vertices) if method == "pyfm" else _prepared_sides(pair, vertices, method)
    truths = [_truth(sides, direction) for direction in (0, 1)]
    rows = []
    for count in counts:
        forward = pair.landmarks(count)
        maps, times = [], []
        for landmarks, (source, target) in ((forward, sides), (forward.reversed(), sides[::-1])):
            start = time.perf_counter()
            maps.append(_map(method, target, source, landmarks, pyfm, seconds))
            times.append(time.perf_counter() - start)
        for direction, landmarks in ((0, forward), (1, forward.reversed())):
            source, target = sides if direction == 0 else sides[::-1]
            found, back = maps[direction], maps[1 - direction]
            pairs = PointPairs(
                SurfacePoints.from_vertices(found.target, landmarks.target),
                SurfacePoints.from_vertices(found.source, landmarks.source),
            )
            figures, trip = compare_with_truth(found, truths[direction], pairs), round_trip(found, back)
            names = (pair.first, pair.second) if direction == 0 else (pair.second, pair.first)
            rows.append(
                {
                    "pair": pair.key,
                    "source": names[0],
                    "target": names[1],
                    "method": method,
                    "landmarks": count,
                    "vertices": [len(target.positions), len(source.positions)],
                    "mean": 100 * figures.mean,
                    "median": 100 * figures.median,
                    "p95": 100 * figures.p95,
                    "max": 100 * figures.maximum,
                    "worst_landmark": 100 * figures.worst_landmark,
                    "flipped": 100 * figures.flipped_area,
                    "true_flipped": 100 * figures.true_flipped_area,
                    "dirichlet_ratio": figures.dirichlet_ratio,
                    "coverage": 100 * figures.coverage,
                    "round_trip": 100 * float(trip.mean()),
                    "known": 100 * figures.known,
                    "seconds": times[direction],
                }
            )
            print(_line(rows[-1]), flush=True)
    return rows


def animal_rows(key: str, vertices: int, method: str, left_out: int) -> list[dict]:
    """Both directions of a pair without truth; the leave-one-out error is over some evenly spaced landmarks."""
    source_mesh, target_mesh, forward = animal_pair(key)
    levels = (choose_level(target_mesh, vertices), choose_level(source_mesh, vertices))
    target, source = prepare_surfaces(target_mesh, source_mesh, levels, default_basis(method))
    rows = []
    for landmarks, to, of in ((forward, target, source), (forward.reversed(), source, target)):
        config = MatchConfig(method=method)
        result = match(to, of, landmarks, config)
        positions = of.triangles(of.finest_level).positions
        errors = []
        for i in np.unique(np.linspace(0, len(landmarks) - 1, left_out).astype(int)):
            less = _without(landmarks, int(i))
            found = match(to, of, less, config).point_map
            image = found.images.at(landmarks.target[[i]]).positions
            errors.append(float(np.linalg.norm(image - positions[landmarks.source[i]])))
        figures = result.quality
        rows.append(
            {
                "pair": key,
                "source": of.control.name,
                "target": to.control.name,
                "method": method,
                "vertices": [len(to.refinement.finest.positions), len(positions)],
                "landmarks": len(landmarks),
                "left_out_mean": 100 * float(np.mean(errors)),
                "left_out_max": 100 * float(np.max(errors)),
                "left_out": len(errors),
                "worst_landmark": 100 * float(figures.landmark_errors.max()),
                "flipped": 100 * figures.flipped_area,
                "coverage": 100 * figures.coverage,
                "dirichlet": figures.dirichlet,
                "area_ratio_5": float(figures.area_ratios[1]),
                "area_ratio_95": float(figures.area_ratios[3]),
                "aspect_median": float(figures.aspect_ratios[0]),
                "aspect_95": float(figures.aspect_ratios[1]),
                "warnings": list(figures.warnings),
            }
        )
        print(rows[-1], flush=True)
    return rows


def _without(landmarks: Landmarks, index: int) -> Landmarks:
    keep = np.arange(len(landmarks)) != index
    names = tuple(name for i, name in enumerate(landmarks.names) if i != index)
    return replace(landmarks, names=names, target=landmarks.target[keep], source=landmarks.source[keep])


def _prepared_sides(pair: HumanPair, vertices: int, method: str) -> tuple[Side, Side]:
    """First and second mesh of a pair, prepared for a method at the level with about so many vertices."""
    meshes = pair.meshes()
    levels = tuple(choose_level(mesh, vertices) for mesh in meshes)
    surfaces = prepare_surfaces(meshes[0], meshes[1], (levels[0], levels[1]), default_basis(method))
    first, second = (
        _side(surface.refinement, neutral, surface) for surface, neutral in zip(surfaces, pair.neutrals(), strict=True)
    )
    return first, second


def _refined_sides(pair: HumanPair, vertices: int) -> tuple[Side, Side]:
    """The same for others' methods, which may take a control mesh that has enough vertices as it is."""
    sides = []
    for mesh, neutral in zip(pair.meshes(), pair.neutrals(), strict=True):
        level = 0 if mesh.n_vertices >= ENOUGH * vertices else choose_level(mesh, vertices)
        sides.append(_side(refine(mesh, level), neutral, None))
    return sides[0], sides[1]


def _side(refinement: Refinement, neutral: np.ndarray, surface: Surface | None) -> Side:
    top = refinement.finest_level
    prolonged = refinement.prolong(neutral, 0, top)
    return Side(surface, refinement.finest.positions, level_triangles(refinement, top), prolonged)


def _truth(sides: tuple[Side, Side], direction: int) -> Truth:
    source, target = sides if direction == 0 else sides[::-1]
    return true_map(*(TriangleSurface.from_faces(side.neutral, side.triangles) for side in (target, source)))


def _map(method: str, target: Side, source: Side, landmarks: Landmarks, pyfm: str | None, seconds: float) -> PointMap:
    if target.surface is not None and source.surface is not None:
        return match(target.surface, source.surface, landmarks, MatchConfig(method=method)).point_map
    with tempfile.TemporaryDirectory() as folder:
        given, answer = f"{folder}/in.npz", f"{folder}/out.npz"
        np.savez(
            given,
            source_vertices=source.positions, source_triangles=source.triangles,
            target_vertices=target.positions, target_triangles=target.triangles,
            landmarks=np.column_stack([landmarks.source, landmarks.target]),
        )  # fmt: skip
        subprocess.run([str(pyfm), str(WORKER), given, answer, str(seconds)], check=True)
        vertex = np.load(answer)["match"].astype(np.int64)
    surfaces = (TriangleSurface.from_faces(side.positions, side.triangles) for side in (target, source))
    return PointMap.from_vertices(*surfaces, vertex)


def _line(row: dict) -> str:
    return (
        f"{row['method']:8s} {row['source']} -> {row['target']} {row['landmarks']} landmarks: mean {row['mean']:.3f} "
        f"p95 {row['p95']:.2f} flipped {row['flipped']:.3f} % Dirichlet {row['dirichlet_ratio']:.3f} "
        f"coverage {row['coverage']:.2f} % ({row['seconds']:.1f} s)"
    )
