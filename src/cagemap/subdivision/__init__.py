"""Subdivision: refined levels, the matrices between them, and limit positions and normals."""

from cagemap.subdivision.limit import limit_matrix as limit_matrix
from cagemap.subdivision.limit import limit_normals as limit_normals
from cagemap.subdivision.limit import limit_positions as limit_positions
from cagemap.subdivision.refinement import Level as Level
from cagemap.subdivision.refinement import Refinement as Refinement
from cagemap.subdivision.refinement import default_scheme as default_scheme
from cagemap.subdivision.refinement import finest_mesh as finest_mesh
from cagemap.subdivision.refinement import level_triangles as level_triangles
from cagemap.subdivision.refinement import refine as refine
from cagemap.subdivision.refinement import triangles as triangles
from cagemap.subdivision.refinement import with_options as with_options
