"""``python -m benchmarks.accuracy.posed``: posed bodies against standing and otherwise posed ones; the truth is known.

Vertex i of a posed mesh is vertex i of the neutral one, so the true map is the one between the neutral meshes. Every
pair stands beside the same two bodies unposed. Rows are written as they come; what is there is not measured again.
"""

from __future__ import annotations

import argparse
import json
import random
from pathlib import Path

import numpy as np

from benchmarks.accuracy.data import DATA, REPOSITORY
from benchmarks.truth import Truth, compare_with_truth, true_map
from cagemap.files.landmarks.pairs import read_landmarks
from cagemap.files.meshes.obj import read_obj
from cagemap.maps.geodesic import JUDGED_VERTICES, geodesic_error
from cagemap.mesh.landmarks import Landmarks
from cagemap.pipeline import choose_level, match, prepare_surface
from cagemap.spectral import Surface
from cagemap.subdivision import level_triangles
from cagemap.surface.triangle_surface import TriangleSurface

CAGES = (("female1605", "male1591"), ("base", "proxy741"))
IDENTITIES = ("male_young", "female_old_heavy")
POSES = ("", "sit", "stride", "crouch")

Body = tuple[str, str, str]


def pairs(count: int) -> list[tuple[Body, Body]]:
    """Target and source; the same choice every time, half of them posed -> standing, half posed -> otherwise posed."""
    standing, posed = [], []
    for cages in CAGES:
        for first, second in (cages, cages[::-1]):
            for t, s in ((t, s) for t in POSES for s in POSES if t != s):
                for one, other in (IDENTITIES, IDENTITIES[::-1]):
                    (posed if t and s else standing).append(((first, one, t), (second, other, s)))
    choose = random.Random(16)
    half = count // 2
    return choose.sample(standing, min(half, len(standing))) + choose.sample(posed, min(count - half, len(posed)))


class Bodies:
    """Prepared surfaces and true maps, each made once."""

    def __init__(self, vertices: int) -> None:
        self.vertices = vertices
        self.surfaces: dict[Body, Surface] = {}
        self.truths: dict[tuple[str, str], Truth] = {}

    def surface(self, body: Body) -> Surface:
        if body not in self.surfaces:
            name = "_".join(part for part in body if part)
            control = read_obj(DATA / "humans" / ("posed" if body[2] else "") / f"{name}.obj")
            self.surfaces[body] = prepare_surface(control, choose_level(control, self.vertices))
        return self.surfaces[body]

    def truth(self, target: Body, source: Body) -> Truth:
        key = target[0], source[0]
        if key not in self.truths:
            neutral = []
            for body in (target, source):
                refinement = self.surface(body).refinement
                control = read_obj(DATA / "humans" / f"{body[0]}_neutral.obj").positions
                top = refinement.finest_level
                places = refinement.prolong(control, 0, top)
                neutral.append(TriangleSurface.from_faces(places, level_triangles(refinement, top)))
            self.truths[key] = true_map(*neutral)
        return self.truths[key]


def landmarks_of(target: str, source: str, count: int) -> Landmarks | None:
    if not count:
        return None
    folder = DATA / "humans" / "landmarks"
    forward = folder / f"{source}__{target}_fps{count}.json"
    if forward.is_file():
        return read_landmarks(forward, f"{target}_neutral.obj", f"{source}_neutral.obj")[0]
    back = folder / f"{target}__{source}_fps{count}.json"
    return read_landmarks(back, f"{source}_neutral.obj", f"{target}_neutral.obj")[0].reversed()


def row(bodies: Bodies, target: Body, source: Body, count: int) -> dict:
    """Figures of one match."""
    found = match(bodies.surface(target), bodies.surface(source), landmarks_of(target[0], source[0], count))
    truth = bodies.truth(target, source)
    figures = compare_with_truth(found.point_map, truth)
    known = np.flatnonzero(truth.known)
    judged = known[np.unique(np.linspace(0, len(known) - 1, min(JUDGED_VERTICES, len(known))).astype(int))]
    return {
        "target": list(target), "source": list(source), "landmarks": count, "vertices": bodies.vertices,
        "mean": 100 * figures.mean, "p95": 100 * figures.p95, "flipped": 100 * figures.flipped_area,
        "geodesic": 100 * float(geodesic_error(found.point_map, truth.images, judged).mean()),
        "left_out": [suspect.name for suspect in found.suspects],
        "notes": list(found.landmark_check.notes),
        "verdict": None if found.confidence is None else found.confidence.verdict,
        "signs": {} if found.confidence is None else dict(found.confidence.signs),
    }  # fmt: skip


def markdown(rows: list[dict]) -> str:
    """One table, and what the bars ask."""
    lines = [
        "| target | source | landmarks | vertices | mean | p95 | geodesic mean | of unposed | flipped % | left out "
        "| verdict |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    ratios = []
    for one in rows:
        ratio = ""
        if one["target"][2] or one["source"][2]:
            still = [
                other["mean"] for other in rows
                if not other["target"][2] and not other["source"][2] and other["landmarks"] == one["landmarks"]
                and other["target"][:2] == one["target"][:2] and other["source"][:2] == one["source"][:2]
            ]  # fmt: skip
            if still:
                ratios.append(one["mean"] / still[0])
                ratio = f"{ratios[-1]:.2f}"
        lines.append(
            f"| {' '.join(one['target'])} | {' '.join(one['source'])} | {one['landmarks']} | {one['vertices']} "
            f"| {one['mean']:.2f} | {one['p95']:.1f} | {one['geodesic']:.2f} | {ratio} | {one['flipped']:.2f} "
            f"| {', '.join(one['left_out'])} | {one['verdict'] or ''} |"
        )
    if ratios:
        accused = sum(bool(one["left_out"]) for one in rows)
        lines += [
            "",
            f"{len(ratios)} posed pairs: {np.mean(ratios):.2f} times the unposed pair's mean, worst {max(ratios):.2f}; "
            f"{accused} with correct pairs left out.",
        ]
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.accuracy.posed", description=__doc__)
    parser.add_argument("--pairs", type=int, default=48)
    parser.add_argument("--vertices", type=int, default=5000)
    parser.add_argument("--landmarks", type=int, choices=[0, 14, 30], default=14)
    parser.add_argument("--output", type=Path, default=REPOSITORY / "benchmarks" / "results")
    arguments = parser.parse_args()
    if not DATA.is_dir():
        parser.error("the meshes are not beside this checkout (../shared/data)")
    arguments.output.mkdir(parents=True, exist_ok=True)
    place = arguments.output / "posed.json"
    rows = json.loads(place.read_text()) if place.is_file() else []
    bodies = Bodies(arguments.vertices)
    chosen = pairs(arguments.pairs)
    still = [((t[0], t[1], ""), (s[0], s[1], "")) for t, s in chosen]
    for target, source in [*dict.fromkeys(still), *chosen]:
        key = [list(target), list(source), arguments.landmarks, arguments.vertices]
        if any([one["target"], one["source"], one["landmarks"], one["vertices"]] == key for one in rows):
            continue
        rows.append(row(bodies, target, source, arguments.landmarks))
        print(rows[-1], flush=True)
        place.write_text(json.dumps(rows, indent=1) + "\n")
        (arguments.output / "posed.md").write_text(markdown(rows))
    print(markdown(rows))


if __name__ == "__main__":
    main()
