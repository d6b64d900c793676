"""What `cagemap match` prints at its end: a summary, warnings and the commands to type next."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from cagemap.files.gltf.document import GLTF_SUFFIXES
from cagemap.files.result.manifest import doubt_message, landmark_messages, sure_message
from cagemap.files.result.verdicts import map_verdict
from cagemap.maps.hypotheses.confidence import describe_signs
from cagemap.maps.quality import MASK_ADVICE
from cagemap.maps.result import MatchResult
from cagemap.mesh import ControlMesh
from cagemap.tasks.requests.match import MatchRequest

_DOUBT = "the map between the bodies may be wrong{}. Look at the result, and give --landmarks where it is wrong"


def match_figures(result: MatchResult, seconds: float) -> dict[str, Any]:
    """Figures of a match: numbers of vertices, seconds, and those of the manifest."""
    manifest = result.manifest
    counts = {"target_vertices": len(result.target.vertices), "source_vertices": len(result.source.vertices)}
    kept = {name: manifest[name] for name in ("quality", "confidence", "shared_area") if manifest.get(name) is not None}
    return {**counts, "seconds": seconds, **kept}


def summary(result: MatchResult, folder: Path, figures: Mapping[str, Any]) -> str:
    """Summary of a match for the terminal, from its `match_figures`."""
    manifest, quality = result.manifest, figures["quality"]
    lines = [
        f"{result.source.control.name} -> {result.target.control.name}: {figures['target_vertices']:,} target and "
        f"{figures['source_vertices']:,} source vertices in {figures['seconds']:.1f} s",
        "  " + "; ".join(filter(None, (landmark_summary(result), sure_message(manifest)))),
        f"  {100 * quality['flipped_area']:.2f} % folded, {100 * quality['coverage']:.1f} % of the "
        f"source{'' if result.shared is None else ', as far as it is shared,'} covered",
        *_shared_summary(result),
        f"wrote {folder}",
    ]
    return "\n".join(lines)


def colors_option(mesh: ControlMesh) -> str | None:
    """Option of `cagemap transfer` that bakes the colours of a mesh's vertices or materials; None without colours."""
    if mesh.vertex_colors is not None:
        return "--bake colors"
    return None if mesh.face_colors is None else "--material-colors"


def next_commands(result: MatchResult, request: MatchRequest) -> str:
    """The commands to type next: to mend a doubtful or poor map, else to transfer what the source has."""
    folder, file, source = shlex.quote(str(request.output)), request.source, result.source.control
    report = f"cagemap report {folder}"
    if doubt_message(result.manifest) or _poor_map(result.manifest):
        return f"next: {report}, or cagemap suggest {folder} -o landmarks.json to add landmarks"
    look = "--texture IMG" if source.has_layout else colors_option(source)
    if file.suffix.lower() in GLTF_SUFFIXES:  # FBX and USD files would be converted once more, which takes seconds
        from cagemap.files import inner_texture  # here, since most matches need no reader of textures

        if inner_texture.color_texture(inner_texture.material_document(file, source), source) is not None:
            look = f"--texture {shlex.quote(str(file))}"
    if look is not None:
        unwrap = "" if result.target.control.has_layout else " --unwrap"
        return f"next: cagemap transfer {folder} {look} -o OUT.png{unwrap}, or {report}"
    if result.target.refinement.is_plain:
        return f"next: {report}"
    return f"next: cagemap wrap {folder} -o OUT.obj, or {report}"


def _shared_summary(result: MatchResult) -> list[str]:
    """Line that states the share of each surface's area that both surfaces have; none if that is all area."""
    if result.shared is None:
        return []
    target, source = result.shared_shares
    return [f"  shared: {100 * target:.0f} % of the target's area, {100 * source:.0f} % of the source's"]


def landmark_summary(result: MatchResult) -> str:
    """Text about errors of landmarks and curves, and about landmarks that were left out."""
    left_out = sorted({suspect.pair for suspect in result.suspects})
    errors = 100 * np.delete(result.landmark_errors, left_out)
    parts = []
    if len(errors):
        used = f"{len(errors)} landmarks" if len(errors) > 1 else "1 landmark"
        worst = f" (worst {errors.max():.2f} %)" if len(errors) > 1 else ""
        parts.append(f"{used} missed by {errors.mean():.2f} % of the model's size{worst}")
    if left_out:
        missed = ", ".join(f"{100 * result.landmark_errors[pair]:.0f} %" for pair in left_out)
        parts.append(f"{len(left_out)} left out, which the map misses by {missed}")
    curves = result.curve_misses
    if curves:
        miss, most = 100 * np.array([[curve.mean, curve.worst] for curve in curves]).T
        counted = f"{len(curves)} curves" if len(curves) > 1 else "1 curve"
        parts.append(f"{counted} missed by {miss.mean():.2f} % (at most {most.max():.2f} %)")
    return "; ".join(parts) or "no landmarks"


def warnings(result: MatchResult) -> list[str]:
    """Notes and warnings of a result, and the report's verdict on a poor map."""
    manifest = result.manifest
    return [*manifest["notes"], *landmark_messages(manifest), *manifest["quality"]["warnings"], *_poor_map(manifest)]


def body_warnings(result: MatchResult, names: tuple[str, str] = ("body", "character")) -> list[str]:
    """Warnings about landmarks and the map of two bodies, in words of commands without options of `cagemap match`.

    ``names``: of the target and of the source.
    """
    manifest = result.manifest
    doubt = doubt_message(manifest)
    about_landmarks = [text for text in landmark_messages(manifest) if text != doubt]
    doubts = []
    if doubt:
        findings = describe_signs(manifest["confidence"]["signs"])
        doubts = [_DOUBT.format(f": {findings[0]}" if findings else "")]
    texts = [*about_landmarks, *manifest["quality"]["warnings"], *_poor_map(manifest), *doubts]
    named = [text.replace("the target", f"the {names[0]}").replace("the source", f"the {names[1]}") for text in texts]
    return [text.removesuffix(MASK_ADVICE) for text in named]


def _poor_map(manifest: Mapping[str, Any]) -> list[str]:
    """The report's verdict on a poor map; none of others."""
    verdict, sentence = map_verdict({**manifest, "confidence": None})  # other messages say why it is doubtful
    return [sentence] if verdict == "poor" else []
