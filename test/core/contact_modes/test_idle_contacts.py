"""Contacts that nobody reaches cost almost nothing, and are not missed when somebody does."""

import numpy as np
import pytest
from idle_stops import START, calls, stepping
from mechanisms import link, scene_of, urdf

import mbd_ros as mbd
from mbd_ros.core.state import State

FEATURES = [[0.0, 0.0, 0.1], [0.1, 0.0, 0.1], [0.0, 0.1, 0.1]]


def over_ground(method, height, dt=1e-4):
    """The 7-joint arm, with points at its flange over a plane that deep."""
    plane = {"half_space": [0.0, 0.0, 1.0], "xyz": [0.0, 0.0, -height]}
    between = [{"frame": "flange", "points": FEATURES}, plane]
    contact = {"type": "rigid", "between": between, "friction": 0.4, "restitution": 0.3}
    contacts = [] if height is None else [contact]
    scene = mbd.load_scene("arm7").with_(
        contacts=contacts, integrator={"type": method}, dt=dt, constraints=[]
    )
    simulation = scene.simulation()
    return simulation, simulation.start(State(0.0, *START))


@pytest.mark.parametrize("method", ["rk4", "adams", "dop853"])
def test_a_contact_far_away_costs_a_few_calls_a_step(method):
    """Of the time, 1.05 to 1.26 were measured at 20 m, and 1.05 to 1.15 at 200 m."""
    free = mbd.load_scene("arm7").with_(constraints=[], integrator={"type": method}, dt=1e-4)
    simulation = free.simulation()
    step = stepping(simulation, simulation.start(State(0.0, *START)))
    assert calls(stepping(*over_ground(method, 20.0))) <= calls(step) + 6


@pytest.mark.parametrize("seed", range(3))
def test_no_contact_is_missed_because_nobody_looked(seed):
    """Events with and without the bound of the speed of gaps are the same to the last bit."""
    times = []
    for looks in (True, False):
        simulation, x = over_ground("rk4", 0.25 + 0.1 * seed, dt=2e-3)
        simulation.stepper._has_clearance = looks
        for _ in range(400):
            x = simulation.stepper.step(x, None)
        times.append([event.t for event in simulation.events])
    assert times[0] == times[1] and times[0]


def test_bodies_far_from_the_origin_and_on_slides_are_not_missed_either():
    """A free body that spins and falls 100 m away from the origin, at the time of a parabola."""
    body = urdf(link("ball", 1.0))
    scene = scene_of(
        "robot: {base: floating}\n"
        "contacts: [{type: rigid, between: [{frame: ball, sphere: 0.05}, {half_space: [0, 0, 1], "
        "xyz: [100, 0, 3]}], friction: 0.0}]\ndt: 0.001\nintegrator: {type: rk4}\n",
        body,
    )
    simulation = scene.simulation()
    q = np.array((100.0, 50.0, 53.05, 0.0, 0.0, 0.0, 1.0))
    v = np.array((0.0, 0.0, 0.0, 0.0, 0.0, 9.0))
    for _ in simulation.run(State(0.0, q, v), 3.3):
        pass
    assert simulation.events[0].t == pytest.approx(np.sqrt(100.0 / 9.81), abs=1e-9)
