"""Damaged crates are refused before USD allocates the memory that they state; sound ones are not."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from examples.shapes import cube

from cagemap.errors import FormatError
from cagemap.files.meshes.formats import read_mesh

pytest.importorskip("pxr.Usd", reason="usd-core is not installed")

from pxr import Usd, UsdGeom

from cagemap.files.usd.crate import check_crate
from cagemap.files.usd.write import write_usd


def sections(content: bytes) -> dict[str, tuple[int, int]]:
    """Start and size of each section of a crate."""
    (place,) = struct.unpack_from("<Q", content, 16)
    (count,) = struct.unpack_from("<Q", content, place)
    rows = (struct.unpack_from("<16sQQ", content, place + 8 + 32 * row) for row in range(count))
    return {name.rstrip(b"\0").decode(): (start, size) for name, start, size in rows}


@pytest.mark.parametrize(("section", "offset"), [("TOKENS", 0), ("SPECS", 8), ("PATHS", 16), ("FIELDS", 8)])
def test_a_section_that_states_more_than_it_holds_is_refused(section: str, offset: int, tmp_path: Path) -> None:
    """Such numbers made USD allocate gigabytes for seconds, or until the system ended the process."""
    path = tmp_path / "box.usdc"
    write_usd(path, cube())
    content = bytearray(path.read_bytes())
    struct.pack_into("<Q", content, sections(content)[section][0] + offset, 1 << 31)
    path.write_bytes(content)
    with pytest.raises(FormatError, match=r"box\.usdc: cannot be read as USD \(its sections are damaged\)"):
        read_mesh(path)


def test_sound_crates_of_many_equal_prims_pass(tmp_path: Path) -> None:
    """Equal prims compress most."""
    path = tmp_path / "many.usdc"
    stage = Usd.Stage.CreateNew(str(path))
    for number in range(3000):
        UsdGeom.Xform.Define(stage, f"/a{number}")
    mesh = UsdGeom.Mesh.Define(stage, "/mesh")
    mesh.CreateFaceVertexCountsAttr(np.full(100_000, 3).tolist())
    stage.GetRootLayer().Save()
    check_crate(path)
