"""`cagemap wrap` as a command; its options are in `cagemap.cli.wrap_request`, the work in `cagemap.cli.wrap`."""

from __future__ import annotations

from cagemap.cli.command import asks
from cagemap.cli.words import say, warn
from cagemap.cli.wrap_request import WrapRequest


@asks(WrapRequest)
def wrap(request: WrapRequest) -> None:
    """Give the target's cage the source's shape: your topology, that shape.

    The refined surface comes to lie on the source. Vertices, faces, UVs, groups and materials stay those of the
    target.
    """
    from cagemap.cli.progress import Stages
    from cagemap.cli.wrap import run_wrap

    with Stages() as stages:
        summary, warnings = run_wrap(request, stages)
    warn(warnings)
    say(summary)
