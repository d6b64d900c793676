"""``python -m benchmarks.accuracy.posed_animals``: animals posed by a simple skeleton, against themselves and others.

The skeleton stands on the landmarks: legs turn at elbow and hock, the neck at the withers, the head at the poll, the
tail at its base. Vertex i of a posed animal is vertex i of the animal, so that between two poses of one animal the true
map is known everywhere; between species every other landmark is given and the others are judged.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from scipy import sparse
from scipy.spatial.transform import Rotation

from benchmarks.accuracy.data import DATA, REPOSITORY
from benchmarks.skeleton import distances
from cagemap.files.meshes.obj import read_obj
from cagemap.mesh import ControlMesh
from cagemap.mesh.faces import cage_triangles
from cagemap.mesh.landmarks import Landmarks
from cagemap.pipeline import choose_level, match, prepare_surface
from cagemap.spectral import Surface

ANIMALS = ("zebra", "horse", "cow", "wolf", "red_fox")
# Bones: from the landmark that they turn about to their end; the first, the trunk, never turns.
BONES = {
    "trunk": ("withers", "croup"),
    "neck": ("withers", "poll"),
    "head": ("poll", "nose_tip"),
    "tail": ("tail_base", "tail_tip"),
    **{f"{leg}_{side}": (f"{joint}_{side}", f"{leg}_foot_{side}") for side in ("left", "right")
       for leg, joint in (("fore", "elbow"), ("hind", "hock"))},
}  # fmt: skip
PARENTS = {"head": "neck"}
# Degrees about x (forwards and backwards) and y (sideways), by bone.
POSES: dict[str, dict[str, tuple[float, float]]] = {
    "": {},
    "walk": {
        "fore_left": (-35, 0), "fore_right": (35, 0), "hind_left": (30, 0), "hind_right": (-30, 0),
        "neck": (20, 0), "tail": (0, 40),
    },
    "graze": {"neck": (50, 0), "head": (20, 0), "fore_left": (-20, 0), "hind_right": (25, 0), "tail": (-30, 0)},
    "look back": {"neck": (-15, 45), "head": (0, 25), "hind_left": (40, 0), "tail": (-40, -30)},
}  # fmt: skip
# Averages over neighbours that make one bone's share of a vertex fade into the next one's.
SMOOTHING = 3


def landmarks_of(animal: str) -> dict[str, int]:
    """Named control vertices of an animal, from all files that have it; feet, hooves and paws are feet."""
    found: dict[str, int] = {}
    for path in sorted((DATA / "animals" / "landmarks").glob(f"*{animal}*.json")):
        entry = json.loads(path.read_text())
        for side in ("source", "target"):
            if entry[side] == f"{animal}.obj":
                for pair in entry["pairs"]:
                    found.setdefault(pair["name"].replace("hoof", "foot").replace("paw", "foot"), pair[side])
    return found


def shares(positions: np.ndarray, triangles: np.ndarray, segments: np.ndarray) -> np.ndarray:
    """(n, b) share of every bone (b, 2, 3) at every vertex: all the nearest's, then averaged over neighbours."""
    weights = np.eye(len(segments))[distances(positions, segments).argmin(axis=1)]
    n = len(positions)
    ends = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    joined = sparse.coo_array((np.ones(2 * len(ends)), (ends.ravel(), ends[:, ::-1].ravel())), shape=(n, n)).tocsr()
    joined = sparse.csr_array((joined > 0).astype(float) + sparse.eye_array(n))
    mean = sparse.diags_array(1 / np.asarray(joined.sum(axis=1)).ravel()) @ joined
    for _ in range(SMOOTHING):
        weights = mean @ weights
    return weights


def posed(animal: str, pose: str) -> ControlMesh:
    """An animal's control mesh in a pose, by linear blend skinning."""
    control, named = read_obj(DATA / "animals" / f"{animal}.obj"), landmarks_of(animal)
    positions = control.positions
    segments = np.array([[positions[named[end]] for end in ends] for ends in BONES.values()])
    weights = shares(positions, cage_triangles(control)[0], segments)
    turns, moved = {}, np.zeros_like(positions)
    for bone, (share, segment) in zip(BONES, zip(weights.T, segments, strict=True), strict=True):
        about_x, about_y = POSES[pose].get(bone, (0, 0))
        turn = Rotation.from_euler("yx", [about_y, about_x], degrees=True).as_matrix()
        shift = segment[0] - turn @ segment[0]
        if bone in PARENTS:
            parent, parent_shift = turns[PARENTS[bone]]
            turn, shift = parent @ turn, parent @ shift + parent_shift
        turns[bone] = turn, shift
        moved += share[:, None] * (positions @ turn.T + shift)
    return control.with_positions(moved)


class Animals:
    """Prepared surfaces, each made once."""

    def __init__(self, vertices: int) -> None:
        self.vertices = vertices
        self.surfaces: dict[tuple[str, str], Surface] = {}

    def surface(self, animal: str, pose: str) -> Surface:
        if (animal, pose) not in self.surfaces:
            control = posed(animal, pose)
            self.surfaces[animal, pose] = prepare_surface(control, choose_level(control, self.vertices))
        return self.surfaces[animal, pose]


def pairs() -> list[tuple[tuple[str, str], tuple[str, str]]]:
    """Target and source: every pose of an animal on the next one, and every animal posed on the next as it stands."""
    names = list(POSES)
    own = [((a, names[i]), (a, names[(i + 1) % len(names)])) for a in ANIMALS for i in range(len(names))]
    others = [((a, pose), (ANIMALS[(i + 1) % len(ANIMALS)], "")) for i, a in enumerate(ANIMALS) for pose in names]
    return own + others


def row(animals: Animals, target: tuple[str, str], source: tuple[str, str]) -> dict:
    """Figures of one match with every other landmark that both animals have."""
    named = landmarks_of(target[0]), landmarks_of(source[0])
    shared = sorted(named[0].keys() & named[1].keys())
    at, to = (np.array([side[name] for name in shared]) for side in named)
    given = Landmarks(tuple(shared[::2]), at[::2], to[::2])
    found = match(animals.surface(*target), animals.surface(*source), given)
    images, places = found.point_map.images.positions, found.point_map.source.positions
    if target[0] == source[0]:
        errors = np.linalg.norm(images - places, axis=1)
    else:
        errors = np.linalg.norm(images[at[1::2]] - places[to[1::2]], axis=1)
    return {
        "target": list(target), "source": list(source), "landmarks": len(given), "vertices": animals.vertices,
        "judged": "all vertices" if target[0] == source[0] else f"{len(errors)} other landmarks",
        "mean": 100 * float(errors.mean()), "p95": 100 * float(np.percentile(errors, 95)),
        "flipped": 100 * found.quality.flipped_area, "left_out": [suspect.name for suspect in found.suspects],
    }  # fmt: skip


def markdown(rows: list[dict]) -> str:
    """One table, and means of both kinds."""
    lines = [
        "| target | source | landmarks | judged | mean | p95 | flipped % | left out |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for one in rows:
        lines.append(
            f"| {' '.join(one['target'])} | {' '.join(one['source'])} | {one['landmarks']} | {one['judged']} "
            f"| {one['mean']:.2f} | {one['p95']:.1f} | {one['flipped']:.2f} | {', '.join(one['left_out'])} |"
        )
    for kind, name in ((True, "poses of one animal"), (False, "another animal")):
        means = [one["mean"] for one in rows if (one["target"][0] == one["source"][0]) == kind]
        if means:
            lines += ["", f"{len(means)} pairs, {name}: mean {np.mean(means):.2f}, worst {max(means):.2f}."]
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.accuracy.posed_animals", description=__doc__)
    parser.add_argument("--vertices", type=int, default=4000)
    parser.add_argument("--output", type=Path, default=REPOSITORY / "benchmarks" / "results")
    arguments = parser.parse_args()
    if not DATA.is_dir():
        parser.error("the meshes are not beside this checkout (../shared/data)")
    place = arguments.output / "posed_animals.json"
    rows = json.loads(place.read_text()) if place.is_file() else []
    animals = Animals(arguments.vertices)
    for target, source in pairs():
        key = [list(target), list(source), arguments.vertices]
        if any([one["target"], one["source"], one["vertices"]] == key for one in rows):
            continue
        rows.append(row(animals, target, source))
        print(rows[-1], flush=True)
        place.write_text(json.dumps(rows, indent=1) + "\n")
        (arguments.output / "posed_animals.md").write_text(markdown(rows))
    print(markdown(rows))


if __name__ == "__main__":
    main()
