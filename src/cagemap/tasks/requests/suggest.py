"""Request of `cagemap suggest`: its fields are the command's options."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cagemap.tasks.requests.options import Force, Option, ResultFolder


@dataclass(frozen=True)
class SuggestRequest:
    """Suggest places for more landmarks.

    The file holds the landmarks of the result and the new ones, on the source where the map puts them now. Correct the
    wrong ones and match again.
    """

    result: ResultFolder
    output: Annotated[Path, Option(("-o", "--output"), help="Landmark file to write, .json.")] = Path("landmarks.json")
    count: Annotated[int, Option(min=1, help="How many more landmarks.")] = 3
    force: Force = False
