"""Landmark files (JSON): pairs of 0-based control vertices or points of two meshes, and pairs of curves."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any
from unicodedata import normalize

import numpy as np

from cagemap.errors import DirectionError, FormatError
from cagemap.files.atomic import write_whole
from cagemap.files.landmarks.curves import pair_curves, pair_entries
from cagemap.files.ownership import mark
from cagemap.files.text import read_text, whole_characters
from cagemap.mesh.cage_points import CagePoints
from cagemap.mesh.landmarks import Landmarks
from cagemap.numerics.arrays import shown
from cagemap.numerics.kinds import kinds_checked

_FORM = (
    '{"source": "a.obj", "target": "b.obj", "pairs": [{"name": "nose", "source": 3, "target": 7}, ...]}, or '
    '{"corners": [3, 4, 9], "weights": [0.2, 0.5, 0.3]} in place of a vertex'
)
# Tolerance of weights: their sum may differ from 1 by this, and they may be as negative.
_WEIGHT_ROUNDING = 1e-4

End = tuple[tuple[int, int, int], tuple[float, float, float]]


@kinds_checked
def read_landmarks(path: str | Path, target: str | Path, source: str | Path) -> tuple[Landmarks, tuple[str, ...]]:
    """Read a landmark file for a map from a target mesh to a source mesh.

    Parameters
    ----------
    path : path
        The JSON file.
    target, source : str or path
        Names of the two meshes; folders and extensions are not compared.

    Returns
    -------
    landmarks : Landmarks
        The pairs of the file, not yet checked against the meshes (`cagemap.mesh.landmarks.check_landmarks`).
    notes : tuple of str
        Notes for the report, such as that the file names other meshes. This is no error: the same landmarks serve
        every pose or identity of a cage.

    Raises
    ------
    FormatError
        If the file has another form; the message names the pair by its number.
    DirectionError
        If the file names the two meshes in exchanged order.
    """
    file = Path(path)
    landmarks = parse_landmarks(file, _parse(file, read_text(file, "a landmark file")))
    return landmarks, _compare_names(file, landmarks, str(target), str(source))


def parse_landmarks(file: Path, data: dict[str, Any]) -> Landmarks:
    """Landmarks from the parsed JSON of a landmark file."""
    pairs = [_pair(file, number, item) for number, item in enumerate(data.get("pairs", []))]
    return Landmarks.of_points(
        tuple(name for name, _, _ in pairs),
        _points([target for _, target, _ in pairs]),
        _points([source for _, _, source in pairs]),
        _mesh_name(file, data, "target"),
        _mesh_name(file, data, "source"),
        pair_curves(file, data.get("curves", [])),
    )


def format_pairs(landmarks: Landmarks) -> list[str]:
    """Entries of all pairs as JSON."""
    ends = zip(landmarks.names, _ends(landmarks.source_points), _ends(landmarks.target_points), strict=True)
    return [
        json.dumps({"name": name, "source": source, "target": target}, ensure_ascii=False)
        for name, source, target in ends
    ]


def write_landmarks(path: str | Path, landmarks: Landmarks, *, force: bool = False) -> None:
    """Write a landmark file."""
    listed = ",\n  ".join(pair_entries(path, landmarks.curves))
    curves = f',\n "curves": [\n  {listed}\n ]' if listed else ""
    names = f'"source": {json.dumps(landmarks.source_name)}, "target": {json.dumps(landmarks.target_name)}'
    pairs = ",\n  ".join(format_pairs(landmarks))
    head = f'{{"written_by": "{mark()}",\n {names},\n "pairs": [\n  '
    write_whole(path, f"{head}{pairs}\n ]{curves}}}\n", force=force)


def _parse(path: Path, text: str) -> dict[str, Any]:
    try:
        data = json.loads(text)
    except json.JSONDecodeError as error:
        raise FormatError(
            f"{path}, line {error.lineno}: expected JSON, got a mistake there ({error.msg}). The form is {_FORM}."
        ) from None
    except (ValueError, RecursionError):
        raise FormatError(f"{path}: expected a landmark file, got JSON that cannot be. The form is {_FORM}.") from None
    if isinstance(data, dict) and "pairs" not in data and isinstance(data.get("curves"), list):
        return data
    if not isinstance(data, dict) or not isinstance(data.get("pairs"), list):
        raise FormatError(f"{path}: expected an object with a list 'pairs', found none. The form is {_FORM}.")
    return data


def _mesh_name(path: Path, data: dict[str, Any], side: str) -> str:
    name = data.get(side, "")
    if not isinstance(name, str):
        raise FormatError(f"{path}: expected the file name of the {side} mesh, got {shown(name)}. The form is {_FORM}.")
    return whole_characters(name)


def _pair(path: Path, number: int, item: Any) -> tuple[str, End, End]:
    """Name of a pair, its point on the target and its point on the source."""
    if not isinstance(item, dict):
        raise FormatError(
            f"{path}: pair {number} (0-based): expected an object, got {shown(item)}. The form is {_FORM}."
        )
    name = item.get("name", f"pair {number}")
    if not isinstance(name, str):
        raise FormatError(f"{path}: pair {number} (0-based): expected a name, got {shown(name)}. Put it in quotes.")
    ends = []
    for side in ("target", "source"):
        end = _end(item.get(side))
        if end is None:
            raise FormatError(
                f"{path}: pair {number} (0-based), '{name}': expected a whole vertex number, or the three corners "
                f"and weights of a point, as '{side}', got {shown(item.get(side))}. Numbers are 0-based control "
                "vertices; weights are not negative and sum to 1."
            )
        ends.append(end)
    return whole_characters(name), ends[0], ends[1]


def _end(value: Any) -> End | None:
    """Corners and weights of one point of a pair; None if the value is neither a vertex nor a point."""
    if _is_vertex(value):
        return (value, value, value), (1.0, 0.0, 0.0)
    corners, weights = (value.get(key) if isinstance(value, dict) else None for key in ("corners", "weights"))
    if not (isinstance(corners, list) and isinstance(weights, list) and len(corners) == len(weights) == 3):
        return None
    if not all(map(_is_vertex, corners)) or not all(isinstance(w, int | float) for w in weights):
        return None
    if (
        not all(-_WEIGHT_ROUNDING <= w <= 1 + _WEIGHT_ROUNDING for w in weights)
        or abs(sum(weights) - 1) > _WEIGHT_ROUNDING
    ):
        return None
    a, b, c = (max(0.0, float(w)) for w in weights)
    total = a + b + c
    return (corners[0], corners[1], corners[2]), (a / total, b / total, c / total)


def _is_vertex(value: Any) -> bool:
    # In Python, JSON's true and false are integers.
    return isinstance(value, int) and not isinstance(value, bool) and abs(value) < 2**63


def _points(ends: list[End]) -> CagePoints:
    corners = np.array([corners for corners, _ in ends], dtype=np.int64).reshape(-1, 3)
    return CagePoints(corners, np.array([weights for _, weights in ends], dtype=np.float64).reshape(-1, 3))


def _ends(points: CagePoints) -> list[int | dict[str, Any]]:
    """Entries of points for JSON: the number of a vertex, or corners and weights."""
    return [
        vertex if vertex >= 0 else {"corners": corners, "weights": weights}
        for vertex, corners, weights in zip(
            points.vertices.tolist(), points.corners.tolist(), points.weights.tolist(), strict=True
        )
    ]


def _compare_names(path: Path, landmarks: Landmarks, target: str, source: str) -> tuple[str, ...]:
    """Refuse exchanged meshes; returns notes on names that differ."""
    file_target, file_source = _stem(landmarks.target_name), _stem(landmarks.source_name)
    if not file_target or not file_source:
        return (f"{path.name} does not name its two meshes, so the direction of its pairs could not be checked",)
    here_target, here_source = _stem(target), _stem(source)
    if file_target == here_target and file_source == here_source:
        return ()
    # Exchanged are meshes if both names are those of the other side; or, for two different cages, if more names match
    # crossed than straight, or both cages do. A name up to the first '_' is the cage's by custom (base_neutral.obj).
    one_cage = _cage(here_target) == _cage(here_source)
    crossed = (file_source == here_target) + (file_target == here_source)
    straight = (file_target == here_target) + (file_source == here_source)
    crossed_cages = _cage(file_source) == _cage(here_target) and _cage(file_target) == _cage(here_source)
    if crossed == 2 or (not one_cage and (crossed_cages or crossed > straight)):
        raise DirectionError(
            f"{path}: expected landmarks for target {Path(target).name} and source {Path(source).name}, got target "
            f"{landmarks.target_name} and source {landmarks.source_name}, which is the other way round. Exchange "
            "target and source, or use the pairs reversed (`Landmarks.reversed()`)."
        )
    return (
        f"{path.name} was made for target {landmarks.target_name} and source {landmarks.source_name} and is used for "
        f"{Path(target).name} and {Path(source).name}; this is right if the vertices are numbered alike, as in other "
        "poses or identities of the same cage",
    )


def _stem(name: str) -> str:
    return Path(normalize("NFC", name).replace("\\", "/")).stem.casefold()


def _cage(stem: str) -> str:
    return stem.partition("_")[0]
