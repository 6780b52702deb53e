"""Pages that hold their motion: opened from a file, in Chromium without a network."""

import io
import time

import numpy as np
import pytest
from deadline import DEADLINE
from PIL import Image

from mbd_ros import load_scene
from mbd_ros.applications.demo.page import Content, moving_result, page
from mbd_ros.cli import main

EVIL = "<img src=x onerror=alert(1)>"
MOST = 6_000_000  # bytes of a page
COUNT_IMAGES = """
window.images = 0; let drew = false;
for (const name of ["drawElements", "drawElementsInstanced"]) {
  const draw = WebGL2RenderingContext.prototype[name];
  WebGL2RenderingContext.prototype[name] = function (...words) {
    drew = true; return draw.apply(this, words); };
}
const look = () => { if (drew) window.images += 1; drew = false; requestAnimationFrame(look); };
requestAnimationFrame(look);
"""


@pytest.fixture
def offline(browser):
    """Opens a file without a network: its tab, all it asked for, and what it threw."""
    pytest.importorskip("viser", reason="viser is not installed")
    contexts = []

    def start(file, width, height):
        contexts.append(
            browser.new_context(offline=True, viewport={"width": width, "height": height})
        )
        contexts[-1].set_default_timeout(1e3 * DEADLINE)
        tab, asked, thrown = contexts[-1].new_page(), [], []
        tab.add_init_script(COUNT_IMAGES)
        tab.on("request", lambda request: asked.append(request.url))
        tab.on("pageerror", lambda error: thrown.append(str(error)))
        tab.on("dialog", lambda dialog: (thrown.append(dialog.message), dialog.dismiss()))
        tab.goto(f"file://{file}")
        return tab, asked, thrown

    yield start
    for context in contexts:
        context.close()


def image_of(frame):
    """What its canvas shows."""
    picture = Image.open(io.BytesIO(frame.locator("canvas").first.screenshot())).convert("RGB")
    return np.asarray(picture).astype(int)


def drawn(tab, frame, least):
    """Waits for so many images."""
    end = time.monotonic() + DEADLINE
    while frame.evaluate("window.images") < least:
        assert time.monotonic() < end, "nothing is drawn"
        tab.wait_for_timeout(100)


def differing(one, other):
    return int((np.abs(one - other).max(axis=-1) > 40).sum())


def shown_at(tab, frame, share):
    """The canvas after a click on the slider, there along it."""
    slider = frame.locator(".mantine-Slider-root").first
    box = slider.bounding_box()
    before = frame.evaluate("window.images")
    slider.click(position={"x": share * box["width"], "y": box["height"] / 2})
    tab.wait_for_timeout(400)
    drawn(tab, frame, before + 3)  # a busy machine has drawn none by then
    return image_of(frame)


def demo_page(tmp_path):
    scene = load_scene("controlled_arm")
    moving = moving_result(scene, scene.simulate(1.0), EVIL, 2.0)
    content = Content(EVIL, "", [], [], (moving, EVIL), {}, [], {})
    (tmp_path / "demo.html").write_text(page(content), encoding="utf-8")
    return tmp_path / "demo.html"


@pytest.mark.parametrize(("width", "height"), [(1280, 800), (390, 844)])
def test_the_page_of_a_demo_moves_without_a_network(
    offline, screenshot, tmp_path, record_testsuite_property, width, height
):
    file = demo_page(tmp_path)
    assert file.stat().st_size < MOST
    tab, asked, thrown = offline(file, width, height)
    frame = tab.frames[-1]
    frame.wait_for_selector("canvas")
    drawn(tab, frame, 10)
    begin, before = frame.evaluate("[performance.now(), window.images]")
    drawn(tab, frame, before + 10)  # how fast depends on what else this machine does
    end, now = frame.evaluate("[performance.now(), window.images]")
    rate = 1000.0 * (now - before) / (end - begin)
    record_testsuite_property(f"images a second at {width} px", round(rate, 1))
    first, last = shown_at(tab, frame, 0.02), shown_at(tab, frame, 0.95)
    assert differing(first, last) > 200
    screenshot(tab, f"demo_{width}")
    assert thrown == [] and tab.locator("img").count() == 0
    assert [url for url in asked if not url.startswith(("file:", "data:", "blob:"))] == []
    assert tab.evaluate("document.documentElement.scrollWidth <= innerWidth")


def test_view_writes_a_page_for_itself(offline, screenshot, tmp_path, capsys):
    file = tmp_path / "leg.html"
    assert main(["view", "four_bar_leg", "-t", "0.2", "-o", str(file)]) == 0
    assert f"{file}: 0." in capsys.readouterr().out
    tab, asked, thrown = offline(file, 1280, 800)
    drawn(tab, tab, 3)
    assert tab.title() == "four_bar_leg.yaml" and thrown == []
    assert [url for url in asked if not url.startswith(("file:", "data:", "blob:"))] == []
    screenshot(tab, "written_1280")
