"""What a finish leaves on disk: the job file of its RESULT makes the same files again."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typed_request import run_typed

from cagemap.files.images.image import read_image, write_image
from cagemap.files.meshes.formats import read_mesh, write_mesh
from cagemap.studio.finish import FinishOptions, finish_commands
from cagemap.studio.finish_layout import SIZE_KEY, VERTICES_KEY
from cagemap.studio.opening import built_in_files
from cagemap.studio.state import Files
from cagemap.tasks.progress import Stages
from cagemap.tasks.requests.catalogue import Key, Value, all_options
from cagemap.tasks.requests.run import RunRequest
from cagemap.tasks.run_job import run_job

pytestmark = pytest.mark.slow

TRANSFER: dict[str, Value] = {
    "normal_map": Path("normals.png"),
    "green": "down",
    "displacement": Path("bumps.png"),
    "scale": 0.01,
    "bits": "16",
    "filter": "linear",
    "bake": ("normal", "ao"),
    "detail": Path("pony.obj"),
    "rays": 8,
    "weights": Path("skin.csv"),
    "influences": 1,
    "attribute": Path("age.npy"),
    "blend_shapes": (Path("faces"),),
    "source_uvs": True,
}
WRAP: dict[str, Value] = {"fairness": 1e-3, "normal_map": True, "displacement": True, "mhclo": True}


def write_inputs(files: Files) -> None:
    """What a rich finish reads, beside the built-in pair."""
    folder, source = files.source.parent, read_mesh(files.source)
    turn = np.linspace(0.0, 1.0, source.n_vertices)
    np.savetxt(folder / "skin.csv", np.column_stack([turn, 1 - turn]), delimiter=",", header="a,b", comments="")
    np.save(folder / "age.npy", turn)
    (folder / "faces").mkdir()
    write_mesh(folder / "faces" / "tall.obj", source.with_positions(source.positions * [1.0, 1.2, 1.0]))
    write_image(folder / "bumps.png", np.random.default_rng(0).integers(0, 256, (32, 32), dtype=np.uint8))
    write_image(folder / "normals.png", np.full((32, 32, 3), (128, 128, 255), dtype=np.uint8))


def rich_finish(files: Files, size: int, vertices: int) -> FinishOptions:
    """A finish that asks for something of every kind, of the built-in pair."""
    folder = files.source.parent
    given: dict[Key, Value] = {VERTICES_KEY: vertices, SIZE_KEY: size, ("match", "trust_landmarks"): True}
    given |= {("transfer", name): value for name, value in TRANSFER.items()}
    given |= {("wrap", name): value for name, value in WRAP.items()}
    asked = FinishOptions(maps=(("roughness", Path("bumps.png")),), map_form=".npz", wrap=True, option_values=given)
    return asked.resolve_paths(all_options(), lambda path: folder / path)


def compared(folder: Path) -> list[Path]:
    """Files of a finish that hold no place or time."""
    kinds = (".png", ".exr", ".npz", ".npy", ".csv", ".obj", ".mhclo")
    inside = [path for path in folder.rglob("*") if path.suffix in kinds and "again" not in path.parts]
    return [path for path in inside if path.parent.name != "faces"]


def same(one: Path, other: Path) -> bool:
    """Whether two files are bit for bit alike; an EXR holds the time at which it was written beside its pixels."""
    if one.suffix == ".exr":
        return bool(np.array_equal(read_image(one).pixels, read_image(other).pixels))
    return one.read_bytes() == other.read_bytes()


@pytest.mark.usefixtures("jobs_in_threads", "small_pages", "quick_fit")
def test_the_job_file_of_a_finish_makes_the_same_files_again(tmp_path: Path) -> None:
    files = built_in_files(tmp_path)
    write_inputs(files)
    before = compared(tmp_path)
    for command in finish_commands(all_options(), files, rich_finish(files, size=32, vertices=300), use_landmarks=True):
        run_typed(command.request)
    made = [path for path in compared(tmp_path) if path not in before]
    text, whole = run_job(RunRequest(files.result / "job.toml", workers=1), Stages())
    assert whole, text
    again = {path.name: path for path in (files.result / "again").rglob("*") if path.is_file()}
    assert len(made) > 15
    assert [path.name for path in made if not same(path, again[path.name])] == []
