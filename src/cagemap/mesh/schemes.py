"""Subdivision schemes: options, and the masks (stencil weights) of each scheme.

Rules and options are those of OpenSubdiv (``Sdc::Options``), used by USD, Blender, Maya and Houdini.

.. [CC78] E. Catmull, J. Clark. Recursively generated B-spline surfaces on arbitrary topological meshes. 1978.
.. [Loop87] C. Loop. Smooth subdivision surfaces based on triangles. Master's thesis, University of Utah, 1987.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray

from cagemap.errors import ParameterError
from cagemap.numerics.arrays import FloatArray

Integers: TypeAlias = NDArray[np.integer]
Boundary = Literal["none", "edge_only", "edge_and_corner"]
UvInterpolation = Literal["none", "corners_only", "corners_plus1", "corners_plus2", "boundaries", "all"]
Creasing = Literal["uniform", "chaikin"]
TriangleRule = Literal["catmull_clark", "smooth"]

INFINITE_SHARPNESS = 10.0  # from here creases and corners are infinitely sharp; Blender's crease c is 10 c^2
# Crease curves are uniform cubic B-splines in both schemes: weights of the vertex and of each neighbour on the curve.
CREASE_VERTEX = (3 / 4, 1 / 8)
SMOOTH_TRIANGLE = 0.47  # weight of a triangle's new face point in the edge points around it under the "smooth" rule

# Values of each option, and the text that an error message adds.
_CHOICES = {
    "boundary": (get_args(Boundary), "USD's default is edge_and_corner, Blender's is edge_only"),
    "uv_interpolation": (get_args(UvInterpolation), "USD's default is corners_plus1, Blender's is boundaries"),
    "creasing": (get_args(Creasing), "uniform is the default everywhere"),
    "triangles": (get_args(TriangleRule), "catmull_clark is the default everywhere"),
}


@dataclass(frozen=True)
class SubdivisionOptions:
    """Options of a subdivision scheme that change the surface."""

    #: whether a boundary vertex with a single face is fixed (``edge_and_corner``, USD's default) or smoothed along the
    #: boundary curve like the others (``edge_only``). Under ``none`` faces at the boundary are holes: they influence
    #: the surface but are no part of it.
    boundary: Boundary = "edge_and_corner"
    #: where UVs are interpolated linearly: everywhere (``all``), on all island borders (``boundaries``), at island
    #: corners (``corners_only``, ``plus``: and at more or fewer similar points), nowhere (``none``). USD's default is
    #: ``corners_plus1``, Blender's ``boundaries``.
    uv_interpolation: UvInterpolation = "all"
    creasing: Creasing = "uniform"  #: sharpness only falls by 1 in a step; ``chaikin``: is also averaged along creases
    triangles: TriangleRule = "catmull_clark"  #: weights of triangles in edge points under Catmull-Clark

    def __post_init__(self) -> None:
        for name, (choices, remedy) in _CHOICES.items():
            value = getattr(self, name)
            if value not in choices:
                raise ParameterError(f"{name}: expected one of {', '.join(choices)}, got {value!r}; {remedy}")


class CatmullClark(SubdivisionOptions):
    """Catmull-Clark subdivision of polygon meshes [CC78]_."""

    @staticmethod
    def polygon_vertex_weights(valence: Integers) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Smooth rule ``((n - 2) n v + sum e_i + sum f_i) / n^2``: weights of vertex, neighbour, new face point."""
        n = np.asarray(valence, dtype=np.float64)
        return (n - 2) / n, 1 / n**2, 1 / n**2

    @staticmethod
    def vertex_weights(valence: Integers) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The same rule among quads: weights of the vertex, of each neighbour, of each diagonally opposite vertex."""
        n = np.asarray(valence, dtype=np.float64)
        return 1 - 7 / (4 * n), 3 / (2 * n**2), 1 / (4 * n**2)

    def face_edge_weights(self, sizes: Integers) -> FloatArray:
        """Weight of a new face point in an edge point, by face size, averaged over both sides."""
        smooth = (np.asarray(sizes) == 3) & (self.triangles == "smooth")
        return np.where(smooth, SMOOTH_TRIANGLE, 1 / 4)

    @staticmethod
    def edge_weights() -> tuple[float, float]:
        """The same rule among quads: weights of each end and of each of the four other vertices."""
        return 3 / 8, 1 / 16


class Loop(SubdivisionOptions):
    """Loop subdivision of triangle meshes [Loop87]_, with Loop's own cosine weight (OpenSubdiv's; not 3/(8n))."""

    @staticmethod
    def vertex_weights(valence: Integers) -> tuple[FloatArray, FloatArray]:
        """Smooth rule ``(1 - n b) v + b sum e_i``, ``b = (5/8 - (3/8 + cos(2 pi/n)/4)^2) / n``: both weights."""
        n = np.asarray(valence, dtype=np.float64)
        b = (5 / 8 - (3 / 8 + np.cos(2 * np.pi / n) / 4) ** 2) / n
        return 1 - n * b, b

    @staticmethod
    def edge_weights() -> tuple[float, float]:
        """Smooth edge rule: weights of each end and of each of the two vertices across."""
        return 3 / 8, 1 / 8


class Bilinear(SubdivisionOptions):
    """Midpoints on edges and centroids in faces without smoothing, USD's ``bilinear``; options have no effect."""


class Plain(Bilinear):
    """No subdivision: the faces of the mesh, such as a scan, are the surface; USD's ``none``."""


Scheme = CatmullClark | Loop | Bilinear

SCHEMES: dict[str, type[CatmullClark] | type[Loop] | type[Bilinear]] = {
    "catmull-clark": CatmullClark,
    "loop": Loop,
    "bilinear": Bilinear,
    "none": Plain,
}


def scheme_name(scheme: Scheme) -> str:
    """Name of a scheme in `SCHEMES`."""
    return next(name for name, kind in SCHEMES.items() if type(scheme) is kind)
