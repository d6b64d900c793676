"""OFF files: what is written is read, what others write is read, and what is wrong is named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from examples.shapes import creature, cube, icosahedron, triangulated

from cagemap.errors import FormatError
from cagemap.files.meshes.formats import read_mesh, write_mesh

BOX = """OFF # a square and a triangle
# by hand
5 2 0
0 0 0
1 0 0
1 1 0
0 1 0.5e0
0 2 0

4 0 1 2 3 255 0 0
3 3 2 4
"""


@pytest.mark.parametrize("mesh", [cube(), icosahedron(), triangulated(creature())])
def test_what_is_written_is_read(mesh, tmp_path: Path) -> None:
    write_mesh(tmp_path / "m.off", mesh)
    again = read_mesh(tmp_path / "m.off")
    np.testing.assert_array_equal(again.positions, mesh.positions)
    np.testing.assert_array_equal(again.face_indices, mesh.face_indices)
    np.testing.assert_array_equal(again.face_offsets, mesh.face_offsets)


@pytest.mark.parametrize(
    "text",
    [
        BOX,
        BOX.replace("OFF # a square and a triangle\n# by hand\n", "OFF "),
        BOX.replace("by hand", "by hand\u2028 9 9 9"),
        BOX.replace("OFF", "STCNOFF", 1),
        BOX.replace("OFF", "NCSTOFF", 1),  # MeshLab
    ],
)
def test_comments_colours_and_counts_on_the_first_line_are_read(text: str, tmp_path: Path) -> None:
    (tmp_path / "m.off").write_text(text)
    mesh = read_mesh(tmp_path / "m.off")
    assert mesh.face_offsets.tolist() == [0, 4, 7]
    assert mesh.face_indices.tolist() == [0, 1, 2, 3, 3, 2, 4]
    assert mesh.positions[3].tolist() == [0, 1, 0.5]


@pytest.mark.parametrize(
    ("was", "now", "said"),
    [
        ("OFF", "4OFF", "another beginning"),
        ("5 2 0", "5 3 0", "a line for each"),
        ("5 2 0", "x 2 0", "a line for each"),
        ("5 2 0", "-1 2 0", "a line for each"),
        ("3 3 2 4", "3 3 2 5", "from 0 to 4, got 5"),
        ("3 3 2 4", "9 3 2 4", "as many vertices"),
        ("3 3 2 4", "99999999999999999999 3 2 4", "as many vertices"),
        ("1 1 0\n", "1 1 nan\n", "three finite numbers"),
        ("1 1 0\n", "1 1\n", "three finite numbers"),
    ],
)
def test_what_is_wrong_is_named(was: str, now: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "m.off").write_text(BOX.replace(was, now))
    with pytest.raises(FormatError, match=said):
        read_mesh(tmp_path / "m.off")
