"""Damaged crates are refused before USD allocates the memory that they state; sound ones are not."""

from __future__ import annotations

import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest
from examples.shapes import cube

from cagemap.errors import FormatError
from cagemap.files.meshes.formats import read_mesh

pytest.importorskip("pxr.Usd", reason="usd-core is not installed")

from pxr import Sdf, Usd, UsdGeom, UsdUtils, Vt

from cagemap.files.usd import crate
from cagemap.files.usd.crate import check_crate
from cagemap.files.usd.write import write_usd

from refusals import refuses


def sections(content: bytes) -> dict[str, tuple[int, int]]:
    """Start and size of each section of a crate."""
    (place,) = struct.unpack_from("<Q", content, 16)
    (count,) = struct.unpack_from("<Q", content, place)
    rows = (struct.unpack_from("<16sQQ", content, place + 8 + 32 * row) for row in range(count))
    return {name.rstrip(b"\0").decode(): (start, size) for name, start, size in rows}


@pytest.mark.parametrize(("section", "offset"), [("TOKENS", 0), ("SPECS", 8), ("PATHS", 16), ("FIELDS", 8)])
def test_a_section_that_states_more_than_it_holds_is_refused(section: str, offset: int, tmp_path: Path) -> None:
    path = tmp_path / "box.usdc"
    write_usd(path, cube())
    content = bytearray(path.read_bytes())
    struct.pack_into("<Q", content, sections(content)[section][0] + offset, 1 << 31)
    path.write_bytes(content)
    refuses(FormatError, r"box\.usdc: cannot be read as USD \(its sections are damaged\)", read_mesh, path)


def test_blocks_that_copy_what_is_not_there_are_refused() -> None:
    """A block of 2 kB made 100 MB of it before."""
    for back in (0, 9):
        with pytest.raises(struct.error):
            crate._decompress_lz4(bytes([0x1F, 65]) + struct.pack("<H", back) + b"\xff" * 2000 + b"\0", 64)
    assert crate._decompress_lz4(bytes([0x1F, 65]) + struct.pack("<H", 1) + b"\xff" * 2000 + b"\0", 64) == b"A" * 64


def test_encrypted_packages_are_refused_by_name(tmp_path: Path) -> None:
    path = tmp_path / "box.usdz"
    with zipfile.ZipFile(path, "w") as package:
        package.writestr("box.usdc", b"PXR-USDC")
    content = bytearray(path.read_bytes())
    for start in (6, content.index(b"PK\x01\x02") + 8):
        content[start] |= 1
    path.write_bytes(content)
    refuses(FormatError, r"box\.usdz: expected a package without encryption", check_crate, path)


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


NUMBERS = np.arange(64)
ARRAYS = {
    "Int": NUMBERS,
    "UInt64": NUMBERS,
    "Float": NUMBERS + 0.0,  # written as whole numbers
    "Double": np.tile([0.25, 0.75], 32),  # a table of two values
    "Half": NUMBERS / 64,  # as they are
    "Bool": NUMBERS % 2 == 0,
}


def crate_of(path: Path, kind: str, values: np.ndarray, *, sampled: bool = False) -> bytearray:
    """Write a mesh with an array of one kind, also as time samples; returns the file's content."""
    stage = Usd.Stage.CreateNew(str(path))
    mesh = UsdGeom.Mesh.Define(stage, "/mesh")
    mesh.CreatePointsAttr(cube().positions.tolist())
    mesh.CreateFaceVertexCountsAttr([4] * 6)
    mesh.CreateFaceVertexIndicesAttr(cube().face_indices.tolist())
    attribute = mesh.GetPrim().CreateAttribute("primvars:values", getattr(Sdf.ValueTypeNames, f"{kind}Array"))
    array = getattr(Vt, f"{kind}Array")(values.tolist())
    for time in (1.0, 2.0) if sampled else (Usd.TimeCode.Default(),):
        attribute.Set(array, time)
    stage.GetRootLayer().Save()
    return bytearray(path.read_bytes())


@pytest.mark.parametrize("package", [False, True])
@pytest.mark.parametrize("sampled", [False, True])
@pytest.mark.parametrize("kind", ARRAYS)
def test_an_array_that_states_more_than_it_holds_is_refused(kind, sampled, package, tmp_path):
    path = tmp_path / "box.usdc"
    content = crate_of(path, kind, ARRAYS[kind], sampled=sampled)
    check_crate(path)
    stated = struct.pack("<Q", len(NUMBERS))
    place = content.find(stated, 88)  # behind the header
    assert place < sections(content)["TOKENS"][0]
    struct.pack_into("<Q", content, place, 3_000_000_000)
    path.write_bytes(content)
    if package:
        path = tmp_path / "box.usdz"
        with zipfile.ZipFile(path, "w") as written:
            written.write(tmp_path / "box.usdc", "box.usdc")
    refuses(FormatError, r"box\.usd[cz]: cannot be read as USD \(its sections are damaged\)", check_crate, path)


def test_an_array_that_is_marked_as_inlined_is_checked(tmp_path: Path) -> None:
    """USD reads it from its place all the same."""
    content = crate_of(tmp_path / "box.usdc", "Int", NUMBERS)
    start, size = sections(content)["FIELDS"]
    arrays = [value | crate._INLINED for value in crate._field_values(content[start:][:size]) if value & crate._ARRAY]
    crate._check_arrays(content, arrays)
    struct.pack_into("<Q", content, content.index(struct.pack("<Q", len(NUMBERS)), 88), 3_000_000_000)
    with pytest.raises(struct.error):
        crate._check_arrays(content, arrays)


@pytest.mark.parametrize("length", [11, 13])
def test_a_list_that_states_more_than_it_holds_is_refused(length: int, tmp_path: Path) -> None:
    """The names of children, and edits of a list."""
    path = tmp_path / "lists.usdc"
    stage = Usd.Stage.CreateNew(str(path))
    for number in range(11):
        stage.DefinePrim(f"/a/b{number}")
    stage.GetPrimAtPath("/a").SetMetadata("apiSchemas", Sdf.TokenListOp.Create(list(map(str, range(13)))))
    stage.GetRootLayer().Save()
    check_crate(path)
    content = bytearray(path.read_bytes())
    struct.pack_into("<Q", content, content.index(struct.pack("<Q", length), 88), 3_000_000_000)
    path.write_bytes(content)
    refuses(FormatError, r"lists\.usdc: cannot be read as USD \(its sections are damaged\)", check_crate, path)


def test_sound_arrays_of_all_kinds_pass(tmp_path: Path) -> None:
    stage = Usd.Stage.CreateNew(str(tmp_path / "kinds.usdc"))
    prim = stage.DefinePrim("/a")
    rng = np.random.default_rng(5)
    for size in (0, 1, 15, 16, 17, 3000):
        for kind in ("Int", "Int64", "UChar", "Float", "Double", "Half"):
            name = Sdf.ValueTypeNames.Find({"Int64": "int64", "UChar": "uchar"}.get(kind, kind.lower())).arrayType
            for number, values in enumerate((np.zeros(size), np.arange(size) % 200, rng.integers(0, 9, size) / 8)):
                values = values if kind in ("Float", "Double", "Half") else np.rint(values).astype(int)
                attribute = prim.CreateAttribute(f"{kind}{size}_{number}", name)
                for time in (Usd.TimeCode.Default(), 1.0, 2.5):
                    attribute.Set(getattr(Vt, f"{kind}Array")(values.tolist()), time)
        prim.CreateAttribute(f"t{size}", Sdf.ValueTypeNames.TokenArray).Set(["a", "b"] * size)
        prim.SetCustomDataByKey(f"numbers{size}", Vt.IntArray(list(range(size))))
    stage.GetRootLayer().Save()
    check_crate(tmp_path / "kinds.usdc")
    assert UsdUtils.CreateNewUsdzPackage(str(tmp_path / "kinds.usdc"), str(tmp_path / "kinds.usdz"))
    check_crate(tmp_path / "kinds.usdz")
