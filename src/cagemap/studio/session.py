"""The session: the shared state, and everything that a page can do with it."""

from __future__ import annotations

import threading
from dataclasses import replace
from pathlib import Path

from cagemap.errors import ParameterError
from cagemap.files import IMAGE_SUFFIXES
from cagemap.numerics.arrays import FloatArray
from cagemap.studio import landmarks as edit
from cagemap.studio.autosave import autosave_path, move_aside, read_autosave_parts
from cagemap.studio.finish import MAP_TITLE, Command, FinishOptions, made_of, plan_commands, with_defaults
from cagemap.studio.finish_layout import explain_flags, in_page_words
from cagemap.studio.finish_map import WrittenMap, map_difference_notes
from cagemap.studio.landmark_files import load_landmarks, save_landmarks
from cagemap.studio.landmarks import Side
from cagemap.studio.opening import result_folder
from cagemap.studio.preview_results import PreviewResults
from cagemap.studio.recorded_match import LANDMARK_FIELDS
from cagemap.studio.runner import Runner
from cagemap.studio.scene import probe_map
from cagemap.studio.shape import pick
from cagemap.studio.state import (
    Files,
    Message,
    Output,
    baked_view,
    first_image,
    map_view,
    update_view,
)
from cagemap.studio.workspace import Workspace
from cagemap.tasks.requests.catalogue import Options


class Session(PreviewResults):
    """State and actions of a running studio; may be called from any thread.

    ``vertices``: approximate number of vertices of each previewed surface.
    ``options``: options of the commands of a finish.
    """

    def __init__(self, workspace: Workspace, vertices: int, options: Options) -> None:
        super().__init__(vertices, workspace.folders[0])
        self.workspace, self.vertices, self.options = workspace, vertices, options
        self._upload_lock = threading.Lock()
        self._added_names: dict[str, dict[str, str]] = {}  # by drop, then by the given name
        self._finish_inputs: tuple[object, ...] = ()
        self._earlier_outputs: tuple[Output, ...] = ()  # of earlier finishes, until the last one replaces them
        self._finish_uv_set: str | None = None  # the target's, of the last finish
        self._has_new_map = False  # whether the last finish computes a map
        self._written_map = WrittenMap()
        self._runner = Runner(lambda job: self._change(finish_job=job), self._on_output, self._on_message, self._on_end)

    # Files

    @property
    def requested_files(self) -> Files | None:
        """The open pair with the chosen image and axes, also where these are not drawn yet."""
        with self._lock:
            files, requested = self._state.files, self._preview.pair_files
        if files is None or requested is None:
            return files
        texture = requested.texture if self._preview.is_requested("image") else files.texture
        return replace(files, texture=texture, ups=requested.ups)

    def open(self, files: Files) -> None:
        """Open two models with their unsaved landmarks, or else those of their file.

        Parts that are not named are those of the autosave. Another image of the open models is only drawn.
        """
        with self.report_errors(), self._lock:
            files, opened = self.workspace.resolve_paths(files), self.requested_files
            if opened is not None and self._scene is not None and replace(files, texture=opened.texture) == opened:
                if files.texture != opened.texture or self._preview.is_requested("image"):
                    self.show(map_view(self._state.view))
                    self._preview.show_image(files.texture)
                    return
            (target, source), autosaved = files.parts, read_autosave_parts(autosave_path(files.landmarks))
            self._open_pair(replace(files, parts=(target or autosaved[0], source or autosaved[1])), files.parts)

    def choose_part(self, side: Side, title: str | None) -> None:
        """Open another part of a file; unsaved landmarks are kept in the autosave."""
        with self.report_errors(), self._lock:
            files, scene = self._require_open()
            files = (self.requested_files or files).without_answer()
            target, source = (choices.opened for choices in scene.part_choices)
            parts = (title, source) if side == "target" else (target, title)
            files = replace(files, parts=parts, result=result_folder(files, parts))
            self._open_pair(self.workspace.resolve_paths(files), parts)

    def open_plain(self, side: Side) -> None:
        """Open a model again without subdividing it."""
        with self.report_errors(), self._lock:
            files, _ = self._require_open()
            files = (self.requested_files or files).without_answer()
            target, source = files.schemes
            self.open(replace(files, schemes=("none", source) if side == "target" else (target, "none")))

    def turn_up(self, side: Side) -> None:
        """Show a model that lies on its side with the other of its file's axes y and z up."""
        with self.report_errors(), self._lock:
            view, (_, scene) = self._state.view, self._require_open()
            up = "y" if abs(scene.shape(side).rotation[2, 1]) > 0.5 else "z"
            self._preview.turn(side, up, view.pose)
            if view.baked is not None:
                self._draw_baked(view.baked)

    def save(self, name: str | Path = "") -> None:
        """Save the complete landmarks, by default to their file."""
        with self.report_errors(), self._lock:
            self._save(Path(name) if str(name).strip() else None)

    def load(self, path: Path, source_points: Path | None = None) -> None:
        """Load landmarks from a file of pairs, or from two files of points.

        Landmarks of other parts stay, unless the file has some.
        """
        with self.report_errors(), self._lock:
            files, scene = self._require_open()
            file = self.workspace.resolve(path)
            source_file = None if source_points is None else self.workspace.resolve(source_points)
            landmarks, notes = load_landmarks(file, source_file, scene, files, self._tracker)
            history = self._state.history
            self._set_history(history.advance(edit.keep_unused_landmarks(landmarks, history.present)))
            self._say_all(notes)

    def add_file(self, name: str, content: bytes, drop: str = "") -> Path | None:
        """Add a file to the first folder; None if it is refused. `Workspace.add` has it name files of the same drop."""
        with self.report_errors(), self._upload_lock:
            added_names = self._added_names.setdefault(drop, {})
            path = self.workspace.add(name, content, added_names)
            if added_names.get(Path(name).name) != path.name:
                self._say("note", f"added {path.name}")
            images = (names for names in added_names.items() if names[0].lower().endswith(IMAGE_SUFFIXES))
            renamed = ", ".join(written for given, written in images if given != written)
            if renamed and path.suffix.lower() in (".fbx", ".usd", ".usda", ".usdc"):
                self._say("note", f"{path.name} may use older images, as those of the drop were renamed: {renamed}")
            added_names[Path(name).name] = path.name
            return path
        return None

    # View and map

    def probe(self, side: Side, origin: FloatArray, direction: FloatArray) -> None:
        """Show the image of the point under the mouse, or none beside the model."""
        with self.report_errors(), self._lock:
            scene = self._scene
            hit = None if scene is None else pick(scene.shape(side), origin, direction)
            self._change(probe=None if scene is None or hit is None else probe_map(scene, side, hit))

    def change_view(self, **fields: object) -> None:
        """Change fields of the view; mode "baked" shows an image of colours by default, see `update_view`."""
        with self.report_errors(), self._lock:
            self.show(update_view(self._state, **fields))

    def show_baked_image(self, image: Path | None) -> None:
        """Show a baked image; None: the map."""
        with self._lock:
            self.show(baked_view(self._state.view, image))

    def match_again(self) -> None:
        """Match from the start with the current landmarks."""
        with self._lock:
            self._request_map(fresh=True)

    def choose_answer(self, answer: int) -> None:
        """Compute the map from another alignment found without landmarks."""
        with self._lock:
            if self._scene is not None and 0 <= answer < len(self._state.map.answers):
                self.show(map_view(self._state.view))
                self._preview.request("answer", answer)

    def cancel(self) -> None:
        """Cancel the finish, or else the preview; complete files and the last map are kept."""
        with self._lock:
            is_finishing = self._state.finish_job is not None
            self._cancelled = is_running = self._state.preview_job is not None and not is_finishing
            is_dropped = is_running and self._preview.drop_map_requests()
            is_outdated = is_dropped and self._state.history.present.constraints != self._checked_constraints
            if is_outdated and self._scene is not None and self._scene.preview_map is not None:
                self._change(map=self._state.map.as_unchecked())
        if is_finishing:
            self._runner.cancel()
        elif is_running:
            self._preview.kill()

    # Finish

    def plan(self, options: FinishOptions) -> tuple[Command, ...]:
        """Commands that a press of *Bake* runs, with the page's alignment and the default options of `with_defaults`.

        ParameterError if the target cannot be wrapped, or a value is refused.
        """
        files, scene = self._require_open()
        has_constraints = self._state.history.present.has_constraints
        options = with_defaults(options, files, scene, self.vertices)
        answer, recorded = (0 if has_constraints else self._state.map.chosen_answer), files.recorded_match
        if not has_constraints and recorded is not None and recorded.answer_name == self._state.map.answer_name:
            # The order of alignments depends on the number of vertices: that of the RESULT is known only at its own.
            sizes = {name: options.option_values.get(("match", name)) for name in ("level", "vertices")}
            if all(value == getattr(recorded.request, name) for name, value in sizes.items()):
                answer = recorded.request.answer
        options = options.with_values({("match", "answer"): answer})
        return plan_commands(self.options, self.workspace, files, options, use_landmarks=has_constraints)

    def finish(self, options: FinishOptions) -> None:
        """Save the landmarks; then map at full resolution, bake and report."""
        with self.report_errors(), self._lock:
            if self._state.finish_job is not None:
                raise ParameterError("a bake is running; cancel it or wait for its end")
            if self._preview.is_requested("image"):
                raise ParameterError("the chosen image is being drawn; press Bake again when it is shown")
            is_sought = self._preview.is_requested("answer") or self._state.map.sought_answer
            if is_sought and not self._state.history.present.has_constraints:
                raise ParameterError(
                    "the chosen alignment has no map yet. Wait for it (after Cancel press Match again), then press Bake"
                )
            files, _ = self._require_open()
            commands = self.plan(options)
            if self._state.history.present.has_constraints:
                self._save()
            self.show(map_view(self._state.view))
            commands = (replace(commands[0], computed=self._computed), *commands[1:])
            remaining = self._written_map.remaining_commands(commands, self._state)
            self._has_new_map = remaining == commands
            uv_set = options.option_values.get(("match", "target_uv_set"))
            self._finish_uv_set = str(uv_set) if uv_set else None
            reused_map = Output(commands[0].output, commands[0].output_title, self._finish_uv_set)
            reused = () if self._has_new_map else (reused_map,)
            self._earlier_outputs = tuple(output for output in self._state.outputs if output not in reused)
            self._change(outputs=(*reused, *self._earlier_outputs))
            self._finish_inputs = self._state.map_inputs
            if options.texture and files.texture is None:
                self._say("note", f"the source has no image; made instead: {', '.join(made_of(commands))}")
            self._runner.start(remaining)

    def close(self) -> None:
        """End all computations; unsaved landmarks are in the autosave."""
        self._runner.cancel()
        self._preview.close()

    # Private

    def _save(self, path: Path | None = None) -> None:
        files, scene = self._require_open()
        target = files.landmarks if path is None else self.workspace.resolve(path)
        written, notes = save_landmarks(target, self._state.history.present, scene, files, self._tracker)
        self._say_all(notes)
        self._say("note", f"saved {', '.join(map(self.workspace.display_name, written))}")
        if written == (target,):  # after two files of points the open file stays
            if target != files.landmarks and autosave_path(target).is_file():
                move_aside(autosave_path(target))  # of an earlier session
            match = files.recorded_match and files.recorded_match.with_defaults_of(*LANDMARK_FIELDS)
            self._change(files=replace(files, landmarks=target, recorded_match=match), saved=True)
            self._tracker.remove_autosave(files.landmarks)

    def _on_output(self, output: Output) -> None:
        with self._lock:
            output = replace(output, uv_set=self._finish_uv_set)
            self._written_map.record(output)
            if self._finish_inputs[:1] != self._state.map_inputs[:1]:
                self._say("note", f"{output.path.name} was made of the models that were open before")
            elif output.path not in [other.path for other in self._finish_outputs]:
                before, earlier = self._finish_outputs, self._earlier_outputs
                others = (other for other in earlier if output.path != other.path and output.title != other.title)
                self._earlier_outputs = tuple(others)
                self._change(outputs=(*before, output, *self._earlier_outputs))
                shown, image = first_image(before), first_image((*before, output))
                is_unchanged = shown is None or self._state.view.baked == shown
                if image != shown and is_unchanged and self._finish_inputs == self._state.map_inputs:
                    self.show_baked_image(image)

    @property
    def _finish_outputs(self) -> tuple[Output, ...]:
        """Outputs of the last finish."""
        return tuple(output for output in self._state.outputs if output not in self._earlier_outputs)

    def _on_message(self, message: Message) -> None:
        self._say(message.kind, explain_flags(self.options, in_page_words(message.text)))

    def _on_end(self, message: Message, is_cancelled: bool) -> None:
        differences: tuple[str, ...] = ()
        with self.report_errors():  # no lock: this takes longer than a click
            if self._finish_inputs == self._state.map_inputs:
                differences = tuple(map_difference_notes(self._scene, self._finish_outputs))
        with self._lock:
            is_map_written = any(output.title == MAP_TITLE for output in self._finish_outputs)
            if self._has_new_map and is_map_written and not is_cancelled:  # the others are of an earlier map
                self._change(outputs=self._finish_outputs)
            self._say(message.kind, message.text)
            self._say_all(differences, "error")  # last: the status line shows it
            if self._state.baked_images and self._finish_inputs != self._state.map_inputs:
                self._say("note", "the baked images show the map before the last changes; press Bake for the new map")
