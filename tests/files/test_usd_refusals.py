"""USD files that cannot be read or written: every message names the file or prim, what is wrong, and what to do."""

from __future__ import annotations

import sys
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from examples.shapes import creature, cube

from cagemap.character.joints import Skeleton
from cagemap.files.meshes.formats import write_mesh
from cagemap.files.usd import stages
from cagemap.files.usd.read import read_usd_meshes
from cagemap.files.usd.skeleton import read_usd_skeleton
from cagemap.files.usd.space import stage_units
from cagemap.files.usd.stages import asset_paths
from cagemap.files.usd.write import UsdResults, write_usd, write_usd_over
from cagemap.files.values.rigs import read_shapes

from refusals import Refusal
from usd_scenes import stage_at, usd_mesh

pytest.importorskip("pxr.Usd", reason="usd-core is not installed")

from pxr import Gf, UsdGeom, UsdSkel

RIG = Skeleton(("hip",), ("",), np.zeros((1, 3)), np.ones((1, 3)), np.eye(3)[None])
NOTHING = UsdResults()
AGAIN = "Export it again."


def written(place: Path, results: UsdResults = NOTHING, name: str = "a.usda") -> Path:
    write_usd(place / name, cube(), results, force=True)
    return place / name


def edited(place: Path, edit: Callable[[Any], object], results: UsdResults = NOTHING) -> Path:
    """A file of a cube after an edit of its stage."""
    with stage_at(written(place, results)) as stage:
        edit(stage)
    return place / "a.usda"


def flattened_joints(stage: Any) -> None:
    """The mesh is bound where all is flattened."""
    binding = UsdSkel.BindingAPI(stage.GetPrimAtPath("/Asset/mesh"))
    binding.CreateGeomBindTransformAttr().Set(Gf.Matrix4d(0.0))


def shape_of_others(stage: Any) -> None:
    """The only blend shape moves a point that is not there."""
    (shape,) = (prim for prim in stage.Traverse() if prim.IsA(UsdSkel.BlendShape))
    UsdSkel.BlendShape(shape).CreatePointIndicesAttr().Set([99] * 8)


def two_meshes(place: Path) -> Path:
    with stage_at(place / "two.usda") as stage:
        for name in ("/a", "/b"):
            usd_mesh(stage, name, cube())
        UsdGeom.SetStageUpAxis(stage, "Y")
    return place / "two.usda"


def package_in_package(place: Path) -> bytes:
    for name, inner in (("inner.usdz", "a.usda"), ("outer.usdz", "inner.usdz")):
        written(place)
        with zipfile.ZipFile(place / name, "w") as package:
            package.write(place / inner, inner)
    return (place / "outer.usdz").read_bytes()


def over(place: Path, prim: str = "/Asset/mesh", **results: Any) -> None:
    write_usd_over(place / "look.usda", written(place), [prim], cube(), UsdResults(**results))


REFUSED = {
    "a mesh of several": Refusal(
        lambda place: read_usd_skeleton(two_meshes(place)),
        "two.usda: expected one mesh ... got /a, /b",
        "Match one of them (`find_part` NAME), or make what is meant a file of its own.",
    ),
    "a package in a package": Refusal(
        lambda place: asset_paths("outer.usdz", package_in_package(place)),
        "outer.usdz:  ... expected a package of layers and images, got a package within it ... Flatten it.",
    ),
    "a mesh that is bound flat": Refusal(
        lambda place: read_usd_skeleton(edited(place, flattened_joints, UsdResults(skeleton=RIG))),
        "a.usda: /Asset/skeleton ... the mesh's bind transform has no inverse ... Export the skeleton again.",
    ),
    "a joint above itself": Refusal(
        lambda place: over(place, skeleton=replace(RIG, parents=("hip",))),
        "skeleton:  ... joint hip is its own parent ... Repair the hierarchy.",
    ),
    "a scene without a unit": Refusal(
        lambda place: stage_units(edited(place, lambda stage: UsdGeom.SetStageMetersPerUnit(stage, -1.0))),
        "a.usda: expected the up axis Y or Z and a positive metersPerUnit ... got Y, -1.0",
        AGAIN,
    ),
    "a layer over another prim": Refusal(
        lambda place: over(place, "/Asset/other"),
        "a.usda: expected a mesh prim /Asset/other ... there is none ... Match again with this file.",
    ),
    "a layer that is not of cagemap": Refusal(
        lambda place: ((place / "own.usda").write_text("#usda 1.0\n"), write_mesh(place / "own.usda", cube())),
        "own.usda: exists ... force=True",
    ),
    "points of another mesh": Refusal(
        lambda place: over(place, points=creature().positions),
        "points: ",
        f"expected (8, 3), got {creature().positions.shape}",
        "Give a position for each vertex.",
    ),
    "values of another mesh": Refusal(
        lambda place: over(place, attributes={"heat": np.ones(5)}),
        "heat:  ... expected a row for each vertex, face or face corner, got 5",
        "Give the values of this mesh.",
    ),
    "a shape of other points": Refusal(
        lambda place: read_usd_meshes(
            edited(place, shape_of_others, UsdResults(attributes={"blendShape:smile": np.ones((8, 3))}))
        ),
        "blend shape smile:  ... expected one finite offset a point, got 8 for 8 points of 8",
        AGAIN,
    ),
    "shapes of another mesh": Refusal(
        lambda place: read_shapes(
            [written(place, UsdResults(attributes={"blendShape:smile": np.ones((8, 3))}))], creature()
        ),
        "a.usda: ",
        f"expected blend shapes of {creature().n_vertices} vertices, as {creature().name} has",
        "Give the shapes of this mesh.",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_usd_file_that_cannot_be_used_is_refused(name: str, tmp_path: Path) -> None:
    REFUSED[name].check(tmp_path)


def test_usd_without_its_library_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """When it is used; `inspect`, `doctest` and `copy` ask every module's values for names that it may lack."""
    file = written(tmp_path)
    monkeypatch.setitem(sys.modules, "pxr.Usd", None)
    assert not hasattr(stages.pxr, "__wrapped__")
    Refusal(
        read_usd_meshes,
        "USD files:  ... expected the package usd-core, which is not installed",
        "Install cagemap[usd] or usd-core.",
    ).check(file)
