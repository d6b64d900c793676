"""Mass and stiffness of a surface, and their restriction to every level (SEC)."""

from cagemap.operators.laplacian import (
    LAPLACIANS,
    AlexaWardetzky,
    DeGoesButtsDesbrun,
    Laplacian,
    MeanTriangulation,
    Operators,
    build_operators,
    lumped_areas,
    named_laplacian,
    stiffness,
    vertex_areas,
)

__all__ = [
    "LAPLACIANS",
    "AlexaWardetzky",
    "DeGoesButtsDesbrun",
    "Laplacian",
    "MeanTriangulation",
    "Operators",
    "build_operators",
    "lumped_areas",
    "named_laplacian",
    "stiffness",
    "vertex_areas",
]
