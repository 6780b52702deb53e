"""What a digital twin watches: singular configurations, residuals, faults."""

import math

import numpy as np
import pytest

from mbd_ros import load_scene
from mbd_ros.cli import main
from mbd_ros.features.estimation.faults import Cusum
from mbd_ros.features.estimation.state_reconstruction import Determinations
from mbd_ros.files.table import read_result


@pytest.mark.parametrize("speed", [2.0, 6.28])
def test_dead_centres_of_a_press_are_foreseen(speed):
    """The rocker is measured: it turns round where crank and coupler lie on one line."""
    scene = load_scene("press")
    start = {**scene.entries["initial"], "velocity": {"crank": speed}}
    scene = scene.with_(initial=start, forces=None, gravity=[0.0, 0.0, 0.0])
    simulation = scene.simulation()
    system, step = simulation.system, 0.004
    ahead = Determinations(system, ["rocker"], 0.05)
    y = simulation.start(scene.initial, np.zeros(1))
    found, rates, lines = [], [], []
    for k in range(1, round(4.0 / speed / step)):
        y = simulation.advance(y, np.zeros(1), k * step)
        a = system.integrated(system.evaluate(system.expand(y), np.zeros(1)).a)
        found.append(ahead.at(y, a))
        rates.append(y.v[2])
        lines.append(math.sin(y.q[1]))
    turns = [k for k in range(1, len(rates)) if rates[k] * rates[k - 1] < 0.0]
    assert turns and lines[turns[0]] * lines[turns[0] - 1] < 0.0
    exact = step * (turns[0] - 1 + rates[turns[0] - 1] / (rates[turns[0] - 1] - rates[turns[0]]))
    for k, one in enumerate(found[: turns[0]]):
        left = exact - k * step
        if left < 0.048:  # an amplification of 100 counts, a little before
            assert left - 0.015 * 2.0 / speed - 1e-3 <= one.time <= left + 2.5e-3
        elif left > 0.053 + 0.015 * 2.0 / speed:
            assert one.time == math.inf
    assert found[turns[0] - 1].amplification > 10.0 * found[0].amplification


def test_a_crank_determines_its_press_everywhere():
    scene = load_scene("press")
    system = scene.system()
    simulation = scene.simulation()
    ahead, y = Determinations(system, ["crank"]), simulation.start(scene.initial, np.zeros(1))
    for k in range(1, 100):
        y = simulation.advance(y, np.zeros(1), 0.01 * k)
        one = ahead.at(y, np.zeros(3))
        assert one.time == math.inf and one.amplification < 3.0


def test_open_chains_have_nothing_to_ask():
    system = load_scene("arm7").system()
    assert not Determinations(system, ["joint1"]).is_needed


def test_alarms_come_with_shifts_and_end_with_them():
    cusum, rng = Cusum(("a", "b")), np.random.default_rng(0)
    for _ in range(20_000):
        cusum.add(rng.standard_normal(2))
        assert not cusum.alarms()
    shift = np.array((0.0, -3.0))
    for _ in range(40):
        cusum.add(rng.standard_normal(2) + shift)
    assert cusum.alarms() == {"b": "too small for long"}
    for _ in range(100):
        cusum.add(rng.standard_normal(2))
    assert not cusum.alarms()
    cusum.add(np.array([np.nan, 12.0]))
    assert cusum.alarms() == {"b": "off by 12 deviations"}


@pytest.mark.soak
def test_the_demo_names_the_faults_that_are_planted(tmp_path, capsys):
    assert main(["demo", "twin", "-o", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().out
    assert "friction doubles" in said and "spring loses a fifth" in said
    html = (tmp_path / "out/demo.html").read_text(encoding="utf-8")
    assert "All checks are met." in html
    assert read_result(tmp_path / "out/samples.csv")["samples"].rows == 800
    assert main(["demo", "twin", "--time", "3", "-o", str(tmp_path / "other")]) == 2
