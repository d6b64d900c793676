"""The pictures of docs/studio.md: ``PYTHONPATH=. python docs/images/studio.py``. Needs Chromium and Selenium."""

from __future__ import annotations

import tempfile
from contextlib import chdir
from pathlib import Path

import numpy as np
from benchmarks.studio.waits import FULL_SIZE
from tests.fixtures.browser_page import Page, chromium, studio

HERE = Path(__file__).resolve().parent
LONG = 300.0  # seconds, for a bake


def main() -> None:
    # Without models the studio opens the built-in pair, in the working folder.
    with (
        tempfile.TemporaryDirectory() as folder,
        chdir(folder),
        chromium(FULL_SIZE) as browser,
        studio() as (_, address),
    ):
        page = Page(browser, address)

        def keep(name: str, width: int, height: int) -> None:
            size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
            browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
            page.run("document.activeElement.blur()")
            page.press("frame")
            page.until(lambda: np.ptp(page.look("target")[..., :3]) > 100, "the models")
            page.screenshot(HERE / f"{name}.png")

        page.until(lambda: "landmarks" in page.text("verdict"), "the map", LONG)
        keep("studio", 1280, 720)
        page.set("other", "checker")
        keep("studio_compare", 1920, 1080)
        page.set("other", "")
        page.press("tab-bake")
        page.press("start")
        page.until(lambda: "everything" in page.text("outputs"), "the bake", LONG)
        keep("studio_finish", 1440, 900)


if __name__ == "__main__":
    main()
