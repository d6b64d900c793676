"""Spectral descriptors and self-symmetry operators, in the spectral domain."""

from cagemap.descriptors.mirrors import Mirror, mirror_symmetries
from cagemap.descriptors.multiplication import multiplication_operator
from cagemap.descriptors.spectral import (
    Filters,
    choose_filters,
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
    propagate_symmetry,
    sends_faces_to_faces,
    symmetry_at,
    symmetry_operator,
)

__all__ = [
    "Filters",
    "Mirror",
    "check_symmetry",
    "choose_filters",
    "heat_filters",
    "heat_times",
    "landmark_descriptors",
    "mirror_symmetries",
    "multiplication_operator",
    "normalise_columns",
    "propagate_symmetry",
    "sends_faces_to_faces",
    "signatures",
    "symmetry_at",
    "symmetry_operator",
    "wave_energies",
    "wave_filters",
]
