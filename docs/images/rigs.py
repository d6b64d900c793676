"""Draw rigs.jpg: weights and shapes of one body on another: python docs/images/rigs.py RESULT.

RESULT is a match of two bodies to which `cagemap transfer --weights` and `--blend-shapes` (an .npz) were applied.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from cagemap.files.images.image import write_image
from cagemap.files.result.folder import read_result
from cagemap.report import draw_carried
from cagemap.tasks.report import carried_data

WIDTH, HEIGHT = 300, 480


def main(folder: Path) -> None:
    """Weights from the front and two shapes, source beside target."""
    result = read_result(folder)
    weights, shapes = draw_carried(result, carried_data(folder, result), (WIDTH, HEIGHT))[-2:]
    pictures = [image for image, _ in (*weights.pictures[:2], *shapes.pictures[:4])]
    write_image(Path(__file__).with_name("rigs.jpg"), np.concatenate(pictures, axis=1), force=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
