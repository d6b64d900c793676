"""A studio of its own process and a headless Chromium that looks at it; skips where there is no Chromium."""

from __future__ import annotations

import base64
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cagemap.studio.page.view import FIRST_VIEW

# A loaded machine without a graphics card needs long for what takes a user's machine a moment.
PATIENCE = 60.0
WINDOW = (1280, 720)
# Milliseconds by which viser has sent what was typed: it waits 50, and what is done meanwhile replaces it unsent.
SENT = 120
# Seconds after which a list that has not come is asked for again.
AGAIN = 2.0
# Ends when a text has changed and, where asked for, so many pictures later the other frame has drawn what came with it.
PRESSED = """
const [label, block, pattern, frames, done] = arguments, text = () => document.getElementById(block)?.innerText ?? '';
const before = text(), other = parent.document.getElementById('target').contentWindow;
const changed = () => pattern ? new RegExp(pattern).test(text()) : text() != before;
const begin = performance.now();
[...document.querySelectorAll('button')].find(b => b.innerText.trim() == label).click();
const look = () => {
    const drawn = left => left ? other.requestAnimationFrame(() => drawn(left - 1)) : done(performance.now() - begin);
    if (changed()) drawn(frames);
    else if (performance.now() - begin > 50000) done(-1);
    else setTimeout(look, 4);
};
look();
"""
# What a frame's canvas shows, small; a screenshot would have the software renderer draw the whole page once more.
LOOK = """
const [size, done] = arguments;
requestAnimationFrame(() => {
    const canvas = [...document.querySelectorAll('canvas')].find(canvas => canvas.width);
    const small = document.createElement('canvas');
    small.width = small.height = size;
    const pen = small.getContext('2d');
    if (canvas) pen.drawImage(canvas, 0, 0, size, size);
    done([...pen.getImageData(0, 0, size, size).data].map(v => String.fromCharCode(v)).join(''));
});
"""
LOOK_SIZE = 160
# Where a frame's camera and canvas are, once the model is in it and viser takes clicks; a click means what it is drawn
# as from there. viser sends clicks and drags only when it has heard what is asked for.
STANDS = """
const mutable = window.__viserMutable, camera = mutable?.camera, canvas = mutable?.canvas;
if (!camera || !canvas || !window.__viserPointer?.hasSceneClickFilter()) return null;
if (!Object.keys(mutable.nodeRefFromName).some(name => name.startsWith('/skin/'))) return null;
const box = canvas.getBoundingClientRect();
const [x, y, z] = camera.position.toArray();  // of a scene that viser turns about y
return [-x, y, -z, box.left, box.top, box.width, box.height, window.innerWidth];
"""
# Of the first view's position, in a model's radius.
SAME_VIEW = 1e-3


@contextmanager
def studio(*arguments: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """Process and address of `cagemap studio`."""
    call = [sys.executable, "-c", "from cagemap.cli import main; main()", "studio", "--no-browser", "--port", "0"]
    process = subprocess.Popen([*call, *arguments], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        address = None
        for line in process.stdout:
            if found := re.search(r"http://\S+", line):
                if "studio is at" in line:
                    address = found[0]
                    break
        assert address is not None, "the studio ended before it served"
        yield process, address
    finally:
        process.kill()
        process.wait()


@contextmanager
def chromium() -> Iterator[Any]:
    """A browser without a screen or a graphics card."""
    program, driver = shutil.which("chromium"), shutil.which("chromedriver")
    if program is None or driver is None:
        pytest.skip("no Chromium here: apt-get install chromium chromium-driver")
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = program
    flags = ["--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--use-angle=swiftshader"]
    flags += ["--enable-unsafe-swiftshader", f"--window-size={WINDOW[0]},{WINDOW[1]}"]
    for flag in flags:
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    browser = webdriver.Chrome(service=Service(driver), options=options)
    browser.set_script_timeout(PATIENCE)
    try:
        yield browser
    finally:
        browser.quit()


class Page:
    """What a user does and sees."""

    def __init__(self, browser: Any, address: str) -> None:
        self.browser, self.address = browser, address
        browser.get(address)

    def until(self, done: Callable[[], Any], what: str, patience: float = PATIENCE) -> Any:
        """Wait until something is so."""
        from selenium.common.exceptions import WebDriverException

        end = time.monotonic() + patience
        while time.monotonic() < end:
            try:
                if value := done():
                    return value
            except WebDriverException:  # what was there a moment ago is being drawn anew
                pass
            time.sleep(0.05)
        self.browser.switch_to.default_content()
        pytest.fail(f"{what}: not within {patience:.0f} s; the page says {self.texts()}")

    def into(self, side: str) -> None:
        """Look into one of the two frames."""
        self.browser.switch_to.default_content()
        self.browser.switch_to.frame(side)

    def text(self, name: str) -> str:
        """Text of one of the panels' blocks."""
        self.into("target" if name in ("outputs", "names") else "source")
        return str(self.browser.execute_script("return document.getElementById(arguments[0])?.innerText ?? ''", name))

    def texts(self) -> dict[str, str]:
        """All of them."""
        return {name: self.text(name) for name in ("status", "list", "map", "outputs")}

    def revision(self) -> int:
        """Number of the map that is shown."""
        found = re.match(r"map (\d+)", self.text("map"))
        return int(found[1]) if found else 0

    def landmarks(self) -> int:
        """How many complete landmarks the list names."""
        found = re.match(r"(\d+) landmark", self.text("list"))
        return int(found[1]) if found else 0

    def choose(self, side: str, label: str, value: str, *, exact: bool = True) -> str:
        """Open a dropdown and take an entry, or the first one that holds some text; returns what it shows then."""

        clicked = 0.0

        def entry() -> Any:
            nonlocal clicked
            options = self.browser.find_elements("css selector", "[role=option]")
            shown = [option for option in options if option.is_displayed()]
            if not shown and time.monotonic() > clicked + AGAIN:  # its folder was still opening
                field = self.field(side, label)
                self.browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", field)
                field.click()
                clicked = time.monotonic()
            found = next((one for one in shown if one.text == value or (not exact and value in one.text)), None)
            if found is None:
                return None
            text = str(found.text)
            found.click()  # or it has been drawn anew, and is looked for again
            return text

        self.into(side)
        return str(self.until(entry, f"{value!r} among {label}"))

    def value(self, side: str, label: str) -> str:
        """What a field shows."""
        return str(self.field(side, label).get_attribute("value"))

    def unfold(self, side: str, label: str) -> None:
        """Open a folder that is folded up."""
        self.into(side)
        look = """return [...document.querySelectorAll('*')].find(
            e => [...e.childNodes].some(n => n.nodeType == 3 && n.data.trim() == arguments[0]))"""
        found = self.until(lambda: self.browser.execute_script(look, label), f"a folder {label!r}")
        self.browser.execute_script("arguments[0].scrollIntoView(); arguments[0].click()", found)

    def answers(self) -> list[str]:
        """Buttons of the ways in which the models may agree."""
        self.into("source")
        look = "return [...document.querySelectorAll('button')].map(b => b.innerText.trim())"
        labels = self.browser.execute_script(look)
        return [label for label in labels if re.match(r"\d+ \u00b7", label)]

    def switch(self, side: str, label: str) -> None:
        """Press a checkbox."""
        press = "arguments[0].click(); return true"
        self.until(lambda: self.browser.execute_script(press, self.field(side, label)), f"a box {label!r}")

    def pressed(self, label: str, block: str, pattern: str = "", pictures: int = 0) -> float:
        """Seconds from pressing a button of the right panel to a block's new text, as the page's own clock tells.

        Parameters
        ----------
        label, block : str
            The button, and the block of text.
        pattern : str
            What the text is then; any other than before if not given.
        pictures : int
            That the left frame draws after it.
        """
        self.enabled("source", label)
        waited = self.browser.execute_async_script(PRESSED, label, block, pattern, pictures)
        if waited < 0:
            raise TimeoutError(f"{label}: {self.texts()}")
        return float(waited) / 1000

    def button(self, side: str, label: str) -> None:
        """Press a button; what enables it may come a moment after the text that tells of it."""
        self.enabled(side, label, "found.scrollIntoView(); found.click();")

    def enabled(self, side: str, label: str, then: str = "") -> None:
        """Wait until a button can be pressed; what is done to it then, before it can be drawn anew, is JavaScript."""
        self.into(side)
        look = f"""const found = [...document.querySelectorAll('button')].find(
            b => b.innerText.trim() == arguments[0] && !b.disabled);
            if (found) {{ {then} }} return !!found"""
        self.until(lambda: self.browser.execute_script(look, label), f"a button {label!r}")

    def has_button(self, side: str, label: str) -> bool:
        """Whether there is a button."""
        self.into(side)
        look = "return [...document.querySelectorAll('button')].some(b => b.innerText.trim() == arguments[0])"
        return bool(self.browser.execute_script(look, label))

    def upload(self, side: str, path: Path) -> None:
        """Choose a file for the upload button."""
        self.into(side)
        self.browser.find_element("css selector", "input[type=file]").send_keys(str(path))

    def field(self, side: str, label: str) -> Any:
        """The input beside a label."""
        self.into(side)
        look = """const name = [...document.querySelectorAll('label, p, span, div')].find(
            e => e.children.length == 0 && e.innerText?.trim() == arguments[0]);
            for (let at = name; at; at = at.parentElement) {
                const field = at.querySelector('input'); if (field) return field; }"""
        return self.until(lambda: self.browser.execute_script(look, label), f"a field {label!r}")

    def fill(self, side: str, label: str, value: str) -> None:
        """Type into a field, and leave it: a dropdown beside it opens as it is reached."""
        from selenium.webdriver.common.keys import Keys

        field = self.field(side, label)
        field.send_keys(Keys.CONTROL, "a")
        field.send_keys(value, Keys.TAB)
        script = "document.activeElement.blur(); setTimeout(arguments[1], arguments[0])"
        self.browser.execute_async_script(script, SENT)

    def look(self, side: str) -> np.ndarray:
        """What a frame's canvas shows, (160, 160, 3)."""

        def taken() -> str:
            self.into(side)
            return str(self.browser.execute_async_script(LOOK, LOOK_SIZE))

        pixels = np.frombuffer(self.until(taken, f"the {side}").encode("latin-1"), dtype=np.uint8)
        return pixels.reshape(LOOK_SIZE, LOOK_SIZE, 4)[..., :3].astype(float)

    def framed(self, side: str) -> None:
        """Look into a frame and wait until its model is seen as at first: panels and the view arrive on their own."""
        self.into(side)

        def stands() -> bool:
            before = self.browser.execute_script(STANDS)
            if before is None or np.abs(np.array(before[:3]) - FIRST_VIEW).max() > SAME_VIEW:
                return False
            time.sleep(0.1)
            return bool(before == self.browser.execute_script(STANDS))

        self.until(stands, f"the first view of the {side}")

    def settle(self, side: str) -> np.ndarray:
        """What a frame's canvas shows once two looks in a row are the same."""
        seen = [self.look(side)]

        def still() -> bool:
            time.sleep(0.2)
            seen.append(self.look(side))
            return bool(seen[-1].any() and np.array_equal(seen[-1], seen[-2]))

        self.until(still, f"the {side} to stand still")
        return seen[-1]

    def skin(self, side: str) -> int:
        """Number of what covers a model: another one each time that it is drawn otherwise."""
        self.into(side)
        look = "return Object.keys(window.__viserMutable?.nodeRefFromName ?? {})"
        found = [re.fullmatch(r"/skin/(\d+)", name) for name in self.browser.execute_script(look)]
        return max((int(one[1]) for one in found if one), default=0)

    def has_ball(self, side: str, number: int) -> bool:
        """Whether a landmark's ball is in a frame's scene: before that, a drag there turns the model."""
        self.into(side)
        look = "return !!window.__viserMutable?.nodeRefFromName[arguments[0]]"
        return bool(self.browser.execute_script(look, f"/landmarks/{number}"))

    def click(self, side: str, point: tuple[float, float], *, shift: bool = False) -> None:
        """Click a model; (0, 0) is the middle of the frame's canvas, (1, 1) its upper right corner."""
        from selenium.webdriver import ActionChains
        from selenium.webdriver.common.keys import Keys

        self.framed(side)
        canvas = self.browser.find_element("css selector", "canvas")
        size = canvas.size
        x, y = round(point[0] * size["width"] / 2), round(-point[1] * size["height"] / 2)
        actions = ActionChains(self.browser, duration=10).move_to_element_with_offset(canvas, x, y)
        if shift:
            actions.key_down(Keys.SHIFT).click().key_up(Keys.SHIFT).perform()
        else:
            actions.click().perform()

    def drag(self, side: str, start: tuple[float, float], end: tuple[float, float]) -> None:
        """Press at one point of a model's canvas, move to another, release; points as in `click`."""
        from selenium.webdriver import ActionChains

        self.framed(side)
        canvas = self.browser.find_element("css selector", "canvas")
        half = np.array([canvas.size["width"], -canvas.size["height"]]) / 2
        path = [np.rint(half * point).astype(int).tolist() for point in np.linspace(start, end, 6)]
        actions = ActionChains(self.browser, duration=40).move_to_element_with_offset(canvas, *path[0]).click_and_hold()
        for x, y in path[1:]:
            actions = actions.move_to_element_with_offset(canvas, x, y).pause(0.1)
        actions.release().perform()

    def link(self, name: str) -> bytes:
        """What a link of the outputs leads to, fetched as the page would."""
        self.into("target")
        script = """const done = arguments[1], at = [...document.querySelectorAll('#outputs a')].find(
            a => a.innerText == arguments[0]);
            fetch(at.href).then(r => r.blob()).then(b => { const reader = new FileReader();
                reader.onload = () => done(reader.result.split(',')[1]); reader.readAsDataURL(b); });"""
        return base64.b64decode(self.browser.execute_async_script(script, name))

    def picture(self, side: str) -> np.ndarray:
        """What a frame shows, as pixels."""
        import io

        import imageio.v3 as imageio

        def taken() -> bytes:
            self.browser.switch_to.default_content()
            return bytes(self.browser.find_element("id", side).screenshot_as_png)

        return np.asarray(imageio.imread(io.BytesIO(self.until(taken, f"a picture of the {side}"))))[..., :3]

    def screenshot(self, path: Path) -> None:
        """Keep the whole page."""
        self.browser.switch_to.default_content()
        self.browser.save_screenshot(str(path))
