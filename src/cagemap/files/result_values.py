"""What a RESULT folder holds, as values: two surfaces, the map between them, and what is known about it."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from cagemap.geometry.surface import TriangleSurface
from cagemap.maps.masks import Masks
from cagemap.maps.point_map import PointMap
from cagemap.mesh import ControlMesh
from cagemap.mesh.curves import Curves
from cagemap.mesh.landmarks import CagePoints
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.refinement import Refinement, Scheme, refine, triangles

if TYPE_CHECKING:  # reading a result needs no solvers
    from cagemap.pipeline import MatchResult


@dataclass(frozen=True, eq=False)
class Side:
    """One of the two surfaces of a result.

    Attributes
    ----------
    control : ControlMesh
        In the file's own units, like ``vertices``.
    scheme : CatmullClark or Loop
    level : int
        Level of ``vertices`` and ``faces``; vertex i of a level is vertex i of every finer one.
    vertices : (n, 3) float64
    faces : (m, 4) or (m, 3) int64
    eigenvalues : (k,) float64
        Of the unit-area surface.
    landmarks : (p,) int64
        Control vertices, in the order of the other side's; the nearest where a landmark lies between them.
    landmark_points : CagePoints, optional
        Where the landmarks lie, if some lie between control vertices.
    mask : (n,) float64, optional
        How much every vertex counts, where not all of the surface does.
    """

    control: ControlMesh
    scheme: Scheme
    level: int
    vertices: FloatArray
    faces: IndexArray
    eigenvalues: FloatArray
    landmarks: IndexArray
    landmark_points: CagePoints | None = None
    mask: FloatArray | None = None

    @cached_property
    def refinement(self) -> Refinement:
        """Every level again, with UVs: cheap, the same numbers as in the match, and made when it is first asked for."""
        return refine(self.control, self.level, self.scheme)


@dataclass(frozen=True, eq=False)
class Result:
    """A dense map between two refined surfaces, as it is stored.

    Attributes
    ----------
    target, source : Side
        The surface that receives, and the one that gives.
    source_triangles : (t2, 3) int64
        Source vertices of every triangle that ``triangle`` counts.
    triangle : (n1,) int64
        Target vertex i maps to the point ``barycentric[i]`` of source triangle ``triangle[i]``.
    barycentric : (n1, 3) float64
    functional_map : (k1, k2) float64
        C12: source coefficients to target coefficients.
    trust : (n1,) float64
        1 where the map is locally unfolded and stretches little, 0 at folds.
    landmark_errors : (p,) float64
        Of sqrt(source area); also of pairs that the map left out, which the manifest's ``landmark_check`` names.
    landmark_names : tuple of str
    runner_up_images : (r, n_0, 3) float64
        Where the r other answers of a match without landmarks put the target's control vertices, about, in the source
        file's units; the manifest's ``confidence`` names them.
    curves : Curves
        Lines that correspond; the manifest's ``curves`` says how far the map leads one from the other.
    manifest : dict
        What ``manifest.json`` holds: versions, parameters, input hashes, timings in seconds, quality figures.
    """

    target: Side
    source: Side
    source_triangles: IndexArray
    triangle: IndexArray
    barycentric: FloatArray
    functional_map: FloatArray
    trust: FloatArray
    landmark_errors: FloatArray
    landmark_names: tuple[str, ...] = ()
    runner_up_images: FloatArray = field(default_factory=lambda: np.zeros((0, 0, 3)))
    curves: Curves = field(default_factory=Curves.none)
    manifest: dict[str, Any] = field(default_factory=dict)

    @cached_property
    def point_map(self) -> PointMap:
        """The map as a value that knows both surfaces."""
        target, source = (TriangleSurface.from_faces(side.vertices, side.faces) for side in (self.target, self.source))
        return PointMap.from_arrays(target, source, self.triangle, self.barycentric)

    @property
    def masks(self) -> Masks:
        """What of both surfaces was matched, and is transferred."""
        return Masks(self.target.mask, self.source.mask)

    def image(self) -> FloatArray:
        """(n1, 3) where every target vertex maps to, in the source file's units."""
        corners = self.source.vertices[self.source_triangles[self.triangle]]
        return np.einsum("nc,ncd->nd", self.barycentric, corners)


def result_of(match: MatchResult, manifest: dict[str, Any] | None = None) -> Result:
    """What of a match is stored.

    Parameters
    ----------
    manifest : dict, optional
        More entries for the manifest, such as input hashes, parameters and further timings.
    """
    quality = match.quality
    left_out = [suspect.pair for suspect in match.suspects]
    errors = np.zeros(len(match.landmarks))
    errors[np.setdiff1d(np.arange(len(errors)), left_out)] = quality.landmark_errors
    errors[left_out] = [suspect.distance for suspect in match.suspects]
    sides = [
        Side(
            control=surface.control,
            scheme=surface.refinement.scheme,
            level=surface.finest,
            vertices=surface.refinement.finest.positions,
            faces=np.asarray(surface.refinement.finest.faces),
            eigenvalues=surface.basis.eigenvalues,
            landmarks=landmarks.nearest_vertices,
            landmark_points=landmarks if np.any(landmarks.vertices < 0) else None,
            mask=mask,
        )
        for surface, landmarks, mask in (
            (match.target, match.landmarks.target_points, match.masks.target),
            (match.source, match.landmarks.source_points, match.masks.source),
        )
    ]
    return Result(
        target=sides[0],
        source=sides[1],
        source_triangles=triangles(sides[1].faces),
        triangle=match.point_map.triangle,
        barycentric=match.point_map.barycentric,
        functional_map=match.functional_map,
        trust=quality.trust,
        landmark_errors=errors,
        landmark_names=match.landmarks.names,
        runner_up_images=_runner_up_images(match),
        curves=match.landmarks.curves,
        manifest={
            "quality": quality.summary(),
            "landmark_check": match.landmark_check.summary(),
            "confidence": None if match.confidence is None else match.confidence.summary(),
            "curves": [asdict(miss) for miss in match.curve_misses],
            "timings": dict(match.timings),
        }
        | (manifest or {}),
    )


def _runner_up_images(match: MatchResult) -> FloatArray:
    """(r, n_0, 3) see `Result`."""
    count = match.target.control.n_vertices
    others = match.confidence.readings[1:] if match.confidence else ()
    scale = match.source.operators.scale
    return np.array([other.positions[:count] / scale for other in others]).reshape(len(others), count, 3)


# Mean distance, of sqrt(area), from which a curve counts as missed.
_CURVE_MISSED = 0.005


def landmark_messages(manifest: dict[str, Any]) -> list[str]:
    """Sentences of a manifest about landmarks: how sure a map without them is, what is left out or missed, notes."""
    check, confidence = manifest.get("landmark_check") or {}, manifest.get("confidence") or {}
    sure = [str(confidence["message"])] if "message" in confidence else []
    left_out = [str(suspect["message"]) for suspect in check.get("suspects", [])]
    missed = [
        f"curve '{curve['name']}' is missed by {100 * curve['mean']:.1f} % of the model's size (at most "
        f"{100 * curve['worst']:.0f} %): it contradicts other landmarks or the shapes; look at it in the report"
        for curve in manifest.get("curves") or []
        if curve["mean"] > _CURVE_MISSED
    ]
    return sure + left_out + missed + list(map(str, check.get("notes", [])))
