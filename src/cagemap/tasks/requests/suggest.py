"""Request of `cagemap suggest`: its fields are the command's options."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cagemap.tasks.requests.options import OUTPUT, Force, Option, ResultFolder


@dataclass(frozen=True)
class SuggestRequest:
    """Suggest places for more landmarks.

    The file holds the landmarks of the result and the new ones, on the source where the map puts them now. Correct the
    wrong ones and match again.
    """

    result: ResultFolder
    output: Annotated[Path, Option("Landmark file to write, .json.", OUTPUT, ("-o",))] = Path("landmarks.json")
    count: Annotated[int, Option("How many more landmarks.", OUTPUT, min=1)] = 3
    force: Force = False
