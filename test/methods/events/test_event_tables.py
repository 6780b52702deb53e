"""Events in results, files and live simulations: a mass that falls onto a stop, in closed form."""

import math
import re

import numpy as np
import pytest
from row_systems import joint, link

import mbd_ros as mbd
from mbd_ros.cli import main
from mbd_ros.files.table import read_result
from mbd_ros.methods.simulation.live_simulation import LiveSimulation
from mbd_ros.methods.simulation.safe_command import CommandWatch

G, HEIGHT, MASS, E = 9.81, 0.5, 2.0, 0.6
FALL = math.sqrt(2.0 * HEIGHT / G)
SPEED = G * FALL
HOPS = [2.0 * SPEED * E**k / G for k in (1, 2, 3)]
TIMES = FALL + np.cumsum([0.0, *HOPS])
ELEMENTS = (
    link("world"),
    link("mass", MASS),
    joint("slide", "prismatic", "world", "mass", "0 0 1"),
)
URDF = f"<robot name='r'>{''.join(ELEMENTS)}</robot>"
STOP = {"type": "joint_stop", "joint": "slide", "lower": 0.0, "restitution": E}


def falling(**more):
    sections = {"constraints": [STOP], "initial": {"position": {"slide": HEIGHT}}, **more}
    return mbd.scene_from(sections, urdf=URDF)


@pytest.fixture
def file(tmp_path):
    """The scene in a file."""
    (tmp_path / "mass.urdf").write_text(URDF, encoding="utf-8")
    scene = tmp_path / "fall.yaml"
    scene.write_text(
        "robot: {urdf: mass.urdf}\ninitial: {position: {slide: 0.5}}\nconstraints:\n"
        "- {type: joint_stop, joint: slide, lower: 0.0, restitution: 0.6}\n",
        encoding="utf-8",
    )
    return scene


@pytest.mark.parametrize(
    "method",
    [
        *({"type": kind} for kind in ("rk4", "dopri5", "dop853", "gauss_legendre", "adams")),
        {"type": "dopri5", "tolerance": 1e-9},
    ],
    ids=lambda method: "-".join(map(str, method.values())),
)
def test_the_table_shows_both_sides_of_every_impact(method):
    result = falling().simulate(1.0, integrator=method, dt=0.01)
    events = result["events"]
    assert events.column("time").unit == "s"
    assert events["time"] == pytest.approx(TIMES[:3], abs=1e-9)
    impulse = events.column("slide_joint_stop.force.impulse")
    speeds = SPEED * E ** np.arange(3)
    assert impulse.unit == "N·s"
    assert impulse.values == pytest.approx(MASS * (1.0 + E) * speeds, abs=1e-8)
    assert events["slide.velocity.before"] == pytest.approx(-speeds, abs=1e-8)
    assert events["slide.velocity.after"] == pytest.approx(E * speeds, abs=1e-8)
    assert events["slide.position.before"] == pytest.approx(np.zeros(3), abs=1e-9)
    assert events["energy.before"] == pytest.approx(0.5 * MASS * speeds**2, abs=1e-8)
    assert events["energy.after"] == pytest.approx(0.5 * MASS * (E * speeds) ** 2, abs=1e-8)
    assert events["slide_joint_stop.force.event"].tolist() == [1.0, 1.0, 1.0]
    assert events["slide_joint_stop.force.mode.after"].tolist() == [1.0, 1.0, 1.0]  # open


def test_samples_between_impacts_follow_the_parabolas():
    samples = falling().simulate(1.1, integrator="rk4", dt=0.01)["samples"]
    expected = []
    for t in samples["time"]:
        k = int(np.searchsorted(TIMES, t))
        if k == 0:
            expected.append(HEIGHT - 0.5 * G * t * t)
        else:
            since = t - TIMES[k - 1]
            expected.append(SPEED * E**k * since - 0.5 * G * since * since)
    assert samples["slide.position"] == pytest.approx(np.array(expected), abs=1e-9)


def test_a_scene_without_events_has_no_such_table():
    assert "events" not in falling(constraints=[]).simulate(0.1)
    smoothed = {**STOP, "restitution": 0.0, "time_constant": 0.01}
    assert "events" not in falling(constraints=[smoothed]).simulate(0.1)
    none, some = (falling().simulate(t)["events"] for t in (0.1, 0.5))
    assert none.rows == 0
    assert list(none) == list(some)


@pytest.mark.parametrize("suffix", [".csv", ".npz", ".mcap"])
def test_simulate_writes_the_events(capsys, file, tmp_path, suffix):
    out, events = tmp_path / f"out{suffix}", tmp_path / f"events{suffix}"
    words = ["simulate", str(file), "-t", "0.9", "-o", str(out), "--events", str(events)]
    assert main(words) == 0
    said = capsys.readouterr().out
    assert said.endswith(f"901 states -> {out}\n2 events -> {events}\n")
    table = read_result(events)["samples" if suffix == ".csv" else "events"]
    whole = mbd.load_scene(file).simulate(0.9)
    assert table["time"] == pytest.approx(TIMES[:2], abs=1e-9)
    assert list(table) == list(whole["events"])
    if suffix != ".csv":
        assert table == read_result(out)["events"] == whole["events"]


@pytest.mark.parametrize(
    ("events", "reason"),
    [
        ("out.csv", "--events .*out.csv: is the file of -o"),
        ("no/events.csv", "directory .*no does not exist"),
    ],
)
def test_places_of_events_that_cannot_be(capsys, file, tmp_path, events, reason):
    out = tmp_path / "out.csv"
    words = ["simulate", str(file), "-t", "0.1", "-o", str(out), "--events"]
    assert main([*words, str(tmp_path / events)]) != 0
    assert re.search(reason, capsys.readouterr().err)
    assert not out.exists()


def test_events_of_a_scene_that_has_none_are_refused(capsys, tmp_path):
    out, events = tmp_path / "out.csv", tmp_path / "events.csv"
    words = ["simulate", "arm7", "-t", "0.1", "-o", str(out), "--events", str(events)]
    assert main(words) != 0
    assert " has no events, such as impacts" in capsys.readouterr().err
    assert not out.exists() and not events.exists()


def live(scene, tick):
    watch = CommandWatch(0.1, 0.1)
    return LiveSimulation(scene.simulation, scene.initial, tick, watch, scene.safe)


@pytest.mark.parametrize("method", ["rk4", "adams", "gauss_legendre"])
def test_a_tick_has_its_events_and_the_bits_of_the_run(method):
    scene = falling(integrator={"type": method}, dt=0.01)
    simulation, found = live(scene, 0.02), []
    run = scene.simulate(1.0)
    for k in range(50):
        now = simulation.tick()
        found += simulation.events
        row = 2 * (k + 1)
        assert now.position[0] == run["samples"]["slide.position"][row]
        assert now.velocity[0] == run["samples"]["slide.velocity"][row]
    assert [event.t for event in found] == run["events"]["time"].tolist()
    simulation.reset()
    assert simulation.events == ()
