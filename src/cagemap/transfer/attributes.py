"""Pull face values back from source to target; bake material colours as an image."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from cagemap.errors import ParameterError
from cagemap.mesh import ControlMesh
from cagemap.mesh.control_mesh import UNKNOWN_COLOR
from cagemap.numerics.arrays import FloatArray, IndexArray, encode_srgb, grouped_sums
from cagemap.surface.triangles import triangle_areas
from cagemap.transfer.baking import Bake, BakeOptions, Transfer, make_layout, single_samples, unit
from cagemap.transfer.locate import TexelSamples, locate_centers
from cagemap.transfer.texture import Pixels

# Samples along a texel's side at borders of materials: 16 levels between two colours.
_EDGE_SAMPLES = 4


def pull_back_faces(transfer: Transfer, values: NDArray[Any], *, n_target_faces: int | None = None) -> NDArray[Any]:
    """Pull values of the source's control faces back to the target's control faces.

    Each refined target triangle takes the value at its centre's image. A control face takes the area-weighted mean of
    its triangles' values. Integers (materials, groups), or rows of them, are labels: the one with the largest area is
    taken.

    ``values`` (m2,) or (m2, q) are at the source's control faces; a ParameterError refuses other numbers of rows.
    ``n_target_faces`` is by default the number of control faces of the target's level. Returns (m1,) or (m1, q), of the
    same kind.
    """
    values = np.asarray(values)
    _require_rows(values, transfer)
    source, target = transfer.source, transfer.target
    hits = source.face_parents[source.triangle_faces[locate_centers(transfer.mapped)]]
    faces = target.face_parents[target.triangle_faces]
    areas = triangle_areas(target.positions, target.triangles)
    n_faces = n_target_faces or int(faces.max()) + 1
    totals = np.bincount(faces, areas, minlength=n_faces)
    areas = np.where(totals[faces] > 0, areas, 1.0)  # the triangles of a face without area count alike
    if values.dtype.kind in "iub":
        distinct, number = np.unique(values, axis=0, return_inverse=True)
        return distinct[largest_share(faces, number.ravel()[hits], areas, n_faces)]
    columns = values[hits].reshape(len(hits), -1)
    totals = np.bincount(faces, areas, minlength=n_faces)
    means = grouped_sums(faces, areas[:, None] * columns, n_faces) / np.where(totals > 0, totals, 1.0)[:, None]
    return means.reshape(n_faces, *values.shape[1:])


def largest_share(owners: IndexArray, labels: NDArray[Any], shares: FloatArray, count: int) -> NDArray[Any]:
    """(count,) label with the largest share of every owner; the smaller label if two shares are equal."""
    distinct, number = np.unique(labels, return_inverse=True)
    keys, inverse = np.unique(owners * len(distinct) + number, return_inverse=True)
    weight = np.bincount(inverse, shares)
    order = np.lexsort((keys, -weight, keys // len(distinct)))
    owners, first = np.unique(keys[order] // len(distinct), return_index=True)
    result = np.full(count, distinct[0], dtype=labels.dtype)
    result[owners] = distinct[keys[order][first] % len(distinct)]
    return result


def face_colors(control: ControlMesh) -> FloatArray:
    """(m, 3) linear RGB colour of every control face by its material; grey for materials without a colour."""
    colors = control.face_colors
    if colors is None:
        raise ParameterError(
            f"{control.name}: expected materials with colours, found none; check that the .mtl lies beside the .obj"
        )
    return np.where(np.isfinite(colors), colors, UNKNOWN_COLOR)


def bake_face_colors(
    transfer: Transfer,
    colors: FloatArray,
    *,
    size: int | tuple[int, int],
    dtype: DTypeLike = np.uint8,
    options: BakeOptions | None = None,
) -> Pixels:
    """Bake colours of the source's control faces into the target's layout, with antialiased edges.

    Texels that a boundary between two colours may cross take 4 x 4 samples, averaged in linear light. With the filter
    "nearest" all texels take one, so that colours are not mixed.

    ``colors`` (m2, 3) are linear RGB of the source's control faces. Integers of ``dtype`` are encoded as sRGB, floats
    stay linear. ``size`` and ``options`` are as in `bake_texture`. ParameterError if there is not one row a source
    face, or the target has no texture coordinates.
    """
    options, kept = options or BakeOptions(), np.dtype(dtype)
    table = np.asarray(colors, dtype=np.float64)
    _require_rows(table, transfer)
    source = transfer.source
    _, label_of_face = np.unique(table, axis=0, return_inverse=True)
    parents = source.face_parents[source.triangle_faces]
    layout = make_layout(transfer, size, options)
    mixed = _mixed_triangles(transfer, label_of_face.ravel()[parents])
    edge_samples = 1 if options.filter == "nearest" else max(1, -(-_EDGE_SAMPLES // layout.supersample))
    counts = single_samples(transfer)
    counts[mixed] = edge_samples

    def shade(samples: TexelSamples) -> FloatArray:
        return samples.mean(table[parents[samples.triangle]])

    def encode(linear: FloatArray) -> FloatArray:
        return encode_srgb(linear) * unit(kept) if kept.kind == "u" else linear

    return Bake(transfer, layout, options, kept, counts).run(shade, table.shape[1], encode)


def _mixed_triangles(transfer: Transfer, labels: IndexArray) -> NDArray[np.bool_]:
    """(t1,) whether a boundary between source labels may cross a target triangle.

    A band as wide as a target triangle's image is grown around the boundaries, over the source's triangles.
    """
    neighbors = transfer.mapped.neighbors
    across = np.where(neighbors >= 0, labels[neighbors], labels[:, None])
    near = (across != labels[:, None]).any(axis=1)
    image_area = triangle_areas(transfer.mapped.mapped, transfer.target.triangles).mean()
    source_area = triangle_areas(transfer.source.positions, transfer.source.triangles).mean()
    for _ in range(2 + int(np.ceil(2 * np.sqrt(image_area / source_area)))):
        near = near | (np.where(neighbors >= 0, near[neighbors], False)).any(axis=1)
    start = transfer.mapped.start_triangles[transfer.target.triangles]
    return near[start].any(axis=1) | (labels[start] != labels[start][:, :1]).any(axis=1)


def _require_rows(values: NDArray[Any], transfer: Transfer) -> None:
    rows = int(transfer.source.face_parents.max()) + 1
    if len(values) != rows:
        raise ParameterError(f"expected {rows} rows, one for every control face of the source, got {len(values)}")
