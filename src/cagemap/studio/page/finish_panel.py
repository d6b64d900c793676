"""What to make of the pair, with the options of the command line, and what was made."""

from __future__ import annotations

from typing import Any

import viser

from cagemap.errors import CagemapError
from cagemap.studio.finish import FinishOptions, WrapOptions
from cagemap.studio.page.choices import Choices, put
from cagemap.studio.page.texts import outputs_text
from cagemap.studio.session import Session
from cagemap.studio.state import Studio
from cagemap.studio.workspace import IMAGES, TABLES

AS_IMAGE = "as the image"
NO_MAP = "(none)"


class FinishPanel:
    """Folders of the right panel: common options, then maps, rig, wrap and others, folded up."""

    def __init__(self, gui: Any, session: Session, choices: Choices) -> None:
        self._session, self._choices = session, choices
        usual = FinishOptions()
        self._texture = gui.add_checkbox("Texture", usual.texture)
        self._size = gui.add_dropdown("Texels", (AS_IMAGE, "1024", "2048", "4096", "8192"))
        self._vertices = gui.add_number("Vertices", usual.vertices, min=1000, max=20_000_000, step=1000)
        self._bake = gui.add_button("Bake", icon=viser.Icon.FLAME, color="orange", hint="runs the commands")
        self._bake.on_click(lambda _: self._start())
        self._outputs = gui.add_html("")
        with gui.add_folder("Other maps", expand_by_default=False):
            self._maps(gui, usual)
        with gui.add_folder("Rig", expand_by_default=False):
            self._rig(gui, usual)
        with gui.add_folder("Wrap", expand_by_default=False):
            self._wraps(gui, WrapOptions())

    def refresh(self, state: Studio) -> None:
        """Show the state as it is now."""
        put(self._outputs, "content", outputs_text(state))
        put(self._bake, "disabled", state.files is None or state.finish_job is not None)

    def options(self) -> FinishOptions:
        """What is asked for.

        Raises
        ------
        CagemapError
            If a value is none, or a file lies outside the workspace.
        """
        size, bits, midlevel = self._size.value, self._bits.value, self._midlevel.value.strip()
        chosen = self._choices.path
        try:
            return FinishOptions(
                vertices=int(self._vertices.value),
                size=None if size == AS_IMAGE else int(size),
                bits=None if bits == AS_IMAGE else int(bits),
                texture=self._texture.value,
                as_color=self._as_color.value,
                displacement=chosen(self._displacement),
                scale=float(self._scale.value),
                midlevel=float(midlevel) if midlevel else None,
                normal_map=chosen(self._normal_map),
                vector_displacement=chosen(self._vectors),
                space=self._space.value,
                green=self._green.value,
                attribute=chosen(self._attribute),
                material_colors=self._colors.value,
                source_uvs=self._source_uvs.value,
                weights=chosen(self._weights),
                influences=int(self._influences.value),
                joints=chosen(self._joints),
                blend_shapes=chosen(self._blend_shapes),
                write_map="" if self._map.value == NO_MAP else self._map.value,
                wrap=self._wrap_options(),
            )
        except ValueError as error:
            if isinstance(error, CagemapError):
                raise
            raise CagemapError(f"Finish: expected numbers in the fields for numbers ({error}). Correct them.") from None

    def _start(self) -> None:
        try:
            options = self.options()
        except CagemapError as error:
            self._session.report(error)
            return
        self._session.finish(options)

    def _maps(self, gui: Any, usual: FinishOptions) -> None:
        self._normal_map = self._choices.dropdown(gui, "Normal map", IMAGES, "its directions turn with the map")
        self._space = gui.add_dropdown("Space", ("tangent", "object"), hint="of normals and vectors")
        self._green = gui.add_dropdown("Green", ("up", "down"), hint="up: OpenGL, Blender; down: DirectX")
        self._displacement = self._choices.dropdown(gui, "Displacement", IMAGES, "height along the source's normal")
        self._scale = gui.add_number("Scale", usual.scale, step=0.001, hint="height between the values 0 and 1")
        self._midlevel = gui.add_text("Midlevel", "", hint="value that means none; empty: 0.5 for integers, else 0")
        self._vectors = self._choices.dropdown(gui, "Vectors", IMAGES, "vector displacement")
        self._colors = gui.add_checkbox("Material colours", usual.material_colors)
        self._as_color = gui.add_checkbox("As a picture", usual.as_color, hint="texture that looks like a normal map")
        self._bits = gui.add_dropdown("Bits", (AS_IMAGE, "8", "16", "32"))
        self._source_uvs = gui.add_checkbox("UVs of the source", usual.source_uvs, hint="so that its own image fits")
        forms = (NO_MAP, ".npy", ".npz", ".mtx", ".vts", ".mhclo")
        self._map = gui.add_dropdown("Map file", forms, hint="the map itself, for other programs")

    def _rig(self, gui: Any, usual: FinishOptions) -> None:
        self._weights = self._choices.dropdown(gui, "Weights", (".csv", ".npz"), "skin weights of the source's cage")
        self._influences = gui.add_number("Influences", usual.influences, min=0, step=1, hint="joints a vertex; 0: all")
        self._joints = self._choices.dropdown(gui, "Joints", (".json",), "skeleton of the source")
        shapes = (".obj", ".npz")
        self._blend_shapes = self._choices.dropdown(gui, "Blend shapes", shapes, "shapes of the source's cage")
        self._attribute = self._choices.dropdown(gui, "Attribute", TABLES, "any values at the source's vertices")

    def _wraps(self, gui: Any, usual: WrapOptions) -> None:
        self._wrap = gui.add_checkbox("Wrap", False, hint="the target's cage in the source's shape")
        self._amount = gui.add_slider("Amount", 0.0, 1.0, 0.01, usual.amount, hint="0: the target, 1: the source")
        self._fit_level = gui.add_number("Fit level", usual.fit_level, min=0, max=6, step=1)
        self._fairness = gui.add_number("Fairness", usual.fairness, min=0.0, step=1e-6, hint="larger is smoother")
        self._symmetric = gui.add_checkbox("Symmetric", usual.symmetric)
        self._rest = gui.add_checkbox("Displacement", usual.displacement, hint="image of what is still missing")
        self._rest_vectors = gui.add_checkbox("Vector displacement", usual.vector_displacement)

    def _wrap_options(self) -> WrapOptions | None:
        if not self._wrap.value:
            return None
        return WrapOptions(
            fit_level=int(self._fit_level.value),
            amount=float(self._amount.value),
            fairness=float(self._fairness.value),
            symmetric=self._symmetric.value,
            displacement=self._rest.value,
            vector_displacement=self._rest_vectors.value,
        )
