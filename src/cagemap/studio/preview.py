"""The preview's thread: gives the latest requests to the worker and returns the results."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path

from cagemap.studio.compute import FindMap, OpenModels, PairFiles, ShowBaked, ShowPosed, Task
from cagemap.studio.landmarks import LandmarkList
from cagemap.studio.skins import PreviewMap
from cagemap.studio.state import Files, RunningJob
from cagemap.studio.worker import Worker

# Titles of computations on the page.
OPENING_TITLE, MATCHING_TITLE, BAKED_TITLE = "Opening the models", "Matching", "Showing the baked image"
POSE_TITLE = "Showing a pose"
_TITLES = {OpenModels: OPENING_TITLE, FindMap: MATCHING_TITLE, ShowBaked: BAKED_TITLE, ShowPosed: POSE_TITLE}
# Appended to the first title of a kind: the first run compiles.
_COMPILE_NOTE = " (some seconds longer on the first run after installing)"


class Preview:
    """Computes what the page shows; a newer request replaces one that waits.

    Parameters
    ----------
    vertices : int
        Approximate number of vertices of each previewed surface.
    folder : Path
        Receives an image that is inside the source's file.
    current_inputs : callable
        Gives the current landmarks and map when a task starts.
    on_job : callable
        Called at every task and stage, and with None after a task.
    on_result : callable
        Called with a task and its result.
    """

    def __init__(
        self,
        vertices: int,
        folder: Path,
        current_inputs: Callable[[], tuple[LandmarkList, PreviewMap | None]],
        on_job: Callable[[RunningJob | None], None],
        on_result: Callable[[Task, object], None],
    ) -> None:
        self._vertices, self._folder = vertices, folder
        self._current_inputs, self._on_job, self._on_result = current_inputs, on_job, on_result
        self._condition = threading.Condition()
        self._pair_files: PairFiles | None = None
        # Requests that wait.
        self._open_request = False
        self._map_request: bool | None = None  # True: a match from the start
        self._answer_request: int | None = None
        self._baked_request: tuple[Path, Path | None, str | None] | None = None
        self._pose_request: str | None = None
        self._closed = False
        self._title = ""
        self._task: Task | None = None
        self._worker = Worker(
            lambda stage: on_job(RunningJob(self._title, stage)), on_early_result=self._on_early_result
        )
        self._worker.start()
        threading.Thread(target=self._run_tasks, name="studio preview", daemon=True).start()

    def open(self, files: Files) -> None:
        """Open two models; requests and a running map of other models are dropped."""
        with self._condition:
            sides = files.schemes, files.ups, files.parts
            self._pair_files = PairFiles(
                files.target, files.source, files.texture, self._vertices, self._folder, *sides
            )
            task = self._task
            if task is not None and not isinstance(task, OpenModels) and task.pair_files != self._pair_files:
                self._worker.cancel(task)
            self._open_request = True
            self._map_request = self._answer_request = self._baked_request = self._pose_request = None
            self._condition.notify()

    @property
    def pair_files(self) -> PairFiles | None:
        """The pair that is open or about to be."""
        return self._pair_files

    def find(self, *, fresh: bool) -> None:
        """Compute the map, by an update if there is one and ``fresh`` is not set."""
        with self._condition:
            self._map_request = fresh or bool(self._map_request)
            self._condition.notify()

    def choose(self, answer: int) -> None:
        """Compute the map from another alignment found without landmarks."""
        with self._condition:
            self._answer_request = answer
            self._condition.notify()

    def show_baked(self, image: Path, layout: Path | None, uv_set: str | None) -> None:
        """Show a baked image, in a UV set of the target or the layout of a mesh file."""
        with self._condition:
            self._baked_request = image, layout, uv_set
            self._condition.notify()

    def show_posed(self, pose: str) -> None:
        """Show both models in a pose; '': unposed."""
        with self._condition:
            self._pose_request = pose
            self._condition.notify()

    def kill(self) -> None:
        """Kill the running task; its result is a failure."""
        self._worker.kill()

    def close(self) -> None:
        """End the thread and the process."""
        with self._condition:
            self._closed = True
            self._condition.notify()
        self._worker.kill()

    def _on_early_result(self, result: object) -> None:
        if self._task is not None and not self._closed:
            self._on_result(self._task, result)

    def _run_tasks(self) -> None:
        not_run = {OpenModels, FindMap}
        while (task := self._next_task()) is not None:
            self._title = _TITLES[type(task)] + (_COMPILE_NOTE if type(task) in not_run else "")
            self._on_job(RunningJob(self._title))
            self._task = task
            result = self._worker.run(task)
            self._task = None
            not_run.discard(type(task))
            if self._closed:
                return
            self._on_job(None)
            self._on_result(task, result)

    def _next_task(self) -> Task | None:
        """Wait for a request: models first, images last."""
        with self._condition:
            while not self._has_request():
                self._condition.wait()
            if self._closed:
                return None
            pair_files, is_open_request = self._pair_files, self._open_request
            fresh, answer, baked = self._map_request, self._answer_request, self._baked_request
            pose = self._pose_request
            if is_open_request:
                self._open_request = False
            elif fresh is not None:
                self._map_request = None
            elif answer is not None:
                self._answer_request = None
            elif pose is not None:
                self._pose_request = None
            else:
                self._baked_request = None
        # Outside the lock: the callee has its own lock, and may be waiting for this one.
        landmarks, preview_map = self._current_inputs()
        assert pair_files is not None  # the first request is to open
        if is_open_request:
            return OpenModels(pair_files)
        if fresh is not None or answer is not None:
            return FindMap(pair_files, landmarks, bool(fresh), answer if fresh is None else None)
        if pose is not None:
            return ShowPosed(pair_files, pose, preview_map)
        assert baked is not None
        return ShowBaked(pair_files, *baked, preview_map)

    def _has_request(self) -> bool:
        requests = self._map_request, self._answer_request, self._baked_request, self._pose_request
        return self._closed or self._open_request or any(request is not None for request in requests)
