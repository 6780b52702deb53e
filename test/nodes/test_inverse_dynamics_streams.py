"""Streams to the real node: what arrives in another order or form must not matter."""

import sys
import time

import numpy as np
import pytest
from inverse_dynamics_streams import motion, offline, play
from nodes.joint_stream import ACTIVE, DEEP, SCENES, TARGET, WrenchStream, live
from nodes.node_process import NodeProcess
from places import RECORDINGS, ROOT
from rcl_interfaces.srv import GetParameters
from sensor_msgs.msg import JointState

from mbd_ros.jobs.domain_claim import claimed_domain
from mbd_ros.methods.inverse_dynamics.torque_estimator import TorqueEstimator, Tuning
from msg_adapters.diagnostics import OK, STALE, WARN
from msg_adapters.joint_state import write_joint_state

ARM = SCENES / "prosthetic_arm.yaml"
LOAD = np.array([30.0, -20.0, 700.0, 4.0, -60.0, 2.0])


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    folder = tmp_path_factory.mktemp("arm")
    with claimed_domain() as own, live(own, folder, ARM) as stream:
        yield stream


# ---------------------------------------------------------------------- order and estimate


@pytest.mark.parametrize("with_velocity", [True, False])
def test_live_estimate_is_the_offline_one_whatever_the_order_of_the_names(arm, with_velocity):
    """Ordered, and shuffled from message to message, with joints that are not asked for."""
    offsets, q, v = motion(60, 4)
    v = v if with_velocity else np.full_like(v, np.nan)
    expected = offline(arm.scene, offsets, q, v)

    def ordered(i, stamp):
        fields = {"velocity": v[i]} if with_velocity else {}
        return write_joint_state(JointState(), stamp, arm.joints, position=q[i], **fields)

    order = np.random.default_rng(1)

    def shuffled(i, stamp):
        names, chosen = [*arm.joints, "thumb"], order.permutation(5)
        position, velocity = np.r_[q[i], 9.0][chosen], np.r_[v[i], 9.0][chosen]
        return write_joint_state(
            JointState(), stamp, [names[k] for k in chosen], position=position, velocity=velocity
        )

    for message in (ordered, shuffled):
        for live_values, offline_values in zip(play(arm, offsets, message), expected, strict=True):
            np.testing.assert_allclose(live_values, offline_values, rtol=0, atol=1e-12)


def test_mimic_joints_absent_present_and_shuffled(domain, tmp_path):
    """The prosthetic hand: ten joints of which four follow another."""
    urdf = RECORDINGS / "psyonic_hand/psyonic_ability_hand_right_large.urdf"
    scene = tmp_path / "hand.yaml"
    scene.write_text(f"robot: {{urdf: {urdf}}}\n")
    (folder := tmp_path / "node").mkdir()
    with live(domain, folder, scene) as stream:
        couplings, model = stream.scene.couplings, stream.scene.robot.model
        assert len(couplings.dependent) == 4
        offsets, z, w = motion(25, len(stream.joints))
        q, v = (np.zeros((model.nq, len(offsets))) for _ in range(2))
        q[couplings.q_index], v[couplings.v_index] = z.T, w.T
        couplings.expand(q, v, np.zeros_like(v))
        names = stream.joints + couplings.dependent
        rows = [stream.scene.robot.joint(name).q for name in names]
        order = np.random.default_rng(2)

        def message(chosen):
            def make(i, stamp):
                these = chosen()
                columns = [rows[k] for k in these]
                return write_joint_state(
                    JointState(),
                    stamp,
                    [names[k] for k in these],
                    position=q[columns, i],
                    velocity=v[columns, i],
                )

            return make

        n, total = len(stream.joints), len(names)
        expected = offline(stream.scene, offsets, z, w)
        for chosen in (lambda: range(n), lambda: range(total), lambda: order.permutation(total)):
            answers = play(stream, offsets, message(chosen))
            for live_values, offline_values in zip(answers, expected, strict=True):
                np.testing.assert_allclose(live_values, offline_values, rtol=0, atol=1e-12)
        assert np.abs([force.position for force in stream.forces]).max() < 1e-12


def test_two_partial_publishers_with_the_same_stamps(arm):
    """The arm in one message, the wrist in another; each keeps the other's last position."""
    arm.reset()
    wrist = arm.probe.node.create_publisher(JointState, "/joint_states", DEEP)
    arm.probe.spin_until(wrist.get_subscription_count)
    arm.probe.meet(arm.name)
    arm.ask(0)
    for k in range(1, 30):
        for publisher, part in ((arm, slice(0, 2)), (wrist, slice(2, 4))):
            count = len(arm.torques)
            publisher.publish(
                arm.message(
                    k,
                    name=arm.joints[part],
                    position=arm.position(k)[part],
                    velocity=arm.speed[part],
                )
            )
            arm.answers(count + 1)
        arm.check(arm.torques[-1], k)
        assert list(arm.torques[-2].position[2:]) == list(arm.position(k - 1)[2:])
    health = arm.probe.wait_health(lambda h: True)
    assert health.level == WARN
    assert "2 publishers" in health.message
    arm.probe.node.destroy_publisher(wrist)
    arm.ask(31)


# ---------------------------------------------------------------------- while running


def test_cutoff_changes_at_run_time(arm):
    offsets, q, v = motion(40, 4)
    nothing = np.full_like(v, np.nan)

    def message(i, stamp):
        return write_joint_state(JointState(), stamp, arm.joints, position=q[i])

    try:
        for cutoff in (5.0, 15.0):
            assert arm.probe.set_parameter(arm.name, "cutoff", cutoff).successful
            expected, _ = offline(arm.scene, offsets, q, nothing, Tuning(cutoff=cutoff))
            answers, _ = play(arm, offsets, message)
            np.testing.assert_allclose(answers, expected, rtol=0, atol=1e-12)
            health = arm.probe.wait_health(lambda h: True)
            filters = TorqueEstimator(
                arm.scene.robot, arm.scene.inverse_dynamics(), Tuning(cutoff=cutoff)
            ).differentiator
            assert health.values["derivatives"].startswith(f"causal, delay {filters.delay:.4f} s")
    finally:
        assert arm.probe.set_parameter(arm.name, "cutoff", 5.0).successful


def test_reset_service_forgets_the_past(arm):
    """Without the reset the second position would be a glitch, with it it is a beginning."""
    arm.reset()
    arm.ask(0)
    arm.reset(begin=arm.begin)
    far = arm.position(1) + 0.8
    arm.send(1, position=far)
    answer = arm.answers(1)[0]
    expected = arm.scene.inverse_dynamics().solve(far, arm.speed, np.zeros(4))
    np.testing.assert_allclose(answer.effort, expected.tau, atol=1e-9)


def test_deactivate_stops_the_output_and_activate_begins_afresh(arm):
    arm.reset()
    arm.ask(0)
    assert arm.probe.change_state(arm.name, "deactivate")
    for k in range(1, 5):
        arm.send(k)
    health = arm.probe.wait_health(lambda h: True)
    assert (health.level, health.message) == (WARN, "inactive")
    assert len(arm.torques) == 1
    assert arm.probe.change_state(arm.name, "activate")
    arm.begin = time.time_ns()
    far = arm.position(0) + 0.8
    arm.send(0, position=far)
    assert list(arm.answers(2)[1].position) == list(far)


def test_cleanup_and_configure_build_the_node_again(arm):
    for label in ("deactivate", "cleanup"):
        assert arm.probe.change_state(arm.name, label)
    arm.probe.spin_until(lambda: not arm.probe.node.count_subscribers("/joint_states"))
    for label in ("configure", "activate"):
        assert arm.probe.change_state(arm.name, label)
    arm.connect()
    arm.reset()
    arm.ask(0)
    arm.ask(1)
    health = arm.probe.wait_health(lambda h: True)
    assert (health.level, health.message) == (OK, "torques published")


def test_the_shipped_parameter_file_works_from_any_folder(domain, probe, tmp_path, monkeypatch):
    """And says what the parameters are by default."""
    monkeypatch.chdir(tmp_path)
    file = ROOT / "config" / "nodes" / "inverse_dynamics.yaml"
    command = [sys.executable, *TARGET, "--ros-args", "--params-file", str(file)]
    node = NodeProcess(command, domain)
    try:
        node.wait_for(ACTIVE)
        request = GetParameters.Request(names=["cutoff", "max_age", "patience"])
        values = probe.call(GetParameters, "/inverse_dynamics/get_parameters", request).values
        tuning = Tuning()
        assert [values[0].double_value, values[1].double_value] == [tuning.cutoff, tuning.max_age]
        assert values[2].integer_value == tuning.patience
        assert "WARN" not in node.log
        assert node.stop() == 0
    finally:
        node.process.kill()


def test_namespace_and_remapping(domain, tmp_path):
    arguments = ["-r", "__ns:=/patient_7", "-r", "__node:=torques", "-r", "joint_states:=/imu/js"]
    where = {"name": "/patient_7/torques", "topic": "/imu/js"}
    with live(domain, tmp_path, ARM, arguments, **where) as stream:
        stream.reset()
        answers = [stream.ask(k) for k in range(5)]
        assert len(answers) == len(stream.torques)


# ---------------------------------------------------------------------- wrenches


WAIT = 10.0  # s for a wrench: longer than a busy machine takes to send it


@pytest.fixture(scope="module")
def stance(tmp_path_factory):
    folder, scene = tmp_path_factory.mktemp("leg"), SCENES / "prosthetic_leg_stance.yaml"
    options = {"wrench_wait": WAIT}
    with claimed_domain() as own, live(own, folder, scene, **options) as stream:
        yield stream, WrenchStream(stream, "/force_plate")


@pytest.fixture
def short_wait(stance):
    """A function: joint states wait but a moment for their wrench from now on; how long [s]."""
    stream, _ = stance

    def shorten():
        assert stream.probe.set_parameter(stream.name, "wrench_wait", 0.1).successful
        return 0.1

    yield shorten
    assert stream.probe.set_parameter(stream.name, "wrench_wait", WAIT).successful


@pytest.mark.parametrize("order", ["before", "after", "interpolated"])
def test_a_wrench_before_and_after_its_joint_state_give_the_same(stance, order):
    stream, plate = stance
    stream.reset()
    plate.send(-1, LOAD)
    for k in range(5):
        load = LOAD * (1 + 0.1 * k)
        if order == "before":
            plate.send(k, load)
            handled(stream)
            stream.send(k)
        elif order == "after":
            stream.send(k)
            handled(stream)
            plate.send(k, load)
        else:
            stream.send(k)
            plate.send(k - 0.5, load - 0.05 * LOAD)
            plate.send(k + 0.5, load + 0.05 * LOAD)
        answer = stream.answers(k + 1)[k]
        stream.check(answer, k, [load])
    assert len(stream.torques) == 5


def test_joint_states_that_wait_are_answered_in_order(stance):
    stream, plate = stance
    stream.reset()
    for k in range(10):
        stream.send(k)
    handled(stream)
    assert stream.torques == []
    for k in range(10):
        plate.send(k, LOAD * k)
    for k, answer in enumerate(stream.answers(10)):
        stream.check(answer, k, [LOAD * k])


def test_a_late_wrench_is_replaced_by_the_last_one_after_the_wait(stance, short_wait):
    stream, plate = stance
    stream.reset()
    plate.send(0, LOAD)
    stream.ask(0, [LOAD])
    wait, begin = short_wait(), time.monotonic()
    stream.ask(5, [LOAD])  # 50 ms later, younger than wrench_max_age
    assert time.monotonic() - begin >= wait


def test_a_stream_that_begins_anew_never_meets_the_wrenches_of_before(stance):
    """Both streams jump back by 1.5 s, the joint state is heard first."""
    stream, plate = stance
    stream.reset()
    for k in range(0, 160, 10):
        plate.send(k, LOAD)
    handled(stream)
    stream.ask(150, [LOAD])
    stream.send(0)
    handled(stream)
    assert len(stream.torques) == 1
    plate.send(0, 2 * LOAD)
    stream.check(stream.answers(2)[1], 0, [2 * LOAD])


def test_reset_and_deactivation_empty_the_queue_and_the_buffers(stance, short_wait):
    stream, plate = stance
    handled(stream)
    before = drops(stream.probe.wait_health(lambda h: True))
    stream.reset()
    plate.send(0, LOAD)
    stream.ask(0, [LOAD])
    stream.send(1)
    stream.reset(begin=stream.begin)
    short_wait()
    stream.send(2)
    stream.probe.wait_health(lambda h: drops(h) == before + 1)
    assert stream.torques == []
    assert stream.probe.change_state(stream.name, "deactivate")
    stream.begin = time.time_ns()
    plate.send(2, LOAD)
    handled(stream)
    assert stream.probe.change_state(stream.name, "activate")
    stream.send(3)
    health = stream.probe.wait_health(lambda h: drops(h) == before + 2)
    assert health.level == STALE
    assert "no joint state answered yet" in health.message
    assert stream.torques == []
    plate.send(4, LOAD)
    stream.ask(4, [LOAD])


def drops(health):
    """How many joint states lacked a wrench."""
    return int(health.values.get("dropped.no_wrench", 0))


def handled(stream):
    """Until the node has handled what was sent, and what it said of that is here."""
    stream.probe.state(stream.name)
