"""Check whether a control mesh can be matched; name the elements at fault and the remedy.

`check_mesh` reports everything it finds, `require_valid` raises. Tolerances are relative to the extent of the mesh or
of a face, so that the file's unit does not matter. Vertices at the same place and vertices of valence 2 are valid.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cagemap.errors import InvalidMeshError
from cagemap.mesh.control_mesh import ControlMesh
from cagemap.mesh.faces import (
    TINY_EDGE,
    degenerate_faces,
    duplicate_faces,
    face_areas,
    face_centres,
    face_extents,
    is_slit,
    keep_faces,
    signed_volume,
    with_openings_closed,
)
from cagemap.mesh.inputs import MeshLike, arrays_accepted
from cagemap.mesh.mesh_report import (
    LISTED,
    REPAIRED,
    MeshProblem,
    MeshReport,
    count_noun,
    first_few,
    list_problems,
    place_text,
    problem_at,
)
from cagemap.mesh.schemes import Plain
from cagemap.mesh.structure_checks import structure_problems
from cagemap.mesh.topology import (
    Topology,
    boundary_loops,
    corner_fans,
    face_components,
    mesh_topology,
    turned_faces,
    used_vertices,
    uv_islands,
)
from cagemap.mesh.weld import coincident_vertices, count_pieces, weld_tolerance
from cagemap.numerics.arrays import FloatArray, IndexArray

SEVERAL = "several components"
ONE_SIDED = MeshProblem(
    "one-sided surface",
    "expected a surface with an inside and an outside, got one where no choice of face directions agrees along all "
    "edges (as on a Moebius strip)",
    "Cut the surface where its two sides are joined.",
)
# Problems that do not prevent subdivision, which needs only oriented manifold connectivity.
UNREFINED = frozenset({SEVERAL, "no size", "size", "no area", "faces without area", "no volume", "inside out"})

MAX_SLIT_EDGES = 8  # most edges of a boundary loop that is reported as a slit; a longer one is an opening
MAX_COMPARED = 16  # number of components that are compared with each other: comparing more costs too much
SMALLEST_EXTENT, LARGEST_EXTENT = 1e-60, 1e60  # their squares and products neither overflow nor vanish in float64
RELATIVE_WIDTH = 1e-9  # least distance of vertices from a line, of the extent; real cages are above 1e-2
RELATIVE_FACE_AREA = 1e-15  # least face area, of the extent squared: edges of 3e-8, the resolution of float32
RELATIVE_FACE_WIDTH = 1e-9  # least face area, of its own extent squared: below it cotangents reach 1e9
OPEN_ROUNDNESS = 0.02  # 36 pi V^2 / A^3, 1 for a ball; below this an open surface has no inside


@arrays_accepted
@np.errstate(over="ignore", invalid="ignore")  # positions may be of any size
def check_mesh(mesh: MeshLike) -> MeshReport:
    """Count the elements of a control mesh and list everything that prevents matching.

    Consequences of a listed problem are not listed: duplicate faces are not reported as non-manifold edges too, and
    connectivity is checked only if no face repeats a vertex.
    """
    blank = MeshReport(mesh.name, len(mesh.positions), None, max(len(mesh.face_offsets) - 1, 0))
    broken = structure_problems(mesh)
    if broken:
        return replace(blank, problems=tuple(_with_places(problem, mesh) for problem in broken))
    degenerate, duplicates = degenerate_faces(mesh), duplicate_faces(mesh)
    kept = np.delete(np.arange(mesh.n_faces), duplicates)
    vertices, faces = mesh.file_numbers
    numbered = replace(mesh, file_vertices=vertices, file_faces=faces)
    single = keep_faces(numbered, kept) if len(duplicates) else numbered
    topology = mesh_topology(single)
    fans, turned = corner_fans(topology), turned_faces(topology)
    loops = boundary_loops(topology, fans)
    unused = np.flatnonzero(~used_vertices(mesh))
    # Vertices of several fans. Edges of more than two faces, reported elsewhere, join fans here.
    touching = np.flatnonzero(np.bincount(single.face_indices[np.unique(fans, return_index=True)[1]]) > 1)
    problems = [
        problem_at(
            "degenerate faces",
            f"expected at least three different vertices around every face, got {len(degenerate)} face(s) with fewer "
            "or with one repeated, faces",
            degenerate,
            "Dissolve the zero-length edges or delete these faces; connectivity is checked after that.",
        ),
        problem_at(
            "duplicate faces",
            f"expected every face once, got {len(duplicates)} face(s) with the same vertices as an earlier one, faces",
            duplicates,
            "Delete these copies.",
        ),
        problem_at(
            "isolated vertices",
            f"expected every vertex to belong to a face, got {len(unused)} without, vertices",
            unused,
            "Delete the loose vertices (this renumbers the others: landmarks must be made for the new file).",
            of_vertices=True,
        ),
    ]
    if not len(degenerate):
        problems += [
            _edge_manifold_problem(single, topology),
            problem_at(
                "non-manifold vertices",
                f"expected the faces around every vertex to form one fan, got {len(touching)} vertex/vertices where "
                "parts of the surface touch in a point only, vertices",
                touching,
                "Split these vertices (one copy per fan), or add the missing faces between the fans.",
                of_vertices=True,
            ),
            _orientation_problem(turned, kept),
        ]
    problems += [_components_problem(mesh, face_components(mesh)), extent_problem(mesh)]
    if problems[-1] is None and not isinstance(mesh.scheme, Plain):  # slivers of a scan do no harm
        problems.append(zero_area_problem(mesh, np.delete(np.arange(mesh.n_faces), degenerate)))
    if loops is not None and not any(problems):
        problems.append(inside_out_problem(mesh, loops))
    report = blank if len(degenerate) else _counts(single, topology, loops, turned is not None, blank)
    sizes, counts = np.unique(mesh.face_sizes, return_counts=True)
    sharp = mesh.crease_edges, mesh.corner_vertices, mesh.hole_faces
    creases, corners, holes = (0 if elements is None else len(elements) for elements in sharp)
    return replace(
        report,
        face_sizes=tuple(zip(sizes.tolist(), counts.tolist(), strict=True)),
        sharp=(creases, corners, holes),
        problems=tuple(_with_places(problem, mesh) for problem in problems if problem is not None),
    )


def _with_places(problem: MeshProblem, mesh: ControlMesh) -> MeshProblem:
    """The problem in the file's numbers, with the coordinates of the elements that its message lists."""
    listed = np.array(problem.elements[:LISTED], dtype=np.int64)
    if not len(listed) or problem.kind == "broken data":  # whose elements may be UVs
        return problem
    if listed.ndim == 2:
        places = mesh.positions[listed].mean(axis=1)
    else:
        places = (mesh.positions if problem.of_vertices else face_centres(mesh))[listed]
    numbers = mesh.file_numbers[int(listed.ndim == 1 and not problem.of_vertices)][np.array(problem.elements)]
    elements = [tuple(row) for row in numbers.tolist()] if listed.ndim == 2 else numbers.tolist()
    return replace(problem, elements=tuple(elements), places=tuple(map(place_text, places)))


def require_valid(mesh: ControlMesh, *, allowed: Collection[str] = (), plain: bool = True) -> None:
    """Raise InvalidMeshError for problems that are not ``allowed``; with ``plain`` it may offer `plain_mesh`."""
    problems = [problem for problem in check_mesh(mesh).problems if problem.kind not in allowed]
    if problems:
        count = count_noun(len(problems), "problem")
        one_piece = "" if SEVERAL in allowed else " of one piece"
        offers_plain = plain and is_repaired_as_plain(mesh, problems)
        remedy = "Or use `plain_mesh`, which repairs the mesh and takes it without subdivision." if offers_plain else ""
        raise InvalidMeshError(
            f"{mesh.name}: expected a manifold, consistently oriented mesh{one_piece}, got {count}:"
            f"{list_problems(problems)}\n{remedy}".rstrip()
        )


def is_repaired_as_plain(mesh: ControlMesh, problems: Sequence[MeshProblem]) -> bool:
    """Whether `plain_mesh` repairs one of the problems of a mesh that has another scheme."""
    return not isinstance(mesh.scheme, Plain) and any(
        one.kind in REPAIRED or (one.kind == SEVERAL and bool(np.all(mesh.face_sizes == 3))) for one in problems
    )


def _counts(
    mesh: ControlMesh, topology: Topology, loops: tuple[IndexArray, ...] | None, two_sided: bool, blank: MeshReport
) -> MeshReport:
    components = np.bincount(face_components(mesh))
    used = used_vertices(mesh)
    valences = np.bincount(topology.edge_vertices.ravel(), minlength=mesh.n_vertices)[used]
    numbers = mesh.file_numbers[0]
    euler = int(used.sum()) - topology.n_edges + mesh.n_faces
    islands = uv_islands(mesh)
    ends = mesh.positions[topology.edge_vertices]
    usual = float(np.median(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)))
    slits = [
        f"of {len(loop)} edges at vertices {first_few(numbers[loop].tolist())}, the first at "
        f"{place_text(mesh.positions[loop[0]])}"
        for loop in loops or ()
        if len(loop) <= MAX_SLIT_EDGES and is_slit(mesh.positions[loop], usual)
    ]
    # V - E + F = 2 - 2 g - b for every component. Where one vertex joins two fans there is no genus.
    handles, odd = divmod(2 * len(components) - euler - len(loops or ()), 2)
    is_surface = loops is not None and two_sided and not odd and handles >= 0
    return replace(
        blank,
        n_edges=topology.n_edges,
        euler_characteristic=euler,
        genus=handles if is_surface else None,
        boundary_edges=len(topology.boundary_corners),
        boundary_loops=None if loops is None else tuple(tuple(numbers[loop].tolist()) for loop in loops),
        notes=(
            f"the boundary has {'a slit' if len(slits) == 1 else f'{len(slits)} slits'} {first_few(slits)}. "
            "If not meant, merge their vertices by distance or fill them.",
        )[: len(slits)],
        component_sizes=tuple(components.tolist()),
        valence_range=(int(valences.min()), int(valences.max())),
        uv_islands=None if islands is None else int(islands.max()) + 1,
    )


def _edge_manifold_problem(mesh: ControlMesh, topology: Topology) -> MeshProblem | None:
    """Edges of more than two faces, and their remedies."""
    bad = topology.face_counts > 2
    if not bad.any():
        return None
    edges, extra, (vertices, faces) = topology.edge_vertices, extra_faces(topology), mesh.file_numbers
    remaining = bad & (topology.face_counts - _counts_of(topology, extra) > 2)
    tiny = remaining & _tiny_edges(mesh, topology)
    split = remaining & ~tiny
    tiny_edges, split_edges = (first_few(map(tuple, vertices[edges[chosen]].tolist())) for chosen in (tiny, split))
    split_faces = np.unique(mesh.corner_faces[split[topology.edges]])
    remedies = {
        f"Delete face(s) {first_few(faces[extra].tolist())}, which hang on such edges alone.": extra,
        f"Merge the two vertices of edge(s) {tiny_edges}, which are almost at the same place; splitting there would "
        "leave a slit.": tiny,
        f"At edge(s) {split_edges} delete the inner ones of faces {first_few(faces[split_faces].tolist())}, or split "
        "the edge so that each sheet has its own.": split,
    }
    return problem_at(
        "non-manifold edges",
        f"expected one or two faces at every edge, got {int(bad.sum())} edge(s) with up to "
        f"{topology.face_counts.max()}, between vertices",
        edges[bad],
        " ".join(remedy for remedy, concerned in remedies.items() if concerned.any()),
    )


def extra_faces(topology: Topology) -> NDArray[np.bool_]:
    """(m,) faces inside a surface, or fins, with edges on the boundary or of more than two faces only."""
    counts = topology.face_counts[topology.edges]
    starts = np.flatnonzero(np.diff(topology.faces, prepend=-1))
    extra = np.logical_or.reduceat(counts > 2, starts) & ~np.logical_or.reduceat(counts == 2, starts)
    # Where deleting all such faces would open an edge, it is uncertain which one is extra: keep them all.
    opened = (topology.face_counts > 2) & (topology.face_counts - _counts_of(topology, extra) < 2)
    return extra & ~np.logical_or.reduceat(opened[topology.edges], starts)


def _counts_of(topology: Topology, faces: NDArray[np.bool_]) -> IndexArray:
    """(e,) number of the given faces (m,) at every edge."""
    corners = faces[topology.faces]
    return np.bincount(topology.edges[corners], minlength=topology.n_edges).astype(np.int64)


def _tiny_edges(mesh: ControlMesh, topology: Topology) -> NDArray[np.bool_]:
    """(e,) edges much shorter than the longest edges of their faces."""
    ends = mesh.positions[topology.edge_vertices]
    lengths: FloatArray = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    longest = np.maximum.reduceat(lengths[topology.edges], mesh.face_offsets[:-1])
    around = np.zeros(len(lengths))
    np.maximum.at(around, topology.edges, longest[mesh.corner_faces])
    return lengths <= TINY_EDGE * around


def _orientation_problem(turned: NDArray[np.bool_] | None, numbers: IndexArray) -> MeshProblem | None:
    if turned is None:
        return ONE_SIDED
    flipped = numbers[turned]
    return problem_at(
        "inconsistent orientation",
        f"expected neighbouring faces to run in the same sense, got {len(flipped)} of {len(numbers)} faces turned "
        "against the others, faces",
        flipped,
        "Flip these faces (recalculate normals to the outside in the modelling program).",
    )


def _components_problem(mesh: ControlMesh, labels: IndexArray) -> MeshProblem | None:
    sizes = np.bincount(labels)
    if len(sizes) == 1:
        return None
    first_faces = np.unique(labels, return_index=True)[1]
    compared = range(min(len(sizes), MAX_COMPARED))
    points = (mesh.positions[np.unique(mesh.face_indices[(labels == i)[mesh.corner_faces]])] for i in compared)
    copied = len({cloud[np.lexsort(cloud.T)].tobytes() for cloud in points}) < len(compared)
    tolerance = None if copied else weld_tolerance(mesh)
    seams = ""
    if tolerance is not None:
        left = count_pieces(mesh, coincident_vertices(mesh, tolerance))
        seams = (
            "Its vertices are split at seams, as glTF and FBX exporters write them: "
            f"`weld_mesh(mesh, {tolerance:g})` leaves {count_noun(left, 'piece')}. "
            f"{'Or' if left == 1 else 'Then'} match"
        )
    return MeshProblem(
        SEVERAL,
        f"expected one connected piece, got {len(sizes)} of {first_few(sizes.tolist())} faces, which begin at faces",
        f"{seams or 'Match'} a part (`find_part` NAME, largest, or each; the check lists them), or delete the pieces "
        f"not wanted.{' One is a copy of another in the same place.' if copied else ''}",
        tuple(first_faces.tolist()),
    )


def extent_problem(mesh: ControlMesh) -> MeshProblem | None:
    """Vertices all at one point or on one line, or a size that overflows."""
    used = used_vertices(mesh)
    with np.errstate(over="ignore"):
        extent = float(np.max(np.ptp(mesh.positions[used], axis=0)))
    if extent == 0.0:
        return MeshProblem(
            "no size",
            "expected vertices in different places, got all in one point",
            "Export the mesh again; the transform may have a scale of zero.",
        )
    if not SMALLEST_EXTENT <= extent <= LARGEST_EXTENT:
        return MeshProblem(
            "size",
            f"expected an extent between {SMALLEST_EXTENT:g} and {LARGEST_EXTENT:g} file units, got {extent:.3g}",
            "Scale the mesh.",
        )
    unit = _unit_sized(mesh).positions[used]
    offsets = unit - unit[0]
    lengths = np.linalg.norm(offsets, axis=1)
    farthest = offsets[np.argmax(lengths)]
    widths = np.linalg.norm(np.cross(offsets, farthest), axis=1) / lengths.max() ** 2
    if widths.max() <= RELATIVE_WIDTH:
        return MeshProblem(
            "no area",
            "expected a surface, got all vertices on one line",
            "Export the mesh again; the transform may have scales of zero.",
        )
    return None


def zero_area_problem(mesh: ControlMesh, examined: IndexArray) -> MeshProblem | None:
    """Examined faces (k,) whose corners are on one line or in one point; None without such faces."""
    unit = _unit_sized(mesh)
    areas, extents = face_areas(unit), face_extents(unit)
    flat = (areas <= RELATIVE_FACE_AREA) | (areas <= RELATIVE_FACE_WIDTH * extents**2)
    faces = examined[flat[examined]]
    return problem_at(
        "faces without area",
        f"expected every face to span an area, got {len(faces)} whose corners are on one line or in one point, faces",
        faces,
        "Move their vertices apart, or dissolve the edges of length zero.",
    )


def inside_out_problem(mesh: ControlMesh, loops: Sequence[IndexArray]) -> MeshProblem | None:
    """Problem of a mesh whose faces look inwards, or of a closed one without volume.

    Openings are closed with cones; a sheet, less round than `OPEN_ROUNDNESS` then, has no inside.
    """
    unit = with_openings_closed(_unit_sized(mesh), loops)
    volume, area = signed_volume(unit), float(face_areas(unit).sum())
    roundness = 36.0 * np.pi * volume * abs(volume) / area**3
    if not loops and abs(roundness) < RELATIVE_WIDTH:
        return MeshProblem(
            "no volume",
            "expected a closed mesh to enclose a volume, got one that is folded flat",
            "Export the mesh again; the transform may have a scale of zero. Delete one side of a flat sheet.",
        )
    if roundness < (-OPEN_ROUNDNESS if loops else 0.0):
        opened = ", judged with its openings closed," if loops else ""
        return MeshProblem(
            "inside out",
            f"expected faces counter-clockwise seen from outside, got a mesh{opened} whose faces all look inwards",
            "Flip all faces (recalculate normals to the outside).",
        )
    return None


def _unit_sized(mesh: ControlMesh) -> ControlMesh:
    """Centre the bounding box of the faces at the origin and scale its longest side to 1."""
    points = mesh.positions[used_vertices(mesh)]
    low, high = points.min(axis=0), points.max(axis=0)
    with np.errstate(over="ignore"):  # a vertex without faces may be anywhere
        return mesh.with_positions((mesh.positions - 0.5 * (low + high)) / np.max(high - low))
