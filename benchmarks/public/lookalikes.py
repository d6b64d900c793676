"""``python -m benchmarks.public.lookalikes FOLDER``: sets of our own that look like FAUST_r and SMAL_r.

Two humans in ten strong poses each, and one quadruped with the proportions of three, in poses: refined, posed, each
written as a plain triangle mesh of about 5000 vertices that shares no connectivity with the others. What was known on
the refined cage is known on all of them. ``python -m benchmarks.public faust_r FOLDER/FAUST_r`` reads them as it reads
the published sets; the template's landmarks are put where those of the literature are.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import fast_simplification
import numpy as np

from benchmarks.accuracy.data import DATA
from benchmarks.accuracy.posed_animals import landmarks_of
from benchmarks.public.sets import SETS
from benchmarks.skeleton import Bone, Sizes, Turns, shares, skinned
from cagemap.files.meshes.formats import write_mesh
from cagemap.files.meshes.obj import read_obj
from cagemap.mesh import ControlMesh
from cagemap.spectral.zoomout import evenly_spaced_vertices
from cagemap.subdivision import level_triangles, refine
from cagemap.surface.triangles import triangle_areas

# Triangles of a written mesh, points that are known on all, and how fast the simplification may give up quality.
TRIANGLES, CAUTION = 10_000, 3
# Of sqrt(area), on what is simplified only: makes triangles of one size everywhere, as the published sets have them.
NOISE = 0.004
KNOWN = {"faust_r": 5000, "smal_r": 3889}
SIDES = (("left", 1.0), ("right", -1.0))

HUMAN, HUMAN_LEVEL = "female1605", 2
IDENTITIES = ("male_young", "female_old_heavy")
HUMAN_LANDMARKS = (
    "nose_tip", "middle_fingertip_left", "middle_fingertip_right", "big_toe_tip_left", "big_toe_tip_right",
    "navel", "back_of_head",
)  # fmt: skip
# Poses that are files of their own, and those that the skeleton makes.
FILED = ("", "sit", "stride", "crouch")
HUMAN_POSES: dict[str, Turns] = {
    "arms up": {
        "upper_arm_left": (0, 0, 95), "upper_arm_right": (0, 0, -110), "forearm_left": (-20, 0, 0),
    },
    "hello": {
        "upper_arm_right": (-20, 0, -75), "forearm_right": (-70, 0, 0), "forearm_left": (-60, 0, 0),
        "head": (0, 30, 0),
    },
    "kick": {
        "thigh_left": (-80, 0, 0), "shin_left": (25, 0, 0), "upper_arm_left": (0, 0, 40), "spine": (-10, 0, 0),
        "upper_arm_right": (0, 0, -40),
    },
    "twist": {
        "spine": (0, 40, 0), "head": (0, 30, 0), "upper_arm_left": (0, -60, 0), "upper_arm_right": (0, 50, 0),
        "forearm_right": (-50, 0, 0),
    },
    "bend": {
        "spine": (60, 0, 0), "head": (-30, 0, 0), "upper_arm_left": (-50, 0, 0), "upper_arm_right": (-70, 0, 10),
        "thigh_left": (10, 0, 0), "thigh_right": (10, 0, 0),
    },
    "lunge": {
        "thigh_left": (-70, 0, 0), "shin_left": (80, 0, 0), "thigh_right": (30, 0, 0), "shin_right": (25, 0, 0),
        "upper_arm_left": (0, 0, 70), "upper_arm_right": (0, 0, -30), "forearm_right": (-80, 0, 0),
        "head": (0, -40, 0),
    },
}  # fmt: skip

ANIMAL, ANIMAL_LEVEL = "zebra", 3
ANIMAL_LANDMARKS = (
    "nose_tip", "tail_tip", "fore_foot_left", "fore_foot_right", "hind_foot_left", "hind_foot_right",
)  # fmt: skip
# Other animals are known at their named landmarks only.
OTHERS, OTHER_POSES = ("zebra", "horse", "cow", "wolf", "red_fox"), ("", "walk", "look back", "leap")
LEGS = ("fore_left", "fore_right", "hind_left", "hind_right")


def legs(upper: tuple[float, float], lower: tuple[float, float]) -> Sizes:
    return {f"upper_{leg}": upper for leg in LEGS} | {f"lower_{leg}": lower for leg in LEGS}


# Length and girth of every part, of the zebra's.
SPECIES: dict[str, Sizes] = {
    "horse": {},
    "hippo": {
        "trunk": (1.0, 1.35), "neck": (0.55, 1.6), "head": (1.15, 1.7), "tail": (0.5, 1.0),
        **legs((0.55, 1.6), (0.5, 1.9)),
    },
    "cougar": {
        "trunk": (1.05, 0.75), "neck": (0.5, 0.8), "head": (0.55, 0.85), "tail": (1.6, 0.7),
        **legs((0.8, 0.9), (0.7, 1.1)),
    },
}  # fmt: skip
ANIMAL_POSES: dict[str, Turns] = {
    "": {},
    "walk": {
        "upper_fore_left": (-35, 0, 0), "upper_fore_right": (30, 0, 0), "upper_hind_left": (30, 0, 0),
        "upper_hind_right": (-30, 0, 0), "lower_fore_right": (40, 0, 0), "lower_hind_right": (30, 0, 0),
        "neck": (20, 0, 0), "tail": (0, 40, 0),
    },
    "graze": {
        "neck": (60, 0, 0), "head": (10, 0, 0), "upper_fore_left": (-25, 0, 0), "upper_hind_right": (25, 0, 0),
        "tail": (-30, 0, 0),
    },
    "look back": {
        "neck": (-10, 50, 0), "head": (0, 30, 0), "upper_hind_left": (40, 0, 0), "tail": (-40, -30, 0),
        "lower_fore_right": (60, 0, 0), "upper_fore_right": (-40, 0, 0),
    },
    "leap": {
        "upper_fore_left": (-60, 0, 0), "upper_fore_right": (-50, 0, 0), "upper_hind_left": (45, 0, 0),
        "upper_hind_right": (55, 0, 0), "lower_fore_left": (30, 0, 0), "neck": (15, -15, 0), "tail": (-60, 0, 0),
    },
    "sit": {
        "trunk": (-35, 0, 0), "upper_fore_left": (35, 0, 0), "upper_fore_right": (35, 0, 0),
        "upper_hind_left": (-40, 0, 0), "upper_hind_right": (-40, 0, 0), "lower_hind_left": (60, 0, 0),
        "lower_hind_right": (60, 0, 0), "neck": (20, 0, 0), "tail": (30, 20, 0),
    },
}  # fmt: skip


def human_bones(at: dict[str, np.ndarray]) -> dict[str, Bone]:
    """Skeleton of a standing human, from named points; lengths of their file."""
    depth = 0.5 * (at["navel"][2] + at["buttock_left"][2])
    hips = np.array([0.0, at["buttock_left"][1], depth])
    neck = np.array([0.0, at["chin"][1] - 0.3, at["ear_left"][2]])
    waist = np.array([0.0, at["navel"][1], depth])
    bones = {
        "hips": Bone(hips, waist, "", 1.6),
        "spine": Bone(waist, neck, "hips", 1.6),
        "head": Bone(neck, at["crown"], "spine", 1.2),
    }
    for side, sign in SIDES:
        shoulder = at[f"shoulder_{side}"] + np.array([0.3 * sign, -0.5, 0])
        elbow, tip = at[f"elbow_{side}"], at[f"middle_fingertip_{side}"]
        knee, heel = at[f"knee_{side}"] - np.array([0, 0, 0.5]), at[f"heel_{side}"]
        ankle = np.array([heel[0], heel[1] + 0.7, heel[2] + 0.4])
        wrist = elbow + 0.55 * (tip - elbow)
        hip = np.array([0.75 * knee[0], hips[1], hips[2]])
        bones |= {
            f"upper_arm_{side}": Bone(shoulder, elbow, "spine", 0.7),
            f"forearm_{side}": Bone(elbow, wrist, f"upper_arm_{side}", 0.6),
            f"hand_{side}": Bone(wrist, tip, f"forearm_{side}", 0.6),
            f"thigh_{side}": Bone(hip - np.array([0, 0.9, 0]), knee, "hips", 1.0),
            f"shin_{side}": Bone(knee, ankle, f"thigh_{side}", 0.8),
            f"foot_{side}": Bone(ankle, at[f"big_toe_tip_{side}"], f"shin_{side}", 0.8),
        }
    return bones


def animal_bones(at: dict[str, np.ndarray]) -> dict[str, Bone]:
    """Skeleton of a standing quadruped, from named points; lengths of their file."""
    size = float(np.linalg.norm(at["withers"] - at["croup"]))
    inside = np.array([0, 0.25 * size, 0])
    bones = {
        "trunk": Bone(at["croup"] - inside, at["withers"] - inside, "", 0.30),
        "neck": Bone(at["withers"] - inside, at["poll"], "trunk", 0.18),
        "head": Bone(at["poll"], at["nose_tip"], "neck", 0.16),
        "tail": Bone(at["tail_base"], at["tail_tip"], "trunk", 0.08),
    }
    for leg in LEGS:
        where, side = leg.split("_")
        foot = at[f"{where}_foot_{side}"]
        if where == "fore":
            top = at[f"elbow_{side}"]
            joint = 0.5 * (top + foot)
        else:
            joint = at[f"hock_{side}"]
            top = np.array([joint[0], 0.45 * at["croup"][1] + 0.55 * joint[1], 0.5 * (at["croup"][2] + joint[2])])
        bones[f"upper_{leg}"] = Bone(top, joint, "trunk", 0.14)
        bones[f"lower_{leg}"] = Bone(joint, foot, f"upper_{leg}", 0.12)
    return bones


def humans() -> tuple[dict[str, np.ndarray], np.ndarray, list[int]]:
    """Refined positions of every shape by name, their triangles, and the landmarks' vertices."""
    listed = json.loads((DATA / "humans" / "landmarks" / f"base__{HUMAN}.json").read_text())["pairs"]
    named = {pair["name"]: pair["target"] for pair in listed}
    shapes: dict[str, np.ndarray] = {}
    triangles = np.zeros((0, 3), dtype=np.int64)
    for i, identity in enumerate(IDENTITIES):
        for j, pose in enumerate(FILED):
            path = DATA / "humans" / ("posed" if pose else "") / "_".join(p for p in (HUMAN, identity, pose) if p)
            control = read_obj(path.with_suffix(".obj"))
            refinement = refine(control, HUMAN_LEVEL)
            triangles = level_triangles(refinement, HUMAN_LEVEL)
            shapes[f"tr_reg_0{80 + 10 * i + j}"] = refinement.finest.positions
        standing = shapes[f"tr_reg_0{80 + 10 * i}"]
        bones = human_bones({name: standing[vertex] for name, vertex in named.items()})
        weights = shares(standing, triangles, bones, 0.03)
        for j, turns in enumerate(HUMAN_POSES.values(), start=len(FILED)):
            shapes[f"tr_reg_0{80 + 10 * i + j}"] = skinned(standing, weights, bones, turns)
    return shapes, triangles, [named[name] for name in HUMAN_LANDMARKS]


def species() -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Other animals in some of the poses: refined positions, triangles, and vertices of the points all of them have."""
    named = {animal: landmarks_of(animal) for animal in OTHERS}
    common = sorted(set.intersection(*(set(points) for points in named.values())))
    order = [*ANIMAL_LANDMARKS, *(name for name in common if name not in ANIMAL_LANDMARKS)]
    shapes = {}
    for animal, points in named.items():
        refinement = refine(read_obj(DATA / "animals" / f"{animal}.obj"), ANIMAL_LEVEL)
        triangles, standing = level_triangles(refinement, ANIMAL_LEVEL), refinement.finest.positions
        bones = animal_bones({name: standing[vertex] for name, vertex in points.items()})
        weights = shares(standing, triangles, bones, 0.04)
        vertices = np.array([points[name] for name in order])
        for i, pose in enumerate(OTHER_POSES):
            moved = skinned(standing, weights, bones, ANIMAL_POSES[pose])
            shapes[f"horse_{animal}_{i}"] = moved, triangles, vertices
    return shapes


def animals() -> tuple[dict[str, np.ndarray], np.ndarray, list[int]]:
    """The same of the quadrupeds."""
    named = landmarks_of(ANIMAL)
    refinement = refine(read_obj(DATA / "animals" / f"{ANIMAL}.obj"), ANIMAL_LEVEL)
    triangles, standing = level_triangles(refinement, ANIMAL_LEVEL), refinement.finest.positions
    bones = animal_bones({name: standing[vertex] for name, vertex in named.items()})
    weights = shares(standing, triangles, bones, 0.04)
    shapes = {
        f"{species}_{i}": skinned(standing, weights, bones, turns, sizes)
        for species, sizes in SPECIES.items()
        for i, turns in enumerate(ANIMAL_POSES.values())
    }
    return shapes, triangles, [named[name] for name in ANIMAL_LANDMARKS]


def write_set(
    name: str, root: Path, shapes: dict[str, np.ndarray], triangles: np.ndarray, landmarks: list[int]
) -> None:
    """Write a set in its published layout; the template's points are vertices of the refined cage."""
    (ids,) = SETS[name].landmarks.values()
    known = evenly_spaced_vertices(len(next(iter(shapes.values()))), KNOWN[name])[: KNOWN[name]]
    known[list(ids)] = landmarks
    for shape, positions in shapes.items():
        write_shape(root, shape, positions, triangles, known)


def write_shape(
    root: Path, shape: str, positions: np.ndarray, triangles: np.ndarray, known: np.ndarray, seed: int = 16
) -> None:
    """One mesh, and the template's points on it, which are vertices of what it was refined from."""
    for folder in ("shapes", "corres"):
        (root / folder).mkdir(parents=True, exist_ok=True)
    scale = np.sqrt(triangle_areas(positions, triangles).sum())
    unit = positions / scale
    rough = unit + NOISE * np.random.default_rng(seed).standard_normal(unit.shape)
    _, _, collapses = fast_simplification.simplify(
        rough.astype(np.float32),
        triangles.astype(np.int32),
        target_count=TRIANGLES,
        agg=CAUTION,
        return_collapses=True,
    )
    _, faces, cluster = fast_simplification.replay_simplification(
        unit.astype(np.float32), triangles.astype(np.int32), collapses
    )
    count = int(cluster.max()) + 1
    centres = np.column_stack([np.bincount(cluster, x, count) for x in unit.T]) / np.bincount(cluster)[:, None]
    order = np.lexsort((np.linalg.norm(unit - centres[cluster], axis=1), cluster))
    points = unit[order[np.searchsorted(cluster[order], np.arange(count))]]  # of every cluster the most central vertex
    write_mesh(root / "shapes" / f"{shape}.off", ControlMesh.from_faces(points, faces, name=shape))
    np.savetxt(root / "corres" / f"{shape}.vts", cluster[known] + 1, fmt="%d")


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.public.lookalikes", description=__doc__)
    parser.add_argument("folder", type=Path)
    arguments = parser.parse_args()
    if not DATA.is_dir():
        parser.error("the meshes are not beside this checkout (../shared/data)")
    write_set("faust_r", arguments.folder / "FAUST_r", *humans())
    write_set("smal_r", arguments.folder / "SMAL_r", *animals())
    (ids,) = SETS["smal_r"].landmarks.values()
    for shape, (positions, triangles, vertices) in species().items():
        known = vertices[np.arange(KNOWN["smal_r"]) % len(vertices)]
        known[list(ids)] = vertices[: len(ids)]
        write_shape(arguments.folder / "species_r", shape, positions, triangles, known)


if __name__ == "__main__":
    main()
