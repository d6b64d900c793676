"""``python -m benchmarks.textures WHAT [--size N] [--data DIR]``: one measure, printed as a line.

identity, back (onto another cage of the same shape and back, by real matches), tiles (20 UDIM images, read, baked and
written), large (one image of 8k or 16k).
"""

from __future__ import annotations

import argparse
import resource
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

import cagemap
from cagemap.cli.map_command import MapRequest
from cagemap.cli.match import MatchRequest, run_match
from cagemap.cli.own_map import run_map
from cagemap.cli.progress import Stages
from cagemap.cli.transfer import run_transfer
from cagemap.cli.transfer_request import TransferRequest
from cagemap.files.images import read_image, udim_path, write_image
from cagemap.files.landmarks import write_landmarks
from cagemap.files.meshes import read_mesh, write_mesh
from cagemap.mesh import ControlMesh, torus
from cagemap.mesh.landmarks import Landmarks
from cagemap.refinement import finest_mesh, refine
from cagemap.transfer import BakeOptions, unwrap
from cagemap.transfer.baking import make_canvas
from cagemap.transfer.texels import rasterize_band

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"


def touched(transfer: cagemap.transfer.Transfer, size: int, finer: int = 1) -> np.ndarray:
    """(size, size) texels whose centre, or for finer rasters any of whose samples, lies in the target's layout."""
    canvas = make_canvas(transfer, size, BakeOptions(supersample=finer))
    bare = replace(canvas.layout, gutter=0.0)
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


def back(data: Path, size: int, name: str, kind: str, grain: float) -> str:
    """PSNR of a texture after two real matches: onto another cage of the same shape with new UVs, and back."""
    mesh = read_mesh(data / "animals" / f"{name}.obj")
    texture = enlarged(read_image(data / "animals" / f"{name}_texture.png").pixels[..., :3], size)
    texture = grained(texture, grain)
    other = unwrap(replace(finest_mesh(refine(mesh, 1)), uvs=None, uv_indices=None))
    if kind == "turned":  # quads along the diagonals of the old ones
        other = unwrap(requadded(mesh))
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
            run_match(MatchRequest(root / target, root / source, root / f"{word}.json", root / word), Stages())
            run_transfer(TransferRequest(root / word, root / output, texture=root / image, size=size), Stages())
        returned = read_image(root / "returned.png").pixels
        result = cagemap.read_result(root / "back")
        where = touched(cagemap.transfer_of(result), size)
        quality = result.manifest["quality"]
    decibels = psnr(returned, texture, where)
    return f"{name} {kind} {size}, grain {grain:g}: {decibels:.2f} dB, folded {quality['flipped_area']:.5f}"


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
    parser.add_argument("what", choices=("identity", "back", "tiles", "large"))
    parser.add_argument("--size", type=int, default=4096)
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--name", default="spot")
    parser.add_argument("--kind", default="refined", choices=("refined", "turned"))
    parser.add_argument("--grain", type=float, default=0.0)
    parser.add_argument("--data", type=Path, default=DATA)
    given = parser.parse_args()
    measures = {
        "identity": lambda: identity(given.data, given.size),
        "back": lambda: back(given.data, given.size, given.name, given.kind, given.grain),
        "tiles": lambda: tiles(given.size, given.count),
        "large": lambda: large(given.size),
    }
    print(measures[given.what](), flush=True)


if __name__ == "__main__":
    main()
