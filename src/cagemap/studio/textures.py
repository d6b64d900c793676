"""The image that the source is drawn with and that a bake transfers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from cagemap.files.gltf.material_images import png_bytes, write_numbered
from cagemap.files.inner_texture import SUFFIXES, extract_texture, material_document
from cagemap.studio.models import OpenedModel, with_texture
from cagemap.studio.shape import refined_shape
from cagemap.subdivision import refine
from cagemap.tasks.material_atlas import material_atlas

Progress = Callable[[str], None]


def textured(source: OpenedModel, holder: Path, folder: Path, progress: Progress) -> OpenedModel:
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
