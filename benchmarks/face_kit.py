"""The package's face shapes: written from `characters/face` of the test data, and measured on heads.

`python -m benchmarks.face_kit write FOLDER` writes `src/cagemap/character/face/face.npz` from the folder
`characters/face`: the neutral head of ICT-FaceKit and the shapes that ARKit names, as rows and half-precision shifts.
Blinks are enlarged by `BLINK_SCALE`; lips and lids that go through each other are moved apart. Run it again only
when the shapes change.

`python -m benchmarks.face_kit measure HEAD...` matches heads that look along +Z without landmarks
(docs/lab/characters.md).
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cagemap.character.self_collision import Collisions, move_apart
from cagemap.character.values import Part
from cagemap.files.face_kit import read_face_kit
from cagemap.files.meshes.formats import read_mesh
from cagemap.files.npz import write_npz
from cagemap.mesh.landmarks import Landmarks
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.pictures.render import Model
from cagemap.surface.triangles import fan_triangles, row_lengths, surface_area
from cagemap.tasks.bodies import Bodies, body_shapes, match_bodies
from cagemap.tasks.carry_arrays import carry_values
from cagemap.tasks.face import face_shapes
from cagemap.tasks.face_parts import Mouth
from cagemap.tasks.progress import Stages

KEPT = Path(__file__).parents[1] / "src" / "cagemap" / "character" / "face" / "face.npz"
# Centimetres; smaller shifts are noise of the scans far from a shape's place (characters/face/README.md).
LEAST = 1e-3
# ICT-FaceKit's lids leave a slit of 9 % of the eye's height (docs/lab/characters.md).
BLINK_SCALE = 1.15
FORWARD = np.array([0.0, 0.0, 1.0])  # of the kit's head
FIRST_OF_SOCKETS = 13294  # vertices from here on are the eyes' sockets
RAYS = 400  # along each side of an eye's box


def face_arrays(folder: Path) -> dict[str, NDArray[Any]]:
    """Arrays of the package's file, from the test data."""
    head = read_mesh(folder / "ict_head_neutral.obj")
    recipe = json.loads((folder / "arkit_map.json").read_text())["map"]
    with np.load(folder / "ict_expressions.npz") as kept:
        given = {name: kept[name] for name in kept.files}
    number = {name: k for k, name in enumerate(given["names"])}
    triangles = fan_triangles(head.face_offsets, head.face_indices)[0]
    names, rows, shifts = [], [], []
    for name, parts in recipe.items():
        if not parts:
            continue
        offsets = np.zeros((head.n_vertices, 3))
        for part in parts:
            start, end = given["offset"][number[part] : number[part] + 2]
            offsets[given["row"][start:end].astype(int)] += given["delta"][start:end]
        offsets *= BLINK_SCALE if name.startswith("eyeBlink") else 1.0
        # mouthClose corrects jawOpen; corners of the mouth are smoother if only the carried shape is moved.
        if name != "mouthClose":
            offsets = move_apart(head.positions, head.positions + offsets, triangles, FORWARD) - head.positions
        moved = np.flatnonzero(np.abs(offsets).max(axis=1) > LEAST)
        names.append(name)
        rows.append(moved.astype(np.uint16))
        shifts.append(offsets[moved].astype(np.float16))
    return {
        "positions": head.positions.astype(np.float32),
        "quads": head.face_indices.reshape(-1, 4).astype(np.uint16),
        "names": np.array(names),
        "starts": np.cumsum([0, *map(len, rows)]).astype(np.int32),
        "rows": np.concatenate(rows),
        "shifts": np.concatenate(shifts),
    }


def depths(
    rest: FloatArray, shapes: Mapping[str, FloatArray], triangles: IndexArray, forward: FloatArray
) -> dict[str, float]:
    """Depth of the deepest vertex inside another part of the surface, x100 of sqrt(area), for each shape.

    Vertices that are inside at rest are left out. mouthClose is taken with jawOpen.
    """
    at_rest = Collisions.find(rest, triangles, np.arange(len(rest)), forward).vertices
    vertices = np.setdiff1d(np.arange(len(rest)), at_rest)
    size, found = np.sqrt(surface_area(rest, triangles)), {}
    for name, offsets in shapes.items():
        moved = rest + offsets + (shapes["jawOpen"] if name == "mouthClose" else 0.0)
        exits = Collisions.find(moved, triangles, vertices, forward).exits
        found[name] = 100.0 * float(row_lengths(exits).max(initial=0.0)) / size
    return found


def slit(positions: FloatArray, triangles: IndexArray, socket: NDArray[np.bool_], box: FloatArray) -> float:
    """Longest column of a box (2, 2) of rays from the front that first hit the eye's socket, as a length."""
    model = Model(positions, triangles)
    x, y = np.meshgrid(*(np.linspace(*box[:, k], RAYS) for k in (0, 1)), indexing="ij")
    origins = np.stack([x.ravel(), y.ravel(), np.full(x.size, positions[:, 2].max() + model.scale)], axis=1)
    unit = ((origins - model.centre) / model.scale).astype(np.float32)
    hit = np.asarray(model.scene.run(unit, np.tile(np.float32([0, 0, -1]), (len(unit), 1))))
    passes = (hit < 0) | socket[triangles[hit]].all(axis=1)
    return float(passes.reshape(x.shape).sum(axis=1).max() * np.ptp(box[:, 1]) / RAYS)


def eye_slits(
    positions: FloatArray, triangles: IndexArray, socket: NDArray[np.bool_], blink: FloatArray
) -> tuple[float, float]:
    """Height of an eye, and of the slit that its blink leaves, as lengths."""
    lids = positions[row_lengths(blink) > 0.3 * row_lengths(blink).max()]
    box = np.stack([lids.min(axis=0), lids.max(axis=0)])[:, :2]
    return slit(positions, triangles, socket, box), slit(positions + blink, triangles, socket, box)


def measure(bodies: Bodies) -> str:
    """One row: eye, gaps of closed lids, deepest collision and shapes above 0.2, as carried and as written."""
    mesh, kit = bodies.given[0].mesh, bodies.given[1]
    positions, triangles = mesh.positions, fan_triangles(mesh.face_offsets, mesh.face_indices)[0]
    is_socket = (np.arange(kit.mesh.n_vertices) >= FIRST_OF_SOCKETS).astype(np.float64)
    carried_mask = carry_values(bodies.result, is_socket[bodies.rows(1)], "vertices")
    assert not isinstance(carried_mask, dict)
    socket = bodies.on_target(carried_mask) > 0.5
    shapes = face_shapes(bodies, Mouth.of(bodies), body_shapes(bodies), list(kit.shapes))
    gaps = []
    for side in ("Left", "Right"):
        height, gap = eye_slits(positions, triangles, socket, shapes[f"eyeBlink{side}"])
        gaps.append(f"{100 * height / np.sqrt(surface_area(positions, triangles)):.2f}")
        gaps.append(f"{gap / height:.1%}")
    row = [mesh.name, *gaps]
    for found in (body_shapes(bodies), shapes):
        depth = depths(positions, found, triangles, FORWARD)
        name = max(depth, key=depth.__getitem__)
        row.append(f"{depth[name]:.2f} ({name}), {sum(value > 0.2 for value in depth.values())} above 0.2")
    return " | ".join(row)


if __name__ == "__main__":
    if sys.argv[1] == "write":
        write_npz(KEPT, face_arrays(Path(sys.argv[2])), compressed=True)
        print(f"{KEPT.name}: {KEPT.stat().st_size / 1e6:.2f} MB")
    else:
        for path in sys.argv[2:]:
            head = Part("head", read_mesh(Path(path)))
            print(measure(match_bodies(head, read_face_kit(), Landmarks.none(), Stages())))
