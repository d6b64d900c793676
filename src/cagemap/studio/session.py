"""The one state that all pages show, and everything that may be done to it."""

from __future__ import annotations

import contextlib
import logging
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

from cagemap.errors import CagemapError, ParameterError
from cagemap.numerics.arrays import FloatArray
from cagemap.studio import landmarks as edit
from cagemap.studio.bench import Dressed, Found, Opened, Task
from cagemap.studio.finish import Command, FinishOptions, commands
from cagemap.studio.landmark_files import load_landmarks, save_landmarks
from cagemap.studio.landmarks import History, LandmarkList, Place, Side
from cagemap.studio.places import place_of, vertex_place
from cagemap.studio.preview import Preview
from cagemap.studio.runner import CANCELLED, Runner
from cagemap.studio.scene import Scene, mirrored, probed, proposed
from cagemap.studio.shape import pick
from cagemap.studio.skins import Images
from cagemap.studio.state import Files, MapState, Output, Studio, View, with_message
from cagemap.studio.worker import STOPPED, Failure
from cagemap.studio.workspace import Workspace, autosave_path, read_autosave, write_autosave

log = logging.getLogger(__name__)

Listener = Callable[[Studio, Scene | None], None]


class Session:
    """Holds the state; every method may be called from any thread, and none of them waits for a computation.

    Parameters
    ----------
    workspace : Workspace
    vertices : int
        Of each previewed surface, about.
    """

    def __init__(self, workspace: Workspace, vertices: int) -> None:
        self.workspace = workspace
        self._lock = threading.RLock()
        self._state = Studio()
        self._scene: Scene | None = None
        self._listeners: list[Listener] = []
        self._cancelled = False
        self._runner = Runner(lambda job: self._change(finish_job=job), self._written, self._ended)
        self._preview = Preview(vertices, self._wanted, lambda job: self._change(preview_job=job), self._receive)

    # What pages read

    @property
    def state(self) -> Studio:
        """The state now."""
        return self._state

    @property
    def scene(self) -> Scene | None:
        """Models and map now."""
        return self._scene

    def subscribe(self, listener: Listener) -> None:
        """Have a function told of every change, after it."""
        with self._lock:
            self._listeners.append(listener)
            listener(self._state, self._scene)

    # Files

    def open(self, files: Files) -> None:
        """Open two models; landmarks come from the autosave where there is one, else from their file."""
        with self._guarded():
            files = self.workspace.within(files)
            with self._lock:
                self._scene = None
                self._change(
                    files=files,
                    history=History(),
                    selected=None,
                    proposal=None,
                    map=MapState(),
                    probe=None,
                    outputs=(),
                    saved=True,
                )
                self._preview.open(files)

    def save(self, path: Path | None = None) -> None:
        """Write the landmarks that both models have."""
        with self._guarded(), self._lock:
            self._save(path)

    def load(self, path: Path, source_points: Path | None = None) -> None:
        """Replace the landmarks by those of a file of pairs, or of a file a mesh; undo brings the old ones back."""
        with self._guarded(), self._lock:
            files, scene = self._open()
            file = self.workspace.require(path)
            second = None if source_points is None else self.workspace.require(source_points)
            landmarks, notes = load_landmarks(file, second, scene, files)
            self._edit(landmarks)
            for note in notes:
                self._say("note", note)

    def save_as(self, name: str) -> None:
        """Write the landmarks to a file of that name, or where they were opened."""
        self.save(Path(name) if name.strip() else None)

    def add_file(self, name: str, content: bytes) -> bool:
        """Put a file into the first folder, under a name that is free."""
        with self._guarded():
            added = self.workspace.add(name, content)
            self._say("note", f"added {added.name}")
            return True
        return False

    def report(self, error: CagemapError) -> None:
        """Show an error."""
        self._say("error", f"{type(error).__name__}: {error}")

    # Landmarks

    def click(self, side: Side, origin: FloatArray, direction: FloatArray) -> None:
        """Place a landmark where a ray meets a model."""
        with self._guarded(), self._lock:
            place = self.place_under(side, origin, direction)
            if place is not None:
                self._edit(edit.place(self._state.history.present, side, place), select=True)

    def probe(self, side: Side, origin: FloatArray, direction: FloatArray) -> None:
        """Ask where the map takes the point of a model that a ray meets; a ray beside it ends the asking."""
        with self._guarded(), self._lock:
            scene = self._scene
            hit = None if scene is None else pick(scene.shape(side), origin, direction)
            self._change(probe=None if scene is None or hit is None else probed(scene, side, hit))

    def place_under(self, side: Side, origin: FloatArray, direction: FloatArray) -> Place | None:
        """Place on a model that a ray of the view meets first."""
        scene = self._scene
        hit = None if scene is None else pick(scene.shape(side), origin, direction)
        return None if scene is None or hit is None else place_of(scene.shape(side), hit)

    def accept(self) -> None:
        """Complete the open landmark where the map proposes."""
        with self._guarded(), self._lock:
            proposal = self._state.proposal
            if proposal is None:
                raise ParameterError("expected a landmark that waits for its other place, and a map; click a model")
            self._edit(edit.move(self._state.history.present, proposal.number, proposal.side, proposal.place))

    def next_landmark(self) -> None:
        """Begin the landmark that would tell most; both its places are proposed, to be accepted or corrected."""
        with self._guarded(), self._lock:
            _, scene = self._open()
            vertex = self._state.map.suggestion
            if vertex is None:
                raise ParameterError("next landmark: expected a map to judge; there is none yet")
            present = self._state.history.present
            if present.open is not None:
                present = edit.remove(present, present.open.number)
            self._edit(edit.place(present, "target", vertex_place(scene.target, vertex)), select=True)

    def move(self, number: int, side: Side, place: Place) -> None:
        """Move one end of a landmark."""
        self._edit(edit.move(self._state.history.present, number, side, place))

    def remove(self, number: int) -> None:
        """Leave a landmark out."""
        self._edit(edit.remove(self._state.history.present, number))

    def rename(self, number: int, name: str) -> None:
        """Give a landmark another name."""
        self._edit(edit.rename(self._state.history.present, number, name))

    def mirror(self, number: int) -> None:
        """Add the counterpart of a landmark across both models' mirror planes."""
        with self._guarded(), self._lock:
            _, scene = self._open()
            before = self._state.history.present
            after = edit.mirror(before, number, lambda side, place: mirrored(scene, side, place))
            if after == before:
                raise ParameterError(
                    "mirror: expected a complete landmark beside the mirror plane of two symmetric models; "
                    "this one lies on it, or a model has none. Place the counterpart by hand."
                )
            self._edit(after)

    def undo(self) -> None:
        """One step back."""
        with self._guarded(), self._lock:
            self._set_history(self._state.history.undo())

    def redo(self) -> None:
        """One step forward again."""
        with self._guarded(), self._lock:
            self._set_history(self._state.history.redo())

    def select(self, number: int | None) -> None:
        """Select a landmark."""
        self._change(selected=number)

    # View and map

    def show(self, view: View) -> None:
        """Show the models in another way."""
        with self._lock:
            before = self._state.view
            self._change(view=view)
            if (view.mode, view.doubts) != (before.mode, before.doubts) and self._scene is not None:
                self._preview.dress()

    def match_again(self) -> None:
        """Compute the map from the start, with the landmarks there are."""
        self._find(fresh=True)

    def choose_answer(self, index: int) -> None:
        """Go on from another of the landmark-free answers."""
        with self._lock:
            if self._scene is not None and 0 <= index < len(self._state.map.answers):
                self._preview.choose(index)

    def cancel_preview(self) -> None:
        """Stop the preview's computation; the map stays as it was."""
        with self._lock:
            running = self._state.preview_job is not None
            self._cancelled = running
        if running:
            self._preview.stop()

    # Finish

    def plan(self, options: FinishOptions) -> tuple[Command, ...]:
        """The commands that a finish would run."""
        files, scene = self._open()
        named = replace(self.workspace.within(options), unwrap=scene.target.uvs is None)
        return commands(files, named, landmarks=self._state.history.present.decides)

    def finish(self, options: FinishOptions) -> None:
        """Map at full resolution, bake and report; saves the landmarks first."""
        with self._guarded(), self._lock:
            if self._state.finish_job is not None:
                raise ParameterError("expected no finish to be running; cancel it or wait for its end")
            todo = self.plan(options)
            if self._state.history.present.decides:
                self._save()
            self._change(outputs=())
            self._runner.start(todo)

    def cancel_finish(self) -> None:
        """End the finish; what was written whole stays."""
        self._runner.cancel()

    def close(self) -> None:
        """End every computation; the autosave holds what was not saved."""
        self._runner.cancel()
        self._preview.close()

    # Inside

    def _save(self, path: Path | None = None) -> None:
        files, scene = self._open()
        target = files.landmarks if path is None else self.workspace.require(path)
        written = save_landmarks(target, self._state.history.present, scene, files)
        self._say("note", f"saved {', '.join(map(self.workspace.show, written))}")
        if written == (target,):  # a file a mesh is for other programs; the file of pairs stays the open one
            self._change(files=replace(files, landmarks=target), saved=True)
            autosave_path(files.landmarks).unlink(missing_ok=True)

    def _written(self, output: Output) -> None:
        with self._lock:
            self._change(outputs=(*self._state.outputs, output))

    def _ended(self, words: str | None) -> None:
        if words in (None, CANCELLED):
            self._say("note", f"finish: {words or 'done'}")
        else:
            self._say("error", str(words))

    def _wanted(self) -> tuple[LandmarkList, View, Images | None]:
        state, scene = self._state, self._scene
        return state.history.present, state.view, None if scene is None else scene.images

    def _receive(self, task: Task, answer: object) -> None:
        """Take in what the worker gave."""
        with self._lock, self._guarded():
            self._take(task, answer)

    def _take(self, task: Task, answer: object) -> None:
        cancelled, self._cancelled = self._cancelled, False
        if task.opening != self._preview.models:  # others have been opened meanwhile
            return
        match answer:
            case Failure() if cancelled and answer.kind == STOPPED:
                self._say("note", "cancelled; the map stays as it was")
            case Failure():
                self._say("error", f"{answer.kind}: {answer.message}")
            case Opened():
                self._scene = Scene(answer.target, answer.source, answer.mirrors, answer.skins)
                self._change()
                for note in answer.notes:
                    self._say("note", note)
                self._first_landmarks()
            case Found() if self._scene is not None:
                if self._state.map.revision == 0:  # the page has its models by now, and the processor is free
                    threading.Thread(target=self._scene.warm, name="studio warm-up", daemon=True).start()
                self._scene = replace(self._scene, images=answer.images, skins=(answer.skin, self._scene.skins[1]))
                found = replace(
                    self._state.map,
                    revision=self._state.map.revision + 1,
                    strain=answer.strain,
                    contradictions=answer.contradictions,
                    notes=answer.notes,
                    seconds=answer.seconds,
                    answers=answer.answers,
                    chosen=answer.chosen,
                    confidence=answer.confidence,
                    suggestion=answer.suggestion,
                )
                self._change(map=found, proposal=proposed(self._scene, self._state.history.present))
            case Dressed() if self._scene is not None:
                self._scene = replace(self._scene, skins=answer.skins)
                self._change()
            case _:
                log.warning("unexpected answer %r to %r", type(answer), type(task))

    def _first_landmarks(self) -> None:
        """Landmarks of newly opened models: what a killed studio left unsaved, else what the file holds."""
        files, scene = self._open()
        kept = autosave_path(files.landmarks)
        recovered = None
        if kept.is_file():
            with self._guarded():
                recovered = read_autosave(kept, (scene.target.n_control, scene.source.n_control))
        if recovered is not None:
            self._change(history=History(recovered), saved=False)
            self._say("note", f"recovered unsaved landmarks of {files.landmarks.name}")
        elif files.landmarks.is_file():
            with self._guarded():
                landmarks, notes = load_landmarks(files.landmarks, None, scene, files)
                self._change(history=History(landmarks), saved=True)
                for note in notes:
                    self._say("note", note)
        self._find(fresh=True)

    def _edit(self, landmarks: LandmarkList, *, select: bool = False) -> None:
        with self._guarded(), self._lock:
            self._set_history(self._state.history.then(landmarks))
            if select and landmarks.items:
                self._change(selected=(landmarks.open or landmarks.items[-1]).number)

    def _set_history(self, history: History) -> None:
        before = self._state.history.present
        if history == self._state.history:
            return
        self._change(history=history, saved=False, proposal=proposed(self._scene, history.present))
        if history.present.get(self._state.selected) is None:
            self._change(selected=None)
        if self._state.files is not None:
            with self._guarded():
                write_autosave(autosave_path(self._state.files.landmarks), history.present)
        if (history.present.complete, history.present.curves) != (before.complete, before.curves):
            self._find(fresh=False)

    def _find(self, *, fresh: bool) -> None:
        if self._scene is not None:
            self._preview.find(fresh=fresh)

    def _open(self) -> tuple[Files, Scene]:
        if self._state.files is None or self._scene is None:
            raise ParameterError("expected two open models, there are none yet. Choose a target and a source.")
        return self._state.files, self._scene

    def _say(self, kind: str, text: str) -> None:
        with self._lock:
            self._change(messages=with_message(self._state.messages, "error" if kind == "error" else "note", text))

    def _change(self, **fields: object) -> None:
        with self._lock:
            self._state = replace(self._state, **fields)  # type: ignore[arg-type]
            for listener in self._listeners:
                listener(self._state, self._scene)

    @contextlib.contextmanager
    def _guarded(self) -> Iterator[None]:
        """Turn errors into messages of the page."""
        try:
            yield
        except CagemapError as error:
            self.report(error)
        except OSError as error:
            self._say("error", f"{error.filename or 'file'}: {error.strerror or error}")
        except Exception as error:  # a fault of ours must not end the studio
            log.exception("internal error")
            self._say("error", f"internal error, {type(error).__name__}: {error}")
