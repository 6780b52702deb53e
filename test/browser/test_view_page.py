"""The page in a real browser: Chromium through Playwright, with software rendering."""

import re
import socket
import threading
import time

import numpy as np
import pytest
from deadline import DEADLINE
from PIL import Image
from view_page import EVIL, NOTICE, evil_arm, orange, red, settled

from mbd_ros.scene.reader import load_scene


def free_port():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        return taken.getsockname()[1]


class Served:
    """A page that draws in a thread, as the command does."""

    def __init__(self, scene, duration):
        from mbd_ros.view.page import Page

        self.page = Page(scene, port=free_port())
        self.page.simulate(duration)
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._draw)
        self._thread.start()

    def _draw(self):
        while not self._ends.is_set():
            self.page.tick(time.monotonic())
            time.sleep(0.02)

    def close(self):
        self._ends.set()
        self._thread.join()
        self.page.close()


@pytest.fixture
def serve():
    pytest.importorskip("viser", reason="viser is not installed")
    served = []

    def start(scene, duration):
        served.append(Served(scene, duration))
        return served[-1].page

    yield start
    for one in served:
        one.close()


def opened(browser, page, width=1280, height=800):
    """The page in a tab, and every address that it asked for."""
    tab, asked = browser.new_page(viewport={"width": width, "height": height}), []
    tab.set_default_timeout(1e3 * DEADLINE)
    tab.on("request", lambda request: asked.append(request.url))
    tab.goto(page.address)
    tab.wait_for_selector("canvas")
    tab.get_by_text("remarks", exact=True).first.wait_for()
    return tab, asked


def bluish(image):
    """Where the table is, on a white ground with grey lines."""
    return image[..., 2] - image[..., 0] > 12


def plotted(tab):
    """The pixels of the plot, as text."""
    return tab.locator(".u-wrap canvas").first.evaluate("canvas => canvas.toDataURL()")


def test_a_scene_moves_with_the_slider_and_its_names_are_text(
    browser, serve, screenshot, tmp_path
):
    page = serve(evil_arm(tmp_path), 0.6)
    tab, asked = opened(browser, page)
    alerts = []
    tab.on("dialog", lambda dialog: (alerts.append(dialog.message), dialog.dismiss()))
    first = settled(tab, lambda image: red(image).sum() > 500)
    assert red(first).sum() > 500
    assert all(re.match(rf"({page.address}|blob:|data:)", url) for url in asked)
    y, x = np.argwhere(red(first)).mean(axis=0)
    tab.mouse.click(x, y + NOTICE)  # on the link: its joint is chosen
    tab.locator("textarea", has_text="velocity").first.wait_for()
    tab.locator(".u-label", has_text=EVIL).wait_for()
    curve = plotted(tab)
    tab.locator("input[inputmode=decimal]").first.fill("0.6")
    tab.keyboard.press("Enter")
    moved = settled(tab, lambda image: (red(image) & ~red(first)).sum() > 300)
    assert (red(moved) & ~red(first)).sum() > 300
    assert plotted(tab) != curve
    assert tab.locator(".u-label", has_text=EVIL).count() == 1
    screenshot(tab, "view_1280")
    fields = tab.locator("input").evaluate_all("all => all.map(one => one.value)")
    assert f"{EVIL}.yaml" in fields and EVIL in tab.locator("body").inner_text()
    assert alerts == [] and tab.locator("img[src=x]").count() == 0
    tab.close()


def test_forces_are_arrows_and_a_telephone_shows_the_robot(browser, serve, screenshot):
    page = serve(load_scene("four_legged_table"), 0.05)
    tab, _ = opened(browser, page)
    image = settled(tab, lambda image: orange(image).sum() > 100)
    assert orange(image).sum() > 100
    screenshot(tab, "forces_1280")
    tab.get_by_role("checkbox", name="forces").click()
    image = settled(tab, lambda image: orange(image).sum() == 0)
    assert orange(image).sum() == 0
    tab.close()
    tab, _ = opened(browser, page, 390, 844)
    image = settled(tab, lambda image: bluish(image).sum() > 300)
    assert bluish(image).sum() > 300
    screenshot(tab, "view_390")
    tab.close()


def test_a_camera_falls_with_what_it_follows(browser, serve, tmp_path):
    """A free arm falls 0.8 m, about its size, in 0.4 s, and stays where the camera looks."""
    tab, _ = opened(browser, serve(evil_arm(tmp_path, "floating"), 0.4))
    before = settled(tab, lambda image: red(image).sum() > 500)
    tab.get_by_role("combobox", name="follow").click()
    tab.get_by_role("option", name="base", exact=True).click()
    tab.wait_for_timeout(300)
    tab.locator("input[inputmode=decimal]").first.fill("0.4")
    tab.keyboard.press("Enter")
    after = settled(tab, lambda image: (np.abs(image - before).max(axis=2) > 20).sum() > 500)
    assert (np.abs(after - before).max(axis=2) > 20).sum() > 500  # the ground goes up

    def middle(image):
        return np.argwhere(red(image)).mean(axis=0)

    near = pytest.approx(middle(before), abs=30)
    assert middle(settled(tab, lambda image: red(image).any() and middle(image) == near)) == near
    tab.close()


def test_a_browser_downloads_the_picture_that_it_shows(browser, serve, tmp_path):
    tab, _ = opened(browser, serve(evil_arm(tmp_path), 0.1))
    settled(tab, lambda image: red(image).sum() > 500)
    with tab.expect_download() as waiting:
        tab.get_by_role("button", name="picture").click()
    image = np.asarray(Image.open(waiting.value.path()).convert("RGB")).astype(int)
    assert image.shape == (720, 1280, 3) and red(image).sum() > 500
    tab.close()


@pytest.mark.soak
def test_a_browser_downloads_a_film_of_the_motion(browser, serve, tmp_path):
    av = pytest.importorskip("av", reason="av is not installed")
    tab, _ = opened(browser, serve(evil_arm(tmp_path), 0.6))
    settled(tab, lambda image: red(image).sum() > 500)
    with tab.expect_download() as waiting:
        tab.get_by_role("button", name="film").click()
    with av.open(str(waiting.value.path())) as file:
        images = [frame.to_ndarray(format="rgb24").astype(int) for frame in file.decode(video=0)]
    assert len(images) == 30
    assert (red(images[-1]) & ~red(images[0])).sum() > 300
    tab.close()
