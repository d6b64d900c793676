"""Files opened at the start: those of the command line or the built-in pair."""

from __future__ import annotations

import re
import zlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from cagemap.errors import ParameterError
from cagemap.example import example_pair
from cagemap.files.images.image import write_image
from cagemap.files.landmarks.pairs import write_landmarks
from cagemap.files.meshes.formats import write_mesh
from cagemap.files.result.manifest import MANIFEST, REMEDY, input_file, read_manifest
from cagemap.files.schema import ResultRecord, SideRecord, parse_record
from cagemap.mesh.parts import PART_KINDS
from cagemap.studio.landmarks import SideNames
from cagemap.studio.recorded_match import LANDMARK_FIELDS, match_of_result
from cagemap.studio.state import Files
from cagemap.tasks.match_parts import EACH, MATERIAL

BUILT_IN_FOLDER = Path("cagemap-studio")
BUILT_IN_TEXTURE_SIZE = 1024
_MAX_SLUG_LENGTH = 40


def default_files(
    target: Path,
    source: Path,
    texture: Path | None,
    schemes: SideNames = (None, None),
    *,
    landmarks: Path | None = None,
    result: Path | None = None,
    parts: SideNames = (None, None),
) -> Files:
    """Absolute paths of a pair; landmarks and RESULT are by default beside the target, and named after the pair.

    Links at default names are not followed: the folders that the page may use are those of the given files.
    """
    target, source, image = target.resolve(), source.resolve(), texture and texture.resolve()
    pair = f"{source.stem}__{target.stem}"
    landmarks = landmarks.resolve() if landmarks else target.with_name(f"{pair}.json")
    result = result.resolve() if result else target.with_name(f"{pair}_RESULT")
    return Files(target, source, image, landmarks, result, schemes, parts=parts)


def result_folder(files: Files, parts: SideNames) -> Path:
    """RESULT folder named after the pair and its parts."""
    pair = "__".join(
        file.stem if part is None else f"{file.stem}_{part_slug(part)}"
        for file, part in zip((files.source, files.target), (parts[1], parts[0]), strict=True)
    )
    return files.result.with_name(f"{pair}_RESULT")


def with_parts(files: Files, parts: SideNames) -> Files:
    """The files with other parts; a RESULT folder of the default name is renamed."""
    is_default = files.result == result_folder(files, (None, None))
    return replace(files, parts=parts, result=result_folder(files, parts) if is_default else files.result)


def part_slug(part: str) -> str:
    """A part's name for use in file names; contains the whole path.

    Examples
    --------
    >>> part_slug("object:eye"), part_slug("object:/char/left/eye"), part_slug("material:eye")
    ('eye', 'char_left_eye', 'material_eye')
    """
    kind, _, name = part.partition(":")
    kind, name = (kind, name) if kind in PART_KINDS else ("object", part)
    slug = re.sub(r"[^\w-]+", "_", name if kind == "object" else f"{kind}_{name}").strip("_")
    if 0 < len(slug) <= _MAX_SLUG_LENGTH:
        return slug
    return f"{slug[9 - _MAX_SLUG_LENGTH :]}_{zlib.crc32(part.encode('utf-8', 'surrogatepass')):08x}"


def command_line_files(
    target: Path | None,
    source: Path | None,
    landmarks: Path | None,
    texture: Path | None,
    result: Path | None,
    schemes: SideNames = (None, None),
    parts: SideNames = (None, None),
) -> Files | None:
    """Files of the command line, or those of a RESULT alone; None without any.

    ParameterError if only one model is named, other files without models, or a RESULT whose models are gone.
    """
    if target is None and source is None:
        if result is not None:
            files = result_files(result, landmarks, texture)
            asked = replace(
                files,
                schemes=(schemes[0] or files.schemes[0], schemes[1] or files.schemes[1]),
                parts=(parts[0] or files.parts[0], parts[1] or files.parts[1]),
            )
            return files if asked == files else asked.without_answer()
        if landmarks or texture or any(schemes) or any(parts):
            raise ParameterError("expected --target and --source beside the other options. Name both models.")
        return None
    if target is None or source is None:
        raise ParameterError("expected --target and --source, got one of them. Name both models, or none.")
    return default_files(target, source, texture, schemes, landmarks=landmarks, result=result, parts=parts)


def result_files(result: Path, landmarks: Path | None, texture: Path | None) -> Files:
    """Files that a RESULT folder was computed from, with the options of its match.

    Where an option is not taken over, the files have another RESULT folder.

    FormatError if the folder is not a RESULT, is damaged, or was written by a version that cannot be read.
    ParameterError if a model has moved or changed.
    """
    manifest = read_manifest(result)
    record = parse_record(ResultRecord, manifest, result / MANIFEST, REMEDY)
    target, source = (input_file(result, manifest, name) for name in ("target", "source"))
    if target is None or source is None:
        raise ParameterError(
            f"--result {result}: expected its models where they were, and unchanged; they are not. "
            "Name them with --target and --source."
        )
    schemes = _recorded_scheme(record.target), _recorded_scheme(record.source)
    parts = _recorded_part(record, "target"), _recorded_part(record, "source")
    match, lost = match_of_result(result.resolve(), manifest, record, {"target": target, "source": source})
    if landmarks is not None or match.has_only_pairs:
        landmarks = landmarks or match.request.landmarks
        match = match.with_defaults_of(*LANDMARK_FIELDS)
    files = default_files(target, source, texture, schemes, landmarks=landmarks, result=result, parts=parts)
    files, notes = keep_result(replace(files, recorded_match=match), lost)
    return replace(files, recorded_match=replace(match, notes=(*match.notes, *notes)))


def keep_result(files: Files, lost_options: Sequence[str]) -> tuple[Files, tuple[str, ...]]:
    """Files with another RESULT folder, and a note, if some options of the opened RESULT are not taken over."""
    match = files.recorded_match
    if not lost_options or match is None or files.result != match.request.output:
        return files, ()
    kept = files.result.with_name(f"{files.result.name}_studio")
    note = (
        f"the studio cannot repeat the match of {files.result.name}: {', '.join(lost_options)}. "
        f"So Bake does not replace it, and writes {kept.name}"
    )
    return replace(files, result=kept), (note,)


def _recorded_part(record: ResultRecord, side: str) -> str | None:
    """Part of a model in a RESULT; None for all or several parts."""
    name = record.parameters.get(f"{side}_part")
    return name if isinstance(name, str) and name not in (EACH, MATERIAL) else None


def _recorded_scheme(side: SideRecord) -> str | None:
    name = side.scheme.get("name")
    return name if isinstance(name, str) else None


def built_in_files(folder: Path) -> Files:
    """Files of the built-in pair, written into a folder unless they exist."""
    folder.mkdir(parents=True, exist_ok=True)
    names = ("deer.obj", "pony.obj", "pony.png", "landmarks.json")
    target, source, texture, landmarks = (folder.resolve() / name for name in names)
    if not all(path.is_file() for path in (target, source, texture, landmarks)):
        pair = example_pair(BUILT_IN_TEXTURE_SIZE)
        write_mesh(target, pair.target)
        write_mesh(source, pair.source)
        write_image(texture, pair.texture)
        write_landmarks(landmarks, pair.landmarks)
    return Files(target, source, texture, landmarks, folder.resolve() / "RESULT")
