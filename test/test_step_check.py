"""Warnings of steps that are too long for the motion that they computed."""

from contextlib import suppress

import numpy as np
import pytest

from mbd_ros import step_check
from mbd_ros.built_scene import DEFAULT_INTEGRATOR, DEFAULT_STABLE
from mbd_ros.core.integration.linearization import fastest_rate
from mbd_ros.errors import MbdError, SolveError
from mbd_ros.part_entries import build_part
from mbd_ros.report.stability.extreme_scenes import mechanism, rods
from mbd_ros.scene import load_scene
from mbd_ros.step_check import step_warnings

NEAR_TOGGLE = "package://mbd_ros/config/scenes/benchmark/x02_four_bar_1e-6.yaml"
SPRING = {"type": "joint_spring", "joint": "j0", "stiffness": 1e4}


def found(scene, entry, dt, duration):
    simulation = scene.simulation(integrator=entry, dt=dt)
    states = []
    with np.errstate(all="ignore"):
        with suppress(MbdError):
            states.extend(simulation.run(scene.initial, duration))
        return list(step_warnings(simulation.system, simulation.integrator, dt, states))


def swing(damping=0.0):
    start = {"initial": {"position": {"j0": 0.01}}, "forces": [{**SPRING, "damping": damping}]}
    return mechanism(start, *rods((3.0,)))().scene  # inertia 1: rate 100


@pytest.mark.parametrize(
    "entry",
    [
        *({"type": name} for name in ("semi_implicit_euler", "rk4", "dopri5", "dop853")),
        *({"type": "adams", "order": order} for order in range(2, 9)),
    ],
    ids=lambda entry: " ".join(map(str, entry.values())),
)
@pytest.mark.parametrize("damping", [0.0, 200.0], ids=["undamped", "critical"])
def test_motion_stays_bounded_up_to_the_step_without_a_warning(entry, damping):
    """The rate times the step is `stable`; beyond it `check` and `simulate` warn."""
    scene = swing(damping)
    method = build_part("integrators", entry, "test")
    rate = fastest_rate(scene.system(), scene.initial)
    assert rate == pytest.approx(100.0, rel=0.01)
    simulation = scene.simulation(integrator=entry, dt=0.99 * method.stable / rate)
    *_, last = simulation.run(scene.initial, 400 * simulation.dt)
    assert abs(last.q[0]) < 0.02
    said = found(scene, entry, 1.05 * method.stable / rate, 1.0)
    assert any("stiff: fastest rate" in text for text in said)


def test_default_integrator_is_as_stable_as_the_scene_module_says():
    assert build_part("integrators", DEFAULT_INTEGRATOR, "test").stable == DEFAULT_STABLE


def test_a_method_that_chooses_its_steps_is_not_warned_of():
    assert found(swing(), {"type": "dopri5", "tolerance": 1e-6}, 0.2, 1.0) == []


def test_an_implicit_step_that_does_not_resolve_the_motion_is_warned_of():
    said = found(swing(), {"type": "gauss_legendre"}, 0.02, 0.4)
    assert any("does not resolve the motion" in text for text in said)
    assert found(swing(), {"type": "gauss_legendre"}, 0.001, 0.2) == []


def test_a_state_without_a_rate_nearby_is_passed_over(monkeypatch):
    scene = swing()
    simulation = scene.simulation(integrator={"type": "rk4"}, dt=0.05)
    states = [scene.initial] * 20

    def failing(system, x):
        if not rates:
            raise SolveError("QP not solved")
        return rates.pop()

    monkeypatch.setattr(step_check, "fastest_rate", failing)
    rates = [100.0]
    told = list(step_warnings(simulation.system, simulation.integrator, 0.05, states))
    assert any("fastest rate 100 1/s" in text for text in told)
    assert not list(step_warnings(simulation.system, simulation.integrator, 0.05, states))


def test_a_near_toggle_is_warned_of():
    said = found(load_scene(NEAR_TOGGLE), {"type": "generalized_alpha"}, 0.01, 1.0)
    assert any("near a toggle at t = 0.71 s" in text for text in said)
