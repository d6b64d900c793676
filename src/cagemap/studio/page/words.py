"""The status line: what is computed, how far it is, how sure the map is, and what to do next."""

from __future__ import annotations

import re
from typing import Any

from cagemap.mesh.mesh_report import counted
from cagemap.studio.preview import OPENING
from cagemap.studio.scene import Scene
from cagemap.studio.skins import DOUBTFUL
from cagemap.studio.state import RunningJob, Studio

# Beginnings of stages' names, what they are called on the page, and how much of a match is done when they begin.
STAGES = (
    ("reading the models", "reading the files", 0.1),
    ("reading the texture", "reading the image", 0.6),
    ("prepare ", "measuring the shapes", 0.05),
    ("refine ", "measuring the shapes", 0.1),
    ("operators of ", "measuring the shapes", 0.15),
    ("basis of ", "measuring the shapes", 0.2),
    ("possible alignments", "trying which parts correspond", 0.35),
    ("rough alignment", "aligning roughly", 0.4),
    ("first alignment", "aligning roughly", 0.4),
    ("elastic alignment", "aligning in detail", 0.6),
    ("elastic update", "following the landmarks", 0.4),
    ("closest points", "finishing the map", 0.75),
    ("compare landmarks", "checking the landmarks", 0.8),
    ("map without doubtful landmarks", "matching without doubtful landmarks", 0.82),
    ("test landmarks", "checking the landmarks", 0.85),
    ("quality", "checking the map", 0.9),
)
# How the package says to ask for another answer and where a landmark helps, which are buttons here.
_ANSWER, _VERTEX = re.compile(r" \(`answer=\d+`\)"), re.compile(r"(?:, first)? at target vertex \d+")
_VERDICTS = {"two answers: ": "Two ways fit", "look at it: ": "Have a look"}


def confidence_text(message: str) -> str:
    """What is said of how sure a match is, for the page."""
    return _VERTEX.sub(" at the place that Next landmark shows", _ANSWER.sub("", message))


def verdict(state: Studio, scene: Scene | None) -> str:
    """How sure the map is, in a few words; '' without a map."""
    known, images = state.map, None if scene is None else scene.images
    if images is None:
        return ""
    if known.rough:
        return "A first look, not yet checked"
    if known.revision == 0:
        return ""
    landmarks = state.history.present.complete
    if known.contradictions:
        count = len(known.contradictions)
        return f"{count} landmark{'s contradict' if count > 1 else ' contradicts'} the others"
    doubtful = 100 * float((images.trust < DOUBTFUL).mean())
    few = f"{doubtful:.0f} % doubtful" if doubtful >= 0.5 else "no doubtful places"
    if landmarks:
        return f"{counted(len(landmarks), 'landmark')} met, {few}"
    said = next((words for start, words in _VERDICTS.items() if start in known.confidence), "Sure")
    return few.capitalize() if not known.confidence else f"{said}, {few}"


def status(state: Studio) -> dict[str, Any]:
    """Text, kind ("busy", "error", "ask" or "ready"), share done or None, and whether it can be cancelled."""
    job = state.finish_job or state.preview_job
    if job is not None:
        return {"kind": "busy", "cancel": True} | _progress(job, finish=state.finish_job is not None)
    text, kind = _next_step(state), "ready"
    if state.messages and state.messages[-1].kind == "error":
        text, kind = state.messages[-1].text, "error"
    elif state.history.present.open is not None:
        kind = "ask"
    return {"kind": kind, "text": text, "fraction": None, "cancel": False}


def _progress(job: RunningJob, *, finish: bool) -> dict[str, Any]:
    if finish:
        command, _, stage = job.stage.partition(": ")
        return {
            "text": f"Baking, step {job.title.removeprefix('finish ')}: {_words(stage or command)[0]}",
            "fraction": job.fraction,
        }
    words, share = _words(job.stage) if job.stage else ("", 0.02)
    return {"text": f"{job.title}{': ' if words else ''}{words}", "fraction": share}


def _words(stage: str) -> tuple[str, float | None]:
    return next(((words, share) for start, words, share in STAGES if stage.startswith(start)), (stage, None))


def _next_step(state: Studio) -> str:
    if state.files is None:
        return "Open two models, or drop their files here."
    if state.map.rough:  # the search was cancelled
        return "This is a first look at the map. Press Match again for the checked one."
    if state.map.revision == 0:
        return OPENING
    if state.probe is not None and state.probe.text:
        return state.probe.text
    if state.history.present.open is not None:
        return "Click the same place on the other model, or press Enter to accept the proposed one."
    if state.view.pose:
        return "Both models are posed, the target by the joints and weights that the map gives it."
    if state.view.mode == "baked":
        return "The baked image is on the target."
    return "Map found. Where it is wrong, click that place on one model, then on the other."
