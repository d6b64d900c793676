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

# A loaded machine without a graphics card needs long for what takes a user's machine a moment.
PATIENCE = 150.0
WINDOW = (1280, 720)


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
    options.set_capability("goog:loggingPrefs", {"performance": "ALL"})
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

    def until(self, done: Callable[[], Any], what: str) -> Any:
        """Wait until something is so."""
        from selenium.common.exceptions import WebDriverException

        end = time.monotonic() + PATIENCE
        while time.monotonic() < end:
            try:
                if value := done():
                    return value
            except WebDriverException:  # what was there a moment ago is being drawn anew
                pass
            time.sleep(0.05)
        self.browser.switch_to.default_content()
        pytest.fail(f"{what}: not within {PATIENCE:.0f} s; the page says {self.texts()}")

    def into(self, side: str) -> None:
        """Look into one of the two frames."""
        self.browser.switch_to.default_content()
        self.browser.switch_to.frame(side)

    def text(self, name: str) -> str:
        """Text of one of the panels' blocks."""
        self.into("target" if name == "outputs" else "source")
        return str(self.browser.execute_script("return document.getElementById(arguments[0])?.innerText ?? ''", name))

    def texts(self) -> dict[str, str]:
        """All of them."""
        return {name: self.text(name) for name in ("status", "list", "map", "outputs")}

    def revision(self) -> int:
        """Number of the map that is shown."""
        found = re.match(r"map (\d+)", self.text("map"))
        return int(found[1]) if found else 0

    def button(self, side: str, label: str) -> None:
        """Press a button."""
        self.into(side)
        press = "return [...document.querySelectorAll('button')].find(b => b.innerText.trim() == arguments[0])"
        found = self.until(lambda: self.browser.execute_script(press, label), f"a button {label!r}")
        self.browser.execute_script("arguments[0].scrollIntoView(); arguments[0].click()", found)

    def field(self, side: str, label: str) -> Any:
        """The input beside a label."""
        self.into(side)
        look = """const name = [...document.querySelectorAll('label, p, span, div')].find(
            e => e.children.length == 0 && e.innerText?.trim() == arguments[0]);
            for (let at = name; at; at = at.parentElement) {
                const field = at.querySelector('input'); if (field) return field; }"""
        return self.until(lambda: self.browser.execute_script(look, label), f"a field {label!r}")

    def fill(self, side: str, label: str, value: str) -> None:
        """Type into a field."""
        from selenium.webdriver.common.keys import Keys

        field = self.field(side, label)
        field.send_keys(Keys.CONTROL, "a")
        field.send_keys(value, Keys.TAB)

    def settle(self, side: str) -> None:
        """Wait until a frame stands still: panels and the first view arrive late on a loaded machine."""
        before = self.picture(side)
        for _ in range(20):
            time.sleep(0.7)
            now = self.picture(side)
            if now.shape == before.shape and np.array_equal(now, before):
                return
            before = now

    def click(self, side: str, point: tuple[float, float]) -> None:
        """Click a model; (0, 0) is the middle of the frame's canvas, (1, 1) its upper right corner."""
        from selenium.webdriver import ActionChains

        self.settle(side)
        self.into(side)
        canvas = self.browser.find_element("css selector", "canvas")
        size = canvas.size
        x, y = round(point[0] * size["width"] / 2), round(-point[1] * size["height"] / 2)
        ActionChains(self.browser, duration=10).move_to_element_with_offset(canvas, x, y).click().perform()

    def drag(self, side: str, start: tuple[float, float], end: tuple[float, float]) -> None:
        """Press at one point of a model's canvas, move to another, release; points as in `click`."""
        from selenium.webdriver import ActionChains

        self.into(side)
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
