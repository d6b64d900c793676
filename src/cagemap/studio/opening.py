"""What the studio opens at the start: files of the command line, or the built-in pair."""

from __future__ import annotations

import re
import zlib
from dataclasses import replace
from pathlib import Path

from cagemap.errors import ParameterError
from cagemap.example import example_pair
from cagemap.files.images.image import write_image
from cagemap.files.landmarks.pairs import write_landmarks
from cagemap.files.meshes.formats import write_mesh
from cagemap.files.result.manifest import MANIFEST, REMEDY, input_file, read_manifest
from cagemap.files.schema import ResultRecord, SideRecord, checked_record
from cagemap.mesh.parts import KINDS
from cagemap.studio.state import Files

BUILT_IN_FOLDER = Path("cagemap-studio")
TEXTURE_SIZE = 1024
# Letters of a part's name in a file's.
_LONGEST_WORD = 40


Stated = tuple[str | None, str | None]
AS_FILED: Stated = (None, None)


def default_files(folder: Path, target: Path, source: Path, texture: Path | None, schemes: Stated = AS_FILED) -> Files:
    """Files of a pair: landmarks and result beside each other in the folder, named after it."""
    pair = f"{source.stem}__{target.stem}"
    return Files(target, source, texture, folder / f"{pair}.json", folder / f"{pair}_RESULT", schemes)


def result_of(files: Files, parts: Stated) -> Path:
    """RESULT folder for other parts of the same files, so that one part's does not replace another's."""
    named = "__".join(
        file.stem if part is None else f"{file.stem}_{word_of(part)}"
        for file, part in zip((files.source, files.target), (parts[1], parts[0]), strict=True)
    )
    return files.result.with_name(f"{named}_RESULT")


def with_parts(files: Files, parts: Stated) -> Files:
    """The same files with other parts open; a RESULT folder that is named after the pair gets the parts' names."""
    usual = files.result == result_of(files, AS_FILED)
    return replace(files, parts=parts, result=result_of(files, parts) if usual else files.result)


def word_of(part: str) -> str:
    """A part's name as a piece of a file name: all of it, so that ``left/eye`` and ``right/eye`` are told apart.

    Examples
    --------
    >>> word_of("object:eye"), word_of("object:/char/left/eye"), word_of("material:eye")
    ('eye', 'char_left_eye', 'material_eye')
    """
    kind, _, name = part.partition(":")
    kind, name = (kind, name) if kind in KINDS else ("object", part)
    word = re.sub(r"[^\w-]+", "_", name if kind == "object" else f"{kind}_{name}").strip("_")
    if 0 < len(word) <= _LONGEST_WORD:
        return word
    return f"{word[9 - _LONGEST_WORD :]}_{zlib.crc32(part.encode('utf-8', 'surrogatepass')):08x}"


def chosen_files(
    target: Path | None,
    source: Path | None,
    landmarks: Path | None,
    texture: Path | None,
    result: Path | None,
    schemes: Stated = AS_FILED,
    parts: Stated = AS_FILED,
) -> Files | None:
    """Files named on the command line; None if there are none. A RESULT folder alone names the models it was made of.

    Raises
    ------
    ParameterError
        If only one model is named, other files without models, or a RESULT whose models are gone.
    """
    if target is None and source is None:
        if result is not None:
            made = result_files(result, landmarks, texture)
            return replace(
                made,
                schemes=(schemes[0] or made.schemes[0], schemes[1] or made.schemes[1]),
                parts=(parts[0] or made.parts[0], parts[1] or made.parts[1]),
            )
        if landmarks or texture or any(schemes) or any(parts):
            raise ParameterError("expected --target and --source beside the other options. Name both models.")
        return None
    if target is None or source is None:
        raise ParameterError("expected --target and --source, got one of them. Name both models, or none.")
    return _named(target, source, landmarks, texture, result, schemes, parts)


def result_files(result: Path, landmarks: Path | None, texture: Path | None) -> Files:
    """Files that a RESULT folder was made of.

    Raises
    ------
    FormatError
        If the folder is no RESULT, or one of a version that this one does not read.
    ParameterError
        If a model is not where it was or has changed.
    """
    manifest = read_manifest(result)
    record = checked_record(ResultRecord, manifest, result / MANIFEST, REMEDY)
    target, source, pairs = (input_file(result, manifest, name) for name in ("target", "source", "landmarks"))
    if target is None or source is None:
        raise ParameterError(
            f"--result {result}: expected its models where they were, and unchanged; they are not. "
            "Name them with --target and --source."
        )
    schemes = _scheme(record.target), _scheme(record.source)
    parts = _part(record, "target"), _part(record, "source")
    return _named(target, source, landmarks or pairs, texture, result, schemes, parts)


def _part(record: ResultRecord, side: str) -> str | None:
    """Part of a model that a RESULT is of; None where it is of all, or of several."""
    name = record.parameters.get(f"{side}_part")
    return name if isinstance(name, str) and name not in ("each", "material") else None


def _scheme(side: SideRecord) -> str | None:
    """How a RESULT's model is subdivided."""
    name = side.scheme.get("name")
    return name if isinstance(name, str) else None


def _named(
    target: Path,
    source: Path,
    landmarks: Path | None,
    texture: Path | None,
    result: Path | None,
    schemes: Stated,
    parts: Stated,
) -> Files:
    image = None if texture is None else texture.resolve()
    usual = default_files(target.resolve().parent, target.resolve(), source.resolve(), image, schemes)
    pairs = usual.landmarks if landmarks is None else landmarks.resolve()
    return replace(usual, landmarks=pairs, result=usual.result if result is None else result.resolve(), parts=parts)


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
