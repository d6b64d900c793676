"""Fixtures that every test may use."""

from __future__ import annotations

import inspect
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

# Before NumPy is loaded: test processes run side by side, and BLAS threads that wait for each other's cores spin.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture
def small_pages(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pages of reports with pictures of a few pixels, where a test asks what they say."""
    from cagemap.report import write_report

    monkeypatch.setitem(inspect.unwrap(write_report).__kwdefaults__, "size", (24, 18))


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of real control meshes beside the checkout; tests that need it skip where it is absent."""
    if not SHARED.is_dir():
        pytest.skip("real control meshes are not beside this checkout (../shared/data)")
    return SHARED


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """One headless Chromium for all tests that ask for it."""
    from browser_page import chromium

    with chromium() as started:
        yield started
