"""Start, first map, checked map, landmark to preview, answers, frames, and a report: each in a headless Chromium."""

from __future__ import annotations

import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from tests.fixtures.browser_page import Page, chromium, studio

from benchmarks.processor import children_time
from cagemap.files.landmarks.pairs import write_landmarks
from cagemap.files.meshes.formats import read_mesh
from cagemap.mesh.landmarks import Landmarks
from cagemap.studio.page.app import PageRequest, StudioApp
from cagemap.studio.state import Files
from cagemap.tasks.requests.catalogue import all_options

Rows = list[tuple[str, str]]
# Seconds that a wait may last, which is what is measured.
LONG = 300.0
# Of the browser: as many pixels as a user's page has; tests draw a quarter as many.
FULL_SIZE = "--force-device-scale-factor=1"
# Mean brightness, of 255, above which a half of the canvas shows a model.
DRAWN = 3.0
# Pictures a second while a model turns.
FRAMES = """
const done = arguments[0], {views} = window.studio, begin = performance.now(), first = views.frames;
const turn = () => {
    const at = (performance.now() - begin) / 1000;
    views.frame([Math.sin(at), 0.3, Math.cos(at)]);
    if (at < 4) requestAnimationFrame(turn);
    else done((views.frames - first) / at);
};
turn();
"""
# The same of a report, by a key; how often the page is drawn is how often it is asked for the next picture.
REPORT_FRAMES = """
const done = arguments[0], canvas = document.querySelector('#viewer canvas'), begin = performance.now();
let frames = 0;
const turn = () => {
    canvas.dispatchEvent(new KeyboardEvent('keydown', {key: 'ArrowLeft'}));
    const at = (performance.now() - begin) / 1000;
    if (at < 4) { frames += 1; requestAnimationFrame(turn); } else done(frames / at);
};
turn();
"""
# Pictures of the target that the page has drawn: its own, an unchecked map, the checked one.
DRAWN_TARGETS = "return window.studio.views.sides.target.drawn"


@dataclass(frozen=True)
class Started:
    """A page with both models on screen.

    Attributes
    ----------
    page : Page
    seconds, processor : float
        From the command to the models, and of the processor, the browser's drawing included.
    """

    page: Page
    seconds: float
    processor: float


@contextmanager
def started(files: Files, vertices: int, *, landmarks: bool = True) -> Iterator[Started]:
    """A studio of its own, from the command until both models are on screen; the browser runs already."""
    named = ["--target", files.target, "--source", files.source, "--vertices", vertices, "--result", files.result]
    named += ["--texture", files.texture] if files.texture is not None else []
    named += ["--landmarks", files.landmarks] if landmarks else []
    with chromium(FULL_SIZE) as browser:
        begin, before = time.perf_counter(), children_time()
        with studio(*map(str, named)) as (_, address):
            page = Page(browser, address)
            page.until(lambda: all(shown(page, side) for side in ("target", "source")), "models", LONG)
            yield Started(page, time.perf_counter() - begin, children_time() - before)


def shown(page: Page, side: str) -> bool:
    """Whether a model is drawn in its half."""
    return float(page.look(side).mean()) > DRAWN


def start_rows(files: Files, displayed: int) -> Rows:
    """From the command to the models, with half of the displayed vertices each; frames when the map is there."""
    with started(files, displayed // 2) as begun:
        page, both = begun.page, f"{sum(sizes(begun.page)):,} vertices displayed"
        page.until(lambda: page.revision() == 1, "the first map", LONG)
        return [
            (f"command to both models on screen, {both}", f"{begun.seconds:.1f} s"),
            ("processor time of that, the drawing included", f"{begun.processor:.1f} s"),
            (f"frames a second while turning both, {both}", f"{frames_a_second(page):.0f}"),
        ]


def sizes(page: Page) -> list[int]:
    """Vertices of both models, as the page is told them."""
    return [model["vertices"] for model in page.state("models").values()]


def frames_a_second(page: Page) -> float:
    """Pictures of both models while they turn."""
    return float(page.browser.execute_async_script(FRAMES))


def map_rows(files: Files, vertices: int) -> Rows:
    """The first map without landmarks, and what changes it: `vertices` a model."""
    with started(files, vertices, landmarks=False) as begun:
        page, begin, before = begun.page, time.perf_counter(), children_time()
        page.until(lambda: page.run(DRAWN_TARGETS) > 1, "a first look", LONG)
        look, processor = time.perf_counter() - begin, children_time() - before
        page.until(lambda: page.revision() == 1, "the first map", LONG)
        wait = time.perf_counter() - begin
        rows = [
            (f"command to both models on screen, {vertices:,} vertices each", f"{begun.seconds:.1f} s"),
            ("from there to a first look at the map, without landmarks", f"{look:.1f} s"),
            ("processor time of that, the drawing included", f"{processor:.1f} s"),
            ("from both models to the finished map", f"{wait:.1f} s"),
        ]
        rows += live_rows(page)
    return rows + server_rows(files, vertices)


def live_rows(page: Page) -> Rows:
    """Landmark to preview, progress after a click, answers while computing, frames."""
    rows = [(f"{what}, in the browser, median", f"{1000 * seconds:.0f} ms") for what, seconds in page.waits().items()]
    page.until(lambda: page.state("status")["kind"] != "busy", "the end of the computation", LONG)
    return [*rows, ("frames a second while turning both", f"{frames_a_second(page):.0f}")]


def milliseconds(seconds: list[float]) -> str:
    """Median of some waits."""
    return f"{1000 * statistics.median(seconds):.0f} ms"


def server_rows(files: Files, vertices: int) -> Rows:
    """What of an answer is the studio's own, while it computes: from a message to the state that pages are told."""
    folders = (files.target.parent,)
    app = StudioApp(PageRequest(files, all_options(), folders, port=0, vertices=vertices, open_browser=False))
    try:
        session = app.session
        waited(lambda: session.state.map.revision == 1)
        for number in range(1, 9):
            session.remove(number)
        waited(lambda: session.state.map.revision > 1 and session.state.preview_job is None)
        session.match_again()
        waited(lambda: session.state.preview_job is not None)
        answers = []
        for _ in range(6):
            answers.append(-time.perf_counter())
            session.undo()
            app._state()  # what every page is told
            answers[-1] += time.perf_counter()
        return [("the same, what the studio needs of it without a browser", milliseconds(answers))]
    finally:
        app.close()


def waited(done: Callable[[], bool]) -> None:
    """Wait until something is so."""
    while not done():
        time.sleep(0.001)


def many_rows(files: Files, vertices: int, count: int) -> Rows:
    """A model beside itself with many landmarks: `vertices` each."""
    target = files.target
    control = read_mesh(target)
    chosen = np.unique(np.linspace(0, control.n_vertices - 1, count).astype(np.int64))
    names = tuple(f"v{vertex}" for vertex in chosen)
    path = files.landmarks.with_name("many.json")
    write_landmarks(path, Landmarks(names, chosen, chosen, target.name, target.name))
    alike = Files(target, target, None, path, files.result)
    with started(alike, vertices) as begun:
        page, begin = begun.page, time.perf_counter()
        title = f"{len(chosen)} landmarks, {' and '.join(f'{size:,}' for size in sizes(page))} vertices"
        rows = [(f"{title}: command to both models", f"{begun.seconds:.1f} s")]
        page.until(lambda: page.revision() == 1, "the first map", LONG)
        rows.append((f"{title}: from there to the map", f"{time.perf_counter() - begin:.1f} s"))
        return rows + [(f"{title}: {name}", value) for name, value in live_rows(page)]


def report_rows(files: Files, vertices: int) -> Rows:
    """Size of the report of a pair, and its pictures a second while both models turn."""
    page = files.result.with_suffix(".html")
    words = ["--target", files.target, "--source", files.source, "--vertices", vertices, "-o", files.result]
    for command in (["match", *words], ["report", files.result, "-o", page]):
        subprocess.run([sys.executable, "-m", "cagemap", *map(str, command)], check=True, capture_output=True)
    with chromium(FULL_SIZE) as browser:
        begin = time.perf_counter()
        browser.get(page.as_uri())
        while browser.execute_script("return document.getElementById('viewer').dataset.ready") != "yes":
            time.sleep(0.01)
        opened = time.perf_counter() - begin
        frames = browser.execute_async_script(REPORT_FRAMES)
    return [
        (f"size of the page, {vertices:,} vertices of each model", f"{page.stat().st_size / 1e6:.1f} MB"),
        ("opened from the file", f"{opened:.1f} s"),
        ("frames a second while turning both", f"{frames:.0f}"),
    ]
