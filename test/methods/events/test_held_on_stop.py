"""A stop whose force a model-based controller takes over, so that it is zero to rounding."""

import numpy as np
import pytest

import mbd_ros as mbd
from mbd_ros.core.state import State

LIES = 3.0  # s, when the leg has swung out onto the stop of its ankle
EXACT = {"integrator": {"type": "rk4"}}


def holding_efforts(free, x):
    """Efforts that hold the joints where they are, as if there were no stop."""
    at = free.coordinates.expand(State(x.t, x.q, x.v))
    independent = free.coordinates.reduce(at)._replace(mode=())

    def accelerations(u):
        return free.coordinates.reduce(at._replace(v=free.evaluate(at, u).a)).v

    bias = accelerations(np.zeros(3))
    columns = np.column_stack([accelerations(unit) - bias for unit in np.eye(3)])
    return np.linalg.solve(columns, -20.0 * independent.v - bias)


@pytest.mark.parametrize("options", [{}, EXACT, {"solver": {"type": "compiled"}}])
def test_a_stop_without_force_neither_chatters_nor_ends_the_run(options):
    leg = mbd.load_scene("controlled_leg")
    free = leg.with_(constraints=None).system()
    simulation = leg.simulation(dt=2e-3, **options)
    x = simulation.advance(simulation.start(leg.initial), np.zeros(3), LIES)
    assert x.mode[-1] == 0  # on the stop
    ankle = x.q[-1]
    before = len(list(simulation.events))
    rng = np.random.default_rng(1)
    for tick in range(1, 101):
        u = holding_efforts(free, x) + 10.0 ** -rng.integers(6, 16) * rng.normal(size=3)
        x = simulation.advance(x, u, LIES + 2e-3 * tick)
    assert abs(x.q[-1] - ankle) < 1e-6
    assert np.abs(x.v).max() < 0.04
    assert len(list(simulation.events)) - before < 300  # a few a command, none that repeats
