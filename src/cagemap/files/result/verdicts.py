"""Quality figures in plain words."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

from cagemap.files.result.manifest import doubt_message, landmark_messages


@dataclass(frozen=True)
class Rating:
    """One quality figure with its verdict."""

    label: str  # its name
    value: str  # number with unit
    meaning: str  # how to read it
    severity: float  # up to 1 the figure is good, up to 2 fair
    finding: str  # the figure as the end of a sentence

    @property
    def verdict(self) -> str:
        """One of "good", "fair" and "poor"."""
        return "good" if self.severity <= 1.0 else "fair" if self.severity <= 2.0 else "poor"


def rate_figures(quality: dict[str, Any]) -> list[Rating]:
    """Rate the known figures of a manifest's ``quality``."""
    ratings = []
    for figure in _FIGURES:
        stated = _read_figure(quality, *figure.names)
        if stated is None:
            continue
        value = 1.0 - stated if figure.complement else stated
        severity = math.inf if math.isnan(value) else _severity(abs(value), figure.good, figure.fair)
        text = "unknown" if math.isnan(value) else figure.formatted(value)
        ratings.append(Rating(figure.label, text, figure.meaning, severity, figure.finding.format(text)))
    return ratings


def overall_verdict(ratings: list[Rating], warnings: list[str]) -> str:
    """The worst verdict; at best "fair" if there are warnings."""
    verdicts = {rating.verdict for rating in ratings} | ({"fair"} if warnings else set())
    return next((verdict for verdict in ("poor", "fair") if verdict in verdicts), "good")


def map_verdict(manifest: dict[str, Any], *, marked: bool = False) -> tuple[str, str]:
    """Verdict of a map, see `overall_verdict`, and a sentence that gives its reasons.

    ``marked``: whether the reader sees marks at the places.
    """
    quality = manifest.get("quality") or {}
    ratings, doubt = rate_figures(quality), doubt_message(manifest)
    verdict = overall_verdict(ratings, [*landmark_messages(manifest), *(quality.get("warnings") or [])])
    rating = max(ratings, key=lambda one: one.severity, default=None)
    worst = rating.finding if rating and rating.verdict == verdict else ""
    advice = "look at the marked places" if marked else "read the remarks below"
    doubtful = f"{doubt[:1].upper()}{doubt[1:]}." if doubt else ""
    if verdict == "poor":
        return verdict, f"Do not use this map as it is: {worst}. {doubtful}".strip()
    if doubtful:
        return verdict, doubtful
    if verdict == "good":
        return verdict, "The map looks sound."
    return verdict, f"The map is usable; {worst}: {advice}." if worst else f"The map is usable; {advice}."


def _severity(value: float, good: float, fair: float) -> float:
    """`Rating.severity` of a figure; ``good``, ``fair``: its largest good and largest fair value."""
    if value <= good:
        return value / good
    return 1.0 + (value - good) / (fair - good) if value <= fair else 1.0 + value / fair


def _read_figure(quality: dict[str, Any], *names: str) -> float | None:
    value: Any = quality
    for name in names:
        value = value.get(name) if isinstance(value, dict) else None
    return float(value) if isinstance(value, int | float) else None


def _percent(share: float) -> str:
    return f"{100 * share:.2f} %"


class _Figure(NamedTuple):
    """A quality figure that is rated."""

    names: tuple[str, ...]  # of its entry
    label: str
    meaning: str
    good: float  # largest good value
    fair: float  # largest fair value
    finding: str
    complement: bool = False  # rate 1 minus the value
    formatted: Callable[[float], str] = _percent


_FIGURES = (
    _Figure(
        ("landmark_error_mean",),
        "Landmarks, mean miss",
        "How far from their partners the landmarks land, as a share of the model's size (the square root of its area). "
        "0 is exact; 1 % of a person is about a finger's width.",
        0.005,
        0.04,
        "landmarks miss by {} of the model's size",
    ),
    _Figure(
        ("landmark_error_worst",),
        "Landmarks, worst miss",
        "The same for the landmark that is met worst. Pairs that were left out do not count.",
        0.01,
        0.15,
        "a landmark misses by {} of the model's size",
    ),
    _Figure(
        ("flipped_area",),
        "Folded area",
        "Part of the target where the map runs backwards over itself. A texture is mirrored or smeared there.",
        0.005,
        0.08,
        "{} of the target is folded over",
    ),
    _Figure(
        ("coverage",),
        "Source left out",
        "Part of the source's area that nothing of the target maps to. What is painted there does not arrive.",
        0.02,
        # A part that the target lacks (an udder, a mouth) does not make the rest of the map worse.
        0.5,
        "{} of the source arrives nowhere",
        complement=True,
    ),
    _Figure(
        ("dirichlet",),
        "Stretch",
        "1 for a map that keeps all lengths; models of different proportions have more. Lower is smoother.",
        2.0,
        10.0,
        "its stretch is {} (1 keeps all lengths)",
        formatted="{:.2f}".format,
    ),
    _Figure(
        ("aspect_ratio_percentiles", "50"),
        "Typical distortion",
        "How much longer than wide a small circle becomes, in the middle half of the surface.",
        2.0,
        4.0,
        "its typical distortion is {}",
        formatted="{:.2f} : 1".format,
    ),
    _Figure(
        ("trusted_area",),
        "Not to be trusted",
        "How far the map is from unfolded and little stretched, averaged over the target; the red places of "
        "the view Problems.",
        0.10,
        # Folds have their own verdict; a toy and a real animal differ by this much stretch.
        0.60,
        "{} of the target is folded or stretched",
        complement=True,
    ),
)
