"""The preview's thread: gives the latest requests to the worker and returns the results."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from cagemap.numerics.sparse_algebra import is_compiled
from cagemap.studio.landmarks import LandmarkList, Side
from cagemap.studio.preview_tasks import FindMap, OpenModels, PairFiles, ShowBaked, ShowImage, ShowPosed, Task
from cagemap.studio.skins import PreviewMap
from cagemap.studio.state import Files, RunningJob
from cagemap.studio.worker import Worker, serve_preview

# Titles of computations on the page.
OPENING_TITLE = "Opening the models"
_TITLES = {
    OpenModels: OPENING_TITLE,
    FindMap: "Matching",
    ShowBaked: "Showing the baked image",
    ShowImage: "Showing the image",
    ShowPosed: "Showing a pose",
}
# Follows the titles until a first map has compiled all functions.
_COMPILE_NOTE = " (about a minute longer the first time after installing)"
# Kinds of requests, in the order in which they are computed.
_KINDS = ("models", "image", "pose", "map", "answer", "baked")


class Preview:
    """Computes what the page shows; a newer request replaces one that waits.

    ``vertices``: approximate number of vertices of each previewed surface.
    ``folder``: receives an image that is inside the source's file.
    ``current_inputs``: gives the current landmarks, map and chosen answer when a task starts.
    ``on_job``: called at every task and stage.
    """

    def __init__(
        self,
        vertices: int,
        folder: Path,
        current_inputs: Callable[[], tuple[LandmarkList, PreviewMap | None, int | str]],
        on_job: Callable[[RunningJob], None],
        on_result: Callable[[Task, object], None],
    ) -> None:
        self._vertices, self._folder = vertices, folder
        self._current_inputs, self._on_job, self._on_result = current_inputs, on_job, on_result
        self._condition = threading.Condition()
        self.pair_files: PairFiles | None = None  # of the pair that is open or about to be
        self._requests: dict[str, tuple[Any, ...]] = {}  # those that wait: arguments by kind
        self._running_kind = ""
        self._closed = False
        self._job = RunningJob("")
        self._task: Task | None = None
        self._worker = Worker(
            lambda stage: on_job(replace(self._job, stage=stage)), serve_preview, self._on_early_result
        )
        self._worker.start()
        threading.Thread(target=self._run_tasks, name="studio preview", daemon=True).start()

    def open(self, files: Files) -> None:
        """Open two models; requests and a running map of other models are dropped."""
        with self._condition:
            sides = files.schemes, files.ups, files.parts
            self.pair_files = PairFiles(files.target, files.source, files.texture, self._vertices, self._folder, *sides)
            task = self._task
            if task is not None and not isinstance(task, OpenModels) and task.pair_files != self.pair_files:
                self._worker.cancel(task)
            self._requests.clear()
            self.request("models")

    def turn(self, side: Side, up: str, pose: str) -> None:
        """Draw the open models with another axis of a file up, in a pose; a running map is computed again."""
        with self._condition:
            assert self.pair_files is not None
            target, source = self.pair_files.ups
            self.pair_files = replace(self.pair_files, ups=(up, source) if side == "target" else (target, up))
            if isinstance(self._task, FindMap):
                self._worker.cancel(self._task)
            self.request("pose", pose)

    def show_image(self, image: Path | None) -> None:
        """Draw the open models with another image of the source; a running map is computed again."""
        with self._condition:
            self.set_image(image)
            if isinstance(self._task, FindMap):
                self._worker.cancel(self._task)
            self.request("image")

    def set_image(self, image: Path | None) -> None:
        """Use an image of the source from the next task on."""
        with self._condition:
            assert self.pair_files is not None
            self.pair_files = replace(self.pair_files, texture=image)

    def find(self, *, fresh: bool) -> None:
        """Compute the map, by an update if there is one and ``fresh`` is not set."""
        with self._condition:
            self.request("map", fresh or self._requests.get("map") == (True,))

    def is_requested(self, kind: str) -> bool:
        """Whether a request of a kind, one of `_KINDS`, waits or is being computed."""
        with self._condition:
            return kind in (*self._requests, self._running_kind)

    def drop_map_requests(self) -> bool:
        """Remove requests for a map that have not begun; return whether there was one."""
        with self._condition:
            dropped = [self._requests.pop(kind, None) for kind in ("map", "answer")]
        return dropped != [None, None]

    def kill(self) -> None:
        """Kill the running task; its result is a failure."""
        self._worker.kill()

    def close(self) -> None:
        """End the thread and the process."""
        with self._condition:
            self._closed = True
            self._condition.notify()
        self._worker.kill()

    def request(self, kind: str, *arguments: Any) -> None:
        """Request a task of a kind, one of `_KINDS`, with its own arguments."""
        with self._condition:
            self._requests[kind] = arguments
            self._condition.notify()

    def _on_early_result(self, result: object) -> None:
        if self._task is not None and not self._closed:
            self._on_result(self._task, result)

    def _run_tasks(self) -> None:
        while (task := self._next_task()) is not None:
            self._job = RunningJob(_TITLES[type(task)] + ("" if is_compiled() else _COMPILE_NOTE))
            self._on_job(self._job)
            self._task = task
            result = self._worker.run(task)
            self._task = None
            if self._closed:
                return
            self._repeat_turned(task)
            self._on_result(task, result)
            self._running_kind = ""

    def _repeat_turned(self, task: Task) -> None:
        """Request a map again if the models were turned or got another image: its drawings are of those before."""
        with self._condition:
            files = self.pair_files
            assert files is not None
            drawn_files = replace(task.pair_files, ups=files.ups, texture=files.texture)
            if isinstance(task, FindMap) and task.pair_files != files == drawn_files:
                if task.answer is None:
                    self.find(fresh=task.fresh)
                else:
                    self._requests.setdefault("answer", (task.answer,))

    def _next_task(self) -> Task | None:
        """Wait for a request: models first, images last."""
        with self._condition:
            self._condition.wait_for(lambda: self._closed or self._requests)
            if self._closed:
                return None
            kind = min(self._requests, key=_KINDS.index)
            pair_files, arguments, self._running_kind = self.pair_files, self._requests.pop(kind), kind
        # Outside the lock: the callee has its own lock, and may be waiting for this one.
        landmarks, preview_map, chosen_answer = self._current_inputs()
        assert pair_files is not None  # the first request is to open
        match kind:
            case "models":
                return OpenModels(pair_files)
            case "map":
                (fresh,) = arguments
                return FindMap(pair_files, landmarks, fresh, chosen_answer=chosen_answer)
            case "answer":
                return FindMap(pair_files, landmarks, answer=arguments[0])
            case "image":
                return ShowImage(pair_files, preview_map)
            case "pose":
                (pose,) = arguments
                return ShowPosed(pair_files, pose, preview_map)
            case _:
                image, layout, uv_set = arguments
                return ShowBaked(pair_files, image, layout, uv_set, preview_map)
