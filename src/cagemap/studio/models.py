"""Models as the studio opens them: read, checked, refined, upright, with what they look like."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cagemap.descriptors import mirror_symmetries
from cagemap.errors import CagemapError, ParameterError
from cagemap.files.images import Pixels, first_image, read_texture, write_image
from cagemap.files.meshes import read_mesh
from cagemap.files.usd import USD_SUFFIXES
from cagemap.files.usd_space import to_standard
from cagemap.mesh import ControlMesh
from cagemap.mesh.checks import require_valid
from cagemap.mesh.mesh_report import first_few
from cagemap.mesh.parts import components
from cagemap.mesh.plain import plain_mesh
from cagemap.mesh.schemes import Plain
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.pipeline import choose_level
from cagemap.refinement import refine, with_options
from cagemap.studio.shape import Original, Shape, shape_of
from cagemap.studio.skins import Look
from cagemap.transfer import face_colors

# Largest side of the texture in the page; the bake uses the whole image.
TEXTURE_SIZE = 1024
# From a file whose z axis points up to the view, for rows.
_Z_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


@dataclass(frozen=True, eq=False)
class Model:
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
    """

    level: int
    shape: Shape
    look: Look
    mirror: IndexArray | None
    notes: tuple[str, ...] = ()

    @property
    def control(self) -> ControlMesh:
        """The control mesh."""
        return self.shape.control


def read_look(path: Path) -> tuple[Pixels, bytes]:
    """A texture in 8 bits, no larger than the page needs, and its JPEG file; the first tile of several."""
    pixels = first_image(read_texture(path)).pixels
    step = max(1, -(-max(pixels.shape[:2]) // TEXTURE_SIZE))
    pixels = pixels[::step, ::step]
    if pixels.dtype != np.uint8:
        top = np.iinfo(pixels.dtype).max if pixels.dtype.kind == "u" else 1.0
        pixels = np.rint(255 * np.clip(pixels.astype(np.float64) / top, 0, 1)).astype(np.uint8)
    pixels = np.repeat(pixels[..., :1], 3, axis=2) if pixels.shape[2] < 3 else np.ascontiguousarray(pixels[..., :3])
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "texture.jpg"
        write_image(file, pixels)
        return pixels, file.read_bytes()


def open_model(path: Path, scheme: str | None, up: str | None, vertices: int) -> Model:
    """Read, check and refine one model.

    Parameters
    ----------
    path : Path
    scheme, up : str or None
        See `cagemap.studio.state.Files`.
    vertices : int
        Of the surface, about.

    Raises
    ------
    ParameterError
        If a mesh that is subdivided has several connected pieces.
    InvalidMeshError, FormatError
        If it cannot be taken or read.
    """
    control = replace(read_mesh(path), name=path.name)
    turn = upright(path, control, up)
    if scheme is not None:
        control = replace(with_options(control, scheme), object_schemes=())
    if isinstance(control.scheme, Plain):
        ready = plain_mesh(control)
        shape = shape_of(refine(ready.mesh, 0), Original(control, ready.vertex_of), turn)
        return Model(0, shape, _own_look(ready.mesh), None, ready.notes)
    _require_one_piece(control)
    require_valid(control)
    level = choose_level(control, vertices)
    mirror = next((plane.image for plane in mirror_symmetries(control)), None)
    return Model(level, shape_of(refine(control, level), turn=turn), _own_look(control), mirror)


def _require_one_piece(control: ControlMesh) -> None:
    pieces = sorted(components(control), key=lambda part: -len(part.faces))
    if len(pieces) > 1:
        listed = first_few(f"{part.title} ({len(part.faces)} faces)" for part in pieces)
        raise ParameterError(
            f"{control.name}: expected a model of one connected piece, got {len(pieces)}: {listed}. Export the "
            "piece that is meant as a file of its own; or match it without the studio: cagemap match --part largest "
            "(--target-part NAME, --source-part NAME, --part each)."
        )


def upright(path: Path, control: ControlMesh, up: str | None) -> FloatArray:
    """(3, 3) rotation from a file's space to the view, for rows: as asked, else as a USD file says, else y is up."""
    if up is not None:
        return _Z_UP if up == "z" else np.eye(3)
    if path.suffix.lower() not in USD_SUFFIXES:
        return np.eye(3)
    left, _, right = np.linalg.svd(to_standard(path, control)[:3, :3])
    return np.asarray(left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right)


def _own_look(control: ControlMesh) -> Look:
    try:
        return Look(colors=face_colors(control))
    except CagemapError:  # a mesh without materials is clay
        return Look()
