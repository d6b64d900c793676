"""``python -m benchmarks.public.harder FOLDER``: sets as those of `lookalikes`, with more of what makes real ones hard.

Humans: two bodies of different cages, arms that touch the body, the head and each other, bent elbows, deep squats.
Animals: one quadruped with proportions of three families that are further apart, each with a shape of its own. Every
mesh has detail of its own and shares neither connectivity nor the order of its vertices with another.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from scipy import sparse

from benchmarks.accuracy.data import DATA
from benchmarks.accuracy.posed_animals import landmarks_of
from benchmarks.public.lookalikes import (
    ANIMAL,
    ANIMAL_LANDMARKS,
    ANIMAL_LEVEL,
    ANIMAL_POSES,
    HUMAN_LANDMARKS,
    HUMAN_LEVEL,
    KNOWN,
    animal_bones,
    human_bones,
    legs,
    write_shape,
)
from benchmarks.public.sets import SETS
from benchmarks.skeleton import Sizes, Turns, shares, skinned
from benchmarks.truth import true_map
from cagemap.files.meshes.obj import read_obj
from cagemap.numerics.sparse_algebra import factor
from cagemap.operators.laplacian import stiffness, vertex_areas
from cagemap.spectral.zoomout import evenly_spaced_vertices
from cagemap.subdivision import level_triangles, refine
from cagemap.surface.triangle_surface import TriangleSurface

# Cage and identity; points of the template are vertices of the last.
HUMANS = (("male1591", "male_young"), ("female1605", "female_old_heavy"))
POSES: dict[str, Turns] = {
    "": {},
    "hands on hips": {
        "upper_arm_left": (20, 0, 10), "forearm_left": (-25, -15, -100),
        "upper_arm_right": (20, 0, -10), "forearm_right": (-25, 15, 100),
    },
    "arms crossed": {
        "upper_arm_left": (-45, -20, -10), "forearm_left": (-35, -95, 0), "spine": (15, 0, 0),
        "upper_arm_right": (-60, 20, 10), "forearm_right": (-35, 95, 0),
    },
    "hands touch": {
        "upper_arm_left": (-75, -38, 0), "forearm_left": (-10, -25, 0), "thigh_left": (0, 0, -6),
        "upper_arm_right": (-75, 38, 0), "forearm_right": (-10, 25, 0), "thigh_right": (0, 0, 6),
    },
    "squat": {
        "spine": (45, 0, 0), "thigh_left": (-105, 0, 0), "thigh_right": (-105, 0, 0), "shin_left": (110, 0, 0),
        "shin_right": (110, 0, 0), "upper_arm_left": (-20, -10, -20), "upper_arm_right": (-20, 10, 20),
        "forearm_left": (-40, 0, 0), "forearm_right": (-40, 0, 0),
    },
    "wave": {
        "upper_arm_left": (0, 0, 75), "forearm_left": (0, -30, 100), "upper_arm_right": (-30, 0, 15),
        "head": (10, 20, 0),
    },
    "side lunge": {
        "thigh_left": (0, 0, 50), "thigh_right": (-15, 0, -40), "shin_right": (40, 0, 0), "spine": (0, 0, -30),
        "upper_arm_left": (0, 0, 110), "upper_arm_right": (0, 60, 0),
    },
    "bow": {
        "spine": (85, 0, 0), "head": (10, 0, 0), "thigh_left": (12, 0, 0), "thigh_right": (12, 0, 0),
        "upper_arm_left": (-85, 0, -20), "upper_arm_right": (-85, 0, 20),
    },
    "kick": {
        "thigh_left": (-95, 0, 0), "shin_left": (10, 0, 0), "thigh_right": (20, 0, 0), "spine": (-15, 20, 0),
        "upper_arm_left": (30, 0, 20), "upper_arm_right": (-70, 0, 0), "forearm_right": (-90, 0, 0),
        "head": (0, -30, 0),
    },
}  # fmt: skip
# Posed by a file.
FILED = "crouch"


FAMILIES: dict[str, Sizes] = {
    "horse": {},
    "hippo": {
        "trunk": (1.05, 1.5), "neck": (0.75, 1.6), "head": (1.15, 1.8), "tail": (0.4, 1.0),
        **legs((0.5, 1.7), (0.45, 2.0)),
    },
    "cougar": {
        "trunk": (1.1, 0.75), "neck": (0.5, 0.9), "head": (0.55, 0.9), "tail": (1.8, 0.8),
        **legs((0.8, 1.0), (0.7, 1.4)),
    },
}  # fmt: skip


def detail(positions: np.ndarray, triangles: np.ndarray, length: float, size: float, seed: int) -> np.ndarray:
    """(n, 3) random shifts, smooth over a length and of a root mean square size, both of sqrt(area)."""
    areas = vertex_areas(positions, triangles)
    unit = np.sqrt(areas.sum())
    heat = sparse.diags_array(areas) + (length * unit) ** 2 * sparse.csc_array(stiffness(positions, triangles))
    factors = factor(sparse.csc_array(heat))
    shifts = np.random.default_rng(seed).standard_normal(positions.shape) / np.sqrt(areas)[:, None]
    for _ in range(2):
        shifts = np.asarray(factors.solve(areas[:, None] * shifts))
    return size * unit * shifts / np.sqrt((shifts**2).mean())


def write_shuffled(
    root: Path, shape: str, positions: np.ndarray, triangles: np.ndarray, known: np.ndarray, seed: int
) -> None:
    """`write_shape` of the same surface with its vertices in another order."""
    order = np.random.default_rng(seed).permutation(len(positions))
    place = np.argsort(order)
    write_shape(root, shape, positions[order], place[triangles], place[known], seed)


def write_humans(root: Path) -> None:
    """Ten poses of two bodies."""
    listed = json.loads((DATA / "humans" / "landmarks" / f"base__{HUMANS[1][0]}.json").read_text())["pairs"]
    named = {pair["name"]: pair["target"] for pair in listed}
    (ids,) = SETS["faust_r"].landmarks.values()
    neutral = []
    for cage, _ in HUMANS:
        refinement = refine(read_obj(DATA / "humans" / f"{cage}_neutral.obj"), HUMAN_LEVEL)
        neutral.append(
            TriangleSurface.from_faces(refinement.finest.positions, level_triangles(refinement, HUMAN_LEVEL))
        )
    truth = true_map(neutral[1], neutral[0]).on(neutral[0])
    nearest = truth.corners[np.arange(len(truth)), truth.barycentric.argmax(axis=1)]
    known = evenly_spaced_vertices(neutral[1].n, KNOWN["faust_r"])[: KNOWN["faust_r"]]
    known[list(ids)] = [named[name] for name in HUMAN_LANDMARKS]
    for i, (cage, identity) in enumerate(HUMANS):
        on_it = np.arange(neutral[1].n) if i == 1 else nearest
        shapes, triangles = [], neutral[i].triangles
        for path in (f"{cage}_{identity}.obj", f"posed/{cage}_{identity}_{FILED}.obj"):
            shapes.append(refine(read_obj(DATA / "humans" / path), HUMAN_LEVEL).finest.positions)
        standing = shapes[0] + detail(shapes[0], triangles, 0.03, 0.004, 100 + i)
        bones = human_bones({name: standing[on_it[vertex]] for name, vertex in named.items()})
        weights = shares(standing, triangles, bones, 0.03)
        shapes = [*(skinned(standing, weights, bones, turns) for turns in POSES.values()), shapes[1]]
        for j, positions in enumerate(shapes):
            moved = positions + detail(positions, triangles, 0.03, 0.003, 1000 + 10 * i + j)
            write_shuffled(root, f"tr_reg_0{80 + 10 * i + j}", moved, triangles, on_it[known], 5000 + 10 * i + j)


def write_animals(root: Path) -> None:
    """Three families in six poses."""
    named = landmarks_of(ANIMAL)
    refinement = refine(read_obj(DATA / "animals" / f"{ANIMAL}.obj"), ANIMAL_LEVEL)
    triangles, standing = level_triangles(refinement, ANIMAL_LEVEL), refinement.finest.positions
    bones = animal_bones({name: standing[vertex] for name, vertex in named.items()})
    weights = shares(standing, triangles, bones, 0.04)
    (ids,) = SETS["smal_r"].landmarks.values()
    known = evenly_spaced_vertices(len(standing), KNOWN["smal_r"])[: KNOWN["smal_r"]]
    known[list(ids)] = [named[name] for name in ANIMAL_LANDMARKS]
    for i, (family, sizes) in enumerate(FAMILIES.items()):
        own = detail(standing, triangles, 0.08, 0.018 if sizes else 0.008, 300 + i)
        own = standing + own + detail(standing, triangles, 0.03, 0.004, 310 + i)
        for j, turns in enumerate(ANIMAL_POSES.values()):
            positions = skinned(own, weights, bones, turns, sizes)
            moved = positions + detail(positions, triangles, 0.05, 0.004, 400 + 10 * i + j)
            write_shuffled(root, f"{family}_{j:02d}", moved, triangles, known, 7000 + 10 * i + j)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.public.harder", description=__doc__)
    parser.add_argument("folder", type=Path)
    arguments = parser.parse_args()
    if not DATA.is_dir():
        parser.error("the meshes are not beside this checkout (../shared/data)")
    write_humans(arguments.folder / "FAUST_r")
    write_animals(arguments.folder / "SMAL_r")


if __name__ == "__main__":
    main()
