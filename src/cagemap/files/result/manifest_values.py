"""Values of a match from the records of its manifest."""

from __future__ import annotations

from typing import Any

import numpy as np

from cagemap.deform.placement import Placement
from cagemap.files.schema import BasisRecord, ConfidenceRecord, LandmarkCheckRecord, QualityRecord
from cagemap.maps.hypotheses.confidence import LOOK, SURE, Confidence
from cagemap.maps.hypotheses.signs import findings
from cagemap.maps.landmarks.check import LandmarkCheck, LandmarkSuspect
from cagemap.maps.point_map import PointMap
from cagemap.maps.quality import QualityFigures
from cagemap.mesh.landmarks import CagePoints, Landmarks
from cagemap.numerics.arrays import FloatArray
from cagemap.spectral import BasisConfig
from cagemap.spectral.config import MAP_BASIS


def stored_basis(record: BasisRecord | None, count: int | None) -> BasisConfig:
    """How a surface was prepared; of a result that does not say, with as many functions as it has eigenvalues."""
    if record is None:
        return MAP_BASIS if not count else BasisConfig(count=count)
    schedule = None if record.schedule is None else tuple(record.schedule)
    accuracy = BasisConfig.accuracy if record.accuracy is None else record.accuracy  # None in older results
    return BasisConfig(
        record.count, schedule, accuracy, record.literal, record.vertices, record.laplacian, record.stabilisation
    )


def stored_landmarks(names: list[str], points: tuple[CagePoints, CagePoints], meshes: tuple[str, str]) -> Landmarks:
    """Landmarks at points of both meshes; without names they are numbered."""
    titles = tuple(names) or tuple(f"pair {i}" for i in range(len(points[0].corners)))
    return Landmarks.of_points(titles, *points, *meshes)


def stored_check(record: LandmarkCheckRecord | None, errors: FloatArray) -> LandmarkCheck:
    """What was found about landmarks, whose errors (p,) are those of all pairs."""
    if record is None:
        return LandmarkCheck()
    suspects = tuple(
        LandmarkSuspect(s.name, s.pair, float(errors[s.pair]), s.nearest_vertex, s.source_vertex, s.evidence)
        for s in record.suspects
    )
    return LandmarkCheck(suspects, tuple(record.notes))


def stored_quality(
    record: QualityRecord | None, check: LandmarkCheck, errors: FloatArray, trust: FloatArray
) -> QualityFigures:
    """Figures of a map, whose landmark errors (p,) are those of all pairs."""
    trusted = np.setdiff1d(np.arange(len(errors)), [suspect.pair for suspect in check.suspects])
    summary: dict[str, Any] = {} if record is None else record.model_dump()
    return QualityFigures.of_summary(summary, errors[trusted], trust)


def stored_confidence(
    record: ConfidenceRecord | None, answer: PointMap, controls: int, others: FloatArray
) -> Confidence | None:
    """The verdict on an answer; no longer sure where a sign is beyond the bound of now, or none was written.

    Parameters
    ----------
    record : ConfidenceRecord or None
    answer : PointMap
    controls : int
        Control vertices n_0 of the target.
    others : (r, n_0, 3) float64
        Where the other answers put them, in the file's lengths.
    """
    if record is None:
        return None
    places = [answer.images.at(slice(controls)).positions, *(answer.source.scale * other for other in others)]
    nowhere = np.zeros((0, 3))
    readings = tuple(
        Placement(
            places[i] if i < len(places) else nowhere,
            1e-4 * reading.cost,
            name=reading.name,
            exchange=tuple((a, b) for a, b in reading.exchange),
        )
        for i, reading in enumerate(record.readings)
    )
    doubtful = record.verdict == SURE and (record.signs is None or findings(record.signs))
    verdict = LOOK if doubtful else record.verdict
    return Confidence(verdict, readings, record.signs or {}, record.deciding, record.file_vertex, record.part)


# Mean distance, of sqrt(area), from which a curve counts as missed.
_CURVE_MISSED = 0.005


def assurance(manifest: dict[str, Any]) -> str:
    """What a manifest says of a map with few landmarks or none that is sure, which warns of nothing; else nothing."""
    confidence = manifest.get("confidence") or {}
    return str(confidence.get("message", "")) if confidence.get("verdict") == SURE else ""


def landmark_messages(manifest: dict[str, Any]) -> list[str]:
    """What a manifest warns of about landmarks: a map that is not sure without them, what is left out or missed."""
    check, confidence = manifest.get("landmark_check") or {}, manifest.get("confidence") or {}
    doubt = [str(confidence["message"])] if "message" in confidence and not assurance(manifest) else []
    left_out = [str(suspect["message"]) for suspect in check.get("suspects", [])]
    missed = [
        f"curve '{curve['name']}' is missed by {100 * curve['mean']:.1f} % of the model's size (at most "
        f"{100 * curve['worst']:.0f} %): it contradicts other landmarks or the shapes; look at it in the report"
        for curve in manifest.get("curves") or []
        if curve["mean"] > _CURVE_MISSED
    ]
    return doubt + left_out + missed + list(map(str, check.get("notes", [])))
