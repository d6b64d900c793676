"""Turning one model turns the other: cameras of all frames follow the one that moved."""

from __future__ import annotations

import threading
from dataclasses import dataclass

import numpy as np
import viser

from cagemap.numerics.arrays import FloatArray
from cagemap.studio.session import Session

# Poses closer than this, of a model's radius, are the same: frames answer a pose with their own rounding of it.
_SAME = 2e-3


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


class Cameras:
    """Links the cameras of several viser servers while the session's view says so."""

    def __init__(self, session: Session, servers: tuple[viser.ViserServer, ...]) -> None:
        self._session, self._servers = session, servers
        self._lock = threading.Lock()
        self._last: Pose | None = None
        for server in servers:
            server.on_client_connect(self._connected)

    def frame(self, position: tuple[float, float, float]) -> None:
        """Put every camera back to where it looks at the whole model."""
        pose = Pose(np.array(position), np.zeros(3), np.array([0.0, 1.0, 0.0]))
        with self._lock:
            self._last = pose
            for client in self._clients():
                _set(client, pose)

    def _clients(self) -> list[viser.ClientHandle]:
        return [client for server in self._servers for client in server.get_clients().values()]

    def _connected(self, client: viser.ClientHandle) -> None:
        with self._lock:
            if self._last is not None and self._session.state.view.linked:
                _set(client, self._last)
        client.camera.on_update(lambda _: self._moved(client))

    def _moved(self, client: viser.ClientHandle) -> None:
        if not self._session.state.view.linked:
            return
        camera = client.camera
        pose = Pose(camera.position, camera.look_at, camera.up_direction)
        with self._lock:
            if self._last is not None and pose.near(self._last):
                return
            self._last = pose
            for other in self._clients():
                if other is not client:
                    _set(other, pose)


def _set(client: viser.ClientHandle, pose: Pose) -> None:
    with client.atomic():
        client.camera.position = pose.position
        client.camera.look_at = pose.look_at
        client.camera.up_direction = pose.up
