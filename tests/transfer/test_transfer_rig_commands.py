"""Rigs and maps by the command line: what comes back from files, and what is refused."""

import json
from pathlib import Path

import numpy as np
import pytest

from cagemap.character.joints import Skeleton
from cagemap.files.images.image import write_image
from cagemap.files.meshes.formats import read_mesh, write_mesh
from cagemap.files.result.folder import read_result
from cagemap.files.usd.prims import JOINT_WEIGHTS
from cagemap.files.usd.write import UsdResults, write_usd
from cagemap.mesh.mirrors import mirror_symmetries
from cagemap.transfer.skin import with_chosen_joints

from command_line import Run
from example_result import identity_result, textured_cube


def write_weights(place: Path, names: list[str], **tables: np.ndarray) -> None:
    for file, table in tables.items():
        np.savetxt(place / f"{file}.csv", table, delimiter=",", header=",".join(names), comments="")


def read_weights(file: Path, names: list[str]) -> np.ndarray:
    with np.load(file) as carried:
        return np.column_stack([carried[name] for name in names])


def test_joints_and_shapes_grow_with_the_target(run: Run, result_folder: Path) -> None:
    place, result = result_folder.parent, read_result(result_folder)
    joints = [
        {"name": "hip", "parent": None, "head": [0, 0, 0], "tail": [0, 0.2, 0]},
        {"name": "knee", "parent": "hip", "head": [0, 0.2, 0], "tail": [0.1, 0.3, 0]},
    ]
    (place / "s.json").write_text(json.dumps(joints))
    run.done("transfer R --joints s.json -o t.json")
    moved = json.loads((place / "t.json").read_text())["joints"]
    np.testing.assert_allclose(moved[1]["tail"], [0.2, 0.6, 0], atol=1e-6)  # the target is twice as large
    source = result.source.control
    write_mesh(
        place / "smile.obj",
        source.with_positions(source.positions + 0.1 * np.random.default_rng(8).normal(size=(8, 3))),
    )
    run.done("transfer R --blend-shapes smile.obj -o faces")
    target = result.target.control
    given = read_mesh(place / "smile.obj").positions - source.positions
    got = read_mesh(place / "faces" / "smile.obj").positions - target.positions
    np.testing.assert_allclose(got, 2 * given, rtol=0, atol=1e-8)
    np.testing.assert_array_equal(read_mesh(place / "faces" / "large.obj").positions, target.positions)


def test_weights_at_a_soft_mask_edge_have_no_more_joints_than_asked(run: Run, result_folder: Path) -> None:
    place, names = result_folder.parent, ["a", "b", "c", "d"]
    given, own = np.tile([0.7, 0.3, 0.0, 0.0], (8, 1)), np.tile([0.0, 0.1, 0.5, 0.4], (8, 1))
    write_weights(place, names, w=given, own=own)
    np.save(place / "soft.npy", np.linspace(0.0, 1.0, 8))
    said = run.done("transfer R --weights w.csv --base own.csv --target-mask soft.npy --influences 2 -o soft.npz")
    table = read_weights(place / "soft.npz", names)
    assert (table > 0).sum(axis=1).max() == 2
    np.testing.assert_allclose(table.sum(axis=1), 1.0, atol=1e-12)
    assert "at most 2 a vertex" in said.out


def test_weights_of_some_joints_and_of_both_sides_alike(run: Run, result_folder: Path) -> None:
    place, rng = result_folder.parent, np.random.default_rng(8)
    names = ["spine", "arm.L", "arm.R"]
    given, own = rng.dirichlet(np.ones(3), 8), rng.dirichlet(np.ones(3), 8)
    write_weights(place, names, w=given, own=own)
    run.done("transfer R --weights w.csv --only", "arm.L, arm.R", "--base", "own.csv", "-o", "o.npz")
    table = read_weights(place / "o.npz", names)
    np.testing.assert_allclose(table, with_chosen_joints(given, own, np.array([1, 2])), atol=1e-9)
    run.done("transfer R --weights w.csv --only spine --base own.csv --influences 2 -o two.npz")
    table = read_weights(place / "two.npz", names)
    assert ((table > 0).sum(axis=1) <= 2)[table[:, 0] > 0].all()
    np.testing.assert_allclose(table.sum(axis=1), 1.0, atol=1e-12)
    run.done("transfer R --weights w.csv --mirror -o m.npz")
    control = identity_result().target.control
    table = read_weights(place / "m.npz", names)
    swapped = table[:, [0, 2, 1]]
    assert any(np.abs(swapped[mirror.image] - table).max() < 1e-9 for mirror in mirror_symmetries(control))


def test_a_user_sees_that_weights_were_normalised(run: Run, result_folder: Path) -> None:
    place = result_folder.parent
    (place / "w.csv").write_text("hip,knee\n" + "\n".join(["0.5,0.499"] * 8))
    outcome = run.done("transfer R --weights w.csv -o out.npz")
    assert "w.csv: weights of 8 of 8 vertices did not sum to 1" in outcome.err
    np.testing.assert_allclose(read_weights(place / "out.npz", ["hip"]), 0.5 / 0.999, rtol=0, atol=1e-12)


@pytest.mark.slow
def test_maps_through_the_command_line(run: Run, result_folder: Path) -> None:
    place, result = result_folder.parent, identity_result()
    write_mesh(place / "large.obj", textured_cube("large.obj", 2.0))
    write_mesh(place / "small.obj", textured_cube("small.obj"))
    for name in ("m.npy", "m.npz", "m.mtx", "m.vts", "m.mhclo"):
        assert run("transfer R --write-map -o", name).code == 0
    for name in ("m.npy", "m.npz"):
        run.done("map", name, "-t", "large.obj", "-s", "small.obj", "--level", 3, "-o", f"R-{name[2:]}")
        np.testing.assert_allclose(read_result(place / f"R-{name[2:]}").image(), result.image(), atol=1e-12)
    np.save(place / "random.npy", np.random.default_rng(0).integers(0, 8, 8))
    assert run("map random.npy -t large.obj -s small.obj --level 2 -o Q").code == 0
    write_image(place / "t2.png", np.zeros((16, 16, 3), np.uint8))
    assert run("transfer Q --texture t2.png -o b2.png").code == 0
    assert run("report Q -o q.html").code == 0


def test_vertex_groups_come_back_under_the_identity(run: Run, result_folder: Path) -> None:
    place = result_folder.parent
    given = {"groups": [{"name": "left", "vertices": [0, 3], "weights": [0.25, 1.0]}, {"name": "top", "vertices": [1]}]}
    (place / "g.json").write_text(json.dumps(given))
    run.done("transfer R --attribute g.json -o out.json")
    groups = json.loads((place / "out.json").read_text())["groups"]
    assert [(group["name"], group["vertices"]) for group in groups] == [("left", [0, 3]), ("top", [1])]
    np.testing.assert_allclose(groups[0]["weights"], [0.25, 1.0], rtol=0, atol=1e-9)


def test_rows_without_a_chosen_joint_keep_all_their_influences(run: Run, result_folder: Path) -> None:
    place, names = result_folder.parent, ["a", "b", "c", "d"]
    given, own = np.tile([0.0, 1.0, 0.0, 0.0], (8, 1)), np.tile([0.0, 0.2, 0.3, 0.5], (8, 1))
    write_weights(place, names, w=given, own=own)
    run.done("transfer R --weights w.csv --only a --base own.csv --influences 2 -o kept.npz")
    np.testing.assert_allclose(read_weights(place / "kept.npz", names), own, atol=1e-12)


@pytest.mark.parametrize("weights", ["w.csv", "w.usda"])
@pytest.mark.parametrize("words", ["--only a,b,c --target-mask half.npy", "--target-mask half.npy", "--only c"])
def test_weights_of_a_base_are_paired_by_the_names_of_its_joints(run, result_folder, weights, words):
    place, names = result_folder.parent, ["a", "b", "c"]
    own, given = np.tile([0.2, 0.3, 0.5], (8, 1)), np.tile([0.25, 0.25, 0.5], (8, 1))
    write_weights(place, names, w=given)
    np.save(place / "half.npy", np.full(8, 0.5))
    control = read_result(result_folder).target.control
    for file, order, table in (("w.usda", [0, 1, 2], given), ("base.usda", [2, 0, 1], own), ("less.usda", [2, 0], own)):
        joints, ends = tuple(names[joint] for joint in order), np.zeros((len(order), 3))
        skin = UsdResults(
            attributes={JOINT_WEIGHTS: table[:, order]}, skeleton=Skeleton(joints, ("",) * len(order), ends, ends + 0.1)
        )
        write_usd(place / file, control, skin)
    run.done(f"transfer R --weights {weights} --base base.usda {words} -o named.npz")
    expected = (own + given) / 2 if "mask" in words else own
    np.testing.assert_allclose(read_weights(place / "named.npz", names), expected, atol=1e-6)
    run.refused(
        f"transfer R --weights {weights} --base less.usda {words} -o never.npz", says="expected weights of the joints b"
    )
    np.savez(place / "values.npz", **{name: np.ones(8) for name in ("heat", "cold", "wet")})
    run.refused(
        "transfer R --attribute values.npz --base base.usda --target-mask half.npy -o never.npz",
        says="expected values of heat, cold, wet, as what is carried, got",
    )
