"""The sets as they are published: which shapes, where their files are, and which points of them correspond.

A set is a folder as its authors pack it. Points of the template are numbered from 0 here, whatever a file counts from.
"""

from __future__ import annotations

import random
import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations
from pathlib import Path

import numpy as np
from scipy.io import loadmat

from cagemap.mesh import ControlMesh
from cagemap.mesh.cage_points import CagePoints

FAUST_VERTICES = 6890
# Lists of pairs.
LISTS = {"shrec20": "test-set*.txt", "tosca": "test_pairs.txt"}
# Parts of PFAUST have the names of whole bodies, in folders of their own; here they get this prefix.
PART, PART_FOLDER, PART_POINTS = "part of ", "partial_off", "partial_corr"
# Of meshes; where a shape has several, the last counts: SHREC's lists and points are those of its .obj files.
ENDINGS = ("ply", "off", "obj")


class SetError(Exception):
    """What is missing or wrong in the folder of a set."""


@dataclass(frozen=True, eq=False)
class Marks:
    """Points of a shape that are known on others of its set.

    Attributes
    ----------
    ids : (t,) int64
        Points of the template, ascending.
    points : CagePoints
        In the numbers of the file.
    """

    ids: np.ndarray
    points: CagePoints

    def of(self, ids: Sequence[int] | np.ndarray) -> CagePoints:
        """Some of the points, by their number on the template."""
        places = np.searchsorted(self.ids, ids)
        known = np.minimum(places, len(self.ids) - 1)
        missing = np.asarray(ids)[self.ids[known] != np.asarray(ids)]
        if len(missing):
            raise SetError(f"expected points {list(ids)} on the shape, it lacks {missing.tolist()}")
        return self.points.at(known)

    def renumbered(self, numbers: np.ndarray) -> Marks:
        """The same points where vertices have other numbers, without those that have none (-1)."""
        corners = numbers[self.points.corners]
        kept = np.flatnonzero((corners >= 0).all(axis=1))
        return Marks(self.ids[kept], CagePoints(corners[kept], self.points.weights[kept]))


@dataclass(frozen=True)
class PublicSet:
    """One set.

    Attributes
    ----------
    name : str
    about : str
        What it is, for the table.
    landmarks : dict of int to tuple of int
        Points of the template that are given, by how many.
    published : str
        Best figures that are known, for the table.
    """

    name: str
    about: str
    landmarks: dict[int, tuple[int, ...]]
    published: str

    def shapes(self, root: Path) -> dict[str, Path]:
        """Mesh of every shape that is tested."""
        patterns = {
            "faust": r"(tr_reg_)?0(8|9)\d",
            "faust_r": r"tr_reg_0(8|9)\d",
            "smal_r": r"(cougar|hippo|horse).*",
            "shrec20": r".*",
            "shrec19": r"\d+",
            "tosca": r"\d+_[a-z]+_\d+",
            "pfaust": r"tr_reg_0(8|9)\d",
        }
        found: dict[str, list[Path]] = {}
        for path in sorted(path for ending in ENDINGS for path in root.rglob(f"*.{ending}")):
            if re.fullmatch(patterns[self.name], path.stem, re.IGNORECASE):
                part = PART if self.name == "pfaust" and path.parent.name == PART_FOLDER else ""
                found.setdefault(part + path.stem, []).append(path)
        named = {}
        for shape, paths in found.items():
            ending = max((path.suffix[1:] for path in paths), key=ENDINGS.index)
            named[shape] = _same(root, [path for path in paths if path.suffix[1:] == ending])
        if not named:
            raise SetError(f"{root}: expected shapes of {self.name}, found none. Give the folder as it is unpacked.")
        return named

    def pairs(self, root: Path, count: int | None) -> list[tuple[str, str]]:
        """Target and source: those of the test sets, both ways, or all of the shapes; a sample, always the same."""
        shapes = self.shapes(root)
        lists = sorted(root.rglob(LISTS[self.name])) if self.name in LISTS else []
        listed = [pair for path in lists for pair in _listed(path, shapes)]
        found = list(dict.fromkeys([*listed, *((b, a) for a, b in listed)])) or list(permutations(sorted(shapes), 2))
        if self.name == "pfaust":  # a part receives from a whole body
            parts = [shape for shape in shapes if shape.startswith(PART)]
            found = [(part, whole) for part in parts for whole in shapes if not whole.startswith(PART)]
        if self.name == "shrec19":  # directed maps; 40 is a scan with holes that papers leave out
            sides = [path.stem.split("_")[::-1] for path in _map_files(root).values()]
            found = [(b, a) for b, a in sides if "40" not in (a, b) and a in shapes and b in shapes]
        if count is None or count >= len(found):
            return found
        return sorted(random.Random(2020).sample(found, count), key=found.index)

    def marks(self, root: Path, shape: str, mesh: ControlMesh) -> Marks:
        """Known points of a shape."""
        if self.name == "faust":
            ids = np.arange(FAUST_VERTICES)
            if mesh.n_vertices < FAUST_VERTICES:
                raise SetError(f"{shape}: expected {FAUST_VERTICES} vertices or more, got {mesh.n_vertices}")
            return Marks(ids, CagePoints.of_vertices(ids))
        if self.name == "shrec20":
            return _barycentric(_only(root, shape, "mat"), mesh)
        if self.name == "shrec19":
            return _numbered(np.arange(mesh.n_vertices))
        if shape.startswith(PART):
            name = shape.removeprefix(PART)
            vertices = _vertices(_only(root, f"{PART_POINTS}/{name}", "vts"), mesh.n_vertices)
            kept = np.flatnonzero(np.loadtxt(_only(root, f"masks/{name}", "vts"), dtype=np.int64, ndmin=1))
            if len(kept) != len(vertices):
                raise SetError(
                    f"{root}: expected as many points in {PART_POINTS}/{name}.vts as ones in masks/{name}.vts, got "
                    f"{len(vertices)} and {len(kept)}"
                )
            return Marks(kept, CagePoints.of_vertices(vertices))
        folder = "corres/" if self.name == "pfaust" else ""
        return _numbered(_vertices(_only(root, folder + shape, "vts"), mesh.n_vertices))

    def pair_marks(self, root: Path, target: str, source: str, mesh: ControlMesh) -> Marks | None:
        """Known points of a target where they belong to the pair: vertices of the source are the template."""
        if self.name != "shrec19":
            return None
        return _numbered(_vertices(_map_files(root)[f"{source}_{target}"], mesh.n_vertices))


_FAUST_R_7 = tuple(number - 1 for number in (2026, 3560, 2, 4489, 1971, 3406, 388))
SETS = {
    one.name: one
    for one in (
        PublicSet(
            "faust",
            "FAUST 080-099, vertex i < 6890 the same in all",
            {5: (412, 5891, 6593, 3323, 2119)},
            "-",
        ),
        PublicSet(
            "faust_r",
            "FAUST remeshed, 080-099",
            {7: _FAUST_R_7},
            "learned, no landmarks: 1.4 HybridFMaps, 1.6 ULRSSM; not learned: 2.5 Smooth Shells, 6.1 ZoomOut",
        ),
        PublicSet(
            "smal_r",
            "SMAL remeshed, cougars, hippos, horses",
            {6: (3162, 1931, 3731, 1399, 1111, 1001)},
            "learned, no landmarks: 2.5 - 2.6 (2026), 2.8 - 3.4 HybridFMaps; 38 ZoomOut",
        ),
        PublicSet(
            "shrec19",
            "SHREC'19 humans of any connectivity, directed maps of the set, without scan 40",
            {0: ()},
            "-",
        ),
        PublicSet(
            "tosca",
            "TOSCA non-isometric 5k (Ren et al. 2018), its pairs both ways",
            {0: ()},
            "-",
        ),
        PublicSet(
            "pfaust",
            "PFAUST, parts of FAUST_r 080-099 to whole bodies",
            {7: _FAUST_R_7},
            "-",
        ),
        PublicSet(
            "shrec20",
            "SHREC'20 non-isometric, test sets 0 - 4, both ways",
            {6: (9, 19, 48, 41, 16, 32)},
            "-",
        ),
    )
}


def more_landmarks(public: PublicSet, marks: Marks, other: Marks, positions: np.ndarray, count: int) -> list[int]:
    """Points of the template for so many landmarks: those of the literature, then the farthest from all before.

    Parameters
    ----------
    public : PublicSet
    marks, other : Marks
        Of target and source; only points that both have.
    positions : (t, 3) float64
        Of the target's points.
    count : int
    """
    base = next((ids for size, ids in sorted(public.landmarks.items(), reverse=True) if size <= count), ())
    shared = np.isin(marks.ids, other.ids)
    ids = [int(number) for number in base if number in marks.ids[shared]]
    distance = np.where(shared, np.inf, -1.0)
    for number in ids:
        distance = np.minimum(distance, np.linalg.norm(positions - positions[marks.ids == number], axis=1))
    while len(ids) < min(count, int(shared.sum())):
        farthest = int(np.argmax(distance)) if ids else int(np.flatnonzero(shared)[0])
        ids.append(int(marks.ids[farthest]))
        away = np.linalg.norm(positions - positions[farthest], axis=1)
        distance = np.where(shared, np.minimum(distance, away), -1.0)
    return ids


def _listed(path: Path, shapes: dict[str, Path]) -> list[tuple[str, str]]:
    """Pairs of a list: two names a line, with or without endings, between commas or spaces."""
    found = []
    for line in path.read_text(encoding="utf-8").splitlines():
        names = [Path(word).stem for word in re.split(r"[\s,;]+", line.strip()) if word]
        if len(names) >= 2 and not line.startswith("#"):
            unknown = [name for name in names[:2] if name not in shapes]
            if unknown:
                raise SetError(f"{path}: expected names of shapes, got {', '.join(unknown)}")
            found.append((names[0], names[1]))
    return found


def _numbered(vertices: np.ndarray) -> Marks:
    """Points of a template that are vertices, in its order."""
    return Marks(np.arange(len(vertices)), CagePoints.of_vertices(vertices))


def _vertices(path: Path, count: int) -> np.ndarray:
    """Vertices of a file with a number from 1 in each line, from 0."""
    try:
        vertices = np.loadtxt(path, dtype=np.int64, ndmin=1) - 1
    except ValueError as error:
        raise SetError(f"{path}: expected a vertex number a line, got something else ({error})") from error
    if vertices.ndim != 1 or not len(vertices) or vertices.min() < 0 or vertices.max() >= count:
        raise SetError(f"{path}: expected a vertex from 1 to {count} a line, got others")
    return vertices


def _map_files(root: Path) -> dict[str, Path]:
    """Maps of SHREC'19: file i_j has a vertex of j for every vertex of i."""
    found = {path.stem: path for ending in ("txt", "map") for path in sorted(root.rglob(f"*_*.{ending}"))}
    found = {name: path for name, path in found.items() if re.fullmatch(r"\d+_\d+", name)}
    if not found:
        raise SetError(f"{root}: expected maps such as corres/1_2.map, found none")
    return found


def _only(root: Path, shape: str, ending: str) -> Path:
    files = sorted(root.rglob(f"{shape}.{ending}"))
    if not files:
        raise SetError(f"{root}: expected {shape}.{ending} somewhere in it, found none")
    return _same(root, files)


def _same(root: Path, files: list[Path]) -> Path:
    """The first of some files of one name, which must be copies: sets come in several sizes."""
    if len(files) > 1 and len({path.read_bytes() for path in files}) > 1:
        folders = ", ".join(str(path.parent.relative_to(root)) for path in files)
        raise SetError(f"{root}: expected one {files[0].name}, got several in {folders}. Give a folder that has one.")
    return files[0]


def _barycentric(path: Path, mesh: ControlMesh) -> Marks:
    """SHREC's points: numbers, and a face (from 1) with three weights each; or a vertex where there is no face."""
    try:
        data = loadmat(path)
        ids, vertices = (np.asarray(data[name], dtype=np.int64).ravel() for name in ("points", "verts"))
    except (ValueError, KeyError, NotImplementedError) as error:  # the last is SciPy's word for MATLAB 7.3
        raise SetError(f"{path}: expected the tables `points` and `verts` (MATLAB 5 to 7), got {error!r}") from error
    triangles = mesh.face_indices.reshape(-1, 3)
    if len(ids) != len(vertices) or not len(ids) or vertices.min() < 1 or vertices.max() > mesh.n_vertices:
        raise SetError(f"{path}: expected points and as many vertices from 1 to {mesh.n_vertices}, got others")
    order = np.argsort(ids)
    corners = np.repeat(vertices[:, None] - 1, 3, axis=1)
    weights = np.tile([1.0, 0.0, 0.0], (len(ids), 1))
    if "baryc" in data:
        faces = np.asarray(data["baryc"], dtype=np.float64).reshape(len(ids), 4)
        known = np.isfinite(faces).all(axis=1) & (faces[:, 0] >= 1)
        if (faces[known, 0] > len(triangles)).any():
            raise SetError(f"{path}: expected faces from 1 to {len(triangles)}, got {faces[known, 0].max():.0f}")
        corners[known] = triangles[faces[known, 0].astype(np.int64) - 1]
        inside = np.clip(faces[known, 1:], 0.0, None)
        weights[known] = inside / inside.sum(axis=1, keepdims=True)
    return Marks(ids[order], CagePoints(corners[order], weights[order]))
