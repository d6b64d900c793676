"""Descriptors and operators of a pair, in coefficients of the hierarchical bases (paper, 5.1 - 5.3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from cagemap.errors import ParameterError
from cagemap.maps.curves import SurfaceCurve
from cagemap.maps.pair import Pair, SymmetryPair
from cagemap.mesh.mirrors import Mirror, mirror_symmetries
from cagemap.numerics.arrays import FloatArray, IndexArray, real_numbers
from cagemap.numerics.brief import Brief
from cagemap.numerics.threads import in_threads
from cagemap.paper.descriptors import Filters, choose_filters, landmark_descriptors, normalise_columns, signatures
from cagemap.paper.operators import check_symmetry, multiplication_operator, symmetry_at, symmetry_operator
from cagemap.spectral.surface import Surface

# Mean distance of neighbouring eigenvalues of a surface of unit area (Weyl's law). With eigenvalues in this unit,
# Lambda~ counts places in the spectrum, and one weight serves all k and all surfaces.
SPACING = 4.0 * np.pi
# Share of landmarks that two mirror planes must take to the same landmarks.
AGREEMENT = 0.5


@dataclass(frozen=True, eq=False, repr=False)
class SpectralData:
    """Descriptors and operators of one surface; the leading blocks are those of the coarser levels (eq. 15).

    Attributes
    ----------
    eigenvalues : (k,) array
        Lambda~, in the order of the basis: bands of level 0, 1, ... Unit area.
    descriptors : (k, q) array
        F~, the same q descriptors on both surfaces, weighted.
    operators : tuple of (k, k) arrays
        O~ beside the Laplacian, such as self-symmetries (paper, 5.2); those of both surfaces in the same order.
    """

    eigenvalues: FloatArray
    descriptors: FloatArray
    operators: tuple[FloatArray, ...] = ()

    def __repr__(self) -> str:
        sizes = f"{self.count} functions, {self.descriptors.shape[1]} descriptors, {len(self.operators)} operators"
        return f"SpectralData({sizes})"

    @property
    def count(self) -> int:
        """Number k of basis functions."""
        return len(self.eigenvalues)

    def leading(self, count: int) -> SpectralData:
        """Keep the first basis functions only."""
        operators = tuple(operator[:count, :count] for operator in self.operators)
        return SpectralData(self.eigenvalues[:count], self.descriptors[:count], operators)


@dataclass(frozen=True)
class MapWeights:
    """Weights of eq. 13, one number each for the whole hierarchy, beside descriptors of unit norm.

    Attributes
    ----------
    laplacian : float
        alpha(Lambda~), for eigenvalues counted in their mean spacing (see `SPACING`).
    operators : float
        alpha(O) of every other operator.
    decay : float
        Weight of ||C||^2. Rows of C that no descriptor speaks about then vanish, and so have no say in a nearest
        neighbour, where eq. 13 leaves noise. 0 is eq. 13 as printed.
    """

    laplacian: float = 0.003
    operators: float = 1.0
    decay: float = 1.0

    def __post_init__(self) -> None:
        """Check the ranges."""
        for name, value in vars(self).items():
            if not (np.isfinite(value) and value >= 0.0):
                raise ParameterError(f"weights: expected {name} of at least 0, got {value}")


@dataclass(frozen=True)
class Constraints:
    """What both surfaces bring to eq. 13: the same descriptors and operators on either side."""

    target: SpectralData
    source: SpectralData

    def __post_init__(self) -> None:
        """Refuse data that cannot be compared."""
        target, source = self.target, self.source
        if target.descriptors.shape[1] != source.descriptors.shape[1]:
            raise ParameterError(
                "expected as many target as source descriptors, got "
                f"{target.descriptors.shape[1]} and {source.descriptors.shape[1]}"
            )
        if len(target.operators) != len(source.operators):
            raise ParameterError(
                f"expected as many target as source operators, got {len(target.operators)} and {len(source.operators)}"
            )
        for side, data in (("target", target), ("source", source)):
            sizes = {(len(data.descriptors), data.count), *(matrix.shape for matrix in data.operators)}
            if sizes != {(data.count, data.count)}:
                raise ParameterError(
                    f"{side}: expected {data.count} rows of descriptors and operators, one for each basis function, "
                    f"got {sorted(sizes)}"
                )

    @property
    def shape(self) -> tuple[int, int]:
        """(k1, k2), the shape of C12."""
        return self.target.count, self.source.count

    def leading(self, k1: int, k2: int) -> Constraints:
        """Those of a coarser level: the leading basis functions of both sides."""
        return Constraints(self.target.leading(k1), self.source.leading(k2))

    def with_descriptors(self, target: FloatArray, source: FloatArray, weight: float = 1.0) -> Constraints:
        """Add descriptors of one's own.

        Parameters
        ----------
        target, source : (k1, q), (k2, q) arrays
            Coefficients of corresponding functions; each column is scaled to norm ``weight`` on either side.
        weight : float
            A landmark kernel weighs 1.
        """
        sides = []
        for data, given in ((self.target, target), (self.source, source)):
            columns = real_numbers(given, "descriptors")
            norms = np.linalg.norm(columns, axis=0)
            scaled = weight * columns / np.where(norms > 0.0, norms, 1.0)
            sides.append(replace(data, descriptors=np.hstack([data.descriptors, scaled])))
        return Constraints(*sides)

    def with_operators(self, target: FloatArray, source: FloatArray) -> Constraints:
        """Add a pair of operators that the map shall commute with, (k1, k1) and (k2, k2); of norms of about 1."""
        sides = ((self.target, target), (self.source, source))
        return Constraints(
            *(replace(data, operators=(*data.operators, real_numbers(given, "operators"))) for data, given in sides)
        )


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
    values = np.empty((surface.hierarchy.levels[level].n_vertices, at_eigenvalues.shape[1]))
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
    rows = basis.rows(level, surface.hierarchy.on_level(level, landmarks))
    columns = [normalise_columns(landmark_descriptors(rows, at_eigenvalues))]
    if curves:
        columns.append(normalise_columns(landmark_descriptors(curve_rows(surface, curves), at_eigenvalues)))
    if config.signature_weight > 0.0:
        projected = basis.project(signature_functions(surface, filters, level), level)
        columns.append(config.signature_weight * normalise_columns(projected))
    descriptors, projections = np.hstack(columns), []
    for symmetry in symmetries:
        check_symmetry(symmetry, surface.control)
        projections.append(symmetry_operator(basis, symmetry_at(surface.hierarchy, symmetry, level)))
    # The same descriptors on both surfaces, for both have as many.
    steps = np.linspace(0, descriptors.shape[1], min(config.products, descriptors.shape[1]), endpoint=False)
    products = [multiplication_operator(basis, descriptors[:, int(step)]) for step in steps]
    projections += [config.product_weight * product for product in products]
    return SpectralData(basis.eigenvalues, descriptors, tuple(projections))
