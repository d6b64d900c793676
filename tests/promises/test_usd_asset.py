"""A USD file with several UV sets: a match uses the one that is named."""

from dataclasses import replace
from pathlib import Path

import pytest

from cagemap.mesh.control_mesh import UvSet
from cagemap.tasks.match import MatchRequest, read_inputs

pytest.importorskip("pxr.Usd", reason="usd-core is not installed")

from cagemap.files.usd.write import write_usd

from example_result import textured_cube
from refusals import refuses
from usd_scenes import stage_at, usd_mesh


def test_a_uv_set_is_chosen_by_name(tmp_path: Path) -> None:
    mesh, path = textured_cube("box.usda"), tmp_path / "box.usda"
    write_usd(path, replace(mesh, uv_name="st", uv_sets=(UvSet("wide", 3.0 * mesh.uvs, mesh.uv_indices),)))
    with stage_at(path) as stage:
        usd_mesh(stage, "/Asset/eye", mesh.with_positions(mesh.positions + 9.0))
    request = MatchRequest(path, path, tmp_path / "R", part="mesh", target_uv_set="wide")
    (part,) = read_inputs(request).parts
    assert (part.target.uv_name, part.source.uv_name) == ("wide", "st")
    assert part.source.uvs.max() <= 1 < part.target.uvs.max()
    refuses(ValueError, "expected a UV set named 'none'", read_inputs, replace(request, target_uv_set="none"))
