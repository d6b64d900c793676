"""What the tests of files share."""

from dataclasses import replace
from pathlib import Path

import numpy as np
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


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An identity between two USD cubes: the target in centimetres, Z up, shifted; the source in metres, Y up."""
    from usd_rigs import write_rigged

    from cagemap.files.result.folder import write_result
    from cagemap.files.result.manifest import file_hash

    from example_result import identity_result

    monkeypatch.chdir(tmp_path)
    shift = np.eye(4)
    shift[3, :3] = [7, 0, 0]
    write_rigged(tmp_path / "large.usda", "large.usda", 2.0, shift, ("Z", 0.01))
    write_rigged(tmp_path / "small.usda", "small.usda", 1.0, None, ("Y", 1.0))
    result = identity_result()
    files = {"target": "large.usda", "source": "small.usda"}
    inputs = {
        side: {"file": name, "path": f"../{name}", "sha256": file_hash(tmp_path / name)} for side, name in files.items()
    }
    write_result(tmp_path / "RESULT", replace(result, provenance={**result.provenance, "inputs": inputs}))
    return tmp_path
