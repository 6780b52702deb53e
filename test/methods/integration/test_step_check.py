"""Warnings of steps that are too long for the motion that they computed."""

import math
from contextlib import suppress

import numpy as np
import pytest

import mbd_ros as mbd
from mbd_ros.api import load_scene
from mbd_ros.applications.report.stability.scenes import mechanism, rods
from mbd_ros.errors import DivergedError, MbdError, SolveError
from mbd_ros.features.simulation import checks
from mbd_ros.features.simulation.checks import step_warnings
from mbd_ros.methods.integration.linear_motion import fastest_rate, linear_motion, longest_step
from mbd_ros.parts.forces.joint_spring import JointSpring
from mbd_ros.scene.describe.check import describe
from mbd_ros.scene.reading.part_entries import build_part
from mbd_ros.scene.runs.simulation import DEFAULT_INTEGRATOR, DEFAULT_STABLE

NEAR_TOGGLE = "package://mbd_ros/config/scenes/benchmark/x02_four_bar_1e-6.yaml"
SPRING = {"type": "joint_spring", "joint": "j0", "stiffness": 1e4}


GOVERNOR = "package://mbd_ros/config/scenes/benchmark/a05_governor.yaml"
STIFF = {"stiffness": 1e6}


def found(scene, entry, dt, duration, word=""):
    """Warnings with a word in them."""
    simulation = scene.simulation(integrator=entry, dt=dt)
    states = []
    with np.errstate(all="ignore"):
        with suppress(MbdError):
            states.extend(simulation.run(scene.initial, duration))
        said = step_warnings(simulation.system, simulation.integrator, dt, states)
        return [text for text in said if word in text]


def swing(damping=0.0):
    start = {"initial": {"position": {"j0": 0.01}}, "forces": [{**SPRING, "damping": damping}]}
    return mechanism(start, *rods((3.0,)))().scene  # inertia 1: rate 100


METHODS = [
    *({"type": name} for name in ("semi_implicit_euler", "rk4", "dopri5", "dop853", "filippov")),
    *({"type": "adams", "order": order} for order in range(2, 9)),
]


@pytest.mark.parametrize("entry", METHODS, ids=lambda entry: " ".join(map(str, entry.values())))
@pytest.mark.parametrize("damping", [0.0, 10.0, 200.0, 2e4])
def test_the_longest_step_is_where_motion_begins_to_grow(entry, damping):
    """Rates of 100 1/s, critically damped at 200; 0.5 and 2e4 1/s with the strongest damper."""
    scene = swing(damping)
    method = build_part("integrators", entry, "test")
    around = linear_motion(scene.system(), scene.initial)
    assert around.rate == pytest.approx(2e4 if damping == 2e4 else 100.0, rel=0.01)
    longest = longest_step(method, around, 1.0)
    assert 0.99 * method.stable <= longest * around.rate < 9.0
    dt, least = 0.99 * longest, 0.99 * method.stable / around.rate
    assert longest_step(method, around, least) == math.inf
    assert found(scene, entry, dt, 20 * dt, "stiff") == []
    assert found(scene, entry, 1.05 * longest, 20 * longest, "stiff")
    assert method.growth(around, dt) < 1.001
    assert swings(scene, entry, dt, 400) < 1.5
    if method.growth(around, 1.1 * longest) > 1.005:  # some grow slowly where nothing damps
        assert swings(scene, entry, 1.1 * longest, 4000) > 100.0


def swings(scene, entry, dt, steps):
    """Largest angle at the end, of that in the beginning; inf if it diverges."""
    simulation = scene.simulation(integrator=entry, dt=dt)
    try:
        states = simulation.run(scene.initial, steps * dt)
        with np.errstate(all="ignore"):
            angles = [abs(x.q[0]) for x in states]
    except DivergedError:
        return math.inf
    return max(angles[-100:]) / max(angles[: steps // 2])


SLIDING = "package://mbd_ros/config/scenes/benchmark/s01_parabola.yaml"


@pytest.mark.parametrize("method", ["rk4", "dopri5", "filippov"])
def test_a_switching_surface_is_no_fast_rate(method):
    """Without a spring nothing is fast there, and with one its own rate counts, not the jump."""
    scene = load_scene(SLIDING)
    slides = [x for x in scene.simulation().run(scene.initial, 1.5) if x.t > 0.8]
    assert slides
    assert found(scene, {"type": method}, 0.01, 1.5, "stiff") == []
    assert max(fastest_rate(scene.system(), x) for x in slides) < 1e-3
    near = scene.holding(forces=(*scene.forces, JointSpring(scene.robot, joint="x", **STIFF)))
    rates = [fastest_rate(near.system(), x) for x in slides]
    assert rates == pytest.approx([1e3] * len(rates), rel=1e-3)
    assert found(near, {"type": method}, 0.01, 0.05, "stiff")


def test_the_shipped_governor_is_not_warned_of_until_its_step_is_too_long():
    scene = load_scene(GOVERNOR)
    around = linear_motion(scene.system(), scene.initial)
    assert around.rate * scene.dt > build_part("integrators", DEFAULT_INTEGRATOR, "").stable
    assert found(scene, None, scene.dt, 0.02, "stiff") == []
    assert found(scene, None, 5e-4, 0.02, "stiff")
    assert "warning" not in "".join(describe(scene))
    assert "need dt < 0.00041 s" in "".join(describe(scene.holding(dt=5e-4)))


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

    monkeypatch.setattr(checks, "linear_motion", failing)
    rates = [linear_motion(simulation.system, scene.initial)]
    told = list(step_warnings(simulation.system, simulation.integrator, 0.05, states))
    assert any("fastest rate 100 1/s" in text for text in told)
    assert not list(step_warnings(simulation.system, simulation.integrator, 0.05, states))


def test_a_near_toggle_is_warned_of():
    said = found(load_scene(NEAR_TOGGLE), {"type": "generalized_alpha"}, 0.01, 1.0)
    assert any("near a toggle at t = 0.71 s" in text for text in said)


@pytest.mark.parametrize("law", [{"factor": 1e9}, {"polynomial": [0.0, 1e9, 1e3]}])
def test_the_rate_of_a_steep_coupling_is_seen_in_every_tier(law):
    """A joint that turns 1e9 times as far as its parent: a step of 1.5e-8 turns it by 15 rad."""
    start = {"velocity": {"j1": 1e-6}}  # 1000 rad/s of the joint that follows
    couplings = {"j2": {"parent": "j1", **law}}
    scene = mechanism({"couplings": couplings, "initial": start}, *rods((1.0, 1.0, 1.0)))().scene
    rates, said = [], []
    for tier in ("plain", "kkt"):
        system = scene.system(solver={"type": tier})
        rates.append(fastest_rate(system, system.reduce(scene.initial)))
        simulation = scene.simulation(solver={"type": tier}, integrator={"type": "rk4"}, dt=4e-3)
        full = [system.expand(system.reduce(scene.initial))] * 2
        said.append(list(step_warnings(simulation.system, simulation.integrator, 4e-3, full)))
    assert rates[0] == pytest.approx(rates[1], rel=0.01) and rates[1] > 500.0
    assert all("stiff: fastest rate" in texts[0] for texts in said)


@pytest.mark.parametrize("method", ["rk4", "moreau_jean"])
def test_an_impact_is_no_doubt_of_the_step(method):
    """A rod hits a stop and bounces: its velocity jumps by 1.5 times the largest one."""
    scene = mbd.scene_from(
        {
            "robot": {"urdf": "package://mbd_ros/config/robots/pendulum.urdf"},
            "constraints": [
                {"type": "joint_stop", "joint": "hinge", "lower": 0.3, "restitution": 0.5}
            ],
            "initial": {"position": {"hinge": 1.0}},
        }
    )
    result = scene.simulate(0.6, dt=5e-3, integrator=method)
    v = result["samples"]["hinge.velocity"]
    assert np.abs(np.diff(v)).max() > 1.4 * np.abs(v).max()
    assert not [text for text in result.metadata["remarks"] if "warning" in text]
