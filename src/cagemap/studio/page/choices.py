"""Dropdowns of files, all brought up to date when one is added."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from cagemap.studio.workspace import Workspace

NONE = "(none)"


class Choices:
    """Makes dropdowns of a workspace's files."""

    def __init__(self, workspace: Workspace) -> None:
        self._workspace = workspace
        self._made: list[tuple[Any, tuple[str, ...]]] = []

    def dropdown(self, gui: Any, label: str, suffixes: tuple[str, ...], hint: str | None = None) -> Any:
        """A dropdown of the files with these suffixes, or none."""
        handle = gui.add_dropdown(label, (NONE, *self._workspace.listing(suffixes)), hint=hint)
        self._made.append((handle, suffixes))
        return handle

    def refresh(self) -> None:
        """List what is there now; what is chosen stays chosen."""
        for handle, suffixes in self._made:
            value, listed = handle.value, (NONE, *self._workspace.listing(suffixes))
            listed = listed if value in listed else (*listed, value)
            if tuple(handle.options) != listed:
                handle.options = listed
                put(handle, "value", value)

    def path(self, handle: Any) -> Path | None:
        """The chosen file.

        Raises
        ------
        ParameterError
            If it lies outside the workspace.
        """
        return None if handle.value == NONE else self._workspace.require(handle.value)

    def choose(self, handle: Any, path: Path | None) -> None:
        """Show a file as the chosen one, also one that is not listed."""
        name = NONE if path is None else self._workspace.show(path)
        if name not in handle.options:
            handle.options = (*handle.options, name)
        put(handle, "value", name)


def put(handle: Any, name: str, value: Any) -> None:
    """Assign only what differs: an assignment is a message to every page."""
    if getattr(handle, name) != value:
        setattr(handle, name, value)
