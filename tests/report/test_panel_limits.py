"""Panels of a report show the first of many poses, and say so."""

from __future__ import annotations

import pytest

from cagemap.report.rig_panels import MAX_PANEL_POSES, CarriedData, Pose, draw_carried

from example_result import identity_result


@pytest.mark.parametrize("more", [0, 1])
def test_the_first_of_many_poses_are_shown_and_counted(more: int) -> None:
    result = identity_result(1)
    places = result.source.control.positions, result.target.control.positions
    count = MAX_PANEL_POSES + more
    (panel,) = draw_carried(result, CarriedData(poses=tuple(Pose(f"{i}", *places) for i in range(count))), (8, 6))
    assert len(panel.pictures) == 2 * MAX_PANEL_POSES
    assert (f"The first {MAX_PANEL_POSES} of {count}." in panel.lead) == bool(more)
