"""From joint states and wrenches to messages with the muscle forces that explain them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from time import monotonic
from typing import Any, NamedTuple

import numpy as np
from geometry_msgs.msg import WrenchStamped

from mbd_ros.core.state import NANOSECOND, Array, State
from mbd_ros.errors import MbdError, SolveError
from mbd_ros.features.muscles.static_optimization import Shares, StaticOptimization
from mbd_ros.features.muscles.task import muscles_task
from mbd_ros.methods.inverse_dynamics.inverse_dynamics import SampleSolver, Torques
from mbd_ros.methods.inverse_dynamics.reactions import JointLoads
from mbd_ros.methods.inverse_dynamics.torque_estimator import Observation, TorqueEstimator
from mbd_ros.nodes.inverse_dynamics.pipeline import Pipeline
from mbd_ros.nodes.shell.parameters import tuning
from mbd_ros.scene.describe.scene_summary import coordinate_names
from msg_adapters.diagnostics import OK
from msg_adapters.errors import MessageError
from msg_adapters.joint_state_cdr import JointStateCdrWriter
from msg_adapters.multi_array import MultiArrayCdrWriter
from msg_adapters.wrench import write_wrench

_LACKS = 1.0e-6  # of the largest need


class MusclePipeline(Pipeline):
    """Scene and solver of a configured node `muscle_forces`.

    Args:
        description: URDF, where the scene takes it from a topic.

    Attributes:
        links: Names for topics of the loads of joints.
        measured: Activations that were measured.
    """

    def __init__(self, values: Any, description: str | None) -> None:
        super().__init__(values, description)
        scene = self.scene
        if self.assembler is not None:
            raise MbdError(f"{scene.name}: muscle forces live: one fixed robot, no free bodies")
        task = muscles_task(scene, options(values), f"{scene.name}: muscles")
        use = values.emg_use
        sharing = task.sharing._replace(
            tracking=values.emg_weight if use == "track" else 0.0,
            measured_is_least=use == "least",
        )
        optimization = replace(task, sharing=sharing).solver(scene, is_live=True)
        loads = task.loads(scene)
        names = coordinate_names(scene.robot, scene.couplings)
        self._sharing = self._solver = LiveSharing(optimization, loads, names)
        self.estimator = TorqueEstimator(scene.robot, self._sharing, tuning(values))
        muscles = [muscle.name for muscle in optimization.muscles]
        reserves = [reserve.name for reserve in optimization.reserves]
        self.measured = MeasuredActivations(muscles, values.emg_max_age, monotonic)
        self._muscle_forces = JointStateCdrWriter(muscles)
        self._activations = MultiArrayCdrWriter(len(muscles), muscles)
        self._reserves = JointStateCdrWriter(reserves, ("effort",)) if reserves else None
        joined = () if loads is None else loads.joint_links
        self.links = [one.link for one in joined]
        axes = {"child": "link", "parent": "parent_link"}
        attribute = axes.get(values.reactions)
        self._frames = ["world" if attribute is None else getattr(j, attribute) for j in joined]
        self._loads = [WrenchStamped() for _ in joined]

    def make_solver(self, values: Any) -> SampleSolver:
        """Torques of joints, which come before those of muscles."""
        return self.scene.inverse_dynamics()

    def reset(self) -> None:
        """Forget the past."""
        super().reset()
        self._sharing.forget()
        self.measured.clear()

    def share(self, x: Observation, wrenches: Sequence[Any]) -> MuscleAnswer | None:
        """Messages for an observation; None if what it needs is not finite.

        Args:
            x: Motion of one stamp.
            wrenches: One (6,) array for every load of the scene.

        Raises:
            SolveError: Muscles and reserves cannot produce the motion.
        """
        sharing = self._sharing
        sharing.time, sharing.measured = x.stamp * NANOSECOND, self.measured.now()
        if self.estimator.solve(x, wrenches) is None:
            return None
        self._violation = self.estimator.violation(x)
        shares: Any = sharing.shares
        frames = shares.frames
        forces = self._muscle_forces.write(
            x.stamp, position=frames.length[0], velocity=frames.speed[0], effort=shares.force[0]
        )
        activations = self._activations.write(shares.activation[0].tolist())
        reserves = None
        if self._reserves is not None:
            reserves = self._reserves.write(x.stamp, effort=shares.reserve[0])
        rows: Any = () if sharing.loads is None else sharing.loads
        loads = [
            write_wrench(msg, x.stamp, frame, row)
            for msg, frame, row in zip(self._loads, self._frames, rows, strict=True)
        ]
        return MuscleAnswer(forces, activations, reserves, loads)

    def health(self, tolerance: float) -> tuple[int, str]:
        """Level and sentence; WARN as inverse dynamics does."""
        level, text = super().health(tolerance)
        return (level, "muscle forces published") if level == OK else (level, text)

    def details(self) -> dict[str, str]:
        """Contents and origin of the numbers, for diagnostics."""
        problem = self._sharing.optimization
        criterion = problem.sharing.criterion
        return {
            **super().details(),
            "muscles": f"{len(problem.muscles)}, {len(problem.reserves)} reserves",
            "shared by": f"{criterion.kind}, exponent {criterion.exponent:g}",
            "passive force": "takes part" if problem.sharing.passive else "left out",
            **self._sharing.details(),
        }


class MuscleAnswer(NamedTuple):
    """Messages for one joint state.

    Attributes:
        forces: JointState of muscles: position = length, velocity = its rate, effort = tension.
        activations: Float64MultiArray whose labels are muscles.
        reserves: JointState of reserves, effort = force; None without any.
        loads: WrenchStamped of each link.
    """

    forces: bytes
    activations: bytes
    reserves: bytes | None
    loads: list[Any]


class LiveSharing:
    """Static optimisation as the solver of a stream of samples, with the face of `SampleSolver`.

    Args:
        optimization: Shares the efforts of a sample among the muscles.
        loads: Of joints; None without.
        coordinates: Names of the independent velocities.

    Attributes:
        shares: Of the newest sample.
        loads: Of the joints at the newest sample, shape (links, 6); None without.
        time: Of the next sample [s].
        measured: Activations measured for the next sample, NaN where none was, shape (n,).
    """

    correction = 0.0

    def __init__(
        self,
        optimization: StaticOptimization,
        loads: JointLoads | None,
        coordinates: Sequence[str],
    ) -> None:
        self.optimization = optimization
        self._joint_loads = loads
        self._coordinates = tuple(coordinates)
        known = optimization.known
        self.couplings = known.couplings
        self.rows = known.rows
        self.needed = known.needed
        self.gap = known.gap
        self._none = np.zeros(len(known.rows))
        self.configuration = optimization.robot.neutral()
        self.time = 0.0
        self.measured = np.full(len(optimization.muscles), np.nan)
        self.shares: Shares | None = None
        self.loads: Array | None = None

    def forget(self) -> None:
        """Forget earlier samples."""
        self.optimization.forget()
        self.shares = None
        self.loads = None

    def solve(
        self, position: Array, velocity: Array, acceleration: Array, wrenches: Sequence[Array] = ()
    ) -> Torques:
        """Share the forces of one sample.

        Raises:
            SolveError: Muscles and reserves cannot produce the motion, with what lacks; or the
                sample has no answer.
        """
        motion = [values[None] for values in (position, velocity, acceleration)]
        if not all(np.isfinite(values).all() for values in (*motion, *wrenches)):
            raise SolveError("motion or wrenches are not finite")
        loads = [wrench[None] for wrench in wrenches]
        times = np.array([self.time])
        shares = self.optimization.solve(times, *motion, loads, self.measured[None])
        if not shares.is_feasible[0]:
            raise SolveError(self._lacking(shares))
        q, v, a = (values[:, 0] for values in self.optimization.motion)
        self.shares = shares
        self.configuration = q
        if self._joint_loads is not None:
            x, force, reserve = State(self.time, q, v), shares.force[0], shares.reserve[0]
            self.loads, _ = self._joint_loads.solve(x, a, force, reserve, wrenches)
        return Torques(shares.needed[0], self._none, len(shares.needed[0]))

    def doubts(self) -> list[str]:
        """Reasons to doubt the newest answer."""
        found: list[str] = self.optimization.known.doubts()
        return found

    def _lacking(self, shares: Shares) -> str:
        lacking = shares.lacking[0]
        most = np.argsort(-np.abs(lacking))
        scale = _LACKS * float(np.abs(shares.needed).max())
        texts = [f"{self._coordinates[i]} lacks {lacking[i]:.4g}" for i in most[:3]
                 if abs(lacking[i]) > scale]  # fmt: skip
        return f"muscles and reserves cannot produce the motion: {', '.join(texts)}"

    def details(self) -> dict[str, str]:
        """Return figures of the newest sample, for diagnostics."""
        shares: Any = self.shares
        if shares is None:
            return {}
        names = [reserve.name for reserve in self.optimization.reserves]
        entries = {
            "objective": f"{shares.objective[0]:.6g}",
            "optimality residual": f"{shares.residual[0]:.1e}",
            "free directions": str(int(shares.null_space[0])),
        }
        if names:
            i = int(np.abs(shares.reserve[0]).argmax())
            entries["largest reserve"] = f"{names[i]}: {shares.reserve[0, i]:.4g}"
        return entries


class MeasuredActivations:
    """Activations that arrive on a topic: the newest of each muscle, as long as it stands.

    Args:
        names: Of the muscles.
        max_age: How long a value stands [s].
        clock: Steady time [s].
    """

    def __init__(self, names: Sequence[str], max_age: float, clock: Callable[[], float]) -> None:
        self._at = {name: i for i, name in enumerate(names)}
        self._max_age = max_age
        self._clock = clock
        self.clear()

    def clear(self) -> None:
        """Forget all."""
        self._values = np.full(len(self._at), np.nan)
        self._heard = np.full(len(self._at), -np.inf)

    def take(self, msg: Any) -> None:
        """Values of a Float64MultiArray whose layout labels are names of muscles.

        Raises:
            MessageError: Not one label a value, no label of a muscle, or a value outside 0 .. 1.
        """
        labels = [dimension.label for dimension in msg.layout.dim]
        if len(labels) != len(msg.data):
            raise MessageError(
                f"{len(labels)} labels for {len(msg.data)} values; expected one each"
            )
        activations = [
            (self._at[n], v) for n, v in zip(labels, msg.data, strict=True) if n in self._at
        ]
        if not activations:
            raise MessageError(f"no label is a muscle; muscles are {', '.join(self._at)}")
        for i, value in activations:
            if not 0.0 <= value <= 1.0:
                name = list(self._at)[i]
                raise MessageError(f"activation of {name} is {value:.6g}, accepted: 0 .. 1")
        now = self._clock()
        for i, value in activations:
            self._values[i], self._heard[i] = value, now

    def now(self) -> Array:
        """Values that stand, NaN for the others, shape (n,)."""
        fresh = self._clock() - self._heard <= self._max_age
        return np.where(fresh, self._values, np.nan)


def options(values: Any) -> dict[str, Any]:
    """The section `muscles` of a task file that says the same as parameters.

    Measured activations come on a topic: their use is not in it.
    """
    chosen: dict[str, Any] = {"objective": values.objective, "passive": values.passive}
    for name in ("exponent", "rise", "fall", "reserves"):
        if getattr(values, name) > 0.0:
            chosen[name] = getattr(values, name)
    if values.reserve_file:
        chosen["reserves"] = values.reserve_file
    if values.reactions != "none":
        chosen |= {"reactions": values.reactions, "links": list(values.links)}
    return chosen
