"""What to make of the pair, with the options of the command line, and what was made."""

from __future__ import annotations

from typing import Any

import viser

from cagemap.errors import CagemapError
from cagemap.studio.finish import DEFAULT_VERTICES, FinishOptions
from cagemap.studio.finish_layout import FILES, MORE_IMAGES, SIZE, VERTICES, WRAP, Field, Fold, folds
from cagemap.studio.page.choices import Choices, put
from cagemap.studio.page.controls import Control, control, named_files
from cagemap.studio.page.texts import outputs_text
from cagemap.studio.session import Session
from cagemap.studio.state import Studio
from cagemap.studio.workspace import IMAGES
from cagemap.tasks.requests.catalogue import Key, Value

AS_IMAGE = "as the image"
NO_MAP = "(none)"
PREVIEW = "map, as under View"
SIZES = ("512", "1024", "2048", "4096", "8192", "16384")
IMAGE_FORMS = (".png", ".tif", ".exr", ".jpg")
MAP_FORMS = (".npy", ".npz", ".mtx", ".vts", ".mhclo", ".proxy")
_MAPS = "roughness, normals, ... of the source's material, all baked in one run: NAME=FILE, with commas"
_NAME = "what files begin with; another name keeps what an earlier bake wrote"


class FinishPanel:
    """What is asked for most, the button and its results; below them all other options, folded up."""

    def __init__(self, gui: Any, session: Session, choices: Choices) -> None:
        self._session, self._choices = session, choices
        self._controls: dict[Key, Control] = {}
        usual = FinishOptions()
        hint = "bake the open texture into the target's layout"
        self._texture = gui.add_checkbox("Texture", usual.texture, hint=hint)
        self._size = gui.add_dropdown("Texels", (AS_IMAGE, *SIZES), hint="width and height of every image")
        hint = "how finely the final map is computed, on each model; more is slower"
        self._vertices = gui.add_number("Vertices", DEFAULT_VERTICES, min=1000, max=20_000_000, step=1000, hint=hint)
        hint = "makes all that is chosen here, beside the landmark file"
        self._bake = gui.add_button("Bake", icon=viser.Icon.FLAME, color="orange", hint=hint)
        self._bake.on_click(lambda _: self._start())
        self._outputs = gui.add_html("")
        hint = "a baked image in the target's own layout, or the map as before"
        self._baked = gui.add_dropdown("On the model", (PREVIEW,), hint=hint, visible=False)
        self._baked.on_update(lambda event: self._look(event.client))
        for fold in folds(session.options):
            with gui.add_folder(fold.title, expand_by_default=False):
                self._fold(gui, fold, usual)

    def refresh(self, state: Studio) -> None:
        """Show the state as it is now."""
        put(self._outputs, "content", outputs_text(state))
        put(self._bake, "disabled", state.files is None or state.finish_job is not None)
        names = (PREVIEW, *(path.name for path in state.images))
        if tuple(self._baked.options) != names:
            self._baked.options = names
            self._choices.refresh()
        shown = state.view.baked if state.view.mode == "baked" else None
        put(self._baked, "value", shown.name if shown is not None and shown.name in names else PREVIEW)
        put(self._baked, "visible", len(names) > 1)

    def options(self) -> FinishOptions:
        """What is asked for.

        Raises
        ------
        CagemapError
            If a value is none, or a file lies outside the workspace.
        """
        given: dict[Key, Value] = {VERTICES: int(self._vertices.value)}
        given |= {} if self._size.value == AS_IMAGE else {SIZE: int(self._size.value)}
        for key, shown in self._controls.items():
            value = shown.value()
            if value != self._session.options[key].default:
                given[key] = value
        if given.get(("match", "level")) is not None:
            del given[VERTICES]
        return FinishOptions(
            texture=self._texture.value,
            maps=self._maps.value(),  # type: ignore[arg-type]
            map_form="" if self._map.value == NO_MAP else self._map.value,
            image_form="" if self._form.value == AS_IMAGE else self._form.value,
            wrap=self._wrap.value,
            report=self._report.value,
            name=str(self._name.value).strip(),
            given=given,
        )

    def _fold(self, gui: Any, fold: Fold, usual: FinishOptions) -> None:
        """Options of a fold, and what the page asks there besides."""
        if fold.title == MORE_IMAGES:
            self._maps = named_files(gui, self._choices, Field(("transfer", "maps"), "Maps", IMAGES), _MAPS)
        if fold.title == WRAP:
            self._wrap = gui.add_checkbox("Wrap", usual.wrap, hint="the target's cage in the source's shape")
        if fold.title == FILES:
            self._name = gui.add_text("Name", usual.name, hint=_NAME)
            self._form = gui.add_dropdown("Format", (AS_IMAGE, *IMAGE_FORMS), hint="of all images")
            self._map = gui.add_dropdown("Map file", (NO_MAP, *MAP_FORMS), hint="the map itself, for other programs")
            self._report = gui.add_checkbox("Report", usual.report, hint="one page about the map and what was made")
        for field in fold.fields:
            self._controls[field.key] = control(gui, self._choices, self._session.options[field.key], field)

    def _start(self) -> None:
        try:
            asked = self.options()
        except CagemapError as error:
            self._session.report(error)
            return
        self._session.finish(asked)

    def _look(self, client: object) -> None:
        if client is None:  # by `refresh`
            return
        images = self._session.state.images
        self._session.look_at(next((path for path in images if path.name == self._baked.value), None))
