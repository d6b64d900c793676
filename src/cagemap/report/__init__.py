"""One self-contained HTML page about a result, for the eye and for print."""

from __future__ import annotations

from pathlib import Path

from cagemap.errors import FormatError
from cagemap.files.atomic import write_whole
from cagemap.maps.result import MatchResult
from cagemap.numerics.arrays import FloatArray
from cagemap.numerics.kinds import kinds_checked
from cagemap.report.figures import (
    HEIGHT,
    WIDTH,
    Figure,
    Gallery,
    Pixels,
    Progress,
    draw_gallery,
    draw_thumbnail,
    for_display,
)
from cagemap.report.looks import SOURCE_PICTURE, TARGET_PICTURE, report_models
from cagemap.report.models import Models
from cagemap.report.page import Texture, build_page, encoded_texture
from cagemap.report.rig_panels import (
    NOTHING,
    CarriedData,
    CarriedShape,
    Panel,
    Passenger,
    Pose,
    Weights,
    draw_carried,
    draw_passengers,
    draw_poses,
)
from cagemap.report.viewpoints import seen

__all__ = [
    "CarriedData",
    "CarriedShape",
    "Figure",
    "Gallery",
    "Models",
    "Panel",
    "Passenger",
    "Pose",
    "Weights",
    "build_page",
    "check_page_path",
    "draw_carried",
    "draw_gallery",
    "draw_passengers",
    "draw_poses",
    "draw_thumbnail",
    "report_models",
    "write_report",
]


# Bytes of a page, and vertices of its models: the first number whose page is small enough.
MAX_BYTES = 5_000_000
MODEL_SIZES = 60_000, 30_000, 15_000, 6000


def check_page_path(path: str | Path) -> None:
    """Refuse a name that a browser would not open as a page.

    Raises
    ------
    FormatError
    """
    suffix = Path(path).suffix
    if suffix.lower() not in (".html", ".htm"):
        got = f"'{suffix}'" if suffix else "a name without an ending"
        raise FormatError(f"{path}: expected the name of a page ending in .html, got {got}. Give another name.")


@kinds_checked
def write_report(
    path: str | Path,
    result: MatchResult,
    *,
    texture: Pixels | None = None,
    baked: Pixels | None = None,
    carried: CarriedData = NOTHING,
    size: tuple[int, int] = (WIDTH, HEIGHT),
    progress: Progress | None = None,
    upright: FloatArray | None = None,
    reason: str = "as asked",
    force: bool = False,
) -> None:
    """Draw and write the report of a result.

    Parameters
    ----------
    path : path
        The HTML file.
    result : MatchResult
    texture, baked : (H, W, c) array, optional
        The source's texture, and the same baked into the target's layout.
    carried : CarriedData
        The wrapped cage, weights and shapes to show.
    size : (int, int)
        Width and height of each picture, in pixels.
    progress : callable, optional
        Called with the name of each step.
    upright : (3, 3) float64, optional
        Rotation for rows after which the target's up is +Y; by default its shape tells. The report gives the
        ``reason``.

    Raises
    ------
    FormatError
        If the name is not that of an HTML file, the file cannot be written, or cagemap did not write the one that is
        there and ``force`` is not given.
    """
    check_page_path(path)
    views = seen(result, upright, reason)
    gallery = draw_gallery(result, texture=texture, baked=baked, size=size, progress=progress, views=views)
    panels = draw_carried(result, carried, size, views)
    textures = _textures(result, texture, baked)
    for most in MODEL_SIZES:
        models = report_models(result, views, texture=texture, baked=baked, carried=carried, most=most)
        page = build_page(result, gallery, panels, models, textures)
        if len(page) <= MAX_BYTES:
            break
    write_whole(path, page.encode("utf-8", "xmlcharrefreplace"), force=force)


def _textures(result: MatchResult, texture: Pixels | None, baked: Pixels | None) -> tuple[Texture, ...]:
    """The pictures that the models wear."""
    source, target = (Path(side.control.name).stem for side in (result.source, result.target))
    shown = []
    if texture is not None and result.source.control.uvs is not None:
        shown.append(encoded_texture(SOURCE_PICTURE, f"{source} (source)", for_display(texture)))
        if baked is not None and result.target.control.uvs is not None:
            shown.append(encoded_texture(TARGET_PICTURE, f"{target} (target), baked", for_display(baked)))
    return tuple(shown)
