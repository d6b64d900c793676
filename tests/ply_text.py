"""PLY files as text, which the product reads and does not write."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cagemap.mesh import ControlMesh


def write_text_ply(path: Path, mesh: ControlMesh) -> None:
    """Write positions, vertex colours as bytes, polygons and their corners' UVs, a line each."""
    colors, uvs = mesh.vertex_colors, mesh.uvs
    head = ["ply", "format ascii 1.0", f"element vertex {mesh.n_vertices}"]
    head += [f"property double {axis}" for axis in "xyz"]
    head += [f"property uchar {color}" for color in ("red", "green", "blue")] if colors is not None else []
    head += [f"element face {mesh.n_faces}", "property list uint int vertex_indices"]
    head += ["property list uint double texcoord"] if uvs is not None else []
    shades = np.zeros((mesh.n_vertices, 0)) if colors is None else np.rint(255 * colors.clip(0, 1)).astype(int)
    rows = [[*place, *shade] for place, shade in zip(mesh.positions.tolist(), shades.tolist(), strict=True)]
    for face in range(mesh.n_faces):
        corners = slice(mesh.face_offsets[face], mesh.face_offsets[face + 1])
        row = [int(mesh.face_sizes[face]), *mesh.face_indices[corners].tolist()]
        if uvs is not None and mesh.uv_indices is not None:
            flat = uvs[mesh.uv_indices[corners]].ravel().tolist()
            row += [len(flat), *flat]
        rows.append(row)
    lines = [" ".join(map(repr, row)) for row in rows]
    path.write_text("\n".join([*head, "end_header", *lines]) + "\n")
