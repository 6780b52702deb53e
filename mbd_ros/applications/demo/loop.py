"""The closed loop of a demo over topics: started at t = 0, led along a reference, and stopped.

The simulator is in lock step: time stands, and each command advances it by one tick. The other
nodes live in the simulated time of /clock. On a machine under any load the physics is that of
a controller that answers every joint state before the next one.
"""

import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

from rclpy.duration import Duration
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from mbd_ros.applications.demo import topics
from mbd_ros.applications.demo.choices import LAWS
from mbd_ros.applications.demo.files import GAINS, MODEL, PLANT, RATE
from mbd_ros.applications.demo.processes import Failed, NodeCommand, running
from mbd_ros.applications.demo.recorder import Recorder
from mbd_ros.applications.demo.task import ReferenceTrajectory
from mbd_ros.files.bags.bags import BagWriter
from mbd_ros.jobs.isolated_domain import isolated_domain
from mbd_ros.jobs.progress import progress
from msg_adapters.time import NANOSECONDS, read_time

CUTOFF = 20.0  # Hz, of the derivatives of the inverse dynamics
_STALL = 10.0  # s without a joint state
_DRAIN = 2.0  # s for the last answers


class LoopRun(NamedTuple):
    """Order of a run.

    Attributes:
        folder: With the scenes and the gains.
        watched: Scene of the inverse dynamics: the true robot, without the disturbance.
        law: A key of `LAWS`.
        joints: Actuated joints.
        trajectory: Their reference.
        duration: [s].
        has_rows: Whether the plant has constraint rows.
        has_coupling: Whether it has dependent joints.
    """

    folder: Path
    watched: Path
    law: str
    joints: tuple[str, ...]
    trajectory: ReferenceTrajectory
    duration: float
    has_rows: bool
    has_coupling: bool

    @property
    def controller(self) -> str:
        """Fully qualified name of the controller."""
        return f"/{LAWS[self.law]}"


def record_loop(run: LoopRun, bag: Path) -> None:
    """Run the three nodes and record their messages.

    Raises:
        Failed: A node ends, refuses its part, or the loop stands still; or others publish here.
        DataError: The bag cannot be written.
    """
    recorded = topics.recorded(run.controller, run.has_rows, run.has_coupling)
    commands = _commands(run)
    with (
        BagWriter(bag) as writer,
        isolated_domain() as environment,
        running(commands, environment, run.folder) as processes,
    ):
        recorder = Recorder(recorded, processes.check, len(commands))
        try:
            _Lead(run, recorder).through()
        finally:
            recorder.close()
        recorder.write(writer)


def _commands(run: LoopRun) -> list[NodeCommand]:
    timed = {"use_sim_time": "true"}
    plant = {"scene": str(run.folder / PLANT), "rate": f"{RATE:.1f}", "paused": "true"}
    return [
        NodeCommand("simulator", {**plant, "lock_step": "true", "publish_clock": "true"}),
        NodeCommand(
            LAWS[run.law],
            {**timed, "scene": str(run.folder / MODEL)},
            ("-r", f"~/commands:={topics.COMMANDS}", "--params-file", str(run.folder / GAINS)),
        ),
        NodeCommand(
            "inverse_dynamics", {**timed, "scene": str(run.watched), "cutoff": f"{CUTOFF:.1f}"}
        ),
    ]


class _Lead:
    """Takes a recorded loop through its run."""

    def __init__(self, run: LoopRun, recorder: Recorder) -> None:
        self._run, self._recorder = run, recorder
        node = recorder.node
        self._reset = node.create_client(Trigger, f"{topics.SIMULATOR}/reset")
        self._pause = node.create_client(SetBool, f"{topics.SIMULATOR}/pause")
        topic = topics.reference(run.controller)
        self._trajectory = node.create_publisher(JointTrajectory, topic, 1)

    def through(self) -> None:
        """From three nodes that start to the last answer."""
        recorder, run = self._recorder, self._run
        recorder.wait(self._is_ready, "start of the nodes")
        recorder.wait(self._is_answered, "answers to the first joint state")
        recorder.messages.clear()
        self._send_reference()
        recorder.ask(self._pause, SetBool.Request(data=False))  # the first state is shown again
        for _ in progress(self._ticks(), round(run.duration * 1000), "simulating"):
            pass
        recorder.ask(self._pause, SetBool.Request(data=True))
        self._drain()

    def _is_ready(self) -> bool:
        recorder, node = self._recorder, self._recorder.node
        nodes = (topics.SIMULATOR, topics.WATCHER, self._run.controller)
        states = {name: recorder.health[name] for name in nodes if name in recorder.health}
        for name, health in states.items():
            if health.values.get("state") == "unconfigured":
                raise Failed(f"node {name} did not start: {health.message}")
        return (
            len(states) == len(nodes)
            and all(health.values.get("state") == "active" for health in states.values())
            and recorder.is_complete()
            and node.count_subscribers(topics.STATES) >= len(nodes)
            and node.count_subscribers(topics.COMMANDS) >= 2
            and self._trajectory.get_subscription_count() >= 2
        )

    def _is_answered(self) -> bool:
        """Ask for the first joint state again, until all have heard it."""
        recorder = self._recorder
        recorder.ask(self._reset, Trigger.Request())
        recorder.spin(0.2)
        received = recorder.health[topics.SIMULATOR].values["commands received"]
        return received != "0" and topics.TORQUES in recorder.newest

    def _send_reference(self) -> None:
        """The reference, whose time 0 is that of the standing clock."""
        recorder, name = self._recorder, self._run.controller
        self._trajectory.publish(_message(self._run.joints, self._run.trajectory))
        self._trajectory.wait_for_all_acked(Duration(seconds=_STALL))

        def is_taken() -> bool:
            values: Mapping[str, str] = recorder.health[name].values
            if "dropped.reference" in values:
                raise Failed(f"node {name} refuses the reference")
            return values["reference"] == "trajectory"

        recorder.wait(is_taken, "the reference to be taken")

    def _ticks(self) -> Iterator[int]:
        """One item a simulated millisecond, as time passes."""
        recorder, shown, seen, since = self._recorder, 0, -1, time.monotonic()
        while (now := self._stamp(topics.STATES)) < self._run.duration * NANOSECONDS:
            if now != seen:
                seen, since = now, time.monotonic()
            elif time.monotonic() - since > _STALL:
                raise Failed(f"the loop stands still at t = {now / NANOSECONDS:.3f} s")
            recorder.check()
            recorder.spin()
            yield from range(shown, shown := now // 1_000_000)

    def _drain(self) -> None:
        """Until the last joint state is answered, and the health after it is known."""
        recorder, end = self._recorder, time.monotonic() + _DRAIN
        while self._stamp(topics.TORQUES) < self._stamp(topics.STATES) and time.monotonic() < end:
            recorder.spin()
        last = recorder.health[topics.SIMULATOR]
        recorder.wait(lambda: recorder.health[topics.SIMULATOR] is not last, "diagnostics")

    def _stamp(self, topic: str) -> int:
        return read_time(self._recorder.read(topic).header.stamp)


def _message(joints: tuple[str, ...], trajectory: ReferenceTrajectory) -> JointTrajectory:
    message = JointTrajectory(joint_names=list(joints))
    for t, q, v, a in zip(*trajectory, strict=True):
        point = JointTrajectoryPoint(
            positions=q.tolist(), velocities=v.tolist(), accelerations=a.tolist()
        )
        since = round(t * NANOSECONDS)
        point.time_from_start.sec, point.time_from_start.nanosec = divmod(since, NANOSECONDS)
        message.points.append(point)
    return message
