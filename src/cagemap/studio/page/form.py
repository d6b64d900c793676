"""The form of a bake: what the page shows of the options, and what it sends back as values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from cagemap.errors import ParameterError
from cagemap.studio.finish import DEFAULT_VERTICES, FinishOptions
from cagemap.studio.finish_layout import FILES, MORE_IMAGES, SIZE, VERTICES, WRAP, Field, folds
from cagemap.studio.workspace import IMAGES
from cagemap.tasks.requests.catalogue import CommandOption, Key, NamedFiles, Options, Value

SIZES = ("512", "1024", "2048", "4096", "8192", "16384")
IMAGE_FORMS = (".png", ".tif", ".exr", ".jpg")
MAP_FORMS = (".npy", ".npz", ".mtx", ".vts", ".mhclo", ".proxy")
_MAPS = "roughness, normals, ... of the source's material, all baked in one run: NAME=FILE, with commas"
_NAME = "what files begin with; another name keeps what an earlier bake wrote"
_USUAL = FinishOptions()


def form(options: Options) -> dict[str, Any]:
    """Fields shown at once, and those of the folds: key, label, hint, kind, value, choices and endings of files."""
    hint = "how finely the final map is computed, on each model; more is slower"
    first = [
        _own("texture", "Texture", "flag", _USUAL.texture, "bake the open image into the target's layout"),
        _option(options, Field(SIZE, "Texels"), hint="width and height of every image", choices=SIZES),
        _option(options, Field(VERTICES, "Vertices", (), hint, 1000), value=DEFAULT_VERTICES),
    ]
    own: dict[str, list[dict[str, Any]]] = {
        MORE_IMAGES: [_own("maps", "Maps", "named files", "", _MAPS, suffixes=IMAGES)],
        WRAP: [_own("wrap", "Wrap", "flag", _USUAL.wrap, "the target's mesh in the source's shape")],
        FILES: [
            _own("name", "Name", "text", _USUAL.name, _NAME),
            _own("image_form", "Format", "choice", "", "of all images; empty: as the image", choices=IMAGE_FORMS),
            _own("map_form", "Map file", "choice", "", "the map itself, for other programs", choices=MAP_FORMS),
            _own("report", "Report", "flag", _USUAL.report, "one page about the map and what was made"),
        ],
    }
    groups = [
        {
            "title": fold.title,
            "fields": own.get(fold.title, []) + [_option(options, one) for one in fold.fields],
        }
        for fold in folds(options)
    ]
    return {"form": {"first": first, "folds": groups}}


def finish_options(options: Options, sent: Mapping[str, Any], require: Any) -> FinishOptions:
    """What is asked for.

    Parameters
    ----------
    options : mapping
    sent : mapping of str to value
        By the keys of `form`; what is missing is as usual.
    require : callable
        Gives a path inside the workspace.

    Raises
    ------
    ParameterError
        If a value is none of its kind, or a file lies outside the workspace.
    """
    labels = {one.key: one.label for fold in folds(options) for one in fold.fields}
    labels |= {VERTICES: "Vertices", SIZE: "Texels"}
    given: dict[Key, Value] = {VERTICES: DEFAULT_VERTICES}
    own: dict[str, Any] = {}
    for name, value in sent.items():
        command, dot, field = name.partition(".")
        if dot and (command, field) in labels:
            key = (command, field)
            read = _value(options[key], labels[key], value, require)
            if read != options[key].default:
                given[key] = read
        elif name in {one.name for one in fields(FinishOptions)} - {"given"}:
            own[name] = _named_files(str(value)) if name == "maps" else type(getattr(_USUAL, name))(value)
        else:
            raise ParameterError(
                f"{name}: expected an option of this page, got none of that name. Load the page again."
            )
    if given.get(("match", "level")) is not None:
        del given[VERTICES]
    return FinishOptions(**own, given=given)


def _own(key: str, label: str, kind: str, value: Any, hint: str, **more: Any) -> dict[str, Any]:
    return {"key": key, "label": label, "kind": kind, "value": value, "hint": hint} | more


def _option(options: Options, field: Field, **other: Any) -> dict[str, Any]:
    option = options[field.key]
    value = "" if option.default is None or isinstance(option.default, tuple) else option.default
    kind = {"output": "flag", "whole": "number"}.get(option.kind, option.kind)
    if kind == "choice" or "choices" in other:
        other = {"choices": option.choices, "usual": option.default is None} | other
    elif kind == "several":
        other["choices"] = option.choices
    if kind in ("file", "files", "named files", "name or file"):
        other["suffixes"] = field.suffixes
    if kind == "number":
        other = {"least": option.least, "most": option.most, "step": field.step} | other
    made = _own(".".join(field.key), field.label, kind, value, field.hint or option.help)
    return made | other


def _value(option: CommandOption, label: str, sent: Any, require: Any) -> Value:
    words = sent.strip() if isinstance(sent, str) else sent
    match option.kind:
        case "flag" | "output":
            return bool(words)
        case "several":
            return tuple(one for one in option.choices if one in words)
        case "whole" | "number":
            kind = int if option.kind == "whole" else float
            try:
                return kind(words) if words not in ("", None) else None
            except (ValueError, TypeError):
                form = "a whole number" if option.kind == "whole" else "a number"
                raise ParameterError(f"{label}: expected {form} or nothing, got {words!r}. Correct it.") from None
        case "file":
            return require(words) if words else None
        case "files":
            return tuple(Path(one) for one in _listed(str(words)))
        case "named files":
            return _named_files(str(words))
        case _:
            return str(words) if words else None


def _named_files(text: str) -> NamedFiles:
    pairs = [one.partition("=") for one in _listed(text)]
    return tuple((name.strip(), Path(path)) if sign else ("", Path(name)) for name, sign, path in pairs)


def _listed(text: str) -> list[str]:
    return [one.strip() for one in text.split(",") if one.strip()]
