"""Colourings and shapes of a report's models."""

from __future__ import annotations

import numpy as np

from cagemap.maps.regions import local_size
from cagemap.maps.result import MatchResult
from cagemap.numerics.arrays import FloatArray, IndexArray, encode_srgb
from cagemap.pictures import BALANCE_SCALE, position_colors, sample_texture, scalar_colors
from cagemap.report.figures import Pixels, display_image, runner_up_image
from cagemap.report.marks import SOURCE, TARGET, find_marks
from cagemap.report.models import Look, Models, Shape
from cagemap.report.rig_panels import CLAY, NO_DATA, CarriedData, joint_colors, refined_wrap
from cagemap.report.shown import (
    MAX_MODEL_VERTICES,
    DisplaySurface,
    display_surfaces,
    matched_source_vertices,
    reached_vertices,
)
from cagemap.report.viewpoints import Viewpoints
from cagemap.transfer import face_colors
from cagemap.transfer.textured_surface import TexturedSurface

# HTML ids of the models' textures.
SOURCE_TEXTURE_ID, TARGET_TEXTURE_ID = "source-texture", "target-texture"
# Texture coordinates beyond this are moved to the unit square: 16 bits for up to 2 are 1/16000 of an image.
_FAR_UVS = 2.0
# Shapes of a page, without the one at rest.
MAX_SHAPES = 12
# A look with corner keys and their values by side, as in `Models`.
_KeyedLook = tuple[Look, dict[str, IndexArray], dict[str, FloatArray]]


def report_models(
    result: MatchResult,
    viewpoints: Viewpoints,
    *,
    texture: Pixels | None = None,
    baked: Pixels | None = None,
    carried: CarriedData = NO_DATA,
    max_vertices: int = MAX_MODEL_VERTICES,
) -> Models:
    """The models of a page with all their colourings and shapes.

    ``texture``, ``baked``: (H, W, c), the source's texture, and the same in the target's layout.
    ``max_vertices``: of each model.
    """
    target, source = display_surfaces(result, viewpoints, max_vertices)
    source_reached = reached_vertices(result, source)
    source_look, keys, values = _source_look(result, target, source, texture, baked) or (None, {}, {})
    looks = [
        *([] if source_look is None else [source_look]),
        Look(
            "Checker", "The source's checker on both. Squares stay squares where the map keeps shape.", kind="checker"
        ),
        Look(
            "Places", "Equal colours are equal places. Point at one model: a ring marks the same place.", kind="places"
        ),
        Look("Problems", "Red: folded or stretched strongly; on the source: nothing from here arrives.", kind="doubt"),
        Look(
            "Sizes",
            "Red: larger on the target than on the source; blue: smaller. The darkest are twice or half as long. The "
            "models, or the parts that both have, are compared at equal area.",
            np.broadcast_to(CLAY, (len(source.vertices), 3)),
            scalar_colors(np.log2(local_size(result)[target.vertices]), -1.0, 1.0, BALANCE_SCALE),
        ),
    ]
    runner_up = runner_up_image(result)
    if runner_up is not None:
        extent = matched_source_vertices(result)
        on_source = position_colors(result.source.vertices[source.vertices], extent)
        on_target = position_colors(runner_up[target.vertices], extent)
        looks.append(
            Look("Other answer", "As Places, of the next best answer: is it the right one?", on_source, on_target)
        )

    def share_look(name: str, legend: str, of_source: FloatArray, of_target: FloatArray) -> Look:
        on_source, on_target = of_source[source.vertices], of_target[target.vertices]
        return Look(name, legend, scalar_colors(on_source, 0.0, 1.0), scalar_colors(on_target, 0.0, 1.0))

    n_target, n_source = len(result.target.vertices), len(result.source.vertices)
    if result.masks.any:
        legend = "Dark parts were masked: neither matched nor transferred."
        masked = result.masks.of_source(n_source), result.masks.joint(result.point_map)
        looks.append(share_look("Masks", legend, *masked))
    shared = result.shared
    if shared is not None:
        lacking = [1 - share for share in result.shared_shares]
        legend = f"Dark parts have no counterpart: {lacking[0]:.0%} of the target, {lacking[1]:.0%} of the source."
        looks.append(share_look("Shared", legend, shared.of_source(n_source), shared.of_target(n_target)))
    if carried.weights is not None:
        on_source = _prolong(source, joint_colors(carried.weights.source))
        on_target = _prolong(target, joint_colors(carried.weights.target))
        legend = "One colour for each joint, mixed where several hold a vertex."
        looks.append(Look("Weights", legend, on_source, on_target))
    return Models(
        target,
        source,
        tuple(looks),
        {TARGET: result.trust[target.vertices], SOURCE: source_reached.astype(np.float64)},
        find_marks(result, target, source, source_reached),
        _shapes(result, target, source, carried),
        keys,
        values,
    )


def _source_look(
    result: MatchResult, target: DisplaySurface, source: DisplaySurface, texture: Pixels | None, baked: Pixels | None
) -> _KeyedLook | None:
    """The texture or the material colours; None if the source has neither."""
    map_triangles, barycentric = result.triangle[target.vertices], result.barycentric[target.vertices]
    finest = result.source.refinement.finest
    if texture is not None and finest.uv_indices is not None:
        legend = "Left the source as it came, right what the target received."
        keys, values = dict[str, IndexArray](), dict[str, FloatArray]()
        colors: dict[str, FloatArray | str] = {}
        pixels = display_image(texture)
        corner_uvs = TexturedSurface.from_level(finest).corner_uvs()
        if source.corner_uvs is None:
            colors[SOURCE] = _vertex_texture(source, corner_uvs, pixels)
        else:
            keys[SOURCE], values[SOURCE] = _index_uvs(source.corner_uvs)
            colors[SOURCE] = SOURCE_TEXTURE_ID
        if baked is not None and target.corner_uvs is not None:
            keys[TARGET], values[TARGET] = _index_uvs(target.corner_uvs)
            colors[TARGET] = TARGET_TEXTURE_ID
        else:
            uvs = np.einsum("nc,ncd->nd", barycentric, corner_uvs[map_triangles])
            colors[TARGET] = sample_texture(pixels, uvs)[:, :3]
        return Look("Texture", legend, colors[SOURCE], colors[TARGET]), keys, values
    control = result.source.control
    if control.face_colors is None or source.control_faces is None:
        return None
    source_colors = encode_srgb(face_colors(control))
    if not np.ptp(source_colors, axis=0).any():  # a single colour shows nothing
        return None
    palette, index = np.unique(source_colors, axis=0, return_inverse=True)
    corners = np.repeat(index.ravel()[source.control_faces][:, None], 3, axis=1)
    per_face = len(result.source_triangles) // len(result.source.faces)
    received = source_colors[finest.face_parents[map_triangles // per_face]]
    look = Look("Materials", "Left the source's materials, right the same on the target.", None, received)
    return look, {SOURCE: corners}, {SOURCE: palette}


def _vertex_texture(display: DisplaySurface, corner_uvs: FloatArray, texture: FloatArray) -> FloatArray:
    """(n, 3) the texture at displayed vertices, from one triangle around each."""
    triangles = display.surface.finest_triangles
    uvs = np.zeros((triangles.n, 2))
    uvs[triangles.triangles.ravel()] = corner_uvs.reshape(-1, 2)
    return sample_texture(texture, uvs[display.vertices])[:, :3]


def _index_uvs(corner_uvs: FloatArray) -> tuple[IndexArray, FloatArray]:
    """Index of the texture coordinates of every corner (t, 3), and the distinct coordinates (k, 2).

    Triangles far outside the unit square are moved to it: the page repeats images, and has 16 bits for a coordinate.
    """
    if np.abs(corner_uvs).max(initial=0.0) > _FAR_UVS:
        corner_uvs = corner_uvs - np.floor(corner_uvs.min(axis=1, keepdims=True))
    values, inverse = np.unique(corner_uvs.reshape(-1, 2), axis=0, return_inverse=True)
    return inverse.reshape(-1, 3), values


def _prolong(display: DisplaySurface, values: FloatArray) -> FloatArray:
    """Values of the control vertices, subdivided to the displayed vertices."""
    refinement = display.surface.refinement
    return np.asarray(refinement.prolong(values, 0, refinement.finest_level)[display.vertices])


def _shapes(
    result: MatchResult, target: DisplaySurface, source: DisplaySurface, carried: CarriedData
) -> tuple[Shape, ...]:
    shapes = list[Shape]()
    if carried.wrapped is not None:
        wrapped = refined_wrap(result.target.refinement, carried.wrapped).finest.positions[target.vertices]
        shapes.append(Shape("Wrapped", None, source.to_page(wrapped)))
    for shape in carried.shapes:
        sides = ((source, shape.source), (target, shape.target))
        shapes.append(Shape(shape.name, *(_displaced_positions(side, offsets) for side, offsets in sides)))
    for pose in carried.poses:
        sides = ((source, pose.source), (target, pose.target))
        shapes.append(
            Shape(pose.name, *(_displaced_positions(side, to - side.surface.control.positions) for side, to in sides))
        )
    return tuple(shapes[:MAX_SHAPES])


def _displaced_positions(display: DisplaySurface, offsets: FloatArray) -> FloatArray:
    """Displayed positions after offsets (n_0, 3) of the control vertices, in file units."""
    return display.positions + _prolong(display, offsets) @ display.turn / display.radius
