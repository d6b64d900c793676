"""What `cagemap transfer` says beside what it writes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cagemap.deform.shared_area import SharedArea
from cagemap.files.result.folder import write_result
from cagemap.tasks.progress import Stages
from cagemap.tasks.requests.results import TransferRequest
from cagemap.tasks.transfer import run_transfer

from example_result import identity_result


@pytest.mark.parametrize("shared", [0.6, 1.0])
def test_area_without_a_counterpart_is_said(tmp_path: Path, shared: float) -> None:
    result = identity_result()
    surfaces = result.target.finest_triangles, result.source.finest_triangles
    own = np.where(np.arange(surfaces[0].n) < shared * surfaces[0].n, 1.0, 0.0)
    area = SharedArea.of_vertices(surfaces, (own, np.ones(surfaces[1].n)))
    write_result(tmp_path / "RESULT", replace(result, shared=area))
    values = tmp_path / "values.csv"
    np.savetxt(values, np.arange(8.0))
    request = TransferRequest(tmp_path / "RESULT", tmp_path / "out.csv", attribute=values)
    _, warnings = run_transfer(request, Stages())
    said = [text for text in warnings if "has no counterpart on the source" in text]
    assert bool(said) == (shared < 1.0)
    masked = replace(request, output=tmp_path / "masked.csv", target_mask="red")
    assert not any("no counterpart" in text for text in run_transfer(masked, Stages())[1])
