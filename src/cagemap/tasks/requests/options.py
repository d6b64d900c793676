"""Annotations that turn fields of requests into options, and options shared by several requests."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import Field, dataclass, fields
from functools import cache, partial
from pathlib import Path
from types import NoneType
from typing import Annotated, Any, Literal, get_args, get_type_hints

from cagemap.errors import ParameterError, wrong_values
from cagemap.files import MASK_SUFFIXES

# Headings of `--help`, in their order.
CARRIED, INPUT, LANDMARKS = "What to carry, one of these", "Input", "Landmarks"
FIT, IMAGES, CHARACTER, FUNCTIONS = "Fit", "Images", "Weights and passengers", "Functions"
OUTPUT, RESEARCH, PAGE = "Output", "Research", "Page"
HEADINGS = (CARRIED, INPUT, LANDMARKS, FIT, IMAGES, CHARACTER, FUNCTIONS, OUTPUT, RESEARCH, PAGE)

SchemeName = Literal["catmull-clark", "loop", "bilinear", "none"]
UvName = Literal["none", "corners-only", "corners-plus1", "corners-plus2", "boundaries", "all"]


@dataclass(frozen=True)
class Option:
    """Option of the command line for a field of a request."""

    help: str
    group: str | None = None  # heading in `--help`
    names: tuple[str, ...] = ()  # as typed, see `option_names`; a switch may have ``--on/--off``
    min: float | None = None  # least and largest value
    max: float | None = None
    metavar: str | None = None  # name of the value in help
    typed: Any = None  # type on the command line, if it is not the field's
    suffixes: tuple[str, ...] = ()  # a text that ends in one of them is the name of a file
    setting: bool = False  # typed as ``--set NAME=VALUE``, see `cagemap.tasks.requests.settings`

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        """Validation and JSON schema of the field: its bounds, and the help text as its description."""
        from pydantic import BeforeValidator, Field  # here, since `cagemap --help` does not need it

        limits = Field(ge=self.min, le=self.max, description=self.help)
        kind = strip_none(source)
        if kind in (int, float):
            return handler(
                Annotated[source, limits, BeforeValidator(partial(_refuse_boolean, f"{kind.__name__}_type"))]
            )
        return handler(Annotated[source, limits])

    def option_names(self, field: str) -> tuple[str, ...]:
        """What is typed for a field, the long name first: by default the field's name, beside a short one."""
        if any(name.startswith("--") for name in self.names):
            return self.names
        return (f"--{field.replace('_', '-')}" if len(field) > 1 else f"-{field}", *self.names)

    def flag(self, field: str) -> str:
        """The long name of a field's option; of a switch without its ``/--off``."""
        return self.option_names(field)[0].partition("/")[0]


def _refuse_boolean(error: Any, value: object) -> object:
    """The value of a number's field: pydantic would take True as 1."""
    from pydantic_core import PydanticKnownError

    if isinstance(value, bool):
        raise PydanticKnownError(error)
    return value


def validate_request(request: type, values: Mapping[str, Any]) -> Any:
    """A request from values of its fields, which may be of similar kinds, such as texts for paths."""
    from pydantic import ValidationError  # here, since `cagemap --help` does not need it

    try:
        return _validator(request).validate_python(dict(values))
    except ValidationError as error:
        field, problem = wrong_values(error)[0]
        raise ParameterError(f"{'.'.join(map(str, field))}: {problem}") from None


@cache
def _validator(request: type) -> Any:
    from pydantic import TypeAdapter

    return TypeAdapter(request)  # cached: making it takes 0.03 s, and a job has thousands of requests


def document_fields(request: Any) -> None:
    """Make ``help(request)`` show the help text of every option."""
    lines = (f"{field.name}\n    {option.help}" for field, _, option in option_fields(request))
    request.__init__.__doc__ = "\n".join(["Parameters", "----------", *lines])


def field_values(request: Any, *names: str) -> dict[str, Any]:
    """Some fields of a request, by name."""
    return {name: getattr(request, name) for name in names}


def files_read(request: Any, *outputs: str) -> list[Path]:
    """Files that a request reads: all that it names but its results and outputs."""

    def paths(value: Any) -> Iterator[Path]:
        if isinstance(value, Path):
            yield value
        elif isinstance(value, tuple):
            for item in value:
                yield from paths(item)

    names = [field.name for field in fields(request) if field.name not in ("result", "results", "output", *outputs)]
    return [path for name in names for path in paths(getattr(request, name))]


def comma_words(text: str) -> list[str]:
    """Words of a comma-separated option."""
    return [word.strip() for word in text.split(",") if word.strip()]


def setting(help: str, *, min: float | None = None, metavar: str | None = None) -> Option:
    """A research option, typed as ``--set NAME=VALUE``."""
    return Option(help, RESEARCH, min=min, metavar=metavar, setting=True)


class Argument(Option):
    """Positional argument of the command line."""


class PythonOnly(Option):
    """Field that the command line fills from another option."""


def option_fields(request: type) -> Iterator[tuple[Field[Any], Any, Option]]:
    """Fields of a request, their types and options."""
    hints = get_type_hints(request, include_extras=True)
    for field in fields(request):
        kind, option = get_args(hints[field.name])
        yield field, kind, option


def strip_none(kind: Any) -> Any:
    """A type without None; a union of several others stays."""
    kinds = [member for member in get_args(kind) if member is not NoneType]
    return kinds[0] if NoneType in get_args(kind) and len(kinds) == 1 else kind


def refuse_unread(request: Any, readers: Mapping[str, Collection[str]], given: Collection[str]) -> None:
    """Refuse options that nothing given reads.

    ``readers``: fields or other words that read an option, by its field.
    """
    unread = (
        (name, words)
        for name, words in readers.items()
        if getattr(request, name) != getattr(type(request), name) and not set(words) & set(given)
    )
    for name, words in unread:
        flags = {field.name: option.flag(field.name) for field, _, option in option_fields(type(request))}
        expected, got = (" or ".join(flags.get(word, word) for word in listed) for listed in (words, given))
        raise ParameterError(
            f"{flags[name]}: expected with {expected} only, got {got or 'none of them'}. Leave {flags[name]} out."
        )


Space = Annotated[
    Literal["tangent", "object"], Option("Space of normals and vectors: tangent (MikkTSpace) or object.", IMAGES)
]
Green = Annotated[Literal["up", "down"], Option("Normal map: green up (OpenGL) or down (DirectX).", IMAGES)]
MeshFile = Annotated[Path, Argument("Control mesh, .obj, .ply, .off, .stl, glTF, VRM, FBX or USD.", metavar="MESH")]
Answer = Annotated[int, Option("Which reported alignment to use: 0 the best, 1 the second.", OUTPUT, min=0)]
Force = Annotated[bool, Option("Also overwrite files that cagemap did not write, or that were edited.", OUTPUT)]
ResultFolder = Annotated[Path, Argument("Folder that `cagemap match` wrote.", metavar="RESULT")]

SchemeOption = Annotated[
    SchemeName | None,
    Option(
        "Subdivision scheme; none uses the mesh without subdivision.  "
        "[default: the file's, else none (glTF, FBX), loop (triangles), catmull-clark]",
        INPUT,
    ),
]
TargetSchemeOption = Annotated[
    SchemeName | None, Option("The target's own scheme, where it differs.  [default: --scheme]", INPUT)
]
SourceSchemeOption = Annotated[
    SchemeName | None, Option("The source's own scheme, such as none for a scan.  [default: --scheme]", INPUT)
]
WeldOption = Annotated[
    str | None,
    Option(
        "Join vertices that the file repeats along seams, within TOLERANCE.  [default: off; glTF and FBX: always]",
        INPUT,
        metavar="auto|TOLERANCE",
    ),
]
TargetWeldOption = Annotated[
    str | None, Option("--weld of the target alone.  [default: --weld]", INPUT, metavar="auto|TOLERANCE")
]
SourceWeldOption = Annotated[
    str | None, Option("--weld of the source alone.  [default: --weld]", INPUT, metavar="auto|TOLERANCE")
]
TargetPartOption = Annotated[str | None, Option("--part of the target alone.  [default: --part]", INPUT)]
SourcePartOption = Annotated[str | None, Option("--part of the source alone.  [default: --part]", INPUT)]
BoundaryOption = Annotated[
    Literal["edge-and-corner", "edge-only", "none"] | None,
    Option(
        "Boundary corners: edge-and-corner keeps them sharp, edge-only rounds them.  "
        "[default: the file's, else edge-and-corner]",
        INPUT,
    ),
]
UvOption = Annotated[
    UvName | None,
    Option("Where UVs are interpolated linearly, as in OpenSubdiv.  [default: the file's, else all]", INPUT),
]
CreasingOption = Annotated[
    Literal["uniform", "chaikin"] | None,
    Option("Rule for semi-sharp creases, as in OpenSubdiv.  [default: the file's, else uniform]", INPUT),
]


TargetMaskOption = Annotated[
    str | None,
    Option(
        "Only this part of the target: name, values or image; not:... inverts.  [default: all]",
        INPUT,
        suffixes=MASK_SUFFIXES,
    ),
]
SourceMaskOption = Annotated[
    str | None,
    Option("Only this part of the source, see --target-mask.  [default: all]", INPUT, suffixes=MASK_SUFFIXES),
]
MaskEdgeOption = Annotated[
    float | None,
    Option(
        "Distance over which masks fade in, relative to the model's size.  "
        "[default: 0.02 for parts and face values, else 0]",
        INPUT,
        min=0.0,
    ),
]
