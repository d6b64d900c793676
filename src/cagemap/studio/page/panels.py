"""The two panels: files, view and finish on the left, landmarks and map on the right."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import viser

from cagemap.errors import CagemapError, ParameterError
from cagemap.files.landmarks.point_formats import POINT_FORMS
from cagemap.mesh.schemes import SCHEMES
from cagemap.studio.landmarks import Landmark, rename
from cagemap.studio.opening import default_files
from cagemap.studio.page.choices import NONE, Choices, put
from cagemap.studio.page.finish_panel import FinishPanel
from cagemap.studio.page.part_choices import PartChoices
from cagemap.studio.page.texts import landmark_table, map_text, parts_text, status_text
from cagemap.studio.scene import Scene
from cagemap.studio.session import Session
from cagemap.studio.state import MODES, Files, Studio
from cagemap.studio.workspace import IMAGES, LANDMARKS, MESHES

WIDTH = 270
AS_FILED = "as the file says"
# Ways in which two models may agree that have a button.
MOST_ANSWERS = 6
# What landmarks are saved as, and the endings that ask for it.
FORMS = {"pairs (.json)": ".json"} | {f"{form.title} ({form.ending})": form.ending for form in POINT_FORMS}


class SetupPanel:
    """Files, view and finish."""

    def __init__(
        self, server: viser.ViserServer, session: Session, choices: Choices, frame: Callable[[], None]
    ) -> None:
        self._session, self._choices = session, choices
        gui = server.gui
        gui.set_panel_label("cagemap studio · target")
        with gui.add_folder("Models"):
            self._target = choices.dropdown(gui, "Target", MESHES, "receives: the model that gets the texture")
            self._source = choices.dropdown(gui, "Source", MESHES, "gives: the model that has the texture")
            self._texture = choices.dropdown(gui, "Texture", IMAGES, "an image over the source's UVs")
            self._source.on_update(lambda event: self._guess_texture(event.client))
            for number, handle in enumerate((self._target, self._source)):
                handle.on_update(partial(self._forget, number))
            with gui.add_folder("As what", expand_by_default=False):
                hint = "how it is subdivided; none: taken as it is, such as a scan"
                self._schemes = _two_dropdowns(gui, "scheme", (AS_FILED, *SCHEMES), hint)
                hint = "axis that points up, for the view alone; only USD files say it, in others it is y"
                self._ups = _two_dropdowns(gui, "up", (AS_FILED, "y", "z"), hint)
            gui.add_button("Open", icon=viser.Icon.FOLDER_OPEN).on_click(lambda _: self._open())
            upload = gui.add_upload_button(
                "Add a file", color="gray", hint="copies a file of yours into the studio's folder"
            )
            upload.on_upload(lambda event: self._upload(event.target.value))
            self._parts = PartChoices(gui, session)
        with gui.add_folder("View"):
            view = session.state.view
            self._mode = gui.add_dropdown("Show", MODES, initial_value=view.mode)
            self._doubts = gui.add_checkbox("Doubtful places", view.doubts, hint="red where the map folds or strains")
            self._cages = gui.add_checkbox("Cages", view.cages)
            self._linked = gui.add_checkbox("Turn together", view.linked)
            self._rest = gui.add_checkbox("Other parts", view.rest, visible=False, hint="of the files, in grey")
            fields: dict[str, Any] = {
                "mode": self._mode,
                "doubts": self._doubts,
                "cages": self._cages,
                "linked": self._linked,
            }
            for name, handle in (fields | {"rest": self._rest}).items():
                handle.on_update(partial(self._show, name))
            gui.add_button("Frame", icon=viser.Icon.FOCUS_CENTERED, color="gray", hint="the whole models").on_click(
                lambda _: frame()
            )
        with gui.add_folder("Finish"):
            self._finish = FinishPanel(gui, session, choices)
        self._names = gui.add_html("")
        self._shown: Files | None = None
        gui.main_panel.dock_left()
        gui.main_panel.set_width(WIDTH)

    def refresh(self, state: Studio, scene: Scene | None) -> None:
        """Show the state as it is now."""
        if state.files is not None and state.files != self._shown:
            self._shown = files = state.files
            chosen = ((self._target, files.target), (self._source, files.source), (self._texture, files.texture))
            for handle, path in chosen:
                self._choices.choose(handle, path)
            handles = (*self._schemes, *self._ups)
            for handle, stated in zip(handles, (*files.schemes, *files.ups), strict=True):
                put(handle, "value", stated or AS_FILED)
        view = state.view
        put(self._doubts, "value", view.doubts)
        put(self._cages, "value", view.cages)
        put(self._linked, "value", view.linked)
        put(self._mode, "value", view.mode)
        put(self._rest, "value", view.rest)
        put(self._rest, "visible", scene is not None and scene.leaves_any)
        put(self._names, "content", parts_text(scene))
        self._parts.refresh(scene)
        self._finish.refresh(state)

    def _show(self, name: str, event: Any) -> None:
        if event.client is not None:  # by a person, not by `refresh`
            self._session.show_as(**{name: event.target.value})

    def _guess_texture(self, client: object) -> None:
        """An image named after the source is most likely its texture; that of another source is not."""
        stem = Path(self._source.value).stem
        named = [name for name in self._texture.options if Path(name).stem.startswith(stem)]
        if client is not None:
            put(self._texture, "value", named[0] if named else NONE)

    def _forget(self, number: int, event: Any) -> None:
        """How the open model is taken is not said of another one, unless it was chosen since."""
        if event.client is None or self._shown is None:
            return
        for handles, stated in ((self._schemes, self._shown.schemes), (self._ups, self._shown.ups)):
            if handles[number].value == (stated[number] or AS_FILED):
                put(handles[number], "value", AS_FILED)

    def _open(self) -> None:
        folder = self._session.workspace.folders[0]
        try:
            target, source, texture = map(self._choices.path, (self._target, self._source, self._texture))
            if target is None or source is None:
                raise ParameterError("expected a target and a source, got one of them or none. Choose both.")
            files = default_files(folder, target, source, texture, _stated(self._schemes))
            self._session.open(replace(files, ups=_stated(self._ups)))
        except CagemapError as error:
            self._session.report(error)

    def _upload(self, file: viser.UploadedFile) -> None:
        if self._session.add_file(file.name, file.content):
            self._choices.refresh()


def _two_dropdowns(gui: Any, word: str, options: tuple[str, ...], hint: str) -> tuple[Any, Any]:
    """A dropdown for the target and one for the source."""
    return gui.add_dropdown(f"Target {word}", options, hint=hint), gui.add_dropdown(
        f"Source {word}", options, hint=hint
    )


def _stated(handles: tuple[Any, Any]) -> tuple[str | None, str | None]:
    """What two dropdowns say; None: as the file says."""
    one, two = (None if handle.value == AS_FILED else str(handle.value) for handle in handles)
    return one, two


class WorkPanel:
    """Landmarks and map."""

    def __init__(self, server: viser.ViserServer, session: Session, choices: Choices) -> None:
        self._session, self._choices = session, choices
        self._numbers: dict[str, int] = {}
        self._shown: Path | None = None
        self._named: tuple[int | None, str] = (None, "")
        self._typed: list[tuple[int | None, str]] = []
        gui = server.gui
        gui.set_panel_label("source")
        self._status = gui.add_html("")
        self._progress = gui.add_progress_bar(0.0, animated=True, visible=False)
        self._cancel = gui.add_button("Cancel", icon=viser.Icon.X, visible=False)
        self._cancel.on_click(lambda _: self._cancelled())
        with gui.add_folder("Map"):
            self._map = gui.add_html("")
            self._answers = [gui.add_button(NONE, visible=False) for _ in range(MOST_ANSWERS)]
            for index, button in enumerate(self._answers):
                button.on_click(partial(self._choose_answer, index))
            again = gui.add_button("Match again", icon=viser.Icon.REFRESH, color="gray", hint="from the start")
            again.on_click(lambda _: session.match_again())
        with gui.add_folder("Landmarks"):
            self._accept = gui.add_button("Accept proposal", icon=viser.Icon.CHECK, color="green", disabled=True)
            self._accept.on_click(lambda _: session.accept())
            self._next = gui.add_button("Next landmark", icon=viser.Icon.BULB, hint="where one more tells most")
            self._next.on_click(lambda _: session.next_landmark())
            self._steps = gui.add_button_group("", ("Undo", "Redo"))
            self._steps.on_click(lambda _: session.undo() if self._steps.value == "Undo" else session.redo())
            self._list = gui.add_html("")
            self._chosen = gui.add_dropdown("Selected", (NONE,))
            self._chosen.on_update(lambda event: self._select(event.client))
            self._name = gui.add_text("Name", "", visible=False)
            self._name.on_update(lambda event: self._rename(event.client))
            self._changes = gui.add_button_group("", ("Delete", "Mirror"), visible=False)
            self._changes.on_click(
                lambda _: self._on_selected(session.remove if self._changes.value == "Delete" else session.mirror)
            )
            self._file = gui.add_text("File", "")
            self._form = gui.add_dropdown(
                "Save as", tuple(FORMS), hint="a program that has one mesh gets one file each"
            )
            self._form.on_update(lambda event: self._choose_form(event.client))
            self._save = gui.add_button("Save landmarks", icon=viser.Icon.DEVICE_FLOPPY, color="gray")
            self._save.on_click(lambda _: self._saved())
            with gui.add_folder("Load landmarks", expand_by_default=False):
                self._pairs = choices.dropdown(gui, "From", LANDMARKS, "a file of pairs, or of the target's points")
                self._points = choices.dropdown(gui, "And", LANDMARKS, "the source's points, where they are a file")
                self._load = gui.add_button("Load", icon=viser.Icon.FOLDER_OPEN, color="gray")
                self._load.on_click(lambda _: self._loaded())
        gui.add_command("Undo", hotkey="Z", modifier="cmd/ctrl").on_trigger(lambda _: session.undo())
        gui.add_command("Redo", hotkey="Z", modifier="cmd/ctrl+shift").on_trigger(lambda _: session.redo())
        gui.main_panel.dock_right()
        gui.main_panel.set_width(WIDTH)

    def refresh(self, state: Studio) -> None:
        """Show the state as it is now."""
        self._refresh_status(state)
        items = state.history.present.items
        put(self._list, "content", landmark_table(state))
        labels = (NONE, *(f"{item.number} {item.name}" for item in items))
        self._numbers = {label: item.number for label, item in zip(labels[1:], items, strict=True)}
        if tuple(self._chosen.options) != labels:
            self._chosen.options = labels
        selected = state.history.present.get(state.selected)
        put(self._chosen, "value", NONE if selected is None else f"{selected.number} {selected.name}")
        self._refresh_name(selected)
        for handle in (self._name, self._changes):
            put(handle, "visible", selected is not None)
        put(self._next, "disabled", state.map.revision == 0)
        put(self._accept, "disabled", state.proposal is None)
        if state.files is not None and state.files.landmarks != self._shown:
            self._shown = state.files.landmarks
            put(self._file, "value", self._session.workspace.show(state.files.landmarks))
            put(self._form, "value", next(iter(FORMS)))
        put(self._map, "content", map_text(state))
        self._refresh_answers(state)

    def _refresh_name(self, selected: Landmark | None) -> None:
        """Show another name than before; one that is being typed is left as it is, the page may be letters ahead."""
        named = (None, "") if selected is None else (selected.number, selected.name)
        if named == self._named:
            return
        self._named = named
        if named in self._typed:
            del self._typed[: self._typed.index(named) + 1]
        else:
            self._typed.clear()
            put(self._name, "value", named[1])

    def _refresh_answers(self, state: Studio) -> None:
        """A button for every way in which the models may agree, where there are several."""
        answers = state.map.answers if len(state.map.answers) > 1 else ()
        for index, button in enumerate(self._answers):
            here = index < len(answers)
            if here:
                chosen = index == state.map.chosen
                put(button, "label", f"{index + 1} \u00b7 {answers[index]}")
                put(button, "color", "blue" if chosen else "gray")
                put(button, "icon", viser.Icon.CHECK if chosen else None)
            put(button, "visible", here)

    def _refresh_status(self, state: Studio) -> None:
        job = state.finish_job or state.preview_job
        put(self._status, "content", status_text(state))
        put(self._progress, "visible", job is not None)
        put(self._progress, "value", 100.0 if job is None or job.fraction is None else max(5.0, 100 * job.fraction))
        put(self._cancel, "visible", job is not None and job.can_cancel)

    def _cancelled(self) -> None:
        if self._session.state.finish_job is not None:
            self._session.cancel_finish()
        else:
            self._session.cancel_preview()

    def _select(self, client: object) -> None:
        if client is not None:  # by a person, not by `refresh`
            self._session.select(self._numbers.get(self._chosen.value))

    def _choose_answer(self, index: int, _: object) -> None:
        if index != self._session.state.map.chosen:
            self._session.choose_answer(index)

    def _choose_form(self, client: object) -> None:
        """Another program's file has another ending."""
        if client is not None:
            put(self._file, "value", with_ending(self._file.value, FORMS[self._form.value]))

    def _rename(self, client: object) -> None:
        number = self._session.state.selected
        if client is not None and number is not None:
            name = str(self._name.value)
            renamed = rename(self._session.state.history.present, number, name).get(number)
            self._typed.append((number, name if renamed is None else renamed.name))
            self._session.rename(number, name)

    def _saved(self) -> None:
        self._session.save_as(self._file.value)
        self._choices.refresh()

    def _loaded(self) -> None:
        try:
            path, points = self._choices.path(self._pairs), self._choices.path(self._points)
            if path is None:
                raise ParameterError("expected a landmark file, none is chosen. Choose one under From.")
            self._session.load(path, points)
        except CagemapError as error:
            self._session.report(error)

    def _on_selected(self, change: Callable[[int], None]) -> None:
        number = self._session.state.selected
        if number is not None:
            change(number)


def with_ending(name: str, ending: str) -> str:
    """A file name with the ending of another form."""
    old = max((known for known in FORMS.values() if name.lower().endswith(known)), key=len, default="")
    return name[: len(name) - len(old)] + ending
