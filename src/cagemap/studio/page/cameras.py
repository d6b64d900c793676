"""Turning one model turns the other: cameras of all frames follow the one that moved.

viser reports every pose that a camera takes, whoever asked for it. A frame that was told a pose is listened to again
once it has reported that pose: what comes before was on its way, or is what viser begins with. Without this, two frames
told of each other's former poses, and could end with a first view that nobody asked for.
"""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
import viser

from cagemap.numerics.arrays import FloatArray
from cagemap.studio.session import Session

# Poses closer than this, of a model's radius, are the same: frames answer a pose with their own rounding of it.
_SAME = 2e-3
# Seconds after which a frame that reports something else than it was told has been moved by hand since.
_LATE = 3.0


@dataclass(frozen=True, eq=False)
class Pose:
    """Where a camera is; models have their centre at 0 and radius 1 in both frames."""

    position: FloatArray
    look_at: FloatArray
    up: FloatArray

    def near(self, other: Pose) -> bool:
        """Whether another pose is the same."""
        pairs = ((self.position, other.position), (self.look_at, other.look_at), (self.up, other.up))
        return all(np.abs(one - two).max() < _SAME for one, two in pairs)


@dataclass
class _Frame:
    """A connected frame: what it was told and has not reported yet, and since when; whether it ever reported a pose."""

    told: Pose | None
    since: float
    arrived: bool = False


class Cameras:
    """Links the cameras of several viser servers while the session's view says so.

    Parameters
    ----------
    session : Session
    servers : tuple of viser.ViserServer
    first : (x, y, z)
        Where cameras are at first, looking at the whole model.
    """

    def __init__(
        self, session: Session, servers: tuple[viser.ViserServer, ...], first: tuple[float, float, float]
    ) -> None:
        self._session = session
        self._first = Pose(np.array(first), np.zeros(3), np.array([0.0, 1.0, 0.0]))
        self._lock = threading.Lock()
        self._last = self._first
        self._frames: dict[Any, _Frame] = {}
        for server in servers:
            server.on_client_connect(self._connected)
            server.on_client_disconnect(self._disconnected)

    def frame(self) -> None:
        """Put every camera back to where it looks at the whole model."""
        with self._lock:
            self._last = self._first
            for client in self._frames:
                self._tell(client, self._first)

    # viser awaits what is async, so that poses are taken in the order in which they came.

    async def _connected(self, client: viser.ClientHandle) -> None:
        with self._lock:
            # Alone, a frame has its first view from viser, or comes back with the one that it had.
            pose = self._last if self._session.state.view.linked else None
            self._frames[client] = _Frame(pose, time.monotonic())

        async def moved(_: viser.CameraHandle) -> None:
            self._moved(client)

        client.camera.on_update(moved)

    async def _disconnected(self, client: viser.ClientHandle) -> None:
        with self._lock:
            self._frames.pop(client, None)

    def _moved(self, client: viser.ClientHandle) -> None:
        pose = _pose(client)
        with self._lock:
            frame = self._frames.get(client)
            if frame is None or self._awaits(client, frame, pose):
                return
            if pose.near(self._last) or not self._session.state.view.linked:
                return
            self._last = pose
            for other in self._frames:
                if other is not client:
                    self._tell(other, pose)

    def _awaits(self, client: viser.ClientHandle, frame: _Frame, pose: Pose) -> bool:
        """Whether a report only answers what the frame was told, or comes from before that."""
        if frame.told is None:
            return False
        if pose.near(frame.told):
            frame.told, frame.arrived = None, True
            return True
        if not frame.arrived:  # also its first report, which comes right after the connection
            _set(client, frame.told)
            return True
        if time.monotonic() < frame.since + _LATE:
            return True
        frame.told = None
        return False

    def _tell(self, client: viser.ClientHandle, pose: Pose) -> None:
        frame = self._frames[client]
        if frame.told is None and pose.near(_pose(client)):  # it would not answer
            return
        frame.told, frame.since = pose, time.monotonic()
        _set(client, pose)


def _pose(client: viser.ClientHandle) -> Pose:
    camera = client.camera
    return Pose(camera.position, camera.look_at, camera.up_direction)


def _set(client: viser.ClientHandle, pose: Pose) -> None:
    with client.atomic():
        client.camera.position = pose.position
        client.camera.look_at = pose.look_at
        client.camera.up_direction = pose.up
