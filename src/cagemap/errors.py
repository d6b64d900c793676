"""Exception classes, one for each kind of cause.

Most messages read "PLACE: expected this, got that. What to do."; the last sentence is left out where the first says it.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any


class CagemapError(Exception):
    """Base of every error that cagemap raises on purpose.

    Attributes
    ----------
    code : str
        Kind of cause, for programs; the message is for people and may change.
    """

    code = "error"

    @property
    def place(self) -> str:
        """The file, option or element that the message begins with; empty if it names none."""
        text = str(self)
        place, found, _ = text.partition(": expected ")
        if not found:
            place, found, _ = text.partition(": ")
        return place if found and not re.search(r"expected |[.,] [A-Z]", place) else ""

    @property
    def remedy(self) -> str:
        """The sentences after the first, which say what to do; empty if that is what was expected."""
        sentences = re.split(r"\. (?=[A-Z`])", str(self)[len(self.place) :], maxsplit=1)
        return "" if len(sentences) == 1 else sentences[1]


class InvalidMeshError(CagemapError, ValueError):
    """A control mesh that cannot be used (non-manifold, flipped, degenerate, ...)."""

    code = "invalid-mesh"


class InvalidLandmarksError(CagemapError, ValueError):
    """Landmarks that do not fit the two meshes (out of range, repeated, too few)."""

    code = "invalid-landmarks"


class DirectionError(CagemapError, ValueError):
    """Target and source were exchanged."""

    code = "exchanged"


class ParameterError(CagemapError, ValueError):
    """A parameter outside its range, or array shapes that disagree."""

    code = "parameter"


class FormatError(CagemapError, ValueError):
    """A file that is not valid in its format, or an unsupported format."""

    code = "format"


class MissingFileError(FormatError):
    """A file that is not there."""

    code = "missing-file"


class SolverError(CagemapError, RuntimeError):
    """A linear or eigenvalue solver that did not reach its accuracy."""

    code = "solver"


class MissingLibraryError(CagemapError, ImportError):
    """A required library that is not installed, for example because its platform has no wheel."""

    code = "missing-library"


# Python names in messages, and the options of the command line for the same.
OPTION_NAMES = {
    "`force=True`": "--force",
    "`check_landmarks=False`": "--trust-landmarks",
    "`Landmarks.reversed()`": "--exchange-landmarks",
    "`answer=1`": "--answer 1",
    "`find_part`": "--part",
    "`plain_mesh`": "--scheme none (of a source alone: --source-scheme none)",
    "`unwrap`": "--unwrap",
    "`ControlMesh.scheme`": "--target-scheme",
}


def use_option_names(text: str) -> str:
    """A message with Python names replaced by options, for the command line and pages."""
    text = re.sub(r"`weld_mesh\(mesh, (.*?)\)`", r"--weld \1", text)
    for python, option in OPTION_NAMES.items():
        text = text.replace(python, option)
    return text


@contextmanager
def values_of(place: object) -> Iterator[None]:
    """Name a file or another place before the messages of parameters that are refused."""
    try:
        yield
    except ParameterError as error:
        raise ParameterError(f"{place}: {error}") from None


# What a value should be, by the start of the type of pydantic's error.
_EXPECTED = {
    "int": "a whole number",
    "float": "a number",
    "finite": "a finite number",
    "bool": "true or false",
    "string_pattern": "letters, digits, '.', '_' and '-', a letter or digit first",
    "string_type": "a text",
    "path": "the name of a file",
    "list": "a list",
    "tuple": "a list",
    "dict": "a table",
    "model": "a table",
    "greater_than_equal": "{ge:g} or more",
    "less_than_equal": "{le:g} or less",
    "literal": "{expected}",
    "enum": "{expected}",
}


def wrong_values(error: Any) -> list[tuple[tuple[str | int, ...], str]]:
    """Path to each entry that a pydantic `ValidationError` is about, with what is wrong and what to do."""
    return [(item["loc"], _wrong_value(item)) for item in error.errors(include_url=False)]


def _wrong_value(item: Mapping[str, Any]) -> str:
    if item["type"] == "extra_forbidden":
        return "there is no such entry. Check its spelling, or remove it."
    if item["type"] == "missing":
        return "is missing. Add it."
    known = (text.format(**item.get("ctx", {})) for kind, text in _EXPECTED.items() if item["type"].startswith(kind))
    got = repr(item["input"])
    return f"expected {next(known, item['msg'])}, got {got if len(got) <= 60 else f'{got[:57]}...'}. Correct it."


def error_code(error: Exception) -> str:
    """The code of an error that ended a task; "memory", "system" or "internal" for those of other libraries."""
    if isinstance(error, CagemapError):
        return error.code
    return "memory" if isinstance(error, MemoryError) else "system" if isinstance(error, OSError) else "internal"


def explain_error(error: Exception) -> str:
    """Message to the user for any error that ended a task."""
    if isinstance(error, CagemapError):
        return use_option_names(str(error))
    if isinstance(error, MemoryError):
        remedy = "Use a lower --level, fewer --vertices or, in a job, fewer --workers"
        return f"not enough memory for surfaces of this size. {remedy}."
    if not isinstance(error, OSError):
        return (
            f"internal error, {type(error).__name__}: {error}. This is a fault of cagemap, please report it; "
            "CAGEMAP_DEBUG=1 shows where it happened."
        )
    reason = error.strerror or error
    if error.filename:
        return f"{error.filename}: {reason}. Check the path, its permissions and the space left on the disk."
    if isinstance(error, FileNotFoundError):  # of a relative path
        return "the current folder was removed. Change to another one."
    return (  # without a name: a file of a library
        f"a file that a library keeps could not be read or written: {reason}. Is there room in the temporary folder "
        "(TMPDIR), and where compiled code is kept (NUMBA_CACHE_DIR, else beside cagemap or in ~/.cache)?"
    )
