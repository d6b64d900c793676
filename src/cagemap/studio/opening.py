"""What the studio opens at the start: files of the command line, or the built-in pair."""

from __future__ import annotations

from pathlib import Path

from cagemap.errors import ParameterError
from cagemap.example import example_pair
from cagemap.files.images import write_image
from cagemap.files.landmarks import write_landmarks
from cagemap.files.meshes import write_mesh
from cagemap.studio.state import Files

BUILT_IN_FOLDER = Path("cagemap-studio")
TEXTURE_SIZE = 1024


def default_files(folder: Path, target: Path, source: Path, texture: Path | None) -> Files:
    """Files of a pair: landmarks and result beside each other in the folder, named after it."""
    pair = f"{source.stem}__{target.stem}"
    return Files(target, source, texture, folder / f"{pair}.json", folder / f"{pair}_RESULT")


def chosen_files(
    target: Path | None, source: Path | None, landmarks: Path | None, texture: Path | None, result: Path | None
) -> Files | None:
    """Files named on the command line; None if there are no models among them.

    Raises
    ------
    ParameterError
        If only one model is named, or other files without models.
    """
    if target is None and source is None:
        if landmarks or texture or result:
            raise ParameterError("expected --target and --source beside the other files. Name both models.")
        return None
    if target is None or source is None:
        raise ParameterError("expected --target and --source, got one of them. Name both models, or none.")
    files = default_files(target.resolve().parent, target.resolve(), source.resolve(), None)
    return Files(
        files.target,
        files.source,
        None if texture is None else texture.resolve(),
        files.landmarks if landmarks is None else landmarks.resolve(),
        files.result if result is None else result.resolve(),
    )


def built_in_files(folder: Path) -> Files:
    """Write the built-in pair into a folder, unless it is there, and name its files."""
    folder.mkdir(parents=True, exist_ok=True)
    names = ("deer.obj", "pony.obj", "pony.png", "landmarks.json")
    target, source, texture, landmarks = (folder.resolve() / name for name in names)
    if not all(path.is_file() for path in (target, source, texture, landmarks)):
        pair = example_pair(TEXTURE_SIZE)
        write_mesh(target, pair.target)
        write_mesh(source, pair.source)
        write_image(texture, pair.texture)
        write_landmarks(landmarks, pair.landmarks)
    return Files(target, source, texture, landmarks, folder.resolve() / "RESULT")
