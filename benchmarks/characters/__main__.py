"""``python -m benchmarks.characters``: character A's rig, weights and animation on body B, against the truth.

Lengths are x100 of sqrt(area of B). The body keeps its own vertices, so in the bind pose only the map can be off; in a
pose, joints and weights are. Each row is printed as it comes.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from benchmarks.accuracy.data import DATA
from benchmarks.accuracy.posed import landmarks_of
from cagemap.character.poses import parent_transforms, pose_at
from cagemap.character.retarget import retarget
from cagemap.character.skeleton import carry_rig
from cagemap.character.values import Animation, Character, Part, Rig, skinned_positions
from cagemap.files.gltf.character import read_character
from cagemap.files.meshes.obj import read_obj
from cagemap.maps.result import MatchResult
from cagemap.mesh import ControlMesh
from cagemap.mesh.landmarks import Landmarks
from cagemap.mesh.schemes import Plain
from cagemap.pipeline import match, prepare_surface
from cagemap.tasks.carry_arrays import carry_weights

RIGS = DATA / "characters" / "rigs"
KEYS = {"sit": 1.0, "stride": 2.0, "crouch": 3.0}
METRES = 0.1  # of the OBJ files' decimetres
TARGETS = {"base": "target_B_body.glb", "soma18056": "target_B_soma18056.glb"}


@dataclass(frozen=True, eq=False)
class Body:
    """A body of a GLB file, and the vertex of the OBJ file that each of its vertices is."""

    part: Part
    rows: np.ndarray

    @property
    def plain(self) -> ControlMesh:
        return replace(self.part.mesh, scheme=Plain())


@cache
def character(name: str) -> Character:
    """A character of the collection."""
    return read_character(RIGS / name)


@cache
def body(name: str, model: str) -> Body:
    """The body in a file, whose shape is that of an OBJ file."""
    part = character(name).parts[0]
    places = read_obj(DATA / "humans" / f"{model}.obj").positions
    away, rows = cKDTree(METRES * places).query(part.mesh.positions)
    assert away.max() < 1e-5, (name, model, away.max())
    return Body(part, rows)


def truth_weights() -> np.ndarray:
    """(13380, 163) all influences of `base`, columns as the joints of A's rig."""
    with np.load(RIGS / "weights_body.npz", allow_pickle=True) as file:
        table = sparse.csr_array((file["data"], file["indices"], file["indptr"]), shape=tuple(file["shape"])).toarray()
        bones = [str(bone) for bone in file["bones"]]
    names = character("character_A.glb").rig.names
    result = np.zeros((len(table), len(names)))
    result[:, [names.index(bone) for bone in bones]] = table
    return result / result.sum(axis=1, keepdims=True)


def on_target(cage: str, values: np.ndarray) -> np.ndarray:
    """Values at the OBJ vertices of `base`, at those of another cage."""
    if cage == "base":
        return values
    with np.load(DATA / "humans" / "ground_truth" / f"base__{cage}.npz") as truth:
        return np.einsum("nk,nkd->nd", truth["b_to_a_bary"], values[truth["b_to_a_verts"]])


def matched(cage: str, count: int) -> MatchResult:
    """B's body matched with A's, both as plain triangles."""
    target, source = body(TARGETS[cage], f"{cage}_female_old_heavy"), body("character_A.glb", "base_male_young")
    landmarks = None
    if count:
        other = cage if cage != "base" else "soma18056"
        known = landmarks_of(other, "base", count)
        of_cage = known.source if cage == "base" else known.target
        landmarks = Landmarks(
            known.names, _numbers(target, of_cage), _numbers(source, known.source), target.part.mesh.name,
            source.part.mesh.name,
        )  # fmt: skip
    return match(prepare_surface(target.plain, 0), prepare_surface(source.plain, 0), landmarks)


def _numbers(of: Body, rows: np.ndarray) -> np.ndarray:
    order = np.argsort(of.rows, kind="stable")
    return order[np.searchsorted(of.rows[order], rows)]


def pose_errors(part: Part, rig: Rig, animation: Animation, truth: dict[str, np.ndarray]) -> list[float]:
    """Mean distances from the true poses."""
    return [
        float(np.linalg.norm(skinned_positions(part, rig, pose_at(rig, animation, time)) - truth[key], axis=1).mean())
        for key, time in KEYS.items()
    ]


def measure(cage: str, count: int) -> None:
    """One target, with or without landmarks."""
    given, known = character("character_A.glb"), character("truth/character_B.glb")
    source, target = body("character_A.glb", "base_male_young"), body(TARGETS[cage], f"{cage}_female_old_heavy")
    true_body = body("truth/character_B.glb", "base_female_old_heavy")
    found = matched(cage, count)
    unit = 100 * found.point_map.target.scale
    poses = {}
    for key, time in KEYS.items():
        places = skinned_positions(true_body.part, known.rig, pose_at(known.rig, known.animations[0], time))
        poses[key] = on_target(cage, places[_numbers(true_body, np.arange(len(places)))])[target.rows]
    images = found.point_map.images.positions / found.point_map.source.scale
    at_source = source.part.mesh.positions[_numbers(source, np.arange(len(source.rows)))]
    bind = unit * np.linalg.norm(images - on_target(cage, at_source)[target.rows], axis=1).mean()
    rig = carry_rig(found.point_map, given.rig)
    apart = unit * np.linalg.norm(rig.heads - known.rig.heads, axis=1)
    true_weights = on_target(cage, truth_weights())[target.rows]
    skin = carry_weights(found, source.part.weights.toarray())
    full = carry_weights(found, truth_weights()[source.rows], influences=None)
    off = [0.5 * np.abs(one - true_weights).sum(axis=1).mean() for one in (skin, full)]
    worst = ", ".join(f"{rig.names[joint]} {apart[joint]:.1f}" for joint in np.argsort(-apart)[:4])
    print(
        f"| {cage} | {count} | {bind:.2f} | {apart.mean():.2f} | {np.mean(apart > 1.5):.2f} | {apart.max():.1f} "
        f"({worst}) | {off[0]:.3f} | {off[1]:.3f} |",
        flush=True,
    )
    carried = replace(target.part, weights=sparse.csr_array(skin))
    cut = true_body.part.weights[_numbers(true_body, np.arange(len(true_body.rows)))].toarray()
    true = replace(target.part, weights=sparse.csr_array(on_target(cage, cut)[target.rows]))
    spine = [joint for joint, name in enumerate(rig.names) if name.startswith("spine")]
    straight = rig.bind.copy()
    straight[spine, 3, :3] = known.rig.heads[spine]
    straight_rig = replace(rig, bind=straight, local=parent_transforms(straight, rig.parents))
    for title, part, of in (
        ("all carried", carried, rig),
        ("true joints", carried, known.rig),
        ("true weights", true, rig),
        ("true spine joints", carried, straight_rig),
    ):
        errors = unit * np.array(pose_errors(part, of, retarget(given.animations[0], given.rig, of), poses))
        print(f"|   {title} | " + " | ".join(f"{key} {error:.2f}" for key, error in zip(KEYS, errors, strict=True))
              + f" | {errors.mean() / bind:.2f} of the bind pose |", flush=True)  # fmt: skip


def main() -> None:
    """Measure the targets asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--target", choices=TARGETS, action="append", help="default: both")
    parser.add_argument("--landmarks", type=int, choices=(0, 14), action="append", help="default: 14, then none")
    asked = parser.parse_args()
    print("| target | landmarks | bind pose | joints, mean | share beyond 1.5 | worst | weights, 4 | weights, all |")
    for cage in asked.target or TARGETS:
        for count in asked.landmarks or (14, 0):
            measure(cage, count)


if __name__ == "__main__":
    main()
