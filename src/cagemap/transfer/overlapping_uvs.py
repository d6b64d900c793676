"""Measure overlaps of UV layouts: mirrored halves, or materials with separate images."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cagemap.mesh import ControlMesh
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.transfer.texels import lay_out, rasterize_band
from cagemap.transfer.texture import OVERHANG, tile_cells

# Texels per side of the raster. Tiles are rotated so that no edge of a layout runs along rows of texels: counts of
# texels along such edges would be biased.
_RASTER = 704
_DIRECTION = np.array([1.0, (np.sqrt(5.0) - 1.0) / 2.0])
_ROTATION = np.array([_DIRECTION, _DIRECTION[::-1] * [-1.0, 1.0]]) / _DIRECTION.sum()
_TEXELS = _RASTER**2 * np.linalg.det(_ROTATION)  # texels in the area of a tile
# Layouts with more tiles are taken for repeated textures.
_MAX_TILES = 64


def overlapping_share(control: ControlMesh, ignored: NDArray[np.bool_] | None = None) -> float:
    """Share of a layout's area that overlaps other parts of it; 0 without UVs.

    Faces across several tiles, as with repeated textures, are ignored, and those of ``ignored`` (m,).
    """
    corners, faces = control.uv_corners()
    if ignored is not None:
        corners, faces = corners[~ignored[faces]], faces[~ignored[faces]]
    masks = _covered(corners)
    inside = np.concatenate([chosen for chosen, _ in masks]) if masks else np.zeros(0, dtype=np.int64)
    a, b = corners[inside, 1] - corners[inside, 0], corners[inside, 2] - corners[inside, 0]
    # The fan of a polygon that is not convex has triangles of both signs.
    areas = np.abs(np.bincount(faces[inside], 0.5 * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])))
    covered = sum(np.count_nonzero(mask) for _, mask in masks) / _TEXELS
    return max(0.0, 1.0 - covered / areas.sum()) if areas.sum() > 0 else 0.0


def overlapping_materials(control: ControlMesh, min_share: float) -> tuple[str, ...]:
    """Names of materials whose layout overlaps that of other materials by more than ``min_share``."""
    if control.face_materials is None or len(control.material_names) < 2:
        return ()
    corners, faces = control.uv_corners()
    materials = control.face_materials[faces]
    owners: dict[tuple[float, float], list[tuple[int, NDArray[np.bool_]]]] = {}
    for material in np.unique(materials).tolist():
        material_corners = corners[materials == material]
        for chosen, mask in _covered(material_corners):
            u, v = tile_cells(material_corners[chosen[:1]])[0].tolist()
            owners.setdefault((u, v), []).append((material, mask))
    overlapping = np.zeros(len(control.material_names))
    covered = np.zeros(len(control.material_names))
    for tile in owners.values():
        several = sum(mask.astype(np.int64) for _, mask in tile) > 1
        for material, mask in tile:
            overlapping[material] += np.count_nonzero(mask & several)
            covered[material] += np.count_nonzero(mask)
    return tuple(
        name
        for name, part, whole in zip(control.material_names, overlapping, covered, strict=True)
        if part > min_share * whole
    )


def _covered(corners: FloatArray) -> list[tuple[IndexArray, NDArray[np.bool_]]]:
    """For every tile: its triangles, and the mask of texels of the rotated tile that they cover."""
    cells = tile_cells(corners) if len(corners) else np.zeros((0, 2))
    places = corners - cells[:, None]
    within = np.flatnonzero(((places > -OVERHANG) & (places < 1.0 + OVERHANG)).all(axis=(1, 2)))
    tiles, owner = np.unique(cells[within], axis=0, return_inverse=True)
    if len(tiles) > _MAX_TILES:
        return []
    masks = []
    for tile in range(len(tiles)):
        chosen = within[owner.ravel() == tile]
        no_borders = np.zeros((len(chosen), 3), dtype=np.int32)
        rotated = (places[chosen] - 0.5) @ _ROTATION.T + 0.5
        layout = lay_out(rotated, no_borders, _RASTER, _RASTER, band_rows=_RASTER, gutter=0.0)
        masks.append((chosen, rasterize_band(layout, 0) >= 0))
    return masks
