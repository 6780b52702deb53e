"""Sampled sliding mode control against the Filippov solution of its discontinuous law.

A pendulum and the prosthetic arm with four controlled joints; the controller takes masses 30 %
too large, and a sinusoidal torque pushes every joint.
"""

import math
from functools import cache
from typing import NamedTuple

import numpy as np
import pytest
from mechanisms import scaled, scene_of
from places import ROOT

from mbd_ros.core.contracts import Load
from mbd_ros.methods.control.contract import EffortBox, Reference
from mbd_ros.methods.events.switching_surfaces import DiscontinuousForce
from mbd_ros.parts.controllers.sliding_mode import SlidingMode

ROBOTS = ROOT / "config/robots"
NOTHING, BANDWIDTH, OUTPUT, END = np.zeros(0), 10.0, 0.01, 1.0
EXACT = {"type": "filippov", "tolerance": 1e-10}


class Case(NamedTuple):
    """A plant, its controlled joints, the gain and the largest disturbance and reference."""

    robot: str
    couplings: str
    joints: tuple[str, ...]
    gain: float
    push: tuple[float, ...]
    sway: tuple[float, ...]


PENDULUM = Case("pendulum", "{}", ("hinge",), 8.0, (0.8,), (0.8,))
ARM = Case(
    "prosthetic_arm",
    "{elbow: {parent: shoulder_flexion, factor: 1.75, offset: 0.175}}",
    ("shoulder_flexion", "shoulder_abduction", "wrist_rotation", "wrist_flexion"),
    25.0,
    (0.5, 0.5, 0.01, 0.01),
    (0.4, 0.2, 0.3, 0.2),
)
CASES = {"pendulum": PENDULUM, "arm": ARM}


class Law:
    """The controller in continuous time, with the model and the reference that it believes in."""

    def __init__(self, case, model, layer):
        self.case = case
        self.joints = model.controlled_joints()
        gains = {"bandwidth": BANDWIDTH, "gain": case.gain, "boundary_layer": layer}
        self.controller = SlidingMode(self.joints, **gains)
        self.box = EffortBox(*(sign * np.full(len(case.joints), np.inf) for sign in (-1, 1)))
        self.q = [joint.q for joint in self.joints.joints]
        self.v = [joint.v for joint in self.joints.joints]

    def reference(self, t):
        sway, w = np.array(self.case.sway), 3.0
        return Reference(
            sway * math.sin(w * t), sway * w * math.cos(w * t), -sway * w * w * math.sin(w * t)
        )

    def control(self, x):
        return self.controller.effort(x, self.reference(x.t), NOTHING, self.box)


class Discontinuous(DiscontinuousForce):
    """tau = equivalent - A^-1 K sign(s), s = v - v_ref + lambda (q - q_ref)."""

    def __init__(self, law):
        self.law, self.surfaces = law, law.joints.names

    def heights(self, k, x):
        ref = self.law.reference(x.t)
        return x.v[self.law.v] - ref.v + BANDWIDTH * (x.q[self.law.q] - ref.q)

    def rates(self, k, x, a):
        ref = self.law.reference(x.t)
        return a[self.law.v] - ref.a + BANDWIDTH * (x.v[self.law.v] - ref.v)

    def blend(self, k, x, signs):
        mobility = self.law.joints.response(x).mobility
        tau = np.zeros(len(x.v))
        reaching = np.linalg.solve(mobility, self.law.case.gain * signs)
        tau[self.law.v] = self.law.control(x).equivalent - reaching
        return tau


class Continuous(Load):
    """The law with a boundary layer."""

    def __init__(self, law):
        self.law = law

    def force(self, k, x, u):
        tau = np.zeros(len(x.v))
        tau[self.law.v] = self.law.control(x).effort
        return tau


class Push(Load):
    """The disturbance."""

    def __init__(self, law):
        self.law = law

    def force(self, k, x, u):
        tau = np.zeros(len(x.v))
        tau[self.law.v] = np.array(self.law.case.push) * math.sin(7.0 * x.t)
        return tau


@pytest.fixture(scope="module")
def plant():
    """The true scene of a case, and the one that the controller believes in."""

    @cache
    def built(name):
        case = CASES[name]
        true = scene_of(
            f"couplings: {case.couplings}\n"
            f"actuators: [{{type: ideal, joints: [{', '.join(case.joints)}]}}]\n",
            ROBOTS / f"{case.robot}.urdf",
        )
        return true, scaled(true, 1.3)

    return built


@pytest.fixture(scope="module")
def limit(plant):
    """Simulation and states of the Filippov solution."""

    @cache
    def solved(name):
        true, model = plant(name)
        law = Law(CASES[name], model, 0.0)
        forces = [Push(law), Discontinuous(law)]
        simulation = true.simulation(integrator=EXACT, dt=OUTPUT, forces=forces)
        return simulation, list(simulation.run(true.initial, END)), law

    return solved


def sampled(plant, name, dt, layer):
    """States every OUTPUT of the plant under the law, read and held every dt."""
    true, model = plant(name)
    law = Law(CASES[name], model, layer)
    simulation = true.simulation(integrator={"type": "rk4"}, dt=dt, forces=[Push(law)])
    expand = simulation.system.expand
    y = simulation.start(true.initial)
    states = [expand(y)]
    for k in range(1, round(END / dt) + 1):
        y = simulation.advance(y, law.control(expand(y)).effort, k * dt)
        if k % round(OUTPUT / dt) == 0:
            states.append(expand(y))
    return states


def layered(plant, name, layer):
    """States of the plant under the continuous law."""
    true, model = plant(name)
    law = Law(CASES[name], model, layer)
    method = {"type": "dopri5", "tolerance": 1e-8}
    simulation = true.simulation(integrator=method, dt=OUTPUT, forces=[Push(law), Continuous(law)])
    return list(simulation.run(true.initial, END))


def deviation(states, exact):
    """Largest of all times in q and in v."""
    pairs = list(zip(states, exact, strict=True))
    return np.array(
        [max(np.abs(getattr(x, f) - getattr(y, f)).max() for x, y in pairs) for f in "qv"]
    )


def orders(steps, errors):
    """Slopes of the errors in q and v against steps, in logarithms."""
    return np.polyfit(np.log(steps), np.log(errors), 1)[0]


@pytest.mark.parametrize("name", CASES)
def test_limit_slides_on_all_surfaces_to_rounding(limit, name):
    """Four at once for the arm; its wrist leaves its surface for a while, since K is too small."""
    simulation, states, law = limit(name)
    found = [event.after.mode for event in simulation.events]
    assert found[-1] == (0,) * len(law.joints)
    heights = [
        Discontinuous(law).heights(None, x) for x in states if x.t > simulation.events[-1].t
    ]
    assert len(heights) > 50 and np.abs(heights).max() <= 1e-15
    assert ((0, 0, 0, 1) in found) == (name == "arm")


@pytest.mark.parametrize("name", CASES)
def test_limit_has_the_tracking_error_of_its_surface(limit, name):
    """On s = 0 the error decays by exp(-lambda t), whatever masses and disturbance are."""
    simulation, states, law = limit(name)
    begin = simulation.events[-1].t
    first, *_, last = (x for x in states if x.t > begin)
    e = [x.q[law.q] - law.reference(x.t).q for x in (first, last)]
    decay = math.exp(-BANDWIDTH * (last.t - first.t))
    assert e[1] == pytest.approx(decay * e[0], abs=1e-9)


@pytest.mark.parametrize(("name", "steps"), [("pendulum", 5), ("arm", 4)])
@pytest.mark.parametrize("layers", [pytest.param(0.0, marks=pytest.mark.soak), 1.0])
def test_sampled_law_converges_to_the_limit(plant, limit, name, steps, layers):
    """dt -> 0 without a boundary layer, and with phi = K dt -> 0.

    Without one the torque chatters, and errors in q of single dt of the arm scatter by a factor
    of two: there its velocities are judged.
    """
    dts = 1e-3 / 2.0 ** np.arange(steps)
    layer = layers * CASES[name].gain
    _, exact, _ = limit(name)
    errors = [deviation(sampled(plant, name, dt, layer * dt), exact) for dt in dts]
    q, v = orders(dts, errors)
    assert v == pytest.approx(1.0, abs=0.15)
    if layers or name == "pendulum":
        assert q == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("name", CASES)
def test_boundary_layer_converges_to_the_limit(plant, limit, name):
    layers = np.array([0.04, 0.02, 0.01])
    errors = [deviation(layered(plant, name, layer), limit(name)[1]) for layer in layers]
    assert orders(layers, errors)[0] == pytest.approx(1.0, abs=0.05)
