"""The page of a robot at 500 Hz for ten minutes, while browsers come and go."""

import random
import threading
import time
from contextlib import suppress
from pathlib import Path

import pytest
from nodes.joint_stream import ACTIVE
from places import ROOT
from web_view import free_port

pytest.importorskip("viser", reason="viser is not installed")

from nodes.page_client import PageClient
from websockets.exceptions import ConnectionClosed

pytestmark = [pytest.mark.soak, pytest.mark.alone]
RATE, SECONDS, SETTLED = 500.0, 600.0, 60.0  # Hz, s, and s until memory is measured
SCENE = f"""robot: {{urdf: {ROOT}/config/robots/arm7.urdf}}
initial: {{position: {{joint2: 0.8, joint4: 0.5}}}}
"""  # nothing brakes it: it swings for ever


def memory(node):
    """Resident memory [MB]."""
    return int(Path(f"/proc/{node.pid}/statm").read_text().split()[1]) * 4096 / 1e6


def read_on(address, ended, lives):
    """A browser, opened again and again for so long [s] as `lives()` says."""
    while not ended.is_set():
        with suppress(ConnectionClosed, OSError, TimeoutError):
            page = PageClient(address)
            page.hear(min(lives(), 5.0 * SECONDS))
            page.close()


def simulated_time(probe):
    """Simulated time of the next report [s], and when it came."""
    health = probe.wait_health(lambda h: h.name == "/simulator")
    return float(health.values["simulated time"]), time.monotonic()


def test_ten_minutes_cost_a_quarter_of_a_core_and_no_memory(
    start_node, probe, tmp_path, record_property
):
    scene, port, nodes = tmp_path / "swinging.yaml", free_port(), {}
    scene.write_text(SCENE)
    for name, more in (("simulator", f"rate: {RATE}"), ("web_view", f"port: {port}")):
        text = f"/**:\n  ros__parameters:\n    scene: {scene}\n    {more}\n"
        nodes[name] = start_node(text, target=("-m", "mbd_ros.nodes", name))
        nodes[name].wait_for(ACTIVE)
    view, simulator = nodes["web_view"], nodes["simulator"]
    address, ended, chance = f"http://127.0.0.1:{port}", threading.Event(), random.Random(5)
    probe.spin_for(5.0)
    alone, begun = simulator.cpu_seconds(), simulated_time(probe)
    probe.spin_for(30.0)
    without = rates(probe, simulator, alone, begun)
    lives = [lambda: SECONDS] + [lambda: chance.uniform(0.5, 60.0)] * 10
    browsers = [
        threading.Thread(target=read_on, args=(address, ended, one), daemon=True) for one in lives
    ]
    browsers[0].start()
    probe.spin_for(10.0)
    cpu, began = view.cpu_seconds(), time.monotonic()
    probe.spin_for(60.0)
    one = (view.cpu_seconds() - cpu) / (time.monotonic() - began)
    for browser in browsers[1:]:
        browser.start()
    probe.spin_for(SETTLED)
    before, cpu, begun = memory(view), simulator.cpu_seconds(), simulated_time(probe)
    probe.spin_for(SECONDS - SETTLED)
    beside, growth = rates(probe, simulator, cpu, begun), memory(view) - before
    ended.set()
    record_property("core", one)
    record_property("growth", growth)
    record_property("simulator", (without, beside))
    assert one <= 0.25
    assert growth <= 5.0
    assert beside[0] >= 0.99 * without[0]
    assert view.stop() == 0


def rates(probe, simulator, cpu, begun):
    """Simulated seconds a second since then, and CPU seconds of the simulator for each."""
    now = simulated_time(probe)
    passed = now[0] - begun[0]
    return passed / (now[1] - begun[1]), (simulator.cpu_seconds() - cpu) / passed
