"""Masked matches, transfers and wraps of files: what lies outside the mask stays the target's own."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples.shapes import creature, torus

from cagemap.errors import FormatError, ParameterError
from cagemap.files.images.image import Image, read_image, write_image
from cagemap.files.landmarks.pairs import write_landmarks
from cagemap.files.meshes.formats import read_mesh
from cagemap.files.meshes.obj_write import write_obj
from cagemap.files.result.folder import read_result
from cagemap.files.result.maps import write_map
from cagemap.files.values.attributes import read_attributes, write_attributes
from cagemap.maps.masks import face_mask
from cagemap.mesh import ControlMesh
from cagemap.mesh.parts import find_part
from cagemap.report import draw_gallery
from cagemap.tasks.import_map import run_map
from cagemap.tasks.masks import read_mask
from cagemap.tasks.match import MatchRequest, run_match
from cagemap.tasks.progress import Stages
from cagemap.tasks.requests.import_map import MapRequest
from cagemap.tasks.requests.transfer import TransferRequest
from cagemap.tasks.transfer import run_transfer
from cagemap.tasks.wrap import WrapRequest, run_wrap

from example_result import identity_result
from plain_meshes import marks_at
from quick_match import from_one_start


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A creature whose hind half is a group; the source's is swollen, which nobody wants on the target."""
    folder = tmp_path_factory.mktemp("masks")
    mesh = creature()
    corners = np.arange(len(mesh.face_indices))
    size = int(np.ceil(np.sqrt(mesh.n_faces)))
    place = np.column_stack([mesh.corner_faces % size, mesh.corner_faces // size])
    unit = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])[(corners - mesh.face_offsets[mesh.corner_faces]) % 4]
    mesh = mesh.with_uvs((place + 0.1 + 0.8 * unit) / size, corners)
    centres = np.add.reduceat(mesh.positions[mesh.face_indices], mesh.face_offsets[:-1]) / mesh.face_sizes[:, None]
    hind = (centres[:, 0] < np.median(centres[:, 0])).astype(np.int64)
    mesh = replace(mesh, face_groups=hind, group_names=("front", "hind"))
    write_obj(folder / "target.obj", mesh)
    behind = mesh.positions[:, 0] < np.median(mesh.positions[:, 0])
    swollen = mesh.positions * np.where(behind[:, None], [1.0, 1.6, 1.6], 1.0)
    write_obj(folder / "source.obj", mesh.with_positions(swollen))
    front = np.flatnonzero(~behind)[:: max(1, int((~behind).sum()) // 16)]
    write_landmarks(folder / "landmarks.json", marks_at(front, "target.obj", "source.obj"))
    write_image(folder / "texture.png", np.random.default_rng(1).integers(0, 256, (64, 64, 3), dtype=np.uint8))
    write_image(folder / "base.png", np.full((64, 64, 3), 9, dtype=np.uint8))
    _run_match(folder, "RESULT", target_mask="front", source_mask="not:hind")
    return folder


def _faces(control: ControlMesh, name: str) -> np.ndarray:
    found = np.zeros(control.n_faces)
    found[find_part(control, name).faces] = 1
    return found


def _run_match(folder: Path, name: str, **options: object) -> None:
    request = MatchRequest(
        folder / "target.obj",
        folder / "source.obj",
        folder / name,
        folder / "landmarks.json",
        level=2,
        k=20,
        parameter=("search_vertices=500",),
        **options,
    )
    run_match(request, Stages())


def _run_transfer(folder: Path, output: str, **options: object) -> tuple[str, list[str]]:
    request = TransferRequest(folder / "RESULT", folder / output, **options)
    return run_transfer(request, Stages())


@pytest.mark.slow
def test_a_masked_match_keeps_its_masks_and_pulls_only_there(scene: Path) -> None:
    result = read_result(scene / "RESULT")
    assert result.manifest["parameters"]["target_mask"] == "front"
    control = result.target.control
    inside = face_mask(result.target.refinement, _faces(control, "front"))
    assert np.all(result.masks.target[inside == 0] == 0)
    assert 0 < result.masks.target[inside == 1].min() < result.masks.target.max() == 1
    # In front nothing was changed: the map is the identity there, whatever the hind half does.
    moved = np.linalg.norm(result.image() - result.target.vertices, axis=1)
    scale = np.sqrt(result.point_map.target.scale**-2)
    assert moved[result.masks.joint(result.point_map) > 0.9].mean() < 0.03 * scale
    gallery = draw_gallery(result, size=(60, 50))
    assert len(gallery.masks) == 2
    assert len(draw_gallery(identity_result(), size=(60, 50)).masks) == 0


@pytest.mark.slow
def test_outside_the_mask_the_texture_is_the_base(scene: Path) -> None:
    summary, _ = _run_transfer(scene, "over.png", texture=scene / "texture.png", bases=(("", scene / "base.png"),))
    assert "outside the masks it is" in summary
    over = read_image(scene / "over.png").pixels
    summary, _ = _run_transfer(scene, "alpha.png", texture=scene / "texture.png")
    assert "alpha" in summary
    faded = read_image(scene / "alpha.png").pixels
    alpha = faded[..., 3]
    assert 0.2 < np.mean(alpha == 0) < 0.8
    assert np.mean(alpha == 255) > 0.1
    assert np.all(over[alpha == 0] == 9)
    np.testing.assert_array_equal(over[alpha == 255], faded[alpha == 255][:, :3])
    with pytest.raises(FormatError, match="JPEG holds no alpha"):
        _run_transfer(scene, "alpha.jpg", texture=scene / "texture.png")
    write_image(scene / "small.png", np.zeros((16, 16, 4), dtype=np.uint8))
    with pytest.raises(ParameterError, match="expected 16 x 16 texels of 3 channels"):
        _run_transfer(scene, "no.png", texture=scene / "texture.png", bases=(("", scene / "small.png"),))


@pytest.fixture(scope="module")
def whole(scene: Path) -> Path:
    """The same pair matched without masks."""
    with from_one_start():
        _run_match(scene, "WHOLE")
    return scene / "WHOLE"


@pytest.mark.slow
def test_masks_of_a_transfer_are_beside_those_of_the_match(scene: Path, whole: Path) -> None:
    alphas = []
    for result, masks in (
        ("RESULT", {}),
        (whole.name, {"target_mask": "front", "source_mask": "not:hind"}),
        ("RESULT", {"target_mask": "front", "source_mask": "not:hind", "mask_edge": 0.0}),
    ):
        request = TransferRequest(scene / result, scene / "further.png", texture=scene / "texture.png", **masks)
        run_transfer(request, Stages())
        alphas.append(read_image(scene / "further.png").pixels[..., 3].astype(int))
    at_match, later, both = alphas
    # The maps differ where nothing pulls, so the source's soft edge lies a little elsewhere.
    assert np.abs(later - at_match).mean() < 5
    assert np.all(both <= at_match)
    write_image(scene / "painted.png", np.full((64, 64), 128, dtype=np.uint8))
    _run_transfer(scene, "further.png", texture=scene / "texture.png", target_mask=str(scene / "painted.png"))
    half = read_image(scene / "further.png").pixels[..., 3]
    assert np.abs(half - at_match * (128 / 255)).max() <= 1
    with pytest.raises(ParameterError, match="target mask: expected some of the surface to count"):
        _run_transfer(scene, "no.png", texture=scene / "texture.png", target_mask="hind")
    with pytest.raises(FormatError, match="is an input too"):
        _run_transfer(scene, "painted.png", texture=scene / "texture.png", target_mask=str(scene / "painted.png"))


@pytest.mark.slow
def test_masks_of_a_wrap_and_of_a_map_leave_parts_out(scene: Path, whole: Path) -> None:
    with Stages() as stages:
        part, _ = run_wrap(WrapRequest((whole,), scene / "part.obj", target_mask="front"), stages)
        every, _ = run_wrap(WrapRequest((whole,), scene / "all.obj"), stages)
    assert "has no counterpart and follows its surroundings" in part
    assert "has no counterpart" not in every
    write_map(scene / "map.npz", read_result(whole).point_map)
    asked = MapRequest(
        scene / "map.npz", scene / "target.obj", scene / "source.obj", scene / "MAP", 2, target_mask="front"
    )
    run_map(asked, Stages())
    found = read_result(scene / "MAP")
    assert found.masks.source is None
    assert 0.2 < np.mean(found.masks.target == 0) < 0.8


def test_labels_do_not_mix_with_those_of_the_base(scene: Path) -> None:
    labels = np.array([[40], [200]], dtype=np.uint8)[np.random.default_rng(5).integers(0, 2, (64, 64))]
    write_image(scene / "labels.png", labels)
    write_image(scene / "under.png", np.full((64, 64, 1), 9, dtype=np.uint8))
    under = (("", scene / "under.png"),)
    _run_transfer(scene, "ids.png", texture=scene / "labels.png", bases=under, filter="nearest")
    assert set(np.unique(read_image(scene / "ids.png").pixels)) == {9, 40, 200}


def test_a_mask_fades_colours_that_are_multiplied_by_alpha_once(scene: Path) -> None:
    multiplied = np.tile(np.array([20, 20, 20, 51], dtype=np.uint8), (64, 64, 1))
    write_image(scene / "glass.tif", Image(multiplied, associated=True))
    _run_transfer(scene, "faded.tif", texture=scene / "glass.tif")
    faded = read_image(scene / "faded.tif")
    assert not faded.associated
    assert set(np.unique(faded.pixels[..., :3])) == {100}
    assert (faded.pixels[..., 3].min(), faded.pixels[..., 3].max()) == (0, 51)
    write_image(scene / "clear.png", np.full((64, 64, 4), 255, dtype=np.uint8))
    _run_transfer(scene, "over.tif", texture=scene / "glass.tif", bases=(("", scene / "clear.png"),))
    over = read_image(scene / "over.tif")
    assert not over.associated
    assert over.pixels[..., :3].min() == 100


@pytest.mark.slow
def test_outside_the_mask_values_and_cages_stay(scene: Path) -> None:
    result = read_result(scene / "RESULT")
    control = result.target.control
    own = np.random.default_rng(2).random(control.n_vertices)
    write_attributes(scene / "given.npz", {"weight": 5 + own})
    _, warnings = _run_transfer(scene, "carried.npz", attribute=scene / "given.npz")
    assert any("--base" in text for text in warnings)
    mixed = []
    for name, base in (("own", own), ("zeros", np.zeros(control.n_vertices, dtype=np.int64))):
        np.savez(scene / f"{name}.npz", weight=base)
        _run_transfer(scene, f"{name}_out.npz", attribute=scene / "given.npz", bases=(("", scene / f"{name}.npz"),))
        mixed.append(read_attributes(scene / f"{name}_out.npz")["weight"])
    weight = result.masks.joint(result.point_map)[: control.n_vertices]
    # Whole numbers in a base are mixed as others are.
    np.testing.assert_allclose(mixed[1], mixed[0] - (1 - weight) * own, atol=1e-12)
    run_wrap(WrapRequest((scene / "RESULT",), scene / "wrapped.obj"), Stages())
    wrapped = read_mesh(scene / "wrapped.obj").positions
    # The swollen half is not taken over: its cage follows the front, which is as it was.
    behind = weight == 0
    swollen, own_shape = result.source.control.positions[behind], control.positions[behind]
    assert np.abs(wrapped[behind] - own_shape).mean() < 0.8 * np.abs(wrapped[behind] - swollen).mean()


def test_a_bake_has_the_size_of_its_base(scene: Path) -> None:
    write_image(scene / "wide.png", np.full((16, 32, 3), 9, dtype=np.uint8))
    summary, _ = _run_transfer(scene, "over_wide.png", texture=scene / "texture.png", bases=(("", scene / "wide.png"),))
    assert "32 x 16 texels" in summary
    pixels = read_image(scene / "over_wide.png").pixels
    assert pixels.shape == (16, 32, 3)
    assert (pixels == 9).all(axis=2).any()


@pytest.mark.parametrize(
    ("size", "channels", "options"), [(16, 4, {}), (8, 3, {"size": 16}), (8, 1, {"bake": ("colors",)})]
)
def test_a_base_that_does_not_fit_is_refused_before_the_bake(scene, monkeypatch, size, channels, options):
    monkeypatch.setattr("cagemap.tasks.carry_images.prepare_bake", lambda *given: pytest.fail("it was prepared"))
    write_image(scene / f"base{channels}.png", np.zeros((size, size, channels), dtype=np.uint8))
    options = {"bases": (("", scene / f"base{channels}.png"),), "texture": scene / "texture.png", **options}
    options |= {"texture": None} if "bake" in options else {}
    with pytest.raises(ParameterError, match=rf"--base .*got {size} x {size} of {channels}"):
        _run_transfer(scene, "never.png", **options)


def test_a_mask_of_as_many_vertices_as_faces_is_said_to_be_at_vertices(tmp_path, caplog):
    ring = torus()
    assert ring.n_vertices == ring.n_faces
    np.save(tmp_path / "m.npy", np.linspace(0.0, 1.0, ring.n_faces))
    assert read_mask(str(tmp_path / "m.npy"), None, ring, tmp_path / "ring.obj", "--target-mask").vertices is not None
    assert "as many rows as control vertices and as control faces: assumed to be at vertices" in caplog.text
