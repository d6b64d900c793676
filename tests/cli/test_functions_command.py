"""`cagemap functions`: eigenfunctions and descriptors of one mesh in files."""

import numpy as np
import pytest
from examples import shapes

from cagemap import research
from cagemap.errors import ParameterError
from cagemap.files.meshes.formats import read_mesh, write_mesh
from cagemap.files.values.attributes import read_attributes
from cagemap.mesh import Plain
from cagemap.paper.constraints import heat_filters
from cagemap.pipeline import prepare_surface
from cagemap.spectral import BasisConfig
from cagemap.tasks.functions import run_functions
from cagemap.tasks.progress import Stages
from cagemap.tasks.requests.functions import FunctionsRequest

from refusals import refuses


@pytest.fixture(scope="module")
def mesh(tmp_path_factory):
    path = tmp_path_factory.mktemp("functions") / "m.obj"
    write_mesh(path, shapes.creature())
    return path


def run(*given, **options):
    return run_functions(FunctionsRequest(*given, **options), Stages())[0]


@pytest.mark.slow
def test_what_is_written_is_what_the_basis_has(mesh, tmp_path):
    """Eigenfunctions orthonormal at unit area; signatures the diagonals, kernels the columns of Phi rho Phi^T."""
    kinds = "eigenfunctions,heat-signatures,wave-signatures,heat-kernels,wave-kernels"
    run(mesh, tmp_path / "f.npz", kinds=kinds, level=2, at=1, schedule="20,10,5", heat=3, wave=4, points="0,7",
        laplacian="alexa-wardetzky")  # fmt: skip
    found = np.load(tmp_path / "f.npz")
    config = BasisConfig(schedule=(20, 10, 5), laplacian="alexa-wardetzky")
    surface = prepare_surface(read_mesh(mesh), 2, config)
    phi = surface.basis.at(1)
    np.testing.assert_allclose(found["eigenfunctions"], phi, atol=1e-12)
    np.testing.assert_allclose(found["eigenvalues"], surface.basis.eigenvalues[:30])
    gram = phi.T @ (surface.operators.mass[1] @ phi)
    np.testing.assert_allclose(np.diag(gram), 1.0, atol=1e-6)
    kernel = phi @ (heat_filters(found["eigenvalues"], found["heat_times"])[:, :, None] * phi.T[:, None, :]).reshape(
        30, -1
    )
    kernel = kernel.reshape(len(phi), 3, len(phi))  # K_t(v, w) at [v, t, w]
    diagonal = np.einsum("vtv->vt", kernel)
    np.testing.assert_allclose(found["heat_signatures"], diagonal, rtol=1e-6, atol=1e-9)
    expected = np.concatenate([kernel[:, :, point] for point in (0, 7)], axis=1)
    np.testing.assert_allclose(found["heat_kernels"], expected, rtol=1e-6, atol=1e-9)
    assert found["wave_kernels"].shape == (len(phi), 8)
    assert found["wave_signatures"].shape == (len(phi), 4)
    assert abs(found["vertex_areas"].sum() - 1) < 0.05  # of the level's own triangles
    np.testing.assert_array_equal(found["points"], [0, 7])


@pytest.mark.slow
def test_tables_and_colours(mesh, tmp_path):
    """A column for each function; colours of the level's own vertices, blue where the function is below 0."""
    said = run(mesh, tmp_path / "f.csv", level=1, k=12)
    assert "12 functions (eigenfunctions)" in said
    table = read_attributes(tmp_path / "f.csv")
    assert list(table)[:2] == ["eigenfunctions_0", "eigenfunctions_1"]
    said = run(mesh, tmp_path / "f.ply", level=1, k=12)
    assert "eigenfunctions 1 in colours" in said  # the first one is constant
    shown = read_mesh(tmp_path / "f.ply")
    values = table["eigenfunctions_1"]
    assert shown.n_vertices == len(values)
    low, high = values < 0.5 * values.min(), values > 0.5 * values.max()
    assert (shown.vertex_colors[low, 2] > shown.vertex_colors[low, 0]).all()
    assert (shown.vertex_colors[high, 2] < shown.vertex_colors[high, 0]).all()
    run(mesh, tmp_path / "s.ply", level=1, at=0, k=12, kinds="heat-signatures", column=9)
    assert read_mesh(tmp_path / "s.ply").n_vertices == shapes.creature().n_vertices


def test_functions_of_a_scan_are_in_its_own_order(tmp_path):
    """A plain mesh's coarse levels have an order of their own; rows are the file's vertices."""
    scan = shapes.creature()
    surface = prepare_surface(scan, 2, BasisConfig(count=10))
    dense = research.control_mesh((surface.vertices, surface.triangles(2).triangles))
    write_mesh(tmp_path / "scan.obj", dense)
    run(tmp_path / "scan.obj", tmp_path / "f.npz", k=10, scheme="none")
    found = np.load(tmp_path / "f.npz")["eigenfunctions"]
    assert len(found) == dense.n_vertices
    assert isinstance(read_mesh(tmp_path / "scan.obj").scheme, Plain | None)
    one, two = found[:, 1], surface.basis.at(2)[:, 1]
    assert abs(np.corrcoef(one, two)[0, 1]) > 0.98


@pytest.mark.parametrize(
    ("output", "options", "said"),
    [
        ("f.ply", {"column": 40, "k": 12}, "--column: expected a function from 0 to 11, got 40"),
        ("f.npz", {"at": 3}, "--at: expected a level from 0 to 1, got 3"),
    ],
)
def test_wrong_requests_are_refused_before_the_eigensolver(mesh, tmp_path, monkeypatch, output, options, said):
    monkeypatch.setattr("cagemap.tasks.functions.prepare_surface", lambda *given, **more: pytest.fail("was solved"))
    refuses(ParameterError, said, run, mesh, tmp_path / output, level=1, **options)
