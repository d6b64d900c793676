"""Pull textures, displacement and attributes back from source to target through the point map."""

from cagemap.transfer.attributes import bake_face_colors as bake_face_colors
from cagemap.transfer.attributes import face_colors as face_colors
from cagemap.transfer.attributes import pull_back_faces as pull_back_faces
from cagemap.transfer.baking import BakeOptions as BakeOptions
from cagemap.transfer.baking import Transfer as Transfer
from cagemap.transfer.baking import bake_texture as bake_texture
from cagemap.transfer.baking import prepare_transfer as prepare_transfer
from cagemap.transfer.baking import target_tiles as target_tiles
from cagemap.transfer.control_values import carry_uvs as carry_uvs
from cagemap.transfer.control_values import combine as combine
from cagemap.transfer.control_values import control_weights as control_weights
from cagemap.transfer.control_values import corner_weights as corner_weights
from cagemap.transfer.detail import Detail as Detail
from cagemap.transfer.detail import bake_detail_heights as bake_detail_heights
from cagemap.transfer.detail import bake_detail_normals as bake_detail_normals
from cagemap.transfer.detail import bake_detail_texture as bake_detail_texture
from cagemap.transfer.detail import bake_detail_values as bake_detail_values
from cagemap.transfer.detail import bake_detail_vectors as bake_detail_vectors
from cagemap.transfer.detail import detail_over as detail_over
from cagemap.transfer.detail import own_transfer as own_transfer
from cagemap.transfer.displacement import bake_displacement as bake_displacement
from cagemap.transfer.matched import bake as bake
from cagemap.transfer.matched import transfer_of as transfer_of
from cagemap.transfer.texture import tile_cells as tile_cells
from cagemap.transfer.unwrap import unwrap as unwrap
