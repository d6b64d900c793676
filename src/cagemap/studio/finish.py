"""The finish: what to make of a pair, and the requests of the package's own tasks that make it at full resolution."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType

from cagemap.errors import ParameterError
from cagemap.files.gltf.document import SCENE_SUFFIXES
from cagemap.files.images.image import UDIM_MARK
from cagemap.files.usd.read import USD_SUFFIXES
from cagemap.studio.opening import word_of
from cagemap.studio.state import Files
from cagemap.studio.workspace import Workspace
from cagemap.tasks.requests.catalogue import (
    WRITTEN,
    CommandOption,
    Key,
    NamedFiles,
    Options,
    Request,
    Value,
    request_of,
)

DEFAULT_VERTICES = 200_000
# Said once on the page and meant by several commands: field of a command, and the one that it is asked by.
SHARED: dict[Key, Key] = {
    **{("wrap", name): ("transfer", name) for name in ("space", "green", "rays", "size", "detail", "detail_texture")},
    **{(command, "force"): ("match", "force") for command in ("transfer", "wrap", "report")},
}
# What the first command makes.
MAP = "the map"
# The open texture among other maps of its material.
COLOR = "color"
_IMAGE = ("size", "bits", "filter", "unwrap", "bases", "force")


@dataclass(frozen=True)
class Carry:
    """One run of `cagemap transfer`: the field that says what is carried, and those that belong to it."""

    title: str
    wants: str
    takes: tuple[str, ...]


CARRIES = (
    Carry("texture", "texture", ("as_color", "usd", *_IMAGE)),
    Carry("normal map", "normal_map", ("space", "green", *_IMAGE)),
    Carry("displacement", "displacement", ("scale", "midlevel", *_IMAGE)),
    Carry("vector displacement", "vector_displacement", ("space", "scale", "midlevel", *_IMAGE)),
    Carry("material colours", "material_colors", ("size", "bits", "unwrap", "bases", "force")),
    Carry("detail", "bake", ("detail", "detail_texture", "rays", "space", "green", *_IMAGE)),
    Carry("attribute", "attribute", ("usd", "bases", "force")),
    Carry("UVs of the source", "source_uvs", ("force",)),
    Carry("skin weights", "weights", ("influences", "only", "mirror", "joints", "usd", "bases", "force")),
    Carry("joints", "joints", ("force",)),
    Carry("blend shapes", "blend_shapes", ("usd", "force")),
    Carry("map for other programs", "write_map", ("force",)),
)
# Options of `cagemap transfer` that belong to some of what is carried; any other belongs to all of it.
_KNOWN = {"output"} | {name for carry in CARRIES for name in (carry.wants, *carry.takes)}
# Options of `cagemap wrap` that belong to its images.
_WRAPPED = ("size", "space", "green", "rays", "detail", "detail_texture", "texture", "force")


@dataclass(frozen=True)
class FinishOptions:
    """What to make, in the words of the command line.

    Attributes
    ----------
    texture : bool
        Bake the open texture.
    maps : tuple of (str, Path)
        Further images over the source's UVs, by name.
    map_form : str
        Ending of the file for the map itself; '' for none.
    image_form : str
        Ending of all images; '': as the source's image.
    wrap, report : bool
    name : str
        What files are called by, and the RESULT folder; '': the target, and the open pair's RESULT.
    given : mapping of (command, field) to value
        Options that are not as usual.
    """

    texture: bool = True
    maps: NamedFiles = ()
    map_form: str = ""
    image_form: str = ""
    wrap: bool = False
    report: bool = True
    name: str = ""
    given: Mapping[Key, Value] = field(default_factory=lambda: MappingProxyType({}))

    def giving(self, values: Mapping[Key, Value]) -> FinishOptions:
        """The same with other values of some options."""
        return replace(self, given={**self.given, **values})

    def placed(self, options: Options, require: Callable[[Path], Path]) -> FinishOptions:
        """The same with every path as ``require`` gives it.

        Raises
        ------
        ParameterError
            If one lies outside the chosen folders, or the name is none of a file.
        """
        if self.name and (Path(self.name).name != self.name or self.name.startswith(".")):
            raise ParameterError(f"Name: expected what files begin with, without a folder, got {self.name!r}.")
        images = CommandOption("transfer", "maps", "--texture", "", "named files")
        given = {key: options[key].placed(value, require) for key, value in self.given.items()}
        maps: NamedFiles = images.placed(self.maps, require)  # type: ignore[assignment]
        return replace(self, maps=maps, given=given)


@dataclass(frozen=True)
class Command:
    """One task of a finish.

    Attributes
    ----------
    title : str
    request : request
        Beside its output other files may be written.
    makes : str
        What its output is; '' for the title.
    """

    title: str
    request: Request
    makes: str = ""

    @property
    def output(self) -> Path:
        """What it writes."""
        return self.request.output


def planned(
    options: Options, workspace: Workspace, files: Files, asked: FinishOptions, *, landmarks: bool
) -> tuple[Command, ...]:
    """The commands that finish what is open, all that they read and write inside the chosen folders.

    Raises
    ------
    ParameterError
        If a file lies outside them, or a link leads there; if a number is outside its range.
    """
    todo = commands(options, files, asked.placed(options, workspace.require), landmarks=landmarks)
    for command in todo:
        workspace.require_outputs(command.output)
    return todo


def commands(options: Options, files: Files, asked: FinishOptions, *, landmarks: bool) -> tuple[Command, ...]:
    """The commands that finish what is open.

    Parameters
    ----------
    options : mapping
        Of the command line.
    files : Files
    asked : FinishOptions
    landmarks : bool
        Whether the landmark file holds any.
    """
    writer = _Writer(options, files, asked)
    if asked.name:
        words = f"{writer.stem}_from{writer.giver}" if writer.giver else writer.stem
        writer = replace(writer, files=replace(files, result=files.result.with_name(f"{words}_RESULT")))
    made = [writer.match(landmarks=landmarks)]
    for carry in CARRIES:
        command = writer.transfer(carry, [other.output for other in made])
        made += [] if command is None else [command]
    made += [writer.wrap()] if asked.wrap else []
    made += [writer.report()] if asked.report else []
    return tuple(made)


@dataclass(frozen=True)
class _Writer:
    """Makes requests of what is asked."""

    options: Options
    files: Files
    asked: FinishOptions

    @property
    def stem(self) -> str:
        """What files begin with: what is asked for or the target, and its part."""
        part = self.files.parts[0]
        own = self.asked.name or self.files.target.stem
        return own if part is None else f"{own}_{word_of(part)}"

    @property
    def giver(self) -> str:
        """The source's part, behind what says where something comes from."""
        part = self.files.parts[1]
        return "" if part is None else f"_{word_of(part)}"

    def value(self, command: str, name: str) -> Value:
        """What is asked for an option."""
        key = SHARED.get((command, name), (command, name))
        return self.asked.given.get(key, self.options[key].default)

    def values(self, command: str, names: Iterable[str]) -> dict[str, Value]:
        """What is asked for some options."""
        return {name: self.value(command, name) for name in names}

    def match(self, *, landmarks: bool) -> Command:
        """The map at full resolution."""
        files = self.files
        values = self.values("match", (name for command, name in self.options if command == "match")) | {
            "target": files.target,
            "source": files.source,
            "landmarks": files.landmarks if landmarks else None,
            "output": files.result,
            "target_scheme": files.schemes[0],
            "source_scheme": files.schemes[1],
            "target_weld": files.welds[0],
            "source_weld": files.welds[1],
            "target_part": files.parts[0],
            "source_part": files.parts[1],
        }
        if values["level"] is None and values["vertices"] is None:
            values["vertices"] = DEFAULT_VERTICES
        return Command("match", request_of(self.options, "match", values), MAP)

    def transfer(self, carry: Carry, taken: list[Path]) -> Command | None:
        """One thing carried, unless it is not asked for; into a file of its own."""
        carried = self._texture() if carry.wants == "texture" else self.values("transfer", [carry.wants])
        if carry.wants == "write_map":
            carried = {"write_map": bool(self.asked.map_form)}
        if not any(carried.values()):
            return None
        says, ending = self._named(carry)
        output = self.files.result.parent / f"{self.stem}{says}{self.giver}{ending}"
        if output in taken:
            output = output.with_name(f"{output.stem}_{carry.wants}{output.suffix}")
        others = (name for command, name in self.options if command == "transfer" and name not in _KNOWN)
        values = {name: self._belonging(carry, name, output) for name in (*carry.takes, *others)}
        values |= {**carried, "result": self.files.result, "output": output}
        return Command(carry.title, request_of(self.options, "transfer", values))

    def _texture(self) -> dict[str, Value]:
        """The open texture, alone or as one of the maps of its material."""
        own = self.files.texture if self.asked.texture else None
        if not self.asked.maps:
            return {"texture": own}
        return {"maps": (*(() if own is None else ((COLOR, own),)), *self.asked.maps)}

    def _belonging(self, carry: Carry, name: str, output: Path) -> Value:
        """What is asked for an option that belongs to something carried."""
        value = self.value("transfer", name)
        if name == "usd":
            return output.with_suffix(".usda") if value else None
        if name == "bases":
            return self._bases(carry)
        if name == "detail_texture" and "texture" not in _parts(self.value("transfer", "bake")):
            return None  # said for the wrapped cage alone
        return value

    def _bases(self, carry: Carry) -> NamedFiles:
        """The target's own images or values under what is carried: each has the name of that, or of none."""
        given: NamedFiles = self.value("transfer", "bases")  # type: ignore[assignment]
        if carry.wants == "bake":
            kinds = _parts(self.value("transfer", "bake"))
            return tuple((kind, path) for kind in kinds for name, path in given if _plain(name) == _plain(kind))
        if carry.wants != "texture":
            return tuple(("", path) for name, path in given if _plain(name) == _plain(carry.wants))
        if not self.asked.maps:
            return tuple(("", path) for name, path in given if name in ("", "texture", COLOR))
        names = {_plain(name): name for name, _ in self.asked.maps} | {"": COLOR, "texture": COLOR, COLOR: COLOR}
        return tuple((names[_plain(name)], path) for name, path in given if _plain(name) in names)

    def _named(self, carry: Carry) -> tuple[str, str]:
        """What the name of an output says of it, before and after the source's part."""
        source, value = self.files.source, self.value("transfer", carry.wants)
        match carry.wants:
            case "texture":
                first = (self.files.texture if self.asked.texture else None) or self.asked.maps[0][1]
                return self._image(first)
            case "normal_map" | "displacement" | "vector_displacement" if isinstance(value, Path):
                return self._image(value)
            case "material_colors":
                return "_material_colors", self.asked.image_form or ".png"
            case "bake":
                kinds = _parts(value)
                only = f"_{kinds[0]}" if len(kinds) == 1 else ""
                detail = self.value("transfer", "detail")
                lies = detail.stem if isinstance(detail, Path) else source.stem
                return f"_from_{lies}", f"{only}{self.asked.image_form or '.png'}"
            case "source_uvs":
                return f"_with_uvs_of_{source.stem}", _mesh_form(self.files.target)
            case "blend_shapes":
                meshes = all(path.suffix.lower() in ("", ".obj", ".ply") for path in map(Path, _parts(value)))
                return "_blend_shapes", "" if meshes else ".npz"
            case "write_map":
                return f"_on_{source.stem}", self.asked.map_form
            case _:
                assert isinstance(value, Path)
                usual = ".json" if carry.wants == "joints" else ".npz"
                return f"_from_{value.stem}", usual if value.suffix.lower() in (
                    *USD_SUFFIXES,
                    *SCENE_SUFFIXES,
                ) else value.suffix

    def _image(self, image: Path) -> tuple[str, str]:
        """Where an image of the source is baked to; every tile of the target's layout gets its number."""
        stem = image.stem.replace(UDIM_MARK, "").rstrip("._-")
        return f"_from_{stem}", self.asked.image_form or image.suffix

    def wrap(self) -> Command:
        """The target's cage in the source's shape."""
        files, written = self.files, WRITTEN["wrap"]
        folder, name = files.result.parent, f"{self.stem}_as_{files.source.stem}{self.giver}"
        own = [name for command, name in self.options if command == "wrap"]
        values = self.values("wrap", [one for one in own if one not in (*written, *_WRAPPED)])
        for one in written:
            if self.value("wrap", one):
                usual = ".exr" if "displacement" in one else ".png"  # offsets are floats
                image = f"{name}_{one}{self.asked.image_form or usual}"
                values[one] = folder / (f"{name}.mhclo" if one == "mhclo" else image)
        images = [one for one in written if one != "mhclo" and one in values]
        if images:
            values |= self.values("wrap", ("size", "space", "green", "rays"))
        if "baked" in values:
            values["detail_texture"] = self.value("wrap", "detail_texture")
            values["texture"] = files.texture if values["detail_texture"] is None else None
        if [one for one in images if one != "baked"] or values.get("detail_texture") is not None:
            values |= self.values("wrap", ("detail",))
        mesh = folder / f"{name}{_mesh_form(files.target)}"
        values |= {"results": (files.result,), "output": mesh, "force": self.value("wrap", "force")}
        return Command("wrap", request_of(self.options, "wrap", values))

    def report(self) -> Command:
        """The page about the map."""
        result = self.files.result
        values = {"up": self.files.ups[0], "force": self.value("report", "force")}
        values |= {"result": result, "output": result.with_name(f"{result.name}.html")}
        return Command("report", request_of(self.options, "report", values))


def _parts(value: Value) -> tuple[str, ...]:
    return tuple(map(str, value)) if isinstance(value, tuple) else ()


def _plain(name: str) -> str:
    """A name as one may say it: normal map, Normal-Map, normal_map."""
    return name.strip().lower().replace(" ", "_").replace("-", "_")


def _mesh_form(target: Path) -> str:
    """The target's own format, where meshes are written in it."""
    suffix = target.suffix.lower()
    return ".usda" if suffix == ".usdz" else suffix if suffix in (".obj", ".ply", *USD_SUFFIXES) else ".obj"
