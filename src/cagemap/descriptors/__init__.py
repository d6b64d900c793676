"""Spectral descriptors and self-symmetry operators, in the spectral domain."""

from cagemap.descriptors.spectral import (
    heat_filters,
    heat_times,
    landmark_descriptors,
    normalise_columns,
    signatures,
    wave_energies,
    wave_filters,
)
from cagemap.descriptors.symmetry import (
    check_symmetry,
    detect_mirror_symmetry,
    propagate_symmetry,
    symmetry_operator,
)

__all__ = [
    "check_symmetry",
    "detect_mirror_symmetry",
    "heat_filters",
    "heat_times",
    "landmark_descriptors",
    "normalise_columns",
    "propagate_symmetry",
    "signatures",
    "symmetry_operator",
    "wave_energies",
    "wave_filters",
]
