"""One model in its frame: skin, cage, landmarks, clicks, and the camera that both frames may share."""

from __future__ import annotations

import threading
from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from typing import Any

import numpy as np
import viser

from cagemap.mesh.curves import Curves
from cagemap.numerics.arrays import FloatArray
from cagemap.studio.landmarks import Side
from cagemap.studio.page.colors import Color, landmark_color
from cagemap.studio.scene import Scene
from cagemap.studio.session import Session
from cagemap.studio.shape import Shape
from cagemap.studio.state import Probe, Studio

# Of a model's radius.
MARKER = 0.016
SELECTED_MARKER = 0.026
LABEL_HEIGHT = 0.05
# Radians, vertically: little perspective, as modellers like it.
FIELD_OF_VIEW = 0.6
FIRST_VIEW = (0.95, 0.65, 3.1)
PROBE = 0.02
# Seconds that a skin stays under the one that replaces it.
LINGER = 0.5
CURVE_LIFT = 0.004
PROBE_COLOR: Color = (255, 255, 255)
CAGE_COLOR = (90, 170, 255)
CONTRADICTED: Color = (255, 30, 30)
# A click whose ray passes a marker this closely, in its radii, selects it.
_GRIP = 1.6
# Rays start this far before a marker: what lies behind the model's surface cannot be clicked.
_BEHIND = 0.06


@dataclass(frozen=True)
class Marker:
    """A landmark's end, as it is drawn."""

    number: int
    label: str
    position: tuple[float, float, float]
    color: Color
    radius: float
    solid: bool


def markers_of(state: Studio, shape: Shape, side: Side) -> dict[int, Marker]:
    """Markers of one model: every landmark that has a place there, and what the map proposes for the open one."""
    made = {}
    proposal = state.proposal
    for item in state.history.present.items:
        place, solid = item.on(side), True
        if place is None and proposal is not None and (proposal.number, proposal.side) == (item.number, side):
            place, solid = proposal.place, False
        if place is None:
            continue
        wrong = item.name in state.map.contradictions
        x, y, z = shape.to_view(np.array(place.position)).tolist()
        made[item.number] = Marker(
            item.number,
            f"{item.number} !" if wrong else str(item.number) + ("" if solid else " ?"),
            (x, y, z),
            CONTRADICTED if wrong else landmark_color(item.number),
            SELECTED_MARKER if item.number == state.selected else MARKER,
            solid,
        )
    return made


class ModelView:
    """One of the two frames.

    Parameters
    ----------
    server : viser.ViserServer
    side : str
    session : Session
    """

    def __init__(self, server: viser.ViserServer, side: Side, session: Session) -> None:
        self.server, self.side, self._session = server, side, session
        self._skin: bytes | None = None
        self._skin_node: Any = None
        self._count = 0
        self._shape: Shape | None = None
        self._cage: Any = None
        self._probe: Any = None
        self._lines: Any = None
        self._curves: Curves | None = None
        self._curved: Shape | None = None
        self._markers: dict[int, tuple[Marker, Any, Any]] = {}
        server.scene.set_up_direction("+y")
        server.scene.world_axes.visible = False
        # Skins carry their light (`glb`); what is left to light are the landmarks' balls.
        server.scene.configure_default_lights(enabled=False)
        server.scene.configure_environment_map(None)
        server.scene.add_light_hemisphere("/light", ground_color=(90, 90, 90), intensity=3.0)
        server.initial_camera.position = FIRST_VIEW
        server.initial_camera.fov = FIELD_OF_VIEW
        server.initial_camera.look_at = (0.0, 0.0, 0.0)
        server.initial_camera.near = 0.005
        server.scene.on_click()(self._clicked)
        server.scene.on_click(modifier="shift")(self._probed)

    def refresh(self, state: Studio, scene: Scene | None) -> None:
        """Show the state as it is now."""
        if scene is None:
            return
        shape = scene.shape(self.side)
        with self.server.atomic():
            if self._shape is not shape:
                self._shape = shape
                self._hide_cage()
            self._show_skin(scene.skins[0 if self.side == "target" else 1])
            self._show_cage(shape, visible=state.view.cages)
            self._show_markers(markers_of(state, shape, self.side))
            self._show_curves(state.history.present.curves, shape)
            self._show_probe(state.probe, shape)

    def _show_curves(self, curves: Curves | None, shape: Shape) -> None:
        """Lines on the model, coloured alike on both."""
        if curves is self._curves and shape is self._curved:
            return
        self._curves, self._curved = curves, shape
        if self._lines is not None:
            self._lines.remove()
            self._lines = None
        if curves is None:
            return
        side = curves.target if self.side == "target" else curves.source
        points = shape.positions[side.points.vertices] + CURVE_LIFT * shape.radius * shape.normals[side.points.vertices]
        colors = np.array([landmark_color(number + 1) for number in side.curve_of], dtype=np.uint8)
        self._lines = self.server.scene.add_line_segments(
            "/curves",
            shape.to_view(points)[side.segments].astype(np.float32),
            colors=colors[side.segments],
            thickness=3.0,
            thickness_units="screen",
        )

    def _show_probe(self, probe: Probe | None, shape: Shape) -> None:
        """A white ball where the probe is on this model."""
        position = None if probe is None else probe.target if self.side == "target" else probe.source
        if position is None:
            if self._probe is not None:
                self._probe.visible = False
            return
        if self._probe is None:
            self._probe = self.server.scene.add_icosphere(
                "/probe", radius=PROBE, color=PROBE_COLOR, cast_shadow=False, receive_shadow=False
            )
        self._probe.position = shape.to_view(np.array(position))
        self._probe.visible = True

    def _show_skin(self, skin: bytes) -> None:
        if skin is self._skin:
            return
        self._count += 1
        old, self._skin = self._skin_node, skin
        self._skin_node = self.server.scene.add_glb(
            f"/skin/{self._count}", skin, cast_shadow=False, receive_shadow=False
        )
        if old is not None:
            # The browser reads the new skin meanwhile; without the old one the model would blink.
            timer = threading.Timer(LINGER, old.remove)
            timer.daemon = True
            timer.start()

    def _show_cage(self, shape: Shape, *, visible: bool) -> None:
        """The control mesh's edges; they are sent when they are first asked for."""
        if self._cage is not None:
            self._cage.visible = visible
        elif visible:
            points = shape.to_view(shape.edges).astype(np.float32)
            self._cage = self.server.scene.add_line_segments(
                "/cage", points, colors=CAGE_COLOR, thickness=1.0, thickness_units="screen"
            )

    def _hide_cage(self) -> None:
        if self._cage is not None:
            self._cage.remove()
            self._cage = None

    def _show_markers(self, wanted: dict[int, Marker]) -> None:
        for number in [number for number in self._markers if number not in wanted]:
            for node in self._markers.pop(number)[1:]:
                node.remove()
        for number, marker in wanted.items():
            old = self._markers.get(number)
            if old is not None and old[0] == marker:
                continue
            self._markers[number] = (marker, *self._draw(marker))

    def _draw(self, marker: Marker) -> tuple[Any, Any]:
        ball = self.server.scene.add_icosphere(
            f"/landmarks/{marker.number}",
            radius=marker.radius,
            color=marker.color,
            opacity=None if marker.solid else 0.5,
            position=marker.position,
            cast_shadow=False,
            receive_shadow=False,
        )
        label = self.server.scene.add_label(
            f"/labels/{marker.number}",
            marker.label,
            position=marker.position,
            font_size_mode="scene",
            font_scene_height=LABEL_HEIGHT,
            depth_test=True,
            anchor="bottom-left",
        )
        if marker.solid:
            ball.on_drag("left")(self._dragger(marker.number))
        return ball, label

    def _clicked(self, event: viser.SceneClickEvent) -> None:
        origin, direction = np.array(event.ray_origin), np.array(event.ray_direction)
        number = self._marker_under(origin, direction)
        if number is not None:
            self._session.select(number)
        else:
            self._session.click(self.side, origin, direction)

    def _probed(self, event: viser.SceneClickEvent) -> None:
        self._session.probe(self.side, np.array(event.ray_origin), np.array(event.ray_direction))

    def _marker_under(self, origin: FloatArray, direction: FloatArray) -> int | None:
        """Landmark whose marker a ray meets, in front of the model."""
        if self._shape is None:
            return None
        place = self._session.place_under(self.side, origin, direction)
        far = np.inf
        if place is not None:
            far = float(np.linalg.norm(self._shape.to_view(np.array(place.position)) - origin)) + _BEHIND
        best: tuple[float, int] | None = None
        for number, (marker, *_) in list(self._markers.items()):
            offset = np.array(marker.position) - origin
            along = float(offset @ direction)
            away = float(np.linalg.norm(offset - along * direction))
            if marker.solid and 0 < along < far and away < _GRIP * marker.radius and (best is None or away < best[0]):
                best = away, number
        return None if best is None else best[1]

    def _dragger(self, number: int) -> Callable[[viser.SceneNodeDragEvent[Any]], Coroutine[Any, Any, None]]:
        async def dragged(event: viser.SceneNodeDragEvent[Any]) -> None:  # awaited one by one: their order is kept
            origin = np.array(event.client.camera.position)
            direction = np.array(event.end_position) - origin
            place = self._session.place_under(self.side, origin, direction / np.linalg.norm(direction))
            held = self._markers.get(number)
            if held is None or self._shape is None:
                return
            marker, *nodes = held
            if place is not None and event.phase == "end":
                self._session.move(number, self.side, place)
            elif place is not None or event.phase == "end":  # let go beside the model, it returns to where it was
                position = marker.position if place is None else self._shape.to_view(np.array(place.position))
                for node in nodes:
                    node.position = position

        return dragged
