"""Linked cameras: whatever order poses and reports come in, all frames end at the pose that was asked for last."""

from __future__ import annotations

import contextlib
from collections import deque
from collections.abc import Callable, Coroutine
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cagemap.studio.page.cameras import Cameras
from cagemap.studio.page.view import FIRST_VIEW

BEGUN = (3.0, 3.0, 3.0)
TURNED = (0.0, 3.3, 0.2)


class Camera:
    """viser's handle: what was reported or assigned last; an assignment of what it holds is not sent."""

    def __init__(self, frame: Frame) -> None:
        self._frame = frame
        self.look_at, self.up_direction = np.zeros(3), np.array([0.0, 1.0, 0.0])
        self.held = np.array(BEGUN)
        self.callbacks: list[Callable[[Any], Coroutine[Any, Any, None]]] = []

    @property
    def position(self) -> np.ndarray:
        return self.held

    @position.setter
    def position(self, value: np.ndarray) -> None:
        if not np.allclose(value, self.held):
            self.held = np.array(value)
            self._frame.told.append(tuple(value))

    def on_update(self, callback: Callable[[Any], Coroutine[Any, Any, None]]) -> None:
        self.callbacks.append(callback)


class Frame:
    """A browser's frame: it begins somewhere, takes the first view later, and reports every pose that it takes."""

    def __init__(self, connect: Callable[[Any], Coroutine[Any, Any, None]]) -> None:
        self.pose: tuple[float, ...] = BEGUN
        self.told: deque[tuple[float, ...]] = deque([FIRST_VIEW])
        self.reports: deque[tuple[float, ...]] = deque([BEGUN])
        self.camera, self._connect, self._connected = Camera(self), connect, False

    @contextlib.contextmanager
    def atomic(self) -> Any:
        yield

    def take(self, pose: tuple[float, ...]) -> None:
        if pose != self.pose:
            self.pose = pose
            self.reports.append(pose)

    def hear(self) -> bool:
        """Take the next pose that was sent."""
        if self.told:
            self.take(self.told.popleft())
            return True
        return False

    def say(self) -> bool:
        """Have the next report arrive."""
        if not self.reports:
            return False
        self.camera.held = np.array(self.reports.popleft())
        if not self._connected:
            self._connected = True
            done(self._connect(self))
        for callback in self.camera.callbacks:
            done(callback(self.camera))
        return True


def done(call: Coroutine[Any, Any, None]) -> None:
    """Run what awaits nothing."""
    with contextlib.suppress(StopIteration):
        call.send(None)


def linked(count: int, *, together: bool = True) -> tuple[Cameras, list[Frame]]:
    connects: list[Any] = []
    servers = [
        SimpleNamespace(on_client_connect=connects.append, on_client_disconnect=lambda _: None) for _ in range(count)
    ]
    session = SimpleNamespace(state=SimpleNamespace(view=SimpleNamespace(linked=together)))
    cameras = Cameras(session, tuple(servers), FIRST_VIEW)  # type: ignore[arg-type]
    return cameras, [Frame(connect) for connect in connects]


def drain(frames: list[Frame]) -> None:
    for _ in range(200):
        if not any([frame.hear() for frame in frames] + [frame.say() for frame in frames]):
            return
    pytest.fail("the frames tell each other of poses without end")


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 1), st.booleans()), max_size=20), st.integers(0, 1))
def test_frames_end_at_the_pose_asked_for_in_whatever_order_messages_come(
    order: list[tuple[int, bool]], hand: int
) -> None:
    cameras, (*frames, late) = linked(3)
    for which, hears in order:
        frames[which].hear() if hears else frames[which].say()
    drain(frames)
    assert [frame.pose for frame in frames] == [FIRST_VIEW] * 2
    for share in (0.3, 0.7, 1.0):  # turned by hand
        frames[hand].take(tuple(np.array(FIRST_VIEW) + share * (np.array(TURNED) - np.array(FIRST_VIEW))))
        for which, hears in order[:5]:
            frames[which].hear() if hears else frames[which].say()
    drain(frames)
    drain([*frames, late])  # opened only now, it takes the pose of the others
    assert np.allclose([frame.pose for frame in (*frames, late)], TURNED)
    cameras.frame()
    drain(frames)
    assert [frame.pose for frame in frames] == [FIRST_VIEW] * 2


def test_a_frame_that_connects_again_keeps_its_own_view() -> None:
    _, (frame,) = linked(1, together=False)
    frame.pose, frame.told, frame.reports = TURNED, deque(), deque([TURNED])
    drain([frame])
    assert frame.pose == TURNED
