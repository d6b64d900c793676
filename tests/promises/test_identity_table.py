"""Every kind of mesh x every kind of value, from file to file: what goes in comes back from the mesh itself.

Also where its vertices and faces are renumbered, which only closest points tell. Meshes are small: a cell of the table
takes a few hundredths of a second.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from examples.shapes import triangulated, voxels

from cagemap.files.images.image import read_image, write_image
from cagemap.files.meshes.formats import read_mesh, write_mesh
from cagemap.files.result.folder import read_result
from cagemap.mesh import CatmullClark, ControlMesh
from cagemap.mesh.parts import find_part, join_meshes
from cagemap.tasks.match import run_match
from cagemap.tasks.progress import Stages
from cagemap.tasks.requests.match import MatchRequest
from cagemap.tasks.requests.transfer import TransferRequest
from cagemap.tasks.transfer import run_transfer

from fbx_scenes import write_fbx

# The quads lie in 5 x 5 cells of the layout; of several parts, the second lies in the last cell.
CELLS, TEXELS, QUADS = 5, 12, 22
JOINTS = 5


def shape() -> ControlMesh:
    """A bent bar without symmetry, each of its quads in a cell of its own of the layout."""
    bar = voxels([(0, 0, 0), (1, 0, 0), (2, 0, 0), (2, 1, 0), (2, 1, 1)])
    rng = np.random.default_rng(11)
    cells = np.column_stack([np.arange(QUADS) % CELLS, np.arange(QUADS) // CELLS])
    square = 0.1 + 0.8 * np.array([(0, 0), (1, 0), (1, 1), (0, 1)], dtype=float)
    uvs = ((cells[:, None] + square) / CELLS).reshape(-1, 2)
    moved = bar.with_positions(bar.positions + 0.12 * rng.normal(size=bar.positions.shape))
    return replace(moved.with_uvs(uvs, np.arange(len(uvs))), name="bar")


def texels(quads: np.ndarray) -> np.ndarray:
    """(h, w) values of the first part's quads at the texels that lie in them, NaN elsewhere."""
    within = np.abs((np.arange(TEXELS) + 0.5) / TEXELS - 0.5) < 0.4
    cells = np.append(quads, np.full(CELLS**2 - QUADS, np.nan)).reshape(CELLS, CELLS)[
        ::-1
    ]  # the image begins at the top
    spread = cells.repeat(TEXELS, axis=0).repeat(TEXELS, axis=1)
    return np.where(np.tile(within[:, None] & within, (CELLS, CELLS)), spread, np.nan)


@dataclass(frozen=True)
class Renumbered:
    """A mesh with other numbers, and which vertices, faces and corners of the first one its own are."""

    mesh: ControlMesh
    vertices: np.ndarray
    faces: np.ndarray
    corners: np.ndarray


def renumbered(mesh: ControlMesh, rng: np.random.Generator | None) -> Renumbered:
    """Vertices and faces in another order, faces from another corner; nothing changes without a generator."""
    size = int(mesh.face_sizes[0])
    vertices, faces = np.arange(mesh.n_vertices), np.arange(mesh.n_faces)
    turns = np.zeros(mesh.n_faces, dtype=np.int64)
    if rng is not None:
        vertices, faces = rng.permutation(vertices), rng.permutation(faces)
        # A quad that is bent keeps the diagonal that splits it.
        turns = rng.integers(0, 3, mesh.n_faces) if size == 3 else 2 * rng.integers(0, 2, mesh.n_faces)
    corners = (size * faces[:, None] + (np.arange(size) + turns[:, None]) % size).ravel()
    other = replace(
        mesh,
        positions=mesh.positions[vertices],
        face_indices=np.argsort(vertices)[mesh.face_indices[corners]],
        uv_indices=None if mesh.uv_indices is None else mesh.uv_indices[corners],
        face_objects=None if mesh.face_objects is None else mesh.face_objects[faces],
    )
    return Renumbered(other, vertices, faces, corners)


@dataclass(frozen=True)
class Kind:
    """A kind of mesh: its file and how it is matched; split into triangles, with a part beside it, or masked."""

    scheme: str | None
    suffix: str = ".obj"
    triangles: bool = False
    parts: bool = False
    masked: bool = False


KINDS = {
    "catmull-clark": Kind("catmull-clark"),
    "loop": Kind("loop", triangles=True),
    "bilinear": Kind("bilinear"),
    "plain triangles": Kind("none", triangles=True),
    "plain quads": Kind("none"),
    "part": Kind("catmull-clark", parts=True),
    "plain part": Kind("none", parts=True),
    "masked": Kind("catmull-clark", masked=True),
    "plain masked": Kind("none", masked=True),
    "ply": Kind(None, ".ply"),
    "usd": Kind(None, ".usda"),
    "glb": Kind("none", ".glb"),
    "fbx": Kind("none", ".fbx"),
}


@dataclass(frozen=True)
class Case:
    """A pair of files that were matched, and how much (from 0 to 1) is transferred to the target's own numbers."""

    kind: Kind
    folder: Path
    source: ControlMesh
    target: Renumbered
    share: dict[str, np.ndarray]

    def transfer(self, output: str, base: str, **options: object) -> Path:
        """Carry something; ``base`` has the target's own values where they stay outside a mask."""
        own = (("", self.folder / base),) if self.kind.masked and base else ()
        request = TransferRequest(self.folder / "R", self.folder / output, bases=own, force=True, **options)
        run_transfer(request, Stages())
        return request.output

    def expected(self, name: str, values: np.ndarray, base: np.ndarray | float = 0.0) -> np.ndarray:
        """Values of the source in the target's numbers, those of the base where nothing is transferred."""
        own = values[getattr(self.target, name)]
        share = self.share[name].reshape(-1, *[1] * (own.ndim - 1))
        return np.asarray(share * own + (1 - share) * base)


def mesh_of(kind: Kind) -> ControlMesh:
    mesh = triangulated(shape()) if kind.triangles else shape()
    if kind.parts:
        beside = replace(mesh, positions=1.3 * mesh.positions + [9.0, 0.0, 0.0], uvs=(4.2 + 0.6 * mesh.uvs) / CELLS)
        mesh = join_meshes([mesh, beside])
        halves = np.arange(mesh.n_faces) * 2 // mesh.n_faces
        mesh = replace(mesh, face_objects=halves, object_names=("bar", "other"))
    if kind.suffix == ".usda" and kind.scheme is None:
        mesh = replace(mesh, scheme=CatmullClark())
    return mesh


@pytest.fixture(scope="module", params=[f"{kind}, {numbers}" for kind in KINDS for numbers in ("same", "others")])
def case(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Case]:
    name, numbers = request.param.split(", ")
    kind, folder = KINDS[name], tmp_path_factory.mktemp("case")
    source = mesh_of(kind)
    target = renumbered(source, None if numbers == "same" else np.random.default_rng(5))
    files = [folder / f"{side}{kind.suffix}" for side in ("target", "source")]
    if kind.suffix == ".fbx":
        pytest.importorskip("ufbx")
        request.getfixturevalue("fbx_server")
    for file, mesh in zip(files, (target.mesh, source), strict=True):
        (write_fbx if kind.suffix == ".fbx" else write_mesh)(file, mesh)
    np.savetxt(folder / "mask.csv", target.mesh.positions[:, 0] > 0.5, fmt="%.1f")
    request = MatchRequest(
        *files,
        folder / "R",
        scheme=kind.scheme,
        level=None if kind.scheme == "none" else 1,
        part="bar" if kind.parts else None,
        target_mask=str(folder / "mask.csv") if kind.masked else None,
    )
    said, _ = run_match(request, Stages())
    manifest = json.loads((folder / "R" / "manifest.json").read_text())
    known = "as it stands, 0.00 % of the model's size apart" if numbers == "others" else "they are one surface"
    assert known in said
    assert known in manifest["confidence"]["message"]
    assert manifest["quality"]["flipped_area"] == 0
    share = {"vertices": np.ones(source.n_vertices), "faces": np.ones(source.n_faces)}
    if kind.parts:
        part = find_part(target.mesh, "bar").faces
        share["faces"] = np.isin(np.arange(source.n_faces), part).astype(float)
        share["vertices"] = np.isin(
            np.arange(source.n_vertices), target.mesh.face_indices.reshape(source.n_faces, -1)[part]
        ).astype(float)
    if kind.masked:
        share["vertices"] = read_result(folder / "R").masks.target[: source.n_vertices]
    corners = share["vertices"][target.mesh.face_indices]
    if kind.masked:
        share["faces"] = corners.reshape(source.n_faces, -1).mean(axis=1)
    with pytest.MonkeyPatch.context() as patch:  # the result is read once for all that is transferred
        patch.setattr("cagemap.tasks.transfer.read_result", cache(read_result))
        yield Case(kind, folder, source, target, share | {"corners": corners})


def test_values_at_vertices_faces_and_corners(case: Case) -> None:
    rng = np.random.default_rng(0)
    counts = {
        "vertices": case.source.n_vertices,
        "faces": case.source.n_faces,
        "corners": len(case.source.face_indices),
    }
    given = {name: rng.normal(size=(count, 2)) for name, count in counts.items()}
    labels = {f"{name}_labels": rng.integers(0, 9, count) for name, count in counts.items()}
    own = {name: np.zeros_like(array) for name, array in (given | labels).items()}
    np.savez(case.folder / "v.npz", **given, **labels)
    np.savez(case.folder / "own.npz", **own)
    output = case.transfer("w.npz", "own.npz", attribute=case.folder / "v.npz")
    with np.load(output) as carried:
        for name, values in given.items():
            np.testing.assert_allclose(carried[name], case.expected(name, values), rtol=0, atol=1e-9, err_msg=name)
        for name, values in labels.items():
            place = name.removesuffix("_labels")
            expected = np.where(case.share[place] >= 0.5, values[getattr(case.target, place)], 0)
            np.testing.assert_array_equal(carried[name], expected, err_msg=name)
            assert carried[name].dtype == values.dtype


def test_skin_weights(case: Case) -> None:
    skin = np.random.default_rng(1).dirichlet(np.ones(JOINTS), case.source.n_vertices)
    own = np.roll(np.eye(JOINTS)[np.zeros(case.source.n_vertices, dtype=int)], 1, axis=1)
    np.save(case.folder / "skin.npy", skin)
    np.save(case.folder / "own.npy", own)
    output = case.transfer("skin.npz", "own.npy", weights=case.folder / "skin.npy", influences=0)
    with np.load(output) as carried:
        expected = case.expected("vertices", skin, own if case.kind.masked else 0.0)
        np.testing.assert_allclose(carried["skin"], expected, rtol=0, atol=1e-9)


def test_blend_shapes(case: Case) -> None:
    offsets = 0.2 * np.random.default_rng(2).normal(size=(case.source.n_vertices, 3))
    np.savez(case.folder / "shapes.npz", smile=offsets)
    output = case.transfer("carried.npz", "", blend_shapes=(case.folder / "shapes.npz",))
    with np.load(output) as carried:
        np.testing.assert_allclose(carried["smile"], case.expected("vertices", offsets), rtol=0, atol=1e-8)


def test_joints(case: Case) -> None:
    joints = [
        {"name": "hip", "parent": None, "head": [0.2, 0.5, 0.4], "tail": [2.4, 0.5, 0.5]},
        {"name": "knee", "parent": "hip", "head": [2.4, 0.5, 0.5], "tail": [2.5, 1.5, 1.8]},
    ]
    (case.folder / "joints.json").write_text(json.dumps(joints))
    output = case.transfer("moved.json", "", joints=case.folder / "joints.json")
    moved = json.loads(output.read_text())["joints"]
    for before, after in zip(joints, moved, strict=True):
        assert after["name"] == before["name"]
        for end in ("head", "tail"):
            np.testing.assert_allclose(after[end], before[end], rtol=0, atol=1e-6)


def baked(case: Case, image: np.ndarray, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Texels of an image that are transferred, and what comes of them."""
    write_image(case.folder / "given.png", image, force=True)
    write_image(case.folder / "base.png", np.zeros_like(image), force=True)
    output = case.transfer("baked.png", "base.png", **{name: case.folder / "given.png"})
    # Of the target's faces that are transferred, back in the source's numbers, which the layout has.
    faces = np.empty(case.source.n_faces)
    faces[case.target.faces] = case.share["faces"]
    quads = faces.reshape(-1, 2).min(axis=1) if case.kind.triangles else faces
    whole = texels(quads[:QUADS]) > 1.0 - 1e-9
    assert whole.any()
    return image[whole].astype(float), read_image(output).pixels[whole].astype(float)


def test_images(case: Case) -> None:
    image = np.random.default_rng(3).integers(0, 256, (CELLS * TEXELS, CELLS * TEXELS, 3)).astype(np.uint8)
    given, carried = baked(case, image, "texture")
    assert np.abs(carried - given).max() <= 1


def test_normal_maps(case: Case) -> None:
    directions = np.random.default_rng(4).normal(size=(CELLS * TEXELS, CELLS * TEXELS, 3))
    directions[:, :, 2] = np.abs(directions[:, :, 2]) + 0.5
    directions /= np.linalg.norm(directions, axis=2, keepdims=True)
    image = np.rint(255 * (0.5 * directions + 0.5)).astype(np.uint8)
    given, carried = baked(case, image, "normal_map")
    assert np.abs(carried - given).max() <= 1


@pytest.mark.parametrize("kind", ["displacement", "vector_displacement"])
def test_displacement(case: Case, kind: str) -> None:
    channels = 1 if kind == "displacement" else 3
    image = np.random.default_rng(5).integers(0, 65_536, (CELLS * TEXELS, CELLS * TEXELS, channels)).astype(np.uint16)
    given, carried = baked(case, image, kind)
    assert np.abs(carried - given).max() <= 1


def test_point_maps(case: Case) -> None:
    output = case.transfer("map.npz", "", write_map=True)
    result = read_result(case.folder / "R")
    with np.load(output) as point_map:
        corners = result.source.vertices[result.source_triangles[point_map["triangle"]]]
        images = np.einsum("nc,ncd->nd", point_map["barycentric"], corners)
    np.testing.assert_allclose(images, result.target.vertices, rtol=0, atol=1e-9)


def test_texture_coordinates(case: Case) -> None:
    laid_out = read_mesh(case.transfer("laid_out.obj", "", source_uvs=True))
    given = case.source.uvs[case.source.uv_indices][
        case.target.corners
    ]  # beside a part: the target's own, which are equal
    np.testing.assert_allclose(laid_out.uvs[laid_out.uv_indices], given, rtol=0, atol=1e-7)  # USD has single precision


@pytest.mark.parametrize("kind", ["catmull-clark", "loop", "plain quads"])
def test_texture_coordinates_that_mirrored_halves_share(tmp_path: Path, kind: str) -> None:
    mesh = mesh_of(KINDS[kind])
    size = int(mesh.face_sizes[0])
    square = np.array([(0.1, 0.1), (0.9, 0.2), (0.8, 0.9), (0.2, 0.7)])[:size]
    mesh = mesh.with_uvs(square, np.tile(np.arange(size), mesh.n_faces))
    files = tmp_path / "target.obj", tmp_path / "source.obj"
    for file in files:
        write_mesh(file, mesh)
    level = None if KINDS[kind].scheme == "none" else 2
    run_match(MatchRequest(*files, tmp_path / "R", scheme=KINDS[kind].scheme, level=level), Stages())
    run_transfer(TransferRequest(tmp_path / "R", tmp_path / "laid_out.obj", source_uvs=True), Stages())
    laid_out = read_mesh(tmp_path / "laid_out.obj")
    np.testing.assert_allclose(laid_out.uvs[laid_out.uv_indices], mesh.uvs[mesh.uv_indices], rtol=0, atol=1e-7)
