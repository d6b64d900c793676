"""Suspicious landmarks: outliers by geodesic distances and by orientation, before any map exists; strain, on a map.

Bodies change size from limb to limb, but a landmark on the wrong limb is out of proportion to most of the others.
Geodesic distances between landmarks are measured on a coarse graph of each surface. Every landmark is then placed on
the source by its distances to the others alone (robust multilateration). Pairs whose given place fits much worse are
outliers, found one after the other. Distances hardly distinguish the left fore foot from the right one. The orientation
of landmarks around each other does: for all of them, and for two that were exchanged.

Strain is a leave-one-out residual, of all pairs from one factorisation. At the finished map the elastic fit is, to
second order, a quadratic problem in positions x and linear maps A,

    alpha E(x, A) + sum_i a_i (n_i . (x_i - y_i))^2,

with n_i the source's normals at the images y_i. Everything but the p landmarks is eliminated, which leaves the energy
``(l - l_0)^T H (l - l_0)`` of their positions l. A landmark that is released while the others are fixed moves by
``u_i = -H_ii^-1 (H (l - l_0))_i``.

This only finds suspects; `maps.landmarks.check` decides which are left out. Bounds: `deform.config.LandmarkConfig`.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse

from cagemap.deform.config import ElasticConfig, LandmarkConfig
from cagemap.deform.energy import energy_matrix
from cagemap.deform.graph import ElasticGraph, cluster_graph
from cagemap.numerics.arrays import FloatArray, IndexArray
from cagemap.numerics.sparse_algebra import factor
from cagemap.numerics.threads import row_slices
from cagemap.surface.triangles import normalize_rows

MOST_TERMS = 4_000_000  # largest number of terms in memory, of sums over triples of landmarks
LANDMARKS_AT_ONCE = 32  # number of landmarks whose blocks of H are computed at once

# Geodesic distances (p, m) from p landmarks on one surface to the vertices of a coarse graph, the landmarks first
# (`cagemap.deform.problem.Problem.landmark_distances`).
Distances = FloatArray
OrientedPoints = tuple[FloatArray, FloatArray]  # positions and unit normals (p, 3) of landmarks on one surface
StrainSystem = tuple[sparse.csc_array, FloatArray]  # K (m, m) and b (m,) of ``z^T K z - 2 z^T b`` of the strain


def misplaced_pairs(target: Distances, source: Distances, config: LandmarkConfig = LandmarkConfig()) -> IndexArray:
    """Pairs whose distances to the others differ between the surfaces: exchanged ones, then single ones, worst first.

    After each pair that is found, the others are judged again without it.
    """
    trusted, wrong = np.arange(len(target)), list[int]()
    max_suspected, at_once = config.max_suspects * len(trusted), max(1, len(trusted) // config.one_of)
    for search, fewest in ((best_exchanges, config.fewest_judged + 1), (worst_placed_pairs, config.fewest_judged)):
        while len(trusted) >= fewest and len(wrong) <= max_suspected:
            found = search(target, source, trusted, at_once, config)
            if not found:
                break
            wrong.extend(found)
            trusted = np.setdiff1d(trusted, found)
    return np.array(wrong, dtype=np.int64)


def best_exchanges(
    target: Distances, source: Distances, trusted: IndexArray, count: int, config: LandmarkConfig = LandmarkConfig()
) -> list[int]:
    """Up to ``count`` couples of trusted pairs that fit much better with source vertices exchanged, flattened."""
    gain = exchange_gains(target, source, trusted, config)
    least = max(config.min_exchange_gain, typical_misfit(target, source, trusted, config))
    exchanged: list[int] = []
    while len(exchanged) < 2 * count:
        both = np.array(np.unravel_index(np.argmax(gain), gain.shape))
        if gain[tuple(both)] < least:
            break
        exchanged.extend(trusted[both].tolist())
        gain[both], gain[:, both] = -np.inf, -np.inf
    return exchanged


def exchange_gains(target: Distances, source: Distances, trusted: IndexArray, config: LandmarkConfig) -> FloatArray:
    """(q, q) gain of any two of q trusted pairs by exchanging source vertices; -inf on the diagonal.

    Gain: misfit of both (`place_by_distances`, without the distance to each other) minus that of both exchanged.
    """
    square = np.ix_(trusted, trusted)
    short, most = config.added_distance, config.max_misfit
    near = target[square] + short
    wanted, given = np.log(near), np.log(source[square] + short)
    different = ~np.eye(len(trusted), dtype=bool)
    wanted = wanted - float(np.median((wanted - given)[different]))
    weights = np.where(different, 1.0 / near, 0.0)
    # Misfits of landmark i at the vertex of j: to all landmarks, less those to j and to i itself.
    p = len(trusted)
    total = np.empty((p, p))
    for rows in row_slices(p, max(1, MOST_TERMS // max(p * p, 1))):
        ratios = np.abs(wanted[rows, None] - given[None])
        total[rows] = np.einsum("ik,ijk->ij", weights[rows], np.minimum(ratios, most))
    at_own = weights * np.minimum(np.abs(wanted - given), most)
    at_other = weights * np.minimum(np.abs(wanted - given.diagonal()), most)
    rest = weights.sum(axis=1)[:, None] - weights
    as_given = (total.diagonal()[:, None] - at_own) / rest
    exchanged = (total - at_other) / rest
    return np.asarray(np.where(different, as_given + as_given.T - exchanged - exchanged.T, -np.inf))


def worst_placed_pairs(
    target: Distances, source: Distances, trusted: IndexArray, count: int, config: LandmarkConfig
) -> list[int]:
    """Up to ``count`` trusted pairs placed much worse than at their best place, worst first."""
    gain, node, distance = place_by_distances(target, source, trusted, config)
    gain = np.where(distance >= config.min_distance, gain, 0.0)
    misplaced: list[int] = []
    while len(misplaced) < count:
        worst = int(np.argmax(gain))
        remaining = trusted[trusted != worst]
        if gain[worst] > 0.0 and is_farther_out(target, source, worst, int(node[worst]), remaining, config):
            gain[worst] = 0.0
            continue
        typical = typical_misfit(target, source, remaining, config)
        if gain[worst] < max(config.min_gain, config.gain_of_typical * typical):
            break
        misplaced.append(worst)
        gain[worst], trusted = 0.0, remaining
    return misplaced


def is_farther_out(
    target: Distances, source: Distances, landmark: int, node: int, others: IndexArray, config: LandmarkConfig
) -> bool:
    """Whether a tip is farther out on its limb than the best place ``node``, as a long tail's tip on a short tail."""
    through = source[others, node] + source[landmark, node]
    is_farther = bool(np.median(through - source[others, landmark]) < config.detour)
    for distances in (target, source):  # at a tip no vertex near the landmark is farther from the others
        away, near = distances[others].mean(axis=0), distances[landmark] < config.tip_reach
        is_farther = is_farther and bool(away[near].max() <= away[landmark] + config.tip_slack)
    return is_farther


def place_by_distances(
    target: Distances, source: Distances, trusted: IndexArray, config: LandmarkConfig = LandmarkConfig()
) -> tuple[FloatArray, IndexArray, FloatArray]:
    """Place every trusted landmark on the source by its distances to the other trusted landmarks.

    Returns, for every landmark (p,), the gain: the misfit of its source vertex minus the least misfit of any vertex, 0
    if it is not trusted; the vertex of least misfit; and the geodesic distance from the given vertex to that one.

    The misfit of vertex v for landmark i is ``sum_j w_ij min(|log (d1_ij + c) / (d2_vj + c) - s|, m)``, weights
    w_ij proportional to ``1 / (d1_ij + c)`` with sum 1, s the median log ratio of all pairs, c and m the
    `added_distance` and `max_misfit` of `LandmarkConfig`. Near landmarks count most. The cap m limits the influence of
    a second wrong pair.
    """
    p, short = len(target), config.added_distance
    near = target[:, :p] + short
    wanted, logs = np.log(near), np.log(source + short)
    shift = float(np.median((wanted - logs[:, :p])[_pairs(trusted)]))
    gain, distance, node = np.zeros(p), np.zeros(p), np.arange(p)
    for i in trusted:
        remaining = trusted[trusted != i]
        weights = 1.0 / near[i, remaining]
        ratios = np.abs(wanted[i, remaining, None] - shift - logs[remaining])
        misfits = (weights / weights.sum()) @ np.minimum(ratios, config.max_misfit)
        node[i] = np.argmin(misfits)
        gain[i], distance[i] = misfits[i] - misfits[node[i]], source[i, node[i]]
    return gain, node, distance


def typical_misfit(
    target: Distances, source: Distances, trusted: IndexArray, config: LandmarkConfig = LandmarkConfig()
) -> float:
    """Median |log ratio| of the distances of all trusted pairs, after removing the common scale."""
    p, short = len(target), config.added_distance
    ratios = (np.log(target[:, :p] + short) - np.log(source[:, :p] + short))[_pairs(trusted)]
    return float(np.median(np.abs(ratios - np.median(ratios))))


def _pairs(trusted: IndexArray) -> tuple[IndexArray, IndexArray]:
    """Rows and columns of all ordered pairs of different trusted landmarks."""
    rows, columns = np.meshgrid(trusted, trusted, indexing="ij")
    different = rows != columns
    return rows[different], columns[different]


def exchanged_sides(
    distances: tuple[Distances, Distances],
    target: OrientedPoints,
    source: OrientedPoints,
    config: LandmarkConfig = LandmarkConfig(),
) -> tuple[int, int] | None:
    """The two pairs whose orientations agree only with source points exchanged; None if there are none."""
    p = len(target[0])
    apart = np.minimum(*(side[:, :p] for side in distances)) > config.min_side_distance
    gain = exchange_gains(*distances, np.arange(p), config) - config.min_side_gain
    gains = np.triu(np.where(apart, gain, 0.0), 1).ravel()
    candidates = np.argsort(-gains)[: max(1, MOST_TERMS // p**2)]
    near, best, min_rise = 1.0 / (distances[0][:, :p] + config.added_distance), None, config.min_side_rise
    np.fill_diagonal(near, 0.0)
    for place in candidates[gains[candidates] > 0.0]:
        both = int(place) // p, int(place) % p
        order = np.arange(p)
        order[list(both)] = both[::-1]
        given = agreement_around(both, target, source, near, config.min_orientation)
        swapped = source[0][order], source[1][order]
        exchanged = agreement_around(both, target, swapped, near, config.min_orientation)
        if given < config.max_side_agreement and exchanged > config.min_side_agreement and exchanged - given > min_rise:
            best, min_rise = both, exchanged - given
    return best


def agreement_around(
    places: tuple[int, int], target: OrientedPoints, source: OrientedPoints, near: FloatArray, flat: float
) -> float:
    """`orientation_agreement` of triples with one of two landmarks, weighted by nearness (p, p): bodies bend."""
    agreed = counted = asked = 0.0
    for i in places:
        for measured, weights in (
            (_orientations, near[i, :, None] * near[i]),
            (_orientations_at, near[:, i, None] * near),
        ):
            votes = measured(i, *target) * measured(i, *source) * weights
            agreed += float(votes.sum())
            counted += float(np.abs(votes).sum())
            asked += float(weights.sum())
    return agreed / max(counted, flat * asked, 1e-12)


def orientation_agreement(
    target: OrientedPoints, source: OrientedPoints, config: LandmarkConfig = LandmarkConfig()
) -> float:
    """Agreement of the landmarks' orientation on both surfaces: 1 the same, -1 mirrored, 0 unknown.

    Every triple (i; j, k) votes with the product of ``n_i . (e_ij x e_ik)`` on both surfaces, e the unit vectors to j
    and k. Triples whose distances in space differ count less, as where arms are crossed.
    """
    p, places = len(target[0]), (target[0], source[0])
    ratios = np.log(np.divide(*(np.linalg.norm(x[:, None] - x, axis=2) + config.added_distance for x in places)))
    # The median includes the diagonal's zeros: surfaces of unit area have one scale (docs/lab/landmark_check.md).
    changed = (ratios - np.median(ratios)) ** 2
    agreed = counted = 0.0
    for i in range(p):
        alike = np.exp(-(changed[i, :, None] + changed[i] + changed) / config.max_triple_change**2)
        votes = alike * _orientations(i, *target) * _orientations(i, *source)
        agreed += float(votes.sum())
        counted += float(np.abs(votes).sum())
    return agreed / max(counted, config.min_orientation * p * (p - 1) * (p - 2), 1e-12)


def _orientations(i: int, positions: FloatArray, normals: FloatArray) -> FloatArray:
    """(p, p) ``n_i . (e_ij x e_ik)`` for one landmark i."""
    units = normalize_rows(positions - positions[i])
    return np.asarray(np.cross(normals[i], units) @ units.T)


def _orientations_at(j: int, positions: FloatArray, normals: FloatArray) -> FloatArray:
    """(p, p) ``n_i . (e_ij x e_ik)`` for one landmark j."""
    units = normalize_rows(positions[None] - positions[:, None])
    return np.asarray(np.einsum("id,ikd->ik", np.cross(normals, units[:, j]), units))


def strain_system(
    graph: ElasticGraph, images: FloatArray, normals: FloatArray, landmarks: IndexArray, config: ElasticConfig
) -> StrainSystem:
    """Matrix and right side of the quadratic problem at images (n, 3) with the source's normals (n, 3) there.

    Landmarks (p,) are its first vertices. Unknown 12 i + c is coordinate c of x_i, 12 i + 3 + 3 b + c is A_i[c, b].
    """
    numbers = config.landmarks
    coarse, vertices = cluster_graph(graph, numbers.strain_vertices, landmarks, config.graph)
    plane, size = normals[vertices], 12 * coarse.n
    blocks = coarse.areas[:, None, None] * plane[:, :, None] * plane[:, None, :]
    blocks = blocks + numbers.strain_ridge / coarse.n * np.eye(3)
    data = sparse.bsr_array((blocks, np.arange(coarse.n), np.arange(coarse.n + 1))).tocoo()
    rows = position_rows(coarse.n)
    at_row, at_column = (rows.ravel()[side] for side in data.coords)
    placed = sparse.coo_array((data.data, (at_row, at_column)), shape=(size, size))
    elastic = sparse.kron(
        numbers.strain_stiffness * energy_matrix(coarse, numbers.strain_smoothing), sparse.eye_array(3)
    )
    right = np.zeros(size)
    right[rows] = np.einsum("nab,nb->na", blocks, images[vertices])
    return sparse.csc_array(elastic + placed), right


def strained_pair(
    system: StrainSystem, places: FloatArray, strains: FloatArray, config: LandmarkConfig = LandmarkConfig()
) -> int | None:
    """The one landmark that would move far if released, by lengths (p,) of `released_shifts`; else None."""
    worst = int(np.argmax(strains))
    if len(places) < config.fewest_strained or strains[worst] < config.min_strain:
        return None
    # Measured again without the worst one, as a wrong landmark strains its neighbours.
    others = np.delete(np.arange(len(places)), worst)
    moved_next = np.linalg.norm(released_shifts(system, places[others], position_rows(len(places))[others]), axis=1)
    least = max(config.min_strain, config.min_strain_of_next * float(moved_next.max()))
    return worst if strains[worst] >= least else None


def released_shifts(system: StrainSystem, places: FloatArray, rows: IndexArray) -> FloatArray:
    """(p, 3) shift of every landmark at places (p, 3), with unknowns rows (p, 3), if it alone is released.

    Only diagonal blocks of H, a Schur complement, are computed: with thousands of landmarks it would fill the memory.
    """
    (matrix, right), own = system, rows.ravel()
    rest = np.setdiff1d(np.arange(len(right)), own)
    coupling, factors = sparse.csc_array(matrix[:, own][rest]), factor(sparse.csc_array(matrix[:, rest][rest]))
    stiffness, positions = sparse.csc_array(matrix[:, own][own]), places.ravel()
    forces = stiffness @ positions - right[own] + coupling.T @ factors.solve(right[rest] - coupling @ positions)
    shifts = np.empty_like(places)
    for part in row_slices(len(places), LANDMARKS_AT_ONCE):
        some, count = slice(3 * part.start, 3 * part.stop), part.stop - part.start
        columns = coupling[:, some]
        reduced = stiffness[some, some].toarray() - columns.T @ factors.solve(columns.toarray())
        blocks = np.asarray(reduced).reshape(count, 3, count, 3)[np.arange(count), :, np.arange(count)]
        shifts[part] = -np.linalg.solve(blocks, forces[some].reshape(-1, 3, 1))[:, :, 0]
    return shifts


def position_rows(count: int) -> IndexArray:
    """(count, 3) rows of the first vertices' positions in a `strain_system`."""
    return 12 * np.arange(count)[:, None] + np.arange(3)
