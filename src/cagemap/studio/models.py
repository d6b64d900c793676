"""Opening a model: read, weld, select a part, check, refine, and load its materials."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cagemap.errors import CagemapError, InvalidMeshError, ParameterError
from cagemap.files.fbx.read import fbx_as_glb
from cagemap.files.gltf.textures import write_numbered
from cagemap.files.images.image import Pixels, png_bytes, read_image, tile_files, write_image
from cagemap.files.inner_texture import SUFFIXES, extract_texture, material_document
from cagemap.files.meshes.formats import read_whole
from cagemap.mesh import ControlMesh
from cagemap.mesh.checks import require_valid
from cagemap.mesh.faces import cage_triangles
from cagemap.mesh.mesh_report import first_few
from cagemap.mesh.mirrors import mirror_symmetries
from cagemap.mesh.parts import connected_parts
from cagemap.mesh.plain import plain_mesh
from cagemap.mesh.repairs import RepairedMesh, unrepaired
from cagemap.mesh.schemes import Plain
from cagemap.mesh.structure_checks import structure_problems
from cagemap.mesh.udim import udim_origin
from cagemap.mesh.weld import weld_mesh, weld_tolerance
from cagemap.numerics.arrays import FloatArray, IndexArray, encode_srgb
from cagemap.pictures import UP_AXES, shape_turn, stated_turn, usual_turn
from cagemap.pipeline import choose_level
from cagemap.studio.file_parts import NO_PARTS, PartChoices, SelectedPart, other_parts_surface, select_part
from cagemap.studio.shape import OriginalMesh, refined_shape
from cagemap.studio.skins import DrawnModel, Look
from cagemap.studio.state import NO_SCHEME
from cagemap.subdivision import refine, with_options
from cagemap.tasks.material_atlas import material_atlas
from cagemap.transfer import face_colors

# Largest side of the texture in the page; the bake uses the whole image.
PREVIEW_TEXTURE_SIZE = 1024
# Triangle meshes of at least so many faces may be scans.
MIN_SCAN_FACES = 20_000
_PART_NOTE = (
    "{file} has several parts: only {part} is matched, the others are grey. To choose another, press Open…, Part"
)


@dataclass(frozen=True, eq=False)
class OpenedModel(DrawnModel):
    """A model as the studio has opened it."""

    level: int  # subdivision level of the preview
    mirror: IndexArray | None  # (n_control,) mirror image of each control vertex
    notes: tuple[str, ...] = ()  # what was changed in the mesh
    part_choices: PartChoices = NO_PARTS
    scheme: str | None = None  # subdivision scheme: the requested one, or "none" for a mesh that cannot be subdivided
    dense: bool = False  # whether it is subdivided although it looks like a scan
    weld: str | None = None  # welding tolerance, as `cagemap match --weld` takes it
    texture: Path | None = None  # file of the look's texture
    path: Path | None = None  # the model's file

    @property
    def control(self) -> ControlMesh:
        """The control mesh."""
        return self.shape.control


def with_texture(look: Look, path: Path) -> Look:
    """A look with an image in 8 bits, reduced, with tiles joined."""
    files = tile_files(path)
    cells = {number: [int(cell) for cell in udim_origin(number)] for number in files}  # column, row from below
    columns, rows = (1 + max(cell[k] for cell in cells.values()) for k in range(2))
    # One after the other: together, many large tiles would not fit into memory.
    tiles = {number: _shrink_tile(read_image(file).pixels, rows, columns) for number, file in files.items()}
    height, width = (max(tile.shape[k] for tile in tiles.values()) for k in range(2))
    pixels = np.zeros((rows * height, columns * width, 3), dtype=np.uint8)
    for number, (column, row) in cells.items():
        top, left = (rows - 1 - row) * height, column * width
        pixels[top : top + height, left : left + width] = _resample(tiles[number], height, width)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "texture.jpg"
        write_image(file, pixels)
        return replace(look, texture=pixels, jpeg=file.read_bytes(), tiles=(columns, rows))


def _shrink_tile(pixels: Pixels, rows: int, columns: int) -> Pixels:
    """(h, w, 3), or (h, w, 1) if grey, in 8 bits: one of rows x columns tiles, reduced to `PREVIEW_TEXTURE_SIZE`."""
    height, width = pixels.shape[:2]
    step = max(1, -(-max(rows * height, columns * width) // PREVIEW_TEXTURE_SIZE))
    small = _resample(pixels, -(-height // step), -(-width // step))
    if small.dtype.kind == "f":  # linear
        small = np.rint(255 * encode_srgb(small.astype(np.float64))).astype(np.uint8)
    elif small.dtype != np.uint8:
        small = np.rint(255 * (small / np.iinfo(small.dtype).max)).astype(np.uint8)
    return small[..., : 1 if small.shape[2] < 3 else 3]


def _resample(pixels: Pixels, height: int, width: int) -> Pixels:
    """(height, width, c) nearest texels."""
    rows, columns = (
        np.arange(count) * side // count for count, side in zip((height, width), pixels.shape[:2], strict=True)
    )
    return pixels[np.ix_(rows, columns)]


def textured(source: OpenedModel, holder: Path, folder: Path, progress: Callable[[str], None]) -> OpenedModel:
    """The source with an image, or with those in a model's file: several materials' are one image in the page."""
    atlas = material_atlas(material_document(holder, source.control), source.control)
    if atlas is not None:
        progress("reading the textures")
        image = write_numbered(folder / f"{holder.stem}_texture.png", png_bytes(atlas.image))
        refined = refined_shape(refine(atlas.control, source.level))
        shape = replace(source.shape, uvs=refined.uvs, uv_triangles=refined.uv_triangles)
        return replace(source, shape=shape, look=with_texture(source.look, image), texture=holder)
    is_model = holder == source.path or holder.suffix.lower() in SUFFIXES
    image_file = extract_texture(holder, source.control, folder) if is_model else holder
    if image_file is None:
        return source
    progress("reading the texture")
    return replace(source, look=with_texture(source.look, image_file), texture=image_file)


def open_model(path: Path, scheme: str | None, up: str | None, vertices: int, part: str | None = None) -> OpenedModel:
    """Read, weld, check and refine one model.

    ``scheme``, ``up``, ``part``: see `cagemap.studio.state.Files`.
    ``vertices``: approximate number of vertices of the refined surface.
    ParameterError if there is no such part, or it has several connected pieces.
    InvalidMeshError, FormatError if the mesh is invalid, or its file cannot be read.
    """
    file_mesh = replace(read_whole(path), name=path.name)
    if structure_problems(file_mesh):
        require_valid(file_mesh)
    rotation = view_rotation(path, up, file_mesh)
    if scheme is not None:
        file_mesh = replace(with_options(file_mesh, scheme), object_schemes=())
    tolerance = weld_tolerance(file_mesh)
    welded = unrepaired(file_mesh) if tolerance is None else weld_mesh(file_mesh, tolerance)
    model = _open_welded(welded, file_mesh, scheme, part, vertices, rotation)
    weld = None if tolerance is None else f"{tolerance:g}"
    opened = model.part_choices.opened
    partial = () if part is not None or opened is None else (_PART_NOTE.format(file=path.name, part=opened),)
    return replace(model, notes=(*welded.notes, *model.notes, *partial), weld=weld, path=path)


def converted_model(path: Path, folder: Path) -> tuple[Path, tuple[str, ...]]:
    """An FBX file as a GLB in a folder, and a note about it; any other file as it is."""
    if path.suffix.lower() != ".fbx":
        return path, ()
    converted = write_numbered(folder / f"{path.stem}.glb", fbx_as_glb(path))
    return converted, (f"{path.name} is converted: {converted.name} is used in its place",)


def _open_welded(
    welded: RepairedMesh,
    file_mesh: ControlMesh,
    scheme: str | None,
    part: str | None,
    vertices: int,
    rotation: FloatArray,
) -> OpenedModel:
    """Select a part, check and refine it; invalid triangle meshes are repaired and not refined."""
    whole = welded.mesh
    selected = _with_file_vertices(select_part(whole, part, plain=isinstance(whole.scheme, Plain)), welded)
    mesh = selected.mesh
    if isinstance(mesh.scheme, Plain):
        return _open_plain(selected, whole, file_mesh, rotation)
    _require_one_piece(mesh)
    dense = scheme is None and _may_be_plain(mesh) and mesh.n_faces >= MIN_SCAN_FACES  # it looks like a scan
    try:
        require_valid(mesh)
    except InvalidMeshError as error:
        if scheme is not None or not _may_be_plain(file_mesh):  # welding states a scheme
            raise
        plain = _with_file_vertices(select_part(with_options(whole, NO_SCHEME), part, plain=True), welded)
        model = _open_plain(plain, whole, file_mesh, rotation)
        faults = str(error).partition("\nOr use ")[0]  # without the remedy that is applied
        return replace(
            model, notes=(f"{file_mesh.name} is no valid cage, so it is not subdivided: {faults}", *model.notes)
        )
    level = choose_level(mesh, vertices)
    original = OriginalMesh(file_mesh, selected.vertex_of) if mesh.file_vertices is not None else None
    shape = refined_shape(refine(mesh, level), original, rotation)
    mirror = next((plane.image for plane in mirror_symmetries(mesh)), None)
    look = replace(_material_look(mesh), other_parts=other_parts_surface(whole, selected.other_faces, level))
    return OpenedModel(shape, look, level, mirror, part_choices=selected.part_choices, scheme=scheme, dense=dense)


def _with_file_vertices(selected: SelectedPart, welded: RepairedMesh) -> SelectedPart:
    """A part of a welded mesh, with its vertices for those of the file."""
    return replace(selected, vertex_of=np.where(welded.vertex_of < 0, -1, selected.vertex_of[welded.vertex_of]))


def _may_be_plain(mesh: ControlMesh) -> bool:
    """Whether a mesh need not be a cage: triangles without a scheme or creases."""
    return mesh.is_triangle_mesh and mesh.scheme is None and mesh.crease_edges is None


def _open_plain(
    selected: SelectedPart, whole: ControlMesh, file_mesh: ControlMesh, rotation: FloatArray
) -> OpenedModel:
    """Open a part without subdividing it."""
    plain = plain_mesh(selected.mesh)
    vertex_of = np.where(selected.vertex_of < 0, -1, plain.vertex_of[selected.vertex_of])
    shape = refined_shape(refine(plain.mesh, 0), OriginalMesh(file_mesh, vertex_of), rotation)
    faces = np.setdiff1d(np.arange(whole.n_faces), selected.other_faces)
    is_left_out = plain.vertex_of[selected.mesh.face_indices] < 0  # corners of pieces that are set aside
    other_faces = np.union1d(selected.other_faces, faces[selected.mesh.corner_faces[is_left_out]])
    look = replace(_material_look(plain.mesh), other_parts=other_parts_surface(whole, other_faces, 0))
    return OpenedModel(shape, look, 0, None, plain.notes, selected.part_choices, NO_SCHEME)


def _require_one_piece(control: ControlMesh) -> None:
    pieces = sorted(connected_parts(control), key=lambda part: -len(part.faces))
    if len(pieces) > 1:
        listed = first_few(f"{part.title} ({len(part.faces)} faces)" for part in pieces)
        raise ParameterError(
            f"{control.name}: expected a part of one connected piece, got {len(pieces)}: {listed}. Press "
            "Open… and choose one of these under Part."
        )


def view_rotation(path: Path, up: str | None, mesh: ControlMesh) -> FloatArray:
    """(3, 3) rotation of rows to the view, by the given axis, a USD file's, the shape's or the usual one."""
    if up is not None:
        return UP_AXES[up]
    stated = stated_turn(path, mesh.upright)
    if stated is None:
        stated = shape_turn(mesh.positions, cage_triangles(mesh)[0])
    return usual_turn(path) if stated is None else stated


def _material_look(control: ControlMesh) -> Look:
    try:
        return Look(colors=face_colors(control))
    except CagemapError:  # a mesh without materials is drawn as clay
        return Look()
