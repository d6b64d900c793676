"""Reports: one self-contained HTML page about a result."""

from __future__ import annotations

from pathlib import Path

from cagemap.files.atomic import write_whole
from cagemap.files.text import require_suffix
from cagemap.maps.result import MatchResult
from cagemap.numerics.arrays import FloatArray
from cagemap.numerics.kinds import kinds_checked
from cagemap.pictures import Y_UP
from cagemap.report.figures import HEIGHT, WIDTH, Pixels, Progress
from cagemap.report.figures import Gallery as Gallery
from cagemap.report.figures import display_image as display_image
from cagemap.report.figures import draw_gallery as draw_gallery
from cagemap.report.figures import draw_thumbnail as draw_thumbnail
from cagemap.report.looks import SOURCE_TEXTURE_ID, TARGET_TEXTURE_ID
from cagemap.report.looks import report_models as report_models
from cagemap.report.page import Texture, encode_texture
from cagemap.report.page import build_page as build_page
from cagemap.report.rig_panels import NO_DATA
from cagemap.report.rig_panels import BakedImage as BakedImage
from cagemap.report.rig_panels import CarriedData as CarriedData
from cagemap.report.rig_panels import CarriedItem as CarriedItem
from cagemap.report.rig_panels import Weights as Weights
from cagemap.report.rig_panels import draw_carried as draw_carried
from cagemap.report.viewpoints import choose_viewpoints

# Largest page in bytes, and vertices of its models: the first number whose page is small enough is taken.
MAX_PAGE_BYTES = 5_000_000
MODEL_VERTEX_COUNTS = 60_000, 30_000, 15_000, 6000


def check_page_path(path: str | Path) -> None:
    """FormatError if a name does not end in .html or .htm."""
    require_suffix(Path(path), (".html", ".htm"), "the name of a page")


@kinds_checked
def write_report(
    path: str | Path,
    result: MatchResult,
    *,
    texture: Pixels | None = None,
    baked: Pixels | None = None,
    carried: CarriedData = NO_DATA,
    size: tuple[int, int] = (WIDTH, HEIGHT),
    progress: Progress | None = None,
    upright: FloatArray | None = None,
    reason: str = "as asked",
    usual: FloatArray = Y_UP,
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
        Baked images, wrapped cage, weights, shapes, passengers and poses to show.
    size : (int, int)
        Width and height of each picture, in pixels.
    progress : callable, optional
        Called with the name of each step.
    upright : (3, 3) float64, optional
        Rotation for rows after which the target's up is +Y; default: found from its shape.
    reason : str
        Where ``upright`` comes from, for the page.
    usual : (3, 3) float64
        The same rotation where ``upright`` is not given and the shape does not tell.

    Raises
    ------
    FormatError
        If the name is not that of an HTML file, the file cannot be written, or cagemap did not write the one that is
        there and ``force`` is not given.
    """
    check_page_path(path)
    viewpoints = choose_viewpoints(result, upright, reason, usual)
    gallery = draw_gallery(result, texture=texture, baked=baked, size=size, progress=progress, viewpoints=viewpoints)
    panels = draw_carried(result, carried, size, viewpoints)
    textures = _textures(result, texture, baked)
    for max_vertices in MODEL_VERTEX_COUNTS:
        models = report_models(
            result, viewpoints, texture=texture, baked=baked, carried=carried, max_vertices=max_vertices
        )
        page = build_page(result, gallery, panels, models, textures)
        if len(page) <= MAX_PAGE_BYTES:
            break
    write_whole(path, page.encode("utf-8", "xmlcharrefreplace"), force=force)


def _textures(result: MatchResult, texture: Pixels | None, baked: Pixels | None) -> tuple[Texture, ...]:
    """Textures of the models on the page."""
    source, target = (Path(side.control.name).stem for side in (result.source, result.target))
    textures = []
    if texture is not None and result.source.control.uvs is not None:
        textures.append(encode_texture(SOURCE_TEXTURE_ID, f"{source} (source)", display_image(texture)))
        if baked is not None and result.target.control.uvs is not None:
            textures.append(encode_texture(TARGET_TEXTURE_ID, f"{target} (target), baked", display_image(baked)))
    return tuple(textures)
