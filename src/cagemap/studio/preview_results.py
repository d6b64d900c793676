"""What the tasks of the preview change in the state: models, maps and drawings."""

from __future__ import annotations

import logging
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

from cagemap.studio.landmark_edits import LandmarkEdits
from cagemap.studio.landmark_files import INITIAL_LANDMARK_READERS, earlier_landmarks
from cagemap.studio.landmarks import History, LandmarkList, SideNames
from cagemap.studio.opening import keep_result, with_parts
from cagemap.studio.preview import OPENING_TITLE, Preview
from cagemap.studio.preview_tasks import (
    FindMap,
    ImageUpdate,
    MapUpdate,
    OpenedPair,
    OpenModels,
    ShowBaked,
    ShowImage,
    ShowPosed,
    Task,
)
from cagemap.studio.recorded_match import lost_welds
from cagemap.studio.scene import Scene, propose_place
from cagemap.studio.skins import PreviewMap
from cagemap.studio.state import (
    INITIAL_FIELDS,
    Files,
    MapState,
    RunningJob,
    View,
    image_uv_set,
    layout_mesh,
    map_view,
)
from cagemap.studio.worker import CANCELLED_KIND, STOPPED_KIND, Failure
from cagemap.tasks.match import ComputedMatch

log = logging.getLogger(__name__)


class PreviewResults(LandmarkEdits):
    """Starts tasks of the preview process, and changes the state by their results.

    ``vertices``: approximate number of vertices of each previewed surface.
    ``folder``: receives an image that is inside the source's file; earlier versions saved landmarks there.
    """

    def __init__(self, vertices: int, folder: Path) -> None:
        super().__init__()
        self._folder = folder
        self._cancelled = False
        self._requested_parts: SideNames = (None, None)
        self._computed: ComputedMatch | None = None
        self._checked_constraints: tuple[object, ...] = ()  # of the last checked map
        self._preview = Preview(
            vertices, folder, self._preview_inputs, lambda job: self._change(preview_job=job), self._receive
        )

    def show(self, view: View) -> None:
        """Set the view."""
        with self._lock:
            before = self._state.view
            is_same_drawing = (view.pose, view.baked) == (before.pose, before.baked)
            self._change(view=view, probe=self._state.probe if is_same_drawing else None)
            if view.pose != before.pose and self._scene is not None:
                self._preview.request("pose", view.pose)
            if view.baked is not None and view.baked != before.baked and self._scene is not None:
                self._draw_baked(view.baked)

    def _draw_baked(self, image: Path) -> None:
        """Request a drawing of the target with a baked image."""
        state = self._state
        self._preview.request("baked", image, layout_mesh(state, image), image_uv_set(state, image))

    def _open_pair(self, files: Files, requested_parts: SideNames) -> None:
        """Open models; if that fails, `_apply_failure` tries again with the requested parts."""
        with self._lock:
            self._scene, self._computed, self._requested_parts = None, None, requested_parts
            job, fields, before = RunningJob(OPENING_TITLE), dict(INITIAL_FIELDS), self._state.files
            models = files.target, files.source
            if before is None or (before.target, before.source) != models:
                fields["models"] = models
            if files.recorded_match is not None:
                fields["map"] = MapState(sought_answer=files.recorded_match.answer_name)
            self._change(files=files, view=map_view(self._state.view), preview_job=job, **fields)
            self._preview.open(files)

    def _preview_inputs(self) -> tuple[LandmarkList, PreviewMap | None, int | str]:
        state, scene = self._state, self._scene
        answer = state.map.sought_answer or state.map.chosen_answer
        return state.history.present, None if scene is None else scene.preview_map, answer

    def _receive(self, task: Task, result: object) -> None:
        is_unchecked = isinstance(result, MapUpdate) and result.map_state.unchecked
        with self._lock:
            with self.report_errors():
                self._apply_result(task, result, is_unchecked=is_unchecked)
            # Under the lock: nobody cancels a finished task. After the result: no page shows the old map as finished.
            if not is_unchecked:
                self._change(preview_job=None)

    def _apply_result(self, task: Task, result: object, *, is_unchecked: bool) -> None:
        cancelled, self._cancelled = self._cancelled, self._cancelled and is_unchecked
        if task.pair_files != self._preview.pair_files or (is_unchecked and cancelled):  # other models are open by now
            return
        files, ups = self._state.files, task.pair_files.ups
        if files is not None and self._scene is not None and files.ups != ups and not isinstance(result, Failure):
            self._scene = self._scene.turned(ups)
            self._change(files=replace(files, ups=ups))
        match task, result:
            case _, Failure() as failure:
                self._apply_failure(task, failure, cancelled=cancelled)
            case _, OpenedPair() as opened:
                self._apply_models(opened)
            case _ if self._scene is None:  # the same models are being opened again
                return
            case FindMap() as search, MapUpdate() as update:
                self._apply_map(self._scene, search, update)
            case _, ImageUpdate(skins, texture, notes):
                self._show_skins(skins)
                if files is not None:
                    self._change(files=replace(files, ups=ups, texture=texture))
                self._say_all(notes)
            case ShowBaked(image=image), bytes() as skin:
                if image == self._state.view.baked:
                    self._show_skins((skin, self._scene.skins[1]))
            case ShowPosed(pose=pose), (bytes() as target, bytes() as source):
                if pose == self._state.view.pose:
                    self._show_skins((target, source))
            case _:
                log.warning("unexpected result %r of %r", type(result), type(task))

    def _apply_failure(self, task: Task, failure: Failure, *, cancelled: bool) -> None:
        """Say why a task failed; open the requested parts if those of the autosave do not exist any more."""
        if self._state.map.unchecked:  # the map shown will not be checked
            self._change(map=self._state.map.without_findings())
        if isinstance(task, ShowImage) and self._state.files is not None:
            self._preview.set_image(self._state.files.texture)
        if failure.kind == CANCELLED_KIND:  # the same models were opened again
            return
        if cancelled and failure.kind == STOPPED_KIND:
            has_checked_map = self._state.map.revision and not self._state.map.unchecked
            self._say("note", "cancelled" + ("; the map stays as it was" if has_checked_map else ""))
            return
        self._say_all(failure.notes)
        is_ours = failure.kind.isidentifier()  # the text of an internal error names its class
        self._say("error", failure.message if is_ours else f"{failure.kind}: {failure.message}")
        files = self._state.files
        if isinstance(task, OpenModels) and files is not None and files.parts != self._requested_parts:
            self._open_pair(replace(files, parts=self._requested_parts), self._requested_parts)

    def _apply_map(self, before: Scene, task: FindMap, update: MapUpdate) -> None:
        """Show a map; one that is checked also turns the source."""
        target, source = update.skins
        scene = replace(before, preview_map=update.preview_map, skins=(target, source or before.skins[1]))
        if not update.map_state.unchecked:
            scene = replace(scene, source=scene.aligned_source)
            self._checked_constraints = task.landmarks.constraints
        self._scene, self._computed = scene, update.computed
        if before.preview_map is None or scene.source is not before.source:
            scene.warm_up()  # not earlier: the page loads the models first
        present, job = self._state.history.present, self._state.preview_job
        seconds = 0.0 if job is None else time.monotonic() - job.begun
        sought, found = self._state.map.sought_answer, update.map_state
        if sought and not found.unchecked and found.answer_name != sought:
            self._keep_recorded_result(f"its alignment, {sought}, which the map here does not start from")
        map_state = found.rename_landmarks(task.landmarks, present).following(self._state.map, seconds)
        self._change(map=map_state, proposal=propose_place(scene, present), probe=None)

    def _show_skins(self, skins: tuple[bytes, bytes]) -> None:
        assert self._scene is not None
        self._scene = replace(self._scene, skins=skins)
        self._change()

    def _apply_models(self, opened: OpenedPair) -> None:
        """Show opened models, and record how they were opened for the finish."""
        target, source = opened.target, opened.source
        self._scene = opened.scene
        if self._state.files is not None:
            files = with_parts(self._state.files, (target.part_choices.opened, source.part_choices.opened))
            schemes, welds = (target.scheme, source.scheme), (target.weld, source.weld)
            files = replace(files, target=target.path or files.target, source=source.path or files.source)
            if (recorded := files.recorded_match) is not None:
                files, notes = keep_result(files, lost_welds(recorded.request, welds))
                self._say_all((*recorded.notes, *notes))
                files = replace(files, recorded_match=replace(recorded, notes=()))
            self._change(files=replace(files, schemes=schemes, welds=welds, texture=source.texture))
        self._say_all(target.notes + source.notes)
        self._load_initial_landmarks()

    def _keep_recorded_result(self, *lost_options: str) -> None:
        """Write another folder than the opened RESULT, and say so, if its match cannot be repeated here."""
        files, _ = self._require_open()
        files, notes = keep_result(files, lost_options)
        self._change(files=files)
        self._say_all(notes)

    def _load_initial_landmarks(self) -> None:
        """Load unsaved landmarks, or else those of the pair's file or of earlier versions, and request the map."""
        files, scene = self._require_open()
        for read, saved in (*INITIAL_LANDMARK_READERS, (partial(earlier_landmarks, folder=self._folder), False)):
            is_read = False
            with self.report_errors():
                loaded = read(files, scene, self._tracker)
                is_read = True
                if loaded is not None:
                    landmarks, notes = loaded
                    self._change(history=History(landmarks), saved=saved)
                    self._say_all(notes)
                    break
            if not is_read:
                self._keep_recorded_result("landmarks that cannot be used")
        self._request_map(fresh=True)

    def _request_map(self, *, fresh: bool) -> None:
        if self._scene is not None:
            self.show(map_view(self._state.view))  # a baked image shows an earlier map
            self._preview.find(fresh=fresh)
