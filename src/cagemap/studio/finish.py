"""The finish: the commands that compute the map, bake and report at full resolution."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from cagemap.errors import ParameterError
from cagemap.files import IMAGE_SUFFIXES
from cagemap.files.gltf.document import SCENE_SUFFIXES
from cagemap.files.images.image import UDIM_MARK
from cagemap.files.usd.stages import USD_SUFFIXES
from cagemap.studio.opening import part_slug
from cagemap.studio.state import NO_SCHEME, Files
from cagemap.studio.workspace import Workspace
from cagemap.tasks.match import ComputedMatch
from cagemap.tasks.requests.catalogue import (
    WRAP_IMAGES_OF,
    WRITTEN,
    Key,
    NamedFiles,
    Options,
    Request,
    Value,
    placed_path,
    request_of,
)
from cagemap.tasks.requests.transfer import READ_BY, TransferRequest
from cagemap.tasks.requests.wrap import WrapRequest

if TYPE_CHECKING:  # the process of a bake needs no models
    from cagemap.studio.scene import Scene

# Options of several commands that the page shows once: (command, field), and the one that is shown.
SHARED_OPTIONS: dict[Key, Key] = {
    **{("wrap", name): ("transfer", name) for name in ("space", "green", "rays", "size", "detail", "detail_texture")},
    **{(command, "force"): ("match", "force") for command in ("transfer", "wrap", "report")},
}
# Title of the first command's output.
MAP_TITLE = "the map"
# Name of the open texture among other images of its material.
COLOR_MAP = "color"
# Kinds of bakes in messages, where they have other words.
_KIND_WORDS = {"ao": "ambient occlusion", "colors": "vertex colours"}
# Titles of the transfers, by the option of their data; in the order in which they are made.
TRANSFERS = {
    "texture": "texture",
    "normal_map": "normal map",
    "displacement": "displacement",
    "vector_displacement": "vector displacement",
    "material_colors": "material colours",
    "bake": "detail",
    "attribute": "attribute",
    "source_uvs": "UVs of the source",
    "weights": "skin weights",
    "joints": "joints",
    "blend_shapes": "blend shapes",
    "passenger": "passenger",
    "write_map": "map for other programs",
}
# Options of `cagemap wrap` for its images.
_WRAP_IMAGE_FIELDS = ("size", "space", "green", "rays", "detail", "detail_texture", "texture", "force")


@dataclass(frozen=True)
class FinishOptions:
    """What a finish makes."""

    texture: bool = True  # bake the open texture
    maps: NamedFiles = ()  # further images over the source's UVs, by name
    map_form: str = ""  # suffix of the file for the map itself; '' for none
    image_form: str = ""  # suffix of all images; '': that of the source's image
    wrap: bool = False
    report: bool = True
    name: str = ""  # stem of files and of the RESULT folder; '': the target's, and the open pair's RESULT
    # options with other values than the default
    option_values: Mapping[Key, Value] = field(default_factory=lambda: MappingProxyType({}))

    def with_values(self, values: Mapping[Key, Value]) -> FinishOptions:
        """Set options of commands."""
        return replace(self, option_values={**self.option_values, **values})

    def resolve_paths(self, options: Options, resolve: Callable[[Path], Path]) -> FinishOptions:
        """Apply ``resolve`` to every path.

        ParameterError if a path lies outside the chosen folders, or the name is no file name.
        """
        if self.name and (Path(self.name).name != self.name or self.name.startswith(".")):
            raise ParameterError(f"Name: expected what files begin with, without a folder, got {self.name!r}.")
        values = {key: options[key].placed(value, resolve) for key, value in self.option_values.items()}
        maps = tuple((name, placed_path(path, resolve)) for name, path in self.maps)
        return replace(self, maps=maps, option_values=values)


def with_defaults(options: FinishOptions, files: Files, scene: Scene, vertices: int) -> FinishOptions:
    """Options with defaults for the open pair.

    Without an image the source's material or vertex colours are baked, or else its ambient occlusion, and a cage is
    wrapped.

    ``vertices``: of the map shown, for a finish that asks for no other number and no level.
    ParameterError if the target cannot be wrapped.
    """
    is_plain, values = files.schemes[0] == NO_SCHEME, options.option_values
    has_level, number = values.get(("match", "level")) is not None, values.get(("match", "vertices"))
    options = options.with_values(
        {
            ("transfer", "unwrap"): not scene.target.control.has_layout,
            ("match", "vertices"): None if has_level else vertices if number is None else number,
        }
    )
    if options.texture and files.texture is None and scene.has_colors:
        options = options.with_values({("transfer", "material_colors"): True})
    elif options.texture and files.texture is None:
        colors = None if values.get(("transfer", "detail")) else scene.source.control.vertex_colors
        default = ("ao",) if colors is None or np.isnan(colors).all() else ("colors",)
        kinds = values.get(("transfer", "bake")) or default
        wrap = options.wrap or not (is_plain or kinds == ("colors",))
        options = replace(options, wrap=wrap).with_values({("transfer", "bake"): kinds})
    if is_plain and options.wrap:
        raise ParameterError(
            f"{files.target.name} is open as a plain mesh, which cannot be wrapped. Press Open… and choose how the "
            "target is subdivided (Options). Or choose something else to make below."
        )
    return options


@dataclass(frozen=True)
class Command:
    """One command of a finish."""

    title: str
    request: Request  # may write further files next to its output
    output_title: str = ""  # '' for the title
    # for the match: the map on the page, which it writes if its inputs are equal
    computed: ComputedMatch | None = field(default=None, compare=False)

    @property
    def output(self) -> Path:
        """The main file or folder that it writes."""
        return self.request.output


def plan_commands(
    options: Options, workspace: Workspace, files: Files, finish_options: FinishOptions, *, use_landmarks: bool
) -> tuple[Command, ...]:
    """Commands of a finish that read and write inside the chosen folders only.

    ParameterError if a file or link leads outside them, or a number is outside its range.
    """
    finish_options = finish_options.resolve_paths(options, workspace.resolve)
    commands = finish_commands(options, files, finish_options, use_landmarks=use_landmarks)
    for command in commands:
        workspace.require_outputs(command.output)
    return commands


def finish_commands(
    options: Options, files: Files, finish_options: FinishOptions, *, use_landmarks: bool
) -> tuple[Command, ...]:
    """Commands of a finish, in their order.

    ``use_landmarks``: match with the landmark file.
    """
    builder = _CommandBuilder(options, files, finish_options)
    if finish_options.name:
        stem = f"{builder.stem}_from{builder.source_suffix}" if builder.source_suffix else builder.stem
        builder = replace(builder, files=replace(files, result=files.result.with_name(f"{stem}_RESULT")))
    commands = [builder.match(use_landmarks=use_landmarks)]
    for data_field in TRANSFERS:
        command = builder.transfer(data_field, [other.output for other in commands])
        commands += [] if command is None else [command]
    commands += [builder.wrap()] if finish_options.wrap else []
    commands += [builder.report()] if finish_options.report else []
    return tuple(commands)


def made_of(commands: Sequence[Command]) -> list[str]:
    """Colours, bakes and mesh that a finish makes of a source without an image, in words."""
    requests = [command.request for command in commands]
    bakes = [request for request in requests if isinstance(request, TransferRequest)]
    made = ["the colours of its materials" for bake in bakes if bake.material_colors]
    made += [_KIND_WORDS.get(kind, kind) for bake in bakes for kind in bake.bake]
    return made + ["the wrapped mesh" for request in requests if isinstance(request, WrapRequest)]


@dataclass(frozen=True)
class _CommandBuilder:
    options: Options
    files: Files
    finish_options: FinishOptions

    @property
    def stem(self) -> str:
        """Beginning of all file names: the given name or the target's, and its part."""
        part = self.files.parts[0]
        name = self.finish_options.name or self.files.target.stem
        return name if part is None else f"{name}_{part_slug(part)}"

    @property
    def source_suffix(self) -> str:
        """The source's part, for file names."""
        part = self.files.parts[1]
        return "" if part is None else f"_{part_slug(part)}"

    def value(self, command: str, name: str) -> Value:
        """The value of an option."""
        key = SHARED_OPTIONS.get((command, name), (command, name))
        return self.finish_options.option_values.get(key, self.options[key].default)

    def values(self, command: str, names: Iterable[str]) -> dict[str, Value]:
        """The values of options."""
        return {name: self.value(command, name) for name in names}

    def match(self, *, use_landmarks: bool) -> Command:
        """The match at full resolution."""
        files = self.files
        values = self.values("match", (name for command, name in self.options if command == "match")) | {
            "target": files.target,
            "source": files.source,
            "landmarks": files.landmarks if use_landmarks else None,
            "output": files.result,
            "target_scheme": files.schemes[0],
            "source_scheme": files.schemes[1],
            "target_weld": files.welds[0],
            "source_weld": files.welds[1],
            "target_part": files.parts[0],
            "source_part": files.parts[1],
        }
        return Command("match", request_of("match", values), MAP_TITLE)

    def transfer(self, data_field: str, used_outputs: list[Path]) -> Command | None:
        """The transfer of one kind of data, or None if it is not requested."""
        data = self._texture_values() if data_field == "texture" else self.values("transfer", [data_field])
        if data_field == "write_map":
            data = {"write_map": bool(self.finish_options.map_form)}
        if not any(data.values()):
            return None
        name, ending = self._name_parts(data_field)
        output = self.files.result.parent / f"{self.stem}{name}{self.source_suffix}{ending}"
        if output in used_outputs:
            output = output.with_name(f"{output.stem}_{data_field}{output.suffix}")
        others = (name for command, name in self.options if command == "transfer" and name not in TRANSFERS)
        read = [name for name in others if data_field in READ_BY.get(name, (data_field,))]
        read += ["joints"] if data_field == "weights" else []  # joints name the columns of weights
        values = {name: self._option_value(data_field, name, output) for name in read}
        values |= {**data, "result": self.files.result, "output": output}
        return Command(TRANSFERS[data_field], request_of("transfer", values))

    def _texture_values(self) -> dict[str, Value]:
        """The open texture, alone or among the maps of its material."""
        texture = self.files.texture if self.finish_options.texture else None
        if not self.finish_options.maps:
            return {"texture": texture}
        return {"maps": (*(() if texture is None else ((COLOR_MAP, texture),)), *self.finish_options.maps)}

    def _option_value(self, data_field: str, name: str, output: Path) -> Value:
        """The value of a transfer's option."""
        value = self.value("transfer", name)
        if name == "usd":
            return output.with_suffix(".usda") if value else None
        if name == "bases":
            return self._base_files(data_field)
        if name == "detail_texture" and "texture" not in _as_names(self.value("transfer", "bake")):
            return None  # it is meant for the wrapped cage
        return value

    def _base_files(self, data_field: str) -> NamedFiles:
        """The target's own files under the transferred data, selected by name."""
        bases: NamedFiles = self.value("transfer", "bases")  # type: ignore[assignment]
        if data_field == "bake":
            kinds = _as_names(self.value("transfer", "bake"))
            return tuple((kind, path) for kind in kinds for name, path in bases if _normalize(name) == _normalize(kind))
        if data_field != "texture":
            return tuple(("", path) for name, path in bases if _normalize(name) == _normalize(data_field))
        if not self.finish_options.maps:
            return tuple(("", path) for name, path in bases if name in ("", "texture", COLOR_MAP))
        names = {_normalize(name): name for name, _ in self.finish_options.maps}
        if self.finish_options.texture and self.files.texture is not None:
            names |= {"": COLOR_MAP, "texture": COLOR_MAP, COLOR_MAP: COLOR_MAP}
        return tuple((names[_normalize(name)], path) for name, path in bases if _normalize(name) in names)

    def _name_parts(self, data_field: str) -> tuple[str, str]:
        """Parts of an output's name after the stem: before and after the source's part."""
        source, value = self.files.source, self.value("transfer", data_field)
        match data_field:
            case "texture":
                texture = self.files.texture if self.finish_options.texture else None
                return self._image_name(texture or self.finish_options.maps[0][1])
            case "normal_map" | "displacement" | "vector_displacement" if isinstance(value, Path):
                return self._image_name(value)
            case "material_colors":
                return f"_from_{source.stem}_material_colors", self.finish_options.image_form or ".png"
            case "bake":
                kinds = _as_names(value)
                kind = f"_{kinds[0]}" if len(kinds) == 1 else ""
                detail = self.value("transfer", "detail")
                origin = detail.stem if isinstance(detail, Path) else source.stem
                return self._origin(origin), f"{kind}{self.finish_options.image_form or '.png'}"
            case "source_uvs":
                return f"_with_uvs_of_{source.stem}", _mesh_suffix(self.files.target)
            case "blend_shapes":
                are_meshes = all(path.suffix.lower() in ("", ".obj", ".ply") for path in map(Path, _as_names(value)))
                return f"_from_{source.stem}_blend_shapes", "" if are_meshes else ".npz"
            case "write_map":
                return f"_on_{source.stem}", self.finish_options.map_form
            case "passenger" if isinstance(value, Path):
                return self._origin(value.stem), _mesh_suffix(value)
            case _:
                assert isinstance(value, Path)
                scene_form = ".json" if data_field == "joints" else ".npz"
                is_scene = value.suffix.lower() in (*USD_SUFFIXES, *SCENE_SUFFIXES)
                return self._origin(value.stem), scene_form if is_scene else value.suffix

    def _image_name(self, image: Path) -> tuple[str, str]:
        """Parts of a baked image's name; the transfer adds tile numbers."""
        stem = image.stem.replace(UDIM_MARK, "").rstrip("._-")
        form = image.suffix if image.suffix.lower() in IMAGE_SUFFIXES else ".png"  # a model's file has its images
        return self._origin(stem), self.finish_options.image_form or form

    def _origin(self, stem: str) -> str:
        """The source's name and a file's in an output's name; once if the file is named after the source."""
        source = self.files.source.stem
        return f"_from_{stem}" if stem.startswith(source) else f"_from_{source}_{stem}"

    def wrap(self) -> Command:
        """The wrap of the target's cage onto the source."""
        files, written = self.files, WRITTEN["wrap"]
        folder, stem = files.result.parent, f"{self.stem}_as_{files.source.stem}{self.source_suffix}"
        names = [name for command, name in self.options if command == "wrap"]
        values = self.values("wrap", [name for name in names if name not in (*written, *_WRAP_IMAGE_FIELDS)])
        for name in written:
            if self.value("wrap", name):
                default_form = ".exr" if "displacement" in name else ".png"  # offsets are floats
                image = f"{stem}_{name}{self.finish_options.image_form or default_form}"
                values[name] = folder / (f"{stem}.mhclo" if name == "mhclo" else image)
        images = [name for name in written if name != "mhclo" and name in values]
        values |= self.values("wrap", [name for name, of in WRAP_IMAGES_OF.items() if set(of) & set(images)])
        if "baked" in values:
            values["detail_texture"] = self.value("wrap", "detail_texture")
            values["texture"] = files.texture if values["detail_texture"] is None else None
        if [name for name in images if name != "baked"] or values.get("detail_texture") is not None:
            values |= self.values("wrap", ("detail",))
        mesh = folder / f"{stem}{_mesh_suffix(files.target)}"
        values |= {"results": (files.result,), "output": mesh, "force": self.value("wrap", "force")}
        return Command("wrap", request_of("wrap", values))

    def report(self) -> Command:
        """The report about the map."""
        result = self.files.result
        values = {"up": self.files.ups[0], "force": self.value("report", "force")}
        values |= {"result": result, "output": result.with_name(f"{result.name}.html")}
        return Command("report", request_of("report", values))


def _as_names(value: Value) -> tuple[str, ...]:
    return tuple(map(str, value)) if isinstance(value, tuple) else ()


def _normalize(name: str) -> str:
    """Spell a name uniformly: normal map, Normal-Map, normal_map."""
    return name.strip().lower().replace(" ", "_").replace("-", "_")


def _mesh_suffix(mesh: Path) -> str:
    """The mesh's own suffix, if the studio writes meshes in that format."""
    suffix = mesh.suffix.lower()
    return ".usda" if suffix == ".usdz" else suffix if suffix in (".obj", ".ply", *USD_SUFFIXES) else ".obj"
