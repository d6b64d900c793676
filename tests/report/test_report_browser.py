"""The report in a real browser: opens from a file, turns, says what is shown, and is accessible."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cagemap.report import CarriedData, CarriedItem, write_report

from browser_page import LOOK, LOOK_SIZE, chromium
from example_result import identity_result
from studio_boxes import until

pytestmark = [pytest.mark.slow, pytest.mark.browser]
SERIOUS = {"serious", "critical"}


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    result = identity_result(4)
    trust = np.where(np.asarray(result.target.vertices)[:, 0] > 0.9, 0.0, 1.0)
    result = replace(result, quality=replace(result.quality, trust=trust))
    texture = np.zeros((64, 96, 3), np.uint8)
    texture[..., 2] = 255
    path = tmp_path_factory.mktemp("page") / "report.html"
    mesh, other = result.source.control, result.target.control
    lean = [one.positions @ np.array([[1, 0, 0], [0.5, 1, 0], [0, 0, 1]]) for one in (mesh, other)]
    carried = CarriedData(poses=(CarriedItem("lean", *lean),))
    write_report(path, result, texture=texture, baked=texture, size=(200, 150), carried=carried)
    return path


@pytest.fixture
def browser(browser: Any, page: Path) -> Any:
    """The report as it is opened: no test sees what another one chose."""
    browser.get(page.as_uri())
    until(lambda: browser.execute_script("return document.getElementById('viewer').dataset.ready") == "yes")
    return browser


def look(browser: Any) -> np.ndarray:
    """Both models, (2, h, w, 4) premultiplied 8-bit pixels."""
    text = browser.execute_async_script(LOOK, LOOK_SIZE)
    pixels = np.array([ord(c) for c in text], np.uint8).reshape(LOOK_SIZE, LOOK_SIZE, 4).astype(int)
    return np.stack([pixels[:, : LOOK_SIZE // 2], pixels[:, LOOK_SIZE // 2 :]])


def mean(picture: np.ndarray) -> np.ndarray:
    return picture[picture[..., 3] > 250].mean(0)


def chosen(browser: Any, name: str) -> np.ndarray:
    """Both models in another look."""
    before = look(browser)
    browser.find_element("xpath", f"//label[span='{name}']/input").click()
    until(lambda: np.abs(look(browser) - before).mean() > 3)
    return look(browser)


def test_both_models_wear_the_texture_and_other_looks(browser: Any) -> None:
    until(lambda: all(mean(side)[2] > mean(side)[0] + 60 for side in look(browser)))
    source, target = look(browser)
    assert np.abs(source - target).mean() < 4  # the identity, seen from the same side
    seen = [look(browser)]
    for name in ("Checker", "Places", "Problems"):
        seen.append(chosen(browser, name))
    reds = [mean(side)[0] - mean(side)[2] for side in seen[-1]]
    assert reds[1] > reds[0] + 5  # folded on the target, all reached of the source


def test_keys_drags_and_buttons_turn_both_together(browser: Any) -> None:
    canvas = browser.find_element("css selector", "#viewer canvas")
    first = chosen(browser, "Places")  # in one colour, a ball looks alike from all sides
    canvas.send_keys("\ue012" * 3)  # left
    until(lambda: np.abs(look(browser) - first).mean() > 2)
    from selenium.webdriver import ActionChains

    turned = look(browser)
    assert np.abs(turned[0] - turned[1]).mean() < 15
    ActionChains(browser).drag_and_drop_by_offset(canvas, 50, 30).perform()
    until(lambda: np.abs(look(browser) - turned).mean() > 0.5)
    browser.find_element("xpath", "//button[.='Reset']").click()
    until(lambda: np.abs(look(browser) - first).mean() < 1)


def test_shapes_marks_and_landmarks_are_shown(browser: Any) -> None:
    first = look(browser)
    browser.find_element("xpath", "//select/option[.='lean']").click()
    until(lambda: np.abs(look(browser) - first).mean() > 2)
    browser.find_element("xpath", "//select/option[.='at rest']").click()
    until(lambda: np.abs(look(browser) - first).mean() < 1)
    browser.find_element("name", "landmarks").click()
    until(lambda: np.abs(look(browser) - first).max() > 40)
    browser.find_element("name", "landmarks").click()
    pin = browser.find_element("css selector", ".pin")
    assert "stretched strongly" in pin.get_attribute("aria-label")
    browser.find_element("css selector", "button[data-mark]").click()
    until(lambda: np.abs(look(browser) - first).mean() > 2)  # closer
    browser.find_element("xpath", "//button[.='Reset']").click()


def test_pointing_at_one_model_marks_the_same_place_of_the_other(browser: Any) -> None:
    from selenium.webdriver import ActionChains

    canvas = browser.find_element("css selector", "#viewer canvas")
    width = canvas.size["width"]
    ActionChains(browser).move_to_element_with_offset(canvas, -width // 4, 10).perform()
    rings = browser.find_elements("css selector", ".ring")
    until(lambda: all(ring.is_displayed() for ring in rings))
    boxes = [ring.rect for ring in rings]
    assert abs(boxes[1]["x"] - boxes[0]["x"] - width / 2) < 12
    assert abs(boxes[1]["y"] - boxes[0]["y"]) < 12


def test_nothing_serious_is_found_by_axe(browser: Any) -> None:
    axe_core = pytest.importorskip("axe_core_python", reason="pip install axe-core-python")
    script = next(Path(axe_core.__path__[0]).rglob("axe.min.js")).read_text(encoding="utf-8")
    browser.execute_script(script)
    browser.execute_script("document.querySelectorAll('details').forEach(one => { one.open = true; })")
    for scheme in ("light", "dark"):
        features = [{"name": "prefers-color-scheme", "value": scheme}]
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})
        found = browser.execute_async_script("axe.run(document).then(arguments[0])")["violations"]
        wrong = [(rule["id"], [node["html"] for node in rule["nodes"]]) for rule in found if rule["impact"] in SERIOUS]
        assert wrong == [], scheme
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": []})


def test_a_browser_without_webgl_shows_the_pictures(page: Path) -> None:
    with chromium("--disable-3d-apis") as opened:
        opened.get(page.as_uri())
        stills = opened.find_element("css selector", ".stills img")
        assert stills.is_displayed()
        assert not opened.find_element("id", "viewer").is_displayed()


def test_nothing_is_wrong_in_the_browser(browser: Any) -> None:
    assert [entry["message"] for entry in browser.get_log("browser") if entry["level"] == "SEVERE"] == []
