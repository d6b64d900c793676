"""The one state that all pages show, and everything that may be done to it."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from cagemap.errors import ParameterError
from cagemap.numerics.arrays import FloatArray
from cagemap.studio import landmarks as edit
from cagemap.studio.agreement import led_elsewhere
from cagemap.studio.autosave import Owned, Parts, autosave_path, kept_parts, set_aside
from cagemap.studio.compute import FindMap, Found, Opened, OpenModels, ShowBaked, ShowPosed, Task
from cagemap.studio.finish import Command, FinishOptions, planned
from cagemap.studio.finish_layout import on_the_page
from cagemap.studio.landmark_files import FIRST, in_files, load_landmarks, save_landmarks
from cagemap.studio.landmarks import History, LandmarkList, Place, Side
from cagemap.studio.last_map import LastMap
from cagemap.studio.opening import result_of, with_parts
from cagemap.studio.places import place_of, vertex_place
from cagemap.studio.preview import Preview
from cagemap.studio.runner import Runner
from cagemap.studio.scene import Scene, mirrored, probed, proposed, with_counterpart
from cagemap.studio.shape import pick
from cagemap.studio.shared_state import Held
from cagemap.studio.skins import Images
from cagemap.studio.state import AFRESH, Files, Message, Output, View, baked_view, changed_view, map_view
from cagemap.studio.worker import DROPPED, STOPPED, Failure
from cagemap.studio.workspace import Workspace
from cagemap.tasks.requests.catalogue import Options

log = logging.getLogger(__name__)


class Session(Held):
    """Holds the state; every method may be called from any thread, and none of them waits for a computation.

    Parameters
    ----------
    workspace : Workspace
    vertices : int
        Of each previewed surface, about.
    options : mapping
        What the commands of a finish can be asked.
    """

    def __init__(self, workspace: Workspace, vertices: int, options: Options) -> None:
        super().__init__()
        self.workspace, self.options = workspace, options
        self._cancelled = False
        self._adding = threading.Lock()
        self._asked_parts: Parts = (None, None)
        self._finishing: object = None
        self._last, self._owned = LastMap(), Owned()
        self._runner = Runner(lambda job: self._change(finish_job=job), self._written, self._told, self._ended)
        told = lambda job: self._change(preview_job=job)  # noqa: E731
        self._preview = Preview(vertices, workspace.folders[0], self._wanted, told, self._receive)

    # Files

    def open(self, files: Files) -> None:
        """Open two models; landmarks come from the autosave where there is one, else from their file.

        Parts that are not named are those of the autosave.
        """
        with self.guarded():
            files = self.workspace.within(files)
            (target, source), kept = files.parts, kept_parts(autosave_path(files.landmarks))
            self._begin(replace(files, parts=(target or kept[0], source or kept[1])), files.parts)

    def choose_part(self, side: Side, title: str | None) -> None:
        """Open another part of one of the files, with its landmarks; what is not saved is kept for its own parts."""
        with self.guarded(), self._lock:
            files, scene = self._open()
            target, source = (offer.opened for offer in scene.offers)
            parts = (title, source) if side == "target" else (target, title)
            chosen = replace(files, parts=parts, result=result_of(files, parts))
            self._begin(self.workspace.within(chosen), parts)

    def take_as_it_is(self, side: Side) -> None:
        """Open one of the models anew, without subdividing it."""
        with self.guarded(), self._lock:
            files, _ = self._open()
            target, source = files.schemes
            self.open(replace(files, schemes=("none", source) if side == "target" else (target, "none")))

    def save(self, name: str | Path = "") -> None:
        """Write the landmarks that both models have to a file of that name, or where they were opened."""
        with self.guarded(), self._lock:
            self._save(Path(name) if str(name).strip() else None)

    def load(self, path: Path, source_points: Path | None = None) -> None:
        """Replace the landmarks by those of a file of pairs, or of a file a mesh; on other parts if it has any."""
        with self.guarded(), self._lock:
            files, scene = self._open()
            file = self.workspace.require(path)
            second = None if source_points is None else self.workspace.require(source_points)
            landmarks, notes = load_landmarks(file, second, scene, files, self._owned)
            self._edit(lambda present: edit.keep_elsewhere(landmarks, present))
            self._notes(notes)

    def add_file(self, name: str, content: bytes) -> Path | None:
        """Put a file into the first folder, under a name that is free; None where that is refused."""
        with self.guarded(), self._adding:
            added = self.workspace.add(name, content)
            self._say("note", f"added {added.name}")
            return added
        return None

    # Landmarks

    def click(self, side: Side, origin: FloatArray, direction: FloatArray) -> None:
        """Place a landmark where a ray meets a model."""
        with self.guarded(), self._lock:
            place = self.place_under(side, origin, direction)
            if place is not None:
                self._edit(lambda present: edit.place(present, side, place), select=True)

    def probe(self, side: Side, origin: FloatArray, direction: FloatArray) -> None:
        """Ask where the map takes the point of a model that a ray meets; a ray beside it ends the asking."""
        with self.guarded(), self._lock:
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
        with self.guarded(), self._lock:
            proposal = self._state.proposal
            if proposal is None:
                raise ParameterError("expected a landmark that waits for its other place, and a map; click a model")
            where = proposal.number, proposal.side, proposal.place
            self._edit(lambda present: edit.move(present, *where))

    def next_landmark(self) -> None:
        """Begin the landmark that would tell most; both its places are proposed, to be accepted or corrected."""
        with self.guarded(), self._lock:
            _, scene = self._open()
            vertex = self._state.map.suggestion
            if vertex is None:
                raise ParameterError("next landmark: expected a map to judge; there is none yet")
            self._edit(lambda present: edit.begin(present, "target", vertex_place(scene.target, vertex)), select=True)

    def move(self, number: int, side: Side, origin: FloatArray, direction: FloatArray) -> None:
        """Move one end of a landmark to where a ray meets the model; a ray beside it moves nothing."""
        place = self.place_under(side, origin, direction)
        if place is not None:
            self._edit(lambda present: edit.move(present, number, side, place))

    def remove(self, number: int) -> None:
        """Leave a landmark out."""
        self._edit(lambda present: edit.remove(present, number))

    def rename(self, number: int, name: str) -> None:
        """Give a landmark another name."""
        with self.guarded(), self._lock:
            self._set_history(self._state.history.renamed(number, name))

    def mirror(self, number: int) -> None:
        """Add the counterpart of a landmark across both models' mirror planes."""
        with self.guarded(), self._lock:
            _, scene = self._open()
            before = self._state.history.present
            after = edit.mirror(before, number, lambda side, place: mirrored(scene, side, place))
            if after == before:
                raise ParameterError(
                    "mirror: expected a complete landmark beside the mirror plane of two symmetric models; "
                    "this one lies on it, or a model has none. Place the counterpart by hand."
                )
            self._edit(lambda _: after)

    def undo(self) -> None:
        """One step back."""
        with self.guarded(), self._lock:
            self._set_history(self._state.history.undo())

    def redo(self) -> None:
        """One step forward again."""
        with self.guarded(), self._lock:
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
            if view.pose != before.pose and self._scene is not None:
                self._preview.show_posed(view.pose)
            if view.baked is not None and view.baked != before.baked and self._scene is not None:
                self._preview.show_baked(view.baked, view.layout)

    def show_as(self, **fields: object) -> None:
        """Change some fields of the view; what was baked last is shown where no baked image was chosen."""
        with self.guarded(), self._lock:
            self.show(changed_view(self._state, **fields))

    def look_at(self, image: Path | None) -> None:
        """Show an image that was baked on the target; None: the map."""
        with self._lock:
            self.show(baked_view(self._state, image))

    def match_again(self) -> None:
        """Match from the start with the current landmarks."""
        with self._lock:
            self._find(fresh=True)

    def choose_answer(self, index: int) -> None:
        """Go on from another of the landmark-free answers."""
        with self._lock:
            if self._scene is not None and 0 <= index < len(self._state.map.answers):
                self.show(map_view(self._state.view))
                self._preview.choose(index)

    def cancel(self) -> None:
        """Cancel the bake (complete files are kept), or else the preview (the last map is kept)."""
        with self._lock:
            finish = self._state.finish_job is not None
            self._cancelled = running = self._state.preview_job is not None and not finish
        if finish:
            self._runner.cancel()
        elif running:
            self._preview.stop()

    # Finish

    def plan(self, options: FinishOptions) -> tuple[Command, ...]:
        """The commands that a finish would run.

        Without an image, colours of the source's materials are baked; without these, the wrapped mesh is made.
        """
        files, scene = self._open()
        landmarks = self._state.history.present.decides
        answer = 0 if landmarks else self._state.map.chosen
        asked = options.giving({("transfer", "unwrap"): scene.target.uvs is None, ("match", "answer"): answer})
        if options.texture and files.texture is None and scene.colored:
            asked = asked.giving({("transfer", "material_colors"): True})
        elif options.texture and files.texture is None:
            asked = replace(asked, wrap=True)
        return planned(self.options, self.workspace, files, asked, landmarks=landmarks)

    def finish(self, options: FinishOptions) -> None:
        """Map at full resolution, bake and report; saves the landmarks first."""
        with self.guarded(), self._lock:
            if self._state.finish_job is not None:
                raise ParameterError("a bake is running; cancel it or wait for its end")
            todo = self.plan(options)
            if self._state.history.present.decides:
                self._save()
            self.show(map_view(self._state.view))  # what is baked anew is drawn anew
            left = self._last.left_of(todo, self._state)
            self._change(outputs=() if left == todo else (Output(todo[0].output, todo[0].makes),))
            self._finishing = self._state.wish
            if options.texture and self._open()[0].texture is None:
                made = "the colours of its materials are" if self._open()[1].colored else "the wrapped mesh is"
                self._say("note", f"the source has no image: {made} made instead")
            self._runner.start(left)

    def close(self) -> None:
        """End every computation; the autosave holds what was not saved."""
        self._runner.cancel()
        self._preview.close()

    # Inside

    def _begin(self, files: Files, asked: Parts) -> None:
        """Open models; parts are those of the files, or those that were asked for where the files' are not there."""
        with self._lock:
            self._scene, self._asked_parts = None, asked
            self._change(files=files, view=map_view(self._state.view), **AFRESH)
            self._preview.open(files)

    def _save(self, path: Path | None = None) -> None:
        files, scene = self._open()
        target = files.landmarks if path is None else self.workspace.require(path)
        written, said = save_landmarks(target, self._state.history.present, scene, files, self._owned)
        self._notes(said)
        self._say("note", f"saved {', '.join(map(self.workspace.show, written))}")
        if written == (target,):  # a file a mesh is for other programs; the file of pairs stays the open one
            if target != files.landmarks and autosave_path(target).is_file():
                set_aside(autosave_path(target))  # of another time
            self._change(files=replace(files, landmarks=target), saved=True)
            self._owned.saved(files.landmarks)

    def _written(self, output: Output) -> None:
        with self._lock:
            self._last.written(output)
            if output.path not in [other.path for other in self._state.outputs]:
                self._change(outputs=(*self._state.outputs, output))

    def _told(self, message: Message) -> None:
        self._say(message.kind, on_the_page(self.options, message.text))

    def _ended(self, message: Message) -> None:
        with self.guarded():  # no lock: it takes longer than a click
            if self._finishing == self._state.wish:
                self._notes(led_elsewhere(self._scene, self._state.outputs), "error")
        with self._lock:
            self._say(message.kind, message.text)
            if self._state.images and self._finishing == self._state.wish:
                self.look_at(self._state.images[0])
            elif self._state.images:
                self._say("note", "what was baked is of the map before the last changes; press Bake for the map of now")

    def _wanted(self) -> tuple[LandmarkList, Images | None]:
        state, scene = self._state, self._scene
        return state.history.present, None if scene is None else scene.images

    def _receive(self, task: Task, answer: object) -> None:
        """Take in what the worker gave."""
        with self._lock, self.guarded():
            self._take(task, answer)

    def _take(self, task: Task, answer: object) -> None:
        rough = isinstance(answer, Found) and answer.known.rough
        cancelled, self._cancelled = self._cancelled, self._cancelled and rough
        if task.opening != self._preview.models or (rough and cancelled):  # others have been opened meanwhile
            return
        match answer:
            case Failure() if answer.kind == DROPPED:  # the same ones again: what they are opened for comes next
                pass
            case Failure() if cancelled and answer.kind == STOPPED:
                self._say("note", "cancelled; the map stays as it was")
            case Failure():
                self._say("error", f"{answer.kind}: {answer.message}")
                files = self._state.files
                if isinstance(task, OpenModels) and files is not None and files.parts != self._asked_parts:
                    self._begin(replace(files, parts=self._asked_parts), self._asked_parts)  # the autosave's are gone
            case Opened():
                self._opened(answer)
            case Found() if self._scene is not None and isinstance(task, FindMap):
                before, (target, source) = self._scene, answer.skins
                scene = replace(before, images=answer.images, skins=(target, source or before.skins[1]))
                self._scene = scene = replace(scene, source=scene.faced)
                if before.images is None or scene.source is not before.source:
                    scene.warm()  # the page has its models by now, and the processor is free
                known = answer.known.under_names(task.landmarks, self._state.history.present)
                known = replace(known, revision=self._state.map.revision + (not known.rough))
                self._change(map=known, proposal=proposed(scene, self._state.history.present))
            case bytes() if self._scene is not None and isinstance(task, ShowBaked):
                if task.image == self._state.view.baked:
                    self._scene = replace(self._scene, skins=(answer, self._scene.skins[1]))
                    self._change()
            case (bytes() as target, bytes() as source) if self._scene is not None and isinstance(task, ShowPosed):
                if task.pose == self._state.view.pose:
                    self._scene = replace(self._scene, skins=(target, source))
                    self._change()
            case _:
                log.warning("unexpected answer %r to %r", type(answer), type(task))

    def _opened(self, answer: Opened) -> None:
        """Take the models as they were opened, so that the finish opens them alike."""
        target, source = answer.target, answer.source
        self._scene = answer.scene
        if self._state.files is not None:
            files = with_parts(self._state.files, (target.offer.opened, source.offer.opened))
            schemes, welds = (target.scheme, source.scheme), (target.weld, source.weld)
            self._change(files=replace(files, schemes=schemes, welds=welds, texture=source.texture))
        self._notes(target.notes + source.notes)
        self._first_landmarks()

    def _first_landmarks(self) -> None:
        """Landmarks of newly opened models: what a killed studio left unsaved, else what the file holds."""
        files, scene = self._open()
        for read, saved in FIRST:
            with self.guarded():
                found = read(files, scene, self._owned)
                if found is not None:
                    landmarks, notes = found
                    self._change(history=History(landmarks), saved=saved)
                    self._notes(notes)
                    break
        self._find(fresh=True)

    def _edit(self, change: Callable[[LandmarkList], LandmarkList], *, select: bool = False) -> None:
        with self.guarded(), self._lock:  # another page may be about to change them too
            before = self._state.history.present
            landmarks = change(before)
            if self._state.view.symmetric and self._scene is not None:
                landmarks = with_counterpart(self._scene, before, landmarks)
            self._set_history(self._state.history.then(landmarks))
            if select and landmarks.items:
                self._change(selected=(before.open or landmarks.open or landmarks.items[-1]).number)

    def _set_history(self, history: History) -> None:
        before = self._state.history.present
        if history == self._state.history:
            return
        files, scene = self._state.files, self._scene
        if files is not None and scene is not None:  # first: what the page shows is not lost
            with self.guarded():
                self._notes(self._owned.keep(files.landmarks, in_files(history.present, scene), files.parts))
        known = self._state.map.under_names(before, history.present)
        self._change(history=history, saved=False, map=known, proposal=proposed(self._scene, history.present))
        if history.present.get(self._state.selected) is None:
            self._change(selected=None)
        if history.present.goes_by != before.goes_by:
            self._find(fresh=False)

    def _find(self, *, fresh: bool) -> None:
        if self._scene is not None:
            self.show(map_view(self._state.view))  # a baked image is of an earlier map
            self._preview.find(fresh=fresh)

    def _open(self) -> tuple[Files, Scene]:
        if self._state.files is None or self._scene is None:
            raise ParameterError("expected two open models, there are none yet. Choose a target and a source.")
        return self._state.files, self._scene
