"""Checks of a wrap before its match and its fit: options, files, and both meshes."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from cagemap.errors import ParameterError
from cagemap.files.atomic import check_outputs
from cagemap.files.images.image import check_writable, read_image_form, texture_files, tile_files
from cagemap.files.meshes.formats import MESH_SUFFIXES, check_mesh_path, read_whole
from cagemap.files.meshes.mhclo import FOLLOWER_SUFFIXES
from cagemap.files.result.folder import ARRAYS
from cagemap.files.result.manifest import MANIFEST
from cagemap.files.text import require_suffix
from cagemap.files.values.attributes import read_attributes
from cagemap.files.values.part_numbering import FileRows, rows_of
from cagemap.mesh import ControlMesh
from cagemap.mesh.mirrors import mirror_symmetries
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.subdivision.refinement import vertex_counts
from cagemap.tasks.detail_bakes import outputs_beside, require_green, require_wrappable, wrap_bakes
from cagemap.tasks.masks import mask_inputs, read_masks
from cagemap.tasks.requests.catalogue import WRAP_IMAGES_OF, WRITTEN
from cagemap.tasks.requests.options import field_values, files_read, refuse_unread
from cagemap.tasks.requests.wrap import WrapRequest
from cagemap.wrap import WrapConfig
from cagemap.wrap.wrapping import NO_CAGE, require_fit_level


def check_wrap(request: WrapRequest) -> None:
    """Refuse options that contradict each other, and output files that cannot hold their data."""
    WrapConfig(level=request.fit_level, fairness=request.fairness)
    if not 0.0 <= request.amount <= 1.0:
        raise ParameterError(f"--amount: expected 0 (the target) to 1 (the source's shape), got {request.amount}")
    if request.detail_texture is not None and (request.detail is None or request.texture is not None):
        raise ParameterError(
            "--detail-texture: expected --detail, and no --texture, since --baked holds only one of them"
        )
    if (request.texture is None and request.detail_texture is None) != (request.baked is None):
        raise ParameterError(
            "--texture (or --detail-texture) and --baked: expected both or neither, an image and the one to write"
        )
    # Only with --target: a RESULT folder records the schemes and the welded meshes of its match.
    matched = dict.fromkeys(side_options(request, "scheme", "weld"), ("target",))
    refuse_unread(request, matched, () if request.target is None else ("target",))
    if (request.target_scheme or request.scheme) == "none":
        raise ParameterError(f"{request.target}: {NO_CAGE}")
    if request.map is not None and (request.landmarks is not None or any(side_options(request, "scheme").values())):
        raise ParameterError("--map: expected no --landmarks and no --scheme, since nothing is matched")
    if request.map is not None and len(request.results) > 1:
        raise ParameterError("--map: expected one --source, got several frames. Wrap each frame with a map of its own.")
    if request.symmetric and request.fit_level:
        raise ParameterError(
            "--symmetric: expected --fit-level 0, since only the symmetry of the control mesh is known"
        )
    require_green(request)
    bakes, images = wrap_bakes(request), outputs_beside(request)
    bakes.check()
    many = len(request.results) > 1
    if many and not request.blend_shapes:
        raise ParameterError(
            f"expected one RESULT, got {len(request.results)}. Several RESULTs need --blend-shapes and a folder as "
            "--output. Meshes are given by --target and --source, the frames of a motion by --target and their names."
        )
    if images and (many or request.blend_shapes or request.amount != 1.0):
        raise ParameterError("images that are baked and --mhclo: expected one RESULT, --amount 1 and no --blend-shapes")
    if request.detail is not None and not bakes.images:
        raise ParameterError("--detail: expected an image to bake from it, such as --normal-map")
    refuse_unread(request, WRAP_IMAGES_OF, [name for name in WRITTEN["wrap"] if getattr(request, name) is not None])
    if not request.blend_shapes:
        check_mesh_path(request.output)
    if request.mhclo is not None:
        require_suffix(request.mhclo, FOLLOWER_SUFFIXES)
    texture = request.texture or request.detail_texture
    if request.baked is None or texture is None:
        return
    if texture == request.texture and texture.suffix.lower() in MESH_SUFFIXES:  # a model's images are read later
        check_writable(request.baked, np.dtype(np.uint8), 3)
    else:
        # Every tile must be readable.
        forms = [read_image_form(file) for file in tile_files(texture).values()]
        dtype, channels, _ = forms[0]
        check_writable(request.baked, dtype, channels)


def check_files(request: WrapRequest) -> None:
    """Refuse outputs that would replace inputs, or files that cagemap did not write."""
    # Results are RESULT folders or, with --target, the files of frames.
    inputs = [file for result in request.results for file in (result, result / MANIFEST, result / ARRAYS)]
    given = files_read(request, *WRITTEN["wrap"])
    inputs += [*(file for path in given for file in texture_files(path)), *mask_inputs(request).values()]
    if request.blend_shapes and request.output.exists() and not request.output.is_dir():
        raise ParameterError(f"{request.output}: --blend-shapes writes a folder of OBJ files, got a file")
    outputs = [*outputs_beside(request), *([] if request.blend_shapes else [request.output])]
    check_outputs(outputs, inputs, force=request.force)


def require_inputs(
    request: WrapRequest, files: tuple[Path, Path], level: int, target: ControlMesh, source: ControlMesh
) -> None:
    """Refuse meshes that cannot be wrapped as requested, before they are matched.

    ``files``: paths of both meshes, which may be welded versions of them.
    ``level``: finest level of the target in the match.
    """
    require_wrappable(request, target, source)
    require_fit_level(request.fit_level, level, "--fit-level")
    if request.symmetric:
        mirror_image(target)
    if request.weights is not None:
        read_follow(
            request.weights, target, rows_of(files[0], target), next(islice(vertex_counts(target), level, None))
        )
    if request.target_mask is not None or request.source_mask is not None:
        sides = zip((target, source), files, strict=True)
        whole = [control if control.file_vertices is None else read_whole(file) for control, file in sides]
        read_masks(request, (whole[0], whole[1]), files)


def read_follow(path: Path, control: ControlMesh, rows: FileRows | None, finest: int) -> FloatArray:
    """Weights with which the target's vertices follow the source: control vertices, or all ``finest`` finest ones."""
    values = read_attributes(path, control, rows)
    if len(values) != 1:
        raise ParameterError(f"{path}: expected one column of weights from 0 to 1, got {', '.join(values)}")
    follow = np.asarray(next(iter(values.values())), dtype=np.float64)
    if len(follow) not in (control.n_vertices, finest):
        raise ParameterError(
            f"{path}: expected a weight for each of the {control.n_vertices} control vertices of {control.name}, the "
            f"target, got {len(follow)}. Give the target's."
        )
    return follow


def mirror_image(control: ControlMesh) -> IndexArray:
    """(n,) mirror image of every control vertex; refuses a mesh without symmetry."""
    image = next((mirror.image for mirror in mirror_symmetries(control) if mirror.exact), None)
    if image is None:
        raise ParameterError(f"{control.name}: expected a mirror symmetric mesh for --symmetric, found no symmetry")
    return image


def shape_files(request: WrapRequest, target: Path, sources: Sequence[Path]) -> list[Path]:
    """The files of blend shapes, by the names of target and sources; refuses equal names."""
    names = [path.stem for path in (target, *sources)]
    if len(set(names)) < len(names):
        raise ParameterError(f"--blend-shapes: expected different names, got {', '.join(names)}. Rename the files.")
    return [request.output / f"{name}.obj" for name in names]


def side_options(request: WrapRequest, *names: str) -> dict[str, Any]:
    """Values of the options --NAME, --target-NAME and --source-NAME."""
    return field_values(request, *(f"{side}{name}" for name in names for side in ("", "target_", "source_")))
