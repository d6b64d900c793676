"""`--target-mask`, `--source-mask` of what is done with a RESULT: masks beside those that it was matched with."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from cagemap.cli.masks import GivenMask, MaskOptions, read_mask
from cagemap.errors import ParameterError
from cagemap.files.meshes import read_whole
from cagemap.files.result import input_file
from cagemap.maps.masks import Masks
from cagemap.maps.result import MatchResult
from cagemap.mesh import ControlMesh
from cagemap.numerics.arrays import FloatArray


def with_masks(result: MatchResult, options: MaskOptions, folder: Path) -> MatchResult:
    """The same result with more left out of it: what counts is the product of its own masks and the given ones.

    Parameters
    ----------
    result : MatchResult
    options : MaskOptions
        In the words and numbers of the files that were matched.
    folder : Path
        Of the RESULT, where the files are looked up.

    Raises
    ------
    ParameterError
        See `cagemap.cli.masks.read_mask`; if nothing would be left; if only a part of a file was matched and that file
        is not where it was; if there is an edge and no mask.
    """
    if options.target is None and options.source is None:
        if options.edge is not None:
            raise ParameterError("--mask-edge: expected --target-mask or --source-mask beside it, got neither")
        return result
    sides = (("target", options.target, result.masks.target), ("source", options.source, result.masks.source))
    target, source = (_narrowed(result, side, text, options.edge, folder, known) for side, text, known in sides)
    masks = Masks(target, source)
    masks.require_fit(len(result.target.vertices), len(result.source.vertices))
    return replace(result, masks=masks)


def _narrowed(
    result: MatchResult, side: str, text: str | None, edge: float | None, folder: Path, known: FloatArray | None
) -> FloatArray | None:
    """(n,) a side's mask times one more."""
    if text is None:
        return known
    surface = result.target if side == "target" else result.source
    given = _given(text, edge, surface.control, input_file(folder, result.manifest, side), f"--{side}-mask")
    mask = given.on(surface.refinement, surface.triangles(surface.finest))
    return mask if known is None else mask * known


def _given(text: str, edge: float | None, control: ControlMesh, file: Path | None, option: str) -> GivenMask:
    if control.file_vertices is None:
        return read_mask(text, edge, control, file or Path(control.name), option)
    if file is None:
        raise ParameterError(
            f"{option}: {control.name} was matched in part, and its file is not where the match read it, or has "
            "changed. Put it back."
        )
    return read_mask(text, edge, read_whole(file), file, option)
