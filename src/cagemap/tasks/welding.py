"""`--weld`: join the vertices that a file repeats along its seams."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from cagemap.errors import ParameterError

if TYPE_CHECKING:  # the command line starts without the numerics
    from cagemap.mesh import ControlMesh
    from cagemap.mesh.weld import Welded

AUTO = "auto"


def weld_asked(control: ControlMesh, word: str | None) -> Welded:
    """The mesh welded as ``--weld`` says, ``auto`` or a tolerance; as it is where nothing is asked for.

    Raises
    ------
    ParameterError
        If the word is neither.
    """
    from cagemap.mesh.weld import unwelded, weld_mesh

    return unwelded(control) if word is None else weld_mesh(control, _tolerance(word))


def _tolerance(word: str) -> float | None:
    if word == AUTO:
        return None
    try:
        value = float(word)
    except ValueError:
        value = math.nan
    if not 0.0 <= value <= 0.1:
        raise ParameterError(
            f"--weld: expected {AUTO} or a distance from 0 to 0.1 in units of the bounding-box diagonal, got {word!r}"
        )
    return value
