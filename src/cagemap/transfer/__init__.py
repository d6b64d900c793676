"""Pull textures, displacement and attributes back from source to target through the point map."""

from cagemap.transfer.attributes import bake_face_colors, face_colors, pull_back_faces
from cagemap.transfer.baking import BakeOptions, Transfer, bake_texture, prepare_transfer, target_tiles
from cagemap.transfer.control_values import (
    CarriedUvs,
    carry_uvs,
    combine,
    control_weights,
    corner_nodes,
    corner_weights,
)
from cagemap.transfer.detail import (
    Detail,
    bake_detail_heights,
    bake_detail_normals,
    bake_detail_texture,
    bake_detail_values,
    bake_detail_vectors,
    detail_over,
    own_transfer,
)
from cagemap.transfer.displacement import Displacement, bake_displacement, scale_ratio
from cagemap.transfer.matched import bake, transfer_of
from cagemap.transfer.texture import tile_cells
from cagemap.transfer.unwrap import unwrap

__all__ = [
    "BakeOptions",
    "CarriedUvs",
    "Detail",
    "Displacement",
    "Transfer",
    "bake",
    "bake_detail_heights",
    "bake_detail_normals",
    "bake_detail_texture",
    "bake_detail_values",
    "bake_detail_vectors",
    "bake_displacement",
    "bake_face_colors",
    "bake_texture",
    "carry_uvs",
    "combine",
    "control_weights",
    "corner_nodes",
    "corner_weights",
    "detail_over",
    "face_colors",
    "own_transfer",
    "prepare_transfer",
    "pull_back_faces",
    "scale_ratio",
    "target_tiles",
    "tile_cells",
    "transfer_of",
    "unwrap",
]
