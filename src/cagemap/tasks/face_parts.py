"""Teeth and lashes of a head in shapes of the built-in face: the lower jaw moves rigidly, lashes turn with the lids."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from cagemap.character.body_frames import BodyFrames
from cagemap.files.face_kit import kit_vertices
from cagemap.mesh import ControlMesh
from cagemap.mesh.topology import vertex_pieces
from cagemap.numerics.arrays import FloatArray, nearest_rotations
from cagemap.tasks.bodies import Bodies

# Motions of ICT-FaceKit's lower teeth: a rotation vector in radians, and a shift. Lengths: centimetres of its face.
_JAW_MOTIONS = {
    "jawOpen": ((0.4422, 0.0, 0.0), (0.0, 0.726, 0.409)),
    "jawForward": ((0.0, 0.0, 0.0), (0.0, -0.17, 0.888)),
    "jawLeft": ((0.0, 0.033, 0.001), (0.38, -0.059, 0.063)),
    "jawRight": ((0.0, -0.033, -0.001), (-0.38, -0.059, 0.063)),
}
_LIPS_RADIUS = 5.0  # of the skin around the lips that places a mouth
_MOUTH = np.array([(-4.2, -8.0, 0.5), (4.2, -0.5, 11.3)])  # lowest and highest coordinates of its teeth, gums, tongue
_MIN_INSIDE = 0.9  # share of a piece's vertices
_MIN_DEPTH = 0.3  # behind the face; beards have less
_FRONT_VERTICES = 32  # of the face that are nearest seen from the front
# Height at which the rows meet, at depth 0, and its rise with depth; a piece that goes this far beyond both ways (gums
# of both rows) is stretched over the gap.
_BITE_HEIGHT, _BITE_RISE = -2.25, -0.09
_MAX_OVERLAP, _GAP = 1.0, 1.0
# Angle in radians by which ICT-FaceKit's upper lashes turn in a blink. Lashes turn where their roots go down by a fifth
# of the most of the lid, and not at all below a tenth (docs/lab/characters.md).
_BLINK_ANGLE, _TURNED_SHARE = 0.93, 0.1
_MAX_TIP_SINE = 0.3  # of the angle by which lashes at the corners of the eye point backwards; eyeballs lie behind


@dataclass(frozen=True, eq=False)
class Mouth:
    """A head's mouth in the space of the built-in face."""

    kit: FloatArray = field(repr=False)  # (k, 3) vertices of the built-in face
    centres: tuple[FloatArray, FloatArray]  # of the skin around the lips, on the head and on the built-in face
    to_kit: FloatArray  # (3, 3) rotation times scale, for offsets as rows

    @classmethod
    def of(cls, bodies: Bodies) -> Mouth:
        """Fit a similarity to the skin around the lips."""
        point_map, kit = bodies.result.point_map, bodies.given[1].mesh.positions
        images = point_map.images.positions / point_map.source.scale
        lips = kit[kit_vertices(("mouth_left", "mouth_right"))].mean(axis=0)
        distances = np.linalg.norm(images - lips, axis=1)
        near = distances <= max(_LIPS_RADIUS, float(np.quantile(distances, 0.05)))  # never none
        sides = point_map.target.positions[near] / point_map.target.scale, images[near]
        centres = sides[0].mean(axis=0), sides[1].mean(axis=0)
        offsets = sides[0] - centres[0]
        covariance = offsets.T @ (sides[1] - centres[1])
        turn = nearest_rotations(covariance[None])[0]
        return cls(kit, centres, turn * (turn * covariance).sum() / (offsets**2).sum())

    def shapes(
        self, mesh: ControlMesh, amounts: Mapping[str, float]
    ) -> tuple[NDArray[np.bool_], dict[str, FloatArray]]:
        """Vertices (n,) of pieces in the mouth, and offsets (n, 3) of shapes that move these; 0 at other vertices.

        ``amounts``: of shapes, in parts of their motions in the built-in face.
        """
        points = (mesh.positions - self.centres[0]) @ self.to_kit + self.centres[1]
        piece = vertex_pieces(mesh)
        sizes = np.bincount(piece)
        is_inside = ((points > _MOUTH[0]) & (points < _MOUTH[1])).all(axis=1)
        rows = np.flatnonzero(is_inside)
        near = cKDTree(self.kit[:, :2]).query(points[rows, :2], k=_FRONT_VERTICES)[1]
        is_inside[rows] = points[rows, 2] < self.kit[near, 2].max(axis=1) - _MIN_DEPTH
        inside = (np.bincount(piece, is_inside) >= _MIN_INSIDE * sizes)[piece]
        heights = points[:, 1] - _BITE_HEIGHT - _BITE_RISE * points[:, 2]
        of_lower = (np.bincount(piece, heights) < 0.0)[piece].astype(np.float64)
        is_above, is_below = (np.bincount(piece, side * heights > _MAX_OVERLAP) > 0 for side in (1.0, -1.0))
        of_lower = np.where((is_above & is_below)[piece], np.clip(0.5 - heights / _GAP, 0.0, 1.0), of_lower)
        motions = {
            name: amount * np.array(_JAW_MOTIONS[name])
            for name, amount in amounts.items()
            if name in _JAW_MOTIONS and inside.any()
        }
        from_kit = np.linalg.inv(self.to_kit)
        return inside, {
            name: (inside * of_lower)[:, None] * (Rotation.from_rotvec(turn).apply(points) + shift - points) @ from_kit
            for name, (turn, shift) in motions.items()
        }


def turn_lashes(
    bodies: Bodies,
    points: FloatArray,
    means: sparse.csr_array,
    shapes: Mapping[str, FloatArray],
    of_skin: Mapping[str, FloatArray],
    amounts: Mapping[str, float],
) -> dict[str, FloatArray]:
    """Shapes (n, 3) of lashes, of which those of upper lids turn about their roots in blinks.

    ``points``: (n, 3), and ``means`` (n, n) over their roots, see `root_means`. Points behind their roots do not turn.
    ``of_skin``: shapes of the head's skin. ``amounts``: of shapes, in parts of their motions in the built-in face.
    """
    right, up, forward = BodyFrames(bodies.result.point_map).rotation
    made, tips = dict(shapes), points - means @ points
    is_behind = tips @ forward < -_MAX_TIP_SINE * np.linalg.norm(tips, axis=1)
    for name in shapes:
        if name.startswith("eyeBlink") and (most := -(of_skin[name] @ up).min(initial=0.0)) > 0.0:
            share = np.clip(-(shapes[name] @ up) / (_TURNED_SHARE * most) - 1.0, 0.0, 1.0) * ~is_behind
            turns = Rotation.from_rotvec(_BLINK_ANGLE * amounts[name] * share[:, None] * right)
            made[name] = shapes[name] + turns.apply(tips) - tips
    return made
