"""Stops that nobody reaches cost almost nothing, and are not missed when somebody does."""

import timeit

import numpy as np
import pytest
from idle_stops import START, calls, stepping

import mbd_ros as mbd
from mbd_ros.core.state import State, is_same

WIDE = {"type": "joint_stop", "joints": ["all"], "lower": -50.0, "upper": 50.0}
COSTS = [("rk4", 1.25), ("adams", 1.3)]


def simulated(method, constraints, dt=1e-4):
    scene = mbd.load_scene("arm7").with_(
        constraints=constraints, integrator={"type": method}, dt=dt
    )
    simulation = scene.simulation()
    return simulation, simulation.start(State(0.0, *START))


@pytest.mark.parametrize(("method", "limit"), COSTS)
def test_idle_stops_cost_a_few_calls_a_step(method, limit):
    """The time of a step is that of its calls; 1.06 and 1.21 were measured on a quiet machine."""
    free, stopped = (stepping(*simulated(method, stops)) for stops in (None, [WIDE]))
    assert calls(stopped) <= calls(free) + 6
    times = [[timeit.timeit(step, number=200) for step in (free, stopped)] for _ in range(25)]
    best = np.min(times, axis=0)
    assert best[1] / best[0] <= limit + 0.2  # for who is beside


def test_idle_stops_cost_no_evaluation():
    for method, _ in COSTS:
        counts = []
        for constraints in (None, [WIDE]):
            simulation, y = simulated(method, constraints)
            before = simulation.system.evaluations
            simulation.advance(y, None, 0.05)
            counts.append(simulation.system.evaluations - before)
        assert counts[0] == counts[1]


@pytest.mark.parametrize("method", ["rk4", "adams", "dopri5", "gauss_legendre"])
@pytest.mark.parametrize("dt", [1e-4, 2e-3])
def test_states_beside_idle_stops_are_those_without(method, dt):
    ends = []
    for constraints in (None, [WIDE]):
        simulation, y = simulated(method, constraints, dt)
        ends.append(simulation.advance(y, None, 100 * dt))
    assert np.array_equal(ends[0].q, ends[1].q) and np.array_equal(ends[0].v, ends[1].v)


@pytest.mark.parametrize("method", ["rk4", "adams"])
@pytest.mark.parametrize("limit", [0.6, 1.0, 3.0])
def test_no_stop_is_missed(method, limit):
    """Many steps at once and single ones hit the same stops; no joint is beyond one, ever.

    A single step ends at the next sample after an event, so both differ by the error of a step.
    """
    stops = {"type": "joint_stop", "joints": ["all"], "lower": -limit, "upper": limit}
    simulation, y = simulated(method, [{**stops, "restitution": 0.5}], 5e-4)
    for k in range(60):
        y = simulation.advance(y, None, 0.01 * (k + 1))
        assert np.abs(y.q).max() <= limit + 1e-9
    single, _ = simulated(method, [{**stops, "restitution": 0.5}], 5e-4)
    states = list(single.run(State(0.0, *START), 0.6))
    assert max(np.abs(x.q).max() for x in states) <= limit + 1e-9
    assert len(simulation.events) == len(single.events) > 0
    assert np.abs(states[-1].q - y.q).max() < 1e-4
    for one, other in zip(simulation.events, single.events, strict=True):
        assert one.guards == other.guards and one.t == pytest.approx(other.t, abs=1e-5)


KINDS = {
    "open": ("arm7", {}, 1.0),
    "coupled": ("arm7", {"couplings": {"joint4": {"parent": "joint2", "factor": 0.5}}}, 0.9),
    "curved": (
        "arm7",
        {"couplings": {"joint4": {"parent": "joint2", "polynomial": [0, 0, 3]}}},
        2.0,
    ),
    "loop": ("four_bar_leg", {}, None),
    "sliding": ("prosthetic_leg", {}, None),
}


@pytest.mark.parametrize("method", ["rk4", "adams"])
@pytest.mark.parametrize("kind", KINDS)
def test_steps_without_a_search_find_what_a_search_finds(method, kind):
    """Every bit and every event, in every tier."""
    name, sections, limit = KINDS[kind]
    scene = mbd.load_scene(name)
    free = list(scene.couplings.independent)[:2]
    joints = ["all"] if limit else free
    low, high = (-limit, limit) if limit else (-0.4, 0.4)
    stops = {"type": "joint_stop", "joints": joints, "lower": low, "upper": high}
    more = {"constraints": [*scene.entries.get("constraints", ()), {**stops, "restitution": 0.4}]}
    if kind != "loop":  # which would not close
        more["initial"] = {"velocity": dict(zip(free, (4.0, -5.0), strict=True))}
    scene = scene.with_(**sections, **more, integrator={"type": method}, dt=1e-3)
    ends = []
    for is_searched in (False, True):
        simulation = scene.simulation()
        simulation.stepper._has_clearance = not is_searched
        states = list(simulation.run(scene.initial, 0.35))
        ends.append((states, simulation.events))
    (states, events), (searched, found) = ends
    assert [event[:2] for event in events] == [event[:2] for event in found]
    assert len(events) > 0
    assert all(is_same(one, other) for one, other in zip(states, searched, strict=True))
