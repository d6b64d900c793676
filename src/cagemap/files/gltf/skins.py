"""Skins of glTF: the joints of all of them as one rig."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cagemap.character.values import Rig
from cagemap.files.gltf.accessors import read_accessor
from cagemap.files.gltf.entries import Document
from cagemap.files.gltf.nodes import Nodes
from cagemap.numerics.arrays import FloatArray, IndexArray

# Of the size of the joints: transforms that differ less are one, rounded.
_ROUNDING = 1e-5


@dataclass(frozen=True, eq=False)
class Skin:
    """One skin of a document.

    Attributes
    ----------
    nodes : (k,) int64
        Its joints.
    inverse_bind : (k, 4, 4) float64
        From the mesh's stored positions to each joint's space.
    to_world : (4, 4) float64
        From the stored positions to the world, in the bind pose.
    """

    nodes: IndexArray
    inverse_bind: FloatArray = field(repr=False)
    to_world: FloatArray = field(repr=False)


@dataclass(frozen=True, eq=False)
class Joints:
    """All joints of a document.

    Attributes
    ----------
    rig : Rig
    joint_of : (n,) int64
        Joint that each node is, -1 where it is none.
    above : (n, 4, 4) float64
        From the space in which a joint's own translation, rotation and scale are stated to that of ``Rig.local``: what
        lies between it and its parent in the rig.
    """

    rig: Rig
    joint_of: IndexArray = field(repr=False)
    above: FloatArray = field(repr=False)


def read_skins(document: Document, nodes: Nodes) -> tuple[Skin, ...]:
    """Skins of a document, with different joints each.

    Raises
    ------
    FormatError
        If joints are no nodes, or their matrices have no inverse.
    """
    return tuple(_skin(document, nodes, number) for number in range(len(document.entries("skins"))))


def _skin(document: Document, nodes: Nodes, number: int) -> Skin:
    where = f"skins {number}"
    entry = document.entry("skins", number)
    count = len(nodes.names)
    joints = [document.whole(joint, f"{where}: joint", 0, count - 1) for joint in document.entries("joints", entry)]
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
    if not invertible(inverse).all():
        document.refuse(where, "an inverse bind matrix has no inverse")
    rank = np.empty(count, dtype=np.int64)
    rank[list(nodes.order)] = np.arange(count)
    return Skin(np.array(joints, dtype=np.int64), inverse, _to_world(inverse, nodes.world[joints], rank[joints]))


def invertible(matrices: FloatArray) -> NDArray[np.bool_]:
    """Whether each matrix has an inverse that is no mere rounding."""
    with np.errstate(over="ignore", invalid="ignore"):
        size = np.abs(matrices[:, :3, :3]).max(axis=(1, 2))
        volume = np.abs(np.linalg.det(matrices[:, :3, :3] / np.where(size > 0, size, 1.0)[:, None, None]))
    return np.asarray((size > 1e-30) & (size < 1e30) & (volume > 1e-12) & (np.abs(matrices).max(axis=(1, 2)) < 1e30))


def _to_world(inverse: FloatArray, world: FloatArray, rank: IndexArray) -> FloatArray:
    """From stored positions to the world, as most joints place them at rest; else as the topmost one does.

    Where the nodes at rest are in the bind pose, every joint places them alike.
    """
    placed = inverse @ world
    heads = np.linalg.inv(inverse)[:, 3, :3]
    size = float(np.ptp(heads, axis=0).max()) or 1.0
    frame = np.column_stack([heads.mean(axis=0) + size * np.vstack([np.zeros(3), np.eye(3)]), np.ones(4)])
    order = np.argsort(rank)
    corners = (frame @ placed[order])[:, :, :3].reshape(len(order), 12)
    scale = max(float(np.ptp(corners.reshape(-1, 4, 3), axis=1).max()), 1e-30)
    alike = np.array([np.sum(np.abs(corners - one).max(axis=1) < _ROUNDING * scale) for one in corners])
    chosen = placed[order[alike.argmax()]]
    return rounded(chosen, np.eye(4), frame)


def rounded(matrix: FloatArray, exact: FloatArray, frame: FloatArray) -> FloatArray:
    """The exact matrix where a matrix differs from it by rounding only, for points (p, 4)."""
    meant = frame @ exact
    size = float(np.ptp(meant[:, :3], axis=0).max())
    return exact if np.abs(frame @ matrix - meant).max() < _ROUNDING * size else matrix


def read_joints(document: Document, nodes: Nodes, skins: tuple[Skin, ...]) -> Joints | None:
    """Joints of all skins as one rig; None without skins.

    A node above a joint is a joint too where it is animated or has no similarity as transform. Others are part of the
    transforms of the joints below them.

    Raises
    ------
    FormatError
        If a joint at rest is scaled to nothing, and its bind pose is not stated.
    """
    if not skins:
        return None
    chosen = _joint_nodes(document, nodes, skins)
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
                parents[joint_of[node]] = _nearest(nodes, joint_of, int(parent))
    local = nodes.local[chosen] @ above[chosen]
    bind = np.full((len(chosen), 4, 4), np.nan)
    for skin in reversed(skins):
        bind[joint_of[skin.nodes]] = np.linalg.inv(skin.inverse_bind) @ skin.to_world
    for joint in np.flatnonzero(np.isnan(bind[:, 0, 0])):
        bind[joint] = local[joint] if parents[joint] < 0 else local[joint] @ bind[parents[joint]]
    if not invertible(bind).all():
        document.refuse("skins", "the bind pose of a joint is scaled to nothing")
    rig = Rig(tuple(nodes.names[node] for node in chosen), parents, local, bind)
    return Joints(rig, joint_of, above)


def _joint_nodes(document: Document, nodes: Nodes, skins: tuple[Skin, ...]) -> list[int]:
    """Nodes that are joints, parents before their children."""
    stated = {int(node) for skin in skins for node in skin.nodes}
    targets = [
        document.table(channel, "target", "animations").get("node")
        for animation in document.entries("animations")
        if isinstance(animation, dict)
        for channel in document.entries("channels", animation, "animations")
        if isinstance(channel, dict)
    ]
    moved = {node for node in targets if isinstance(node, int)}
    turned = nodes.local[:, :3, :3]
    lengths = np.linalg.norm(turned, axis=2)
    even = np.ptp(lengths, axis=1) <= 1e-4 * lengths.max(axis=1, initial=0.0)
    cosines = np.abs(turned @ turned.transpose(0, 2, 1) - lengths[:, :, None] ** 2 * np.eye(3)).max(axis=(1, 2))
    similar = even & (cosines <= 1e-4 * lengths.max(axis=1) ** 2)
    chosen = set(stated)
    for node in stated:
        while (node := int(nodes.parents[node])) >= 0:
            if node in moved or not similar[node]:
                chosen.add(node)
    return [node for node in nodes.order if node in chosen]


def _nearest(nodes: Nodes, joint_of: IndexArray, node: int) -> int:
    """The joint that a node is, or the nearest above it; -1 where there is none."""
    while node >= 0 and joint_of[node] < 0:
        node = int(nodes.parents[node])
    return int(joint_of[node]) if node >= 0 else -1


def nearest_joint(nodes: Nodes, joints: Joints, node: int) -> int:
    """The joint nearest above a node; -1 where there is none."""
    return _nearest(nodes, joints.joint_of, int(nodes.parents[node]))
