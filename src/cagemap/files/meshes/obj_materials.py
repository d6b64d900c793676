"""Materials of an OBJ file, with their colour images, as a glTF document."""

from __future__ import annotations

import logging
import math
import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from cagemap.files.gltf.binary import Binary
from cagemap.files.gltf.entries import Document
from cagemap.files.gltf.textures import CLAMP, REPEAT, AddedTextures
from cagemap.files.meshes.colors import material_lines
from cagemap.files.meshes.obj import material_files
from cagemap.files.text import find_image, is_number, read_text

_log = logging.getLogger(__name__)

# Largest number of values of each option of an image; `-o`, `-s` and `-t` may have fewer.
_OPTIONS = {"-o": 3, "-s": 3, "-t": 3, "-mm": 2} | dict.fromkeys(
    ("-blendu", "-blendv", "-bm", "-boost", "-cc", "-clamp", "-imfchan", "-texres", "-type"), 1
)


def obj_images(path: Path) -> list[Path]:
    """Existing images (``map_Kd``) that the ``.mtl`` files of an OBJ file name."""
    statements = _color_statements(path)
    images = (_image_file(path, library, image_options(statement)[1]) for library, _, statement in statements)
    return [image for image in images if image is not None]


def obj_document(path: Path) -> Document:
    """A document without meshes, of the materials of an OBJ file's ``.mtl`` files and their images (``map_Kd``)."""
    binary, top = Binary(), dict[str, Any]()
    textures = AddedTextures(binary, top)
    materials = []
    for library, name, statement in _color_statements(path):
        texture = _texture(path, library, name, statement, textures) if statement else None
        surface = {} if texture is None else {"baseColorTexture": texture}
        materials.append({"name": name, "pbrMetallicRoughness": surface})
    top |= {"asset": {"version": "2.0"}, "materials": materials}
    return replace(binary.document(top), file=path)


def _color_statements(path: Path) -> Iterator[tuple[Path, str, str]]:
    """Material file, name and last ``map_Kd`` statement ("" if none) of each material; the first one of a name."""
    known: set[str] = set()
    for library in material_files(path, read_text(path, "an OBJ file")):
        statements: dict[str, str] = {}
        for name, _, line in material_lines(library):
            keyword, _, rest = line.partition(" ")
            statements[name] = rest if keyword.lower() == "map_kd" else statements.get(name, "")
        yield from ((library, name, rest) for name, rest in statements.items() if name not in known)
        known |= statements.keys()


def _texture(
    path: Path, library: Path, material: str, statement: str, textures: AddedTextures
) -> dict[str, Any] | None:
    """The texture of an image statement of a material file; None, with a warning, if its image cannot be read."""
    options, name = image_options(statement)
    file = _image_file(path, library, name)
    image = None if file is None else textures.image(file.read_bytes(), file.suffix)
    if image is None:
        problem = "is not found; put it beside the .mtl" if file is None else "cannot be read as an image"
        _log.warning("%s: material %s: '%s' %s: its faces have the material's colour", path, material, name, problem)
        return None
    (across, up), (right, above) = (
        [*map(float, options.get(word, ())), *(missing,) * 3][:2] for word, missing in (("-s", 1.0), ("-o", 0.0))
    )
    transform = {"scale": [across, up], "offset": [right, 1.0 - up - above]}  # v is up in OBJ, down in glTF
    wrap = CLAMP if options.get("-clamp") == ["on"] else REPEAT
    moved = (across, up, right, above) != (1.0, 1.0, 0.0, 0.0)
    return textures.texture(image, (wrap, wrap), transform if moved else None)


def _image_file(path: Path, library: Path, name: str) -> Path | None:
    """The image of a name in the folder of a material file or of its OBJ file; else of the name without comments."""
    shorter, sign, _ = name.rpartition(" #")
    found = find_image(library, name) or find_image(path, os.path.join(library.parent.absolute(), name))
    return found or (_image_file(path, library, shorter.rstrip()) if sign else None)


def image_options(rest: str) -> tuple[dict[str, list[str]], str]:
    """Options before the name of an image, and the name: the rest of the line."""
    options: dict[str, list[str]] = {}
    while (words := rest.split(maxsplit=4)) and (most := _OPTIONS.get(words[0])):
        values = words[1:-1][:most]  # the last word belongs to the name, also if it is a number
        if words[0] in ("-o", "-s", "-t"):
            finite = [is_number(word) and math.isfinite(float(word)) for word in values]
            values = values[: [*finite, False].index(False)]
        options[words[0]] = values
        rest = rest.split(maxsplit=len(values) + 1)[-1] if len(words) > 1 else ""
    return options, rest.strip()
