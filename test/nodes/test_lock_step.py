"""Lock step never stands still unnoticed: messages get lost, nodes are restarted and killed."""

import itertools
import os
import signal
import sys
import time
from collections import Counter

import numpy as np
import pytest
from deadline import DEADLINE
from nodes.relay import REMAPPED, Relay, ended, started
from nodes.simulation_client import ARM, NAME, PENDULUM, QuickProbe, simulated
from places import ROOT
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension, MultiArrayLayout

from mbd_ros.scene.reader import load_scene
from msg_adapters.diagnostics import OK, WARN
from msg_adapters.time import read_time

SCENE = ROOT / "config/scenes/controlled_arm.yaml"
CONTROLLER = "/sliding_mode_controller"
STILL = 2  # statuses in a row, one a second, that both may be OK and time may stand
RAMP = 0.2  # s
HOUR = float(os.environ.get("MBD_ROS_SOAK_SECONDS", "3600"))


class LossyLoop:
    """Simulator and controller in lock step, with a relay between them that loses messages."""

    def __init__(self, domain, folder, probe, nodes, **plant):
        self._domain, self._folder, self.probe, self._nodes = domain, folder, probe, nodes
        self._plant = {"scene": SCENE, "lock_step": "true", "publish_clock": "true", **plant}
        self.relay = Relay(probe, loss=0.01)
        scene = load_scene(SCENE)
        self._names, self._gain = list(scene.actuated), scene.safe.gain
        self._limit = np.array([scene.robot.joint(n).max_effort for n in self._names])
        self._speeds, self._begun = {}, None
        self._fine = Counter()  # node -> statuses in a row that were OK while time stood
        self._files = itertools.count()
        self.done = Counter()
        self.longest = self.highest = 0.0
        self.simulator = self.controller = None
        self.start_simulator()
        self.start_controller()

    def start_simulator(self):
        self.end("simulator", signal.SIGKILL)
        self.simulator = self._started("simulator", **self._plant)

    def start_controller(self, number=signal.SIGINT):
        self.end("controller", number)
        values = {"scene": SCENE, "use_sim_time": "true", "safe_ramp": RAMP}
        self.controller = self._started("sliding_mode_controller", REMAPPED, **values)
        self._assert_ramped()  # what the one before sent last
        self._begun = None

    def end(self, which, number):
        node = getattr(self, which)
        if node is None:
            return
        self.done[f"{which} {number.name}"] += 1
        code = node.stop(number)
        assert code == (0 if number == signal.SIGINT else -number), node.log
        assert "Traceback" not in node.log
        self._nodes.remove(node)

    def _started(self, module, arguments=(), **values):
        folder = self._folder / f"{module}_{next(self._files)}"
        node = started(self._domain, folder, module, arguments, **values)
        self._nodes.append(node)
        self.probe.spin_for(0.1)  # what the one before said
        self.probe.health.clear()
        self._fine.clear()
        self._since = time.monotonic()
        return node

    def watch(self, seconds):
        """Run for a while; both rules hold at every look."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.probe.spin_for(0.05)
            if self._is_new_time():
                self._since = time.monotonic()
                self._fine.clear()
            still = time.monotonic() - self._since
            self.longest = max(self.longest, still)
            for health in self.probe.health:
                is_fine = health.level == OK
                self._fine[health.name] = self._fine[health.name] + 1 if is_fine else 0
            assert min(self._fine[NAME], self._fine[CONTROLLER]) <= STILL, self.probe.health[-4:]
            assert still < DEADLINE, self.probe.health[-4:]
            self._assert_ramped()
            self.probe.health.clear()

    def _is_new_time(self):
        stamps = list(self.relay.stamps)
        self.relay.stamps.clear()
        if len(self._speeds) > 10_000:
            self._speeds.clear()
        for message in self.relay.states:
            v = dict(zip(message.name, message.velocity, strict=True))
            self._speeds[read_time(message.header.stamp)] = np.array([v[n] for n in self._names])
        self.relay.states.clear()
        moved = len(set(stamps)) > 1
        self.done["states"] += len(stamps)
        if stamps:
            self.relay.stamps.append(stamps[-1])
        return moved

    def _assert_ramped(self):
        """Control grows with the ramp; what the safe command damps besides is no ramp's matter."""
        while self.relay.commands:
            answered, values = self.relay.commands.popleft()
            if answered is None:
                continue
            if self._begun is None:
                self._begun = answered
            if answered < self._begun:
                self._begun = answered  # of another simulation
            share = min((answered - self._begun) * 1e-9 / RAMP + 1e-9, 1.0)
            self.highest = max(self.highest, (np.abs(values) / self._limit).max())
            damping = self._gain * np.abs(self._speeds.get(answered, np.inf))
            accepted = share * self._limit + damping
            assert (np.abs(values) <= accepted).all(), (answered, self._begun, values, accepted)


@pytest.mark.alone
@pytest.mark.soak
@pytest.mark.parametrize(
    ("seconds", "controller_every", "simulator_every"),
    [
        (15.0, 5.0, 10.0),
        (HOUR, 30.0, 120.0),
    ],
)
def test_lock_step_with_losses_restarts_and_kills(
    domain, tmp_path, capfd, seconds, controller_every, simulator_every
):
    """1 % of the messages are lost; controllers are stopped and killed, simulators killed.

    Never do both say OK while time stands for more than 2 s, and never is a command above the
    ramp that begins with either node.
    """
    with QuickProbe(domain) as probe, ended() as nodes:
        loop = LossyLoop(domain, tmp_path, probe, nodes)
        begin = time.monotonic()
        next_controller = controller_every
        next_simulator = simulator_every - 0.5 * controller_every  # long after the other one
        ends = itertools.cycle((signal.SIGINT, signal.SIGKILL))
        while (now := time.monotonic() - begin) < seconds:
            if now >= next_simulator:
                next_simulator += simulator_every
                loop.start_simulator()
            elif now >= next_controller:
                next_controller += controller_every
                loop.start_controller(next(ends))
            loop.watch(min(1.0, seconds - now))
        with capfd.disabled():
            sys.stdout.write(
                f"\n{dict(loop.done)}; still for {loop.longest:.2f} s at most; largest command "
                f"{100 * loop.highest:.3g} % of the limit\n"
            )
        assert loop.highest > 0.05  # the arm was held


# ---------------------------------------------------------------------- one fault at a time


FAST = ARM + "initial: {velocity: {wrist_flexion: 20.0}}\n"
LOCKED = {"lock_step": "true", "publish_clock": "true"}


def moved(relay, ns):
    """Whether simulated time went on by so much [ns]."""
    return lambda: relay.stamps and relay.stamps[-1] - relay.stamps[0] >= ns


@pytest.mark.parametrize("is_measured", [True, False])
def test_a_joint_that_begins_fast_does_not_stop_the_loop(domain, tmp_path, is_measured):
    """20 rad/s where 3 are allowed: believed at once by its velocity, or after `patience`."""
    (folder := tmp_path / "plant").mkdir()
    with (
        simulated(domain, folder, FAST, **LOCKED) as plant,
        ended() as nodes,
    ):
        plant.probe.node.destroy_publisher(plant._vectors)
        relay = Relay(plant.probe, without_velocity=not is_measured)
        values = {"scene": SCENE, "use_sim_time": "true"}
        folder = tmp_path / "controller"
        node = started(domain, folder, "sliding_mode_controller", REMAPPED, **values)
        nodes.append(node)
        plant.probe.spin_until(moved(relay, 50_000_000))
        health = plant.probe.wait_health(lambda h: h.name == CONTROLLER)
        assert is_measured == ("dropped.jump" not in health.values)


def test_commands_that_do_not_arrive_are_said_on_both_sides(domain, tmp_path):
    """And what comes late sees the robot: simulator first, then the controller, then commands."""
    (folder := tmp_path / "plant").mkdir()
    with (
        simulated(domain, folder, ARM, **LOCKED) as plant,
        ended() as nodes,
    ):
        plant.probe.node.destroy_publisher(plant._vectors)
        relay = Relay(plant.probe)
        values = {"scene": SCENE, "use_sim_time": "true"}
        folder = tmp_path / "controller"
        node = started(domain, folder, "sliding_mode_controller", REMAPPED, **values)
        nodes.append(node)
        plant.probe.spin_until(moved(relay, 50_000_000))
        relay.loss_of_commands = 1.0
        health = plant.probe.wait_health(lambda h: h.name == NAME and h.level == WARN)
        assert "the state is repeated; waiting for a command" in health.message
        health = plant.probe.wait_health(lambda h: h.name == CONTROLLER and h.level == WARN)
        assert "comes again and again: time stands" in health.message
        relay.stamps.clear()
        relay.loss_of_commands = 0.0
        plant.probe.spin_until(moved(relay, 50_000_000))
        plant.probe.wait_health(lambda h: h.name == NAME and h.level == OK)
        plant.probe.wait_health(lambda h: h.name == CONTROLLER and h.level == OK)


def test_a_state_that_was_repeated_is_answered_once(domain, tmp_path):
    """An answer to a state that was answered before is no tick; one without a stamp is."""
    with simulated(domain, tmp_path, ARM, **LOCKED) as client:
        dimension = MultiArrayDimension()
        message = Float64MultiArray(data=[0.0] * 4, layout=MultiArrayLayout(dim=[dimension]))
        for label, stamp in (("0.000000001", 1), ("0.000000001", 1), ("0.001000000", 2)):
            dimension.label = label
            client.publish(message)
            client.probe.spin_until(lambda k=stamp: client.newest.stamp >= k * 1_000_000)
        health = client.probe.wait_health(
            lambda h: h.values["commands that answered a state again"] == "1"
        )
        assert health.values["simulated time"] == "0.002"
        client.command([0.0] * 4)
        client.probe.spin_until(lambda: client.newest.stamp == 3_000_000)
        client.reset()
        dimension.label = "0.003000000"  # under way while time began anew
        client.publish(message)
        health = client.probe.wait_health(
            lambda h: h.values["commands that answered a state again"] == "2"
        )
        assert health.values["simulated time"] == "0"


@pytest.mark.parametrize("factor", [0.1, 1.0])
def test_stamps_run_forwards_from_the_first_one_on(domain, tmp_path, factor):
    """Also by the node clock, after a reset, a pause and a new beginning."""
    with simulated(domain, tmp_path, PENDULUM, real_time_factor=factor) as client:
        for act in (
            client.reset,
            lambda: client.pause(True),
            client.step,
            lambda: client.pause(False),
            lambda: client.probe.change_state(NAME, "deactivate"),
            lambda: client.probe.change_state(NAME, "activate"),
        ):
            act()
            client.probe.spin_for(0.1)
        stamps = client.stamps()
        assert (np.diff(stamps) > 0).all(), np.diff(stamps).min()


def test_who_comes_late_sees_a_paused_robot(domain, tmp_path):
    with simulated(domain, tmp_path, PENDULUM, paused="true", publish_clock="true") as client:
        shown = client.step()
        client.settle()
        late = []
        qos = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
        client.probe.node.create_subscription(JointState, "/joint_states", late.append, qos)
        client.probe.spin_until(lambda: late)
        assert late[0].position.tolist() == shown.position.tolist()
        assert read_time(late[0].header.stamp) == shown.stamp
        client.probe.spin_until(lambda: len(client.states) == client.settle())  # for a while only
