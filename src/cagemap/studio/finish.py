"""The finish: what to make of a pair, and the package's own commands that make it at full resolution."""

from __future__ import annotations

import shlex
from dataclasses import dataclass, fields, replace
from pathlib import Path

from cagemap.files.images import texture_files
from cagemap.studio.state import Files, Output

DEFAULT_VERTICES = 200_000


@dataclass(frozen=True)
class WrapOptions:
    """How the target's cage is given the source's shape, in the words of `cagemap wrap`."""

    fit_level: int = 0
    amount: float = 1.0
    fairness: float = 1e-4
    symmetric: bool = False
    displacement: bool = False
    vector_displacement: bool = False


@dataclass(frozen=True)
class FinishOptions:
    """What to make, in the words of the command line.

    Attributes
    ----------
    vertices : int
        Of each surface, about.
    size, bits : int or None
        Texels a side, bits a channel; None: as the source image.
    texture : bool
        Bake the open texture.
    as_color : bool
        Although it looks like a normal map.
    displacement, normal_map, vector_displacement, attribute : Path or None
        Files of the source to carry.
    scale, midlevel : float, float or None
        What the displacement's values mean.
    space, green : str
        Of normals and vectors.
    material_colors, source_uvs : bool
    weights, joints, blend_shapes : Path or None
        Of the source's rig.
    influences : int
        Joints a vertex at most; 0: all.
    write_map : str
        Ending of the file for the map itself; '' for none.
    wrap : WrapOptions or None
    unwrap : bool
        Lay out the target, which has no UVs.
    report : bool
    """

    vertices: int = DEFAULT_VERTICES
    size: int | None = None
    bits: int | None = None
    texture: bool = True
    as_color: bool = False
    displacement: Path | None = None
    scale: float = 1.0
    midlevel: float | None = None
    normal_map: Path | None = None
    vector_displacement: Path | None = None
    space: str = "tangent"
    green: str = "up"
    attribute: Path | None = None
    material_colors: bool = False
    source_uvs: bool = False
    weights: Path | None = None
    influences: int = 4
    joints: Path | None = None
    blend_shapes: Path | None = None
    write_map: str = ""
    wrap: WrapOptions | None = None
    unwrap: bool = False
    report: bool = True

    @property
    def paths(self) -> tuple[Path, ...]:
        """Files that are named."""
        values = (getattr(self, field.name) for field in fields(self))
        return tuple(value for value in values if isinstance(value, Path))


@dataclass(frozen=True)
class Command:
    """One call of the command line.

    Attributes
    ----------
    title : str
    arguments : tuple of str
        After ``cagemap``.
    outputs : tuple of Output
        What it may write; the first one always.
    """

    title: str
    arguments: tuple[str, ...]
    outputs: tuple[Output, ...]

    def __str__(self) -> str:
        return shlex.join(("cagemap", *self.arguments))

    def written(self) -> tuple[Output, ...]:
        """What is there of it; every tile of a layout of several."""
        found = []
        for output in self.outputs:
            found += [replace(output, path=file) for file in texture_files(output.path) if file.exists()]
        return tuple(found)


def commands(files: Files, options: FinishOptions, *, landmarks: bool) -> tuple[Command, ...]:
    """The commands that finish what is open.

    Parameters
    ----------
    landmarks : bool
        Whether the landmark file holds any.
    """
    result, folder, stem = files.result, files.result.parent, files.target.stem
    match = ["match", "--target", str(files.target), "--source", str(files.source)]
    match += ["--landmarks", str(files.landmarks)] if landmarks else []
    for side, scheme in zip(("target", "source"), files.schemes, strict=True):
        match += [] if scheme is None else [f"--{side}-scheme", scheme]
    for side, part in zip(("target", "source"), files.parts, strict=True):
        match += [] if part is None else [f"--{side}-part", part]
    match += ["--vertices", str(options.vertices), "-o", str(result)]
    made = [Command("match", tuple(match), (Output(result, "the map"),))]

    def carried(source: Path, *, name: str | None = None) -> Path:
        return folder / f"{stem}_from_{source.stem if name is None else name}{source.suffix}"

    def transfer(title: str, kind: list[str], output: Path, *, bake: bool = False) -> None:
        arguments = ["transfer", str(result), *kind, *(_bake_words(options) if bake else []), "-o", str(output)]
        unwrapped = Output(output.with_name(f"{output.stem}_unwrapped.obj"), "the target with a layout")
        outputs = (Output(output, title), *([unwrapped] if bake and options.unwrap else []))
        made.append(Command(title, tuple(arguments), outputs))

    if options.texture and files.texture is not None:
        kind = ["--texture", str(files.texture), *(["--as-color"] if options.as_color else [])]
        transfer("texture", kind, carried(files.texture), bake=True)
    if options.normal_map is not None:
        kind = ["--normal-map", str(options.normal_map), "--space", options.space, "--green", options.green]
        transfer("normal map", kind, carried(options.normal_map), bake=True)
    if options.displacement is not None:
        kind = ["--displacement", str(options.displacement), "--scale", str(options.scale)]
        kind += [] if options.midlevel is None else ["--midlevel", str(options.midlevel)]
        transfer("displacement", kind, carried(options.displacement), bake=True)
    if options.vector_displacement is not None:
        kind = ["--vector-displacement", str(options.vector_displacement), "--space", options.space]
        transfer("vector displacement", kind, carried(options.vector_displacement), bake=True)
    if options.material_colors:
        transfer("material colours", ["--material-colors"], folder / f"{stem}_material_colors.png", bake=True)
    if options.attribute is not None:
        transfer("attribute", ["--attribute", str(options.attribute)], carried(options.attribute))
    if options.source_uvs:
        transfer("UVs of the source", ["--source-uvs"], folder / f"{stem}_with_uvs_of_{files.source.stem}.obj")
    if options.weights is not None:
        kind = ["--weights", str(options.weights), "--influences", str(options.influences)]
        kind += [] if options.joints is None else ["--joints", str(options.joints)]
        transfer("skin weights", kind, carried(options.weights))
    elif options.joints is not None:
        transfer("joints", ["--joints", str(options.joints)], carried(options.joints))
    if options.blend_shapes is not None:
        transfer("blend shapes", ["--blend-shapes", str(options.blend_shapes)], folder / f"{stem}_blend_shapes.npz")
    if options.write_map:
        transfer(
            "map for other programs", ["--write-map"], folder / f"{stem}_on_{files.source.stem}{options.write_map}"
        )
    if options.wrap is not None:
        made.append(_wrap_command(files, options.wrap, options.size))
    if options.report:
        report = folder / f"{result.name}.html"
        made.append(Command("report", ("report", str(result), "-o", str(report)), (Output(report, "report"),)))
    return tuple(made)


def _bake_words(options: FinishOptions) -> list[str]:
    words = [] if options.size is None else ["--size", str(options.size)]
    words += [] if options.bits is None else ["--bits", str(options.bits)]
    return [*words, *(["--unwrap"] if options.unwrap else [])]


def _wrap_command(files: Files, wrap: WrapOptions, size: int | None) -> Command:
    folder, name = files.result.parent, f"{files.target.stem}_as_{files.source.stem}"
    mesh = folder / f"{name}{files.target.suffix if files.target.suffix.lower() in ('.obj', '.ply') else '.obj'}"
    words = ["wrap", str(files.result), "--fit-level", str(wrap.fit_level), "--amount", str(wrap.amount)]
    words += ["--fairness", str(wrap.fairness), *(["--symmetric"] if wrap.symmetric else [])]
    outputs = [Output(mesh, "the target in the source's shape")]
    for kind, wanted in (("displacement", wrap.displacement), ("vector-displacement", wrap.vector_displacement)):
        if wanted:
            image = folder / f"{name}_{kind.replace('-', '_')}.exr"
            words += [f"--{kind}", str(image)]
            outputs.append(Output(image, f"what is still missing, as {kind.replace('-', ' ')}"))
    words += ["--size", str(size)] if size is not None and len(outputs) > 1 else []
    return Command("wrap", (*words, "-o", str(mesh)), tuple(outputs))
