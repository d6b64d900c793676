"""Mass and stiffness of a surface, and their restriction to every level (SEC)."""

from cagemap.operators.laplacian import LAPLACIANS as LAPLACIANS
from cagemap.operators.laplacian import Laplacian as Laplacian
from cagemap.operators.laplacian import Operators as Operators
from cagemap.operators.laplacian import build_operators as build_operators
from cagemap.operators.laplacian import lumped_areas as lumped_areas
from cagemap.operators.laplacian import named_laplacian as named_laplacian
from cagemap.operators.laplacian import stiffness as stiffness
from cagemap.operators.laplacian import vertex_areas as vertex_areas
