"""Still pictures of a report: the same views of source and target, side by side."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import chain, islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cagemap.maps.hypotheses.confidence import SURE
from cagemap.maps.pair import surface_curve
from cagemap.maps.result import MatchResult
from cagemap.numerics.arrays import FloatArray, encode_srgb
from cagemap.numerics.threads import ThreadPool
from cagemap.pictures import (
    BACK,
    FRONT,
    TRUST_SCALE,
    VIEWS,
    Camera,
    Image,
    Model,
    Skin,
    View,
    distinct_colors,
    draw_dots,
    draw_line,
    frame,
    position_colors,
    render_skins,
    sample_texture,
    scalar_colors,
)
from cagemap.report.shown import matched_source_vertices
from cagemap.report.viewpoints import Viewpoints, choose_viewpoints
from cagemap.surface.polylines import Polyline
from cagemap.transfer import face_colors
from cagemap.transfer.textured_surface import TexturedSurface

Pixels = NDArray[Any]
Progress = Callable[[str], None]

WIDTH, HEIGHT = 600, 460
THUMBNAIL_SIZE = 220, 190
# Of sqrt(area): distance of two answers that gets the last colour of the scale.
MAX_ANSWER_DISTANCE = 0.3
STILL_CHECKER_CELLS = 28  # along the longest side of the matched part
MAX_TEXTURE_SIZE = 2048  # texels a side
BACKGROUND = np.array([0.962, 0.966, 0.970])


@dataclass(frozen=True)
class Figure:
    """One view of both surfaces, or of the target alone."""

    view: str
    source: Image | None
    target: Image


@dataclass(frozen=True)
class Gallery:
    """All still pictures of a report."""

    appearance: str  # what ``looks`` show: "texture", "material colours" or "checker"
    # `looks`, `maps`, `trust`: the transferred appearance; the map as colours with landmarks; trust in the map
    looks: tuple[Figure, ...]
    maps: tuple[Figure, ...]
    trust: tuple[Figure, ...]
    orientation: str  # up axis and front of the target, and how they were found
    masks: tuple[Figure, ...] = ()  # the matched parts of both surfaces; empty where everything was matched
    # from the front and from behind, if the map is not sure: the runner-up beside the source, as colours, and its
    # distance from the map
    answers: tuple[tuple[Figure, Figure], ...] = ()


@dataclass(frozen=True, eq=False)
class _ModelPair:
    """Both surfaces, rotated for drawing."""

    result: MatchResult
    target: TexturedSurface
    source: TexturedSurface
    target_model: Model
    source_model: Model
    viewpoints: Viewpoints


def draw_gallery(
    result: MatchResult,
    *,
    texture: Pixels | None = None,
    baked: Pixels | None = None,
    size: tuple[int, int] = (WIDTH, HEIGHT),
    progress: Progress | None = None,
    viewpoints: Viewpoints | None = None,
) -> Gallery:
    """Draw all still pictures of a report.

    ``texture``: (H, W, c), the source's; integers are scaled to 0 to 1. Default: material colours or a checker.
    ``baked``: (H, W, c), in the target's own layout. Default: the source's texture, pulled back vertex by vertex.
    ``size``: width and height of each picture, in pixels.
    ``progress``: called with the name of each step.
    ``viewpoints``: default: `choose_viewpoints`.
    """
    models = _model_pair(result, viewpoints or choose_viewpoints(result))
    appearance, source_skin, target_skin = _skins(models, texture, baked)
    trust = scalar_colors(result.trust, 0.0, 1.0, TRUST_SCALE)
    map_skins = _place_skins(result, result.image())
    jobs: list[list[_FigureJob]] = [
        [(view, source_skin, target_skin, False) for view in VIEWS],
        [(view, *map_skins, True) for view in (FRONT, BACK)],
        [(view, None, Skin(vertex_colors=trust), False) for view in (FRONT, BACK)],
        _mask_jobs(result),
        _answer_jobs(result),
    ]
    drawn = iter(_draw_figures(models, list(chain(*jobs)), size, progress))
    looks, maps, trusts, masks, answers = (tuple(islice(drawn, len(group))) for group in jobs)
    answer_pairs = tuple(zip(answers[::2], answers[1::2], strict=True))
    return Gallery(appearance, looks, maps, trusts, str(models.viewpoints.target), masks, answer_pairs)


def _mask_jobs(result: MatchResult) -> list[_FigureJob]:
    """Pictures of the masks from the front and from behind; none if nothing is masked."""
    masks = result.masks
    if not masks.any:
        return []
    source_mask, joint_mask = masks.of_source(len(result.source.vertices)), masks.joint(result.point_map)
    skins = [Skin(vertex_colors=scalar_colors(values, 0.0, 1.0)) for values in (source_mask, joint_mask)]
    return [(view, skins[0], skins[1], False) for view in (FRONT, BACK)]


def runner_up_image(result: MatchResult) -> FloatArray | None:
    """(n1, 3) images of the target's vertices under the runner-up; None if sure or not known."""
    runner_ups = result.runner_up_images
    if result.confidence is None or result.confidence.verdict == SURE or not len(runner_ups):
        return None
    refinement, image = result.target.refinement, result.image()
    return np.asarray(
        image + refinement.prolong(runner_ups[0] - image[: runner_ups.shape[1]], 0, refinement.finest_level)
    )


def _answer_jobs(result: MatchResult) -> list[_FigureJob]:
    """Pictures of the runner-up and of its distance from the map; none without a runner-up."""
    image = runner_up_image(result)
    if image is None:
        return []
    distances = np.linalg.norm(image - result.image(), axis=1) * result.source.scale
    apart = Skin(vertex_colors=scalar_colors(distances, 0.0, MAX_ANSWER_DISTANCE, TRUST_SCALE[::-1]))
    places = _place_skins(result, image)
    return [job for view in (FRONT, BACK) for job in ((view, *places, True), (view, None, apart, False))]


def _place_skins(result: MatchResult, image: FloatArray) -> tuple[Skin, Skin]:
    """Skins of source and target, whose vertices are at ``image`` (n1, 3): equal colours are equal places."""
    extent, points = matched_source_vertices(result), (result.source.vertices, image)
    of_source, of_target = (Skin(vertex_colors=position_colors(at, extent)) for at in points)
    return of_source, of_target


def draw_thumbnail(result: MatchResult) -> Image:
    """One small picture of a map: source left, target right; equal colours correspond."""
    models = _model_pair(result, choose_viewpoints(result))
    (figure,) = _draw_figures(models, [(FRONT, *_place_skins(result, result.image()), False)], THUMBNAIL_SIZE)
    return figure.target if figure.source is None else np.hstack([figure.source, figure.target])


def _model_pair(result: MatchResult, viewpoints: Viewpoints) -> _ModelPair:
    target, source = (TexturedSurface.from_level(side.refinement.finest) for side in (result.target, result.source))
    return _ModelPair(
        result,
        target,
        source,
        Model(target.positions @ viewpoints.target.turn, target.triangles),
        Model(source.positions @ viewpoints.source_turn, source.triangles),
        viewpoints,
    )


def _skins(models: _ModelPair, texture: Pixels | None, baked: Pixels | None) -> tuple[str, Skin, Skin]:
    """Appearance (texture, material colours or checker) and the skins of source and target."""
    if texture is not None and models.source.uvs is not None:
        pixels = display_image(texture)
        source_skin = Skin(texture=pixels, corner_uvs=models.source.corner_uvs())
        if baked is not None and models.target.uvs is not None:
            return "texture", source_skin, Skin(texture=display_image(baked), corner_uvs=models.target.corner_uvs())
        corners = models.source.corner_uvs()[models.result.triangle]
        places = np.einsum("nc,ncd->nd", models.result.barycentric, corners)
        return "texture", source_skin, Skin(vertex_colors=sample_texture(pixels, places)[:, :3])
    control = models.result.source.control
    colors_of_faces = np.zeros((1, 3)) if control.face_colors is None else face_colors(control)
    if np.ptp(colors_of_faces, axis=0).any():  # a single colour shows nothing
        parents = models.source.face_parents[models.source.triangle_faces]
        colors = encode_srgb(colors_of_faces[parents])
        return "material colours", Skin(face_colors=colors), Skin(vertex_colors=colors[models.result.triangle])
    extent = matched_source_vertices(models.result)
    source_checker = _checker(models.result.source.vertices, extent)
    target_checker = _checker(models.result.image(), extent)
    return "checker", Skin(vertex_colors=source_checker), Skin(vertex_colors=target_checker)


def _checker(points: FloatArray, reference: FloatArray) -> FloatArray:
    """(n, 3) colours of a three-dimensional checker."""
    size = float(np.ptp(reference, axis=0).max()) or 1.0  # of one vertex
    cells = np.floor((points - reference.min(0)) * (STILL_CHECKER_CELLS / size)).astype(np.int64)
    odd = (cells.sum(1) % 2 == 1)[:, None]
    return np.where(odd, np.array([0.20, 0.45, 0.55]), np.array([0.93, 0.90, 0.84]))


def display_image(image: Pixels, *, is_data: bool = False) -> FloatArray:
    """(h, w, 3) sRGB in [0, 1], at most 2048 texels a side, always three channels.

    Float images are linear colours and are encoded as sRGB; with ``is_data`` they are shown unchanged.
    """
    pixels = np.asarray(image)
    if np.issubdtype(pixels.dtype, np.integer):
        scale = 1.0 / np.iinfo(pixels.dtype).max
    else:
        scale = 1.0
    pixels = pixels.reshape(*pixels.shape[:2], -1)
    pixels = pixels[..., :3] if pixels.shape[2] >= 3 else np.repeat(pixels[..., :1], 3, axis=2)
    step = max(1, -(-max(pixels.shape[:2]) // MAX_TEXTURE_SIZE))
    height, width = (length // step * step for length in pixels.shape[:2])
    blocks = pixels[:height, :width].reshape(height // step, step, width // step, step, 3)
    shown = blocks.mean(axis=(1, 3), dtype=np.float32) * np.float32(scale)
    is_linear = pixels.dtype.kind == "f" and not is_data
    return encode_srgb(shown).astype(np.float32) if is_linear else np.clip(shown, 0.0, 1.0)


# View, skin of the source, skin of the target, whether landmarks and curves are drawn.
_FigureJob = tuple[View, Skin | None, Skin, bool]


def _draw_figures(
    models: _ModelPair, jobs: list[_FigureJob], size: tuple[int, int], progress: Progress | None = None
) -> tuple[Figure, ...]:
    """Draw figures; all skins of a surface in one view together."""
    groups: dict[tuple[bool, View], list[int]] = {}
    for number, (view, source_skin, _, _) in enumerate(jobs):
        for is_source in (False,) if source_skin is None else (True, False):
            groups.setdefault((is_source, view), []).append(number)
    overlays = {is_source: _make_overlay(models, is_source=is_source) for is_source in (True, False)}
    pictures: dict[tuple[bool, int], Image] = {}
    n_pictures = sum(map(len, groups.values()))

    def draw(group: tuple[bool, View]) -> list[Image]:
        is_source, view = group
        model = models.source_model if is_source else models.target_model
        group_jobs = [jobs[number] for number in groups[group]]
        skins = [skin for _, *skins, _ in group_jobs if (skin := skins[0 if is_source else 1]) is not None]
        camera = frame(model.positions, view, aspect=size[0] / size[1])
        images = render_skins(model, skins, camera, size, background=BACKGROUND)
        return [
            overlays[is_source].draw_on(image, model, camera) if has_overlay else image
            for image, (*_, has_overlay) in zip(images, group_jobs, strict=True)
        ]

    # NumPy and Embree release the interpreter lock, so two threads draw nearly twice as fast.
    with ThreadPool(2) as pool:
        for (is_source, view), images in zip(groups, pool.map(draw, groups), strict=True):
            for number, image in zip(groups[is_source, view], images, strict=True):
                pictures[is_source, number] = image
                if progress is not None:
                    progress(f"picture {len(pictures)} of {n_pictures}")
    return tuple(
        Figure(view.name, pictures.get((True, number)), pictures[False, number])
        for number, (view, *_) in enumerate(jobs)
    )


@dataclass(frozen=True, eq=False)
class _Overlay:
    """Landmarks and curves on a picture."""

    dots: FloatArray
    curves: tuple[Polyline, ...]

    def draw_on(self, image: Image, model: Model, camera: Camera) -> Image:
        """A copy of the image with the visible landmarks and curves drawn on it."""
        for line, color in zip(self.curves, distinct_colors(len(self.curves)), strict=True):
            image = draw_line(image, model, camera, line, color)
        return draw_dots(image, model, camera, self.dots, distinct_colors(len(self.dots)), radius=5.0)


def _make_overlay(models: _ModelPair, *, is_source: bool) -> _Overlay:
    pairs, viewpoints = models.result.landmarks, models.viewpoints
    surface, points, cage_curves, turn = (
        (models.result.source, pairs.source_points, [pair.source for pair in pairs.curves], viewpoints.source_turn)
        if is_source
        else (models.result.target, pairs.target_points, [pair.target for pair in pairs.curves], viewpoints.target.turn)
    )
    finest = surface.finest_triangles
    lines = [surface_curve(surface, curve).line for curve in cage_curves]
    curves = tuple(Polyline(line.positions @ turn / finest.scale, line.closed) for line in lines)
    return _Overlay(surface.vertices[points.heaviest_corners] @ turn, curves)
