"""Controls of the page for options of the command line, each by the kind of its option."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cagemap.errors import ParameterError
from cagemap.studio.finish_layout import Field
from cagemap.studio.page.choices import NONE, Choices, put
from cagemap.tasks.requests.catalogue import CommandOption, NamedFiles, Value

USUAL = "as usual"
_SEPARATOR = ", "


@dataclass(frozen=True)
class Control:
    """An option on the page.

    Attributes
    ----------
    label : str
    value : callable
        What is asked for; raises `ParameterError` where that cannot be read.
    """

    label: str
    value: Callable[[], Value]


def control(gui: Any, choices: Choices, option: CommandOption, field: Field) -> Control:
    """Show an option; its usual value is chosen."""
    label, hint = field.label, field.hint or option.help
    made: Callable[[], Value]
    match option.kind:
        case "flag" | "output":
            checkbox = gui.add_checkbox(label, bool(option.default), hint=hint)
            made = lambda: bool(checkbox.value)  # noqa: E731
        case "choice":
            made = _choice(gui, option, label, hint)
        case "several":
            boxes = {one: gui.add_checkbox(one, False, hint=hint) for one in option.choices}
            made = lambda: tuple(one for one, box in boxes.items() if box.value)  # noqa: E731
        case "whole" | "number":
            made = _number(gui, option, field, hint)
        case "file":
            dropdown = choices.dropdown(gui, label, field.suffixes, hint)
            made = lambda: choices.path(dropdown)  # noqa: E731
        case "name or file":
            text = _chosen_text(gui, choices, field, hint, lambda _, chosen: chosen)
            made = lambda: str(text.value).strip() or None  # noqa: E731
        case "files":
            listed = _chosen_text(gui, choices, field, hint, _with)
            made = lambda: tuple(Path(one) for one in _listed(listed.value))  # noqa: E731
        case "named files":
            return named_files(gui, choices, field, hint)
        case _:
            line = gui.add_text(label, str(option.default or ""), hint=hint)
            made = lambda: str(line.value).strip() or None  # noqa: E731
    return Control(label, made)


def named_files(gui: Any, choices: Choices, field: Field, hint: str) -> Control:
    """Files with names before them: ``roughness=skin_rough.png``; one that is chosen gets the last word of its own."""

    def named(before: str, chosen: str) -> str:
        return _with(before, f"{last_word(chosen)}={chosen}")

    text = _chosen_text(gui, choices, field, hint, named)

    def value() -> NamedFiles:
        pairs = [one.partition("=") for one in _listed(text.value)]
        return tuple((name.strip(), Path(path)) if sign else ("", Path(name)) for name, sign, path in pairs)

    return Control(field.label, value)


def last_word(file: str) -> str:
    """What an image is most likely of, by its name.

    Examples
    --------
    >>> last_word("maps/spot_roughness.png"), last_word("skin.<UDIM>.png"), last_word("Height.exr")
    ('roughness', 'skin', 'height')
    """
    stem = Path(file).stem.replace("<UDIM>", "").rstrip("._-")
    return "".join(c if c.isalnum() else " " for c in stem).split()[-1].lower() if stem else "map"


def _choice(gui: Any, option: CommandOption, label: str, hint: str) -> Callable[[], Value]:
    words = option.choices if option.default is not None else (USUAL, *option.choices)
    dropdown = gui.add_dropdown(label, words, initial_value=str(option.default or USUAL), hint=hint)
    return lambda: None if dropdown.value == USUAL else str(dropdown.value)


def _number(gui: Any, option: CommandOption, field: Field, hint: str) -> Callable[[], Value]:
    kind = int if option.kind == "whole" else float
    if isinstance(option.default, int | float):
        number = gui.add_number(
            field.label, option.default, min=option.least, max=option.most, step=kind(field.step), hint=hint
        )
        return lambda: kind(number.value)
    text = gui.add_text(field.label, "", hint=hint)

    def value() -> Value:
        words = str(text.value).strip()
        try:
            return kind(words) if words else None
        except ValueError:
            form = "a whole number" if option.kind == "whole" else "a number"
            raise ParameterError(f"{field.label}: expected {form} or nothing, got {words!r}. Correct it.") from None

    return value


def _chosen_text(gui: Any, choices: Choices, field: Field, hint: str, taken: Callable[[str, str], str]) -> Any:
    """A line of text, and a dropdown of files under it: one that is chosen goes into the text."""
    text = gui.add_text(field.label, "", hint=hint)
    dropdown = choices.dropdown(gui, "… choose", field.suffixes, hint)

    def choose(event: Any) -> None:
        if event.client is not None and dropdown.value != NONE:  # by a person
            text.value = taken(str(text.value), str(dropdown.value))
            put(dropdown, "value", NONE)

    dropdown.on_update(choose)
    return text


def _with(before: str, one: str) -> str:
    return _SEPARATOR.join([*_listed(before), one])


def _listed(text: str) -> list[str]:
    return [one.strip() for one in str(text).split(_SEPARATOR.strip()) if one.strip()]
