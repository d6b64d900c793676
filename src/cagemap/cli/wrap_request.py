"""What `cagemap wrap` is asked for, as said on the command line or in a job file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from cagemap.cli.subdivision import SchemeName
from cagemap.wrap import WrapConfig


@dataclass(frozen=True)
class WrapRequest:
    """What the user asked for, as said on the command line."""

    results: tuple[Path, ...]
    output: Path
    target: Path | None = None
    source: Path | None = None
    landmarks: Path | None = None
    scheme: SchemeName | None = None
    target_scheme: SchemeName | None = None
    source_scheme: SchemeName | None = None
    fit_level: int = 0
    amount: float = 1.0
    fairness: float = WrapConfig.fairness
    weights: Path | None = None
    symmetric: bool = False
    blend_shapes: bool = False
    displacement: Path | None = None
    vector_displacement: Path | None = None
    normal_map: Path | None = None
    occlusion: Path | None = None
    colors: Path | None = None
    texture: Path | None = None
    baked: Path | None = None
    detail: Path | None = None
    space: str = "tangent"
    green: str = "up"
    rays: int = 128
    size: int | None = None
    mhclo: Path | None = None
    force: bool = False
