"""Models as the studio opens them: read, checked, refined, upright, with what they look like."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cagemap.errors import CagemapError, InvalidMeshError, ParameterError
from cagemap.files.images.image import Pixels, read_image, tile_files, write_image
from cagemap.files.meshes.formats import read_whole
from cagemap.files.usd.space import upright_turn
from cagemap.mesh import ControlMesh
from cagemap.mesh.checks import require_valid
from cagemap.mesh.mesh_report import first_few
from cagemap.mesh.mirrors import mirror_symmetries
from cagemap.mesh.parts import connected_parts
from cagemap.mesh.plain import plain_mesh
from cagemap.mesh.schemes import Plain
from cagemap.mesh.structure_checks import structure_problems
from cagemap.mesh.udim import udim_origin
from cagemap.mesh.weld import Welded, unwelded, weld_mesh, weld_tolerance
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.pictures import UP_AXES, Y_UP
from cagemap.pipeline import choose_level
from cagemap.studio.file_parts import NOTHING, Offer, Taken, rest_of, take_part
from cagemap.studio.shape import Original, Shape, shape_of
from cagemap.studio.skins import Look
from cagemap.subdivision import refine, with_options
from cagemap.transfer import face_colors

# Largest side of the texture in the page; the bake uses the whole image.
TEXTURE_SIZE = 1024
# A triangle mesh of so many faces is rather a scan than a cage.
DENSE = 20_000
NO_SCHEME = "none"


@dataclass(frozen=True, eq=False)
class OpenedModel:
    """One control mesh, opened.

    Attributes
    ----------
    level : int
        Of the preview.
    shape : Shape
    look : Look
        The source's includes the texture.
    mirror : (n_control,) int64 or None
        The control vertex across the mirror plane.
    notes : tuple of str
        What was done to a mesh to take it as it is.
    offer : Offer
        Parts of its file.
    scheme : str or None
        How it is subdivided, as asked for or, where it is no cage, as it is.
    dense : bool
        Whether it is subdivided although it looks like a scan.
    weld : str or None
        Tolerance that it was welded with, as `cagemap match --weld` takes it.
    texture : Path or None
        Image of the look.
    """

    level: int
    shape: Shape
    look: Look
    mirror: IndexArray | None
    notes: tuple[str, ...] = ()
    offer: Offer = NOTHING
    scheme: str | None = None
    dense: bool = False
    weld: str | None = None
    texture: Path | None = None

    @property
    def control(self) -> ControlMesh:
        """The control mesh."""
        return self.shape.control


def with_texture(look: Look, path: Path) -> Look:
    """A look with an image in 8 bits, no larger than the page needs; tiles lie beside each other in one."""
    files = tile_files(path)
    places = {number: [int(cell) for cell in udim_origin(number)] for number in files}  # column, row from below
    columns, rows = (1 + max(place[k] for place in places.values()) for k in range(2))
    # One after the other: many large ones would not fit into memory together.
    shown = {number: _shrunk(read_image(file).pixels, rows, columns) for number, file in files.items()}
    height, width = (max(tile.shape[k] for tile in shown.values()) for k in range(2))
    pixels = np.zeros((rows * height, columns * width, 3), dtype=np.uint8)
    for number, (column, row) in places.items():
        top, left = (rows - 1 - row) * height, column * width
        pixels[top : top + height, left : left + width] = _nearest(shown[number], height, width)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "texture.jpg"
        write_image(file, pixels)
        return replace(look, texture=pixels, encoded=file.read_bytes(), tiles=(columns, rows))


def _shrunk(pixels: Pixels, rows: int, columns: int) -> Pixels:
    """(h, w, 3) in 8 bits: as large as an image may be of which rows x columns make one for the page."""
    height, width = pixels.shape[:2]
    step = max(1, -(-max(rows * height, columns * width) // TEXTURE_SIZE))
    small = _nearest(pixels, -(-height // step), -(-width // step))
    if small.dtype != np.uint8:
        top = np.iinfo(small.dtype).max if small.dtype.kind == "u" else 1.0
        small = np.rint(255 * np.clip(small.astype(np.float64) / top, 0, 1)).astype(np.uint8)
    return np.repeat(small[..., :1], 3, axis=2) if small.shape[2] < 3 else small[..., :3]


def _nearest(pixels: Pixels, height: int, width: int) -> Pixels:
    """(height, width, c) nearest texels."""
    rows, columns = (
        np.arange(count) * side // count for count, side in zip((height, width), pixels.shape[:2], strict=True)
    )
    return pixels[np.ix_(rows, columns)]


def open_model(path: Path, scheme: str | None, up: str | None, vertices: int, part: str | None = None) -> OpenedModel:
    """Read, weld where its file is split at seams, check and refine one model.

    Parameters
    ----------
    path : Path
    scheme, up, part : str or None
        See `cagemap.studio.state.Files`.
    vertices : int
        Of the surface, about.

    Raises
    ------
    ParameterError
        If there is no such part, or it has several connected pieces.
    InvalidMeshError, FormatError
        If it cannot be taken or read.
    """
    filed = replace(read_whole(path), name=path.name)
    if structure_problems(filed):
        require_valid(filed)
    turn = upright(path, up)
    if scheme is not None:
        filed = replace(with_options(filed, scheme), object_schemes=())
    tolerance = weld_tolerance(filed)
    welded = unwelded(filed) if tolerance is None else weld_mesh(filed, tolerance)
    model = _open_welded(welded, filed, scheme, part, vertices, turn)
    return replace(model, notes=(*welded.notes, *model.notes), weld=None if tolerance is None else f"{tolerance:g}")


def _open_welded(
    welded: Welded, filed: ControlMesh, scheme: str | None, part: str | None, vertices: int, turn: FloatArray
) -> OpenedModel:
    """Take a part of a mesh, or all of it, check and refine it."""
    whole = welded.mesh
    taken = _of_file(take_part(whole, part, plain=isinstance(whole.scheme, Plain)), welded)
    if isinstance(taken.mesh.scheme, Plain):
        return _as_it_is(taken, whole, filed, turn)
    _require_one_piece(taken.mesh)
    dense = scheme is None and is_dense(taken.mesh)
    try:
        require_valid(taken.mesh)
    except InvalidMeshError as error:
        if not dense:
            raise
        again = _of_file(take_part(with_options(whole, NO_SCHEME), part, plain=True), welded)
        model = _as_it_is(again, whole, filed, turn)
        return replace(model, notes=(f"{filed.name} is no cage and is taken as it is: {error}", *model.notes))
    level = choose_level(taken.mesh, vertices)
    original = Original(filed, taken.vertex_of) if taken.mesh.file_vertices is not None else None
    shape = shape_of(refine(taken.mesh, level), original, turn)
    mirror = next((plane.image for plane in mirror_symmetries(taken.mesh)), None)
    look = replace(_own_look(taken.mesh), rest=rest_of(whole, taken.left, level))
    return OpenedModel(level, shape, look, mirror, offer=taken.offer, scheme=scheme, dense=dense)


def _of_file(taken: Taken, welded: Welded) -> Taken:
    """A part of a welded mesh, with its vertex for each of the file's."""
    return replace(taken, vertex_of=np.where(welded.vertex_of < 0, -1, taken.vertex_of[welded.vertex_of]))


def is_dense(mesh: ControlMesh) -> bool:
    """Whether a mesh looks like a scan rather than a cage: many triangles, and nothing said about subdivision."""
    stated = mesh.scheme is not None or mesh.crease_edges is not None
    return mesh.is_triangle_mesh and not stated and mesh.n_faces >= DENSE


def _as_it_is(taken: Taken, whole: ControlMesh, filed: ControlMesh, turn: FloatArray) -> OpenedModel:
    """A part, or a whole file, that is not subdivided."""
    ready = plain_mesh(taken.mesh)
    vertex_of = np.where(taken.vertex_of < 0, -1, ready.vertex_of[taken.vertex_of])
    shape = shape_of(refine(ready.mesh, 0), Original(filed, vertex_of), turn)
    look = replace(_own_look(ready.mesh), rest=rest_of(whole, taken.left, 0))
    return OpenedModel(0, shape, look, None, ready.notes, taken.offer, NO_SCHEME)


def _require_one_piece(control: ControlMesh) -> None:
    pieces = sorted(connected_parts(control), key=lambda part: -len(part.faces))
    if len(pieces) > 1:
        listed = first_few(f"{part.title} ({len(part.faces)} faces)" for part in pieces)
        raise ParameterError(
            f"{control.name}: expected a part of one connected piece, got {len(pieces)}: {listed}. Choose one of "
            "these; `cagemap match --part each` maps all of them."
        )


def upright(path: Path, up: str | None) -> FloatArray:
    """(3, 3) rotation from a file's space to the view, for rows: as asked, else as a USD file says, else y is up."""
    if up is not None:
        return UP_AXES[up]
    said = upright_turn(path)
    return Y_UP if said is None else said


def _own_look(control: ControlMesh) -> Look:
    try:
        return Look(colors=face_colors(control))
    except CagemapError:  # a mesh without materials is clay
        return Look()
