"""Small glTF documents that tests share."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from cagemap.files.gltf.entries import Document

_KINDS = {"f4": 5126, "u1": 5121, "i1": 5120, "u2": 5123, "i2": 5122, "u4": 5125}
_SHAPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


class Maker:
    """Collects accessors of a document."""

    def __init__(self) -> None:
        self.data = b""
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []

    def view(self, data: bytes, **extra: Any) -> int:
        self.views.append({"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data)} | extra)
        self.data += data + b"\0" * (-len(data) % 4)
        return len(self.views) - 1

    def add(self, values: Any, dtype: str = "<f4", **extra: Any) -> int:
        array = np.asarray(values, dtype=dtype)
        columns = 1 if array.ndim == 1 else array[0].size
        bounds: dict[str, Any] = {}
        if columns in (1, 3) and array.dtype.kind == "f":
            rows = array.reshape(-1, columns)
            bounds = {"min": rows.min(axis=0).tolist(), "max": rows.max(axis=0).tolist()}
        entry = {"bufferView": self.view(array.tobytes()), "componentType": _KINDS[array.dtype.str[1:]]}
        entry |= {"count": len(array), "type": _SHAPES[columns]} | bounds | extra
        self.accessors.append(entry)
        return len(self.accessors) - 1

    def document(self, file: Path = Path("made.glb"), **top: Any) -> Document:
        entries: dict[str, Any] = {"asset": {"version": "2.0"}, "bufferViews": self.views, "accessors": self.accessors}
        entries["buffers"] = [{"byteLength": len(self.data)}]
        return Document(entries | top, (self.data,), file)


def matrices(rows: np.ndarray) -> np.ndarray:
    """(k, 16) as glTF stores matrices, of matrices (k, 4, 4) for points as rows."""
    return rows.reshape(-1, 16)


def moved(x: float, y: float, z: float) -> np.ndarray:
    """A shift, for points as rows."""
    matrix = np.eye(4)
    matrix[3, :3] = [x, y, z]
    return matrix


def arm(*, above: dict[str, Any] | None = None, bind: np.ndarray | None = None) -> Document:
    """Two quads along x on joints at x = 0 and 1, a ball below the second; ``bind`` moves what is stored."""
    bind = np.eye(4) if bind is None else bind
    make = Maker()
    points = np.array([(x, y, 0.0) for x in (0.0, 1.0, 2.0) for y in (0.0, 1.0)])
    stored = np.column_stack([points, np.ones(6)]) @ bind
    inverse = np.stack([np.linalg.inv(bind), np.linalg.inv(bind) @ moved(-1, 0, 0)])
    weights = np.array([(255, 0, 0, 0)] * 2 + [(127, 127, 0, 0)] * 2 + [(0, 255, 0, 0)] * 2)
    attributes = {
        "POSITION": make.add(stored[:, :3]),
        "TEXCOORD_0": make.add(points[:, :2] / 2),
        "JOINTS_0": make.add(np.tile([0, 1, 0, 0], (6, 1)), "u1"),
        "WEIGHTS_0": make.add(weights, "u1", normalized=True),
    }
    raised = np.zeros((6, 3))
    raised[4:, 2] = 1.0
    strip = {
        "attributes": attributes,
        "indices": make.add([0, 2, 1, 1, 2, 3, 2, 4, 3, 3, 4, 5], "<u2"),
        "targets": [{"POSITION": make.add(raised)}],
    }
    ball = {"attributes": {"POSITION": make.add([(0, 0, 0), (1, 0, 0), (0, 1, 0)])}}
    quarter = [0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)]
    times = make.add([0.0, 0.5, 2.0])
    turned = make.add([(0, 0, 0, 1), quarter, (0, 0, 0, 1)])
    shifted = make.add([(0, 0, 0), (0, 0, 1), (0, 0, 0)])
    return make.document(
        scene=0,
        scenes=[{"nodes": [0, 4]}],
        nodes=[
            {"name": "armature", "children": [1]} | (above or {}),
            {"name": "upper", "children": [2]},
            {"name": "lower", "translation": [1, 0, 0], "children": [3]},
            {"name": "ball", "mesh": 1, "translation": [0, 0, 5]},
            {"name": "strip", "mesh": 0, "skin": 0, "translation": [7, 7, 7]},
        ],
        meshes=[{"primitives": [strip], "extras": {"targetNames": ["raise"]}}, {"primitives": [ball]}],
        skins=[{"joints": [1, 2], "inverseBindMatrices": make.add(matrices(inverse))}],
        animations=[
            {
                "name": "bend",
                "samplers": [{"input": times, "output": turned}, {"input": times, "output": shifted}],
                "channels": [
                    {"sampler": 0, "target": {"node": 2, "path": "rotation"}},
                    {"sampler": 1, "target": {"node": 1, "path": "translation"}},
                    {"sampler": 1, "target": {"node": 4, "path": "translation"}},
                ],
            }
        ],
    )


def changed(document: Document, **top: Any) -> Document:
    """A copy with other entries at the top."""
    return replace(document, json=json.loads(json.dumps(document.json)) | top)
