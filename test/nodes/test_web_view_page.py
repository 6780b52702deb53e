"""The page of `web_view` in a real browser, with a real simulator behind it."""

import re

import numpy as np
import pytest
from deadline import DEADLINE
from geometry_msgs.msg import WrenchStamped
from nodes.joint_stream import ACTIVE
from places import ROOT
from view_page import EVIL, NOTICE, evil_arm, orange, pixels, red, settled
from web_view import free_port

from msg_adapters.wrench import read_wrench

pytest.importorskip("viser", reason="viser is not installed")


@pytest.fixture
def live(start_node):
    """Starts a simulator and a page of a scene; the simulator's node and the page's address."""

    def start(scene, simulator="", page=""):
        port = free_port()
        for name, values in (("simulator", simulator), ("web_view", f"port: {port}\n    {page}")):
            text = f"/**:\n  ros__parameters:\n    scene: '{scene}'\n    {values}\n"
            node = start_node(text, target=("-m", "mbd_ros.nodes", name))
            node.wait_for(ACTIVE)
        return f"http://127.0.0.1:{port}"

    return start


def tab_of(browser, address):
    """A tab, every address that it asked for, and what popped up."""
    tab, asked, alerts = browser.new_page(viewport={"width": 1280, "height": 800}), [], []
    tab.set_default_timeout(1e3 * DEADLINE)
    tab.on("request", lambda request: asked.append(request.url))
    tab.on("dialog", lambda dialog: (alerts.append(dialog.message), dialog.dismiss()))
    tab.goto(address)
    return tab, asked, alerts


def at_rest(tab):
    """Where the robot is red once two pictures of it are the same."""
    before = red(pixels(tab))

    def is_same(image):
        nonlocal before
        same, before = (red(image) == before).all(), red(image)
        return same

    tab.wait_for_timeout(300)
    return red(settled(tab, is_same))


def test_a_live_robot_moves_is_pulled_and_reset_and_names_are_text(
    browser, live, probe, tmp_path, screenshot
):
    evil_arm(tmp_path)
    pushes = []
    probe.node.create_subscription(WrenchStamped, "/simulator/push", pushes.append, 10)
    address = live(tmp_path / f"{EVIL}.yaml", "pushed_links: ['*']\n    real_time_factor: 0.3")
    tab, asked, alerts = tab_of(browser, address)
    first = settled(tab, lambda image: red(image).sum() > 300)
    assert red(first).sum() > 300
    assert all(re.match(rf"({address}|blob:|data:)", url) for url in asked)
    moved = settled(tab, lambda image: (red(image) & ~red(first)).sum() > 200)
    assert (red(moved) & ~red(first)).sum() > 200
    tab.get_by_role("button", name="pause").click()
    tab.locator("textarea", has_text="pause: paused, t = ").wait_for()
    y, x = np.argwhere(at_rest(tab)).mean(axis=0)
    tab.keyboard.down("Shift")
    tab.mouse.move(x, y + NOTICE)
    tab.mouse.down()
    tab.mouse.move(x, y + NOTICE - 60.0, steps=5)
    probe.spin_until(lambda: pushes and np.abs(read_wrench(pushes[-1]).wrench[:3]).max() > 0.1)
    assert pushes[-1].header.frame_id == "arm"
    tab.mouse.up()
    tab.keyboard.up("Shift")
    probe.spin_until(lambda: not read_wrench(pushes[-1]).wrench.any())
    tab.get_by_role("button", name="reset").click()
    tab.locator("textarea", has_text="reset: at the initial state, t = 0 s").wait_for()
    tab.get_by_role("button", name="run").click()
    tab.locator("textarea", has_text="run: not paused").wait_for()
    tab.locator("input[inputmode=decimal]").first.fill("0.5")
    tab.locator("textarea", has_text="real-time factor 0.5: done").wait_for()
    assert EVIL in tab.locator("body").inner_text()
    assert alerts == [] and tab.locator("img[src=x]").count() == 0
    screenshot(tab, "web_view")
    tab.close()


def test_a_token_opens_the_page_of_a_loop_whose_forces_are_arrows_on_a_telephone_too(
    browser, live, screenshot
):
    scene = ROOT / "config/scenes/four_bar_leg.yaml"
    address = live(scene, "real_time_factor: 0.3", "token: sesame")
    tab, _, _ = tab_of(browser, address)
    tab.get_by_label("token").fill("simsim")
    tab.get_by_role("button").click()
    tab.get_by_text("Wrong token").wait_for()
    assert tab.locator("canvas").count() == 0
    tab.get_by_label("token").fill("sesame")
    tab.get_by_role("button").click()
    tab.wait_for_selector("canvas")
    assert "sesame" not in tab.url
    image = settled(tab, lambda image: orange(image).sum() > 60)
    assert orange(image).sum() > 60
    tab.set_viewport_size({"width": 390, "height": 844})
    image = settled(tab, lambda image: orange(image).sum() > 20)
    assert orange(image).sum() > 20
    screenshot(tab, "web_view_telephone")
    tab.close()
