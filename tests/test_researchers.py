"""The researcher's page runs, and the short names of `cagemap.research` do what they say."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from examples import shapes

from cagemap import research
from cagemap.basis import BasisConfig
from cagemap.errors import ParameterError
from cagemap.files.result import read_result

PAGE = Path(__file__).resolve().parents[1] / "docs" / "researchers.md"
BASIS = BasisConfig(schedule=(20, 10))


@pytest.mark.slow
def test_every_block_of_the_page_runs(tmp_path, monkeypatch):
    """In order, in one namespace, as a reader would paste them."""
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    names: dict[str, object] = {}
    for number, block in enumerate(blocks):
        exec(compile(block, f"researchers.md, block {number}", "exec"), names)
    assert len(blocks) == 6
    assert read_result(tmp_path / "RESULT").functional_map.shape == (80, 80)


@pytest.mark.slow
def test_the_commands_of_table_1_run(shared_data, tmp_path):
    """As the page has them, with fewer levels: one had its landmarks the wrong way round."""
    block = re.search(r"```text\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL).group(1)
    commands = re.findall(r"^cagemap (.*)$", block.replace("\\\n", ""), re.MULTILINE)
    places = {path.name: str(path) for path in [*shared_data.rglob("*.obj"), *shared_data.rglob("*.json")]}
    assert len(commands) == 3
    for number, command in enumerate(commands):
        words = [places.get(word, word) for word in shlex.split(re.sub(r"level [34]", "level 1", command))]
        words = [re.sub(r"^(\d+,\d+),.*", r"\1", word) for word in words]
        words[words.index("--output") + 1] = str(tmp_path / str(number))
        subprocess.run([sys.executable, "-m", "cagemap", *words], check=True)
        assert [one.levels for one in read_result(tmp_path / str(number)).level_maps] == [(0, 0), (1, 1)]


@pytest.fixture(scope="module")
def itself():
    """The creature and itself: every map is the identity."""
    surface = research.prepare(shapes.creature(), 1, BASIS)
    chosen = np.arange(0, surface.control.n_vertices, 7)
    return research.make_pair(surface, surface, (chosen, chosen))


def test_meshes_come_in_many_forms():
    mesh = shapes.cube()
    faces = [mesh.face(i) for i in range(mesh.n_faces)]

    class Trimesh:
        vertices, faces = mesh.positions, np.array([mesh.face(i) for i in range(mesh.n_faces)])

    for given in (mesh, (mesh.positions, faces), Trimesh()):
        np.testing.assert_array_equal(research.control_mesh(given).face_indices, mesh.face_indices)
    with pytest.raises(ParameterError, match="object with vertices and faces, got int"):
        research.control_mesh(3)


def test_the_identity_is_found_from_constraints_and_transports_functions(itself):
    constraints = research.gather_constraints(itself)
    found = research.functional_map(itself, constraints, research.MapWeights(decay=0.0))
    np.testing.assert_allclose(found, np.eye(30), atol=1e-6)
    values = itself.source.basis.at(1) @ np.arange(30.0)
    np.testing.assert_allclose(research.transport(itself, found, values, 1, 1), values, atol=1e-4)
    points = research.point_map(itself, found)
    away = np.linalg.norm(points.images.positions - itself.source.triangles(1).positions, axis=1)
    assert away.max() < 1e-3
    np.testing.assert_allclose(research.functional_map_of(itself, points), np.eye(30), atol=1e-2)


def test_landmark_functions_are_columns_of_the_descriptor_matrix(itself):
    """K~ delta_v with K~ = Phi~ rho(Lambda~) Phi~^T, which is never made otherwise (Definition 3)."""
    surface = itself.target
    filters = research.heat_and_wave_filters(surface, surface, heat=2, wave=0)
    phi, eigenvalues = research.eigenfunctions(surface, 1)
    found = research.landmark_functions(surface, filters, [4], 1)
    for j, rho in enumerate(filters.at(eigenvalues).T):
        np.testing.assert_allclose(found[:, j], (phi * rho) @ phi[4], rtol=1e-9, atol=1e-12)


def test_what_does_not_fit_is_refused(itself):
    with pytest.raises(ParameterError, match="at most"):
        research.point_map(itself, np.eye(40))
    with pytest.raises(ParameterError, match="has 20 of 30 functions"):
        research.transport(itself, np.eye(30), itself.source.basis.at(1)[:, 0], 1, 0)
    with pytest.raises(ParameterError, match="as many target as source landmarks"):
        research.make_pair(itself.target, itself.source, ((1, 2), (1,)))
    with pytest.raises(ParameterError, match="start"):
        research.paper_map(itself, start=np.eye(3))
