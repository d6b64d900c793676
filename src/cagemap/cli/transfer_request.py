"""What `cagemap transfer` is asked for, as said on the command line or in a job file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from cagemap.files.images import texture_files
from cagemap.files.result import ARRAYS, MANIFEST

# A summary, and warnings.
Outcome = tuple[str, list[str]]


@dataclass(frozen=True)
class TransferRequest:
    """What the user asked for, as said on the command line."""

    result: Path
    output: Path
    texture: Path | None = None
    maps: tuple[tuple[str, Path], ...] = ()
    usd: Path | None = None
    displacement: Path | None = None
    normal_map: Path | None = None
    vector_displacement: Path | None = None
    space: str = "tangent"
    green: str = "up"
    as_color: bool = False
    attribute: Path | None = None
    material_colors: bool = False
    bake: tuple[str, ...] = ()
    detail: Path | None = None
    rays: int = 128
    source_uvs: bool = False
    weights: Path | None = None
    influences: int = 4
    joints: Path | None = None
    blend_shapes: tuple[Path, ...] = ()
    write_map: bool = False
    size: int | None = None
    bits: int | None = None
    bases: tuple[tuple[str, Path], ...] = ()
    unwrap: bool = False
    midlevel: float | None = None
    scale: float = 1.0
    force: bool = False


def base_of(request: TransferRequest, name: str = "") -> Path | None:
    """What lies outside the masks of a map, or of all of them."""
    given = dict(request.bases)
    return given.get(name, given.get(""))


def inputs_of(request: TransferRequest) -> list[Path]:
    """Files that are read, as far as the command line names them."""
    single = (request.texture, request.displacement, request.normal_map, request.vector_displacement)
    others = (
        request.attribute,
        request.weights,
        request.joints,
        request.detail,
        *(path for _, path in (*request.maps, *request.bases)),
    )
    given = [path for path in (*single, *others) if path is not None]
    return [
        request.result / MANIFEST,
        request.result / ARRAYS,
        *(file for path in given for file in texture_files(path)),
    ]
