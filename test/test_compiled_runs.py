"""Runs in native code against the plain tier, which integrates the same equations in Python."""

import pickle

import numpy as np
import pytest

from mbd_ros.api import load_scene
from mbd_ros.compiled.runs.compiled_method import CompiledMethod
from mbd_ros.compiled.symbols.untraceable import Untraceable
from mbd_ros.core.simulation.simulation import Simulation
from mbd_ros.integrators.adams import Adams
from mbd_ros.integrators.dop853 import Dop853
from mbd_ros.integrators.dopri5 import Dopri5
from mbd_ros.integrators.gauss_legendre import GaussLegendre
from mbd_ros.integrators.rk4 import Rk4
from mbd_ros.integrators.semi_implicit_euler import SemiImplicitEuler
from mbd_ros.stabilization.projection import Projection

SWING = "package://mbd_ros/config/scenes/benchmark/arm7_swing.yaml"
METHODS = {
    "rk4": (Rk4(), 1e-3),
    "dopri5": (Dopri5(), 1e-3),
    "dop853": (Dop853(), 2e-3),
    "adaptive dopri5": (Dopri5(tolerance=1e-8), 1e-3),
    "adaptive dop853": (Dop853(tolerance=1e-9), 1e-3),
    "adams 2": (Adams(order=2), 1e-3),
    "adams 5": (Adams(order=5), 1e-3),
    "adams 8": (Adams(order=8), 5e-4),
    "semi_implicit_euler": (SemiImplicitEuler(), 1e-3),
}
DURATION = 0.2


def simulations(scene, method, dt):
    """The compiled one and the plain one."""
    fix = Projection()
    both = (CompiledMethod(method, fix), method)
    return [Simulation(scene.system(), each, fix, dt) for each in both]


def bits(states):
    return [(x.t, *(each.tobytes() for each in x[1:4])) for x in states]


def off(states, others):
    """Largest difference between two runs, time included."""
    rows = [
        np.array([np.concatenate(([x.t], *x[1:4])) for x in each]) for each in (states, others)
    ]
    assert rows[0].shape == rows[1].shape
    return np.abs(rows[0] - rows[1]).max()


@pytest.mark.parametrize("name", METHODS)
def test_samples_are_those_of_the_plain_tier(name):
    """Rounding, which a swing of 43 rad/s multiplies by some hundred in this time."""
    scene = load_scene(SWING)
    compiled, plain = simulations(scene, *METHODS[name])
    states, others = (list(each.run(scene.initial, DURATION)) for each in (compiled, plain))
    assert off(states, others) < 1e-11
    assert compiled.steps == plain.steps
    rows = compiled.sampled(scene.initial, DURATION)
    assert bits(states) == [(r[0], r[1:8].tobytes(), r[8:].tobytes(), b"") for r in rows]


@pytest.mark.parametrize("name", ["rk4", "adaptive dop853", "adams 8"])
def test_ticks_are_those_of_the_plain_tier(name):
    """Steps end at every tick, as those of a live simulation do."""
    scene = load_scene(SWING)
    both = simulations(scene, *METHODS[name])
    ends = []
    for simulation in both:
        y = simulation.start(scene.initial)
        for tick in range(1, 101):
            y = simulation.advance(y, None, tick * 2e-3)
        ends.append(y)
    assert off(*([end] for end in ends)) < 1e-11


@pytest.mark.parametrize("name", ["rk4", "adaptive dop853", "adams 8"])
def test_a_checkpoint_continues_with_the_same_bits(name):
    """Inside a block too, and in another simulation."""
    scene = load_scene(SWING)
    compiled, _ = simulations(scene, *METHODS[name])
    states = compiled.run(scene.initial, DURATION)
    for _ in range(77):
        next(states)
    kept = pickle.dumps(compiled.checkpoint())
    rest = bits(states)
    other, _ = simulations(scene, *METHODS[name])
    assert bits(other.run(pickle.loads(kept), DURATION)) == rest


def test_what_has_no_native_steps_is_named():
    scene = load_scene(SWING)
    with pytest.raises(Untraceable, match="gauss_legendre"):
        CompiledMethod(GaussLegendre(), Projection()).prepare(scene.system(), 1e-3)
