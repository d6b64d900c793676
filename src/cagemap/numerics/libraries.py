"""Import of libraries that only some steps need, and that have no wheel for every platform."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from cagemap.errors import MissingLibraryError


def library(module: str, purpose: str) -> Any:
    """Import a module by its full name; ``purpose`` is what needs it, in the plural, such as "pictures".

    Raises
    ------
    MissingLibraryError
        If it is not installed.
    """
    try:
        return import_module(module)
    except ImportError as error:
        name = module.partition(".")[0]
        raise MissingLibraryError(
            f"{purpose}: expected the library {name}, which is not installed ({error}); `pip install {name}` where it "
            "has a wheel for this platform and version of Python, or do this step where it has: everything else works "
            "without it"
        ) from error
