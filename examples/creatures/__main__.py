"""Write the built-in example's files."""

from __future__ import annotations

from pathlib import Path

from examples.creatures.creatures import deer, pony
from examples.creatures.paint import paint_texture
from examples.creatures.pair import creature_landmarks

from cagemap.files.images.image import write_image
from cagemap.files.landmarks.pairs import write_landmarks
from cagemap.files.meshes.formats import write_mesh

FOLDER = Path(__file__).resolve().parents[2] / "src" / "cagemap" / "example"
TEXTURE_SIZE = 2048


def main() -> None:
    """Model, unwrap and paint; seven seconds."""
    target, source = deer(), pony()
    for creature in (target, source):
        write_mesh(FOLDER / f"{creature.mesh.name}.obj", creature.mesh)
    write_landmarks(FOLDER / "landmarks.json", creature_landmarks(target, source))
    write_image(FOLDER / "pony.png", paint_texture(source, TEXTURE_SIZE))


if __name__ == "__main__":
    main()
