"""The delay that a loop tolerates, from both sides; error, speed and delay beyond their bounds."""

from collections import deque

import numpy as np
import pinocchio as pin
import pytest
from places import ROOT

from mbd_ros.api import load_scene
from mbd_ros.features.control.control_loop import ControlLoop, Guard
from mbd_ros.features.control.loop_watch import (
    ChatterMeter,
    DelayMeter,
    LoopWatch,
    LossLimits,
    rest_responses,
)
from mbd_ros.features.control.reference import ReferenceGenerator
from mbd_ros.methods.control.contract import LoopGains, pd_gains, sliding_gains, tolerable_delay
from mbd_ros.methods.projection.state_projection import ObservedState
from mbd_ros.methods.simulation.live_simulation import LiveSimulation
from mbd_ros.methods.simulation.safe_command import CommandWatch
from mbd_ros.scene.schema.registry import resolve

SCENES = ROOT / "config/scenes"
RAMP, BEGIN = 0.2, 0.9  # s
LAWS = {
    "sliding_mode": {"bandwidth": 20.0, "gain": 60.0, "boundary_layer": 0.5},
    "super_twisting": {"bandwidth": 20.0, "disturbance_rate": 200.0},
    "computed_torque": {"kp": 400.0, "kd": 40.0},
    "qp_tracking": {"kp": 100.0, "kd": 20.0},
    "gravity_compensation": {"stiffness": 0.4, "damping": 0.05},
}


class DelayedLoop:
    """A plant and its controller in one process, with a delay between command and drive.

    Attributes:
        watch: Of the loop.
        worst: Largest error / bound while the loop was not lost.
        fault: When the loop was lost first, and why.
    """

    def __init__(self, name, kind, rate, **gains):
        scene = load_scene(SCENES / f"{name}.yaml")
        self.joints = joints = scene.controlled_joints()
        controller = resolve("controllers", kind, "test")(joints, **{**LAWS[kind], **gains})
        limits, speeds = (
            np.array([getattr(joint, key) for joint in joints.joints])
            for key in ("max_effort", "max_velocity")
        )
        rest = rest_responses(joints, scene.initial)
        self.watch = LoopWatch(joints.names, controller, rest, LossLimits(speeds, 5.0))
        self.loop = ControlLoop(
            controller,
            ReferenceGenerator(joints),
            Guard(joints.names, limits),
            scene.safe,
            RAMP,
            0.1,
            ChatterMeter(len(joints)),
            self.watch,
        )
        commands = CommandWatch(0.1, 0.1)
        self.live = LiveSimulation(
            scene.simulation, scene.initial, 1.0 / rate, commands, scene.safe
        )
        names = [joint.name for joint in scene.robot.joints]
        self._driven = [names.index(name) for name in joints.names]
        self._independent = [names.index(name) for name in scene.couplings.independent]
        self._observed = ObservedState(joints.system, scene.couplings)
        self._queue = deque()
        self.speeds, self.worst, self.fault, self.fastest = speeds, 0.0, None, 0.0
        self.is_led = self.is_blind = False

    def lead(self):
        """A slow swing of every joint."""
        now, (q,) = self.live.now.t, self.loop.generator.at(self.live.now.t)[:1]
        t = np.arange(0.0, 5.0, 0.05)
        lower, upper = (
            np.array([getattr(joint, key) for joint in self.joints.joints])
            for key in ("lower", "upper")
        )
        away = 0.1 * (1.0 - np.cos(3.0 * t))[:, None] * np.where(q > 0.5 * (lower + upper), -1, 1)
        self.loop.generator.follow(now, now + t, q + away)

    def run(self, until, delay=0.0):
        while self.live.now.t < until - 1e-9:
            now = self.live.now
            x = self._observed.state(
                now.t, now.position[self._independent], now.velocity[self._independent]
            )
            acted = None if self.is_blind else now.effort[self._driven]
            command = self.loop.update(x, acted)
            self._note(command)
            self._queue.append((now.t + delay, command.effort))
            while self._queue and self._queue[0][0] <= now.t + 1e-9:
                self.live.watch.take(self._queue.popleft()[1])
            self.live.tick()

    @property
    def energy(self):
        """Of the plant [J]."""
        x, model = self.live._x, self.joints.system.robot.model
        return pin.computeMechanicalEnergy(model, model.createData(), x.q, x.v)

    def _note(self, command):
        now, watch = self.live.now, self.watch
        if watch.fault and self.fault is None:
            self.fault = now.t, watch.fault
        if now.t > BEGIN - 0.1 and not watch.fault:
            self.worst = max(self.worst, float((np.abs(command.error) / watch.error_bound).max()))
        v = np.abs(now.velocity[self._driven])
        self.fastest = max(self.fastest, float((v / self.speeds).max()))


def led(name, kind, rate, **gains):
    loop = DelayedLoop(name, kind, rate, **gains)
    loop.run(0.5)
    loop.lead()
    loop.run(BEGIN)
    assert loop.watch.delay == pytest.approx(0.0, abs=1e-9)
    assert not loop.watch.warnings()
    return loop


CASES = [
    ("controlled_arm", "sliding_mode", 1000.0, {}),
    ("controlled_leg", "computed_torque", 500.0, {}),
    ("controlled_four_bar", "super_twisting", 250.0, {}),
    ("controlled_arm7", "qp_tracking", 250.0, {}),
]
MORE = [
    ("controlled_arm", "sliding_mode", 250.0, {"gain": 30.0, "bandwidth": 8.0}),
    ("controlled_arm", "gravity_compensation", 1000.0, {"damping": [2.0, 2.0, 0.01, 0.02]}),
    ("controlled_leg", "sliding_mode", 500.0, {"law": "exponential", "boundary_layer": 0.6}),
    ("controlled_four_bar", "qp_tracking", 100.0, {}),
    ("controlled_arm7", "super_twisting", 1000.0, {"disturbance_rate": 400.0}),
]


@pytest.mark.parametrize(
    ("name", "law", "rate", "gains"),
    [*CASES, *(pytest.param(*case, marks=pytest.mark.soak) for case in MORE)],
)
def test_the_tolerable_delay_is_true_from_both_sides(name, law, rate, gains):
    """0.8 of it keeps the error within its bound; 1.5 of it is caught in 0.1 s and made safe."""
    loop = led(name, law, rate, **gains)
    tolerable = loop.watch.tolerable
    assert tolerable >= 1.0 / rate
    loop.run(BEGIN + 1.0, 0.8 * tolerable)
    assert loop.fault is None
    assert loop.worst < 1.0
    assert 0.8 * tolerable <= loop.watch.delay + 1e-9 <= tolerable + 0.1 / rate

    loop = led(name, law, rate, **gains)
    loop.run(BEGIN + 0.1 + RAMP, 1.5 * tolerable)
    assert loop.fault is not None
    t, reason = loop.fault
    assert t - BEGIN <= 0.1
    assert "loop delay" in reason
    assert loop.loop.weight == 1.0
    assert loop.fastest < 2.0
    energy = loop.energy
    loop.run(BEGIN + 1.0, 1.5 * tolerable)
    assert loop.energy < energy + 0.01  # J: nothing but gravity moves it
    assert loop.watch.faults == 1


def test_a_loop_without_an_echo_is_caught_by_speed_and_error():
    """A robot that reports no effort: the delay is not measured, the arm does not spin on."""
    loop = led("controlled_arm", "sliding_mode", 1000.0)
    loop.is_blind = True
    loop.watch.meter.reset()
    loop.run(BEGIN + 0.8, 0.02)
    assert loop.watch.delay is None
    assert loop.fault is not None
    assert loop.fault[0] < BEGIN + 0.5
    assert "speed" in loop.fault[1] or "tracking error" in loop.fault[1]
    assert loop.fastest < 4.0
    assert loop.loop.weight == 1.0


def test_a_lost_loop_comes_back_by_the_ramp_and_waits_longer_every_time():
    loop = led("controlled_arm", "sliding_mode", 1000.0)
    loop.run(BEGIN + 0.3, 0.02)
    assert loop.watch.fault
    loop.run(BEGIN + 2.5)  # the delay is gone
    assert not loop.watch.fault
    assert loop.loop.weight == 0.0
    begin = loop.live.now.t
    loop.lead()
    loop.run(begin + 0.5)
    loop.run(begin + 1.5, 0.02)
    assert loop.watch.faults == 2
    loop.run(begin + 2.0)
    assert loop.watch.fault  # two seconds now
    loop.loop.restart()  # as ~/reset does
    assert not loop.watch.fault


def test_a_gap_in_the_states_does_not_shorten_the_wait_of_a_lost_loop():
    loop = led("controlled_arm", "sliding_mode", 1000.0)
    loop.run(BEGIN + 0.3, 0.02)
    assert loop.watch.fault
    for _ in range(200):
        loop.live.tick()
    begin = loop.live.now.t
    loop.run(begin + 0.9)
    assert loop.watch.fault
    loop.run(begin + 1.5)
    assert not loop.watch.fault


def test_after_a_reset_the_first_loss_is_the_first_one_again():
    loop = led("controlled_arm", "sliding_mode", 1000.0)
    loop.run(BEGIN + 0.3, 0.02)
    loop.run(BEGIN + 2.5)
    assert loop.watch.faults == 1 and not loop.watch.fault
    loop.loop.restart()
    begin = loop.live.now.t
    loop.run(begin + 0.5)
    loop.lead()
    loop.run(begin + 1.0, 0.02)
    assert loop.watch.fault
    loop.run(begin + 2.5)
    assert not loop.watch.fault


@pytest.mark.parametrize("rate", [100.0, 1000.0])
@pytest.mark.parametrize("noise", [0.0, 0.02])
@pytest.mark.parametrize("late", [1, 4, 9])
def test_the_age_of_commands_is_found_in_their_echo(rate, noise, late):
    """Also in a measured one; constant efforts tell nothing, nor does somebody else's effort."""
    rng = np.random.default_rng(2)
    meter, h = DelayMeter(3), 1.0 / rate
    sent = np.cumsum(rng.normal(size=(300, 3)), axis=0)
    for k in range(300):
        echo = sent[k - late] if k >= late else np.zeros(3)
        meter.measure(k * h, echo + noise * rng.normal(size=3), h)
        meter.send(k * h, sent[k])
    assert meter.delay == pytest.approx((late - 1) * h, abs=1e-9)
    for strange in (np.ones((300, 3)), rng.normal(size=(300, 3)), np.full((300, 3), np.nan)):
        meter.reset()
        for k in range(300):
            meter.measure(k * h, strange[k], h)
            meter.send(k * h, np.ones(3) if strange[0, 0] == 1.0 else sent[k])
        assert meter.delay is None


def stable(gains, period, delay):
    """Whether a sampled loop on a double integrator is, by the eigenvalues of its steps."""
    late = round(delay / period)
    g, h = 1.0 / 0.7, period
    kp, kd, ki, slope = (float(value[0]) for value in gains)
    n = 3 + late
    step = np.zeros((n, n))  # e, e', integral of s, then the commands on their way
    step[0, :2], step[1, 1], step[2, 2] = [1.0, h], 1.0, 1.0
    step[2, :2] = [h * slope, h]
    law = np.zeros(n)
    law[:3] = -g * np.array([kp, kd, ki])
    if late:
        step[0, 3], step[1, 3] = 0.5 * h * h, h
        for k in range(3, n - 1):
            step[k, k + 1] = 1.0
        step[n - 1] = law
    else:
        step[0] += 0.5 * h * h * law
        step[1] += h * law
    used = np.arange(n) if ki else np.delete(np.arange(n), 2)
    return np.abs(np.linalg.eigvals(step[np.ix_(used, used)])).max() < 1.0


@pytest.mark.parametrize("period", [1e-4, 1e-3, 4e-3])
@pytest.mark.parametrize(
    "gains",
    [
        pd_gains(np.array([400.0]), np.array([40.0])),
        pd_gains(np.array([2500.0]), np.array([60.0])),
        sliding_gains(np.array([20.0]), np.array([120.0])),
        sliding_gains(np.array([20.0]), np.array([70.0]), np.array([1300.0])),
        LoopGains(*(np.array([value]) for value in (900.0, 55.0, 300.0, 10.0))),
    ],
)
def test_the_tolerable_delay_is_that_of_the_eigenvalues(gains, period):
    """Of the exactly sampled loop: the last stable one, to 5 % and one period; or the cap."""
    (found,) = tolerable_delay(gains, period)
    assert stable(gains, period, found) or found == 0.0
    if found < 0.04 - period:
        assert not stable(gains, period, 1.05 * found + 2.0 * period)


def test_gains_that_leave_no_room_say_so():
    loop = DelayedLoop("controlled_arm", "gravity_compensation", 1000.0, damping=5.0)
    loop.run(0.02)
    assert loop.watch.tolerable == 0.0
    assert "the gains tolerate no delay at a period of 1 ms" in loop.watch.warnings()


@pytest.mark.parametrize("name", ["controlled_arm", "controlled_four_bar"])
def test_where_gains_leave_no_room_error_and_speed_decide(name):
    """At 100 Hz, with commands that act a period late as in any loop that is not in lock step."""
    loop = DelayedLoop(name, "sliding_mode", 100.0)
    loop.run(0.5, 0.01)
    loop.lead()
    loop.run(2.5, 0.01)
    assert loop.watch.tolerable == 0.0
    assert loop.watch.delay == pytest.approx(0.01)
    assert loop.worst > 1.0  # the tolerable delay is true
    assert any("the gains tolerate no delay" in text for text in loop.watch.warnings())
    assert loop.fault is None and loop.fastest < 1.0
    loop.run(4.0, 0.04)
    assert loop.fault is not None and "loop delay" not in loop.fault[1]
