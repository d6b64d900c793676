"""Pairs of human cages whose true map is known, for tests of what a spectral method finds."""

from __future__ import annotations

import numpy as np
from benchmarks.truth import true_map

from cagemap.geometry.surface import TriangleSurface
from cagemap.maps.spectral.hierarchical import Growth
from cagemap.pipeline import MatchConfig, pair_of, prepare_surface

# A third of the default growths: what is left out shows as well, in a third of the time.
THREE = tuple(Growth(12, 1.5, weight, 0.3) for weight in (0.1, 0.33, 1.0))


class Judged:
    """A pair of human cages with its true map on one level, both sides' bases by one configuration."""

    def __init__(self, human, config, landmarks, *, back=False, level=1):
        """With the second mesh as target, or, back, the first one."""
        self.level = level
        order = slice(None, None, -1 if back else 1)
        self.surfaces = [prepare_surface(mesh, level, config) for mesh in human.meshes()[order]]
        neutrals = [
            TriangleSurface.from_faces(s.refinement.prolong(neutral, 0, level), s.refinement.finest.faces)
            for s, neutral in zip(self.surfaces, human.neutrals()[order], strict=True)
        ]
        source, target = self.surfaces
        truth = true_map(neutrals[1], neutrals[0])
        self.images, self.known = truth.on(source.triangles(level)).positions, truth.known
        chosen = human.landmarks(landmarks)
        self.pair = pair_of(target, source, chosen.reversed() if back else chosen, MatchConfig())

    def error(self, positions):
        n = len(positions)
        return 100 * float(np.linalg.norm(positions - self.images[:n], axis=1)[self.known[:n]].mean())

    def errors(self, maps, points):
        """Of every level's match, and of the point map."""
        places = self.surfaces[0].triangles(self.level).positions
        return [*(self.error(places[found.match]) for found in maps), self.error(points.images.positions)]
