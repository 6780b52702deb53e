"""A stop that a joint passes is named, with joint, time and overshoot, under every integrator."""

import numpy as np
import pytest
from mechanisms import scene_of
from places import ROOT

from mbd_ros.cli import main

PENDULUM = ROOT / "config/robots/pendulum.urdf"
METHODS = {
    "euler": "{type: semi_implicit_euler}",
    "rk4": "{type: rk4}",
    "adams": "{type: adams}",
    "dopri5": "{type: dopri5}",
    "dopri5 adaptive": "{type: dopri5, tolerance: 1e-8}",
    "dop853 adaptive": "{type: dop853, tolerance: 1e-9}",
    "gauss": "{type: gauss_legendre}",
}


def scene_text(method, speed, *, start=0.0, upper=3.0, dt=1e-3):
    return (
        f"robot: {{urdf: {PENDULUM}}}\n"
        f"constraints: [{{type: joint_stop, joint: hinge, upper: {upper}, smoothed: true}}]\n"
        f"initial: {{position: {{hinge: {start}}}, velocity: {{hinge: {speed}}}}}\n"
        f"integrator: {METHODS[method]}\ndt: {dt}\n"
    )


@pytest.mark.parametrize("method", METHODS)
def test_a_stop_that_is_passed_is_named_with_joint_time_and_size(method):
    scene = scene_of(scene_text(method, 1e3))
    simulation = scene.simulation()
    states = list(simulation.run(scene.initial, 0.2))
    beyond = [x.q[0] - 3.0 for x in states]
    (found,) = simulation.overshoots.reportable()
    assert found.joint.name == "hinge" and found.end == 3.0 and max(beyond) > 1.0
    assert found.size == pytest.approx(max(beyond), rel=0.01)
    assert found.t == pytest.approx(states[int(np.argmax(beyond))].t, abs=2e-3)
    assert found.speed == pytest.approx(430.0, rel=0.2)
    (text,) = simulation.passed_stops()
    assert text.startswith("hinge passes its stop at 3 rad by 1.")


@pytest.mark.parametrize("method", METHODS)
def test_a_stop_that_holds_is_not_named(method):
    scene = scene_of(scene_text(method, 30.0))
    simulation = scene.simulation()
    furthest = max(x.q[0] for x in simulation.run(scene.initial, 0.5))
    assert furthest == pytest.approx(3.0, abs=1e-3)
    assert simulation.passed_stops() == []


def test_what_adaptive_steps_pass_between_two_outputs_is_seen():
    scene = scene_of(scene_text("dopri5 adaptive", 1e3, dt=0.5))
    simulation = scene.simulation()
    states = list(simulation.run(scene.initial, 0.5))
    assert [x.q[0] < 3.0 + 1e-3 for x in states] == [True, True]
    assert simulation.overshoots.reportable()[0].size == pytest.approx(1.68, abs=0.02)


def test_a_start_beyond_the_end_is_no_overshoot_but_going_further_is():
    for speed, further in ((0.0, False), (1e3, True)):
        scene = scene_of(scene_text("rk4", speed, start=1.5, upper=1.0))
        simulation = scene.simulation()
        list(simulation.run(scene.initial, 0.1))
        assert bool(simulation.passed_stops()) == further


@pytest.mark.parametrize(("speed", "is_said"), [(1e3, True), (10.0, False)])
def test_the_summary_of_simulate_says_it(tmp_path, capsys, speed, is_said):
    file = tmp_path / "scene.yaml"
    file.write_text(scene_text("dop853 adaptive", speed), encoding="utf-8")
    assert main(["simulate", str(file), "-t", "0.2", "-o", str(tmp_path / "o.csv")]) == 0
    said = "warning: hinge passes its stop at 3 rad by 1.6" in capsys.readouterr().out
    assert said == is_said
