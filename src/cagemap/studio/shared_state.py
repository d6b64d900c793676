"""State shared by all pages, behind a lock, with listeners and messages."""

from __future__ import annotations

import contextlib
import logging
import threading
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

from cagemap.errors import CagemapError, ParameterError
from cagemap.studio.finish_layout import in_page_words
from cagemap.studio.scene import Scene
from cagemap.studio.state import Files, Message, MessageKind, StudioState, add_message

log = logging.getLogger(__name__)

Listener = Callable[[StudioState, Scene | None], None]


class SharedState:
    """The state and the scene of a `cagemap.studio.session.Session`."""

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._state = StudioState()
        self._scene: Scene | None = None
        self._listeners: list[Listener] = []

    @property
    def state(self) -> StudioState:
        """The current state."""
        return self._state

    @property
    def scene(self) -> Scene | None:
        """The current models and map."""
        return self._scene

    def subscribe(self, listener: Listener) -> None:
        """Call a function now and after every change."""
        with self._lock:
            self._listeners.append(listener)
            listener(self._state, self._scene)

    def note(self, text: str) -> None:
        """Show a note."""
        self._say("note", text)

    def _say(self, kind: MessageKind, text: str) -> None:
        with self._lock:
            self._change(messages=add_message(self._state.messages, kind, in_page_words(text)))

    def _say_all(self, texts: Iterable[str], kind: MessageKind = "note") -> None:
        for text in texts:
            self._say(kind, text)

    def answer_error(self, error: Message | None) -> None:
        """Remove an error from the status line after an action that caused no new error."""
        with self._lock:
            if error is not None and self._state.error is error:
                self._change(answered_error=error)

    def _change(self, **fields: object) -> None:
        with self._lock:
            self._state = replace(self._state, **fields)  # type: ignore[arg-type]
            for listener in self._listeners:
                listener(self._state, self._scene)

    @contextlib.contextmanager
    def report_errors(self) -> Iterator[None]:
        """Show errors as messages of the page."""
        try:
            yield
        except CagemapError as error:
            self._say("error", str(error))
        except OSError as error:
            self._say("error", f"{error.filename or 'file'}: {error.strerror or error}")
        except Exception as error:  # a bug must not end the studio
            log.exception("internal error")
            self._say("error", f"internal error, {type(error).__name__}: {error}")

    def _require_open(self) -> tuple[Files, Scene]:
        if self._state.files is None or self._scene is None:
            raise ParameterError("expected two open models, there are none yet. Choose a target and a source.")
        return self._state.files, self._scene
