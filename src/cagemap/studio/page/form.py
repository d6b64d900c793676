"""The form of a finish: options for the page, and values sent back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from types import MappingProxyType
from typing import Any

from cagemap.errors import ParameterError
from cagemap.files import IMAGE_SUFFIXES
from cagemap.spectral.surface import DEFAULT_VERTICES
from cagemap.studio.finish import FinishOptions
from cagemap.studio.finish_layout import FILES, MORE_IMAGES, SIZE_KEY, VERTICES_KEY, WRAP, Field, sections
from cagemap.tasks.requests.catalogue import CommandOption, Key, NamedFiles, Options, Value

SIZES = ("512", "1024", "2048", "4096", "8192", "16384")
IMAGE_FORMS = (".png", ".tif", ".exr", ".jpg")
MAP_FORMS = (".npy", ".npz", ".mtx", ".vts", ".mhclo", ".proxy")
_MAPS_HINT = "roughness, normals, ... of the source's material: NAME=FILE, separated by commas"
_NAME_HINT = "beginning of all file names; another name keeps the files of an earlier bake"
_DEFAULTS = FinishOptions()


def form_fields(
    options: Options, vertices: int, recorded: Mapping[Key, Value] = MappingProxyType({})
) -> dict[str, Any]:
    """Entries of the form: key, label, hint, kind, value, choices and suffixes.

    The page sends values that a user changed, and those of entries with ``always_sent``. Options of an opened RESULT
    also have a ``default``, which the page takes when other models are opened.

    ``vertices``: of the map shown, which a bake uses where nothing else is typed.
    ``recorded``: options of an opened RESULT.
    """
    more = f"more, such as {DEFAULT_VERTICES}," if vertices < DEFAULT_VERTICES else "more"
    vertices_hint = f"of each model in the final map, approximately; {more} is finer and slower"
    first = [
        _entry("texture", "Texture", "flag", _DEFAULTS.texture, "bake the open image into the target's layout"),
        _option_entry(
            options,
            Field(SIZE_KEY, "Image size"),
            hint="width and height in texels; default: as the source's image",
            choices=SIZES,
        ),
        _option_entry(options, Field(VERTICES_KEY, "Vertices", (), vertices_hint, 1000), recorded, value=vertices)
        | {"always_sent": True},
    ]
    finish_entries: dict[str, list[dict[str, Any]]] = {
        MORE_IMAGES: [_entry("maps", "Maps", "named files", "", _MAPS_HINT, suffixes=IMAGE_SUFFIXES)],
        WRAP: [_entry("wrap", "Wrap", "flag", _DEFAULTS.wrap, "the target's mesh in the source's shape")],
        FILES: [
            _entry("name", "Name", "text", _DEFAULTS.name, _NAME_HINT),
            _entry("image_form", "Format", "choice", "", "of all images; empty: as the image", choices=IMAGE_FORMS),
            _entry("map_form", "Map file", "choice", "", "the map itself, for other programs", choices=MAP_FORMS),
            _entry("report", "Report", "flag", _DEFAULTS.report, "one page about the map and what was made"),
        ],
    }
    folds = [
        {
            "title": section.title,
            "fields": finish_entries.get(section.title, [])
            + [_option_entry(options, field, recorded) for field in section.fields],
        }
        for section in sections(options)
    ]
    return {"form": {"first": first, "folds": folds}}


def read_form(options: Options, sent: Mapping[str, Any]) -> FinishOptions:
    """Read the values that a page sent.

    ``sent``: by the keys of `form_fields`; missing ones have the default.
    ParameterError if a value is of the wrong kind.
    """
    labels = {field.key: field.label for section in sections(options) for field in section.fields}
    labels |= {VERTICES_KEY: "Vertices", SIZE_KEY: "Image size"}
    option_values: dict[Key, Value] = {}
    finish_values: dict[str, Any] = {}
    for name, sent_value in sent.items():
        command, dot, option = name.partition(".")
        if dot and (command, option) in labels:
            key = (command, option)
            value = _read_value(options[key], labels[key], sent_value)
            if value != options[key].default:
                option_values[key] = value
        elif name in {field.name for field in fields(FinishOptions)} - {"option_values"}:
            is_maps = name == "maps"
            finish_values[name] = (
                _named_files(str(sent_value)) if is_maps else type(getattr(_DEFAULTS, name))(sent_value)
            )
        else:
            raise ParameterError(f"{name}: expected an option of this page, got another name. Reload the page.")
    return FinishOptions(**finish_values, option_values=option_values)


def _entry(key: str, label: str, kind: str, value: Any, hint: str, **more: Any) -> dict[str, Any]:
    return {"key": key, "label": label, "kind": kind, "value": value, "hint": hint} | more


def _option_entry(
    options: Options, field: Field, recorded: Mapping[Key, Value] = MappingProxyType({}), **other: Any
) -> dict[str, Any]:
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
    entry = _entry(".".join(field.key), field.label, kind, value, field.hint or option.help)
    entry |= other
    if field.key in recorded:
        entry |= {"value": recorded[field.key], "default": entry["value"], "always_sent": True}
    return entry


def _read_value(option: CommandOption, label: str, sent: Any) -> Value:
    value = sent.strip() if isinstance(sent, str) else sent
    match option.kind:
        case "flag" | "output":
            return bool(value)
        case "several":
            return tuple(choice for choice in option.choices if choice in value)
        case "whole" | "number":
            number_type = int if option.kind == "whole" else float
            try:
                return number_type(value) if value not in ("", None) else None
            except (ValueError, TypeError):
                expected = "a whole number" if option.kind == "whole" else "a number"
                raise ParameterError(f"{label}: expected {expected} or nothing, got {value!r}. Correct it.") from None
        case "file":
            return Path(value) if value else None
        case "files":
            return tuple(map(Path, _split_list(str(value))))
        case "named files":
            return _named_files(str(value))
        case _:
            return str(value) if value else None


def _named_files(text: str) -> NamedFiles:
    pairs = [item.partition("=") for item in _split_list(text)]
    return tuple((name.strip(), Path(path)) if sign else ("", Path(name)) for name, sign, path in pairs)


def _split_list(text: str) -> list[str]:
    return [item.strip() for item in text.split(",") if item.strip()]
