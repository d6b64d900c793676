"""Nodes of a glTF scene: their hierarchy and transforms. Matrices act on rows, as everywhere in cagemap."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from cagemap.files.gltf.document import Document
from cagemap.numerics.arrays import FloatArray, IndexArray

# Of the length of a transform's axes.
_SHEAR, _ROUNDING = 1e-4, 1e-9
_REST = {"translation": [0.0] * 3, "rotation": [0.0, 0.0, 0.0, 1.0], "scale": [1.0] * 3}


@dataclass(frozen=True, eq=False)
class Nodes:
    """All nodes of a document.

    Attributes
    ----------
    order : tuple of int
        All nodes, parents before their children.
    in_scene : frozenset of int
        Those of the scene that is shown.
    parents : (n,) int64
        -1 for a root.
    local, world : (n, 4, 4) float64
        From a node's space to its parent's, and to the world.
    names : tuple of str
        Different ones; nodes without a name have one of their number.
    """

    order: tuple[int, ...]
    in_scene: frozenset[int]
    parents: IndexArray = field(repr=False)
    local: FloatArray = field(repr=False)
    world: FloatArray = field(repr=False)
    names: tuple[str, ...] = field(repr=False)


def read_nodes(document: Document) -> Nodes:
    """The nodes of a document.

    Raises
    ------
    FormatError
        If a node has two parents or is its own ancestor, or a transform is no finite one.
    """
    count = len(document.entries("nodes"))
    children = [_children(document, number) for number in range(count)]
    parents = np.full(count, -1, dtype=np.int64)
    for number, own in enumerate(children):
        for child in own:
            if parents[child] >= 0:
                document.refuse(f"nodes {child}", f"has two parents, {parents[child]} and {number}")
            parents[child] = number
    order = _below(np.flatnonzero(parents < 0).tolist(), children)
    if len(order) != count:
        document.refuse("nodes", "some are their own ancestors")
    local = np.array([_local(document, number) for number in range(count)]).reshape(-1, 4, 4)
    world = local.copy()
    with np.errstate(over="ignore", invalid="ignore"):
        for number in order:
            if parents[number] >= 0:
                world[number] = local[number] @ world[parents[number]]
    if not np.isfinite(world).all():
        document.refuse("nodes", "their transforms are too large")
    names = distinct([document.name("nodes", number) or f"node {number}" for number in range(count)])
    return Nodes(tuple(order), frozenset(_below(_roots(document, parents), children)), parents, local, world, names)


def distinct(names: list[str]) -> tuple[str, ...]:
    """Names with a number behind those that came before."""
    used: set[str] = set()
    made = []
    counts: dict[str, int] = {}
    for name in names:
        word = name
        while word in used:
            counts[name] = counts.get(name, 1) + 1
            word = f"{name}_{counts[name]}"
        used.add(word)
        made.append(word)
    return tuple(made)


def _children(document: Document, number: int) -> list[int]:
    where = f"nodes {number}"
    own = document.entries("children", document.entry("nodes", number), where)
    return [document.whole(child, f"{where}: child", 0, len(document.entries("nodes")) - 1) for child in own]


def _below(roots: list[int], children: list[list[int]]) -> list[int]:
    """Nodes from the roots down, depth first."""
    found, open_nodes = [], list(reversed(roots))
    seen: set[int] = set()
    while open_nodes:
        number = open_nodes.pop()
        if number in seen:
            continue
        seen.add(number)
        found.append(number)
        open_nodes.extend(reversed(children[number]))
    return found


def _roots(document: Document, parents: IndexArray) -> list[int]:
    """Root nodes of the scene that is shown; without scenes all nodes are."""
    if not document.entries("scenes"):
        return np.flatnonzero(parents < 0).tolist()
    scene = document.entry("scenes", document.json.get("scene", 0))
    listed = document.entries("nodes", scene, "scenes")
    return [document.whole(number, "scenes: node", 0, len(parents) - 1) for number in listed]


def _local(document: Document, number: int) -> FloatArray:
    entry = document.entry("nodes", number)
    where = f"nodes {number}"
    if entry.get("matrix") is not None:
        # By columns for points as columns: the rows of a matrix for points as rows.
        return document.numbers(entry["matrix"], f"{where}: matrix", 16).reshape(4, 4)
    stated = {name: rest if entry.get(name) is None else entry[name] for name, rest in _REST.items()}
    return transform(*(document.numbers(stated[name], f"{where}: {name}", len(rest)) for name, rest in _REST.items()))


def rotation_matrix(quaternion: FloatArray) -> FloatArray:
    """(..., 3, 3) rotations, for points as rows, of quaternions (..., 4): x, y, z, w of any length but 0."""
    length = np.linalg.norm(quaternion, axis=-1, keepdims=True)
    x, y, z, w = np.moveaxis(quaternion / np.where(length > 0.0, length, 1.0), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)],
        [2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w)],
        [2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def transform(translation: FloatArray, quaternion: FloatArray, scale: FloatArray) -> FloatArray:
    """(4, 4) matrix for points as rows: scaled, turned, moved."""
    made = np.eye(4)
    made[:3, :3] = scale[:, None] * rotation_matrix(quaternion)
    made[3, :3] = translation
    return made


def decomposed(matrix: FloatArray) -> dict[str, list[float]]:
    """Translation, rotation and scale of a transform (4, 4), as a node states them; ``matrix`` where it has shear."""
    scale = np.linalg.norm(matrix[:3, :3], axis=1)
    if np.linalg.det(matrix[:3, :3]) < 0.0:
        scale = -scale
    turn = matrix[:3, :3] / np.where(scale == 0.0, 1.0, scale)[:, None]
    if (scale == 0.0).any() or np.abs(turn @ turn.T - np.eye(3)).max() > _SHEAR:
        return {"matrix": matrix.ravel().tolist()}
    rotation = Rotation.from_matrix(turn.T).as_quat()
    parts = {"translation": matrix[3, :3], "rotation": rotation, "scale": scale}
    return {name: part.tolist() for name, part in parts.items() if np.abs(part - _REST[name]).max() > _ROUNDING}
