"""`cagemap match` as a command; its options are in `cagemap.cli.match_request`, the work in `cagemap.cli.match`."""

from __future__ import annotations

from cagemap.cli.command import asks
from cagemap.cli.match_request import MatchRequest
from cagemap.cli.words import say, warn


@asks(MatchRequest)
def match(request: MatchRequest) -> None:
    """Find for every point of the target its place on the source.

    Writes a folder with manifest.json (what was done, how long it took, how good the map is) and map.npz (the map
    itself). Without landmarks every way in which one shape may lie on the other is tried, and the answer says how sure
    it is. Landmarks make it better: six to thirty, spread over the whole surface, are a good number; tips of limbs,
    nose and tail first.
    """
    from cagemap.cli.match import run_match
    from cagemap.cli.progress import Stages

    with Stages() as stages:
        summary, warnings = run_match(request, stages)
    warn(warnings)
    say(summary)
