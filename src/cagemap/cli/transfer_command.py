"""`cagemap transfer` as a command; its options are in `transfer_request`, the work in `cagemap.cli.transfer`."""

from __future__ import annotations

from typing import Any

from cagemap.cli.command import asks
from cagemap.cli.transfer_request import TransferRequest
from cagemap.cli.words import say, warn


def _read(texture: tuple[str, ...], bases: tuple[str, ...], bake: str | None, **others: Any) -> TransferRequest:
    """The request of a command line, where an image may have a name and kinds of bakes are listed with commas."""
    from cagemap.cli.texture_maps import texture_and_maps

    image, maps = texture_and_maps(texture)
    whole, named = texture_and_maps(bases, "--base")
    kinds = tuple(name.strip() for name in bake.split(",")) if bake else ()
    under = named if whole is None else (("", whole),)
    return TransferRequest(texture=image, maps=maps, bases=under, bake=kinds, **others)


@asks(TransferRequest, said={"texture": tuple[str, ...], "bases": tuple[str, ...], "bake": str | None}, read=_read)
def transfer(request: TransferRequest) -> None:
    """Carry something from source to target: textures, attributes, UVs, skinning weights, joints, blend shapes.

    Images are baked into the target's own UV layout, texel by texel, across the source's seams.
    """
    from cagemap.cli.progress import Stages
    from cagemap.cli.transfer import run_transfer

    with Stages() as stages:
        summary, warnings = run_transfer(request, stages)
    warn(warnings)
    say(summary)
