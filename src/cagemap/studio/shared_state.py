"""A state that all pages show: held under a lock, told to listeners after every change, errors in it as messages."""

from __future__ import annotations

import contextlib
import logging
import threading
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

from cagemap.errors import CagemapError, use_option_names
from cagemap.studio.scene import Scene
from cagemap.studio.state import Studio, with_message

log = logging.getLogger(__name__)

Listener = Callable[[Studio, Scene | None], None]


class Held:
    """The state and the scene; what may be done to them is `cagemap.studio.session.Session`."""

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._state = Studio()
        self._scene: Scene | None = None
        self._listeners: list[Listener] = []

    @property
    def state(self) -> Studio:
        """The state now."""
        return self._state

    @property
    def scene(self) -> Scene | None:
        """Models and map now."""
        return self._scene

    def subscribe(self, listener: Listener) -> None:
        """Have a function told of every change, after it."""
        with self._lock:
            self._listeners.append(listener)
            listener(self._state, self._scene)

    def report(self, error: CagemapError) -> None:
        """Show an error."""
        self._say("error", f"{type(error).__name__}: {error}")

    def _say(self, kind: str, text: str) -> None:
        with self._lock:
            self._change(messages=with_message(self._state.messages, "error" if kind == "error" else "note", text))

    def _notes(self, notes: Iterable[str], kind: str = "note") -> None:
        for note in notes:
            self._say(kind, use_option_names(note))

    def _change(self, **fields: object) -> None:
        with self._lock:
            self._state = replace(self._state, **fields)  # type: ignore[arg-type]
            for listener in self._listeners:
                listener(self._state, self._scene)

    @contextlib.contextmanager
    def guarded(self) -> Iterator[None]:
        """Turn errors into messages of the page."""
        try:
            yield
        except CagemapError as error:
            self.report(error)
        except OSError as error:
            self._say("error", f"{error.filename or 'file'}: {error.strerror or error}")
        except Exception as error:  # a fault of ours must not end the studio
            log.exception("internal error")
            self._say("error", f"internal error, {type(error).__name__}: {error}")
