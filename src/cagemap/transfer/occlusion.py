"""Ambient occlusion at vertices: the visible share of the cosine-weighted hemisphere."""

from __future__ import annotations

import numpy as np

from cagemap.errors import ParameterError
from cagemap.numerics.arrays import FloatArray
from cagemap.numerics.libraries import library
from cagemap.surface.triangle_surface import TriangleSurface
from cagemap.transfer.tangents import plane_basis

# Rays start so far above the surface, in units of sqrt(area): Embree computes in single precision.
_LIFT = 1e-4
# Rays at a time: 40 bytes each.
_RAYS_AT_ONCE = 1 << 20
# Golden ratio: angle between directions of one vertex, and between the patterns of two vertices (no pattern shows).
_GOLDEN = 0.618033988749895


def ambient_occlusion(surface: TriangleSurface, rays: int = 128) -> FloatArray:
    """(n,) visible share of the cosine-weighted hemisphere over every vertex, from 0 to 1.

    ``rays``: over each vertex; the same places of the sky in every run.
    """
    if rays < 1:
        raise ParameterError(f"occlusion: expected 1 ray or more, got {rays}")
    scene = library("embreex.rtcore_scene", "ambient occlusion").EmbreeScene()
    middle = surface.positions.mean(axis=0)
    places = surface.positions - middle
    meshes = library("embreex.mesh_construction", "ambient occlusion")
    meshes.TriangleMesh(scene, places.astype(np.float32), surface.triangles.astype(np.int32))
    normals = surface.vertex_normals
    sky = _sky(rays)
    open_part = np.empty(surface.n)
    step = max(1, _RAYS_AT_ONCE // rays)
    for begin in range(0, surface.n, step):
        part = slice(begin, min(surface.n, begin + step))
        basis = plane_basis(normals[part], np.broadcast_to([1.0, 0.0, 0.0], normals[part].shape))
        angle = 2 * np.pi * ((np.arange(part.start, part.stop) * _GOLDEN) % 1.0)
        cosine, sine = np.cos(angle)[:, None], np.sin(angle)[:, None]
        across = basis[:, :, 0] * cosine + basis[:, :, 1] * sine
        along = basis[:, :, 1] * cosine - basis[:, :, 0] * sine
        frames = np.stack([across, along, normals[part]], axis=1)  # rows
        directions = np.einsum("rk,nkd->nrd", sky, frames).reshape(-1, 3).astype(np.float32)
        origins = np.repeat(places[part] + _LIFT * normals[part], rays, axis=0).astype(np.float32)
        hidden = np.asarray(scene.run(origins, directions, query="OCCLUDED")) >= 0
        open_part[part] = 1.0 - hidden.reshape(-1, rays).mean(axis=1)
    return open_part


def _sky(rays: int) -> FloatArray:
    """(rays, 3) directions about the axis z, as dense as their cosine: a sunflower on the disk, lifted up."""
    index = np.arange(rays) + 0.5
    squared_radius = index / rays
    angle = 2 * np.pi * _GOLDEN * index
    radius = np.sqrt(squared_radius)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1.0 - squared_radius)])
