"""The simulator in real time, in lock step and in a loop with inverse dynamics, over DDS."""

import math
import signal
import sys
import time

import numpy as np
import pytest
from nodes.simulation_client import (
    ARM,
    DEEP,
    JOINTS,
    NAME,
    PENDULUM,
    STOP,
    simulated,
    streamed,
    swinging,
)
from nodes.timer_node import LINE
from places import ROOT
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from visualization_msgs.msg import MarkerArray

from mbd_ros.api import load_scene
from mbd_ros.files.bags.bag_reader import messages, raw_messages
from mbd_ros.files.bags.bag_writer import BagWriter
from mbd_ros.methods.simulation.live_simulation import LiveSimulation
from mbd_ros.methods.simulation.safe_command import CommandWatch
from msg_adapters.diagnostics import OK, WARN
from msg_adapters.joint_state import read_joint_state, write_joint_state
from msg_adapters.multi_array import write_multi_array
from msg_adapters.time import read_clock

TIMER = ROOT / "test/support/nodes/timer_node.py"
TICK = 1e-3
MS = 1_000_000
METRES_PER_NEWTON = 0.02
VECTOR, STATE = "std_msgs/msg/Float64MultiArray", "sensor_msgs/msg/JointState"


def scene_of(folder, text):
    """The scene that a text describes, in this process."""
    path = folder / "local.yaml"
    path.write_text(text, encoding="utf-8")
    return load_scene(path)


# ---------------------------------------------------------------------- real time


@pytest.mark.soak  # a busy machine decides
@pytest.mark.parametrize("seconds", [60.0])
def test_real_time_at_1_khz(domain, start_node, tmp_path, capfd, seconds):
    """No command is lost, joint states come at their rate, stamps are ticks to the nanosecond.

    In the median second, ticks are at most half as late as those of an rclpy timer beside it.
    """
    timer = start_node(target=(str(TIMER),))
    with simulated(domain, tmp_path, ARM, publish_clock="true") as client:
        before = client.probe.wait_health(lambda h: h.values["state"] == "active")
        first = len(client.states)
        sent = streamed(client, seconds, 1000.0)
        client.probe.spin_for(0.05)
        arrivals, stamps = np.array(client.arrivals[first:]), client.stamps()[first:]
        health = client.probe.wait_health(lambda h: h.values["commands received"] == str(sent))
        assert before.values["commands received"] == "0"
        assert len(arrivals) / (arrivals[-1] - arrivals[0]) == pytest.approx(1000.0, rel=0.01)
        assert set(np.diff(stamps)) == {MS}
        assert int(health.values["overruns"]) >= 0
        assert float(health.values["time given up"]) == 0.0
        assert "dropped.command" not in health.values
        ours = lateness(client.probe.health, seconds)
        timers = [float(line.rpartition(LINE)[2]) for line in timer.log.splitlines()]
        timers = timers[-len(ours) :]
        assert min(len(ours), len(timers)) > 0.9 * seconds
        with capfd.disabled():
            sys.stdout.write(f"\nlateness p99 of a second [us], simulator: {quartiles(ours)}, ")
            sys.stdout.write(f"rclpy timer: {quartiles(timers)}\n")
        assert np.median(ours) <= 0.5 * np.median(timers)


def lateness(healths, seconds):
    """What the simulator says of the last `seconds`, a number a second [s]."""
    own = [h for h in healths if h.name == NAME and "simulating" in h.message]
    return [float(h.values["lateness of 99 % of the ticks"]) for h in own][-round(seconds) :]


def quartiles(values):
    return " / ".join(f"{1e6 * value:.1f}" for value in np.percentile(values, [25, 50, 75]))


def test_stamps_of_the_node_clock_say_when_a_tick_was_due_by_the_real_time_factor(
    domain, tmp_path
):
    """Never before that: what a busy machine delays, the stamps do not show."""
    with simulated(domain, tmp_path, PENDULUM, stop=signal.SIGTERM) as client:
        for asked in (1, 0.5, 2):
            assert client.probe.set_parameter(NAME, "real_time_factor", asked).successful
            first, begin = len(client.states), time.time_ns()
            client.probe.spin_until(lambda n=first: len(client.states) > n + 200)
            samples = [client.sample(k) for k in range(first, first + 200)]
            stamps = np.array([sample.stamp for sample in samples])
            # The last tick before the change may still be on its way.
            assert begin - 1000 * MS < stamps[1] < stamps[-1] < time.time_ns()
            assert np.median(np.diff(stamps)) == pytest.approx(MS / asked, abs=1000)
        for value in (-1.0, float("nan")):
            assert not client.probe.set_parameter(NAME, "real_time_factor", value).successful


def test_as_fast_as_possible_pause_and_reset(domain, tmp_path):
    """With ticks of 10 ms, so that it is fast on a busy machine too."""
    options = {"publish_clock": "true", "real_time_factor": 0.0, "rate": 100.0}
    with simulated(domain, tmp_path, ARM, **options) as client:
        clocks = []
        keep = client.probe.node.create_subscription(Clock, "/clock", clocks.append, DEEP)
        client.probe.spin_until(keep.get_publisher_count)
        reached = "real-time factor reached"
        client.probe.wait_health(lambda h: float(h.values[reached]) > 1.2)
        client.pause(True)
        health = client.probe.wait_health(lambda h: "paused" in h.message)
        assert health.values[reached] == "standing"
        reported = round(1e9 * float(health.values["simulated time"]))
        client.probe.spin_until(lambda: client.newest.stamp >= reported - MS)
        first, ticked = len(client.states), len(clocks)
        assert client.node.is_idle()
        assert len(client.states) == first
        client.probe.spin_until(lambda: len(clocks) > ticked)
        standing = {read_clock(message) for message in clocks[ticked:]}
        assert standing == {client.newest.stamp}  # repeated, for who comes late
        client.reset()
        assert client.newest.stamp == 1  # ns: 0 would be none
        np.testing.assert_array_equal(client.newest.position, [0.0, 0.0, 0.175, 0.0, 0.0])
        client.step()
        first = len(client.states)
        assert client.probe.set_parameter(NAME, "real_time_factor", 1.0).successful
        client.pause(False)
        client.probe.spin_until(lambda: len(client.states) > first + 30)
        assert set(np.diff(client.stamps()[first - 1 :])) == {10 * MS}


def test_a_simulation_that_is_too_slow_says_so_and_stretches_no_step(domain, tmp_path):
    """Ticks of 20 us in real time: overruns, WARN; every tick is 20 us all the same."""
    with simulated(
        domain, tmp_path, ARM + "dt: 2e-5\n", rate=50_000.0, publish_clock="true"
    ) as client:
        health = client.probe.wait_health(lambda h: "lagging" in h.message)
        assert health.level == WARN
        assert "instead of 1, " in health.message
        assert int(health.values["overruns"]) > 10
        assert 0.0 < float(health.values["real-time factor reached"]) < 0.9
        assert float(health.values["time given up"]) > 0.1
        client.pause(True)
        stamps = [client.newest.stamp]
        stamps += [client.step().stamp for _ in range(20)]
        assert set(np.diff(stamps)) == {20_000}


# ---------------------------------------------------------------------- lock step


def played(client, bag, out, by_service):
    """Play a bag of commands in lock step, a tick a command; record the joint states once each."""
    first = len(client.states)

    def ticks():
        """Stamp -> state; before the first tick, and without a command, states are repeated."""
        found = {
            client.sample(k).stamp: client.states[k] for k in range(first, len(client.states))
        }
        return {stamp: state for stamp, state in found.items() if stamp >= MS}

    commands = [m for _, _, m in messages(bag, {f"{NAME}/commands": VECTOR})]
    for message in commands:
        client.command(message.data)
        if by_service:
            client.step()
    client.probe.spin_until(lambda: len(ticks()) >= len(commands))
    with BagWriter(out) as writer:
        for stamp, state in ticks().items():
            writer.write("/joint_states", STATE, stamp, state)
    return [(raw.log_time, raw.cdr) for raw in raw_messages(out)]


def test_lock_step_gives_the_same_bag_twice(domain, tmp_path):
    """By ~/step, by `lock_step` as fast as DDS brings them, after a reset, in another process.

    A stop acts, so that the QP has a history to forget. And it is the run in this process.
    """
    from mbd_ros.files.bags.bag_types import new_message

    bag, count = tmp_path / "commands", 120
    with BagWriter(bag) as writer:
        for k in range(count):
            message = write_multi_array(new_message(VECTOR), swinging(k * TICK))
            writer.write(f"{NAME}/commands", VECTOR, k * MS, message)
    text, recordings = ARM + STOP, []
    for mode, factor in (("paused", 1.0), ("lock_step", 0.0)):
        (folder := tmp_path / mode).mkdir()
        options = {mode: "true", "publish_clock": "true", "real_time_factor": factor}
        with simulated(domain, folder, text, **options) as client:
            for out in ("first", "second"):
                recordings.append(played(client, bag, folder / out, mode == "paused"))
                client.reset()
    assert len(recordings[0]) == count
    for recording in recordings[1:]:
        assert recording == recordings[0]
    scene = scene_of(tmp_path, text)
    live = LiveSimulation(
        scene.simulation, scene.initial, TICK, CommandWatch(0.1, 0.1), scene.safe
    )
    last = list(messages(tmp_path / "paused" / "first", {"/joint_states": STATE}))
    for k, (_, stamp, message) in enumerate(last):
        live.watch.take(swinging(k * TICK))
        now, sample = live.tick(), read_joint_state(message)
        assert stamp == sample.stamp == (k + 1) * MS
        for field in ("position", "velocity", "effort"):
            np.testing.assert_allclose(
                getattr(sample, field), getattr(now, field), rtol=0, atol=1e-12
            )


def test_commands_by_vector_and_by_name_in_any_order(domain, tmp_path):
    order = list(JOINTS[::-1])
    with simulated(domain, tmp_path, ARM, paused="true", joints=order) as client:
        client.command([4.0, 3.0, 2.0, 1.0])
        expected = {"elbow": 0.0, **dict(zip(order, [4.0, 3.0, 2.0, 1.0], strict=True))}
        scene = scene_of(tmp_path, ARM)
        names = [joint.name for joint in scene.robot.joints]
        np.testing.assert_array_equal(client.step().effort, [expected[name] for name in names])
        for chosen in (JOINTS, order):
            values = np.array([1.0 + JOINTS.index(name) for name in chosen])
            client.publish(write_joint_state(JointState(), 0, chosen, effort=values))
            effort = dict(zip(names, client.step().effort, strict=True))
            assert [effort[name] for name in JOINTS] == [1.0, 2.0, 3.0, 4.0]
        refused = client.probe.set_parameter(NAME, "joints", list(JOINTS))
        assert "read-only" in refused.reason


def test_a_step_needs_a_pause(domain, tmp_path):
    with simulated(domain, tmp_path, PENDULUM) as client:
        assert client.refused_step() == "not paused: call ~/pause first"
        client.pause(True)
        client.step()
        assert client.probe.change_state(NAME, "deactivate")
        assert client.refused_step() == "the node is inactive"
        client.settle()
        assert client.probe.change_state(NAME, "activate")
        client.step()


# ---------------------------------------------------------------------- forces


@pytest.mark.parametrize("solver", ["plain", "qp"])
def test_constraint_forces_and_markers(domain, tmp_path, solver):
    """The loop of the four-bar leg: multipliers by row, an arrow for each of the two bodies.

    A stop that the start is beyond comes first in the scene: it must not be taken for the loop.
    The leg hangs 80 m away, and so do its arrows.
    """
    leg = (ROOT / "config/robots/four_bar_leg.urdf").read_text(encoding="utf-8")
    leg = leg.replace('<origin xyz="0 0 0.9275"/>', '<origin xyz="80 0 0.9275"/>')
    (tmp_path / "leg.urdf").write_text(leg, encoding="utf-8")
    text = (ROOT / "config/scenes/four_bar_leg.yaml").read_text(encoding="utf-8")
    text = text.replace("../robots/four_bar_leg.urdf", str(tmp_path / "leg.urdf"))
    stop = "- {type: joint_stop, joint: hip_flexion, upper: 0.2, time_constant: 0.01}"
    text = text.replace("constraints:", f"solver: {{type: {solver}}}\nconstraints:\n{stop}")
    with simulated(
        domain,
        tmp_path,
        text,
        publish_clock="true",
        marker_rate=50.0,
        marker_scale=METRES_PER_NEWTON,
    ) as client:
        forces, arrays = [], []
        create = client.probe.node.create_subscription
        create(JointState, f"{NAME}/constraint_forces", forces.append, DEEP)
        create(MarkerArray, f"{NAME}/markers", arrays.append, DEEP)
        client.probe.spin_until(lambda: forces and len(arrays) > 2)
        client.pause(True)  # a busy machine lags, and says so
        scene = scene_of(tmp_path, text)
        system = scene.system()
        assert tuple(forces[0].name) == tuple(row.name for row in system.multiplier_rows)
        assert forces[0].name[0] == "hip_flexion_joint_stop.torque" and len(forces[0].effort) == 3
        assert np.abs(forces[-1].effort).max() > 0.1
        upper, lower = shown = arrays[-1].markers
        on = "shank_loop_closure.on_"
        assert {upper.ns, lower.ns} == {f"{on}posterior_bar", f"{on}shank"}
        tails = [np.array([m.points[0].x, m.points[0].y, m.points[0].z]) for m in (upper, lower)]
        heads = [np.array([m.points[1].x, m.points[1].y, m.points[1].z]) for m in (upper, lower)]
        np.testing.assert_allclose(tails[0], tails[1], atol=1e-9)
        np.testing.assert_allclose(tails[0], [80.0, 0.0, 0.5], atol=0.5)
        np.testing.assert_allclose(heads[0] - tails[0], tails[1] - heads[1], atol=1e-12)
        stamp = shown[0].header.stamp
        client.probe.spin_until(lambda: any(f.header.stamp == stamp for f in forces))
        (force,) = (f for f in forces if f.header.stamp == stamp)
        pull = np.linalg.norm(heads[0] - tails[0]) / METRES_PER_NEWTON
        assert pull == pytest.approx(math.hypot(*force.effort[1:]), rel=1e-9)
        health = client.probe.wait_health(lambda h: h.level == OK)
        assert health.values["solver tier"] == (
            "qp over kkt" if solver == "plain" else "qp over aba"
        )
        assert float(health.values["drift of positions"]) < 1e-12
        assert float(health.values["drift of velocities"]) < 1e-11
