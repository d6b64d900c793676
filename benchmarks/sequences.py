"""``python -m benchmarks.sequences MOTION KIND``: a cage through the frames of a motion, from frame to frame or afresh.

Every frame is a plain mesh of 10 000 triangles with its own connectivity and vertex order, made from the refined body
that the animation poses; where each vertex of the target's surface belongs on it is known.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import dataclass

import fast_simplification
import numpy as np
from scipy.spatial import cKDTree

from benchmarks.accuracy.data import DATA
from benchmarks.truth import Truth, true_map
from cagemap.character.poses import pose_at
from cagemap.character.values import skin_positions
from cagemap.files.gltf.character import read_character
from cagemap.files.meshes.obj import read_obj
from cagemap.mesh import ControlMesh
from cagemap.mesh.landmarks import Landmarks
from cagemap.mesh.plain import plain_mesh
from cagemap.pipeline import MatchResult, match, match_next, prepare_surface
from cagemap.spectral import Surface
from cagemap.subdivision import level_triangles, refine
from cagemap.surface.triangle_surface import SurfacePoints, TriangleSurface
from cagemap.surface.triangles import triangle_areas

CHARACTERS = DATA / "characters"
# Target cage and identity, source cage and identity, the character's file, and the times of the frames in seconds
HUMAN_MOTIONS = {
    "sit": ("female1605", "female_old_heavy", "male1591", "male_young", "character_A.glb", np.linspace(0, 2, 13)),
    "crouch": (
        "male1591", "male_young", "female1605", "female_old_heavy", "truth/character_B.glb", np.linspace(4, 2, 13)
    ),
}  # fmt: skip
HUMAN_LEVELS, FOX_LEVELS = (1, 2), (2, 3)  # of target, and of source before it is simplified
TRIANGLES, CAUTION, NOISE = 10_000, 3, 0.004  # as in benchmarks.public.lookalikes


@dataclass(frozen=True)
class Motion:
    """A target, and frames of a source that moves."""

    target: Surface
    triangles: np.ndarray  # of the source before it is simplified
    truth: Truth  # images of the target's vertices on these
    shapes: list[np.ndarray]  # its positions in every frame
    landmarks: tuple[np.ndarray, np.ndarray]  # vertices of the target's cage, and of the source before

    def true_places(self, frame: int) -> np.ndarray:
        posed = TriangleSurface.from_faces(self.shapes[frame], self.triangles)
        return self.truth.on(posed).positions / posed.scale

    def frame(self, number: int) -> tuple[Surface, Landmarks]:
        """A frame's surface and landmarks, with a connectivity and an order of its own."""
        places, faces = other_connectivity(self.shapes[number], self.triangles, number)
        plain = plain_mesh(ControlMesh.from_faces(places, faces, name=f"frame_{number:02d}"))
        surface = prepare_surface(plain.mesh, 0)
        at = self.shapes[number][self.landmarks[1]]
        on_source = np.linalg.norm(plain.mesh.positions[None] - at[:, None], axis=2).argmin(axis=1)
        names = tuple(f"point {i}" for i in range(len(at)))
        return surface, Landmarks(names, self.landmarks[0], on_source)


def other_connectivity(positions: np.ndarray, triangles: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """The surface with about 10 000 triangles and shuffled vertices."""
    random = np.random.default_rng(seed)
    scale = np.sqrt(triangle_areas(positions, triangles).sum())
    rough = positions / scale + NOISE * random.standard_normal(positions.shape)
    as_int = triangles.astype(np.int32)
    count = min(TRIANGLES, len(triangles))
    _, _, collapses = fast_simplification.simplify(
        rough.astype(np.float32), as_int, target_count=count, agg=CAUTION, return_collapses=True
    )
    _, faces, cluster = fast_simplification.replay_simplification(positions.astype(np.float32), as_int, collapses)
    count = int(cluster.max()) + 1
    centres = np.column_stack([np.bincount(cluster, x, count) for x in positions.T]) / np.bincount(cluster)[:, None]
    order = np.lexsort((np.linalg.norm(positions - centres[cluster], axis=1), cluster))
    points = positions[order[np.searchsorted(cluster[order], np.arange(count))]]
    shuffled = random.permutation(count)
    moved = np.empty_like(points)
    moved[shuffled] = points
    return moved, shuffled[faces]


def human_motion(name: str) -> Motion:
    target_cage, target_identity, source_cage, identity, character_file, times = HUMAN_MOTIONS[name]
    character = read_character(CHARACTERS / "rigs" / character_file)
    humans = DATA / "humans"

    def cage(connectivity: str, identity: str) -> ControlMesh:
        return read_obj(humans / f"{connectivity}_{identity}.obj")

    # Skinning weights of the source's cage, from the body's by the ground truth between the neutral meshes.
    body = character.parts[0]
    rest = 0.1 * cage("base", identity).positions
    of_obj = cKDTree(body.mesh.positions).query(rest)[1]
    truth = np.load(humans / "ground_truth" / f"base__{source_cage}.npz")
    corners, barycentric = truth["b_to_a_verts"], truth["b_to_a_bary"]
    weights = body.weights.toarray()[of_obj]
    weights = np.einsum("nk,nkj->nj", barycentric, weights[corners])
    control = cage(source_cage, identity)
    refinement = refine(control, HUMAN_LEVELS[1])
    triangles = level_triangles(refinement, HUMAN_LEVELS[1])
    shapes = []
    for time_ in times:
        transforms = pose_at(character.rig, character.animations[0], float(time_))
        posed = 10 * skin_positions(0.1 * control.positions, weights, character.rig, transforms)
        shapes.append(refinement.prolong(posed, 0, HUMAN_LEVELS[1]))
    target = prepare_surface(cage(target_cage, target_identity), HUMAN_LEVELS[0])
    neutral = []
    for refined, connectivity, level in (
        (target.refinement, target_cage, HUMAN_LEVELS[0]), (refinement, source_cage, HUMAN_LEVELS[1]),
    ):  # fmt: skip
        places = refined.prolong(cage(connectivity, "neutral").positions, 0, level)
        neutral.append(TriangleSurface.from_faces(places, level_triangles(refined, level)))
    cages = sorted((target_cage, source_cage))
    listed = json.loads((humans / "landmarks" / f"{cages[0]}__{cages[1]}.json").read_text())
    sides = ("source", "target") if listed["source"].startswith(target_cage) else ("target", "source")
    wanted = ("nose_tip", "middle_fingertip_left", "middle_fingertip_right", "big_toe_tip_left", "big_toe_tip_right",
              "navel", "back_of_head")  # fmt: skip
    pairs = {pair["name"]: pair for pair in listed["pairs"]}
    landmarks = tuple(np.array([pairs[one][side] for one in wanted]) for side in sides)
    return Motion(target, triangles, true_map(*neutral), shapes, landmarks)


def fox_motion() -> Motion:
    """The fox of rigs/foreign: from rest (frame 0) into its run; the target is the fox at rest."""
    fox = read_character(CHARACTERS / "foreign" / "Fox.glb")
    part = fox.parts[0]
    control = ControlMesh.from_faces(part.mesh.positions, part.mesh.face_indices.reshape(-1, 3), name="fox")
    refinement = refine(control, FOX_LEVELS[1])
    triangles = level_triangles(refinement, FOX_LEVELS[1])
    places = [part.mesh.positions]
    run = fox.animations[2]
    for time_ in np.linspace(0, 1.158, 14):
        places.append(skin_positions(part.mesh.positions, part.weights, fox.rig, pose_at(fox.rig, run, float(time_))))
    shapes = [refinement.prolong(place, 0, FOX_LEVELS[1]) for place in places]
    target = prepare_surface(control, FOX_LEVELS[0])
    neutral = TriangleSurface.from_faces(target.finest_triangles.positions, target.finest_triangles.triangles)
    full = TriangleSurface.from_faces(shapes[0], triangles)
    count = neutral.n
    images = SurfacePoints.from_vertices(full, np.arange(count))
    tips = np.array([
        control.positions[:, 2].argmax(), control.positions[:, 2].argmin(), control.positions[:, 1].argmax(),
        *(np.where(sign * control.positions[:, 0] > 0, control.positions @ np.array([0, -1, along]), -1e9).argmax()
          for sign in (1, -1) for along in (0.5, -0.5)),
    ])  # fmt: skip
    return Motion(target, triangles, Truth(images, np.ones(count, dtype=bool)), shapes, (tips, tips))


def run(motion: Motion, order: list[int], kind: str, held: bool) -> list[dict]:
    """Rows of frames in an order, each matched afresh, or from the map to the last one, with or without landmarks."""
    rows: list[dict] = []
    result: MatchResult | None = None
    for number in order:
        start = time.process_time()
        source, landmarks = motion.frame(number)
        prepared = time.process_time()
        given = landmarks if held or (result is None and kind == "next") else None
        if kind == "fresh" or result is None:
            result = match(motion.target, source, given)
        else:
            result = match_next(result, source, given)
        seconds = time.process_time() - prepared
        errors = np.linalg.norm(result.image() - motion.true_places(number), axis=1)[motion.truth.known] * source.scale
        rows.append({
            "frame": number, "mean": 100 * errors.mean(), "p95": 100 * np.percentile(errors, 95), "seconds": seconds,
            "preparing": prepared - start, "images": result.image() * source.scale,
            "true": motion.true_places(number) * source.scale,
        })  # fmt: skip
        print(f"{kind} {number} {rows[-1]['mean']:.2f} p95 {rows[-1]['p95']:.1f} processor s {seconds:.1f}", flush=True)
    return rows


def summary(motion: Motion, rows: list[dict]) -> str:
    """Error and its growth, second differences of the error over time, the round trip's drift, processor seconds."""
    means = np.array([row["mean"] for row in rows])
    images, true = (np.array([row[key] for row in rows])[:, motion.truth.known] for key in ("images", "true"))
    jitter, of_truth = (
        100 * np.linalg.norm(np.diff(places, 2, axis=0), axis=2).mean() for places in (images - true, true)
    )
    line = (
        f"mean {means.mean():.2f}, first {means[0]:.2f}, last {means[-1]:.2f}, worst {means.max():.2f}, jitter "
        f"{jitter:.2f} (the motion's {of_truth:.2f}), processor s {np.mean([row['seconds'] for row in rows[1:]]):.1f} "
        f"and {np.mean([row['preparing'] for row in rows[1:]]):.1f} to prepare"
    )
    if len(rows) > 1 and rows[0]["frame"] == rows[-1]["frame"]:
        line += f", round trip {100 * np.linalg.norm(images[0] - images[-1], axis=1).mean():.2f}"
    return line


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.sequences", description=__doc__)
    parser.add_argument("motion", choices=(*HUMAN_MOTIONS, "fox"))
    parser.add_argument("kinds", nargs="+", help="next/0, fresh/0 or fresh/7: from the last frame or afresh, landmarks")
    parser.add_argument("--frames", type=int, nargs="*", help="Only these.")
    parser.add_argument("--return", dest="back", action="store_true", help="Return to the first frame.")
    arguments = parser.parse_args()
    if not DATA.is_dir():
        parser.error("the meshes are not beside this checkout (../shared/data)")
    motion = fox_motion() if arguments.motion == "fox" else human_motion(arguments.motion)
    order = arguments.frames or list(range(len(motion.shapes)))
    if arguments.back:
        order += order[-2::-1]
    for given in arguments.kinds:
        kind, count = given.split("/")
        print(f"{arguments.motion} {given}: {summary(motion, run(motion, order, kind, count != '0'))}", flush=True)


if __name__ == "__main__":
    main()
