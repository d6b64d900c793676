"""The preview's thread: hands the newest wish of each kind to the worker, and its answers back."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path

from cagemap.studio.compute import FindMap, Opening, OpenModels, ShowBaked, ShowPosed, Task
from cagemap.studio.landmarks import LandmarkList
from cagemap.studio.skins import Images
from cagemap.studio.state import Files, RunningJob
from cagemap.studio.worker import Worker

# What a computation is called on the page.
OPENING, MATCHING, DRAWING, POSING = "Opening the models", "Matching", "Showing the baked image", "Showing a pose"
_TITLES = {OpenModels: OPENING, FindMap: MATCHING, ShowBaked: DRAWING, ShowPosed: POSING}
# What may last when a version of cagemap runs for the first time; said until it was done once.
_COMPILES = " (some seconds longer on the first run after installing)"


class Preview:
    """Computes what is shown; wishes that a newer one replaces are never computed.

    Parameters
    ----------
    vertices : int
        Of each previewed surface, about.
    folder : Path
        Where an image inside the source's file is put.
    wanted : callable
        The landmarks and the map that is shown, as they are when a task begins.
    on_job : callable
        Told of every task and its stages, and None when there is none.
    on_answer : callable
        Told of a task and its answer.
    """

    def __init__(
        self,
        vertices: int,
        folder: Path,
        wanted: Callable[[], tuple[LandmarkList, Images | None]],
        on_job: Callable[[RunningJob | None], None],
        on_answer: Callable[[Task, object], None],
    ) -> None:
        self._vertices, self._folder = vertices, folder
        self._wanted, self._on_job, self._on_answer = wanted, on_job, on_answer
        self._wake = threading.Condition()
        self._models: Opening | None = None
        self._opening = False
        self._finding: bool | None = None  # None: nothing to find; True: from the start
        self._choosing: int | None = None
        self._showing: tuple[Path, Path | None] | None = None
        self._posing: str | None = None
        self._closed = False
        self._title = ""
        self._task: Task | None = None
        self._worker = Worker(lambda stage: on_job(RunningJob(self._title, stage)), on_shown=self._shown)
        self._worker.start()
        threading.Thread(target=self._work, name="studio preview", daemon=True).start()

    def open(self, files: Files) -> None:
        """Open two models; what was wished of others is forgotten, and their map is not found to its end."""
        with self._wake:
            asked = files.schemes, files.ups, files.parts
            self._models = Opening(files.target, files.source, files.texture, self._vertices, self._folder, *asked)
            task = self._task
            if task is not None and not isinstance(task, OpenModels) and task.opening != self._models:
                self._worker.drop(task)
            self._opening = True
            self._finding = self._choosing = self._showing = self._posing = None
            self._wake.notify()

    @property
    def models(self) -> Opening | None:
        """What is open, or is to be."""
        return self._models

    def find(self, *, fresh: bool) -> None:
        """Find the map; an update is enough where there is one, unless ``fresh``."""
        with self._wake:
            self._finding = fresh or bool(self._finding)
            self._wake.notify()

    def choose(self, index: int) -> None:
        """Go on from another landmark-free answer."""
        with self._wake:
            self._choosing = index
            self._wake.notify()

    def show_baked(self, image: Path, layout: Path | None) -> None:
        """Show a baked image, in the target's layout or that of another file."""
        with self._wake:
            self._showing = image, layout
            self._wake.notify()

    def show_posed(self, pose: str) -> None:
        """Show both models in a pose; '': as their files have them."""
        with self._wake:
            self._posing = pose
            self._wake.notify()

    def stop(self) -> None:
        """Stop what is being computed; its answer is a failure."""
        self._worker.stop()

    def close(self) -> None:
        """End."""
        with self._wake:
            self._closed = True
            self._wake.notify()
        self._worker.stop()

    def _shown(self, early: object) -> None:
        """Hand on what the task that runs shows before it is done."""
        if self._task is not None and not self._closed:
            self._on_answer(self._task, early)

    def _work(self) -> None:
        first = {OpenModels, FindMap}
        while (task := self._next()) is not None:
            self._title = _TITLES[type(task)] + (_COMPILES if type(task) in first else "")
            self._on_job(RunningJob(self._title))
            self._task = task
            answer = self._worker.run(task)
            self._task = None
            first.discard(type(task))
            if self._closed:
                return
            self._on_job(None)
            self._on_answer(task, answer)

    def _next(self) -> Task | None:
        """Wait for a wish; opening comes first, images last."""
        with self._wake:
            while not self._anything_wanted():
                self._wake.wait()
            if self._closed:
                return None
            models, opening = self._models, self._opening
            finding, choosing, showing, posing = self._finding, self._choosing, self._showing, self._posing
            if opening:
                self._opening = False
            elif finding is not None:
                self._finding = None
            elif choosing is not None:
                self._choosing = None
            elif posing is not None:
                self._posing = None
            else:
                self._showing = None
        # Outside the lock: whoever answers has one of its own, and may be about to wish something.
        landmarks, images = self._wanted()
        assert models is not None  # every other wish comes after the first `open`
        if opening:
            return OpenModels(models)
        if finding is not None or choosing is not None:
            return FindMap(models, landmarks, bool(finding), choosing if finding is None else None)
        if posing is not None:
            return ShowPosed(models, posing)
        assert showing is not None
        return ShowBaked(models, *showing, images)

    def _anything_wanted(self) -> bool:
        wished = self._opening or self._finding is not None or self._choosing is not None
        wished = wished or self._showing is not None or self._posing is not None
        return self._closed or wished
