"""The `muscles` section of a task file: how muscles share the forces that a motion needs."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from mbd_ros.core.loads.inputs import input_names
from mbd_ros.core.ranges import Positive, Unit, Within
from mbd_ros.core.rows.constraint_rows import ConstraintRows
from mbd_ros.errors import ModelError, SceneError
from mbd_ros.features.muscles.muscle_trial import MuscleDynamics
from mbd_ros.features.muscles.static_optimization import (
    EXPONENTS,
    Criterion,
    SharingOptions,
    StaticOptimization,
)
from mbd_ros.methods.inverse_dynamics.reactions import JointLoads, JointReactions, Side
from mbd_ros.methods.inverse_dynamics.reserves import (
    BodyReserve,
    InputReserve,
    Reserve,
    coordinate_reserves,
    joint_reserve,
)
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.reading.building import Site
from mbd_ros.scene.runs.path_search import QuickestSearch, state_paths
from mbd_ros.scene.schema import schema
from mbd_ros.scene.schema.locate import find_file

Objective = Literal["activation", "stress", "volume", "metabolic"]
Exponent = Annotated[float | None, Within(1.0, 10.0), Unit("-")]
Rate = Annotated[float | None, Within(1.0e-9, 1.0e9), Unit("1/s")]
Interval = Annotated[float, Within(1.0e-4, 10.0), Unit("s")]
Degree = Annotated[int, Within(1, 8), Unit("-")]
Tolerance = Annotated[float, Within(1.0e-8, 1.0), Unit("-")]


@dataclass(frozen=True)
class MusclesTask:
    """How the muscles of a scene share the forces of a motion, and which loads are computed.

    Attributes:
        sharing: Objective and limits of the activations.
        reserves: Reserve actuators that help the muscles.
        emg: Table of measured activations, `<muscle>.activation`; None without one.
        side: Body and axes of the joint loads; None for no loads.
        links: Links whose joints have loads; empty for all.
        by_muscle: Whether the load of each muscle is computed, too.
        dynamics: Dynamics of the muscles over the whole motion; None for frames one by one.
    """

    sharing: SharingOptions
    reserves: tuple[Reserve, ...]
    emg: Path | None
    side: Side | None
    links: tuple[str, ...]
    by_muscle: bool
    dynamics: MuscleDynamics | None = None

    def solver(self, scene: Scene, is_live: bool = False) -> StaticOptimization:
        """Return static optimisation with Pinocchio data of its own.

        Args:
            is_live: Whether frames come one by one; then native code is worth its compilation.

        Raises:
            SceneError: The scene has no muscles, or loops.
        """
        if scene.has_loops:
            rows = ", ".join(part.name for part in scene.constraints if part.law.is_rigid)
            raise SceneError(
                f"{scene.name}: muscle forces are computed for open chains and couplings only; "
                f"leave out the loops {rows}"
            )
        known: Any = scene.inverse_dynamics()
        search = QuickestSearch()
        if any(getattr(muscle.path, "wraps", ()) for muscle in scene.muscles):
            search.prepare()  # before a live node has to meet the time of a frame
        try:
            return StaticOptimization(
                scene.robot,
                known,
                scene.muscles,
                self.reserves,
                self.sharing,
                search=search,
                quick=state_paths if is_live else None,
            )
        except ModelError as error:
            raise SceneError(f"{scene.name}: {error}") from error

    def loads(self, scene: Scene) -> JointLoads | None:
        """Return joint loads with Pinocchio data of their own; None if no side is given."""
        if self.side is None:
            return None
        robot, no_rows = scene.robot, ConstraintRows((), int(scene.robot.model.nv))
        wrenches = tuple(scene.wrenches.values())
        bare = JointReactions(robot, no_rows, wrenches, scene.forces_without_input)
        try:
            return JointLoads(robot, bare, scene.muscles, self.reserves, self.links, self.side)
        except ModelError as error:
            raise SceneError(f"{scene.name}: links: {error}") from error


def build_task(site: Site, entry: Any) -> MusclesTask:
    """Build the `muscles` section of a task file.

    Raises:
        SceneError: A key is unknown or its value is not accepted; the message names both.
    """
    scene: Any = site.scene
    return muscles_task(scene, entry, site.where, site.origin.folder)


def muscles_task(scene: Scene, entry: Any, where: str, folder: Path = Path()) -> MusclesTask:
    """Build a task from the keys of the section `muscles`.

    Args:
        entry: Values by key, as `task_of_keys` describes them.
        where: File and key, for messages.
        folder: Folder from which relative paths start.

    Raises:
        SceneError: A key is unknown or its value is not accepted; the message names both.
    """
    task: MusclesTask = schema.call(task_of_keys, entry, where, scene, where, folder)
    if task.dynamics is None:
        for key in MuscleDynamics._fields[1:]:
            if key in entry:
                raise SceneError(f"{where}.dynamics: is missing; {key} needs it")
    return task


def task_of_keys(
    scene: Scene,
    where: str,
    folder: Path,
    *,
    objective: Objective = "activation",
    exponent: Exponent = None,
    passive: bool = False,
    reserves: Any = None,
    residuals: Sequence[Mapping[str, Any]] = (),
    rise: Rate = None,
    fall: Rate = None,
    emg: str | None = None,
    emg_use: Literal["track", "least"] = "track",
    emg_weight: Annotated[Positive, Unit("-")] = 10.0,
    reactions: Side | None = None,
    links: Sequence[str] = (),
    by_muscle: bool = False,
    dynamics: Literal["activation", "tendon"] | None = None,
    interval: Interval = 0.02,
    degree: Degree = 4,
    tolerance: Tolerance = 1.0e-3,
) -> MusclesTask:
    """Build a task; the keyword arguments are the keys of the section `muscles`.

    Args:
        where: File and key, for messages.
        folder: Folder from which relative paths start.
        objective: The cost of the activations a, a sum of w a^p. activation: w = 1. stress:
            w = (F0 / F_max)^p. volume: w = F_max l_opt over its mean. metabolic: w is the
            metabolic rate of the fibres.
        exponent: Exponent p of the activations, from 1 to 10. By default 2 for activation and
            volume, 3 for stress and 1 for metabolic.
        passive: Include the passive elastic force of the fibres.
        reserves: Optimal force of a reserve actuator on every independent coordinate [N·m or N],
            or the actuators of OpenSim (.xml). A task file also takes a number by joint. By
            default there are no reserves.
        residuals: Reserve forces and torques on bodies.
        rise: Fastest rise of an activation [1/s].
        fall: Fastest fall of an activation [1/s].
        emg: Table of measured activations, `<muscle>.activation`, from 0 to 1.
        emg_use: Whether the cost includes the squared distance from the measured activations
            (track), or these are lower bounds (least).
        emg_weight: Weight of the squared distance from the measured activations.
        reactions: Also compute joint loads. child: on the child body in its axes. parent: on the
            parent body in its axes. ground: on the child body in world axes.
        links: Links whose joints have loads; a list a,b,c on the command line. By default all.
        by_muscle: Also compute the share of each muscle in the joint loads.
        dynamics: Solve for the whole motion at once. activation: activations follow excitations.
            tendon: elastic tendons stretch, too. By default frames are solved one by one.
        interval: Longest interval of the mesh of `dynamics` [s].
        degree: Collocation points on an interval.
        tolerance: Largest error of activations between collocation points.
    """
    is_tracked = emg is not None and emg_use == "track"
    sharing = SharingOptions(
        criterion=Criterion(objective, EXPONENTS[objective] if exponent is None else exponent),
        passive=passive,
        rise=math.inf if rise is None else rise,
        fall=math.inf if fall is None else fall,
        tracking=emg_weight if is_tracked else 0.0,
        measured_is_least=emg is not None and emg_use == "least",
    )
    if reactions is None and (links or by_muscle):
        raise SceneError(f"{where}.reactions: is missing; links and by_muscle need it")
    every = [*_input_reserves(scene), *_reserves(scene, reserves, f"{where}.reserves", folder)]
    for i, entry in enumerate(residuals):
        place = f"{where}.residuals[{i}]"
        every.append(schema.call(BodyReserve, dict(entry), place, scene.robot))
    _refuse_repeated(scene, every, where)
    return MusclesTask(
        sharing,
        tuple(every),
        emg=None if emg is None else find_file(folder, emg, f"{where}.emg"),
        side=reactions,
        links=tuple(links),
        by_muscle=by_muscle,
        dynamics=_dynamics(where, sharing, dynamics, interval, degree, tolerance),
    )


def _dynamics(
    where: str,
    sharing: SharingOptions,
    kind: str | None,
    interval: float,
    degree: int,
    tolerance: float,
) -> MuscleDynamics | None:
    if kind is None:
        return None
    if sharing.passive or min(sharing.rise, sharing.fall) < math.inf:
        raise SceneError(
            f"{where}.dynamics: passive, rise and fall are for frames one by one; with dynamics "
            "fibres have their passive force, and activations their rates"
        )
    return MuscleDynamics(kind, interval, degree, tolerance)


def _reserves(scene: Scene, reserves: Any, where: str, folder: Path) -> Sequence[Reserve]:
    """Build reserves from a number for all coordinates, numbers by joint, or a file of OpenSim."""
    robot, couplings = scene.robot, scene.couplings
    if reserves is None:
        return ()
    if isinstance(reserves, str):
        from mbd_ros.features.muscles.osim_reserves import read_reserves  # reads XML

        return read_reserves(find_file(folder, reserves, where), robot, couplings)
    if isinstance(reserves, Mapping):
        forces = {n: schema.value(v, Positive, f"{where}.{n}") for n, v in reserves.items()}
        try:
            return [joint_reserve(robot, couplings, name, force) for name, force in forces.items()]
        except ModelError as error:
            raise SceneError(f"{where}: {error}") from error
    return coordinate_reserves(robot, couplings, schema.value(reserves, Positive, where))


def _input_reserves(scene: Scene) -> list[Reserve]:
    """Return the inputs of actuators and forces, except those with internal states.

    They share the forces with the muscles.
    """
    reserves: list[Reserve] = []
    for part in (*scene.actuators, *(force for force in scene.forces if force.inputs)):
        if part.internal:
            continue
        names = [part.name] if len(part.inputs) == 1 else input_names(part)
        reserves += [InputReserve(n.replace(".", "_"), part, i) for i, n in enumerate(names)]
    return reserves


def _refuse_repeated(scene: Scene, reserves: Sequence[Reserve], where: str) -> None:
    seen = {muscle.name for muscle in scene.muscles}
    for reserve in reserves:
        if reserve.name in seen:
            raise SceneError(
                f"{where}: the reserve {reserve.name} has the name of a muscle or of another "
                "reserve; rename one of them"
            )
        seen.add(reserve.name)
