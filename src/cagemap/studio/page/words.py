"""Texts of the status line: progress, confidence of the map, and the next step."""

from __future__ import annotations

import re
import time
from typing import Any

import numpy as np

from cagemap.maps.hypotheses.confidence import LOOK, SURE, TWO
from cagemap.mesh.mesh_report import PLACE, VERTEX, count_noun
from cagemap.studio.scene import Scene
from cagemap.studio.skins import DOUBTFUL_TRUST
from cagemap.studio.state import RunningJob, StudioState

# Beginning of a stage's name, its text on the page, and the share of the task done before it; None for those of a bake.
STAGES = (
    ("read result", "reading the map", None),
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
    ("read", "reading the files", None),
    ("merge parts", "joining the parts", None),
    ("unwrap", "laying out UVs", None),
    ("prepare", "preparing the image", None),
    ("bake", "painting the image", None),
    ("carry values", "carrying the values", None),
    ("texture coordinates", "carrying the UVs", None),
    ("passenger", "fitting the passenger", None),
    ("detail", "finding the detailed mesh", None),
    ("ambient occlusion", "measuring ambient occlusion", None),
    ("range of ", "measuring the heights", None),
    ("wrap ", "fitting the mesh", None),
    ("write", "writing the files", None),
    ("draw", "drawing the pictures", None),
)
# Parts of the package's messages that the page's buttons and colours replace.
_ANSWER_HINT = re.compile(rf" \(`answer=\d+`\)|{PLACE}")
_VERTEX_HINT = re.compile(f"(?:, first)? at target {VERTEX}")


def confidence_text(message: str) -> str:
    """A message about a match in words of the page."""
    return _VERTEX_HINT.sub(" at the place that Next landmark shows", _ANSWER_HINT.sub("", message))


def verdict(state: StudioState, scene: Scene | None) -> str:
    """Confidence of the map in a few words; '' without a map."""
    map_state, preview_map = state.map, None if scene is None else scene.preview_map
    if scene is None or preview_map is None:
        return ""
    if map_state.unchecked:
        return "Not yet checked"
    if map_state.revision == 0:
        return ""
    landmarks = state.history.present.complete_landmarks
    if map_state.contradictions:
        count = len(map_state.contradictions)
        return f"{count} landmark{'s contradict' if count > 1 else ' contradicts'} the others"
    if map_state.poor:
        return f"Poor map: {map_state.poor}"
    percent = 100 * float(np.average(preview_map.trust < DOUBTFUL_TRUST, weights=scene.target.surface.vertex_areas))
    doubts = f"{percent:.0f} % stretched or folded" if percent >= 0.5 else "nothing stretched or folded"
    if landmarks:
        return f"{count_noun(len(landmarks), 'landmark')} met, {doubts}"
    if not map_state.confidence:
        return doubts.capitalize()
    confidence = next((known for known in (TWO, LOOK) if f"{known}: " in map_state.confidence), f"alignment {SURE}")
    return f"{confidence.capitalize()}, {doubts}"


def bake_hint(state: StudioState, scene: Scene | None) -> str:
    """What a bake does with the map, and how long that takes; '' without a map."""
    if scene is None or not state.map.first_seconds:
        return "" if scene is None or state.preview_job is None else "A bake uses the map that is being computed."
    seconds = f"from the start, which takes {state.map.first_seconds:.0f} s or longer"
    if state.map.from_start:
        return (
            "The map shown is baked. More vertices are finer. For them, and after other changes, a bake computes a map "
            f"{seconds}."
        )
    return f"A bake computes the map {seconds}; the next bake of the same landmarks uses it again."


def status_entries(state: StudioState, scene: Scene | None) -> dict[str, Any]:
    """Text, kind ("busy", "error", "ask", "ready"), fraction done or None, and whether it can be cancelled.

    If busy, also the seconds since the beginning.
    """
    job = state.finish_job or state.preview_job
    if job is not None:
        progress = _preview_progress(job) if state.finish_job is None else _finish_progress(job)
        return {"kind": "busy", "cancel": True, "seconds": time.monotonic() - job.begun} | progress
    text, kind = _next_step(state, scene), "ready"
    if state.error is not None:
        text, kind = state.error.text, "error"
    elif state.history.present.open_landmark is not None:
        kind = "ask"
    return {"kind": kind, "text": text, "fraction": None, "cancel": False}


def _finish_progress(job: RunningJob) -> dict[str, Any]:
    command, _, stage = job.stage.partition(": ")
    text = f": {_stage_text(stage)[0]}" if stage else ""
    return {"text": f"Baking, step {job.title.removeprefix('finish ')}, {command}{text}", "fraction": job.fraction}


def _preview_progress(job: RunningJob) -> dict[str, Any]:
    text, fraction = _stage_text(job.stage) if job.stage else ("", 0.02)
    return {"text": f"{job.title}{': ' if text else ''}{text}", "fraction": fraction}


def _stage_text(stage: str) -> tuple[str, float | None]:
    return next(((text, fraction) for start, text, fraction in STAGES if stage.startswith(start)), (stage, None))


def _next_step(state: StudioState, scene: Scene | None) -> str:
    if state.files is None:
        return state.messages[-1].text if state.messages else "Open two models, or drop their files here."
    if state.map.unchecked:  # cancelled
        return "This map is not checked. Press Match again for the checked one."
    if state.map.revision == 0:
        return "These models are not open. Press Open…" if scene is None else "No map yet. Press Match again."
    if state.probe is not None and state.probe.text:
        return state.probe.text
    if state.history.present.open_landmark is not None:
        return "Click the same place on the other model, or press Enter to accept the proposed one."
    if state.view.pose:
        return "Both models are posed, the target by the joints and weights that the map gives it."
    if state.view.mode == "baked":
        return "The baked image is on the target."
    return "Map found. Press Bake, or where it is wrong, click that place on one model, then on the other."
