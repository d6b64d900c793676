"""Subdivision: refined levels, and the matrices between them."""

from cagemap.subdivision.refinement import Level as Level
from cagemap.subdivision.refinement import Refinement as Refinement
from cagemap.subdivision.refinement import default_scheme as default_scheme
from cagemap.subdivision.refinement import finest_mesh as finest_mesh
from cagemap.subdivision.refinement import level_triangles as level_triangles
from cagemap.subdivision.refinement import refine as refine
from cagemap.subdivision.refinement import triangles as triangles
from cagemap.subdivision.refinement import with_options as with_options
