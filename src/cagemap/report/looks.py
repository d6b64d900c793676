"""Models of a report: their colourings and shapes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cagemap.maps.regions import local_size
from cagemap.maps.result import MatchResult
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.pictures import BALANCE, distinct_colors, position_colors, sample_texture, scalar_colors, to_display
from cagemap.report.figures import Pixels, for_display, runner_up_image
from cagemap.report.marks import SOURCE, TARGET, find_marks
from cagemap.report.models import Look, Models, Shape
from cagemap.report.rig_panels import NOTHING, CarriedData, refined_wrap
from cagemap.report.shown import MAX_VERTICES, ShownSurface, reached, shown_surfaces
from cagemap.report.viewpoints import Seen
from cagemap.transfer import face_colors
from cagemap.transfer.textured_surface import TexturedSurface

# Ids of the pictures of a page that models wear.
SOURCE_PICTURE, TARGET_PICTURE = "source-texture", "target-texture"
CLAY = np.array([0.86, 0.84, 0.80])
# Shapes that a page has beside the one at rest.
MAX_SHAPES = 12


@dataclass(frozen=True, eq=False)
class _FirstLook:
    """The look that the source came with: with its keys by side, see `Models`."""

    look: Look
    keys: dict[str, IndexArray]
    values: dict[str, FloatArray]


def report_models(
    result: MatchResult,
    views: Seen,
    *,
    texture: Pixels | None = None,
    baked: Pixels | None = None,
    carried: CarriedData = NOTHING,
    most: int = MAX_VERTICES,
) -> Models:
    """Everything that turns on a page.

    Parameters
    ----------
    result : MatchResult
    views : Seen
    texture, baked : (H, W, c) array, optional
        The source's texture, and the same in the target's layout; the page shows them as pictures.
    carried : CarriedData
    most : int
        Vertices of each model.
    """
    target, source = shown_surfaces(result, views, most)
    source_reached = reached(result, source)
    first = _first_look(result, target, source, texture, baked)
    looks = [
        *([] if first is None else [first.look]),
        Look(
            "Checker",
            "The source's checker on both. Squares stay squares where the map keeps shape.",
            kind="checker",
        ),
        Look(
            "Places",
            "Equal colours are equal places. Point at one model: a ring marks the same place.",
            kind="places",
        ),
        Look(
            "Problems",
            "Red: folded or stretched strongly; on the source: nothing from here arrives.",
            kind="doubt",
        ),
        Look(
            "Sizes",
            "Red: larger on the target than on the source; blue: smaller. The darkest are twice or half as long. Both "
            "models are compared at equal area.",
            np.broadcast_to(CLAY, (len(source.vertices), 3)),
            scalar_colors(np.log2(local_size(result)[target.vertices]), -1.0, 1.0, BALANCE),
        ),
    ]
    other = runner_up_image(result)
    if other is not None:
        shown = [
            position_colors(places, result.source.vertices)
            for places in (result.source.vertices[source.vertices], other[target.vertices])
        ]
        looks.append(
            Look("Other answer", "As Places, of the next best answer: is it the right one?", shown[0], shown[1])
        )
    if result.masks.any:
        own, joint = result.masks.of_source(len(result.source.vertices)), result.masks.joint(result.point_map)
        shown = [scalar_colors(values, 0.0, 1.0) for values in (own[source.vertices], joint[target.vertices])]
        looks.append(Look("Masks", "Dark parts were masked: neither matched nor transferred.", shown[0], shown[1]))
    if result.shared is not None:
        shown = [
            scalar_colors(values, 0.0, 1.0)
            for values in (result.shared.source[source.vertices], result.shared.target[target.vertices])
        ]
        parts = result.shared
        legend = (
            f"Dark parts have no counterpart: {1 - parts.target_share:.0%} of the target, "
            f"{1 - parts.source_share:.0%} of the source."
        )
        looks.append(Look("Shared", legend, shown[0], shown[1]))
    if carried.weights is not None:
        palette = distinct_colors(carried.weights.source.shape[1])
        shown = [
            _at_vertices(side, _joint_colors(values, palette))
            for side, values in ((source, carried.weights.source), (target, carried.weights.target))
        ]
        looks.append(
            Look("Weights", "One colour for each joint, mixed where several hold a vertex.", shown[0], shown[1])
        )
    return Models(
        target,
        source,
        tuple(looks),
        {TARGET: result.trust[target.vertices], SOURCE: source_reached.astype(np.float64)},
        find_marks(result, target, source, source_reached),
        _shapes(result, target, source, carried),
        {} if first is None else first.keys,
        {} if first is None else first.values,
    )


def _first_look(
    result: MatchResult, target: ShownSurface, source: ShownSurface, texture: Pixels | None, baked: Pixels | None
) -> _FirstLook | None:
    """The texture, or the colours of the materials; None where the source has neither."""
    map_triangles, map_weights = result.triangle[target.vertices], result.barycentric[target.vertices]
    full = result.source.refinement.finest
    if texture is not None and full.uv_indices is not None:
        legend = "Left the source as it came, right what the target received."
        keys, values = dict[str, IndexArray](), dict[str, FloatArray]()
        colors: dict[str, FloatArray | str] = {}
        shown = for_display(texture)
        finest = _corner_uvs(result)
        if source.corner_uvs is None:
            colors[SOURCE] = _texture_of_vertices(source, finest, shown)
        else:
            keys[SOURCE], values[SOURCE] = _keyed(source.corner_uvs)
            colors[SOURCE] = SOURCE_PICTURE
        if baked is not None and target.corner_uvs is not None:
            keys[TARGET], values[TARGET] = _keyed(target.corner_uvs)
            colors[TARGET] = TARGET_PICTURE
        else:
            places = np.einsum("nc,ncd->nd", map_weights, finest[map_triangles])
            colors[TARGET] = sample_texture(shown, places)[:, :3]
        return _FirstLook(Look("Texture", legend, colors[SOURCE], colors[TARGET]), keys, values)
    control = result.source.control
    if control.face_materials is None or control.material_colors is None or source.control_faces is None:
        return None
    own = to_display(face_colors(control))
    if not np.ptp(own, axis=0).any():  # one colour all over shows nothing
        return None
    palette, material = np.unique(own, axis=0, return_inverse=True)
    corners = np.repeat(material.ravel()[source.control_faces][:, None], 3, axis=1)
    per_face = len(result.source_triangles) // len(result.source.faces)
    received = own[full.face_parents[map_triangles // per_face]]
    look = Look("Materials", "Left the source's materials, right the same on the target.", None, received)
    return _FirstLook(look, {SOURCE: corners}, {SOURCE: palette})


def _corner_uvs(result: MatchResult) -> FloatArray:
    """(t, 3, 2) texture coordinates of the source's finest triangles."""
    return TexturedSurface.from_level(result.source.refinement.finest).corner_uvs()


def _texture_of_vertices(shown: ShownSurface, corner_uvs: FloatArray, texture: FloatArray) -> FloatArray:
    """(n, 3) the texture at shown vertices, in one of the triangles around each."""
    at = np.zeros((shown.surface.finest_triangles.n, 2))
    at[shown.surface.finest_triangles.triangles.ravel()] = corner_uvs.reshape(-1, 2)
    return sample_texture(texture, at[shown.vertices])[:, :3]


def _keyed(corner_uvs: FloatArray) -> tuple[IndexArray, FloatArray]:
    """Number of the texture coordinates of every corner (t, 3), and these (k, 2)."""
    values, inverse = np.unique(corner_uvs.reshape(-1, 2), axis=0, return_inverse=True)
    return inverse.reshape(-1, 3), values


def _joint_colors(weights: FloatArray, palette: FloatArray) -> FloatArray:
    return np.asarray(weights @ palette + (1.0 - weights.sum(axis=1, keepdims=True)).clip(0.0) * CLAY)


def _at_vertices(shown: ShownSurface, values: FloatArray) -> FloatArray:
    """Values of the control vertices at the shown ones."""
    refinement = shown.surface.refinement
    return np.asarray(refinement.prolong(values, 0, refinement.n_levels)[shown.vertices])


def _shapes(result: MatchResult, target: ShownSurface, source: ShownSurface, carried: CarriedData) -> tuple[Shape, ...]:
    shapes = list[Shape]()
    if carried.wrapped is not None:
        wrapped = refined_wrap(result.target.refinement, carried.wrapped).finest.positions[target.vertices]
        shapes.append(Shape("Wrapped", None, source.placed(wrapped)))
    for moved in carried.shapes:
        sides = ((source, moved.source), (target, moved.target))
        shapes.append(Shape(moved.name, *(_moved(side, offsets) for side, offsets in sides)))
    for pose in carried.poses:
        sides = ((source, pose.source), (target, pose.target))
        shapes.append(Shape(pose.name, *(_moved(side, to - side.surface.control.positions) for side, to in sides)))
    return tuple(shapes[:MAX_SHAPES])


def _moved(shown: ShownSurface, offsets: FloatArray) -> FloatArray:
    """Shown positions after offsets (n_0, 3) of the control vertices, in the file's lengths."""
    return shown.positions + _at_vertices(shown, offsets) @ shown.turn / shown.radius
