"""`python -m benchmarks.face_kit FOLDER`: the package's face shapes, from `characters/face` of the test data.

Writes `src/cagemap/character/face/face.npz`: the neutral head of ICT-FaceKit and the shapes that ARKit names, as rows
and half-precision shifts. `FOLDER` is `characters/face`. Run it again only when the shapes change.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cagemap.files.meshes.formats import read_mesh
from cagemap.files.npz import write_npz

KEPT = Path(__file__).parents[1] / "src" / "cagemap" / "character" / "face" / "face.npz"
# Centimetres; smaller shifts are noise of the scans far from a shape's place (characters/face/README.md).
LEAST = 1e-3


def face_arrays(folder: Path) -> dict[str, NDArray[Any]]:
    """Arrays of the package's file, from the test data."""
    head = read_mesh(folder / "ict_head_neutral.obj")
    recipe = json.loads((folder / "arkit_map.json").read_text())["map"]
    with np.load(folder / "ict_expressions.npz") as kept:
        given = {name: kept[name] for name in kept.files}
    number = {name: k for k, name in enumerate(given["names"])}
    names, rows, shifts = [], [], []
    for name, parts in recipe.items():
        if not parts:
            continue
        offsets = np.zeros((head.n_vertices, 3))
        for part in parts:
            start, end = given["offset"][number[part] : number[part] + 2]
            offsets[given["row"][start:end].astype(int)] += given["delta"][start:end]
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


if __name__ == "__main__":
    write_npz(KEPT, face_arrays(Path(sys.argv[1])), compressed=True)
    print(f"{KEPT.name}: {KEPT.stat().st_size / 1e6:.2f} MB")
