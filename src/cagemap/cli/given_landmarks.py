"""Landmarks and curves of the files that the user named, whatever their form."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from cagemap.errors import ParameterError
from cagemap.files.landmark_points import read_points
from cagemap.files.landmarks import read_landmarks
from cagemap.mesh import ControlMesh
from cagemap.mesh.landmarks import Landmarks, paired

if TYPE_CHECKING:
    from cagemap.cli.match import MatchRequest


def read_given_landmarks(
    request: MatchRequest, target: ControlMesh, source: ControlMesh
) -> tuple[Landmarks, tuple[str, ...]]:
    """Landmarks of the files given, with the curves of ``--curves`` beside theirs; and notes."""
    landmarks, notes = _read_points_or_pairs(request, target, source)
    if request.curves is None:
        return landmarks, notes
    more, more_notes = _read_pairs(request.curves, request)
    if len(more):
        raise ParameterError(f"--curves: expected curves alone, got landmarks in {request.curves}. Give --landmarks.")
    return replace(landmarks, curves=landmarks.curves.beside(more.curves)), (*notes, *more_notes)


def _read_pairs(path: Path, request: MatchRequest) -> tuple[Landmarks, tuple[str, ...]]:
    """A file of pairs, made for this direction or the other."""
    if request.exchange_landmarks:
        exchanged, notes = read_landmarks(path, request.source, request.target)
        return exchanged.reversed(), notes
    return read_landmarks(path, request.target, request.source)


def _read_points_or_pairs(
    request: MatchRequest, target: ControlMesh, source: ControlMesh
) -> tuple[Landmarks, tuple[str, ...]]:
    """Landmarks of a pair file, or of a file for each mesh, or none; and notes."""
    points = request.target_points, request.source_points
    if points[0] is not None and points[1] is not None and request.landmarks is None:
        return paired(read_points(points[0], target), read_points(points[1], source), target, source)
    if points != (None, None):
        raise ParameterError(
            "--target-points and --source-points: expected both, and no --landmarks beside them; landmarks are pairs "
            "of points of the same name, or come from one file of pairs."
        )
    if request.landmarks is None:
        return Landmarks.none(), ()
    return _read_pairs(request.landmarks, request)
