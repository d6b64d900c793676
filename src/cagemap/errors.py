"""Named errors, one class per kind of cause.

Every message says what was expected, what was found, where, and what to do about it.
"""

from __future__ import annotations


class CagemapError(Exception):
    """Base of every error that cagemap raises on purpose."""


class InvalidMeshError(CagemapError, ValueError):
    """A control mesh that the method cannot take (non-manifold, flipped, degenerate, ...)."""


class InvalidLandmarksError(CagemapError, ValueError):
    """Landmarks that do not fit the two meshes (out of range, repeated, too few)."""


class DirectionError(CagemapError, ValueError):
    """Target and source were exchanged."""


class ParameterError(CagemapError, ValueError):
    """A parameter outside its range, or array shapes that disagree."""


class FormatError(CagemapError, ValueError):
    """A file that cannot be read as what it claims to be, or a format that is not supported."""


class SolverError(CagemapError, RuntimeError):
    """A linear or eigenvalue solve that did not reach its accuracy."""


class MissingLibraryError(CagemapError, ImportError):
    """A library that this step needs and that is not installed, as where it has no wheel for the platform."""


# What messages name as Python has it, and how the command line calls it.
OPTIONS = {
    "`force=True`": "--force",
    "`check_landmarks=False`": "--trust-landmarks",
    "`Landmarks.reversed()`": "--exchange-landmarks",
    "`answer=1`": "--answer 1",
    "`find_part`": "--part",
    "`weld_mesh`": "--weld",
    "`plain_mesh`": "--scheme none",
    "`unwrap`": "--unwrap",
    "`ControlMesh.scheme`": "--target-scheme",
}


def in_options(text: str) -> str:
    """A message in the words of the command line, for its users and for pages."""
    for python, option in OPTIONS.items():
        text = text.replace(python, option)
    return text


def explained(error: Exception) -> str:
    """What to say to a user of the command line or the studio of any error that ended a task."""
    if isinstance(error, CagemapError):
        return in_options(str(error))
    if isinstance(error, MemoryError):
        return "not enough memory for surfaces of this size. Use a lower --level or fewer --vertices."
    if not isinstance(error, OSError):
        return (
            f"internal error, {type(error).__name__}: {error}. This is a fault of cagemap, please report it; "
            "CAGEMAP_DEBUG=1 shows where it happened."
        )
    reason = error.strerror or error
    if error.filename:
        return f"{error.filename}: {reason}. Check the path and the space left on the disk."
    return (  # of a library's own files
        f"a file that a library keeps could not be read or written: {reason}. Is there room in the temporary folder "
        "(TMPDIR), and where compiled code is kept (NUMBA_CACHE_DIR, else beside cagemap or in ~/.cache)?"
    )
