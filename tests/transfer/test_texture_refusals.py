"""Textures that cannot be laid on a surface: every message says which option, what is wrong, and what to do."""

from __future__ import annotations

import numpy as np
import pytest

from cagemap.transfer.texture import lay_texture

from refusals import Refusal

UVS, TRIANGLES = np.eye(3)[:, :2], np.arange(3)[None]
REFUSED = {
    "another wrap": Refusal(
        lambda _: lay_texture(np.zeros((4, 4), np.uint8), UVS, TRIANGLES, wrap="mirror"),  # type: ignore[arg-type]
        "wrap: ",
        "expected 'repeat' or 'clamp'",
        "got 'mirror'",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_texture_that_cannot_be_laid_is_refused(name: str) -> None:
    REFUSED[name].check(None)
