"""Damaged USD characters: a named error or a valid result, never another exception."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cagemap.files.gltf.character import character_of
from cagemap.files.gltf.parts import read_scene
from cagemap.files.gltf.write import character_glb
from cagemap.files.values.attributes import read_attributes
from cagemap.files.values.rigs import read_skeleton

from damage import cases, mutated_bytes, outcome

pytest.importorskip("pxr.Usd", reason="usd-core is not installed")

from cagemap.files.usd.character import write_usd_character
from cagemap.files.usd.convert import usd_document
from cagemap.files.usd.read import read_usd
from cagemap.files.usd.space import to_standard

from usd_characters import lively, painted, with_shape_track

pytestmark = pytest.mark.slow


def use(path: Path) -> None:
    """All that `rig` reads of a character."""
    document = usd_document(path)
    character = character_of(document)
    assert all(np.isfinite(part.mesh.positions).all() for part in character.parts)


def use_values(path: Path) -> None:
    """All that `transfer` reads of a rigged mesh."""
    read_skeleton(path)
    read_attributes(path)
    assert np.isfinite(read_usd(path).positions).all()
    to_standard(path)


def with_number(content: bytes, rng: np.random.Generator) -> bytes:
    """A layer as text with a number of one of its lines replaced, or the line removed."""
    lines = content.split(b"\n")
    place = int(rng.integers(6, len(lines)))
    numbers = list(re.finditer(rb"-?\d+\.?\d*(e-?\d+)?", lines[place]))
    if not numbers:
        return b"\n".join(lines[:place] + lines[place + 1 :])
    start, end = numbers[rng.integers(len(numbers))].span()
    word = (b"0", b"-1", b"nan", b"inf", b"1e30", b"999999", b"0.5")[rng.integers(7)]
    lines[place] = lines[place][:start] + word + lines[place][end:]
    return b"\n".join(lines)


@pytest.mark.parametrize("suffix", [".usda", ".usdc"])
def test_changed_values_are_a_named_error_or_a_character(tmp_path: Path, suffix: str) -> None:
    rng = np.random.default_rng(11)
    change = with_number if suffix == ".usda" else mutated_bytes
    made = with_shape_track(lively(), "walk | fast", np.array([[0.0, 0.0], [1.0, 0.25], [0.5, 1.0]]))
    alone = replace(made, parts=made.parts[:1])
    read = []
    for name, (character, document, of) in {
        "C": (made, character_glb(made), use),
        "P": (*painted(), use),
        "V": (alone, character_glb(alone), use_values),
    }.items():
        given = tmp_path / f"{name}{suffix}"
        write_usd_character(given, character, read_scene(document))
        assert outcome(lambda given=given, of=of: of(given))
        content = given.read_bytes()
        for number in cases(40 if of is use_values else 10):
            path = tmp_path / f"{name}{number}{suffix}"  # USD keeps what it has read by name
            path.write_bytes(change(content, rng))
            read.append(outcome(lambda path=path, of=of: of(path)))
    assert 0 < sum(read) < len(read)
