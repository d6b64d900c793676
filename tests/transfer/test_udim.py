"""UDIM sets in and out, and what overhangs a tile."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from examples.shapes import grid

from cagemap.files.images.image import (
    read_image_form,
    read_texture,
    texture_files,
    tile_pattern,
    udim_path,
    write_image,
)
from cagemap.maps.point_map import PointMap
from cagemap.mesh import ControlMesh
from cagemap.subdivision import refine
from cagemap.surface.triangle_surface import TriangleSurface
from cagemap.tasks.bake_tiles import layout_tiles
from cagemap.transfer import prepare_transfer, target_tiles
from cagemap.transfer.texture import OVERHANG, tile_cells
from cagemap.transfer.textured_surface import TexturedSurface


def _tiled_grid(columns: int, rows: int, margin: float = 0.02) -> ControlMesh:
    """A bent grid whose faces lie in a UDIM tile each."""
    mesh = grid(columns, rows)
    unit = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]]) * (1 - 2 * margin) + margin
    uvs = np.concatenate([unit + np.array([face % columns, face // columns]) for face in range(mesh.n_faces)])
    x, y = mesh.positions[:, 0], mesh.positions[:, 1]
    bent = np.column_stack([x, y, 0.3 * np.sin(x) * np.cos(y)])
    return mesh.with_positions(bent).with_uvs(uvs, np.arange(4 * mesh.n_faces))


def _noise(size: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (size, size, 3), dtype=np.uint8)


def test_what_overhangs_a_tile_by_a_rounding_does_not_become_two() -> None:
    mesh = _tiled_grid(2, 1, margin=0.0)
    level = refine(mesh, 5).finest
    assert target_tiles(TexturedSurface.from_level(level)) == [1001, 1002]
    for shift in (1e-7, -1e-7, 0.4 * OVERHANG):
        moved = refine(mesh.with_uvs(mesh.uvs + np.array([shift, 0]), mesh.uv_indices), 5).finest
        assert target_tiles(TexturedSurface.from_level(moved)) == [1001, 1002]
    single = _tiled_grid(1, 1, margin=0.0)
    grown = refine(single.with_uvs((single.uvs - 0.5) * (1 + OVERHANG) + 0.5, single.uv_indices), 8).finest
    assert target_tiles(TexturedSurface.from_level(grown)) == [0]
    across = np.array([[[0.4, 0.5], [1.4, 0.5], [1.2, 0.9]], [[-1e-6, 0], [0, 1e-6], [0, 0]]])
    np.testing.assert_array_equal(tile_cells(across), [[1, 0], [0, 0]])


@pytest.mark.parametrize("hole", [False, True])
def test_faces_that_get_no_texels_do_not_turn_tiles_off(hole: bool) -> None:
    mesh = _tiled_grid(3, 1)
    uvs = mesh.uvs.copy()
    uvs[:4] = [-0.1, -0.1] if not hole else uvs[:4] - 1.0
    level = refine(mesh.with_uvs(uvs, mesh.uv_indices), 2).finest
    surfaces = [TriangleSurface.from_faces(level.positions, level.faces)] * 2
    point_map = PointMap.from_vertices(*surfaces, np.arange(level.n_vertices))
    transfer = prepare_transfer(level, level, point_map, holes=level.face_parents == 0 if hole else None)
    assert layout_tiles(transfer) == ([1002, 1003], [])


def test_both_spellings_of_a_set(tmp_path: Path) -> None:
    for number in (1001, 1012):
        write_image(udim_path(tmp_path / "skin.%(UDIM)d.png", number), _noise(8, number))
    (tmp_path / "skin.1x01.png").write_bytes(b"")
    assert sorted(path.name for path in tmp_path.iterdir())[:2] == ["skin.1001.png", "skin.1012.png"]
    for name in ("skin.<UDIM>.png", "skin.%(UDIM)d.png"):
        assert list(read_texture(tmp_path / name)) == [1001, 1012]
        assert len(texture_files(tmp_path / name)) == 2
        assert read_image_form(tmp_path / name) == (np.dtype(np.uint8), 3, (8, 8))
        assert tile_pattern(tmp_path / name).name == "skin.<UDIM>.png"
    assert tile_pattern("skin.png").name == "skin.<UDIM>.png"
