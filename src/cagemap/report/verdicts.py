"""Quality figures in plain words."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

_PERCENT = "{:.2f} %"


@dataclass(frozen=True)
class Rating:
    """One figure for people.

    Attributes
    ----------
    label, value, meaning : str
        What it is called, its number with its unit, and a sentence on how to read it.
    verdict : str
        "good", "fair" or "poor".
    finding : str
        The figure as the end of a sentence.
    """

    label: str
    value: str
    meaning: str
    verdict: str
    finding: str


def explain(quality: dict[str, Any]) -> list[Rating]:
    """Figures of a manifest's ``quality``, each with a verdict; unknown or missing ones are left out."""
    ratings = []
    for read, label, show, meaning, good, fair, finding in _FIGURES:
        value = read(quality)
        if value is None:
            continue
        badness = abs(value)
        verdict = "good" if badness <= good else "fair" if badness <= fair else "poor"
        ratings.append(Rating(label, show(value), meaning, verdict, finding.format(show(value))))
    return ratings


def overall(ratings: list[Rating], warnings: list[str]) -> str:
    """One word for all: the worst verdict, at best "fair" where there are warnings."""
    verdicts = {rating.verdict for rating in ratings} | ({"fair"} if warnings else set())
    return next((verdict for verdict in ("poor", "fair") if verdict in verdicts), "good")


def sentence(ratings: list[Rating], verdict: str, *, unsure: bool = False, marked: bool = True) -> str:
    """The verdict for people: one sentence that names the worst figure.

    Parameters
    ----------
    ratings : list of Rating
    verdict : str
        See `overall`.
    unsure : bool
        Whether the map, with few landmarks or none, may be another than the right one.
    marked : bool
        Whether the page has marked places.
    """
    worst = next((rating.finding for rating in ratings if rating.verdict == verdict), "")
    if verdict == "good":
        return "The map looks sound."
    if verdict == "poor":
        return f"Do not use this map as it is: {worst}."
    if unsure:
        return "Look at this map first: it may not be the right one."
    advice = "look at the marked places" if marked else "read the remarks below"
    return f"The map is usable; {worst}: {advice}." if worst else f"The map is usable; {advice}."


def _get(quality: dict[str, Any], *names: str) -> float | None:
    value: Any = quality
    for name in names:
        value = value.get(name) if isinstance(value, dict) else None
    return float(value) if isinstance(value, int | float) else None


def _missing(name: str) -> Callable[[dict[str, Any]], float | None]:
    def read(quality: dict[str, Any]) -> float | None:
        share = _get(quality, name)
        return None if share is None else 1.0 - share

    return read


_Figure = tuple[Callable[[dict[str, Any]], float | None], str, Callable[[float], str], str, float, float, str]
# reader, label, format, meaning, good up to, fair up to (of the value as read), finding
_FIGURES: list[_Figure] = [
    (
        lambda q: _get(q, "landmark_error_mean"),
        "Landmarks, mean miss",
        lambda x: _PERCENT.format(100 * x),
        "How far from their partners the landmarks land, as a share of the model's size (the square root of its area). "
        "0 is exact; 1 % of a person is about a finger's width.",
        0.005,
        0.04,
        "landmarks miss by {} of the model's size",
    ),
    (
        lambda q: _get(q, "landmark_error_worst"),
        "Landmarks, worst miss",
        lambda x: _PERCENT.format(100 * x),
        "The same for the landmark that is met worst. Pairs that were left out do not count.",
        0.01,
        0.15,
        "a landmark misses by {} of the model's size",
    ),
    (
        lambda q: _get(q, "flipped_area"),
        "Folded area",
        lambda x: _PERCENT.format(100 * x),
        "Part of the target where the map runs backwards over itself. A texture is mirrored or smeared there.",
        0.005,
        0.08,
        "{} of the target is folded over",
    ),
    (
        _missing("coverage"),
        "Source left out",
        lambda x: _PERCENT.format(100 * x),
        "Part of the source's area that nothing of the target maps to. What is painted there does not arrive.",
        0.02,
        # A part that the target lacks (an udder, a mouth) leaves the rest of the map as good as it is.
        0.5,
        "{} of the source arrives nowhere",
    ),
    (
        lambda q: _get(q, "dirichlet"),
        "Stretch",
        "{:.2f}".format,
        "1 for a map that keeps all lengths; models of different proportions have more. Lower is smoother.",
        2.0,
        10.0,
        "it stretches strongly ({}; 1 keeps all lengths)",
    ),
    (
        lambda q: _get(q, "aspect_ratio_percentiles", "50"),
        "Typical distortion",
        lambda x: f"{x:.2f} : 1",
        "How much longer than wide a small circle becomes, in the middle half of the surface.",
        2.0,
        4.0,
        "it distorts strongly ({} in the middle)",
    ),
    (
        _missing("trusted_area"),
        "Not to be trusted",
        lambda x: _PERCENT.format(100 * x),
        "How far the map is from unfolded and little stretched, averaged over the target; the red places of "
        "the view Problems.",
        0.10,
        # Folds have a verdict of their own above; a toy and its living model differ by this much stretch alone.
        0.60,
        "{} of the target is folded or stretched",
    ),
]
