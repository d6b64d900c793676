"""From a control mesh to a prepared surface: refined, with its operators and its basis (paper, sections 2.2 and 4)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import islice

import numpy as np

from cagemap.basis.construction import hierarchical_basis
from cagemap.basis.schedule import LARGE_MAP_BASIS, MAP_BASIS, BasisConfig
from cagemap.basis.surface import Surface, on_levels, operators_for
from cagemap.errors import ParameterError
from cagemap.geometry.triangles import load_kernels
from cagemap.mesh import ControlMesh
from cagemap.mesh.checks import require_valid
from cagemap.mesh.schemes import Plain
from cagemap.numerics.kinds import kinds_checked
from cagemap.numerics.threads import ThreadPool, in_threads, one_blas_thread
from cagemap.operators.coarse_levels import refined
from cagemap.refinement import default_scheme
from cagemap.refinement.counts import vertex_counts

Progress = Callable[[str], None]

# A level counts as having the vertices asked for from this share on; the next one has four times as many.
ENOUGH = 0.75
MOST_LEVELS = 12
# Names of the methods that find a map.
METHODS = ("elastic", "hfm", "paper")


def silent(stage: str) -> None:
    """Report no progress."""


@kinds_checked
def choose_level(control: ControlMesh, vertices: int) -> int:
    """Coarsest level of at least 1 with about this many vertices or more (three quarters count as enough).

    A plain mesh (scheme none) has level 0 only.

    Parameters
    ----------
    control : ControlMesh
    vertices : int

    Raises
    ------
    ParameterError
        If the number of vertices is out of range.
    """
    if not 1 <= vertices <= 20_000_000:
        raise ParameterError(f"vertices: expected a number from 1 to 20 000 000, got {vertices}")
    if isinstance(default_scheme(control), Plain):
        return 0
    counts = islice(vertex_counts(control), 1, MOST_LEVELS)
    return next((level for level, n in enumerate(counts, 1) if n >= ENOUGH * vertices), MOST_LEVELS)


@kinds_checked
def default_basis(method: str) -> BasisConfig:
    """The basis that a method reads all of: 150 functions for "elastic", 300 for "hfm" and "paper".

    Only that of "paper" is of the finest level's geometry, as in the paper.

    Raises
    ------
    ParameterError
        For any other name.
    """
    if method not in METHODS:
        raise ParameterError(f"method: expected one of {', '.join(METHODS)}, got '{method}'")
    return {"elastic": MAP_BASIS, "hfm": LARGE_MAP_BASIS}.get(method, BasisConfig())


@kinds_checked
def prepare_surface(
    control: ControlMesh,
    level: int,
    config: BasisConfig = MAP_BASIS,
    *,
    progress: Progress = silent,
) -> Surface:
    """Refine a control mesh and compute its operators and its hierarchical basis (paper, sections 2.2 and 4).

    It is subdivided as the mesh says (``control.scheme``); else by Loop where all faces are triangles, by Catmull-Clark
    where they are not.

    Parameters
    ----------
    control : ControlMesh
    level : int
        Number of the finest level, at least 1; 0 of a plain mesh (scheme none), which is not refined.
    config : BasisConfig
    progress : callable
        Called with the name of each stage.

    Raises
    ------
    InvalidMeshError
        If the control mesh is not an oriented connected manifold; the message lists the offending elements.
    ParameterError
        If the level or the number of basis functions is out of range.
    """
    require_valid(control)
    return prepare_checked(control, level, config, progress=progress)


def prepare_checked(
    control: ControlMesh,
    level: int,
    config: BasisConfig = MAP_BASIS,
    *,
    progress: Progress = silent,
) -> Surface:
    """`prepare_surface` of a control mesh that was found valid already."""
    scheme = default_scheme(control)
    if isinstance(scheme, Plain) and level:
        raise ParameterError(f"level: expected 0 of a plain mesh (scheme none), got {level}; bilinear refines it")
    if not isinstance(scheme, Plain) and not 1 <= level <= MOST_LEVELS:
        raise ParameterError(
            f"level: expected 1 to {MOST_LEVELS}, got {level}; level 0 is the control mesh, and only a plain mesh "
            "(scheme none) is matched as it is"
        )
    with one_blas_thread():
        progress(f"refine {control.name}")
        refinement = refined(control, level, scheme)
        progress(f"operators of {control.name}")
        operators = operators_for(refinement, config)
        progress(f"basis of {control.name}")
        return Surface.of(
            refinement, operators, hierarchical_basis(refinement, operators, on_levels(refinement, config)), config
        )


@kinds_checked
def prepare_surfaces(
    target: ControlMesh,
    source: ControlMesh,
    levels: tuple[int, int],
    config: BasisConfig | tuple[BasisConfig, BasisConfig] = MAP_BASIS,
    *,
    prepare: Callable[..., Surface] = prepare_surface,
    progress: Progress = silent,
) -> tuple[Surface, Surface]:
    """Prepare both surfaces at the same time, each in a thread of its own.

    Parameters
    ----------
    target, source : ControlMesh
    levels : (int, int)
        Finest level of each.
    config : BasisConfig or two
        Of both, or of each.
    prepare : callable
        What makes one surface from a control mesh, a level and a configuration.
    progress : callable
        Called once: the stages of two surfaces would mix.

    Raises
    ------
    InvalidMeshError, ParameterError
        See `prepare_surface`.
    """
    if not isinstance(levels, Sequence | np.ndarray) or len(levels) != 2:
        raise ParameterError(f"levels: expected two, the target's and the source's, got {levels}")
    configs = config if isinstance(config, tuple) else (config, config)
    progress(f"prepare {target.name} and {source.name}")
    with one_blas_thread(), ThreadPool(1) as aside:  # before the threads start: the setting is the process's
        aside.submit(load_kernels)  # while the surfaces are refined, which takes none
        made = in_threads(lambda side: prepare(*side), list(zip((target, source), levels, configs, strict=True)))
    return made[0], made[1]
