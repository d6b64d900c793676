"""What the tests of files share."""

from pathlib import Path

import pytest


@pytest.fixture
def painted_path(tmp_path: Path) -> Path:
    """C.usda: a character with a material that has every slot."""
    from cagemap.files.gltf.parts import read_scene
    from cagemap.files.usd.character import write_usd_character

    from usd_characters import painted

    made, document = painted()
    write_usd_character(tmp_path / "C.usda", made, read_scene(document))
    return tmp_path / "C.usda"
