"""Descriptors and operators of a pair, gathered once for all levels (paper, sections 5.1 and 5.2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from cagemap.basis import Surface
from cagemap.descriptors import (
    Filters,
    Mirror,
    check_symmetry,
    choose_filters,
    landmark_descriptors,
    mirror_symmetries,
    multiplication_operator,
    normalise_columns,
    signatures,
    symmetry_at,
    symmetry_operator,
)
from cagemap.errors import ParameterError
from cagemap.functional_map import Constraints, SpectralData
from cagemap.maps.curves import SurfaceCurve
from cagemap.maps.pair import Pair, SymmetryPair
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.brief import Brief
from cagemap.numerics.threads import in_threads

# Share of landmarks that two planes must take to the same landmarks.
AGREEMENT = 0.5


@dataclass(frozen=True, repr=False)
class DescriptorConfig(Brief):
    """Which descriptors are asked for; the defaults are the measured ones.

    Attributes
    ----------
    heat, wave : int
        Filters of each kind, for landmarks and signatures alike.
    signature_weight : float
        Norm of a signature beside a landmark kernel's of 1; 0 leaves signatures out.
    products : int
        Descriptors, chosen at equal steps among all, whose multiplication the map shall commute with [NO17]; 0 for
        none. Each is a dense operator.
    product_weight : float
        Norm of a multiplication beside that of a self-symmetry.
    """

    heat: int = 10
    wave: int = 20
    signature_weight: float = 3.0
    products: int = 0
    product_weight: float = 3.0

    def __post_init__(self) -> None:
        """Check the ranges."""
        for name in ("signature_weight", "product_weight"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0.0):
                raise ParameterError(f"{name}: expected at least 0, got {value}")
        if self.products < 0:
            raise ParameterError(f"products: expected 0 or more descriptors, got {self.products}")


def gather_constraints(pair: Pair, config: DescriptorConfig = DescriptorConfig()) -> Constraints:
    """F~ and O~ of both surfaces on their whole bases.

    Filters are chosen and columns scaled here, once: the descriptors F~^l of a coarser level are the leading rows, and
    one weight of an operator means the same on all levels (eqs. 13-16).
    """
    filters = choose_filters(pair.target.basis.eigenvalues, pair.source.basis.eigenvalues, config.heat, config.wave)
    curves = [one.target for one in pair.landmarks.curves], [one.source for one in pair.landmarks.curves]
    sides = [
        (pair.target, pair.target_landmarks, curves[0], tuple(target for target, _ in pair.symmetries)),
        (pair.source, pair.source_landmarks, curves[1], tuple(source for _, source in pair.symmetries)),
    ]
    made = in_threads(lambda side: _spectral_data(*side, filters, config), sides)
    return Constraints(*made)


def eigenvalues(surface: Surface, level: int) -> FloatArray:
    """Lambda~ of a level."""
    return surface.basis.eigenvalues[: surface.basis.size(level)]


def signature_functions(surface: Surface, filters: Filters, level: int) -> FloatArray:
    """Signatures diag(Phi~ rho_t(Lambda~) Phi~^T) at the vertices of a level (Definition 3); (n_level, q)."""
    at_eigenvalues = filters.at(eigenvalues(surface, level))
    values = np.empty((surface.refinement.levels[level].n_vertices, at_eigenvalues.shape[1]))
    for part, block in surface.basis.row_blocks(level):
        values[part] = signatures(block, at_eigenvalues)
    return values


def curve_rows(surface: Surface, curves: Sequence[SurfaceCurve]) -> FloatArray:
    """Basis rows of whole curves, (q, k): the mean of Phi~(v, :) along each, by length.

    With them a landmark descriptor becomes the heat or wave that starts from all of the curve at once, whatever its
    points are called.
    """
    corners, places = np.unique(np.vstack([curve.points.corners for curve in curves]), return_inverse=True)
    rows = surface.basis.rows(surface.finest, corners)
    weights = np.vstack([curve.shares[:, None] * curve.points.barycentric for curve in curves])
    of = np.repeat(np.arange(len(curves)), [3 * len(curve.points) for curve in curves])
    gather = sparse.csr_array((weights.ravel(), (of, places.ravel())), shape=(len(curves), len(corners)))
    return np.asarray(gather @ rows)


def paired_mirrors(pair: Pair) -> tuple[SymmetryPair, ...]:
    """Mirror planes that both control meshes have and that the landmarks agree with.

    A plane takes landmark i near landmark j on either side, or it is another plane. Where too few landmarks tell planes
    of one side apart, these are left; where each side has one plane only, the two belong together unless landmarks say
    otherwise. A plain mesh has none.
    """
    if pair.target.refinement.is_plain or pair.source.refinement.is_plain:
        return ()  # the vertices of a scan mirror no vertices
    sides = [(pair.target.control, pair.landmarks.target), (pair.source.control, pair.landmarks.source)]
    mirrors = in_threads(lambda side: mirror_symmetries(side[0]), sides)
    partners = [
        [(mirror, _partners(mirror, landmarks.positions / landmarks.surface.scale)) for mirror in planes]
        for planes, (_, landmarks) in zip(mirrors, sides, strict=True)
    ]
    found: list[SymmetryPair] = []
    taken: set[int] = set()
    for target, at_target in partners[0]:
        if sum(np.array_equal(at_target, others) for _, others in partners[0]) > 1:
            continue
        agreement = [np.mean(at_target == at_source) if len(at_target) else 1.0 for _, at_source in partners[1]]
        order = [int(i) for i in np.argsort(agreement)[::-1] if int(i) not in taken]
        told = len(order) == 1 or (len(order) > 1 and agreement[order[0]] > agreement[order[1]])
        if told and agreement[order[0]] >= AGREEMENT:
            taken.add(order[0])
            found.append((target.image, partners[1][order[0]][0].image))
    return tuple(found)


def _partners(mirror: Mirror, places: FloatArray) -> IndexArray:
    """Which landmark every landmark's mirror image is nearest to; (p,)."""
    squared = np.sum((mirror.reflect(places)[:, None] - places[None, :]) ** 2, axis=2)
    return np.asarray(np.argmin(squared, axis=1)) if len(places) else np.zeros(0, dtype=np.int64)


def _spectral_data(
    surface: Surface,
    landmarks: IndexArray,
    curves: Sequence[SurfaceCurve],
    symmetries: tuple[IndexArray, ...],
    filters: Filters,
    config: DescriptorConfig,
) -> SpectralData:
    basis = surface.basis
    at_eigenvalues, level = filters.at(basis.eigenvalues), basis.last_level
    # Vertex i of the control mesh is vertex i of every level.
    columns = [normalise_columns(landmark_descriptors(basis.rows(level, landmarks), at_eigenvalues))]
    if curves:
        columns.append(normalise_columns(landmark_descriptors(curve_rows(surface, curves), at_eigenvalues)))
    if config.signature_weight > 0.0:
        projected = basis.project(signature_functions(surface, filters, level), level)
        columns.append(config.signature_weight * normalise_columns(projected))
    descriptors, projections = np.hstack(columns), []
    for symmetry in symmetries:
        check_symmetry(symmetry, surface.control)
        projections.append(symmetry_operator(basis, symmetry_at(surface.refinement, symmetry, level)))
    # The same descriptors on both surfaces, for both have as many.
    steps = np.linspace(0, descriptors.shape[1], min(config.products, descriptors.shape[1]), endpoint=False)
    products = [multiplication_operator(basis, descriptors[:, int(step)]) for step in steps]
    projections += [config.product_weight * product for product in products]
    return SpectralData(basis.eigenvalues, descriptors, tuple(projections))
