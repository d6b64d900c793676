"""Damaged assets: OBJ with every tag, USD as text and as crate, UDIM sets; a named error each, nothing left behind."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cagemap.errors import CagemapError, FormatError
from cagemap.files.images.image import read_texture, udim_path, write_image
from cagemap.files.meshes.formats import read_mesh, write_mesh
from cagemap.mesh import ControlMesh
from cagemap.mesh.checks import check_mesh
from cagemap.mesh.parts import extract_faces, list_parts
from cagemap.subdivision import limit_positions, refine

pytest.importorskip("pxr.Usd", reason="usd-core is not installed")


from damage import mutated_bytes, outcome, refused_share
from refusals import refuses
from usd_scenes import full_cube


def _everything() -> ControlMesh:
    mesh = full_cube()
    return replace(
        mesh,
        face_objects=np.array([0, 0, 0, 1, 1, 1]),
        object_names=("a", "b"),
        face_groups=np.array([0, 1, 0, 1, 0, 1]),
        group_names=("g", "h"),
    )


def _write(path: Path) -> None:
    """A sound file; a package is made of a crate as USD's own tool does."""
    if path.suffix != ".usdz":
        write_mesh(path, _everything())
        return
    from pxr import UsdUtils

    crate = path.with_name("packed.usdc")
    write_mesh(crate, _everything())
    assert UsdUtils.CreateNewUsdzPackage(str(crate), str(path))
    crate.unlink()


def _use(path: Path) -> None:
    """Read, check and refine; what a check lets through must be refined without trouble."""
    mesh = read_mesh(path)
    report = check_mesh(mesh)
    if report.problems:
        raise FormatError("; ".join(problem.found for problem in report.problems))
    for part in list_parts(mesh)[:4]:
        extract_faces(mesh, part.faces)
    refinement = refine(mesh, 1)
    assert np.isfinite(refinement.finest.positions).all()
    limit_positions(refinement, 1)


# Of each file; others have crates that USD itself takes 3 s to refuse.
SEEDS = {"mesh.obj": 10, "mesh.usda": 10, "mesh.usdc": 25, "mesh.usdz": 24}


@pytest.mark.slow
@pytest.mark.parametrize("name", SEEDS)
def test_changed_bytes(name: str, tmp_path: Path) -> None:
    """A package holds the crate, and fewer cases change the package itself."""
    rng = np.random.default_rng([SEEDS[name], *name.encode()])
    path = tmp_path / name
    _write(path)
    content, beside = path.read_bytes(), set(tmp_path.iterdir())
    assert outcome(lambda: _use(path))
    count = 25 if path.suffix == ".usdz" else 80
    assert refused_share(path, _use, lambda: mutated_bytes(content, rng), count) > 0.1
    assert set(tmp_path.iterdir()) == beside


def test_a_write_that_fails_leaves_nothing_behind(tmp_path: Path) -> None:
    broken = replace(_everything(), material_names=("skin", "two\nlines"))
    with pytest.raises(CagemapError):
        write_mesh(tmp_path / "mesh.obj", broken)
    with pytest.raises(CagemapError):
        write_mesh(tmp_path / "mesh.usdz", _everything())
    (tmp_path / "mesh.usda").write_text("#usda 1.0\n# somebody's own\n")
    refuses(FormatError, "force=True", write_mesh, tmp_path / "mesh.usda", _everything())
    assert [path.name for path in tmp_path.iterdir()] == ["mesh.usda"]


@pytest.mark.parametrize(
    "spoil",
    [
        lambda path: path.unlink(),
        lambda path: path.write_bytes(b""),
        lambda path: path.write_bytes(path.read_bytes()[:40]),
        lambda path: path.write_bytes(b"P6 0 0 255\n"),
    ],
)
def test_a_set_with_a_spoilt_tile(spoil: Callable[[Path], object], tmp_path: Path) -> None:
    for tile in (1001, 1002):
        write_image(udim_path(tmp_path / "t.<UDIM>.png", tile), np.zeros((4, 4, 3), dtype=np.uint8))
    spoil(tmp_path / "t.1002.png")
    if (tmp_path / "t.1002.png").exists():
        refuses(FormatError, r"t\.1002\.png", read_texture, tmp_path / "t.<UDIM>.png")
    else:
        assert list(read_texture(tmp_path / "t.<UDIM>.png")) == [1001]
