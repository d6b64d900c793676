"""``python -m benchmarks.plain``: files to RESULT of the human pairs as triangles, beside their cages.

The refined meshes are written out as triangles (400 000 and more) and matched by the command line, in a process of its
own, with ``--scheme none``; then the cages at the same level. Error, seconds and memory of each.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.accuracy.data import DATA, HUMANS, HumanPair
from benchmarks.truth import Truth, compare_with_truth, true_map
from cagemap.files.meshes.formats import write_mesh
from cagemap.files.result.folder import read_result
from cagemap.mesh import ControlMesh
from cagemap.pipeline import choose_level
from cagemap.subdivision import level_triangles, refine
from cagemap.surface.triangle_surface import TriangleSurface


@dataclass(frozen=True)
class Run:
    """One match from files to RESULT; errors x100 of sqrt(area), seconds of wall clock and of processors, GB."""

    mean: float
    p95: float
    seconds: float
    processor: float
    memory: float


def triangles_of(mesh: ControlMesh, level: int) -> ControlMesh:
    """A refined mesh as triangles."""
    refinement = refine(mesh, level)
    triangles = level_triangles(refinement, level)
    return ControlMesh(refinement.finest.positions, np.arange(0, triangles.size + 1, 3), triangles.ravel())


def neutral_surface(mesh: ControlMesh, neutral: np.ndarray, level: int) -> TriangleSurface:
    """The refined neutral shape, on which both connectivities of a pair coincide."""
    plain = triangles_of(mesh.with_positions(neutral), level)
    return TriangleSurface.from_faces(plain.positions, plain.face_indices.reshape(-1, 3))


def run(folder: Path, target: Path, source: Path, landmarks: Path, truth: Truth, options: list[str]) -> Run:
    """Match two files by the command line and judge the RESULT."""
    result = folder / "RESULT"
    command = [sys.executable, "-c", "from cagemap.cli import main; main()", "-q", "match", "-o", str(result), *options]
    files = ["--target", str(target), "--source", str(source), "--landmarks", str(landmarks)]
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run([*command, *files], check=True)
    seconds, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    found = read_result(result)
    figures = compare_with_truth(found.point_map, truth)
    used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return Run(100 * figures.mean, 100 * figures.p95, seconds, used, found.provenance["peak_memory_bytes"] / 1e9)


def measure(pair: HumanPair, vertices: int, landmarks: int) -> None:
    """One direction: the first model is the source, the second the target."""
    meshes, neutrals = pair.meshes(), pair.neutrals()
    levels = [choose_level(mesh, vertices) for mesh in meshes]
    surfaces = [neutral_surface(*side) for side in zip(meshes, neutrals, levels, strict=True)]
    truth = true_map(surfaces[1], surfaces[0])
    names = [f"{name}_{identity}" for name, identity in zip((pair.first, pair.second), pair.identities, strict=True)]
    marks = DATA / "humans" / "landmarks" / f"{pair.key}_fps{landmarks}.json"
    with tempfile.TemporaryDirectory() as text:
        folder = Path(text)
        files = [folder / f"{name}.ply" for name in names]
        for file, mesh, level in zip(files, meshes, levels, strict=True):
            write_mesh(file, triangles_of(mesh, level))
        plain = run(folder, files[1], files[0], marks, truth, ["--scheme", "none"])
        cages = [DATA / "humans" / f"{name}.obj" for name in names]
        asked = ["--set", f"source.level={levels[0]}", "--set", f"target.level={levels[1]}"]
        cage = run(folder, cages[1], cages[0], marks, truth, asked)
    counts = " and ".join(f"{len(surface.triangles):,}" for surface in surfaces[::-1])
    print(f"{names[0]} -> {names[1]}, {counts} triangles")
    for title, one in (("plain", plain), ("cage", cage)):
        print(
            f"  {title:5s} mean {one.mean:.3f} p95 {one.p95:.2f}, {one.seconds:.1f} s ({one.processor:.1f} s of "
            f"processor), {one.memory:.2f} GB"
        )
    print(f"  plain over cage: mean {plain.mean / cage.mean:.2f}", flush=True)


def main() -> None:
    """Measure the pairs asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pair", choices=HUMANS, action="append", help="default: the three of the accuracy bars")
    parser.add_argument("--vertices", type=int, default=200_000)
    parser.add_argument("--landmarks", type=int, default=14)
    arguments = parser.parse_args()
    for key in arguments.pair or list(HUMANS)[:3]:
        measure(HUMANS[key], arguments.vertices, arguments.landmarks)


if __name__ == "__main__":
    main()
