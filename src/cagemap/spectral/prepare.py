"""From a control mesh to a prepared surface: refined, with its operators and its basis (paper, sections 2.2 and 4)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import islice

import numpy as np

from cagemap.errors import ParameterError
from cagemap.mesh import ControlMesh
from cagemap.mesh.checks import require_valid
from cagemap.mesh.inputs import MeshLike, arrays_accepted
from cagemap.mesh.schemes import Plain
from cagemap.numerics.kinds import kinds_checked
from cagemap.numerics.threads import ThreadPool, in_threads, one_blas_thread
from cagemap.operators.coarse_levels import refined
from cagemap.spectral.bands import hierarchical_basis
from cagemap.spectral.config import HFM_FUNCTIONS, MAP_BASIS, PAPER_SCHEDULE, BasisConfig
from cagemap.spectral.surface import Surface, operators_for
from cagemap.subdivision import default_scheme
from cagemap.subdivision.refinement import vertex_counts
from cagemap.surface.triangles import load_kernels

Progress = Callable[[str], None]

# A level counts as having the vertices asked for from this share on; the next one has four times as many.
ENOUGH = 0.75
MOST_LEVELS = 12
# About as many vertices as a match has on each side, unless told otherwise.
DEFAULT_VERTICES = 200_000
# Names of the methods that find a map.
METHODS = ("elastic", "hfm", "paper")


def silent(stage: str) -> None:
    """Report no progress."""


@arrays_accepted
def choose_level(control: MeshLike, vertices: int) -> int:
    """Coarsest level of at least 1 with about this many vertices or more (three quarters count as enough).

    A plain mesh (scheme none) has level 0 only.

    Parameters
    ----------
    control : mesh, see `cagemap.mesh.inputs.control_mesh`
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
def default_basis(method: str, level: int = len(PAPER_SCHEDULE) - 1) -> BasisConfig:
    """The basis of a method: functions of one level; for "paper" a schedule of no more levels than the surface has.

    Raises
    ------
    ParameterError
        If there is no such method.
    """
    if method not in METHODS:
        raise ParameterError(f"method: expected one of {', '.join(METHODS)}, got '{method}'")
    if method == "paper":
        return BasisConfig(schedule=PAPER_SCHEDULE[: level + 1])
    return replace(MAP_BASIS, count=HFM_FUNCTIONS) if method == "hfm" else MAP_BASIS


@arrays_accepted
def prepare_surface(
    control: MeshLike,
    level: int,
    config: BasisConfig = MAP_BASIS,
    *,
    progress: Progress = silent,
) -> Surface:
    """Refine a control mesh and compute its operators and its basis (paper, sections 2.2 and 4).

    It is subdivided as the mesh says (``control.scheme``); else by Loop where all faces are triangles, by Catmull-Clark
    where they are not.

    Parameters
    ----------
    control : mesh, see `cagemap.mesh.inputs.control_mesh`
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
        return Surface.of(refinement, operators, hierarchical_basis(refinement, operators, config), config)


@arrays_accepted
def prepare_surfaces(
    target: MeshLike,
    source: MeshLike,
    levels: tuple[int, int],
    config: BasisConfig | tuple[BasisConfig, BasisConfig] = MAP_BASIS,
    *,
    prepare: Callable[..., Surface] = prepare_surface,
    progress: Progress = silent,
) -> tuple[Surface, Surface]:
    """Prepare both surfaces at the same time, each in a thread of its own.

    Parameters
    ----------
    target, source : mesh, see `cagemap.mesh.inputs.control_mesh`
    levels : (int, int)
        Finest level of each.
    config : BasisConfig or two
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
