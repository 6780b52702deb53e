"""~/follow_joint_trajectory of the controllers over DDS, and trajectories that ask for a part.

The test is the robot: it answers commands with joint states of its own stamps, so that no result
depends on how fast this machine is.
"""

import os

import numpy as np
import pytest
from builtin_interfaces.msg import Duration, Time
from nodes.control_client import POSE, controlled
from nodes.simulation_client import JOINTS
from rclpy.action import ActionClient
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from msg_adapters.time import NANOSECONDS

CALM = {"safe_ramp": 0.0, "reference_ramp": 0.1}
STEP = 10_000_000  # ns
TARGET = POSE + np.array([0.1, 0.0, -0.1, 0.0])
SUCCEEDED, CANCELED, ABORTED, EXECUTING = 4, 5, 6, 2  # of action_msgs/GoalStatus


def points(*positions, names=JOINTS, half=500_000_000):
    """A trajectory with a point every half second."""
    message = JointTrajectory(joint_names=list(names))
    for k, given in enumerate(positions, 1):
        point = JointTrajectoryPoint(positions=[float(x) for x in given])
        sec, nanosec = divmod(k * half, NANOSECONDS)
        point.time_from_start = Duration(sec=sec, nanosec=nanosec)
        message.points.append(point)
    return message


class Robot:
    """A controlled robot that stands, or is wherever the reference wants it to be."""

    def __init__(self, client):
        self.client, self.pose = client, POSE.copy()
        client.ask(self.pose)

    def live(self, *, stuck=False):
        """One joint state on; returns where the reference was."""
        self.client.ask(self.pose, stamp=self.client.stamp + STEP)
        wanted = self.pose - self.client.states[-1].position
        self.pose = self.pose if stuck else wanted
        return wanted

    def live_for(self, seconds, **how):
        """The reference after so much time of the stamps."""
        for _ in range(round(seconds * NANOSECONDS / STEP)):
            wanted = self.live(**how)
        return wanted


# ---------------------------------------------------------------------- topic


def test_a_trajectory_of_some_joints_leaves_the_others_where_they_are(domain, tmp_path):
    with controlled(domain, tmp_path, **CALM) as client:
        robot = Robot(client)
        client.lead(points([0.7, 0.2], names=[JOINTS[0], JOINTS[2]]))
        end = robot.live_for(0.6)
        np.testing.assert_allclose(end, [0.7, POSE[1], 0.2, POSE[3]], atol=1e-9)
        client.node.wait_for("held: not given")
        client.lead(points([0.1], names=[JOINTS[1]]))
        end = robot.live_for(0.6)
        np.testing.assert_allclose(end, [0.7, 0.1, 0.2, POSE[3]], atol=1e-9)


@pytest.mark.parametrize("names", [(), JOINTS, JOINTS[:1]])
def test_an_empty_trajectory_stops_at_what_is_measured(domain, tmp_path, names):
    with controlled(domain, tmp_path, **CALM) as client:
        robot = Robot(client)
        client.lead(points(TARGET))
        robot.live_for(0.25)
        assert not np.allclose(robot.pose, TARGET, atol=1e-3)
        client.lead(JointTrajectory(joint_names=list(names)))
        before = robot.pose.copy()
        end = robot.live_for(0.5)
        np.testing.assert_allclose(end, before, atol=5e-3)
        assert client.wait_health(lambda h: h.values["reference"] == "held")
        client.lead(JointTrajectory(joint_names=["thumb"]))
        client.node.wait_for("thumb not controlled")


# ---------------------------------------------------------------------- without the messages


def test_without_control_msgs_the_node_says_so_and_works(domain, tmp_path, monkeypatch):
    hiding = tmp_path / "hiding" / "control_msgs"
    hiding.mkdir(parents=True)
    text = "raise ModuleNotFoundError('hidden', name='control_msgs')\n"
    (hiding / "__init__.py").write_text(text)
    monkeypatch.setenv("PYTHONPATH", str(hiding.parent), prepend=os.pathsep)
    with controlled(domain, tmp_path, **CALM) as client:
        action = f"{client.name}/follow_joint_trajectory"
        client.node.wait_for(f"no action {action}: control_msgs is not installed")
        health = client.wait_health(lambda h: "action" in h.values)
        assert health.values["action"].startswith("none: control_msgs is not installed")
        robot = Robot(client)
        client.lead(points(TARGET))
        np.testing.assert_allclose(robot.live_for(0.6), TARGET, atol=1e-9)


# ---------------------------------------------------------------------- the action


class Leader:
    """An action client."""

    def __init__(self, client):
        kind = pytest.importorskip(
            "control_msgs.action", reason="control_msgs is not installed (a ROS package, no wheel)"
        )
        self.action, self._messages = (
            kind.FollowJointTrajectory,
            pytest.importorskip("control_msgs.msg"),
        )
        self._client, self._probe = client, client.probe
        name = f"{client.name}/follow_joint_trajectory"
        self._actions = ActionClient(client.probe.node, self.action, name)
        client.probe.spin_until(self._actions.server_is_ready)
        self.feedback = []

    def wait(self, future):
        self._probe.spin_until(future.done)
        return future.result()

    def tolerance(self, name, **values):
        return self._messages.JointTolerance(name=name, **values)

    def send(self, trajectory, path=(), goal=(), time=0.0, **more):
        """Goal handle of a request."""
        sec, nanosec = divmod(round(time * NANOSECONDS), NANOSECONDS)
        request = self.action.Goal(
            trajectory=trajectory,
            path_tolerance=list(path),
            goal_tolerance=list(goal),
            goal_time_tolerance=Duration(sec=sec, nanosec=nanosec),
            **more,
        )
        sent = self._actions.send_goal_async(request, self._keep)
        return self.wait(sent)

    def result(self, handle, robot, **how):
        """Status and result, while the robot lives."""
        future = handle.get_result_async()
        for _ in range(500):
            if future.done():
                break
            robot.live(**how)
            self._client.handled()
        answer = self.wait(future)
        return answer.status, answer.result

    def _keep(self, message):
        self.feedback.append(message.feedback)


@pytest.fixture(params=["events", "single_threaded"])
def executor(request):
    return request.param


def test_a_goal_is_reached_with_feedback_on_the_way(domain, tmp_path, executor):
    pytest.importorskip("control_msgs", reason="control_msgs is not installed")
    with controlled(domain, tmp_path, **CALM, executor=executor) as client:
        leader, robot = Leader(client), Robot(client)
        handle = leader.send(points([TARGET[0]], [TARGET[0] + 0.1], names=JOINTS[:1]))
        assert handle.accepted
        robot.live_for(0.3)
        client.probe.spin_until(lambda: handle.status == EXECUTING)
        status, result = leader.result(handle, robot)
        assert (status, result.error_code, result.error_string) == (SUCCEEDED, 0, "goal reached")
        end = POSE + np.array([0.2, 0.0, 0.0, 0.0])
        np.testing.assert_allclose(robot.live_for(0.1), end, atol=1e-9)
        times = [
            f.desired.time_from_start.sec + f.desired.time_from_start.nanosec * 1e-9
            for f in leader.feedback
        ]
        assert 20 <= len(times) <= 24 and times == sorted(times) and times[-1] >= 1.0
        for feedback in leader.feedback:
            assert tuple(feedback.joint_names) == JOINTS
            desired, actual = (np.array(p.positions) for p in (feedback.desired, feedback.actual))
            np.testing.assert_allclose(np.array(feedback.error.positions), desired - actual)
        assert leader.feedback[0].desired.velocities[0] != 0.0
        client.wait_health(
            lambda h: h.values["action"] == f"{client.name}/follow_joint_trajectory"
        )


def test_a_joint_that_stays_behind_aborts_with_its_name(domain, tmp_path):
    pytest.importorskip("control_msgs", reason="control_msgs is not installed")
    late = {"constraints__goal": [0.05], "constraints__goal_time": 0.2}
    with controlled(domain, tmp_path, **CALM, **late) as client:
        leader, robot = Leader(client), Robot(client)
        handle = leader.send(points(TARGET), path=[leader.tolerance(JOINTS[2], position=0.02)])
        status, result = leader.result(handle, robot, stuck=True)
        assert (status, result.error_code) == (ABORTED, result.PATH_TOLERANCE_VIOLATED)
        assert (
            f"{JOINTS[2]} is 0.0" in result.error_string and "accepted 0.02" in result.error_string
        )
        np.testing.assert_allclose(robot.live_for(0.2, stuck=True), POSE, atol=1e-9)
        begin = client.stamp
        handle = leader.send(points(TARGET))
        status, result = leader.result(handle, robot, stuck=True)
        assert (status, result.error_code) == (ABORTED, result.GOAL_TOLERANCE_VIOLATED)
        assert "is 0.1 off, accepted 0.05" in result.error_string
        assert 0.7 <= (client.stamp - begin) * 1e-9 < 1.0
        np.testing.assert_allclose(robot.live_for(0.2, stuck=True), POSE, atol=1e-9)
        patient = [leader.tolerance(name, position=-1.0) for name in JOINTS]
        handle = leader.send(points(TARGET), goal=patient)
        assert leader.result(handle, robot, stuck=True)[0] == SUCCEEDED


def test_cancel_new_goals_topics_and_safe_commands_end_a_goal(domain, tmp_path):
    pytest.importorskip("control_msgs", reason="control_msgs is not installed")
    with controlled(domain, tmp_path, **CALM) as client:
        leader, robot = Leader(client), Robot(client)
        handle = leader.send(points(TARGET))
        robot.live_for(0.2)
        leader.wait(handle.cancel_goal_async())
        here = robot.pose.copy()
        assert leader.result(handle, robot)[0] == CANCELED
        np.testing.assert_allclose(robot.live_for(0.5), here, atol=5e-3)

        first = leader.send(points(TARGET))
        robot.live_for(0.1)
        second = leader.send(points(POSE))
        status, result = leader.result(first, robot)
        assert (status, result.error_code) == (ABORTED, result.INVALID_GOAL)
        assert result.error_string == "preempted by a new goal"
        assert leader.result(second, robot)[0] == SUCCEEDED

        stop = leader.send(JointTrajectory())
        assert leader.result(stop, robot)[0] == SUCCEEDED

        handle = leader.send(points(TARGET))
        client.refer(POSE)
        status, result = leader.result(handle, robot)
        assert status == ABORTED and "something else is followed" in result.error_string

        robot.live_for(1.0)
        handle = leader.send(points(TARGET))
        client.be_patient(False)  # and no joint state comes
        answer = leader.wait(handle.get_result_async())
        assert answer.status == ABORTED and "joint states stopped" in answer.result.error_string

        client.be_patient()
        client.ask(robot.pose)
        here = robot.pose.copy()
        np.testing.assert_allclose(robot.live_for(0.6), here, atol=1e-9)
        handle = leader.send(points(TARGET))
        assert handle.accepted
        assert client.probe.change_state(client.name, "deactivate")
        answer = leader.wait(handle.get_result_async())
        assert answer.status == ABORTED and "the safe command" in answer.result.error_string
        assert not leader.send(points(TARGET)).accepted
        client.node.wait_for("goal refused: the controller is inactive")


def test_a_lost_loop_ends_a_goal_which_does_not_go_on_when_control_comes_back(domain, tmp_path):
    pytest.importorskip("control_msgs", reason="control_msgs is not installed")
    with controlled(domain, tmp_path, **CALM, error_limit=5.0) as client:
        leader, robot = Leader(client), Robot(client)
        handle = leader.send(points(POSE + 0.4, half=4 * NANOSECONDS))
        status, result = leader.result(handle, robot, stuck=True)
        assert status == ABORTED
        assert "the loop was lost" in result.error_string
        assert "tracking error" in result.error_string
        assert not leader.send(points(TARGET)).accepted
        client.node.wait_for("goal refused: the loop was lost")
        np.testing.assert_allclose(robot.live_for(1.5, stuck=True), POSE, atol=1e-9)
        assert leader.result(leader.send(points(TARGET)), robot)[0] == SUCCEEDED


def test_goals_that_cannot_be_followed_are_rejected_each_with_its_reason(domain, tmp_path):
    pytest.importorskip("control_msgs", reason="control_msgs is not installed")
    with controlled(domain, tmp_path, **CALM) as client:
        leader = Leader(client)
        assert not leader.send(points(TARGET)).accepted
        client.node.wait_for("no joint state yet")
        robot = Robot(client)
        old = points(TARGET)
        old.header.stamp = Time(sec=1)
        joint, far = JOINTS[0], points(TARGET + 9.0)
        twice = points(TARGET, TARGET)
        twice.points[1].time_from_start = twice.points[0].time_from_start
        unknown, accelerated = leader.tolerance("thumb"), leader.tolerance(joint, acceleration=1.0)
        multi = leader.action.Goal().multi_dof_trajectory
        multi.joint_names = ["base"]
        for reason, trajectory, more in (
            ("thumb not controlled", points([0.1], names=["thumb"]), {}),
            ("it ended", old, {}),
            (f"{joint} at", far, {}),
            ("must increase", twice, {}),
            ("positions of [3] values", points(TARGET[:3]), {}),
            ("path_tolerance of 'thumb'", points(TARGET), {"path": [unknown]}),
            ("carry no accelerations", points(TARGET), {"goal": [accelerated]}),
            ("3001 points, accepted: 3000", points(*[TARGET] * 3001, half=1_000_000), {}),
            (
                "multi_dof_trajectory: joints have one",
                points(TARGET),
                {"multi_dof_trajectory": multi},
            ),
        ):
            assert not leader.send(trajectory, **more).accepted, reason
            client.node.wait_for(reason)
        client.wait_health(lambda h: h.values.get("dropped.goal") == "10")
        assert leader.result(leader.send(points(TARGET)), robot)[0] == SUCCEEDED
