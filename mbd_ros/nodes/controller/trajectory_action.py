"""The action `~/follow_joint_trajectory` of a controller, where control_msgs is installed."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from rclpy.action import ActionServer, CancelResponse, GoalResponse

from mbd_ros.features.control.trajectory import (
    JointTolerance,
    Outcome,
    ReferenceTrajectory,
    ResultCode,
    TargetError,
    Tolerances,
    TrajectoryGoal,
)
from mbd_ros.nodes.controller.pipeline import ControlPipeline, Plan
from msg_adapters.errors import MessageError
from msg_adapters.follow_joint_trajectory import FeedbackWriter, read_goal

NAME = "~/follow_joint_trajectory"
ABSENT = "control_msgs is not installed (apt install ros-jazzy-control-msgs)"


class TrajectoryAction:
    """Takes one goal at a time and reports its progress and end.

    Joint states tell the progress and the end of a goal: nothing here waits, and one thread is
    enough.

    Args:
        action: `action_type()`.
        pipeline: Gives the pipeline at work.
        refused: Told why a goal was refused.
        noted: Told which joints of an accepted one were mapped or left out.
    """

    def __init__(
        self,
        node: Any,
        action: Any,
        pipeline: Callable[[], ControlPipeline],
        refused: Callable[[str], None],
        noted: Callable[[str], None],
    ) -> None:
        self._node = node
        self._action = action
        self._pipeline = pipeline
        self._refused = refused
        self._noted = noted
        self._running: _Running | None = None
        self._accepted: tuple[Plan, Tolerances] | None = None
        self._feedback = FeedbackWriter(action.Feedback(), pipeline().names)
        self._next_feedback = 0.0
        self._server = _Server(
            node,
            action,
            NAME,
            lambda handle: action.Result(),
            goal_callback=self._judge,
            handle_accepted_callback=self._begin,
            cancel_callback=self._cancel,
        )

    def update(self, stamp: int) -> None:
        """After the answer to a joint state of this stamp [ns]: feedback, perhaps the end."""
        if self._running is None:
            return
        pipeline, goal = self._pipeline(), self._running.goal
        generator = pipeline.loop.generator
        if pipeline.watch.fault:
            self.give_up(f"the loop was lost, the command goes safe: {pipeline.watch.fault}")
            return
        if generator.trajectory is not self._running.trajectory:
            self.abort("something else is followed: a reference of a topic, or after ~/reset")
            return
        t, q, v = pipeline.measured()
        ref = generator.at(t)
        outcome = goal.judge(t, q, v, ref)
        if outcome is not None or t >= self._next_feedback:
            self._next_feedback = t + 1.0 / self._node.parameters.action_monitor_rate
            message = self._feedback.write(stamp, t - goal.begin, ref, (q, v))
            self._running.handle.publish_feedback(message)
        if outcome is not None:
            if outcome.code != ResultCode.SUCCESSFUL:
                generator.hold(t, q, v)
            self._end(outcome)

    def abort(self, why: str) -> None:
        """End the goal that is followed, if there is one: others decide about the joints now."""
        if self._running is not None:
            self._end(Outcome(ResultCode.INVALID_GOAL, why))

    def give_up(self, why: str) -> None:
        """End the goal that is followed, if there is one: the safe command takes over.

        Control could continue its trajectory on return, but the client was told that the goal
        ended.
        """
        if self._running is not None:
            self._pipeline().stop()
            self.abort(why)

    def destroy(self) -> None:
        """Take the action away."""
        self.abort("the controller is no longer configured")
        self._server.destroy()

    def _judge(self, request: Any) -> GoalResponse:
        """Check a goal; the one before is followed until it begins."""
        try:
            self._accepted = self._checked(request)
        except (MessageError, TargetError) as error:
            self._refused(f"{self._node.resolve_topic_name(NAME)}: {error}")
            return GoalResponse.REJECT
        return GoalResponse.ACCEPT

    def _checked(self, request: Any) -> tuple[Plan, Tolerances]:
        if not self._node.active:
            raise TargetError(f"goal refused: the controller is {self._node.state}")
        pipeline, goal = self._pipeline(), read_goal(request)
        if pipeline.watch.fault:
            raise TargetError(f"goal refused: the loop was lost: {pipeline.watch.fault}")
        path, end = (
            [JointTolerance(*entry) for entry in given] for given in (goal.path, goal.goal)
        )
        default = tolerances(self._node.parameters, len(pipeline.names))
        within = default.of_goal(pipeline.names, path, end, goal.time)
        return pipeline.plan(goal.trajectory), within

    def _begin(self, handle: Any) -> None:
        """Follow the goal that `_judge` accepted just now, instead of the one before."""
        assert self._accepted is not None
        (plan, within), self._accepted = self._accepted, None
        self.abort("preempted by a new goal")
        pipeline = self._pipeline()
        generator = pipeline.loop.generator
        pipeline.take(plan)
        goal = TrajectoryGoal(
            pipeline.names, within, plan.begin, generator.trajectory.end, generator.end
        )
        self._running = _Running(handle, goal, generator.trajectory)
        self._next_feedback = 0.0
        self._noted(plan.note)
        handle.execute()

    def _cancel(self, handle: Any) -> CancelResponse:
        """Hold the joints; the client hears it once rclpy has noted its request."""
        if self._running is None or self._running.handle != handle:
            return CancelResponse.REJECT
        self._running = None
        pipeline = self._pipeline()
        pipeline.stop()
        self._server.notify_execute(handle, self._canceled)
        return CancelResponse.ACCEPT

    def _canceled(self, handle: Any) -> Any:
        handle.canceled()
        return self._action.Result(error_string="canceled: the joints hold where they were")

    def _end(self, outcome: Outcome) -> None:
        assert self._running is not None
        handle, self._running = self._running.handle, None
        if outcome.code == ResultCode.SUCCESSFUL:
            handle.succeed()
        else:
            handle.abort()
        result = self._action.Result(error_code=int(outcome.code), error_string=outcome.text)
        self._server.notify_execute(handle, lambda _: result)


class _Running(NamedTuple):
    """The goal that is followed, and its trajectory in the reference generator."""

    handle: Any
    goal: TrajectoryGoal
    trajectory: ReferenceTrajectory


class _Server(ActionServer):  # type: ignore[misc]
    """Ends a goal as soon as its end is known, not when a waiting coroutine returns."""

    def notify_execute(self, goal_handle: Any, execute_callback: Any) -> None:
        if execute_callback is not None:
            super().notify_execute(goal_handle, execute_callback)


def action_type() -> Any:
    """FollowJointTrajectory; None where control_msgs is not installed."""
    try:
        from control_msgs.action import FollowJointTrajectory
    except ModuleNotFoundError as error:
        if str(error.name).partition(".")[0] != "control_msgs":
            raise
        return None
    return FollowJointTrajectory


def tolerances(values: Any, n: int) -> Tolerances:
    """Default tolerances of goals, from the parameters of the node; 0 is none."""
    path, goal = (
        np.full(n, each) for each in (values.constraints_trajectory, values.constraints_goal)
    )
    speed, time = values.constraints_stopped_velocity_tolerance, values.constraints_goal_time
    none = np.full(n, np.inf)
    return Tolerances(
        np.where(path > 0.0, path, np.inf),
        none,
        np.where(goal > 0.0, goal, np.inf),
        np.full(n, speed) if speed > 0.0 else none,
        time if time > 0.0 else np.inf,
    )
