"""A plain target has no cage to wrap: it is refused before any work, and nothing is written."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples.shapes import cube

from cagemap.errors import ParameterError
from cagemap.files.meshes.formats import write_mesh
from cagemap.mesh.schemes import Plain
from cagemap.tasks import WrapRequest, run
from cagemap.tasks import wrap as task

from example_result import identity_result, textured_cube


def test_with_a_map_nothing_is_refined(tmp_path: Path) -> None:
    for name in ("t.obj", "s.obj"):
        write_mesh(tmp_path / name, replace(cube(), scheme=Plain()))
    np.save(tmp_path / "map.npy", np.arange(8))
    request = WrapRequest(
        (), target=tmp_path / "t.obj", source=tmp_path / "s.obj", map=tmp_path / "map.npy", output=tmp_path / "new.obj"
    )
    stages = list[str]()
    with pytest.raises(ParameterError, match="expected a cage to wrap, got a plain mesh"):
        run(request, stages.append)
    assert stages == ["read"]


def test_of_blend_shapes_no_folder_is_left(
    result_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plain = replace(textured_cube("t.obj"), scheme=Plain())
    monkeypatch.setattr(task, "read_result", lambda _: identity_result(1, (plain, textured_cube("s.obj"))))
    with pytest.raises(ParameterError, match="expected a cage to wrap, got a plain mesh"):
        run(WrapRequest(results=(result_folder,), output=tmp_path / "shapes", blend_shapes=True))
    assert not (tmp_path / "shapes").exists()
