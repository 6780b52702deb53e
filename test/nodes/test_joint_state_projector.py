"""The node `joint_state_projector` over DDS; numbers in test names are those of faults.md."""

import gc
import math
import signal
import sys
import time
from contextlib import contextmanager

import numpy as np
import pytest
from deadline import DEADLINE, PATIENT
from nodes.joint_stream import ACTIVE, MS, parameter_file
from nodes.node_process import NodeProcess
from nodes.probe import Probe
from nodes.simulation_client import DEEP
from places import RECORDINGS, ROOT
from rclpy.experimental import EventsExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from state_projection import FOUR_BAR, LEG, SCENES, measured, nearest_in_z, projector
from std_msgs.msg import Float64MultiArray, String
from std_srvs.srv import Trigger

from mbd_ros.files.bags.bag_reader import raw_messages
from mbd_ros.jobs.domain_claim import claimed_domain
from mbd_ros.scene.reader import load_scene
from mbd_ros.scene.runs.simulation import build_simulation
from msg_adapters.diagnostics import ERROR, OK, STALE, WARN
from msg_adapters.joint_state import JointStateWriter, write_joint_state
from msg_adapters.time import read_time, write_time

NAME = "/joint_state_projector"
TARGET = ("-m", "mbd_ros.nodes", "joint_state_projector")
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
NAN = math.nan
MOMENT = 0.01  # s of silence
REVOLUTE, SLIDE = 5e-3, 3e-4  # rad, m: noise


class Stream:
    """Sends joint states to a node and keeps what it answers."""

    def __init__(self, node, probe, scene):
        self.node, self.probe, self.scene = node, probe, scene
        self.joints = tuple(joint.name for joint in scene.robot.joints)
        self.states, self.forces, self.violations = [], [], []
        create = probe.node.create_subscription
        self._subscriptions = [
            create(JointState, f"{NAME}/joint_states", self.states.append, DEEP),
            create(JointState, f"{NAME}/constraint_forces", self.forces.append, DEEP),
            create(Float64MultiArray, f"{NAME}/violation", self.violations.append, DEEP),
        ]
        self.publisher = probe.node.create_publisher(JointState, "/joint_states", DEEP)
        self.begin = time.time_ns()

    def connect(self):
        """Until a joint state is answered on every topic there is: a first one may be lost."""
        self.probe.spin_until(self.publisher.get_subscription_count)
        self.probe.spin_until(lambda: all(s.get_publisher_count() for s in self._subscriptions))
        self.probe.spin_until(self._is_answered)
        self.probe.state(NAME)  # all that was sent is answered

    def _is_answered(self):
        x = self.scene.initial
        columns = [self.scene.robot.joint(name).q for name in self.joints]
        self.send(0, x.q[columns], stamp=time.time_ns())
        return self.states and self.violations

    def reset(self, begin=None):
        assert self.probe.call(Trigger, f"{NAME}/reset", Trigger.Request()).success
        self.begin = time.time_ns() if begin is None else begin
        for answers in (self.states, self.forces, self.violations):
            answers.clear()

    def stamp(self, k):
        return self.begin + round(k * 10 * MS)

    def send(self, k, q, v=None, names=None, **changes):
        """Sample k [10 ms], q and v in the order of the names."""
        names = self.joints if names is None else names
        fields = {"position": q, **({} if v is None else {"velocity": v})}
        message = write_joint_state(
            JointState(), changes.pop("stamp", self.stamp(k)), names, **fields
        )
        for field, values in changes.items():
            setattr(message, field, values)
        self.publisher.publish(message)

    def answers(self, count):
        """The newest state, forces and violation once `count` were answered."""
        topics = (self.states, self.forces, self.violations)
        self.probe.spin_until(lambda: min(map(len, topics)) >= count)
        return self.states[count - 1], self.forces[count - 1], self.violations[count - 1]

    def ask(self, k, q, v=None, names=None, **changes):
        seen = len(self.states)
        self.send(k, q, v, names, **changes)
        return self.answers(seen + 1)

    def dropped(self, reason):
        own = [h for h in self.probe.health if h.name == NAME]
        return int(own[-1].values.get(f"dropped.{reason}", 0)) if own else 0

    def assert_finite(self):
        for message in self.states + self.forces:
            for values in (message.position, message.velocity, message.effort):
                assert all(map(math.isfinite, values)), message
        assert all(math.isfinite(x) for message in self.violations for x in message.data)


@contextmanager
def live(
    domain, folder, scene_path, *, code=0, stop=signal.SIGINT, description=None, **parameters
):
    """A running node that must end with exit code `code`, if 0 without a traceback."""
    file = parameter_file(folder, {"scene": scene_path, **PATIENT, **parameters})
    words = [sys.executable, *TARGET, "--ros-args", "--params-file", str(file)]
    node = NodeProcess(words, domain)
    try:
        with Probe(domain) as probe:
            stream = Stream(node, probe, load_scene(scene_path))
            node.wait_for(ACTIVE)
            stream.connect()
            yield stream
            stream.assert_finite()
            assert node.stop(stop) == code, node.log
            assert code or "Traceback" not in node.log
    finally:
        if node.process.poll() is None:
            node.process.kill()
            node.wait()


@pytest.fixture(scope="module")
def running_leg(tmp_path_factory):
    folder, scene = tmp_path_factory.mktemp("leg"), SCENES / f"{LEG}.yaml"
    options = {"violation_tolerance": 0.002}
    with claimed_domain() as own, live(own, folder, scene, **options) as stream:
        yield stream


def motion(scene, k, straight=False):
    """A consistent state of the leg at sample k: it swings, with the knee at its end or not."""
    t = 0.01 * k
    z = np.array([0.3 + 0.1 * np.sin(t), -0.8 + 0.3 * np.sin(2 * t), 0.1 * np.cos(t)])
    w = np.array([0.1 * np.cos(t), 0.6 * np.cos(2 * t), -0.1 * np.sin(t)])
    if straight:
        z[1] = 0.0
    q, v = np.zeros(5), np.zeros(5)
    q[scene.couplings.q_index], v[scene.couplings.v_index] = z, w
    scene.couplings.expand(q, v, np.zeros(5))
    return q, v


@pytest.fixture
def leg(running_leg):
    """The shared leg with an empty past, proven to work before and after the test."""

    def prove():
        running_leg.reset()
        q, v = motion(running_leg.scene, 0)
        state, _, _ = running_leg.ask(0, q, v)
        np.testing.assert_allclose(state.position, q, rtol=0, atol=1e-12)
        np.testing.assert_allclose(state.velocity, v, rtol=0, atol=1e-12)

    prove()
    yield running_leg
    running_leg.assert_finite()
    prove()


def assert_dropped(stream, reason, count):
    """Diagnostics count `count` more drops than before for a reason."""
    before, key = stream.dropped(reason), f"dropped.{reason}"
    return lambda: stream.probe.wait_health(lambda h: int(h.values.get(key, 0)) == before + count)


def noisy(scene, k, rng, straight):
    q, v = motion(scene, k, straight)
    size = np.array([REVOLUTE if j.kind == "revolute" else SLIDE for j in scene.robot.joints])
    return q + size * rng.normal(size=5), v + 10 * size * rng.normal(size=5)


def expected_of(scene, ours, q, v, missing=()):
    """Oracle, with the mass matrix where dropped joints are on their coupling."""
    q = q.copy()
    for name in missing:
        row = scene.robot.joint(name).q
        q[row] = scene.couplings.positions(q[scene.couplings.q_index])[row]
    m = measured(q, v, missing, scene)
    return nearest_in_z(scene, ours.system, m, ours.lower, ours.upper)


# ---------------------------------------------------------------------- what it is for


@pytest.mark.parametrize("missing", [(), ("knee_slide_x",)])
@pytest.mark.parametrize("straight", [False, True])
def test_noise_bias_and_a_dropped_joint_against_another_solver(leg, missing, straight):
    """On the manifold to 1e-12, as quadprog says to 1e-8, limits kept; at 1 kHz of stamps."""
    scene, ours = projector(LEG)
    rng, slide = np.random.default_rng(0), leg.joints.index("knee_slide_y")
    names = [name for name in leg.joints if name not in missing]
    columns = [leg.joints.index(name) for name in names]
    leg.reset()
    beyond = 0
    for k in range(60):
        q, v = noisy(scene, k, rng, straight)
        q[slide] += 0.004
        order = rng.permutation(len(names))
        state, force, violation = leg.ask(
            10 * k, q[columns][order], v[columns][order], [names[i] for i in order]
        )
        assert tuple(state.name) == leg.joints
        x, w = np.array(state.position), np.array(state.velocity)
        np.testing.assert_allclose(
            x, scene.couplings.positions(x[scene.couplings.q_index]), rtol=0, atol=1e-12
        )
        np.testing.assert_allclose(
            w, scene.couplings.jacobian(x) @ w[scene.couplings.v_index], rtol=0, atol=1e-12
        )
        expected_q, expected_v = expected_of(scene, ours, q, v, missing)
        np.testing.assert_allclose(x, expected_q, rtol=0, atol=1e-8)
        np.testing.assert_allclose(w, expected_v, rtol=0, atol=1e-8)
        assert (x >= ours.lower).all() and (x <= ours.upper).all()
        _check_forces(leg, ours, q, v, x, missing, force, violation)
        beyond += q[leg.joints.index("knee")] > 0
    assert beyond >= 20 if straight else beyond == 0
    health = leg.probe.wait_health(lambda h: True)
    assert health.level == WARN
    assert "measurement violates" in health.message and "knee_slide_y by 0.00" in health.message
    assert health.values["joints reconstructed"] == (", ".join(missing) or "none")
    assert health.values["joints held"] == "none"
    assert float(health.values["largest position violation"]) > 0.002


def _check_forces(leg, ours, q, v, x, missing, force, violation):
    """Rows then limits: the multipliers explain the shift, the violation is the measured one."""
    scene, J = leg.scene, ours.system.jacobian(0.0, x)
    known = [name not in missing for name in leg.joints]
    on_couplings = scene.couplings.positions(q[scene.couplings.q_index])
    M = ours.system.mass(np.where(known, q, on_couplings)).dense
    W = np.where(np.outer(known, known), M, 0.0)
    effort = np.array(force.effort)
    assert tuple(force.name) == (*scene.couplings.dependent, *(f"{n}.limit" for n in leg.joints))
    pull = W @ (x - q)
    np.testing.assert_allclose(pull, J.T @ effort[:2] + effort[2:], rtol=0, atol=1e-9)
    raw = np.where(known, q, x)
    gap = ours.system.residual(0.0, raw)
    rate = ours.system.jacobian(0.0, raw) @ np.where(
        known, v, np.nan_to_num(leg.states[-1].velocity)
    )
    excess = raw - np.clip(raw, ours.lower, ours.upper)
    np.testing.assert_allclose(force.position, np.r_[gap, excess], rtol=0, atol=1e-12)
    expected = [np.abs(part).max() for part in (gap, rate, excess)]
    np.testing.assert_allclose(violation.data, expected, rtol=0, atol=1e-12)


def test_each_knee_joint_of_the_four_bar_is_reconstructed_on_its_branch(domain, tmp_path):
    """Along a simulated swing; the first message is far from the initial state of the scene."""
    path = SCENES / f"{FOUR_BAR}.yaml"
    scene = load_scene(path)
    states = list(build_simulation(scene, dt=0.01).run(scene.initial, 0.55))[20:]
    assert np.abs(states[0].q - scene.initial.q).max() > 0.3
    with live(domain, tmp_path, path) as stream:
        order = [scene.robot.joint(name).q for name in stream.joints]
        for missing in ("knee_anterior", "knee_tibial", "knee_posterior"):
            names = [name for name in stream.joints if name != missing]
            columns = [scene.robot.joint(name).q for name in names]
            stream.reset()
            for k, x in enumerate(states):
                state, force, violation = stream.ask(k, x.q[columns], x.v[columns], names)
                np.testing.assert_allclose(state.position, x.q[order], rtol=0, atol=1e-8)
                np.testing.assert_allclose(state.velocity, x.v[order], rtol=0, atol=1e-7)
                assert violation.data[0] <= 1e-12
            health = stream.probe.wait_health(lambda h: h.name == NAME)
            assert health.values["joints reconstructed"] == missing
            assert (health.level, health.message) == (OK, "projected states published")
        rows = [f"{part.name}.{row.name}" for part in scene.constraints for row in part.rows]
        assert list(force.name) == [*rows, *(f"{name}.limit" for name in stream.joints)]


def test_a_real_bag_passes_with_the_knee_slides_reconstructed(domain, tmp_path):
    folder = RECORDINGS / "gait10dof/walk"
    topics = {"/joint_states": "sensor_msgs/msg/JointState"}
    recorded = list(raw_messages(folder / "bag", topics))
    assert len(recorded) == 500
    with live(domain, tmp_path, folder / "scene.yaml", clock_tolerance=1e10) as stream:
        couplings = stream.scene.couplings
        stream.reset()
        for k, raw in enumerate(recorded):
            stream.publisher.publish(raw.cdr)
            if k % 50 == 49:
                stream.answers(k + 1)
        states, _, _ = stream.answers(500), None, None
        assert len(stream.states) == 500 and states
        health = stream.probe.wait_health(lambda h: h.name == NAME)
        rows = [stream.joints.index(name) for name in couplings.independent]
        from rclpy.serialization import deserialize_message

        for raw, state in zip(recorded, stream.states, strict=True):
            message = deserialize_message(raw.cdr, JointState)
            assert state.header.stamp == message.header.stamp
            q, v = np.array(state.position), np.array(state.velocity)
            given = dict(zip(message.name, message.position, strict=True))
            speeds = dict(zip(message.name, message.velocity, strict=True))
            z = np.array([given[name] for name in couplings.independent])
            w = np.array([speeds[name] for name in couplings.independent])
            np.testing.assert_allclose(q[rows], z, rtol=0, atol=1e-12)
            np.testing.assert_allclose(v[rows], w, rtol=0, atol=1e-12)
            np.testing.assert_allclose(q, couplings.positions(z), rtol=0, atol=1e-12)
            np.testing.assert_allclose(v, couplings.jacobian(q) @ w, rtol=0, atol=1e-12)
        named = set(health.values["joints reconstructed"].split(", "))
        assert named == set(couplings.dependent) and len(named) == 4
        assert not [key for key in health.values if key.startswith("dropped.")]


# ---------------------------------------------------------------------- rate


def stream_at_1_khz(stream, seconds):
    """Sent states: noise, one slide dropped, the other biased, the ankle at its end and not."""
    scene, rng = stream.scene, np.random.default_rng(0)
    ankle, q0 = scene.robot.joint("ankle"), motion(scene, 0)[0]
    q0[scene.robot.joint("knee_slide_y").q] += 0.002
    names = [name for name in stream.joints if name != "knee_slide_x"]
    columns = [stream.joints.index(name) for name in names]
    writer = JointStateWriter(JointState(), names)
    stream.reset()
    executor = EventsExecutor(context=stream.probe.node.context)
    stream.probe._executor.remove_node(stream.probe.node)
    executor.add_node(stream.probe.node)
    begin, count = time.perf_counter(), int(1000 * seconds)
    gc.disable()  # a pause of the sender would become a burst
    try:
        for i in range(count):
            while (left := begin + 1e-3 * i - time.perf_counter()) > 0:
                executor.spin_once(timeout_sec=left)
            q = q0 + 1e-4 * rng.normal(size=5)
            q[ankle.q] = ankle.upper + 0.01 * math.sin(0.01 * i)
            values = {"position": q[columns], "velocity": 0.0, "effort": 0.0}
            stream.publisher.publish(writer.write(time.time_ns(), **values))
        end = time.perf_counter() + DEADLINE
        while len(stream.violations) < count and time.perf_counter() < end:
            executor.spin_once(timeout_sec=0.05)
    finally:
        gc.enable()
        executor.remove_node(stream.probe.node)
        stream.probe._executor.add_node(stream.probe.node)
    return count


@pytest.mark.soak  # a busy machine decides
@pytest.mark.parametrize("seconds", [60.0])
def test_no_message_is_lost_at_1_khz(seconds, domain, tmp_path):
    with live(domain, tmp_path, SCENES / f"{LEG}.yaml") as stream:
        busy = stream.node.cpu_seconds()
        sent = stream_at_1_khz(stream, seconds)
        busy = (stream.node.cpu_seconds() - busy) / sent
        assert len(stream.states) == len(stream.forces) == len(stream.violations) == sent
        stamps = [read_time(state.header.stamp) for state in stream.states]
        assert stamps == sorted(stamps)
        assert busy < 1e-3, f"{busy * 1e6:.0f} us per message"
        assert not [key for key in stream.probe.health[-1].values if key.startswith("dropped.")]


# ---------------------------------------------------------------------- faults


MALFORMED = [
    ({"position": [0.3]}, "position has 1 values for 5 names"),
    ({"velocity": [0.3] * 6}, "velocity has 6 values for 5 names"),
    ({"name": []}, "name is empty"),
    ({"name": ["knee"] * 5}, "name repeats knee"),
]


def test_1_2_malformed_messages_are_dropped(leg):
    check = assert_dropped(leg, "malformed", len(MALFORMED) + 2)
    for k, (changes, _) in enumerate(MALFORMED, 1):
        leg.send(k, *motion(leg.scene, k), **changes)
    for cdr in (bytes(4), bytes([0, 1, 0, 0]) + b"\xff" * 40):
        leg.publisher.publish(cdr)
    leg.ask(9, *motion(leg.scene, 9))
    assert len(leg.states) == 2
    check()
    leg.node.wait_for(f"joint_states: {MALFORMED[0][1]} (dropped for 'malformed': 1)")


def test_4_more_joints_are_ignored_and_listed_once(leg):
    for k in (1, 2, 3):
        q, v = motion(leg.scene, k)
        state, _, _ = leg.ask(k, np.r_[NAN, q], np.r_[math.inf, v], ["camera", *leg.joints])
        np.testing.assert_allclose(state.position, q, rtol=0, atol=1e-12)
    health = leg.probe.wait_health(lambda h: True)
    assert health.values["joints ignored"] == "camera"
    assert leg.node.count_logged("joints ignored: camera") == 1


def test_5_what_nothing_determines_is_held_and_then_the_output_stops(leg):
    names = [name for name in leg.joints if name != "hip_flexion"]
    columns, q0 = [leg.joints.index(name) for name in names], motion(leg.scene, 0)[0]
    for k in (5, 10):  # max_age is 100 ms
        q, v = motion(leg.scene, k)
        state, _, _ = leg.ask(k, q[columns], v[columns], names)
        assert state.position[leg.joints.index("hip_flexion")] == pytest.approx(q0[0], abs=1e-6)
    health = leg.probe.wait_health(lambda h: h.values["joints held"] == "hip_flexion")
    assert health.values["joints reconstructed"] == "none"
    for k in (11, 40, 80):
        q, v = motion(leg.scene, k)
        leg.send(k, q[columns], v[columns], names)
    leg.node.wait_for("joints missing for too long (hip_flexion)")
    assert leg.probe.set_parameter(NAME, "timeout", MOMENT).successful
    leg.probe.wait_health(lambda h: h.level == STALE)
    assert leg.probe.set_parameter(NAME, "timeout", PATIENT["timeout"]).successful
    assert len(leg.states) == 3
    leg.ask(81, *motion(leg.scene, 81))


def test_6_9_a_dependent_joint_that_is_nan_is_missing_another_one_drops_the_message(leg):
    check = assert_dropped(leg, "not_finite", 3)
    q, v = motion(leg.scene, 1)
    q_nan = q.copy()
    q_nan[leg.joints.index("knee_slide_x")] = NAN
    state, _, violation = leg.ask(1, q_nan, v)
    np.testing.assert_allclose(state.position, q, rtol=0, atol=1e-12)
    assert violation.data[0] <= 1e-12
    for bad in (NAN, math.inf, -math.inf):
        q_nan = q.copy()
        q_nan[leg.joints.index("knee")] = bad
        leg.send(2, q_nan, v)
    leg.ask(3, *motion(leg.scene, 3))
    check()


def test_8_velocities_that_are_nan_are_absent(leg):
    """Of a dependent joint: reconstructed. Of an independent one: derived from positions."""
    for k in range(1, 40):
        q, v = motion(leg.scene, k)
        slides = [leg.joints.index(f"knee_slide_{axis}") for axis in "xy"]
        v_nan = v.copy()
        v_nan[slides] = NAN
        state, _, _ = leg.ask(k, q, v_nan, effort=[NAN] * 5)
        np.testing.assert_allclose(state.velocity, v, rtol=0, atol=1e-12)
    for k in range(40, 80):
        q, v = motion(leg.scene, k)
        state, _, _ = leg.ask(k, q, None if k % 2 else [NAN, math.inf, NAN, -math.inf, NAN])
        np.testing.assert_allclose(state.position, q, rtol=0, atol=1e-12)
    np.testing.assert_allclose(state.velocity, v, rtol=0, atol=0.15)  # filters of 5 Hz lag


def test_10_a_glitch_is_dropped_and_believed_when_it_stays(leg):
    check = assert_dropped(leg, "jump", 7)
    glitch = 1.0 * (np.array(leg.joints) == "hip_flexion")  # rad in 10 ms; 16 rad/s are allowed
    for k in (1, 2, 3):
        q, v = motion(leg.scene, k)
        leg.send(k, q + glitch, v)
    leg.ask(4, *motion(leg.scene, 4))
    for k in range(5, 10):  # patience is 5
        q, v = motion(leg.scene, k)
        leg.send(k, q + glitch, v)
    state, _, _ = leg.answers(3)
    np.testing.assert_allclose(state.position, q + glitch, rtol=0, atol=1e-12)
    check()


def test_12_13_14_stamps(leg):
    q, v = motion(leg.scene, 0)
    before = time.time_ns()
    leg.reset()
    state, _, _ = leg.ask(0, q, v, stamp=0)
    assert before < read_time(state.header.stamp) < time.time_ns()
    leg.reset()
    check = assert_dropped(leg, "old", 2)
    leg.ask(20, q, v)
    leg.send(19, q, v)
    leg.send(5, q, v)
    first, _, _ = leg.ask(21, q, v)
    again, _, _ = leg.ask(21, q, v)
    assert again == first
    check()
    state, _, _ = leg.ask(-150, q, v)  # 1.7 s back, rewind is 1 s
    assert read_time(state.header.stamp) == leg.stamp(-150)
    assert leg.node.log.count("stamp 0 in joint states: receive time is used") <= 1


def test_15_a_stamp_of_another_clock_is_stale_with_both_times_and_a_hint(leg):
    before = leg.dropped("two_clocks")
    for hours in (-1, 1):
        leg.send(1, *motion(leg.scene, 1), stamp=leg.begin + hours * 3600 * 10**9)
    count = str(before + 2)
    health = leg.probe.wait_health(lambda h: h.values.get("dropped.two_clocks") == count)
    assert health.level == STALE
    assert "two clocks; does use_sim_time fit the publisher?" in health.message


def test_19_two_publishers_are_named(leg):
    second = leg.probe.node.create_publisher(JointState, "/joint_states", DEEP)
    leg.probe.wait_health(lambda h: "2 publishers (probe, probe), one was expected" in h.message)
    leg.probe.node.destroy_publisher(second)
    leg.probe.wait_health(lambda h: "2 publishers" not in h.message)


@pytest.mark.parametrize("size", [1e160, 1e308])
def test_values_that_overflow_never_become_nan_on_a_topic(leg, size):
    v = np.array([size, -size, size, size, -size])
    leg.send(1, motion(leg.scene, 1)[0], v)
    leg.reset()
    leg.ask(2, *motion(leg.scene, 2))


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("violation_tolerance", "wide", "Wrong parameter type"),
        ("violation_tolerance", NAN, "out of range"),
        ("failures", 0, "parameter 'failures' is 0 (int)"),
        ("limits", False, "read-only"),
        ("violation_tolerence", 1.0, "did you mean 'violation_tolerance'?"),
    ],
)
def test_36_a_bad_parameter_is_refused_and_the_node_lives(leg, name, value, reason):
    result = leg.probe.set_parameter(NAME, name, value)
    assert not result.successful
    assert reason in result.reason


def test_37_a_new_tolerance_is_used_at_once(leg):
    q, v = motion(leg.scene, 1)
    q[leg.joints.index("knee_slide_x")] += 0.004
    leg.ask(1, q, v)
    health = leg.probe.wait_health(lambda h: h.level == WARN)
    assert health.message == "measurement violates knee_slide_x by 0.004"
    assert leg.probe.set_parameter(NAME, "violation_tolerance", 0.01).successful
    leg.probe.wait_health(lambda h: h.level == OK)
    assert leg.probe.set_parameter(NAME, "violation_tolerance", 0.002).successful


def test_28_states_without_an_answer_are_dropped_and_in_the_end_deactivate(domain, tmp_path):
    """Speeds whose sums overflow; the good messages between them are answered."""
    with live(domain, tmp_path, SCENES / f"{LEG}.yaml", failures=5) as stream:
        q, v = motion(stream.scene, 0)
        bad = np.array([1e308, -1e308, 1e308, 1e308, -1e308])
        stream.reset()
        stream.ask(0, q, v)
        for k in range(1, 5):
            stream.send(k, q, bad)
        stream.ask(5, q, v)
        health = stream.probe.wait_health(lambda h: int(h.values.get("dropped.unsolved", 0)) == 4)
        assert health.values["state"] == "active"
        for k in range(6, 11):
            stream.send(k, q, bad)
        health = stream.probe.wait_health(lambda h: h.level == ERROR)
        assert health.message.startswith("5 joint states in a row: ")
        assert health.values["state"] == "inactive"
        assert stream.probe.change_state(NAME, "activate")
        stream.ask(11, q, v)


def test_16_17_38_clock_that_jumps_back_and_stands(domain, tmp_path):
    """On the other executor; ended by SIGTERM."""
    options = {"use_sim_time": "true", "executor": "single_threaded", "timeout": MOMENT}
    scene = SCENES / f"{LEG}.yaml"
    with live(domain, tmp_path, scene, stop=signal.SIGTERM, **options) as stream:
        clock = stream.probe.node.create_publisher(Clock, "/clock", 10)
        stream.probe.spin_until(clock.get_subscription_count)

        def set_clock(second):
            message = Clock()
            write_time(message.clock, int(second * 1e9))
            clock.publish(message)
            stream.probe.state(NAME)  # handled

        stream.reset(begin=100 * 10**9)
        stream.ask(0, *motion(stream.scene, 0))  # before the first /clock
        set_clock(100.0)
        stream.ask(1, *motion(stream.scene, 1))
        stream.probe.spin_for(2.0 * MOMENT)  # the clock stands longer than the timeout
        assert stream.probe.wait_health(lambda h: True).level == OK
        set_clock(98.0)
        stream.node.wait_for("time jumped back by 2.000 s: starting afresh")
        stream.probe.wait_health(lambda h: "no joint state answered yet" in h.message)
        stream.ask(-199, *motion(stream.scene, 0))


URDF = """<robot name="wheel">
  <link name="base"/>
  <link name="arm"><inertial><origin xyz="0.2 0 0"/><mass value="{mass}"/>
    <inertia ixx="0.01" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="wheel" type="continuous"><parent link="base"/><child link="arm"/>
    <axis xyz="0 1 0"/><limit velocity="20" effort="10"/></joint>
</robot>"""


def test_11_21_22_description_on_a_topic_and_a_wheel_that_wraps(start_node, probe, tmp_path):
    """Without rows and limits there are no constraint forces, and states pass unchanged."""
    scene = tmp_path / "scene.yaml"
    scene.write_text("robot: {description_topic: robot_description}\n")
    node = start_node(f"/**:\n  ros__parameters:\n    scene: {scene}\n", target=TARGET)
    health = probe.wait_health(lambda h: h.level == ERROR)
    assert "waiting for the robot description on robot_description" in health.message
    publisher = probe.node.create_publisher(String, "/robot_description", LATCHED)
    probe.spin_until(publisher.get_subscription_count)
    publisher.publish(String(data=URDF.format(mass=-1.0)))
    node.wait_for("mass is -1 kg, but must not be negative")
    publisher.publish(String(data=URDF.format(mass=1.0)))
    node.wait_for(ACTIVE)
    stream = Stream(node, probe, load_scene(scene, URDF.format(mass=1.0)))
    stream.connect()
    stream.reset()
    for k, turns in enumerate((0, 0, 1, 1, -1)):
        stream.send(k, [0.1 * k + 2 * math.pi * turns], [10.0])
        probe.spin_until(lambda n=k: len(stream.states) > n)
        assert stream.states[-1].position[0] == pytest.approx(0.1 * k, abs=1e-12)
    publisher.publish(String(data=URDF.format(mass=-2.0)))
    probe.wait_health(lambda h: "dropped.robot_description" in h.values)
    publisher.publish(String(data=URDF.format(mass=2.0)))
    node.wait_for("new robot description in use")
    stream.send(9, [0.5], [10.0])
    probe.spin_until(lambda: len(stream.states) == 6)
    assert stream.forces == []
    assert node.stop() == 0


def test_the_shipped_parameter_file_works_from_any_folder(domain, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    file = ROOT / "config" / "nodes" / "joint_state_projector.yaml"
    node = NodeProcess([sys.executable, *TARGET, "--ros-args", "--params-file", str(file)], domain)
    try:
        node.wait_for(ACTIVE)
        assert "WARN" not in node.log
        assert node.stop() == 0
    finally:
        node.process.kill()
