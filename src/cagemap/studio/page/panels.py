"""The two panels: files and view on the left, landmarks, map and finish on the right."""

from __future__ import annotations

import html
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import viser

from cagemap.errors import CagemapError
from cagemap.studio.finish import FinishOptions
from cagemap.studio.opening import default_files
from cagemap.studio.page.colors import css, landmark_color
from cagemap.studio.session import Session
from cagemap.studio.state import MODES, Studio
from cagemap.studio.workspace import IMAGES, LANDMARKS, MESHES

NONE = "(none)"
WIDTH = 270
# Rows of the list before it scrolls, in pixels.
LIST_HEIGHT = 220


class SetupPanel:
    """Files and view."""

    def __init__(self, server: viser.ViserServer, session: Session, frame: Callable[[], None]) -> None:
        self._session = session
        gui = server.gui
        gui.set_panel_label("cagemap studio · target")
        workspace = session.workspace
        with gui.add_folder("Models"):
            meshes = workspace.listing(MESHES) or (NONE,)
            self._target = gui.add_dropdown("Target", meshes, hint="receives: the model that gets the texture")
            self._source = gui.add_dropdown("Source", meshes, hint="gives: the model that has the texture")
            images = (NONE, *workspace.listing(IMAGES))
            self._texture = gui.add_dropdown("Texture", images, hint="an image over the source's UVs")
            self._source.on_update(lambda event: self._guess_texture(event.client))
            gui.add_button("Open", icon=viser.Icon.FOLDER_OPEN).on_click(lambda _: self._open())
            upload = gui.add_upload_button("Add a file", hint="copies a file of yours into the studio's folder")
            upload.on_upload(lambda event: self._upload(event.target.value))
        with gui.add_folder("View"):
            view = session.state.view
            self._mode = gui.add_dropdown("Show", MODES, initial_value=view.mode)
            self._doubts = gui.add_checkbox("Doubtful places", view.doubts, hint="red where the map folds or strains")
            self._cages = gui.add_checkbox("Cages", view.cages)
            self._linked = gui.add_checkbox("Turn together", view.linked)
            for handle in (self._mode, self._doubts, self._cages, self._linked):
                handle.on_update(lambda _: self._show())
            gui.add_button("Frame", icon=viser.Icon.FOCUS_CENTERED).on_click(lambda _: frame())
        self._parts = gui.add_markdown("")
        gui.main_panel.dock_left()
        gui.main_panel.set_width(WIDTH)

    def refresh(self, state: Studio, parts: str) -> None:
        """Show the state as it is now."""
        workspace = self._session.workspace
        if state.files is not None:
            files = state.files
            chosen = ((self._target, files.target), (self._source, files.source), (self._texture, files.texture))
            for handle, path in chosen:
                name = NONE if path is None else workspace.show(path)
                if name not in handle.options:
                    handle.options = (*handle.options, name)
                _set(handle, "value", name)
        view = state.view
        _set(self._doubts, "value", view.doubts)
        _set(self._cages, "value", view.cages)
        _set(self._linked, "value", view.linked)
        _set(self._mode, "value", view.mode)
        _set(self._parts, "content", parts)

    def _show(self) -> None:
        view = replace(
            self._session.state.view,
            mode=self._mode.value,
            doubts=self._doubts.value,
            cages=self._cages.value,
            linked=self._linked.value,
        )
        if view != self._session.state.view:
            self._session.show(view)

    def _guess_texture(self, client: object) -> None:
        """An image named after the source is most likely its texture."""
        stem = Path(self._source.value).stem
        named = [name for name in self._texture.options if Path(name).stem.startswith(stem)]
        if client is not None and named:
            _set(self._texture, "value", named[0])

    def _open(self) -> None:
        workspace = self._session.workspace
        texture = None if self._texture.value == NONE else self._texture.value
        try:
            target, source = workspace.require(self._target.value), workspace.require(self._source.value)
            image = None if texture is None else workspace.require(texture)
        except CagemapError as error:
            self._session.report(error)
            return
        self._session.open(default_files(workspace.folders[0], target, source, image))

    def _upload(self, file: viser.UploadedFile) -> None:
        if self._session.add_file(file.name, file.content):
            workspace = self._session.workspace
            self._target.options = self._source.options = workspace.listing(MESHES) or (NONE,)
            self._texture.options = (NONE, *workspace.listing(IMAGES))


class WorkPanel:
    """Landmarks, map and finish."""

    def __init__(self, server: viser.ViserServer, session: Session) -> None:
        self._server, self._session = server, session
        self._numbers: dict[str, int] = {}
        gui = server.gui
        gui.set_panel_label("source")
        self._status = gui.add_html("")
        self._progress = gui.add_progress_bar(0.0, animated=True, visible=False)
        self._cancel = gui.add_button("Cancel", icon=viser.Icon.X, visible=False)
        self._cancel.on_click(lambda _: self._cancelled())
        with gui.add_folder("Landmarks"):
            self._accept = gui.add_button("Accept proposal", icon=viser.Icon.CHECK, color="green", disabled=True)
            self._accept.on_click(lambda _: session.accept())
            self._next = gui.add_button("Next landmark", icon=viser.Icon.BULB, hint="where one more tells most")
            self._next.on_click(lambda _: session.next_landmark())
            self._undo = gui.add_button("Undo", icon=viser.Icon.ARROW_BACK_UP)
            self._undo.on_click(lambda _: session.undo())
            self._redo = gui.add_button("Redo", icon=viser.Icon.ARROW_FORWARD_UP)
            self._redo.on_click(lambda _: session.redo())
            self._list = gui.add_html("")
            self._chosen = gui.add_dropdown("Selected", (NONE,))
            self._chosen.on_update(lambda event: self._select(event.client))
            self._name = gui.add_text("Name", "", disabled=True)
            self._name.on_update(lambda event: self._rename(event.client))
            self._delete = gui.add_button("Delete", icon=viser.Icon.TRASH, disabled=True)
            self._delete.on_click(lambda _: self._on_selected(session.remove))
            self._mirror = gui.add_button("Mirror", icon=viser.Icon.FLIP_VERTICAL, disabled=True)
            self._mirror.on_click(lambda _: self._on_selected(session.mirror))
            self._file = gui.add_text("File", "")
            self._save = gui.add_button("Save landmarks", icon=viser.Icon.DEVICE_FLOPPY)
            self._save.on_click(lambda _: session.save_as(self._file.value))
            self._load = gui.add_dropdown("Load", (NONE, *session.workspace.listing(LANDMARKS)))
            self._load.on_update(lambda event: self._loaded(event.client))
        with gui.add_folder("Map"):
            self._map = gui.add_html("")
            self._answers = gui.add_dropdown("Answer", (NONE,), hint="other ways in which target and source may agree")
            self._answers.on_update(lambda event: self._choose_answer(event.client))
            gui.add_button("Match again", icon=viser.Icon.REFRESH).on_click(lambda _: session.match_again())
        with gui.add_folder("Finish"):
            self._finish_controls(gui)
        gui.add_command("Undo", hotkey="Z", modifier="cmd/ctrl").on_trigger(lambda _: session.undo())
        gui.add_command("Redo", hotkey="Z", modifier="cmd/ctrl+shift").on_trigger(lambda _: session.redo())
        gui.main_panel.dock_right()
        gui.main_panel.set_width(WIDTH)

    def refresh(self, state: Studio) -> None:
        """Show the state as it is now."""
        self._refresh_status(state)
        items = state.history.present.items
        _set(self._list, "content", landmark_table(state))
        labels = (NONE, *(f"{item.number} {item.name}" for item in items))
        self._numbers = {label: item.number for label, item in zip(labels[1:], items, strict=True)}
        if tuple(self._chosen.options) != labels:
            self._chosen.options = labels
        selected = state.history.present.get(state.selected)
        _set(self._chosen, "value", NONE if selected is None else f"{selected.number} {selected.name}")
        _set(self._name, "value", "" if selected is None else selected.name)
        for handle in (self._name, self._delete, self._mirror):
            _set(handle, "disabled", selected is None)
        _set(self._undo, "disabled", not state.history.past)
        _set(self._redo, "disabled", not state.history.future)
        _set(self._next, "disabled", state.map.revision == 0)
        _set(self._accept, "disabled", state.proposal is None)
        if state.files is not None and not self._file.value:
            _set(self._file, "value", self._session.workspace.show(state.files.landmarks))
        _set(self._map, "content", map_text(state))
        answers = tuple(f"{number + 1} {name}" for number, name in enumerate(state.map.answers)) or (NONE,)
        if tuple(self._answers.options) != answers:
            self._answers.options = answers
        _set(self._answers, "value", answers[min(state.map.chosen, len(answers) - 1)])
        _set(self._outputs, "content", outputs_text(state))
        names = tuple(output.path.name for output in state.outputs if output.path.is_file()) or (NONE,)
        if tuple(self._download.options) != names:
            self._download.options = names

    def _finish_controls(self, gui: Any) -> None:
        images = (NONE, *self._session.workspace.listing(IMAGES))
        self._texture = gui.add_checkbox("Texture", True)
        self._displacement = gui.add_dropdown("Displacement", images)
        self._colors = gui.add_checkbox("Material colours", False)
        self._unwrap = gui.add_checkbox("Unwrap target", False, hint="for a target without UVs")
        self._size = gui.add_dropdown("Texels", ("as the image", "1024", "2048", "4096", "8192"))
        self._vertices = gui.add_number("Vertices", FinishOptions().vertices, min=1000, max=20_000_000, step=1000)
        self._bake = gui.add_button("Bake", icon=viser.Icon.FLAME, color="orange")
        self._bake.on_click(lambda _: self._session.finish(self._options()))
        self._outputs = gui.add_html("")
        self._download = gui.add_dropdown("Result", (NONE,))
        gui.add_button("Download", icon=viser.Icon.DOWNLOAD).on_click(lambda event: self._send(event.client))

    def _options(self) -> FinishOptions:
        displacement = None if self._displacement.value == NONE else self._displacement.value
        return FinishOptions(
            vertices=int(self._vertices.value),
            size=int(self._size.value) if self._size.value.isdigit() else None,
            texture=self._texture.value,
            displacement=None if displacement is None else self._session.workspace.require(displacement),
            material_colors=self._colors.value,
            unwrap=self._unwrap.value,
        )

    def _refresh_status(self, state: Studio) -> None:
        job = state.finish_job or state.preview_job
        _set(self._status, "content", status_text(state))
        _set(self._progress, "visible", job is not None)
        _set(self._progress, "value", 100.0 if job is None or job.fraction is None else max(5.0, 100 * job.fraction))
        _set(self._cancel, "visible", job is not None and job.can_cancel)

    def _cancelled(self) -> None:
        if self._session.state.finish_job is not None:
            self._session.cancel_finish()
        else:
            self._session.cancel_preview()

    def _select(self, client: object) -> None:
        if client is not None:  # by a person, not by `refresh`
            self._session.select(self._numbers.get(self._chosen.value))

    def _choose_answer(self, client: object) -> None:
        if client is not None and self._answers.value in self._answers.options:
            self._session.choose_answer(list(self._answers.options).index(self._answers.value))

    def _rename(self, client: object) -> None:
        number = self._session.state.selected
        if client is not None and number is not None:
            self._session.rename(number, self._name.value)

    def _loaded(self, client: object) -> None:
        if client is not None and self._load.value != NONE:
            self._session.load(Path(self._load.value))

    def _on_selected(self, change: Callable[[int], None]) -> None:
        number = self._session.state.selected
        if number is not None:
            change(number)

    def _send(self, client: viser.ClientHandle | None) -> None:
        chosen = [out for out in self._session.state.outputs if out.path.name == self._download.value]
        if client is not None and chosen and chosen[0].path.is_file():
            client.send_file_download(chosen[0].path.name, chosen[0].path.read_bytes(), save_immediately=True)


def landmark_table(state: Studio) -> str:
    """The list: colour, number, name and strain of every landmark."""
    rows = []
    for item in state.history.present.items:
        strain = state.map.strain.get(item.name)
        wrong = state.map.contradictions.get(item.name)
        shown = "…" if not item.complete else "" if strain is None else f"{100 * strain:.1f} %"
        style = "background:#5a1d1d;" if wrong else ""
        style += "outline:1px solid #fff;" if item.number == state.selected else ""
        swatch = f'<span style="color:{css(landmark_color(item.number))}">&#9679;</span>'
        rows.append(
            f'<tr style="{style}" title="{html.escape(wrong or "")}"><td>{swatch} {item.number}</td>'
            f"<td>{html.escape(item.name)}{' &#9888;' if wrong else ''}</td>"
            f'<td style="text-align:right">{shown}</td></tr>'
        )
    head = f"{len(state.history.present.complete)} landmarks" + ("" if state.saved else " · not saved yet")
    return (
        f'<div id="list" style="font-size:12px;padding:0 8px"><div>{head}</div>'
        f'<div style="max-height:{LIST_HEIGHT}px;overflow-y:auto"><table style="width:100%;border-spacing:2px">'
        f"{''.join(rows)}</table></div></div>"
    )


def status_text(state: Studio) -> str:
    """What runs, and the last messages."""
    job = state.finish_job or state.preview_job
    lines = []
    if job is not None:
        lines.append(f"<b>{html.escape(job.title)}</b> {html.escape(job.stage)}")
    elif state.files is None:
        lines.append("Choose a target and a source on the left, then Open.")
    elif state.probe is not None and state.probe.text:
        lines.append(html.escape(state.probe.text))
    elif state.history.present.open is not None:
        lines.append("Click the same place on the other model, or accept the proposal.")
    else:
        lines.append("Click a model where the map is wrong, then the same place on the other one.")
    for message in reversed(state.messages):
        color = "#ff8a80" if message.kind == "error" else "#b0bec5"
        lines.append(f'<span style="color:{color}">{html.escape(message.text)}</span>')
    return f'<div id="status" style="font-size:12px;padding:4px 8px">{"<br>".join(lines)}</div>'


def map_text(state: Studio) -> str:
    """What is known about the map."""
    known = state.map
    if known.revision == 0:
        return '<div id="map" style="font-size:12px;padding:0 8px">no map yet</div>'
    lines = [f"map {known.revision}, {known.seconds:.1f} s"]
    lines += [known.confidence] if known.confidence else []
    lines += list(known.contradictions.values()) + list(known.notes)
    shown = "<br>".join(html.escape(line) for line in lines)
    return f'<div id="map" style="font-size:12px;padding:0 8px">{shown}</div>'


def outputs_text(state: Studio) -> str:
    """What was written."""
    lines = "<br>".join(f"{html.escape(out.what)}: {html.escape(out.path.name)}" for out in state.outputs)
    return f'<div id="outputs" style="font-size:12px;padding:0 8px">{lines}</div>'


def _set(handle: Any, name: str, value: Any) -> None:
    """Assign only what differs: an assignment is a message to every page."""
    if getattr(handle, name) != value:
        setattr(handle, name, value)
