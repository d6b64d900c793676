"""The maps of all levels in a RESULT folder, of the methods that go from level to level.

The last one's points and functional map are those of the result itself; of it only the vertex matches are stored here.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from cagemap.errors import FormatError
from cagemap.files.npz import ArraySpec, check_arrays, lie_in_triangles
from cagemap.files.schema import LevelMapRecord
from cagemap.maps.level_map import LevelMap
from cagemap.maps.point_map import PointMap
from cagemap.maps.result import MatchResult
from cagemap.numerics.arrays import FloatArray
from cagemap.spectral import Surface


def stored_levels(result: MatchResult) -> tuple[LevelMap, ...]:
    """The maps that are stored; none where a side is a plain mesh, whose coarse levels no file knows."""
    if result.target.refinement.is_plain or result.source.refinement.is_plain or not result.has_spectral:
        return ()
    if any(found.points is None for found in result.level_maps):
        return ()
    return result.level_maps


def level_entries(result: MatchResult) -> list[dict[str, int]]:
    """What a manifest says of them."""
    return [{"target": found.levels[0], "source": found.levels[1]} for found in stored_levels(result)]


def level_arrays(result: MatchResult) -> dict[str, NDArray[Any]]:
    """Vertex matches of all of them; functional map, triangles and barycentric coordinates of all but the last."""
    arrays: dict[str, NDArray[Any]] = {}
    maps = stored_levels(result)
    for i, found in enumerate(maps):
        arrays[f"level_{i}_match"] = found.match
        if found is not maps[-1] and found.points is not None:
            arrays[f"level_{i}_functional_map"] = found.functional_map
            arrays[f"level_{i}_triangle"] = found.points.triangle
            arrays[f"level_{i}_barycentric"] = found.points.barycentric
    return arrays


def read_level_maps(
    path: Path,
    stored: dict[str, NDArray[Any]],
    entries: list[LevelMapRecord],
    surfaces: tuple[Surface, Surface],
    point_map: PointMap,
    functional_map: FloatArray | None,
    remedy: str,
) -> tuple[LevelMap, ...]:
    """The maps that `level_arrays` wrote, the result's own last."""
    if functional_map is None or not entries:
        return ()
    target, source = surfaces
    levels = [(entry.target, entry.source) for entry in entries]
    finest = target.refinement.n_levels, source.refinement.n_levels
    if levels[-1] != finest or any(one > finest[0] or other > finest[1] for one, other in levels):
        raise FormatError(f"{path}: expected levels of maps that end at {finest}, the manifest has {levels}. {remedy}")
    maps = []
    for i, entry in enumerate(entries):
        last = i == len(entries) - 1
        sides = target.triangles(entry.target), source.triangles(entry.source)
        specs = {f"level_{i}_match": ArraySpec(("n1",), below="n2")}
        if not last:
            specs |= {
                f"level_{i}_functional_map": ArraySpec((f"k1_{i}", f"k2_{i}")),
                f"level_{i}_triangle": ArraySpec(("n1",), below="t2"),
                f"level_{i}_barycentric": ArraySpec(("n1", 3)),
            }
        sizes = {"n1": sides[0].n, "n2": sides[1].n, "t2": len(sides[1].triangles)}
        arrays = check_arrays(path, stored, specs, sizes, remedy)
        points, c = point_map, functional_map
        if not last:
            c = arrays[f"level_{i}_functional_map"]
            places = arrays[f"level_{i}_triangle"], arrays[f"level_{i}_barycentric"]
            if not lie_in_triangles(places[1]):
                raise FormatError(f"{path}: level_{i}_barycentric lie outside their triangles. {remedy}")
            points = PointMap.from_arrays(*sides, *places)
        maps.append(LevelMap((entry.target, entry.source), c, arrays[f"level_{i}_match"], points))
    return tuple(maps)
