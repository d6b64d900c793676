"""The finish: the package's own commands at full resolution, one after the other, each in its own process."""

from __future__ import annotations

import shlex
import subprocess
import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from cagemap.studio.state import Files, Output

DEFAULT_VERTICES = 200_000


@dataclass(frozen=True)
class FinishOptions:
    """What to make, in the words of the command line.

    Attributes
    ----------
    vertices : int
        Of each surface, about.
    size : int or None
        Texels a side; None: as the source image.
    texture : bool
        Bake the open texture.
    displacement, attribute : Path or None
        Files of the source to carry.
    material_colors : bool
    unwrap : bool
        Lay out a target without UVs.
    report : bool
    """

    vertices: int = DEFAULT_VERTICES
    size: int | None = None
    texture: bool = True
    displacement: Path | None = None
    attribute: Path | None = None
    material_colors: bool = False
    unwrap: bool = False
    report: bool = True


@dataclass(frozen=True)
class Command:
    """One call of the command line.

    Attributes
    ----------
    title : str
    arguments : tuple of str
        After ``cagemap``.
    output : Output
        What it writes.
    """

    title: str
    arguments: tuple[str, ...]
    output: Output

    def __str__(self) -> str:
        return shlex.join(("cagemap", *self.arguments))


def commands(files: Files, options: FinishOptions, *, landmarks: bool) -> tuple[Command, ...]:
    """The commands that finish what is open.

    Parameters
    ----------
    landmarks : bool
        Whether the landmark file holds any.
    """
    result, folder, stem = files.result, files.result.parent, files.target.stem
    match = ["match", "--target", str(files.target), "--source", str(files.source)]
    match += ["--landmarks", str(files.landmarks)] if landmarks else []
    match += ["--vertices", str(options.vertices), "-o", str(result)]
    size = [] if options.size is None else ["--size", str(options.size)]
    bake = [*size, *(["--unwrap"] if options.unwrap else [])]
    made = [Command("match", tuple(match), Output(result, "the map"))]

    def transfer(title: str, kind: list[str], output: Path, more: list[str]) -> None:
        arguments = ("transfer", str(result), *kind, *more, "-o", str(output))
        made.append(Command(title, arguments, Output(output, title)))

    if options.texture and files.texture is not None:
        output = folder / f"{stem}_from_{files.texture.stem}{files.texture.suffix}"
        transfer("texture", ["--texture", str(files.texture)], output, bake)
    if options.displacement is not None:
        output = folder / f"{stem}_from_{options.displacement.stem}{options.displacement.suffix}"
        transfer("displacement", ["--displacement", str(options.displacement)], output, bake)
    if options.material_colors:
        transfer("material colours", ["--material-colors"], folder / f"{stem}_material_colors.png", bake)
    if options.attribute is not None:
        output = folder / f"{stem}_from_{options.attribute.stem}{options.attribute.suffix}"
        transfer("attribute", ["--attribute", str(options.attribute)], output, [])
    if options.report:
        report = folder / f"{result.name}.html"
        made.append(Command("report", ("report", str(result), "-o", str(report)), Output(report, "report")))
    return tuple(made)


class Runner:
    """Runs commands one after the other; one run at a time."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[str] | None = None
        self._ended = threading.Event()

    def run(
        self,
        todo: tuple[Command, ...],
        on_stage: Callable[[int, str], None],
        on_output: Callable[[Output], None],
    ) -> str | None:
        """Run to the end; blocks, so call it from a thread of its own.

        Parameters
        ----------
        on_stage : callable
            Number of the command and what it does now.
        on_output : callable
            Told of everything that was written.

        Returns
        -------
        str or None
            What went wrong, with the command's own words.
        """
        self._ended.clear()
        for number, command in enumerate(todo):
            on_stage(number, command.title)
            words = self._run_one(command, partial(on_stage, number))
            if words is not None:
                return words
            on_output(command.output)
        return None

    def cancel(self) -> None:
        """End the running command; what it has not finished writing leaves no trace."""
        self._ended.set()
        process = self._process
        if process is not None and process.poll() is None:
            process.terminate()

    def _run_one(self, command: Command, on_stage: Callable[[str], None]) -> str | None:
        if self._ended.is_set():
            return "cancelled"
        call = [sys.executable, "-c", "from cagemap.cli import main; main()", "-v", *command.arguments]
        self._process = subprocess.Popen(call, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        lines: list[str] = []
        assert self._process.stdout is not None
        for line in self._process.stdout:
            lines.append(line.rstrip())
            if (stage := stage_of(line)) is not None:
                on_stage(stage)
        code = self._process.wait()
        if self._ended.is_set():
            return "cancelled"
        if code == 0:
            return None
        errors = [line for line in lines if "error" in line] or lines[-3:] or [f"exit code {code}"]
        return f"{command.title}: " + "\n".join(errors)


def stage_of(line: str) -> str | None:
    """The stage that a line of a verbose command announces."""
    head, separator, stage = line.partition("stage:")
    return stage.strip() if separator and head.startswith("cagemap") else None
