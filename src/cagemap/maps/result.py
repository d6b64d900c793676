"""Result of a match: it is written, read, updated, baked from and reported."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from cagemap.deform.problem import PreparedPair, Problem
from cagemap.errors import ParameterError
from cagemap.maps.functional_maps import LevelMap, functional_map_of
from cagemap.maps.hypotheses.confidence import Confidence, jump_lengths, jump_warnings
from cagemap.maps.landmarks.check import LandmarkCheck, LandmarkSuspect, foreign_warnings
from cagemap.maps.masks import WHOLE, Masks
from cagemap.maps.pair import CurveMiss, curve_miss, curve_pairs, point_pairs
from cagemap.maps.point_map import PointMap
from cagemap.maps.quality import QualityFigures, judge, measure_quality, unshared_warnings
from cagemap.mesh.landmarks import Landmarks
from cagemap.numerics.arrays import FloatArray, IndexArray, joined_runs
from cagemap.numerics.threads import in_threads, kept, one_blas_thread
from cagemap.spectral import Surface
from cagemap.subdivision.refinement import truncate_refinement

# Warning about masks that leave only area without a counterpart.
NOTHING_SHARED = (
    "none of the area that the masks leave has a counterpart on the other surface: look at the masks of both sides"
)


@dataclass(frozen=True, eq=False)
class SpectralMap:
    """Functional map between two bases, and their eigenvalues."""

    functional_map: FloatArray  # (k1, k2) C12, takes source coefficients to target coefficients
    target_eigenvalues: FloatArray  # (k1,) of the unit-area surface
    source_eigenvalues: FloatArray  # (k2,)

    def __repr__(self) -> str:
        return f"SpectralMap({self.functional_map.shape[0]} x {self.functional_map.shape[1]} functions)"


@dataclass(frozen=True, eq=False)
class MatchResult:
    """Dense map from target to source, with its inputs, checks and quality."""

    target: Surface  #: the surface that receives
    source: Surface  #: the surface that gives
    landmarks: Landmarks  #: all landmarks that were given, suspects included
    point_map: PointMap  #: T12: finest target vertices -> points of the finest source triangles
    quality: QualityFigures  #: quality measured without ground truth; landmark errors are those of the trusted pairs
    timings: dict[str, float] = field(default_factory=dict)  #: seconds of every stage
    landmark_check: LandmarkCheck = field(default_factory=LandmarkCheck)  #: pairs that were left out, and notes
    level_maps: tuple[LevelMap, ...] = ()  #: of every level, by the methods that go from level to level; see `at_level`
    confidence: Confidence | None = None  #: verdict and other answers; None if the landmarks determine the map
    prepared: PreparedPair | None = None  #: for `update_match` and `match_pair`, of this process ("elastic" only)
    masks: Masks = WHOLE  #: weights of both surfaces in the match and in transfers
    shared: Masks | None = None  #: 1 where vertices have a counterpart; None if both surfaces are closed
    known_spectral: SpectralMap | None = None  #: value of `spectral`, if it was read or follows from other maps
    provenance: dict[str, Any] = field(default_factory=dict)  #: further entries of the manifest: inputs, notes

    def __repr__(self) -> str:
        sides = f"target {self.target.control.name!r}, source {self.source.control.name!r}"
        return f"MatchResult({sides}, {len(self.triangle)} target vertices, {self.landmarks})"

    def __getstate__(self) -> dict[str, Any]:
        """Pickles and deep copies are like a result that was read: without the factorisations of this process."""
        return dict(vars(replace(self, prepared=None)))

    @kept
    def spectral(self) -> SpectralMap:
        """Functional map and eigenvalues of both bases: stored, from the method, or computed from the map."""
        if self.known_spectral is not None:
            return self.known_spectral
        with one_blas_thread():
            bases = in_threads(lambda surface: surface.basis, [self.target, self.source])
            if self.level_maps:
                functional_map = self.level_maps[-1].functional_map
            else:
                functional_map = functional_map_of(self.target, self.source, self.point_map)
        return SpectralMap(functional_map, *(basis.eigenvalues for basis in bases))

    def at_level(self, level: int) -> MatchResult:
        """Result with the map of one of the target's levels, to write, bake, draw and judge.

        Of several maps of this level the last one is used, with the finest source. ParameterError if none was found.
        """
        finest = self.target.refinement.finest_level
        if level == finest:
            return self
        plain = self.target.refinement.is_plain or self.source.refinement.is_plain
        known = {one.levels[0]: one for one in self.level_maps if one.points is not None and not plain}
        if level not in known:
            has = ", ".join(map(str, sorted({*known, finest})))
            raise ParameterError(
                f"level {level}: expected one of the target's levels with a map, {has}. The methods hfm and paper find "
                "one for each level that they go through, of surfaces that are subdivided"
            )
        level_map, points = known[level], known[level].points
        assert points is not None
        sides = zip((self.target, self.source), level_map.levels, strict=True)
        target, source = (Surface(truncate_refinement(side.refinement, on), side.config) for side, on in sides)
        point_map = PointMap.from_arrays(
            target.finest_triangles, source.finest_triangles, points.triangle, points.barycentric
        )
        quality = measure_quality(point_map, point_pairs(target, source, self.trusted))
        spectral = None
        if self.has_spectral:
            values = self.spectral.target_eigenvalues, self.spectral.source_eigenvalues
            cut = (all_of[:k] for all_of, k in zip(values, level_map.functional_map.shape, strict=True))
            spectral = SpectralMap(level_map.functional_map, *cut)
        return replace(
            self,
            target=target,
            source=source,
            point_map=point_map,
            quality=quality,
            level_maps=tuple(one for one in self.level_maps if all(np.less_equal(one.levels, level_map.levels))),
            confidence=None,
            prepared=None,
            masks=WHOLE,
            known_spectral=spectral,
        )

    @property
    def shared_shares(self) -> tuple[float, ...]:
        """Shares of the target's and the source's area with a counterpart; () if both surfaces are closed."""
        return () if self.shared is None else self.shared.shares(self.point_map.target, self.point_map.source)

    @property
    def has_spectral(self) -> bool:
        """Whether `spectral` is available without preparing a basis."""
        return self.known_spectral is not None or (self.target.is_prepared and self.source.is_prepared)

    @property
    def functional_map(self) -> FloatArray:
        """(k1, k2) C12, takes source coefficients to target coefficients; computed on first access."""
        return self.spectral.functional_map

    @property
    def suspects(self) -> tuple[LandmarkSuspect, ...]:
        """Landmark pairs that were left out of the map."""
        return self.landmark_check.suspects

    @property
    def trusted(self) -> Landmarks:
        """The landmarks without the suspects; the map meets them."""
        return self.landmark_check.trusted(self.landmarks)

    @kept
    def curve_misses(self) -> tuple[CurveMiss, ...]:
        """Distances between the image of every curve and its counterpart."""
        pairs = curve_pairs(self.target, self.source, self.landmarks.curves)
        return tuple(curve_miss(pair, self.point_map) for pair in pairs)

    @property
    def landmark_errors(self) -> FloatArray:
        """(p,) error of every landmark, of sqrt(source area), suspects included."""
        left_out = self.landmark_check.left_out
        errors = np.zeros(len(self.landmarks))
        errors[np.setdiff1d(np.arange(len(errors)), left_out)] = self.quality.landmark_errors
        errors[left_out] = [suspect.distance for suspect in self.suspects]
        return errors

    @property
    def source_triangles(self) -> IndexArray:
        """(t2, 3) vertices of the source triangles that `triangle` refers to."""
        return self.point_map.source.triangles

    @property
    def triangle(self) -> IndexArray:
        """(n1,) target vertex i maps to the point ``barycentric[i]`` of source triangle ``triangle[i]``."""
        return self.point_map.triangle

    @property
    def barycentric(self) -> FloatArray:
        """(n1, 3) barycentric coordinates of every image, see `triangle`."""
        return self.point_map.barycentric

    @property
    def trust(self) -> FloatArray:
        """(n1,) 1 where the map is locally unfolded and stretches little, 0 at folds."""
        return self.quality.trust

    @property
    def runner_up_images(self) -> FloatArray:
        """(r, n_0, 3) approximate images of the target's control vertices by other answers, in source file units."""
        count = self.target.control.n_vertices
        other_answers = self.confidence.answers[1:] if self.confidence else ()
        known = [
            other.positions[:count] / self.source.scale for other in other_answers if len(other.positions) >= count
        ]
        return np.array(known).reshape(len(known), count, 3)

    def nearest_vertices(self) -> IndexArray:
        """(n_0,) source control vertex nearest to every target control vertex's image, within its face.

        Vertices are numbered as in the control meshes. For finest levels see `PointMap.nearest_vertices`.
        """
        control, count = self.source.control, self.target.control.n_vertices
        triangles_per_face = len(self.source_triangles) // len(self.source.faces)
        faces = self.source.refinement.finest.face_parents[self.triangle[:count] // triangles_per_face]
        sizes = control.face_sizes[faces]
        offsets, face_corners = joined_runs(control.face_offsets[faces], sizes)
        owners, corners = np.repeat(np.arange(count), sizes), control.face_indices[face_corners]
        source_positions, images = self.point_map.source.positions, self.point_map.images.positions
        away = np.linalg.norm(source_positions[corners] - images[owners], axis=1)
        return np.asarray(corners[np.lexsort((away, owners))[offsets[:-1]]])

    def image(self) -> FloatArray:
        """(n1, 3) image of every target vertex, in source file units."""
        return self.point_map.images.interpolate(self.source.vertices)

    @property
    def manifest(self) -> dict[str, Any]:
        """Entries of the manifest: quality, checks, timings, provenance."""
        shares = self.shared_shares
        return {
            "quality": self.quality.summary(),
            "landmark_check": self.landmark_check.summary(),
            "confidence": None if self.confidence is None else self.confidence.summary(),
            **({"shared_area": dict(zip(("target", "source"), shares, strict=True))} if shares else {}),
            "curves": [asdict(miss) for miss in self.curve_misses],
            "timings": dict(self.timings),
            "bases": {"target": asdict(self.target.config), "source": asdict(self.source.config)},
            **self.provenance,
        }


def shared_area_warnings(shared: Masks | None, masks: Masks, point_map: PointMap) -> tuple[str, ...]:
    """Warnings about area without a counterpart, and about masks that leave only such area."""
    if shared is None:
        return ()
    unshared = unshared_warnings(*shared.shares(point_map.target, point_map.source))
    return (NOTHING_SHARED, *unshared) if masks.any and masks.within(shared) is masks else unshared


def result_of_fit(
    problem: Problem,
    point_map: PointMap,
    landmarks: Landmarks,
    check: LandmarkCheck,
    timings: dict[str, float],
    shared: Masks | None,
    confidence: Confidence | None = None,
    jumps: FloatArray | None = None,
) -> MatchResult:
    """Result of an elastic match of a problem with all landmarks; ``jumps`` are `jump_lengths`, None if not known."""
    start = time.perf_counter()
    prepared, target, source = problem.prepared, problem.prepared.target, problem.prepared.source
    masks, points = prepared.masks, problem.without(check.left_out).landmarks
    with one_blas_thread():
        jumps = jump_lengths(prepared, point_map, shared) if jumps is None else jumps
        jumping = jump_warnings(prepared, jumps)
        counted = masks.within(shared)
        quality = judge(target, point_map, points, counted)
        unshared = shared_area_warnings(shared, masks, point_map)
        foreign = foreign_warnings(quality.flipped_area, len(landmarks), len(check.suspects))
        quality = replace(
            quality, warnings=(*jumping, *quality.warnings, *unshared, *foreign), match_warnings=(*jumping, *foreign)
        )
    return MatchResult(
        target,
        source,
        landmarks,
        point_map,
        quality,
        {**timings, "quality": time.perf_counter() - start},
        check,
        confidence=confidence,
        prepared=prepared,
        masks=masks,
        shared=shared,
    )
