"""Edits of landmarks: each is one step of the history, is kept in the autosave, and updates the map."""

from __future__ import annotations

from collections.abc import Callable

from cagemap.errors import ParameterError
from cagemap.numerics.arrays import FloatArray
from cagemap.studio import landmarks as edit
from cagemap.studio.autosave import FileTracker
from cagemap.studio.landmark_files import autosave_models, to_file_numbers
from cagemap.studio.landmarks import History, LandmarkList, Place, Side
from cagemap.studio.places import hit_place, vertex_place
from cagemap.studio.scene import add_counterpart, add_mirror_image, propose_place
from cagemap.studio.shape import pick
from cagemap.studio.shared_state import SharedState


class LandmarkEdits(SharedState):
    """The shared state, and what a page can do with its landmarks."""

    def __init__(self) -> None:
        super().__init__()
        self._tracker = FileTracker()

    def click(self, side: Side, origin: FloatArray, direction: FloatArray) -> None:
        """Place a landmark under the mouse."""
        with self.report_errors(), self._lock:
            place = self.place_on_ray(side, origin, direction)
            if place is not None:
                self._edit(lambda present: edit.add_place(present, side, place), select=True)

    def place_on_ray(self, side: Side, origin: FloatArray, direction: FloatArray) -> Place | None:
        """Place where a ray of the view first meets a model."""
        scene = self._scene
        hit = None if scene is None else pick(scene.shape(side), origin, direction)
        return None if scene is None or hit is None else hit_place(scene.shape(side), hit)

    def accept(self) -> None:
        """Complete the open landmark at the proposed place."""
        with self.report_errors(), self._lock:
            proposal = self._state.proposal
            if proposal is None:
                raise ParameterError("Accept: expected a proposed place, there is none. Click a model first.")
            self._edit(lambda present: edit.move(present, proposal.number, proposal.side, proposal.place))

    def next_landmark(self) -> None:
        """Start a landmark at the suggested vertex, with a proposed place on the source."""
        with self.report_errors(), self._lock:
            _, scene = self._require_open()
            vertex = self._state.map.suggestion
            if vertex is None:
                raise ParameterError("Next landmark: expected a map, there is none yet. Wait for the first one.")
            self._edit(lambda present: edit.begin(present, "target", vertex_place(scene.target, vertex)), select=True)

    def move(self, number: int, side: Side, origin: FloatArray, direction: FloatArray) -> None:
        """Move a landmark on one model to the surface point under the mouse; nothing if there is none."""
        place = self.place_on_ray(side, origin, direction)
        if place is not None:
            self._edit(lambda present: edit.move(present, number, side, place))

    def remove(self, number: int) -> None:
        """Remove a landmark."""
        self._edit(lambda present: edit.remove(present, number))

    def rename(self, number: int, name: str) -> None:
        """Rename a landmark."""
        with self.report_errors(), self._lock:
            self._set_history(self._state.history.rename_landmark(number, name))

    def mirror(self, number: int) -> None:
        """Add the mirror image of a landmark."""
        with self.report_errors(), self._lock:
            _, scene = self._require_open()
            before = self._state.history.present
            after = add_mirror_image(scene, before, number)
            if after == before:
                raise ParameterError(
                    "Mirror: expected a complete landmark of two symmetric models that is not on the mirror plane, and "
                    "none at its mirror image yet. Place the mirrored landmark by hand."
                )
            self._edit(lambda _: after)

    def undo(self) -> None:
        """Undo the last edit of landmarks."""
        with self.report_errors(), self._lock:
            self._set_history(self._state.history.undo())

    def redo(self) -> None:
        """Redo the last undone edit."""
        with self.report_errors(), self._lock:
            self._set_history(self._state.history.redo())

    def select(self, number: int | None) -> None:
        """Select a landmark."""
        self._change(selected=number)

    def _edit(self, change: Callable[[LandmarkList], LandmarkList], *, select: bool = False) -> None:
        with self.report_errors(), self._lock:  # another page may edit at the same time
            before = self._state.history.present
            landmarks = change(before)
            if self._state.view.symmetric and self._scene is not None:
                landmarks = add_counterpart(self._scene, before, landmarks)
            self._set_history(self._state.history.advance(landmarks))
            if select and landmarks.items:
                self._change(selected=(landmarks.open_landmark or before.open_landmark or landmarks.items[-1]).number)

    def _set_history(self, history: History) -> None:
        before, after = self._state.history.present, history.present
        if history == self._state.history:
            return
        files, scene = self._state.files, self._scene
        if files is not None and scene is not None:  # before the page shows the edit, so that it cannot be lost
            with self.report_errors():
                landmarks, models = to_file_numbers(after, scene), autosave_models(files, scene)
                self._say_all(self._tracker.autosave(files.landmarks, landmarks, files.parts, models))
        map_state = self._state.map.rename_landmarks(before, after)
        proposal = propose_place(self._scene, after)
        self._change(history=history, saved=False, map=map_state, proposal=proposal, probe=None)
        if after.get(self._state.selected) is None:
            self._change(selected=None)
        if after.constraints != before.constraints:
            self._request_map(fresh=False)

    def _request_map(self, *, fresh: bool) -> None:
        raise NotImplementedError
