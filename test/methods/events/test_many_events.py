"""Runs with many events: each costs the same, and those that were taken are not kept."""

import gc
import pickle
import weakref

import numpy as np
import pytest

import mbd_ros as mbd
from mbd_ros.core.contracts import Guard, Load
from mbd_ros.core.state import State
from mbd_ros.methods.events.step_events import Event, EventLog
from mbd_ros.methods.simulation.live_simulation import LiveSimulation
from mbd_ros.methods.simulation.safe_command import CommandWatch

RATE = 1000.0
PENDULUM = "package://mbd_ros/config/robots/pendulum.urdf"


class Metronome(Load):
    """Beats at every zero of sin(1000 t), and does nothing else."""

    guards = (Guard("beat"),)

    def __init__(self, robot):
        self.zero = np.zeros(robot.model.nv)

    def force(self, k, x, u):
        return self.zero

    def guard_values(self, k, x, u, now):
        return np.array([np.sin(RATE * x.t)])


@pytest.fixture
def scene():
    return mbd.scene_from({"robot": {"urdf": PENDULUM}, "dt": 1e-3})


def beating(scene):
    return scene.simulation(forces=(Metronome(scene.robot),))


def event(t):
    x = State(t, np.array([t]), np.zeros(1))
    return Event(t, ("beat",), x, x, np.zeros(0))


def test_twenty_thousand_events_are_twenty_thousand_entries():
    """Every log on the way is kept, as checkpoints do; tuples of them would be 1.6 GB."""
    log, logs = EventLog(), []
    for k in range(20_000):
        log = log.after(event(float(k)))
        logs.append(log)
    assert all(len(one) == k + 1 for k, one in enumerate(logs))
    assert len({id(one._shared) for one in logs}) == 1
    assert log[-1].t == 19_999.0 and log[5:8][1].t == 6.0


def test_a_log_is_a_value():
    first = EventLog().after(event(1.0))
    one, other = first.after(event(2.0)), first.after(event(3.0))
    assert [[e.t for e in log] for log in (first, one, other)] == [[1.0], [1.0, 2.0], [1.0, 3.0]]
    again = pickle.loads(pickle.dumps(first))
    assert [e.t for e in again] == [1.0]
    with pytest.raises(ValueError, match="read-only"):
        first[0].after.q[0] = 7.0
    with pytest.raises(IndexError):
        first[1]


def test_checkpoints_of_a_run_share_their_events(scene):
    """A checkpoint at every sample of 600 events, none of which is copied."""
    simulation = beating(scene)
    span, kept = 600.5 * np.pi / RATE, []
    for _ in simulation.run(scene.initial, span):
        kept.append(simulation.checkpoint().memory["transitions"][-1])
    times = [e.t for e in simulation.events]
    assert times == pytest.approx(np.arange(1, 601) * np.pi / RATE, abs=1e-12)
    assert all(log[0] is simulation.events[0] for log in kept if log)
    assert [len(log) for log in kept] == sorted(len(log) for log in kept)
    assert len({id(log._shared) for log in kept if log}) == 1


def test_a_live_simulation_keeps_the_events_of_one_tick(scene):
    live = LiveSimulation(
        lambda: beating(scene), scene.initial, 0.01, CommandWatch(0.1, 0.1), scene.safe
    )
    seen = []
    for _ in range(40):
        live.tick()
        seen += [weakref.ref(one.impulse) for one in live.events]
    gc.collect()
    assert len(seen) == int(0.4 * RATE / np.pi)
    assert sum(ref() is not None for ref in seen) == len(live.events) <= 4
    assert not live.simulation.events
