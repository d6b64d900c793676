"""Nodes of a glTF scene with their transforms, and the joints of all skins as one rig. Matrices act on rows."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import chain

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cagemap.character.poses import decompose
from cagemap.character.values import Rig
from cagemap.files.gltf.entries import Document, read_accessor
from cagemap.files.text import make_distinct
from cagemap.numerics.arrays import FloatArray, IndexArray

# Relative to the length of a transform's axes.
_SHEAR, _TRANSFORM_ROUNDING = 1e-4, 1e-9
# Transform of a node that states none.
REST = {"translation": [0.0] * 3, "rotation": [0.0, 0.0, 0.0, 1.0], "scale": [1.0] * 3}


@dataclass(frozen=True, eq=False)
class Nodes:
    """Nodes of a document with their transforms."""

    order: tuple[int, ...]  # all nodes, parents before children
    in_scene: frozenset[int]  # nodes of the displayed scene
    parents: IndexArray = field(repr=False)  # (n,) -1 for a root
    # `local`, `world`: (n, 4, 4) from a node's space to its parent's, and to the world
    local: FloatArray = field(repr=False)
    world: FloatArray = field(repr=False)
    names: tuple[str, ...] = field(repr=False)  # unique; unnamed nodes are called by their number


def read_nodes(document: Document) -> Nodes:
    """The nodes of a document."""
    count = len(document.entries("nodes"))
    children = [
        document.entries("children", document.entry("nodes", number), f"nodes {number}") for number in range(count)
    ]
    parents = np.full(count, -1, dtype=np.int64)
    for number, listed in enumerate(children):
        for child in listed:
            if parents[child] >= 0:
                document.refuse(f"nodes {child}", f"has two parents, {parents[child]} and {number}")
            parents[child] = number
    order = _descendants(np.flatnonzero(parents < 0).tolist(), children)
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
    roots = np.flatnonzero(parents < 0).tolist()
    if document.entries("scenes"):  # without scenes, all roots are displayed
        roots = document.entries("nodes", document.entry("scenes", document.json.get("scene", 0)), "scenes")
    in_scene = frozenset(_descendants(roots, children))
    return Nodes(tuple(order), in_scene, parents, local, world, document.unique_names("nodes", "node"))


def _descendants(roots: list[int], children: list[list[int]]) -> list[int]:
    """The roots and all nodes below them, depth first."""
    ordered, open_nodes = [], list(reversed(roots))
    seen: set[int] = set()
    while open_nodes:
        number = open_nodes.pop()
        if number in seen:
            continue
        seen.add(number)
        ordered.append(number)
        open_nodes.extend(reversed(children[number]))
    return ordered


def _local(document: Document, number: int) -> FloatArray:
    entry = document.entry("nodes", number)
    where = f"nodes {number}"
    if entry.get("matrix") is not None:
        # Stored by columns for points as columns, so read by rows it acts on points as rows.
        return document.numbers(entry["matrix"], f"{where}: matrix", 16).reshape(4, 4)
    stated = {name: rest if entry.get(name) is None else entry[name] for name, rest in REST.items()}
    return transform(*(document.numbers(stated[name], f"{where}: {name}", len(rest)) for name, rest in REST.items()))


def scale_signs(document: Document, number: int) -> FloatArray:
    """(3,) signs of a node's scale in the file, times the signs of the scale that `decompose_transform` gives it."""
    stated = document.entry("nodes", number).get("scale")
    scale = document.numbers(REST["scale"] if stated is None else stated, f"nodes {number}: scale", 3)
    signs = np.where(scale < 0.0, -1.0, 1.0)
    return np.asarray(signs * signs.prod())


def transform(translation: FloatArray, quaternion: FloatArray, scale: FloatArray) -> FloatArray:
    """(4, 4) matrix for points as rows: scales, rotates, translates. A quaternion of length 0 rotates nothing."""
    rotation = Rotation.from_quat(quaternion if np.linalg.norm(quaternion) > 0.0 else REST["rotation"])
    matrix = np.eye(4)
    matrix[:3, :3] = scale[:, None] * rotation.as_matrix().T
    matrix[3, :3] = translation
    return matrix


def decompose_transform(matrix: FloatArray) -> dict[str, list[float]]:
    """Translation, rotation and scale of a transform (4, 4), as in a node's entry; ``matrix`` if it has shear."""
    translation, turn, scale = decompose(matrix)
    if (scale == 0.0).any() or np.abs(turn @ turn.T - np.eye(3)).max() > _SHEAR:
        return {"matrix": matrix.ravel().tolist()}
    parts = {"translation": translation, "rotation": Rotation.from_matrix(turn.T).as_quat(), "scale": scale}
    return {
        name: part.tolist() for name, part in parts.items() if np.abs(part - REST[name]).max() > _TRANSFORM_ROUNDING
    }


# Relative to the size of the skeleton: transforms that differ by less are equal up to rounding.
_SAME_TRANSFORM = 1e-5


@dataclass(frozen=True, eq=False)
class Skin:
    """A skin of a document."""

    nodes: IndexArray  # (k,) its joints
    inverse_bind: FloatArray = field(repr=False)  # (k, 4, 4) from the mesh's stored positions to each joint's space
    to_world: FloatArray = field(repr=False)  # (4, 4) from the stored positions to the world, in the bind pose


@dataclass(frozen=True, eq=False)
class Joints:
    """Joints of all skins as one rig."""

    rig: Rig
    joint_of: IndexArray = field(repr=False)  # (n,) joint of each node, -1 for other nodes
    of_skins: tuple[IndexArray, ...] = field(repr=False)  # for each skin, (k,) joints of the rig
    # (n, 4, 4) from the space of a node's own translation, rotation and scale to that of ``Rig.local``: transforms of
    # the nodes between it and its parent in the rig
    above: FloatArray = field(repr=False)


def read_skin(document: Document, nodes: Nodes, number: int) -> Skin:
    """A skin of a document; its joints are unique."""
    where = f"skins {number}"
    entry = document.entry("skins", number)
    count = len(nodes.names)
    joints = document.entries("joints", entry, where)
    if not joints or len(set(joints)) != len(joints):
        document.refuse(where, f"expected different joints, got {len(joints)} of {len(set(joints))} nodes")
    stated = entry.get("inverseBindMatrices")
    if stated is None:
        inverse = np.tile(np.eye(4), (len(joints), 1, 1))
    else:
        inverse = read_accessor(document, stated, f"{where}: inverseBindMatrices", ("MAT4",))[: len(joints)]
        inverse = inverse.astype(np.float64).reshape(-1, 4, 4)
    if len(inverse) < len(joints):
        document.refuse(where, f"expected {len(joints)} inverse bind matrices, got {len(inverse)}")
    inverse[:, :, 3] = [0.0, 0.0, 0.0, 1.0]  # by the standard; files round it
    if not is_invertible(inverse).all():
        document.refuse(where, "an inverse bind matrix has no inverse")
    rank = np.empty(count, dtype=np.int64)
    rank[list(nodes.order)] = np.arange(count)
    return Skin(np.array(joints, dtype=np.int64), inverse, _to_world(inverse, nodes.world[joints], rank[joints]))


def is_invertible(matrices: FloatArray) -> NDArray[np.bool_]:
    """(k,) whether each matrix can be inverted safely in floating point."""
    with np.errstate(over="ignore", invalid="ignore"):
        size = np.abs(matrices[:, :3, :3]).max(axis=(1, 2))
        volume = np.abs(np.linalg.det(matrices[:, :3, :3] / np.where(size > 0, size, 1.0)[:, None, None]))
    return np.asarray((size > 1e-30) & (size < 1e30) & (volume > 1e-12) & (np.abs(matrices).max(axis=(1, 2)) < 1e30))


def _to_world(inverse: FloatArray, world: FloatArray, rank: IndexArray) -> FloatArray:
    """Transform of stored positions to the world on which most joints at rest agree; else that of the topmost joint."""
    placed, frame = inverse @ world, _frame(inverse)
    order = np.argsort(rank)
    corners = (frame @ placed[order])[:, :, :3].reshape(len(order), 12)
    scale = max(float(np.ptp(corners.reshape(-1, 4, 3), axis=1).max()), 1e-30)
    alike = np.array(
        [np.sum(np.abs(corners - placed_corners).max(axis=1) < _SAME_TRANSFORM * scale) for placed_corners in corners]
    )
    chosen = placed[order[alike.argmax()]]
    return snap_to_exact(chosen, np.eye(4), frame)


def _frame(inverse: FloatArray) -> FloatArray:
    """(4, 4) points that span the joints of inverse bind matrices (k, 4, 4), as rows."""
    heads = np.linalg.inv(inverse)[:, 3, :3]
    size = float(np.ptp(heads, axis=0).max()) or 1.0
    return np.column_stack([heads.mean(axis=0) + size * np.vstack([np.zeros(3), np.eye(3)]), np.ones(4)])


def snap_to_exact(matrix: FloatArray, exact: FloatArray, frame: FloatArray) -> FloatArray:
    """``exact``, if a matrix moves points (p, 4) to the same places up to rounding; otherwise ``matrix``."""
    meant = frame @ exact
    size = float(np.ptp(meant[:, :3], axis=0).max())
    return exact if np.abs(frame @ matrix - meant).max() < _SAME_TRANSFORM * size else matrix


def read_joints(document: Document, nodes: Nodes, skins: tuple[Skin, ...], *, props: bool = False) -> Joints | None:
    """Joints of all skins as one rig; None without skins, unless ``props`` and a mesh moves by itself.

    An animated node of a mesh without skin becomes a joint. So does a node above a joint if it is animated or its
    transform is no similarity. Transforms of other nodes are applied to the joints below them. A joint that a later
    skin in use binds otherwise gets a child.
    """
    chosen = _joint_nodes(document, nodes, skins) if skins or props else []
    if not chosen:
        return None
    count = len(nodes.names)
    joint_of = np.full(count, -1, dtype=np.int64)
    joint_of[chosen] = np.arange(len(chosen))
    parents = np.full(len(chosen), -1, dtype=np.int64)
    above = np.tile(np.eye(4), (count, 1, 1))
    for node in nodes.order:
        parent = nodes.parents[node]
        if parent >= 0:
            above[node] = np.eye(4) if joint_of[parent] >= 0 else nodes.local[parent] @ above[parent]
            if joint_of[node] >= 0:
                parents[joint_of[node]] = nearest_joint(nodes, joint_of, int(parent))
    local = nodes.local[chosen] @ above[chosen]
    bind = np.full((len(chosen), 4, 4), np.nan)
    for skin in reversed(skins):
        bind[joint_of[skin.nodes]] = np.linalg.inv(skin.inverse_bind) @ skin.to_world
    for joint in np.flatnonzero(np.isnan(bind[:, 0, 0])):
        bind[joint] = local[joint] if parents[joint] < 0 else local[joint] @ bind[parents[joint]]
    if not is_invertible(bind).all():
        document.refuse("skins", "the bind pose of a joint is scaled to nothing")
    rig = Rig(tuple(nodes.names[node] for node in chosen), parents, local, bind)
    of_skins, used = [], {document.entry("nodes", node).get("skin") for node in nodes.in_scene}
    for number, skin in enumerate(skins):
        of_skin = joint_of[skin.nodes]
        if number in used:
            rig, of_skin = _with_bound(rig, of_skin, skin, nodes.names)
        of_skins.append(of_skin)
    return Joints(rig, joint_of, tuple(of_skins), above)


def _with_bound(rig: Rig, joints: IndexArray, skin: Skin, taken: tuple[str, ...]) -> tuple[Rig, IndexArray]:
    """The rig with further joints, not named as ``taken``, where a skin binds its joints (k,) in another pose."""
    changes, frame = skin.inverse_bind @ rig.bind[joints], _frame(skin.inverse_bind)
    other = [snap_to_exact(change, skin.to_world, frame) is not skin.to_world for change in changes]
    moved = np.flatnonzero(other)
    if not len(moved):
        return rig, joints
    count, of_skin = len(rig.names), joints.copy()
    of_skin[moved] = count + np.arange(len(moved))
    words = [rig.names[joint] for joint in joints[moved]]
    names = make_distinct([*dict.fromkeys((*taken, *rig.names)), *words])
    bind = np.concatenate([rig.bind, np.linalg.inv(skin.inverse_bind[moved]) @ skin.to_world])
    local = np.concatenate([rig.local, np.tile(np.eye(4), (len(moved), 1, 1))])
    return Rig((*rig.names, *names[-len(moved) :]), np.append(rig.parents, joints[moved]), local, bind), of_skin


def _joint_nodes(document: Document, nodes: Nodes, skins: tuple[Skin, ...]) -> list[int]:
    """Nodes that become joints, parents before children."""
    moved = moved_nodes(document)
    turned = nodes.local[:, :3, :3]
    lengths = np.linalg.norm(turned, axis=2)
    even = np.ptp(lengths, axis=1) <= 1e-4 * lengths.max(axis=1, initial=0.0)
    cosines = np.abs(turned @ turned.transpose(0, 2, 1) - lengths[:, :, None] ** 2 * np.eye(3)).max(axis=(1, 2))
    similar = even & (cosines <= 1e-4 * lengths.max(axis=1) ** 2)

    def add_ancestors(chosen: set[int]) -> None:
        for node in list(chosen):
            while (node := int(nodes.parents[node])) >= 0:
                if node in moved or not similar[node]:
                    chosen.add(node)

    chosen = {int(node) for skin in skins for node in skin.nodes}
    add_ancestors(chosen)
    chosen |= _moved_props(document, nodes, chosen, moved)
    add_ancestors(chosen)
    return [node for node in nodes.order if node in chosen]


def moved_nodes(document: Document) -> set[int]:
    """Nodes that animations move; weights of blend shapes move none."""
    targets = (
        document.table(channel, "target", "animations")
        for animation in document.entries("animations")
        for channel in document.entries("channels", animation, "animations")
    )
    return {one["node"] for one in targets if one.get("path") != "weights" and one.get("node") is not None}


def _moved_props(document: Document, nodes: Nodes, joints: set[int], moved: set[int]) -> set[int]:
    """Animated nodes of meshes without skin, and those above them up to a joint; not a turntable of all meshes."""
    chains = list[set[int]]()
    for node in nodes.in_scene:
        entry = document.entry("nodes", node)
        if entry.get("mesh") is None or entry.get("skin") is not None or not is_invertible(nodes.world[[node]])[0]:
            continue
        chains.append(set())
        while node >= 0 and node not in joints:
            chains[-1].add(node)
            node = int(nodes.parents[node])
    found = moved.intersection(chain.from_iterable(chains))
    return found if joints else found - moved.intersection(*chains)


def nearest_joint(nodes: Nodes, joint_of: IndexArray, node: int) -> int:
    """The joint of a node or of its nearest ancestor; -1 if none of them is a joint."""
    while node >= 0 and joint_of[node] < 0:
        node = int(nodes.parents[node])
    return int(joint_of[node]) if node >= 0 else -1
