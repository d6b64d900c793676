"""The pictures of a report: the same views of source and target, side by side."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cagemap.maps.hypotheses.confidence import SURE
from cagemap.maps.places import surface_curves
from cagemap.maps.result import MatchResult
from cagemap.mesh.cage_points import CagePoints
from cagemap.mesh.curves import CageCurves
from cagemap.numerics.arrays import FloatArray
from cagemap.numerics.threads import ThreadPool
from cagemap.pictures import (
    BACK,
    ENOUGH,
    FRONT,
    VIEWS,
    Image,
    Model,
    Skin,
    View,
    distinct_colors,
    draw_dots,
    draw_line,
    frame,
    position_colors,
    render,
    sample_texture,
    scalar_colors,
    to_display,
)
from cagemap.report.viewpoints import Seen, seen
from cagemap.spectral import Surface
from cagemap.surface.polylines import Polyline
from cagemap.transfer import face_colors
from cagemap.transfer.textured_surface import TexturedSurface

Pixels = NDArray[Any]
Progress = Callable[[str], None]

WIDTH, HEIGHT = 600, 460
_SMALL = 220, 190
# Of sqrt(area): where two answers are so far apart they are drawn in the strongest colour.
ELSEWHERE = 0.3
_CELLS = 28  # of a checker, along the longest side
_LARGEST_TEXTURE = 2048  # a picture shows no more than this
PAPER = np.array([0.962, 0.966, 0.970])


@dataclass(frozen=True)
class Figure:
    """One view of both surfaces (or of the target alone).

    Attributes
    ----------
    view : str
        Name of the view.
    source : Image or None
    target : Image
    """

    view: str
    source: Image | None
    target: Image


@dataclass(frozen=True)
class Gallery:
    """All pictures of a report; ``appearance`` says what the first ones show.

    Attributes
    ----------
    appearance : str
        "texture", "material colours" or "checker".
    looks, maps, trust : tuple of Figure
        The transferred look; the map as colours with landmarks; where the map is to be trusted.
    orientation : str
        What of the target is taken to be up and in front, and why.
    masks : tuple of Figure
        What was matched of both surfaces, where not all of them was.
    answers : tuple of (Figure, Figure)
        From the front and from behind, where a map is not sure: the runner-up beside the source, as colours, and how
        far it is from the map.
    """

    appearance: str
    looks: tuple[Figure, ...]
    maps: tuple[Figure, ...]
    trust: tuple[Figure, ...]
    orientation: str
    masks: tuple[Figure, ...] = ()
    answers: tuple[tuple[Figure, Figure], ...] = ()


@dataclass(frozen=True, eq=False)
class _Stage:
    """Both surfaces, ready to draw, turned to where they are seen from."""

    result: MatchResult
    target: TexturedSurface
    source: TexturedSurface
    target_model: Model
    source_model: Model
    seen: Seen


def draw_gallery(
    result: MatchResult,
    *,
    texture: Pixels | None = None,
    baked: Pixels | None = None,
    size: tuple[int, int] = (WIDTH, HEIGHT),
    progress: Progress | None = None,
    views: Seen | None = None,
) -> Gallery:
    """Draw everything a report shows.

    Parameters
    ----------
    result : MatchResult
    texture : (H, W, c) array, optional
        The source's texture; integers stand for 0 to 1. Without one, material colours or a checker are shown.
    baked : (H, W, c) array, optional
        The texture baked into the target's own layout. Without one, the source's texture is pulled back vertex by
        vertex.
    size : (int, int)
        Width and height of each picture, in pixels.
    progress : callable, optional
        Called with the name of each step.
    views : Seen, optional
        From where; by default as the target's shape shows.
    """
    stage = _stage(result, views or seen(result))
    appearance, source_skin, target_skin = _looks(stage, texture, baked)
    pulled = position_colors(result.image(), result.source.vertices)
    own = position_colors(result.source.vertices, result.source.vertices)
    trust = scalar_colors(result.trust, 0.0, 1.0, ENOUGH)
    jobs: list[_Job] = [
        *((view, source_skin, target_skin, False) for view in VIEWS),
        *((view, Skin(vertex_colors=own), Skin(vertex_colors=pulled), True) for view in (FRONT, BACK)),
        *((view, None, Skin(vertex_colors=trust), False) for view in (FRONT, BACK)),
    ]
    masks, answers = _mask_jobs(result), _answer_jobs(result)
    figures = tuple(_figures(stage, [*jobs, *masks, *answers], size, progress))
    masked, other = figures[7 : 7 + len(masks)], figures[7 + len(masks) :]
    both = tuple(zip(other[::2], other[1::2], strict=True))
    said = str(stage.seen.target)
    return Gallery(appearance, figures[:3], figures[3:5], figures[5:7], said, masked, both)


def _mask_jobs(result: MatchResult) -> list[_Job]:
    """What counts of both surfaces, from the front and from behind; nothing where all of it does."""
    masks = result.masks
    if not masks.any:
        return []
    own, joint = masks.of_source(len(result.source.vertices)), masks.joint(result.point_map)
    skins = [Skin(vertex_colors=scalar_colors(values, 0.0, 1.0)) for values in (own, joint)]
    return [(view, skins[0], skins[1], False) for view in (FRONT, BACK)]


def runner_up_image(result: MatchResult) -> FloatArray | None:
    """(n1, 3) where the next best answer puts every target vertex; None where the answer is sure or none is known."""
    others = result.runner_up_images
    if result.confidence is None or result.confidence.verdict == SURE or not len(others):
        return None
    refinement, found = result.target.refinement, result.image()
    return np.asarray(found + refinement.prolong(others[0] - found[: others.shape[1]], 0, refinement.n_levels))


def _answer_jobs(result: MatchResult) -> list[_Job]:
    """The runner-up as colours and its distance from the map; nothing where the answer is sure or none is known."""
    image, vertices = runner_up_image(result), result.source.vertices
    if image is None:
        return []
    apart = np.linalg.norm(image - result.image(), axis=1) * result.source.scale
    skins = [
        Skin(vertex_colors=colors)
        for colors in (
            position_colors(vertices, vertices),
            position_colors(image, vertices),
            scalar_colors(apart, 0.0, ELSEWHERE, ENOUGH[::-1]),
        )
    ]
    return [job for view in (FRONT, BACK) for job in ((view, skins[0], skins[1], True), (view, None, skins[2], False))]


def draw_thumbnail(result: MatchResult) -> Image:
    """One small picture of a map: equal colours correspond; the source on the left, the target on the right."""
    stage = _stage(result, seen(result))
    own = Skin(vertex_colors=position_colors(result.source.vertices, result.source.vertices))
    pulled = Skin(vertex_colors=position_colors(result.image(), result.source.vertices))
    figure = _figure(stage, (FRONT, own, pulled, False), _SMALL)
    return figure.target if figure.source is None else np.hstack([figure.source, figure.target])


def _stage(result: MatchResult, views: Seen) -> _Stage:
    target, source = (TexturedSurface.from_level(side.refinement.finest) for side in (result.target, result.source))
    return _Stage(
        result,
        target,
        source,
        Model(target.positions @ views.target.turn, target.triangles),
        Model(source.positions @ views.source_turn, source.triangles),
        views,
    )


def _looks(stage: _Stage, texture: Pixels | None, baked: Pixels | None) -> tuple[str, Skin, Skin]:
    """What source and target look like: its name and both skins."""
    if texture is not None and stage.source.uvs is not None:
        shown = for_display(texture)
        source_skin = Skin(texture=shown, corner_uvs=stage.source.corner_uvs())
        if baked is not None and stage.target.uvs is not None:
            return "texture", source_skin, Skin(texture=for_display(baked), corner_uvs=stage.target.corner_uvs())
        return "texture", source_skin, Skin(vertex_colors=_pulled_texture(stage, shown))
    control = stage.result.source.control
    own = np.zeros((1, 3))
    if control.face_materials is not None and control.material_colors is not None:
        own = face_colors(control)
    if np.ptp(own, axis=0).any():  # one colour all over shows nothing
        parents = stage.source.face_parents[stage.source.triangle_faces]
        colors = to_display(own[parents])
        return "material colours", Skin(face_colors=colors), Skin(vertex_colors=colors[stage.result.triangle])
    checker = _checker(stage.result.source.vertices, stage.result.source.vertices)
    pulled = _checker(stage.result.image(), stage.result.source.vertices)
    return "checker", Skin(vertex_colors=checker), Skin(vertex_colors=pulled)


def _pulled_texture(stage: _Stage, texture: FloatArray) -> FloatArray:
    """(n1, 3) the source's texture at the image of every target vertex; UVs are mixed inside one triangle only."""
    corners = stage.source.corner_uvs()[stage.result.triangle]
    return sample_texture(texture, np.einsum("nc,ncd->nd", stage.result.barycentric, corners))[:, :3]


def _checker(points: FloatArray, reference: FloatArray) -> FloatArray:
    """(n, 3) a soft three-dimensional checker in two tones."""
    steps = np.floor((points - reference.min(0)) * (_CELLS / float(np.ptp(reference, axis=0).max()))).astype(np.int64)
    odd = (steps.sum(1) % 2 == 1)[:, None]
    return np.where(odd, np.array([0.20, 0.45, 0.55]), np.array([0.93, 0.90, 0.84]))


def for_display(image: Pixels) -> FloatArray:
    """(h, w, 3) sRGB in [0, 1], at most 2048 texels a side; grey images become coloured."""
    pixels = np.asarray(image)
    if np.issubdtype(pixels.dtype, np.integer):
        scale = 1.0 / np.iinfo(pixels.dtype).max
    else:
        scale = 1.0
    pixels = pixels.reshape(*pixels.shape[:2], -1)
    pixels = pixels[..., :3] if pixels.shape[2] >= 3 else np.repeat(pixels[..., :1], 3, axis=2)
    step = max(1, -(-max(pixels.shape[:2]) // _LARGEST_TEXTURE))
    height, width = (length // step * step for length in pixels.shape[:2])
    blocks = pixels[:height, :width].reshape(height // step, step, width // step, step, 3)
    return np.clip(np.asarray(blocks.mean(axis=(1, 3), dtype=np.float32) * scale, dtype=np.float32), 0.0, 1.0)


_Job = tuple[View, Skin | None, Skin, bool]


def _figures(stage: _Stage, jobs: list[_Job], size: tuple[int, int], progress: Progress | None) -> Iterator[Figure]:
    # NumPy and Embree release the interpreter in their loops, so two threads draw nearly twice as fast.
    with ThreadPool(2) as pool:
        for number, figure in enumerate(pool.map(lambda job: _figure(stage, job, size), jobs), start=1):
            if progress is not None:
                progress(f"picture {number} of {len(jobs)}")
            yield figure


def _figure(stage: _Stage, job: _Job, size: tuple[int, int]) -> Figure:
    view, source_skin, target_skin, dotted = job
    result = stage.result
    pairs = result.landmarks
    marks = [
        _marks(side, points, lines, turn) if dotted else None
        for side, points, lines, turn in (
            (result.target, pairs.target_points, pairs.curves.target, stage.seen.target.turn),
            (result.source, pairs.source_points, pairs.curves.source, stage.seen.source_turn),
        )
    ]
    source = None if source_skin is None else _draw(stage.source_model, source_skin, view, size, marks[1])
    return Figure(view.name, source, _draw(stage.target_model, target_skin, view, size, marks[0]))


@dataclass(frozen=True, eq=False)
class _Marks:
    """What is drawn on a picture: a dot for every landmark, and a line for every curve."""

    dots: FloatArray
    curves: tuple[Polyline, ...]


def _marks(surface: Surface, points: CagePoints, lines: CageCurves, turn: FloatArray) -> _Marks:
    finest = surface.finest_triangles
    found = surface_curves(surface.refinement, finest, lines) if len(lines) else ()
    curves = tuple(Polyline(curve.line.positions @ turn / finest.scale, curve.closed) for curve in found)
    return _Marks(surface.vertices[points.nearest_vertices] @ turn, curves)


def _draw(model: Model, skin: Skin, view: View, size: tuple[int, int], marks: _Marks | None) -> Image:
    camera = frame(model.positions, view, aspect=size[0] / size[1])
    image = render(model, skin, camera, width=size[0], height=size[1], background=PAPER)
    if marks is None:
        return image
    for line, color in zip(marks.curves, distinct_colors(len(marks.curves)), strict=True):
        image = draw_line(image, model, camera, line, color)
    return draw_dots(image, model, camera, marks.dots, distinct_colors(len(marks.dots)), radius=5.0)
