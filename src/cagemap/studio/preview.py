"""The preview's thread: hands the newest wish of each kind to the worker, and its answers back."""

from __future__ import annotations

import threading
from collections.abc import Callable

from cagemap.studio.compute import ChooseAnswer, Dress, FindMap, Opening, OpenModels, Task
from cagemap.studio.landmarks import LandmarkList
from cagemap.studio.skins import Images
from cagemap.studio.state import Files, RunningJob, View
from cagemap.studio.worker import Worker

_TITLES = {
    OpenModels: "opening the models",
    FindMap: "finding the map",
    ChooseAnswer: "finding the map",
    Dress: "drawing",
}
# What may last when a version of cagemap runs for the first time; said until it was done once.
_COMPILED = (OpenModels, FindMap)
_COMPILES = " (the first run after installing compiles, which takes some seconds longer)"


class Preview:
    """Computes what is shown; wishes that a newer one replaces are never computed.

    Parameters
    ----------
    vertices : int
        Of each previewed surface, about.
    wanted : callable
        The landmarks, the view and the map that is shown, as they are when a task begins.
    on_job : callable
        Told of every task and its stages, and None when there is none.
    on_answer : callable
        Told of a task and its answer.
    """

    def __init__(
        self,
        vertices: int,
        wanted: Callable[[], tuple[LandmarkList, View, Images | None]],
        on_job: Callable[[RunningJob | None], None],
        on_answer: Callable[[Task, object], None],
    ) -> None:
        self._vertices, self._wanted, self._on_job, self._on_answer = vertices, wanted, on_job, on_answer
        self._wake = threading.Condition()
        self._models: Opening | None = None
        self._opening = False
        self._finding: bool | None = None  # None: nothing to find; True: from the start
        self._choosing: int | None = None
        self._dressing = self._closed = False
        self._title = ""
        self._task: Task | None = None
        self._worker = Worker(lambda stage: on_job(RunningJob(self._title, stage, can_cancel=True)))
        self._worker.start()
        threading.Thread(target=self._work, name="studio preview", daemon=True).start()

    def open(self, files: Files) -> None:
        """Open two models; what was wished of others is forgotten, and their map is not found to its end."""
        with self._wake:
            asked = files.schemes, files.ups, files.parts
            self._models = Opening(files.target, files.source, files.texture, self._vertices, *asked)
            task = self._task
            if task is not None and not isinstance(task, OpenModels) and task.opening != self._models:
                self._worker.drop(task)
            self._opening = True
            self._finding, self._choosing, self._dressing = None, None, False
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

    def dress(self) -> None:
        """Show the models in the view as it is."""
        with self._wake:
            self._dressing = True
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

    def _work(self) -> None:
        first = set(_COMPILED)
        while (task := self._next()) is not None:
            self._title = _TITLES[type(task)] + (_COMPILES if type(task) in first else "")
            self._on_job(RunningJob(self._title, can_cancel=True))
            self._task = task
            answer = self._worker.run(task)
            self._task = None
            first.discard(type(task))
            if self._closed:
                return
            self._on_job(None)
            self._on_answer(task, answer)

    def _next(self) -> Task | None:
        """Wait for a wish; opening comes first, drawing last."""
        with self._wake:
            while not self._anything_wanted():
                self._wake.wait()
            if self._closed:
                return None
            models, opening = self._models, self._opening
            finding, choosing = self._finding, self._choosing
            if opening:
                self._opening = False
            elif finding is not None:
                self._finding = None  # its answer dresses the target only: a wish to dress both stays
            elif choosing is not None:
                self._choosing = None
            else:
                self._dressing = False
        # Outside the lock: whoever answers has one of its own, and may be about to wish something.
        landmarks, view, images = self._wanted()
        assert models is not None  # every other wish comes after the first `open`
        if opening:
            return OpenModels(models, view)
        if finding is not None:
            return FindMap(models, landmarks, view, fresh=finding)
        return Dress(models, view, images) if choosing is None else ChooseAnswer(models, landmarks, choosing, view)

    def _anything_wanted(self) -> bool:
        wished = self._opening or self._finding is not None or self._choosing is not None or self._dressing
        return self._closed or wished
