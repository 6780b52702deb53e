"""Compiled runs from event to event against the plain tier, which takes every step in Python."""

import time

import numpy as np
import pytest
from compiled_events import ROBOTS, simulations, table

from mbd_ros.api import load_scene, scene_from
from mbd_ros.parts.integrators.adams import Adams
from mbd_ros.parts.integrators.dop853 import Dop853
from mbd_ros.parts.integrators.rk4 import Rk4

ARM = {
    "robot": {"urdf": ROBOTS + "arm7.urdf"},
    "constraints": [
        {"type": "joint_stop", "joint": "joint2", "restitution": 0.3},
        {"type": "joint_stop", "joint": "joint4", "restitution": 0.2},
        *({"type": "dry_friction", "joint": f"joint{i}", "limit": 0.4} for i in range(1, 8)),
    ],
    "initial": {
        "position": {"joint1": 0.3, "joint2": -0.6, "joint3": 0.5, "joint4": 1.2, "joint6": 0.8},
        "velocity": {"joint1": 0.2, "joint2": -0.3, "joint4": 0.4, "joint5": -0.5},
    },
}
BENT = {
    **{"hip_flexion": 0.3, "knee_anterior": -0.8844343782453666},
    **{"knee_tibial": 0.18630267744763485, "knee_posterior": -1.1433094128214365},
}
LEG = "package://mbd_ros/config/scenes/prosthetic_leg.yaml"
LEG_STOPS = [
    {"type": "joint_stop", "joints": ["knee", "ankle"], "restitution": 0.3},
    {"type": "dry_friction", "joint": "ankle", "limit": 0.3},
]


def compared(scene, method, dt, duration, near=1e-9):
    """Runs of both: the same events, states near one another; returns the compiled one."""
    compiled, plain = simulations(scene, method, dt)
    rows, wanted = (table(each.run(scene.initial, duration)) for each in (compiled, plain))
    assert [e.guards for e in compiled.events] == [e.guards for e in plain.events]
    assert len(plain.events) > 1
    times, those = ([e.t for e in each.events] for each in (compiled, plain))
    assert times == pytest.approx(those, abs=1e-10, rel=0)
    for mine, other in zip(compiled.events, plain.events, strict=True):
        assert mine.after.mode == other.after.mode
        assert mine.impulse == pytest.approx(other.impulse, abs=near)
    assert rows.shape == wanted.shape
    assert rows == pytest.approx(wanted, abs=near)
    return compiled


@pytest.mark.parametrize(
    ("method", "dt"),
    [(Rk4(), 1e-3), (Dop853(), 2e-3), (Adams(order=5), 1e-3)],
    ids=["rk4", "dop853", "adams"],
)
def test_an_arm_with_stops_and_friction_has_the_same_events(method, dt):
    compiled = compared(scene_from(ARM), method, dt, 0.5)
    assert compiled.stepper.handed_over < 0.2 * compiled.steps


def test_a_coupled_leg_with_stops_and_a_weak_drive_has_the_same_events():
    """The knee slides as it bends, and the drive of the hip gives way at its limit."""
    drive = {"offset": 0.2, "amplitude": 0.3, "angular_frequency": 6.0, "phase": 0.5}
    weak = {"type": "prescribed_motion", "joint": "hip_flexion", "harmonic": drive, "limit": 12.0}
    scene = load_scene(LEG).with_(
        constraints=[*LEG_STOPS, weak],
        initial={"position": {"hip_flexion": 0.34}, "velocity": {"knee": -3.0}},
    )
    compiled = compared(scene, Rk4(), 1e-3, 0.5)
    assert compiled.stepper.handed_over < compiled.steps


def test_a_loop_with_stops_is_projected_after_every_step():
    scene = load_scene("package://mbd_ros/config/scenes/four_bar_leg.yaml")
    loop = {
        **{"type": "loop_closure", "kind": "point", "directions": "xz"},
        **{"frame_a": "posterior_bar", "point_a": [-0.007, 0.0, -0.051]},
        **{"frame_b": "shank", "point_b": [-0.059, 0.0, 0.002]},
    }
    stop = {"type": "joint_stop", "joint": "ankle", "restitution": 0.4}
    slow = {"type": "dry_friction", "joint": "hip_flexion", "limit": 0.5}
    scene = scene.with_(
        constraints=[loop, {**stop, "lower": -0.02, "upper": 0.02}, slow],
        initial={"position": BENT, "velocity": {"ankle": 20.0}},
    )
    compiled = compared(scene, Rk4(), 1e-3, 0.3)
    y = compiled.stepper.state
    assert np.abs(compiled.system.residual(y.t, y.q)).max() < 1e-11


def test_runs_go_on_from_checkpoints_with_the_same_bits():
    scene = scene_from(ARM)
    compiled, _ = simulations(scene, Rk4(), 1e-3)
    states, kept = [], None
    for i, x in enumerate(compiled.run(scene.initial, 0.3)):
        states.append(x)
        if i == 150:
            kept = compiled.checkpoint()
    events = [e.t for e in compiled.events]
    again = list(compiled.run(kept, 0.3))
    assert table(again).tobytes() == table(states[151:]).tobytes()
    assert [e.t for e in compiled.events] == events


def test_steps_of_a_live_simulation_have_the_same_events():
    scene = scene_from(ARM)
    compiled, plain = simulations(scene, Rk4(), 1e-3)
    ends = []
    for simulation in (compiled, plain):
        y = simulation.start(scene.initial)
        for i in range(1, 301):
            y = simulation.advance(y, None, 1e-3 * i)
        ends.append(np.concatenate(y[1:4]))
    assert [e.guards for e in compiled.events] == [e.guards for e in plain.events]
    assert ends[0] == pytest.approx(ends[1], abs=1e-9)


def test_events_cost_less_than_half_of_the_plain_tier():
    """Measured: 8 times less with 79 events in a second; a shared machine needs some margin."""
    scene = scene_from(ARM)
    both, seconds = simulations(scene, Rk4(), 1e-3), ([], [])
    for _ in range(2):
        for simulation, times in zip(both, seconds, strict=True):
            begin = time.process_time()
            list(simulation.run(scene.initial, 0.5))
            times.append(time.process_time() - begin)
    assert 2.5 * min(seconds[0]) < min(seconds[1])
