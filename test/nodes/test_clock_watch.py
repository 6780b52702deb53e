"""A simulation that dies, stands or is slow, as a controller in simulated time takes it."""

from contextlib import contextmanager

import numpy as np
import pytest
from deadline import PATIENT
from nodes.control_client import KINDS, MOMENT, POSE, STEP, controlled
from nodes.simulation_client import ARM, DAMPED, NAME, simulated
from rosgraph_msgs.msg import Clock

from msg_adapters.diagnostics import OK, STALE, WARN
from msg_adapters.time import write_clock

CALM = ARM + DAMPED
RAMP, LARGEST = 0.5, 5.0
TUNED = {
    **{"use_sim_time": "true", "timeout": MOMENT, "safe_ramp": RAMP, "max_age": 1.0},
    "effort_limit": [LARGEST] * 4,
}
LONE = {**PATIENT, "effort_limit": [50.0] * 4}
SLOW_AND_REAL = [("sliding", 0.1), pytest.param("qp", 1.0, marks=pytest.mark.soak)]
SAFE = "share of the safe command"


@contextmanager
def simulation(domain, tmp_path, name, **values):
    """A simulator with a clock, which the test ends."""
    (folder := tmp_path / name).mkdir()
    given = {"publish_clock": "true", "marker_rate": 0.0, "command_timeout": 1e3, **values}
    with simulated(domain, folder, CALM, stop=None, **given) as client:
        yield client


@contextmanager
def controller(domain, tmp_path, kind="sliding", **values):
    """The controller of that simulator."""
    (folder := tmp_path / "controller").mkdir()
    with controlled(domain, folder, CALM, kind=kind, plant=NAME, **TUNED | values) as client:
        yield client


def controls(client):
    """Once the law alone acts; its status, which may warn of a late command."""
    return client.wait_health(lambda h: h.level in (OK, WARN) and h.values[SAFE] == "0")


@pytest.mark.parametrize(("kind", "factor"), SLOW_AND_REAL)
def test_a_killed_simulator_is_noticed_and_its_successor_gets_a_ramp(
    domain, tmp_path, kind, factor
):
    """By its silence: DDS forgets a killed process after 14 to 21 s, and says so then."""
    values = {"rate": 200.0, "real_time_factor": factor}
    with controller(domain, tmp_path, kind) as client:
        with simulation(domain, tmp_path, "first", **values) as first:
            controls(client)
            first.node.process.kill()
            first.node.wait()
            count = len(client.commands)
            client.wait_health(lambda h: h.level == STALE and "/clock is silent for" in h.message)
            client.probe.spin_until(lambda: not client.commands[-1].any())
            assert np.abs(client.commands[count - 1 :]).max() <= LARGEST
        count = len(client.commands)
        with simulation(domain, tmp_path, "second", **values) as second:
            controls(client)
            second.node.stop()
        answers = [k for k in range(count, len(client.commands)) if client.answered[k]]
        stamps = np.array([client.answered[k] for k in answers])
        efforts = np.abs([client.commands[k] for k in answers]).max(1)
        begun = np.flatnonzero(np.diff(stamps, prepend=np.inf) < 0)[-1]  # time may begin twice
        share = (stamps[begun:] - stamps[begun]) * 1e-9 / RAMP
        assert (efforts[begun:] <= LARGEST * (share + 0.1)).all()
        assert efforts.max() > 0.0


def is_kept(client):
    """Whether the command did not go safe for three reports, of one a second."""
    healths = [client.wait_health(lambda h: True) for _ in range(3)]
    first, *later = [(h.values[SAFE], h.values["times gone safe"]) for h in healths]
    return first[0] == "0" and all(values == first for values in later)


def test_slow_motion_and_a_pause_are_no_silence(domain, tmp_path):
    """A tick a second, then none: the clock beats all the same.

    Where the machine itself stands it may be silent once, but not again and again.
    """
    values = {"rate": 100.0, "real_time_factor": 1.0}
    with (
        simulation(domain, tmp_path, "plant", **values) as plant,
        controller(domain, tmp_path) as client,
    ):
        controls(client)
        assert client.probe.set_parameter(NAME, "real_time_factor", 0.01).successful
        client.probe.spin_until(lambda: is_kept(client))
        plant.pause(True)
        client.probe.spin_until(lambda: is_kept(client))
        plant.pause(False)
        assert plant.node.stop() == 0


def test_a_clock_that_ticked_and_stops_is_silence_though_its_publisher_is_there(domain, tmp_path):
    """A simulator that hangs; where it goes on the command comes back by a ramp."""
    with controlled(domain, tmp_path, **TUNED) as client:
        clock = client.probe.node.create_publisher(Clock, "/clock", 10)
        client.probe.spin_until(clock.get_subscription_count)

        def tick(k):
            clock.publish(write_clock(Clock(), k * STEP))
            client.probe.spin_for(0.01)
            return client.ask(stamp=k * STEP)

        for k in range(1, 80):
            command = tick(k)
        assert command.any()
        client.probe.spin_until(lambda: not client.commands[-1].any())
        assert "/clock is silent for" in client.wait_health(lambda h: h.level == STALE).message
        full = np.abs(client.holding(POSE)).max()
        for k in range(80, 90):
            assert np.abs(tick(k)).max() <= full * (k - 79) * STEP * 1e-9 / RAMP * 1.01


@pytest.mark.parametrize("kind", KINDS)
def test_time_that_begins_anew_brings_control_back_by_a_ramp(domain, tmp_path, kind):
    """A simulator that ended and began before anybody noticed, or that was reset."""
    with controlled(domain, tmp_path, kind=kind, **TUNED | LONE) as client:
        clock = client.probe.node.create_publisher(Clock, "/clock", 10)
        client.probe.spin_until(clock.get_subscription_count)
        for begin in (400, 0):
            for k in range(1, 100):
                clock.publish(write_clock(Clock(), (begin + k) * STEP))
                command = client.ask(stamp=(begin + k) * STEP)
                full = np.abs(client.holding()).max()
                assert np.abs(command).max() <= full * max(k * STEP * 1e-9 / RAMP, 0.03) * 1.01
            np.testing.assert_allclose(command, client.holding(), rtol=1e-9)
