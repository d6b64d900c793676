"""Images that `cagemap transfer` bakes: their meaning, sizes and labels, and what it says of doubtful ones."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cagemap.files.images.image import read_image
from cagemap.files.meshes.formats import write_mesh
from cagemap.files.result.folder import write_result
from cagemap.mesh import ControlMesh
from cagemap.tasks.progress import Stages
from cagemap.tasks.requests.transfer import TransferRequest
from cagemap.tasks.transfer import run_transfer

from example_result import identity_result, textured_cube


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a RESULT of two equal cubes."""
    monkeypatch.chdir(tmp_path)
    write_result(tmp_path / "RESULT", identity_result())
    return tmp_path


def transfer(output: str, **options: Any) -> tuple[np.ndarray | None, str, list[str]]:
    """Run a transfer; returns the image, if one was written under this name, the summary and the warnings."""
    summary, warnings = run_transfer(TransferRequest(Path("RESULT"), Path(output), **options), Stages())
    return read_image(Path(output)).pixels if Path(output).is_file() else None, summary, warnings


def half_painted(mesh: ControlMesh) -> ControlMesh:
    """Colours at the vertices of the upper half only."""
    known = mesh.positions[:, 2] > 0
    return replace(mesh, vertex_colors=np.where(known[:, None], [0.2, 0.5, 0.1], np.nan))


@pytest.mark.parametrize("output", ["o.png", "o.exr"])
@pytest.mark.parametrize("own", [True, False])
def test_vertices_without_a_colour_are_baked_grey(place: Path, output: str, own: bool) -> None:
    source = half_painted(textured_cube("small.obj"))
    if own:
        write_result(place / "RESULT", identity_result(3, (textured_cube("large.obj", 2.0), source)), force=True)
    else:
        write_mesh(place / "detail.obj", source)
    detail = None if own else place / "detail.obj"
    pixels, _, warnings = transfer(output, bake=("colors",), detail=detail, size=64)
    assert pixels is not None
    assert np.isfinite(pixels).all()
    full = np.iinfo(pixels.dtype).max if pixels.dtype.kind == "u" else 1.0
    assert pixels.min() > 0.005 * full, "no texel is black"
    grey = pixels.reshape(-1, 3).max(axis=0) / full
    if not own:  # subdivision mixes the colours of a cube's vertices
        np.testing.assert_allclose(grey, 0.8 if output == "o.exr" else 0.906, atol=0.01)
    assert any("4 of 8 vertices have no colour and are baked in grey" in text for text in warnings)
