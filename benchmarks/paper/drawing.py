"""What is drawn and said: the list of figures and tables, each of them, and their page."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

import matplotlib as mpl

mpl.use("agg")

from matplotlib import pyplot as plt

from benchmarks.paper import basis_figures, blocks, map_figures, tables
from benchmarks.paper.data import folder
from benchmarks.paper.levels import table_of_levels
from benchmarks.paper.stages import table_of_stages

mpl.rcParams["svg.hashsalt"] = "cagemap"  # the same file each time

# What the paper says of each.
FIGURES: dict[str, tuple[Callable[[], map_figures.Drawn], str]] = {
    "fig1": (map_figures.figure_1, "Fig. 1. A texture carried by the map."),
    "fig2": (map_figures.figure_2, "Fig. 2. The pipeline: basis, constraints, functional and point map, transfer."),
    "fig3": (basis_figures.figure_3, "Fig. 3. Refined geometries and SEC operators of every level."),
    "fig4": (
        basis_figures.figure_4,
        "Fig. 4. 'The graphs are almost indistinguishable'; exact ones are slightly better for larger k.",
    ),
    "fig5": (basis_figures.figure_5, "Fig. 5. 'Clear visual similarity' of eigenvectors and prolonged eigenvectors."),
    "fig6": (
        basis_figures.figure_6,
        "Fig. 6. Eigenvalues of the levels are similar; 'the similarity breaks later for higher levels'.",
    ),
    "fig7": (basis_figures.figure_7, "Fig. 7. The hierarchical basis: subdivide what is there, add a band."),
    "fig8": (
        basis_figures.figure_8,
        "Fig. 8. 'As t increases the error decreases, even for small t the error is less than 2 percent'.",
    ),
    "fig9": (
        map_figures.figure_9,
        "Fig. 9. The only candidates of a refined vertex are the non-zeros of the column of S_2.",
    ),
    "fig10": (map_figures.figure_10, "Fig. 10. 'Notice how the map improves as the resolution increases.'"),
    "blocks": (
        blocks.figure_of_blocks,
        "Blocks of eqs. 14-16. They extend the map to each further band; what they carry is discussed in [a page](blocks.md).",
    ),
}
STAGES = (
    "Mean error (x100 of sqrt(area)) of 14 directions at about 25k vertices with a stage left out, set to zero or replaced by "
    "noise of the same norm. Parameters were chosen on seven directions and are judged on the other seven."
)
TABLES: dict[str, tuple[Callable[[], str], str]] = {
    "table1": (
        tables.table_1,
        "Table 1. 'Much less expensive': exact over hierarchical basis is 2.06 to 2.82 in the paper.",
    ),
    "table3": (tables.table_3, "Table 3. Timing of whole results (its columns are not in the extracted text)."),
    "methods": (
        tables.table_of_methods,
        "Ours. Mean errors, x100 of sqrt(area), of the methods by level and landmarks; `paper` with the schedule (100, 50, 50).",
    ),
    "levels": (
        table_of_levels,
        "More levels. Mean errors, x100 of sqrt(area), where the finest level is 1, 2 or 3.",
    ),
    "stages_hfm": (partial(table_of_stages, "hfm"), f"Stages of hfm. {STAGES}"),
    "stages_paper": (partial(table_of_stages, "paper"), f"Stages of paper. {STAGES}"),
}


def made(name: str) -> tuple[str, str, float]:
    """Draw one figure, or fill one table; its name, what is said of it, and the seconds it took."""
    start = time.perf_counter()
    if name in FIGURES:
        figure, said = FIGURES[name][0]()
        figure.tight_layout()
        figure.savefig(folder() / f"{name}.svg", dpi=300, metadata={"Date": None})  # pictures inside at 300 dpi
        plt.close(figure)
    else:
        said = TABLES[name][0]()
    return name, said, time.perf_counter() - start


def write_page(seen: dict[str, Any]) -> None:
    """One page: the paper's claim, what we see, where it does not hold; ``seen["code"]`` has the commit of each."""
    parts = [
        "# The paper's figures and tables\n\nRedrawn from our data by `python -m benchmarks.paper`. The paper's own models are "
        "not published. Eigenvalues and times are for unit area, errors x100 of sqrt(area). Figures are vectors; pictures in "
        "them have 300 dpi. Missing: Figures 11 to 18 and Table 2, whose models or text are not available, and "
        "orientation-aware descriptors, which are neither implemented nor measured."
    ]

    def version(name: str) -> str:
        return f"Code: {seen['code'][name]}."

    for name, (_, claim) in FIGURES.items():
        if name in seen:
            title, said = claim.split(". ", 1)[0] + ". " + claim.split(". ", 2)[1], claim.split(". ", 2)[2]
            parts.append(f"## {title}\n\nThe paper: {said}\n\n![{name}]({name}.svg)\n\n{seen[name]}\n\n{version(name)}")
    for name, (_, claim) in TABLES.items():
        if name in seen:
            title, said = claim.split(". ", 1)
            parts.append(f"## {title}\n\n{said}\n\n{seen[name]}\n\n{version(name)}")
    (folder() / "index.md").write_text("\n\n".join(parts) + "\n")
