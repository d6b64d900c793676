"""`--target-mask`, `--source-mask`: weights of both models; `--base`: the target's own values outside the masks."""

from __future__ import annotations

import logging
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from cagemap.errors import ParameterError
from cagemap.files import IMAGE_SUFFIXES, INVERT_PREFIX, MASK_SUFFIXES
from cagemap.files.meshes.formats import read_whole
from cagemap.files.result.manifest import input_file
from cagemap.files.usd.prims import JOINT_WEIGHTS
from cagemap.files.usd.read import read_usd_meshes
from cagemap.files.usd.stages import is_usd
from cagemap.files.values.attributes import read_attributes
from cagemap.files.values.rigs import scene_skeleton
from cagemap.maps.masks import Masks, face_mask, soft_edge, vertex_mask
from cagemap.maps.result import MatchResult
from cagemap.mesh import ControlMesh
from cagemap.mesh.faces import place_of_rows
from cagemap.mesh.parts import find_part
from cagemap.numerics.arrays import FloatArray
from cagemap.spectral import Surface
from cagemap.subdivision import Refinement
from cagemap.surface.triangle_surface import TriangleSurface

if TYPE_CHECKING:  # a match without masks starts without images and their library
    from cagemap.files.images.image import Pixels
from cagemap.files.values.part_numbering import Attributes, FileRows, to_file
from cagemap.tasks.requests.import_map import MapRequest
from cagemap.tasks.requests.match import MatchRequest
from cagemap.tasks.requests.options import refuse_unread
from cagemap.tasks.requests.transfer import TransferRequest, base_of
from cagemap.tasks.requests.wrap import WrapRequest

_log = logging.getLogger(__name__)
# Warning about values whose rows fit control vertices and control faces.
ASSUMED_AT_VERTICES = "as many rows as control vertices and as control faces: assumed to be at vertices"
# Default width of the soft edge of a set of faces, in units of sqrt(area).
DEFAULT_EDGE = 0.02


@dataclass(frozen=True, eq=False)
class GivenMask:
    """A mask of a file's whole mesh: values, faces or an image."""

    vertices: FloatArray | None = None  # (n_0,) values at the file's control vertices
    faces: FloatArray | None = None  # (m_0,) values at the file's control faces
    image: Pixels | dict[int, Pixels] | None = None  # over the UVs; several images by UDIM number
    inverted: bool = False  # whether values v become 1 - v
    edge: float = 0.0  # width of its soft edge, see `cagemap.maps.masks.soft_edge`

    def on(self, refinement: Refinement, surface: TriangleSurface) -> FloatArray:
        """(n,) mask of the finest vertices of the file's mesh or a part of it."""
        control = refinement.control
        if self.vertices is not None:
            rows = slice(None) if control.file_vertices is None else control.file_vertices
            mask = vertex_mask(refinement, self._turned(self.vertices)[rows])
        elif self.faces is not None:
            rows = slice(None) if control.file_faces is None else control.file_faces
            mask = face_mask(refinement, self._turned(self.faces)[rows])
        else:
            from cagemap.transfer.masks import painted_mask

            assert self.image is not None
            mask = self._turned(painted_mask(refinement.finest, self.image))
        return soft_edge(surface, mask, self.edge)

    def _turned(self, values: FloatArray) -> FloatArray:
        return 1.0 - values if self.inverted else values


GivenMasks = tuple[GivenMask | None, GivenMask | None]


# Requests with masks of both models.
Masked = MatchRequest | MapRequest | TransferRequest | WrapRequest


def mask_file(text: str | None) -> Path | None:
    """The file of a mask; None if the text is a part's name."""
    if text is None:
        return None
    path = Path(text.removeprefix(INVERT_PREFIX))
    return path if path.suffix.lower() in MASK_SUFFIXES else None


def mask_inputs(request: Masked) -> dict[str, Path]:
    """Files of both masks, with an image's tiles, by their names in a manifest."""
    files: dict[str, Path] = {}
    for side, text in (("target", request.target_mask), ("source", request.source_mask)):
        path = mask_file(text)
        if path is not None:
            from cagemap.files.images.image import texture_files

            files |= {f"{side}_mask_{i}": file for i, file in enumerate(texture_files(path))}
    return files


def read_masks(request: Masked, controls: tuple[ControlMesh, ControlMesh], files: tuple[Path, Path]) -> GivenMasks:
    """Read the masks of the target's and the source's whole files."""
    texts = {"target_mask": request.target_mask, "source_mask": request.source_mask}
    target, source = (
        None if text is None else read_mask(text, request.mask_edge, control, file, f"--{name.replace('_', '-')}")
        for (name, text), control, file in zip(texts.items(), controls, files, strict=True)
    )
    refuse_unread(request, {"mask_edge": texts}, [name for name, text in texts.items() if text is not None])
    return target, source


def masks_on(given: GivenMasks, surfaces: tuple[Surface, Surface]) -> Masks:
    """Masks of two prepared surfaces, which may be parts of their files."""
    target, source = (
        None if mask is None else mask.on(surface.refinement, surface.finest_triangles)
        for mask, surface in zip(given, surfaces, strict=True)
    )
    return Masks(target, source)


def with_masks(result: MatchResult, request: Masked, folder: Path) -> MatchResult:
    """A result whose masks are multiplied by the request's masks.

    Masks use names and numbers of the matched files, whose paths are relative to ``folder``, the RESULT.
    """
    texts = {"target": request.target_mask, "source": request.source_mask}
    if (*texts.values(), request.mask_edge) == (None, None, None):
        return result
    matched_files = [_matched_file(result, side, folder, given=text is not None) for side, text in texts.items()]
    file_masks = read_masks(
        request, (matched_files[0][0], matched_files[1][0]), (matched_files[0][1], matched_files[1][1])
    )
    more = masks_on(file_masks, (result.target, result.source))
    pairs = zip((result.masks.target, result.masks.source), (more.target, more.source), strict=True)
    masks = Masks(
        *(first if second is None else second if first is None else first * second for first, second in pairs)
    )
    masks.require_fit(len(result.target.vertices), len(result.source.vertices))
    return replace(result, masks=masks)


def _matched_file(result: MatchResult, side: str, folder: Path, *, given: bool) -> tuple[ControlMesh, Path]:
    """The whole mesh of a side's file and its path; without a mask, the matched mesh."""
    control = (result.target if side == "target" else result.source).control
    file = input_file(folder, result.manifest, side) if given else None
    if control.file_vertices is None or not given:
        return control, file or Path(control.name)
    if file is None:
        raise ParameterError(
            f"--{side}-mask: {control.name} was matched in part, and its file is not where the match read it, or has "
            "changed. Put it back."
        )
    return read_whole(file), file


def read_mask(text: str, edge: float | None, control: ControlMesh, mesh_file: Path, option: str) -> GivenMask:
    """Read the mask of a file's mesh from a mask option.

    ``text``: a file of values at control vertices or faces (.npy, .npz, .csv), an image over the UVs, a USD file's
        primvar, or names of objects, groups, materials or components; ``not:`` before it inverts the mask.
    ``edge``: width of the soft edge; default: `DEFAULT_EDGE` for sets of faces, 0 for values.
    """
    inverted = text.startswith(INVERT_PREFIX)
    name = text.removeprefix(INVERT_PREFIX)
    path = mask_file(text)
    if path is not None and path.suffix.lower() in IMAGE_SUFFIXES:
        if control.uvs is None:
            raise ParameterError(f"{option}: {control.name} has no texture coordinates that {path} could be painted on")
        from cagemap.files.images.image import texture_pixels
        from cagemap.tasks.tiled_texture import read_texture_of

        return GivenMask(image=texture_pixels(read_texture_of(control, path)), inverted=inverted, edge=edge or 0.0)
    if path is not None:
        values = read_attributes(path)
        if len(values) != 1:
            raise ParameterError(f"{option}: {path}: expected one array of values, got {', '.join(values)}")
        return _of_values(next(iter(values.values())), f"{option}: {path}", control, inverted, edge)
    primvar = _primvar(mesh_file, name)
    if primvar is not None:
        return _of_values(primvar, f"{option}: primvar {name}", control, inverted, edge)
    faces = np.zeros(control.n_faces)
    for part in name.split(","):
        faces[find_part(control, part).faces] = 1.0
    return GivenMask(faces=faces, inverted=inverted, edge=DEFAULT_EDGE if edge is None else edge)


def _of_values(array: FloatArray, where: str, control: ControlMesh, inverted: bool, edge: float | None) -> GivenMask:
    values = np.asarray(array, dtype=np.float64)
    rows = {control.n_faces: "faces", control.n_vertices: "vertices"}
    kind = rows.get(len(values)) if values.ndim == 1 else None
    if kind is None or not np.all((values >= 0) & (values <= 1)):
        raise ParameterError(
            f"{where}: expected {control.n_vertices} numbers from 0 to 1, one a control vertex, or {control.n_faces}, "
            f"one a control face, got shape {values.shape} from {values.min():g} to {values.max():g}"
        )
    if control.n_vertices == control.n_faces:
        _log.warning("%s: %s", where, ASSUMED_AT_VERTICES)
    if kind == "vertices":
        return GivenMask(vertices=values, inverted=inverted, edge=edge or 0.0)
    return GivenMask(faces=values, inverted=inverted, edge=DEFAULT_EDGE if edge is None else edge)


def _primvar(mesh_file: Path, name: str) -> FloatArray | None:
    """A primvar of a USD file's only mesh; None without it."""
    if not is_usd(mesh_file):
        return None
    meshes = read_usd_meshes(mesh_file)
    values = meshes[0].attributes.get(name) if len(meshes) == 1 else None
    return None if values is None else np.asarray(values, dtype=np.float64)


def keep_base(
    request: TransferRequest,
    result: MatchResult,
    carried: Attributes,
    rows: FileRows | None,
    places: Mapping[str, str] = MappingProxyType({}),
) -> tuple[Attributes, list[str]]:
    """Carried values blended over the target's own values outside the masks; and notes.

    ``places``: of values by name, see `to_file`.
    """
    if not result.masks.any:
        return carried, []
    base = base_of(request)
    if base is None:
        return carried, [
            "outside the masks values are carried as well; --base with the target's own values keeps those"
        ]
    own = own_values(base, result.target.control, rows, carried, of_weights=request.weights is not None)
    weight = result.masks.joint(result.point_map)
    kept: Attributes = {}
    for name, values in carried.items():
        below = own[name]
        if below.shape != values.shape:
            raise ParameterError(
                f"--base {base}: expected {name} of shape {values.shape}, as what is carried, got shape {below.shape}. "
                "Give the target's own values."
            )
        share = _weight_at(result, weight, len(values), places.get(name)).reshape(-1, *([1] * (values.ndim - 1)))
        if values.dtype.kind == "i":  # labels are not mixed
            kept[name] = np.where(share >= 0.5, values, below)
        else:
            kept[name] = below + share * (values - below)
    return kept, []


def to_file_values(
    request: TransferRequest,
    carried: Attributes,
    rows: FileRows | None,
    places: Mapping[str, str] = MappingProxyType({}),
) -> Attributes:
    """Values of a part in the file's numbering, with ``--base``'s values or 0 elsewhere."""
    base = None if rows is None else base_of(request)
    if base is None or rows is None:
        return to_file(carried, rows, places=places)
    below = own_values(base, rows.whole, None, carried, of_weights=request.weights is not None)
    return to_file(carried, rows, below, places)


def own_values(
    base: Path, control: ControlMesh, rows: FileRows | None, names: Collection[str], *, of_weights: bool
) -> Attributes:
    """The target's own values by the names of what is carried.

    Weights of a scene have the names of its joints. The only table of another file has the order of ``names``.

    ``of_weights``: whether joint weights are carried; other values are not taken from those of the base.
    """
    given = read_attributes(base, control, rows)
    if all(name in given for name in names):
        return given
    if not of_weights and JOINT_WEIGHTS in given:
        _require_names(base, "values of", [*given], names)
    joints = _joint_names(base, control if rows is None else rows.whole) if JOINT_WEIGHTS in given else ()
    if joints:
        weights = dict(zip(joints, given[JOINT_WEIGHTS].T, strict=True))
        _require_names(base, "weights of the joints", [*weights], names)
        others = [joint for joint, column in weights.items() if joint not in names and column.any()]
        if others:
            raise ParameterError(
                f"--base {base}: expected weights of {', '.join(names)} alone, got some of {', '.join(others)}. Give "
                "weights of the same joints."
            )
        return weights
    if len(given) == len(names) == 1:
        return dict(zip(names, given.values(), strict=True))
    table = given.get(JOINT_WEIGHTS) if len(given) > 1 else next(iter(given.values()), None)
    if table is not None and table.ndim == 2 and table.shape[1] == len(names):
        return dict(zip(names, table.T, strict=True))
    _require_names(base, "values of", [*given], names)
    return given


def _joint_names(base: Path, control: ControlMesh) -> tuple[str, ...]:
    """Names of the columns of a scene's joint weights; none for other files, or if joints have equal names."""
    skeleton = scene_skeleton(base, control)
    names = () if skeleton is None else skeleton.names
    return names if len(set(names)) == len(names) else ()


def _require_names(base: Path, what: str, given: Collection[str], names: Collection[str]) -> None:
    missing = [name for name in names if name not in given]
    if missing:
        raise ParameterError(
            f"--base {base}: expected {what} {', '.join(missing)}, as what is carried, got {', '.join(given)}. Give "
            "the target's own values."
        )


def _weight_at(result: MatchResult, weight: FloatArray, count: int, place: str | None) -> FloatArray:
    """(count,) weights at control vertices, control faces, face corners or refined vertices."""
    control = result.target.control
    place = place_of_rows(control, count) if place is None else place
    at_vertices = weight[: control.n_vertices]
    if place == "vertices":
        return at_vertices
    at_corners = at_vertices[control.face_indices]
    if place == "faces":
        return np.add.reduceat(at_corners, control.face_offsets[:-1]) / control.face_sizes
    return at_corners if place == "corners" else weight
