"""``python -m benchmarks.textures WHAT [--size N] [--data DIR]``: one measure, printed as a line.

identity, back (onto another cage of the same shape and back, by real matches), bound (the same by the exact map),
edges (what a renderer sees at islands' borders, level by level of its mip chain), tiles (20 UDIM images, read, baked
and written), large (one image of 8k or 16k).
"""

from __future__ import annotations

import argparse
import resource
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np
from examples.shapes import torus
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

import cagemap
from benchmarks.textures.edges import border_errors
from cagemap.files.images.image import read_image, udim_path, write_image
from cagemap.files.landmarks.pairs import write_landmarks
from cagemap.files.meshes.formats import read_mesh, write_mesh
from cagemap.maps.result import MatchResult
from cagemap.mesh import ControlMesh
from cagemap.mesh.landmarks import Landmarks
from cagemap.subdivision import finest_mesh, refine
from cagemap.surface.triangles import triangle_areas, triangles
from cagemap.tasks.import_map import run_map
from cagemap.tasks.match import MatchRequest, run_match
from cagemap.tasks.progress import Stages
from cagemap.tasks.requests.import_map import MapRequest
from cagemap.tasks.requests.transfer import TransferRequest
from cagemap.tasks.transfer import run_transfer
from cagemap.transfer import BakeOptions, unwrap
from cagemap.transfer.baking import make_layout
from cagemap.transfer.texels import rasterize_band
from cagemap.transfer.texture import Filter

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"


def touched(transfer: cagemap.transfer.Transfer, size: int, finer: int = 1) -> np.ndarray:
    """(size, size) texels whose centre, or for finer rasters any of whose samples, lies in the target's layout."""
    layout = make_layout(transfer, size, BakeOptions(supersample=finer))
    bare = replace(layout, gutter=0.0)
    cells = np.concatenate([rasterize_band(bare, band) for band in range(len(bare.band_triangles))]) >= 0
    return np.asarray(cells.reshape(size, finer, size, finer).any(axis=(1, 3)))


def psnr(one: np.ndarray, other: np.ndarray, where: np.ndarray) -> float:
    """Peak signal to noise, dB, of 8-bit images over some texels."""
    squared = (one[where].astype(np.float64) - other[where].astype(np.float64)) ** 2
    return float(10 * np.log10(255.0**2 / max(squared.mean(), 1e-12)))


def enlarged(pixels: np.ndarray, size: int) -> np.ndarray:
    """A square image, interpolated linearly to a larger size."""
    at = np.clip((np.arange(size) + 0.5) * len(pixels) / size - 0.5, 0, len(pixels) - 1)
    low = at.astype(int)
    high, share = np.minimum(low + 1, len(pixels) - 1), (at - low)[:, None, None]
    rows = pixels[low] * (1 - share) + pixels[high] * share
    rows = rows.transpose(1, 0, 2)
    return np.rint((rows[low] * (1 - share) + rows[high] * share).transpose(1, 0, 2)).astype(np.uint8)


def grained(pixels: np.ndarray, contrast: float) -> np.ndarray:
    """An 8-bit image with noise of about three texels' size over it, so that it has detail of its own size."""
    noise = np.random.default_rng(0).standard_normal(pixels.shape[:2])
    for axis in (0, 1):
        noise = (np.roll(noise, 1, axis) + 2 * noise + np.roll(noise, -1, axis)) / 4
    grain = contrast * noise / noise.std()
    return np.rint(np.clip(pixels + grain[..., None], 0, 255)).astype(np.uint8)


def identity(data: Path, size: int) -> str:
    """Share of covered texels that come back within 1 level, spot and blub, at three densities."""
    lines = []
    for name in ("spot", "blub"):
        texture = enlarged(read_image(data / "animals" / f"{name}_texture.png").pixels[..., :3], size)
        for level in (3, 4, 5):
            finest = refine(read_mesh(data / "animals" / f"{name}.obj"), level).finest
            surface = cagemap.TriangleSurface.from_faces(finest.positions, finest.faces)
            point_map = cagemap.maps.point_map.PointMap.from_vertices(surface, surface, np.arange(surface.n))
            transfer = cagemap.prepare_transfer(finest, finest, point_map)
            baked = cagemap.bake_texture(transfer, texture, size=size)
            near = np.abs(baked.astype(int) - texture.astype(int)).max(axis=2) <= 1
            shares = [near[touched(transfer, size, finer)].mean() for finer in (1, 4)]
            lines.append(f"{name} level {level}: centres {100 * shares[0]:.3f} %, touched {100 * shares[1]:.3f} %")
    return "\n".join(lines)


def back(data: Path, size: int, name: str, kind: str, grain: float, lookup: Filter, between: int) -> str:
    """PSNR of a texture after two real matches: onto another cage of the same shape with new UVs, and back."""
    mesh, texture, other = _scene(data, size, name, kind, grain)
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        write_mesh(root / "one.obj", mesh)
        write_mesh(root / "other.obj", other)
        write_image(root / "given.png", texture)
        picked = np.linspace(0, mesh.n_vertices - 1, 12).astype(int)
        names = tuple(f"p{k}" for k in range(len(picked)))
        there = Landmarks(names, picked, picked, "other.obj", "one.obj")
        write_landmarks(root / "there.json", there)
        write_landmarks(root / "back.json", Landmarks(names, picked, picked, "one.obj", "other.obj"))
        steps = (
            ("other.obj", "one.obj", "there", "given.png", "between.png"),
            ("one.obj", "other.obj", "back", "between.png", "returned.png"),
        )
        for target, source, word, image, output in steps:
            run_match(MatchRequest(root / target, root / source, root / word, root / f"{word}.json"), Stages())
            texels = (between or size) if word == "there" else size
            request = TransferRequest(root / word, root / output, texture=root / image, size=texels, filter=lookup)
            run_transfer(request, Stages())
        returned = read_image(root / "returned.png").pixels
        result, there = (cagemap.read_result(root / word) for word in ("back", "there"))
        texels = texels_off(result, there, size)
        where = touched(cagemap.transfer_of(result), size)
        quality = result.manifest["quality"]
    decibels = psnr(returned, texture, where)
    return (
        f"{name} {kind} {size} -> {between or size} -> {size}, grain {grain:g}, {lookup}: {decibels:.2f} dB, folded "
        f"{quality['flipped_area']:.5f}; the two maps are {np.median(texels):.2f} texels off, "
        f"{np.quantile(texels, 0.95):.2f} for 95 %"
    )


def texels_off(back: MatchResult, there: MatchResult, size: int) -> NDArray[np.float64]:
    """(n,) how far vertices lie from where both maps take them, in texels of their own layout's mean density."""
    own = back.point_map.target
    returned = there.point_map.pull_back(there.point_map.source.positions)
    moved = back.point_map.pull_back(returned)
    level = back.target.refinement.finest
    density = size * np.sqrt(triangle_areas(level.uvs, triangles(level.uv_indices)).sum())  # the surface's area is 1
    return np.asarray(np.linalg.norm(moved - own.positions, axis=1) * density)


def bound(data: Path, size: int, name: str, grain: float, kind: Filter, between: int) -> str:
    """PSNR of the same way by the exact map: what the other layout alone leaves, with no error of a match.

    The other cage is the first refinement, so that its vertices lie where the cage's own of one level more do.
    """
    mesh, texture, other = _scene(data, size, name, "refined", grain)
    levels = refine(other, 3).finest, refine(mesh, 4).finest
    surfaces = [cagemap.TriangleSurface.from_faces(level.positions, level.faces) for level in levels]
    image, options = texture, cagemap.transfer.BakeOptions(filter=kind)
    for (target, source), texels in (((0, 1), between or size), ((1, 0), size)):
        one, two = surfaces[target], surfaces[source]
        same = cKDTree(levels[source].positions).query(levels[target].positions)[1]
        exact = cagemap.maps.point_map.PointMap.from_vertices(one, two, same)
        transfer = cagemap.prepare_transfer(levels[target], levels[source], exact)
        image = cagemap.bake_texture(transfer, image, size=texels, options=options)
    areas = [triangle_areas(level.uvs, triangles(level.uv_indices)).sum() for level in levels]
    where = touched(transfer, size)
    inner = ndimage.binary_erosion(where, iterations=4)
    return (
        f"{name}, exact map {size} -> {between or size} -> {size}, grain {grain:g}, {kind}: "
        f"{psnr(image, texture, where):.2f} dB, {psnr(image, texture, inner):.2f} four texels inside; "
        f"the other layout has {areas[0] / areas[1] * ((between or size) / size) ** 2:.2f} times the texels"
    )


def edges(data: Path, size: int) -> str:
    """Errors at islands' borders, level by level of the mip chain a renderer makes, for ways to fill the background."""
    lines = []
    for name in ("spot", "blub"):
        mesh, texture, other = _scene(data, size, name, "refined", 0.0)
        for cage, title in ((mesh, "its own layout"), (other, "unwrapped")):
            target, source = refine(cage, 3 if cage is mesh else 2).finest, refine(mesh, 3).finest
            one, two = (cagemap.TriangleSurface.from_faces(level.positions, level.faces) for level in (target, source))
            same = cKDTree(source.positions).query(target.positions)[1]
            transfer = cagemap.prepare_transfer(
                target, source, cagemap.maps.point_map.PointMap.from_vertices(one, two, same)
            )
            lines.append(f"{name} {size}, {title}: rms error of lookups near borders, 8-bit levels, by mip level")
            for fill, errors in border_errors(transfer, texture, size, 8).items():
                lines.append(f"  {fill:20s}" + " ".join(f"{error:6.2f}" for error in errors))
    return "\n".join(lines)


def _scene(
    data: Path, size: int, name: str, kind: str, grain: float
) -> tuple[ControlMesh, NDArray[np.uint8], ControlMesh]:
    """A cage, its texture, and another cage of the same shape with a layout of its own."""
    mesh = read_mesh(data / "animals" / f"{name}.obj")
    texture = enlarged(read_image(data / "animals" / f"{name}_texture.png").pixels[..., :3], size)
    texture = grained(texture, grain)
    other = unwrap(replace(finest_mesh(refine(mesh, 1)), uvs=None, uv_indices=None))
    if kind == "turned":  # quads along the diagonals of the old ones
        other = unwrap(requadded(mesh))
    return mesh, texture, other


def requadded(mesh: ControlMesh) -> ControlMesh:
    """Nearly the same surface in other quads: one for each edge of level 1, between its ends and its faces' points."""
    refinement = refine(mesh, 2)
    faces = refinement.levels[1].faces
    assert faces is not None
    tails, heads = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    face = np.repeat(np.arange(len(faces)), faces.shape[1])
    n = refinement.levels[1].n_vertices
    owner = {(a, b): f for a, b, f in zip(tails.tolist(), heads.tolist(), face.tolist(), strict=True)}
    quads = [(a, n + owner[b, a], b, n + f) for (a, b), f in owner.items() if a < b and (b, a) in owner]
    positions = refinement.finest.positions
    # Level 2 numbers vertices, then edges, then faces.
    points = np.concatenate([positions[:n], positions[len(positions) - len(faces) :]])
    return ControlMesh.from_faces(points, quads, name=mesh.name)


def tiled(columns: int, tiles: int) -> ControlMesh:
    """A torus whose faces lie in the squares of 20 tiles, ten a row."""
    mesh = torus(columns, columns)
    per_tile = -(-mesh.n_faces // tiles)
    side = int(np.ceil(np.sqrt(per_tile)))
    unit = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    face, tile = np.divmod(np.arange(mesh.n_faces), tiles)
    place = np.column_stack([face % side, face // side])
    origin = np.column_stack([tile % 10, tile // 10])
    uvs = ((place[:, None] + 0.02 + 0.96 * unit) / side + origin[:, None]).reshape(-1, 2)
    return mesh.with_uvs(uvs, np.arange(len(uvs)))


def tiles(size: int, count: int) -> str:
    """Wall and processor seconds and peak memory of a whole `cagemap transfer` of a UDIM set."""
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        mesh = tiled(40, count)
        write_mesh(root / "source.obj", mesh)
        write_mesh(root / "target.obj", mesh.with_positions(mesh.positions * [1.0, 1.1, 0.9]))
        np.save(root / "map.npy", np.arange(refine(mesh, 3).finest.n_vertices))
        rng = np.random.default_rng(0)
        base = np.kron(rng.integers(0, 256, (size // 16, size // 16, 3)), np.ones((16, 16, 1))).astype(np.uint8)
        for tile in range(count):
            number = 1001 + tile % 10 + 10 * (tile // 10)
            write_image(udim_path(root / "skin.<UDIM>.png", number), base)
        run_map(MapRequest(root / "map.npy", root / "target.obj", root / "source.obj", root / "RESULT", 3), Stages())
        wall, processor = time.perf_counter(), time.process_time()
        request = TransferRequest(root / "RESULT", root / "out.<UDIM>.png", texture=root / "skin.<UDIM>.png")
        run_transfer(request, Stages())
        spent = time.perf_counter() - wall, time.process_time() - processor
        found = len(list(root.glob("out.*.png")))
    return f"{found} tiles of {size}: {spent[0]:.1f} s wall, {spent[1]:.1f} s processor, {peak():.2f} GB at most"


def large(size: int) -> str:
    """Seconds and peak memory of one image of a large size, from a source of the same size."""
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        mesh = tiled(40, 1)
        finest = refine(mesh, 3).finest
        surface = cagemap.TriangleSurface.from_faces(finest.positions, finest.faces)
        point_map = cagemap.maps.point_map.PointMap.from_vertices(surface, surface, np.arange(surface.n))
        transfer = cagemap.prepare_transfer(finest, finest, point_map)
        pixels = np.zeros((size, size, 3), dtype=np.uint8)
        pixels[::2] = 200
        started, before = time.perf_counter(), peak()
        baked = cagemap.bake_texture(transfer, pixels, size=size)
        seconds, within = time.perf_counter() - started, peak()
        write_image(root / "out.png", baked)
    return f"{size}: bake {seconds:.1f} s; {before:.2f} GB before, {within:.2f} GB baked, {peak():.2f} GB written"


def peak() -> float:
    """Largest resident memory so far, GB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6


def main() -> None:
    """Run one measure."""
    parser = argparse.ArgumentParser()
    parser.add_argument("what", choices=("identity", "back", "bound", "edges", "tiles", "large"))
    parser.add_argument("--size", type=int, default=4096)
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--name", default="spot")
    parser.add_argument("--kind", default="refined", choices=("refined", "turned"))
    parser.add_argument("--grain", type=float, default=0.0)
    parser.add_argument("--filter", default="smooth", choices=get_args(Filter))
    parser.add_argument("--between", type=int, default=0)
    parser.add_argument("--data", type=Path, default=DATA)
    given = parser.parse_args()
    measures = {
        "identity": lambda: identity(given.data, given.size),
        "back": lambda: back(given.data, given.size, given.name, given.kind, given.grain, given.filter, given.between),
        "bound": lambda: bound(given.data, given.size, given.name, given.grain, given.filter, given.between),
        "edges": lambda: edges(given.data, given.size),
        "tiles": lambda: tiles(given.size, given.count),
        "large": lambda: large(given.size),
    }
    print(measures[given.what](), flush=True)


if __name__ == "__main__":
    main()
