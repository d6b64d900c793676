"""The image that the source is drawn with and that a bake transfers."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from cagemap.files.gltf.material_images import png_bytes, write_numbered
from cagemap.files.inner_texture import SUFFIXES, extract_texture
from cagemap.files.meshes.colors import read_material_images
from cagemap.files.meshes.obj import material_files
from cagemap.files.text import read_text
from cagemap.mesh import ControlMesh
from cagemap.studio.models import OpenedModel, with_texture
from cagemap.studio.shape import refined_shape
from cagemap.subdivision import refine
from cagemap.tasks.material_atlas import material_atlas

Progress = Callable[[str], None]


def textured(source: OpenedModel, holder: Path, folder: Path, progress: Progress) -> OpenedModel:
    """The source with an image, or with those in a model's file: several materials' are one image in the page."""
    atlas = material_atlas(holder, source.control)
    if atlas is not None:
        progress("reading the textures")
        image = write_numbered(folder / f"{holder.stem}_texture.png", png_bytes(atlas.image))
        refined = refined_shape(refine(atlas.control, source.level))
        shape = replace(source.shape, uvs=refined.uvs, uv_triangles=refined.uv_triangles)
        return replace(source, shape=shape, look=with_texture(source.look, image), texture=holder)
    is_model = holder == source.path or holder.suffix.lower() in SUFFIXES
    image_file = extract_texture(holder, source.control, folder) if is_model else holder
    if is_model and holder.suffix.lower() == ".obj" and source.control.uvs is not None:
        image_file, note = _obj_image(holder, source.control)
        source = replace(source, notes=(*source.notes, *note))
    if image_file is None:
        return source
    progress("reading the texture")
    return replace(source, look=with_texture(source.look, image_file), texture=image_file)


def _obj_image(path: Path, control: ControlMesh) -> tuple[Path | None, tuple[str, ...]]:
    """The colour image that most faces of an OBJ have by its material files, and a note if they have several."""
    if control.face_materials is None:
        return None, ()
    known: dict[str, Path] = {}
    for file in material_files(path, read_text(path, "an OBJ file")):
        known = read_material_images(file) | known
    names = [control.material_names[number] for number in control.face_materials.tolist() if number >= 0]
    images = Counter(known[name] for name in names if name in known)
    if not images:
        return None, ()
    (first, _), *others = images.most_common()
    note = (
        f"{path.name} has an image for each of {1 + len(others)} materials; {first.name}, of most faces, is used for "
        "all. Convert the model to GLB, with its images, to use each, or choose another under Open…, Source's image"
    )
    return first, (note,) if others else ()
