"""Which part of either file is open, and whether a scan is taken as it is."""

from __future__ import annotations

from functools import partial
from typing import Any

import viser

from cagemap.studio.file_parts import Offer
from cagemap.studio.landmarks import SIDES, Side
from cagemap.studio.page.choices import NONE, put
from cagemap.studio.scene import Scene
from cagemap.studio.session import Session

WHOLE = "the whole file"


class PartChoices:
    """A dropdown for each side, shown where its file has several parts, and a button where it looks like a scan."""

    def __init__(self, gui: Any, session: Session) -> None:
        self._session = session
        self._offers: dict[Side, Offer] = {}
        self._parts: dict[Side, Any] = {}
        self._scans: dict[Side, Any] = {}
        for side in SIDES:
            hint = f"part of the {side}'s file; choosing another one opens it"
            part = gui.add_dropdown(f"{side.capitalize()} part", (NONE,), visible=False, hint=hint)
            part.on_update(partial(self._chosen, side))
            hint = f"the {side} has as many triangles as a scan: match it without subdividing it"
            scan = gui.add_button(f"Take the {side} as it is", icon=viser.Icon.SCAN, visible=False, hint=hint)
            scan.on_click(partial(self._as_it_is, side))
            self._parts[side], self._scans[side] = part, scan

    def refresh(self, scene: Scene | None) -> None:
        """Show what the open files offer."""
        if scene is None:
            return
        for side, offer, dense in zip(SIDES, scene.offers, scene.dense, strict=True):
            self._offers[side] = offer
            words = labels(offer)
            handle = self._parts[side]
            if words and tuple(handle.options) != tuple(words):
                handle.options = tuple(words)
            if words:
                put(handle, "value", next(word for word, title in words.items() if title == offer.opened))
            put(handle, "visible", len(words) > 1)
            put(self._scans[side], "visible", dense)

    def _chosen(self, side: Side, event: Any) -> None:
        if event.client is None:  # by `refresh`, not by a person
            return
        offer = self._offers.get(side, Offer())
        title = labels(offer).get(self._parts[side].value)
        if title != offer.opened:
            self._session.choose_part(side, title)

    def _as_it_is(self, side: Side, _: object) -> None:
        self._session.take_as_it_is(side)


def labels(offer: Offer) -> dict[str, str | None]:
    """What a person chooses from, and the part that each line means; None for the whole file."""
    whole: dict[str, str | None] = {WHOLE: None} if offer.titles and offer.whole else {}
    return whole | {f"{title} ({faces:,} faces)": title for title, faces in zip(offer.titles, offer.faces, strict=True)}
