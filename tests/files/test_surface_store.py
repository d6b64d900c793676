"""Stored surfaces: the same surface again, or a clear refusal; the version of the code that keys them."""

import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from examples import shapes

from cagemap.errors import FormatError, ParameterError
from cagemap.files.result.manifest import code_version
from cagemap.files.result.surface_store import load_or_prepare, load_surface, save_surface, surface_key
from cagemap.mesh import CatmullClark
from cagemap.pipeline import MatchConfig, match, prepare_surface, prepare_surfaces
from cagemap.spectral import BasisConfig
from cagemap.spectral.surface import Surface

from example_result import edit_header, rewrite_arrays
from refusals import refuses

CONFIG = BasisConfig(count=20)
LEVEL = 2


@pytest.fixture(scope="module")
def surface():
    return prepare_surface(shapes.creature(), LEVEL, CONFIG)


@pytest.fixture
def stored(surface, tmp_path):
    path = tmp_path / "creature.npz"
    save_surface(path, surface)
    return path


def assert_same(one, other):
    """Bit for bit: what is stored is stored exactly, what is made again is made the same way."""
    for name in ("positions", "face_offsets", "face_indices", "uvs", "uv_indices"):
        np.testing.assert_array_equal(getattr(one.control, name), getattr(other.control, name))
    assert one.refinement.scheme == other.refinement.scheme
    for mine, theirs in zip(one.refinement.levels, other.refinement.levels, strict=True):
        np.testing.assert_array_equal(mine.positions, theirs.positions)
    for family in ("mass", "stiffness"):
        for mine, theirs in zip(getattr(one.operators, family), getattr(other.operators, family), strict=True):
            assert (mine != theirs).nnz == 0
            assert mine.dtype == theirs.dtype
    assert one.operators.scale == other.operators.scale
    for mine, theirs in zip(one.basis.bands, other.basis.bands, strict=True):
        np.testing.assert_array_equal(mine, theirs)
    for name in ("eigenvalues", "residuals", "indices", "gram"):
        np.testing.assert_array_equal(getattr(one.basis, name), getattr(other.basis, name))


def no_preparing(*arguments, **options):
    raise AssertionError("expected the stored surface to be read, not prepared again")


def test_a_surface_comes_back_bit_for_bit(surface, stored):
    assert_same(load_surface(stored), surface)
    assert_same(load_surface(str(stored)), surface)


@pytest.mark.parametrize("mesh", [shapes.icosahedron(), shapes.grid(4, 3)])
def test_loop_surfaces_and_boundaries_come_back(mesh, tmp_path):
    surface = prepare_surface(mesh, LEVEL, CONFIG)
    save_surface(tmp_path / "s.npz", surface)
    assert_same(load_surface(tmp_path / "s.npz"), surface)


@pytest.mark.slow
def test_operators_may_end_below_the_finest_level(surface, tmp_path):
    """The basis is that of the coarser surface, and functions of it refine to the finest level."""
    config = replace(CONFIG, vertices=300)
    short = prepare_surface(shapes.creature(), LEVEL, config)
    level = short.operators.finest_level
    assert level < LEVEL
    assert short.refinement.levels[level].n_vertices >= 300
    coarse = prepare_surface(shapes.creature(), level, CONFIG)
    np.testing.assert_allclose(short.basis.eigenvalues, coarse.basis.eigenvalues, rtol=1e-12)
    np.testing.assert_allclose(short.basis.eigenvalues[1:], surface.basis.eigenvalues[1:], rtol=0.05)
    assert short.basis.at(LEVEL).shape == (short.refinement.finest.n_vertices, CONFIG.count)
    # Lengths are those of the finest surface all the same.
    assert short.scale == pytest.approx(surface.scale, rel=1e-14)
    save_surface(tmp_path / "short.npz", short)
    assert_same(load_surface(tmp_path / "short.npz"), short)
    with pytest.raises(ParameterError, match="last with operators"):
        short.basis.project(np.ones(short.refinement.finest.n_vertices), LEVEL)
    with pytest.raises(ParameterError, match=rf"operators up to level {LEVEL}, got .* end at level {level}"):
        match(short, short, config=MatchConfig(method="paper"))


def test_operators_of_another_config_are_refused(surface, tmp_path):
    other = replace(surface.config, laplacian="alexa-wardetzky")
    named = Surface.of(surface.hierarchy, surface.operators, surface.basis, other)
    refuses(ParameterError, "its operators are not those of its config", save_surface, tmp_path / "s.npz", named)
    assert not (tmp_path / "s.npz").exists()


def test_numbers_of_numpy_are_stored(tmp_path):
    control, config = shapes.cube(), BasisConfig(count=np.int64(6), vertices=np.int32(20))
    levels = np.array([2, 2])
    assert surface_key(control, levels[0], config=config) == surface_key(control, 2, config=replace(config, count=6))
    surface = load_or_prepare(tmp_path, control, levels[0], config)
    assert_same(load_or_prepare(tmp_path, control, levels[0], config, prepare=no_preparing), surface)
    prepared = prepare_surfaces(control, control, levels, config)
    save_surface(tmp_path / "s.npz", prepared[0])


def test_the_second_time_it_is_read(surface, tmp_path):
    folder = tmp_path / "new" / "cache"
    first = load_or_prepare(folder, shapes.creature(), LEVEL, CONFIG, prepare=lambda *_, **__: surface)
    assert first is surface
    renamed = replace(shapes.creature(), name="another name")
    again = load_or_prepare(folder, renamed, LEVEL, CONFIG, prepare=no_preparing)
    assert_same(again, surface)
    assert again.control.name == "another name"
    assert len(list(folder.iterdir())) == 1


def test_the_key_depends_on_all_that_matters_and_on_nothing_else():
    mesh = shapes.creature()
    moved = mesh.positions.copy()
    moved[3, 1] += 1e-12
    keys = [
        surface_key(mesh, 2, None, CONFIG),
        surface_key(mesh.with_positions(moved), 2, None, CONFIG),
        surface_key(mesh, 3, None, CONFIG),
        surface_key(mesh, 2, CatmullClark(boundary="edge_only"), CONFIG),
        surface_key(mesh, 2, None, replace(CONFIG, count=21)),
        surface_key(mesh, 2, None, replace(CONFIG, accuracy=1e-7)),
        surface_key(mesh, 2, None, replace(CONFIG, schedule=(10, 10))),
        surface_key(mesh.with_uvs(np.zeros((1, 2)), np.zeros_like(mesh.face_indices)), 2, None, CONFIG),
    ]
    assert len(set(keys)) == len(keys)
    assert surface_key(replace(mesh, name="x"), 2, CatmullClark(), CONFIG) == keys[0]


DAMAGE = {
    "newer": lambda path: edit_header(path, lambda header: header.update(format_version=99)),
    "older": lambda path: edit_header(path, lambda header: header.update(format_version=0)),
    "something else": lambda path: edit_header(path, lambda header: header.update(format="cagemap-result")),
    "no scheme": lambda path: edit_header(path, lambda header: header.pop("scheme")),
    "unknown scheme": lambda path: edit_header(path, lambda header: header.update(scheme={"name": "doo-sabin"})),
    "another level": lambda path: edit_header(path, lambda header: header.update(level=1)),
    "a band missing": lambda path: rewrite_arrays(path, band_0=None),
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_another_content_is_refused_by_name(damage, stored):
    DAMAGE[damage](stored)
    refuses(FormatError, stored.name, load_surface, stored)


def test_a_missing_file_is_named(tmp_path):
    refuses(FormatError, "no such file", load_surface, tmp_path / "absent.npz")


def test_an_unusable_folder_is_named_before_any_work(tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(FormatError, match="file"):
        load_or_prepare(tmp_path / "file", shapes.creature(), LEVEL, CONFIG, prepare=no_preparing)


def test_nothing_is_stored_when_preparing_fails(tmp_path):
    def failing(*arguments, **options):
        raise ParameterError("no")

    with pytest.raises(ParameterError):
        load_or_prepare(tmp_path, shapes.creature(), LEVEL, CONFIG, prepare=failing)
    assert not list(tmp_path.iterdir())


def test_a_broken_write_leaves_the_old_file(stored, surface, monkeypatch):
    before = stored.read_bytes()

    def half(path, arrays):
        path.write_bytes(b"PK half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("cagemap.files.result.surface_store.write_npz", half)
    refuses(FormatError, "No space left", save_surface, stored, surface)
    assert stored.read_bytes() == before
    assert [path.name for path in stored.parent.iterdir()] == [stored.name]


def test_two_at_once_both_get_the_surface(surface, tmp_path):
    barrier = threading.Barrier(2)

    def slowly(*arguments, **options):
        barrier.wait(timeout=60)  # both have found no file
        return surface

    with ThreadPoolExecutor(2) as pool:
        args = (tmp_path, shapes.creature(), LEVEL, CONFIG)
        results = list(pool.map(lambda _: load_or_prepare(*args, prepare=slowly), range(2)))
    for result in results:
        assert_same(result, surface)
    assert len(list(tmp_path.iterdir())) == 1


def test_it_changes_with_any_python_file_and_with_nothing_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    room = tmp_path / "cagemap" / "room"
    room.mkdir(parents=True)
    (room / "a.py").write_text("x = 1\n")
    monkeypatch.setattr(resources, "files", lambda _: tmp_path / "cagemap")
    version = code_version.__wrapped__  # a process keeps that of its start
    before = version()
    (room / "style.css").write_text("p {}")
    assert version() == before
    (room / "a.py").write_text("x = 2\n")
    changed = version()
    assert changed != before
    (room / "a.py").rename(room / "b.py")
    assert version() not in (before, changed)
