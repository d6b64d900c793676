"""Fixtures that every test may use."""

from __future__ import annotations

import inspect
import os
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
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


@dataclass
class Chromium:
    """The browser that runs, and how many tests had failed when it was started."""

    program: Any = None
    failed: int = -1
    begun: ExitStack = field(default_factory=ExitStack)

    def close(self) -> None:
        with suppress(Exception):  # it may be what has failed
            self.begun.close()


@pytest.fixture(scope="session")
def chromium_held() -> Iterator[Chromium]:
    """What `browser` gives out."""
    held = Chromium()
    yield held
    held.close()


@pytest.fixture
def browser(chromium_held: Chromium, request: pytest.FixtureRequest) -> Any:
    """One headless Chromium for all tests that ask for it; what a failure left of it, no other test meets."""
    from browser_page import chromium

    if chromium_held.failed != request.session.testsfailed:
        chromium_held.close()
        chromium_held.program = chromium_held.begun.enter_context(chromium())
        chromium_held.failed = request.session.testsfailed
    return chromium_held.program
