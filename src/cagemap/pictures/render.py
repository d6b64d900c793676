"""Off-screen rendering: ray casting with Embree, shading with NumPy.

Lights: a sky of fixed directions (pictures are noise-free and repeatable), a key light from the upper left, and a weak
light at the eye. A floor shows the contact shadow.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates, maximum_filter, minimum_filter

from cagemap.errors import ParameterError
from cagemap.numerics.arrays import FloatArray, IndexArray, decode_srgb, encode_srgb
from cagemap.numerics.process import import_library
from cagemap.numerics.threads import kept
from cagemap.pictures.camera import Camera
from cagemap.pictures.textures import sample_texture
from cagemap.surface.triangles import vertex_normals

Image = NDArray[np.uint8]
DEFAULT_COLOR = np.array([0.80, 0.78, 0.75])
WHITE = np.ones(3)
FLOOR_REACH, FLOOR_CELLS = 0.9, 141  # half a side, of the model's size; grid points a side
SKY_DIRECTIONS, FLOOR_SKY_DIRECTIONS = 36, 80
MIN_NORMAL_AGREEMENT = 0.97  # cosine below which the sky's light is not interpolated between pixels
MIN_REFINED_CONTRAST = 0.06  # pixels with more contrast get several rays


@dataclass(frozen=True, eq=False)
class Skin:
    """Colours of a surface: texture, else vertex colours, else face colours, else clay.

    Attributes
    ----------
    vertex_colors : (n, 3) sRGB in [0, 1] or None
    face_colors : (t, 3) sRGB in [0, 1] or None
        One per triangle.
    texture : (H, W, 3) or (H, W, 4) sRGB in [0, 1] or None
        Row 0 is the top: row = (1 - v) H. Alpha is ignored.
    corner_uvs : (t, 3, 2) float64 or None
        UV of every corner of every triangle.
    """

    vertex_colors: FloatArray | None = None
    face_colors: FloatArray | None = None
    texture: FloatArray | None = None
    corner_uvs: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class Model:
    """A triangulated surface for ray casting; reuse it for several views.

    Attributes
    ----------
    positions : (n, 3) float64
    triangles : (t, 3) int64
    """

    positions: FloatArray
    triangles: IndexArray

    def __post_init__(self) -> None:
        """Raise if there are no triangles."""
        if self.triangles.ndim != 2 or self.triangles.shape[1:] != (3,) or len(self.triangles) == 0:
            raise ParameterError(
                f"Model: expected triangles (t, 3) with t > 0, got {self.triangles.shape}. "
                "Split quads with cagemap.subdivision.triangles first."
            )

    @kept
    def scale(self) -> float:
        """Longest side of the bounding box."""
        return float(np.ptp(self.positions, axis=0).max()) or 1.0

    @kept
    def centre(self) -> FloatArray:
        """(3,) middle of the bounding box."""
        return np.asarray((self.positions.min(0) + self.positions.max(0)) / 2)

    @kept
    def scene(self) -> Any:
        """Embree's tree of the positions in a unit box; Embree computes in single precision."""
        scene = import_library("embreex.rtcore_scene", "pictures").EmbreeScene()
        unit = ((self.positions - self.centre) / self.scale).astype(np.float32)
        import_library("embreex.mesh_construction", "pictures").TriangleMesh(
            scene, unit, self.triangles.astype(np.int32)
        )
        return scene

    @kept
    def normals(self) -> FloatArray:
        """(n, 3) unit vertex normals, face normals weighted by area."""
        return vertex_normals(self.positions, self.triangles)

    @kept
    def floor_shadow(self) -> FloatArray:
        """(cells, cells) share of the sky hidden from floor points; 0 at the border."""
        reach = np.linspace(-FLOOR_REACH, FLOOR_REACH, FLOOR_CELLS)
        x, z = np.meshgrid(reach, reach, indexing="ij")
        points = np.stack([x.ravel(), np.zeros(x.size), z.ravel()], axis=1) * self.scale
        points += [self.centre[0], float(self.positions[:, 1].min()), self.centre[2]]
        up = np.tile([0.0, 1.0, 0.0], (len(points), 1))
        sky = _sky(FLOOR_SKY_DIRECTIONS)
        height = np.maximum(sky[:, 1], 0.0)
        unhidden = float(np.sum(height * (0.62 + 0.38 * height)) / np.sum(height))
        shadow = np.clip(1.0 - _openness(self, points, up, sky) / unhidden, 0.0, 1.0).reshape(x.shape)
        return shadow * np.clip((FLOOR_REACH - np.hypot(x, z)) / 0.3, 0.0, 1.0)


def render(
    model: Model,
    skin: Skin,
    camera: Camera,
    *,
    width: int = 800,
    height: int = 600,
    samples: int = 2,
    background: FloatArray = WHITE,
    floor: bool = True,
) -> Image:
    """Draw a surface.

    Parameters
    ----------
    camera : Camera
        From ``frame``.
    samples : int
        Rays per pixel along each axis, for pixels with contrast; 2 or 3 for smooth edges.
    background : (3,) sRGB
    floor : bool
        Whether to draw the shadow on a floor.

    Returns
    -------
    (height, width, 3) uint8
        Row 0 is the top.
    """
    size = width, height
    return next(render_skins(model, [skin], camera, size, samples=samples, background=background, floor=floor))


def render_skins(
    model: Model,
    skins: Sequence[Skin],
    camera: Camera,
    size: tuple[int, int],
    *,
    samples: int = 2,
    background: FloatArray = WHITE,
    floor: bool = True,
) -> Iterator[Image]:
    """Draw a surface in several skins; the sky's light is computed once. See `render`.

    ``size``: width and height.
    """
    for skin in skins:
        _check_skin(model, skin)
    width, height = size
    scene = _Scene(model, camera, decode_srgb(background), floor)
    seen = _cast_eye_rays(scene, camera.rays(width, height), size=(height, width))
    # Sky light varies slowly: additional rays reuse that of the pixel or of a neighbour.
    neighbor_openness = maximum_filter(seen.openness.reshape(height, width), 3).ravel()
    openness = np.where(seen.openness < 0, neighbor_openness, seen.openness)
    for skin in skins:
        colors = encode_srgb(seen.radiance(scene, skin))
        image, around = colors.reshape(height, width, 3), (3, 3, 1)
        contrast = (maximum_filter(image, around) - minimum_filter(image, around)).max(axis=2)
        refined = np.flatnonzero(contrast > MIN_REFINED_CONTRAST)
        if samples > 1 and len(refined):
            light = np.zeros((len(refined), 3))
            for row, column in np.ndindex(samples, samples):
                offset = ((column + 0.5) / samples, (row + 0.5) / samples)
                rays = camera.rays(width, height, offset)[refined]
                light += _cast_eye_rays(scene, rays, openness=openness[refined]).radiance(scene, skin)
            colors[refined] = encode_srgb(light / samples**2)
        yield np.round(colors * 255).astype(np.uint8).reshape(height, width, 3)


def visible_points(model: Model, camera: Camera, points: FloatArray) -> NDArray[np.bool_]:
    """(p,) whether the camera sees points (p, 3) of the surface."""
    towards = points - camera.eye
    distance = np.linalg.norm(towards, axis=1)
    hit = _cast(model, _to_unit(model, camera.eye), towards / distance[:, None])
    return np.asarray(hit["tfar"].astype(np.float64) * model.scale > distance - 0.01 * model.scale)


@dataclass(frozen=True, eq=False)
class _Scene:
    """Everything that the light along a ray depends on, except the skin."""

    model: Model
    camera: Camera
    background: FloatArray
    floor: bool


def _check_skin(model: Model, skin: Skin) -> None:
    expected = {
        "vertex_colors": (len(model.positions), 3),
        "face_colors": (len(model.triangles), 3),
        "corner_uvs": (len(model.triangles), 3, 2),
    }
    for name, shape in expected.items():
        array = getattr(skin, name)
        if array is not None and array.shape != shape:
            raise ParameterError(f"Skin.{name}: expected shape {shape} for this model, got {array.shape}.")
    if (skin.texture is None) != (skin.corner_uvs is None):
        raise ParameterError("Skin: texture and corner_uvs go together; give both or neither.")


def _to_unit(model: Model, points: FloatArray) -> FloatArray:
    """Points in the coordinates of the scene's unit box."""
    return (points - model.centre) / model.scale


def _cast(model: Model, origins: NDArray[Any], directions: FloatArray) -> dict[str, NDArray[Any]]:
    """First hits of rays from origins in the unit box; ``tfar`` multiplies the directions."""
    starts = np.broadcast_to(origins, directions.shape)
    hits: dict[str, NDArray[Any]] = model.scene.run(
        np.ascontiguousarray(starts, np.float32), np.ascontiguousarray(directions, np.float32), output=1
    )
    return hits


@dataclass(frozen=True, eq=False)
class _EyeRays:
    """Hits of eye rays and the light on them."""

    background: FloatArray  # (r, 3) linear light where nothing is hit
    rows: IndexArray  # (h,) rays that hit the surface
    triangle: IndexArray  # (h,)
    corner: FloatArray  # (h, 3) barycentric coordinates
    light: FloatArray  # (h, 3) linear
    openness: FloatArray  # (r,) the sky's share at the hits, -1 without a hit

    def radiance(self, scene: _Scene, skin: Skin) -> FloatArray:
        """(r, 3) linear light along the rays."""
        radiance = self.background.copy()
        radiance[self.rows] = _colors(skin, scene.model, self.triangle, self.corner) * self.light
        return radiance


def _cast_eye_rays(
    scene: _Scene,
    directions: FloatArray,
    *,
    openness: FloatArray | None = None,
    size: tuple[int, int] | None = None,
) -> _EyeRays:
    """Cast rays from the eye; the sky's share of each is given, or computed for an image of size (height, width)."""
    model, camera = scene.model, scene.camera
    hits = _cast(model, _to_unit(model, camera.eye), directions)
    hit_rows = np.flatnonzero(hits["primID"] >= 0)
    triangle = hits["primID"][hit_rows].astype(np.int64)
    corner = np.stack(
        [1.0 - hits["u"][hit_rows] - hits["v"][hit_rows], hits["u"][hit_rows], hits["v"][hit_rows]], axis=1
    )
    # From corners, not from distances: exact in double precision, however far the eye is.
    vertices = model.triangles[triangle]
    points = np.einsum("rc,rcd->rd", corner, model.positions[vertices])
    normals = np.einsum("rc,rcd->rd", corner, model.normals[vertices])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    # Back faces of an open surface are lit as if they faced the eye.
    normals *= np.where(np.einsum("rd,rd->r", normals, directions[hit_rows]) > 0, -1.0, 1.0)[:, None]
    if openness is None:
        assert size is not None
        openness = _pixel_openness(model, points, normals, hit_rows, size)
    background = np.tile(scene.background, (len(directions), 1))
    if scene.floor:
        _shade_floor(model, camera, directions, hits["primID"] < 0, background)
    light = _light(camera, points, normals, np.abs(openness[hit_rows]))
    return _EyeRays(background, hit_rows, triangle, corner, light, openness)


def _colors(skin: Skin, model: Model, triangle: IndexArray, corner: FloatArray) -> FloatArray:
    """(r, 3) linear surface colour at hits."""
    if skin.texture is not None and skin.corner_uvs is not None:
        uv = np.einsum("rc,rcd->rd", corner, skin.corner_uvs[triangle])
        return decode_srgb(sample_texture(skin.texture, uv)[:, :3])
    if skin.vertex_colors is not None:
        return np.einsum("rc,rcd->rd", corner, decode_srgb(skin.vertex_colors[model.triangles[triangle]]))
    if skin.face_colors is not None:
        return decode_srgb(skin.face_colors[triangle])
    return np.tile(decode_srgb(DEFAULT_COLOR), (len(triangle), 1))


def _sky(count: int) -> FloatArray:
    """(count, 3) evenly distributed directions on a Fibonacci spiral."""
    order = np.arange(count) + 0.5
    height = 1.0 - 2.0 * order / count
    angle = 2.39996322973 * order
    ring = np.sqrt(1.0 - height**2)
    return np.stack([ring * np.cos(angle), height, ring * np.sin(angle)], axis=1)


def _pixel_openness(
    model: Model, points: FloatArray, normals: FloatArray, hit_rows: IndexArray, size: tuple[int, int]
) -> FloatArray:
    """(h * w,) the sky's share at the hits of an image's pixels, -1 without a hit.

    Every second pixel of every second row is computed; between them it is interpolated where normals agree.
    """
    height, width = size
    hit = np.full(height * width, -1, dtype=np.int64)
    hit[hit_rows] = np.arange(len(hit_rows))
    coarse = hit.reshape(size)[::2, ::2]
    sampled = coarse[coarse >= 0]
    share = np.empty(len(hit_rows))
    share[sampled] = _openness(model, points[sampled], normals[sampled], _sky(SKY_DIRECTIONS))
    grid = np.zeros((*coarse.shape, 4))
    grid[coarse >= 0] = np.column_stack([share[sampled], normals[sampled]])
    rows = _insert_means(grid, height).swapaxes(0, 1)
    interpolated = _insert_means(rows, width).swapaxes(0, 1).reshape(-1, 4)[hit_rows]
    agree = np.einsum("pd,pd->p", interpolated[:, 1:], normals) > MIN_NORMAL_AGREEMENT
    agree[sampled] = True
    share = np.where(agree, interpolated[:, 0], share)
    rest = np.flatnonzero(~agree)
    share[rest] = _openness(model, points[rest], normals[rest], _sky(SKY_DIRECTIONS))
    openness = np.full(height * width, -1.0)
    openness[hit_rows] = share
    return openness


def _insert_means(grid: FloatArray, length: int) -> FloatArray:
    """(length, ...) rows of a grid, with the means of neighbours between them."""
    rows = np.empty((length, *grid.shape[1:]))
    rows[::2] = grid
    rows[1::2] = ((grid + np.concatenate([grid[1:], grid[-1:]])) / 2)[: length // 2]
    return rows


def _openness(model: Model, points: FloatArray, normals: FloatArray, directions: FloatArray) -> FloatArray:
    """(p,) share of the sky light that reaches points, weighted by cosine and elevation."""
    origins = _to_unit(model, points + normals * (2e-3 * model.scale)).astype(np.float32)
    light, max_light = np.zeros(len(points)), np.full(len(points), 1e-9)
    for direction in directions:
        cosine = normals @ direction
        rows = np.flatnonzero(cosine > 0)
        hits = _cast(model, origins[rows], np.broadcast_to(direction, (len(rows), 3)))
        # Distant parts block less, so that a hand does not darken the belly.
        clear = np.clip(hits["tfar"] / 0.5, 0.0, 1.0)
        light[rows] += cosine[rows] * clear * (0.62 + 0.38 * direction[1])
        max_light[rows] += cosine[rows]
    return light / max_light


def _light(camera: Camera, points: FloatArray, normals: FloatArray, sky: FloatArray) -> FloatArray:
    """(p, 3) linear light at points: sky, wrapped key light, weak light from the eye."""
    key_direction = np.array([-0.45, 0.62, 0.64]) @ camera.axes
    key = np.clip((normals @ key_direction + 0.25) / 1.25, 0.0, None)
    towards = camera.eye - points
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    eye = np.maximum(np.einsum("pd,pd->p", normals, towards), 0.0)
    warm, cool = np.array([1.04, 1.0, 0.94]), np.array([0.95, 0.99, 1.06])
    return 0.70 * sky[:, None] * cool + 0.48 * key[:, None] * warm * (0.35 + 0.65 * sky[:, None]) + 0.10 * eye[:, None]


def _shade_floor(
    model: Model, camera: Camera, directions: FloatArray, is_free: NDArray[np.bool_], radiance: FloatArray
) -> None:
    """Darken the background in place where the floor sees less sky."""
    ground = float(model.positions[:, 1].min())
    if camera.eye[1] <= ground:
        return
    rows = np.flatnonzero(is_free & (directions[:, 1] < -1e-6))
    distance = (ground - camera.eye[1]) / directions[rows, 1]
    points = camera.eye[[0, 2]] + directions[rows][:, [0, 2]] * distance[:, None]
    # Grid coordinates of `floor_shadow`, whose border is 0.
    grid = ((points - model.centre[[0, 2]]) / (2 * FLOOR_REACH * model.scale) + 0.5) * (FLOOR_CELLS - 1)
    on_grid = np.flatnonzero(((grid > 0) & (grid < FLOOR_CELLS - 1)).all(1))
    shadow = map_coordinates(model.floor_shadow, grid[on_grid].T, order=1)
    radiance[rows[on_grid]] *= (1.0 - 0.55 * shadow)[:, None]
