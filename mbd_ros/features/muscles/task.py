"""The `muscles` section of a task file: how the muscles of a scene share a motion's forces."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from mbd_ros.core.loads.inputs import input_names
from mbd_ros.core.ranges import Positive, Unit, Within
from mbd_ros.core.rows.constraint_rows import ConstraintRows
from mbd_ros.errors import ModelError, SceneError
from mbd_ros.features.muscles.muscle_trial import DEFAULTS, MuscleDynamics
from mbd_ros.features.muscles.static_optimization import (
    EXPONENTS,
    Criterion,
    StaticOptimization,
    Wishes,
)
from mbd_ros.methods.inverse_dynamics.reactions import JointLoads, JointReactions, Side
from mbd_ros.methods.inverse_dynamics.reserves import (
    BodyReserve,
    InputReserve,
    Reserve,
    coordinate_reserves,
    reserve_on,
)
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.reading.building import Site
from mbd_ros.scene.runs.path_search import QuickestSearch, state_paths
from mbd_ros.scene.schema import schema
from mbd_ros.scene.schema.locate import find_file

Objective = Literal["activation", "stress", "volume", "metabolic"]
Use = Literal["track", "least"]
OptionalRate = Annotated[float | None, Within(1.0e-9, 1.0e9), Unit("1/s")]
Dynamics = Literal["activation", "tendon"]
Exponent = Annotated[float | None, Within(1.0, 10.0), Unit("-")]


@dataclass(frozen=True)
class MusclesTask:
    """Static optimisation, asked of a scene with muscles.

    Attributes:
        wishes: What is asked of the activations.
        reserves: What helps the muscles.
        emg: Table of measured activations, `<muscle>.activation`; None without.
        side: Whose loads of joints are asked for; None for no loads.
        links: Whose joint; empty for all.
        by_muscle: Whether the loads of each muscle are asked for, too.
        dynamics: Of muscles over the whole motion; None for frames one by one.
    """

    wishes: Wishes
    reserves: tuple[Reserve, ...]
    emg: Path | None
    side: Side | None
    links: tuple[str, ...]
    by_muscle: bool
    dynamics: MuscleDynamics | None = None

    def solver(self, scene: Scene, is_live: bool = False) -> StaticOptimization:
        """Static optimisation with its own Pinocchio data.

        Args:
            is_live: Whether frames come one by one, which native code is worth then.

        Raises:
            SceneError: The scene has no muscles, or loops.
        """
        if scene.has_loops:
            rows = ", ".join(part.name for part in scene.constraints if part.law.is_rigid)
            raise SceneError(
                f"{scene.name}: muscles share the forces of open chains and couplings; "
                f"leave out the loops {rows}"
            )
        known: Any = scene.inverse_dynamics()
        search = QuickestSearch()
        if any(getattr(muscle.path, "wraps", ()) for muscle in scene.muscles):
            search.prepare()  # before frames are waited for
        try:
            return StaticOptimization(
                *(scene.robot, known, scene.muscles, self.reserves, self.wishes),
                search=search,
                quick=state_paths if is_live else None,
            )
        except ModelError as error:
            raise SceneError(f"{scene.name}: {error}") from error

    def loads(self, scene: Scene) -> JointLoads | None:
        """Loads of joints with their own Pinocchio data; None where nobody asks for them."""
        if self.side is None:
            return None
        robot, none = scene.robot, ConstraintRows((), int(scene.robot.model.nv))
        bare = JointReactions(robot, none, tuple(scene.wrenches.values()), scene.acting)
        try:
            return JointLoads(robot, bare, scene.muscles, self.reserves, self.links, self.side)
        except ModelError as error:
            raise SceneError(f"{scene.name}: links: {error}") from error


def build_task(site: Site, given: Any) -> MusclesTask:
    """The `muscles` section of a task file.

    Raises:
        SceneError: Names file, key, what is wrong and what is accepted.
    """
    scene: Any = site.scene
    return muscles_task(scene, given, site.where, site.origin.folder)


def muscles_task(scene: Scene, given: Any, where: str, folder: Path = Path()) -> MusclesTask:
    """The task that options ask for.

    Args:
        given: Options by name, see `_task`.
        where: File and key, for the messages.
        folder: Where paths begin.

    Raises:
        SceneError: Names key, what is wrong and what is accepted.
    """
    task: MusclesTask = schema.call(_task, given, where, scene, where, folder)
    return task


def _task(
    scene: Scene,
    where: str,
    folder: Path,
    *,
    objective: Objective = "activation",
    exponent: Exponent = None,
    passive: bool = False,
    reserves: Any = None,
    residuals: Sequence[Mapping[str, Any]] = (),
    rise: OptionalRate = None,
    fall: OptionalRate = None,
    emg: str | None = None,
    emg_use: Use = "track",
    emg_weight: Annotated[Positive, Unit("-")] = 10.0,
    reactions: Side | None = None,
    links: Sequence[str] = (),
    by_muscle: bool = False,
    dynamics: Dynamics | None = None,
    interval: Annotated[float | None, Within(1.0e-4, 10.0), Unit("s")] = None,
    degree: Annotated[int | None, Within(1, 8), Unit("-")] = None,
    tolerance: Annotated[float | None, Within(1.0e-8, 1.0), Unit("-")] = None,
) -> MusclesTask:
    tracking = emg_weight if emg is not None and emg_use == "track" else 0.0
    wishes = Wishes(
        Criterion(objective, EXPONENTS[objective] if exponent is None else exponent),
        passive,
        math.inf if rise is None else rise,
        math.inf if fall is None else fall,
        tracking,
        emg is not None and emg_use == "least",
    )
    if reactions is None and (links or by_muscle):
        raise SceneError(f"{where}.reactions: is missing, links and by_muscle say more of it")
    helping = [*_inputs(scene), *_reserves(scene, reserves, f"{where}.reserves", folder)]
    for i, entry in enumerate(residuals):
        helping.append(
            schema.call(BodyReserve, dict(entry), f"{where}.residuals[{i}]", scene.robot)
        )
    _refuse_repeated(scene, helping, where)
    file = None if emg is None else find_file(folder, emg, f"{where}.emg")
    lasting = _dynamics(where, wishes, dynamics, interval, degree, tolerance)
    loads = reactions, tuple(links), by_muscle
    return MusclesTask(wishes, tuple(helping), file, *loads, lasting)


def _dynamics(
    where: str, wishes: Wishes, kind: str | None, *more: float | int | str | None
) -> MuscleDynamics | None:
    if kind is None:
        for key, value in zip(MuscleDynamics._fields[1:], more, strict=True):
            if value is not None:
                raise SceneError(f"{where}.dynamics: is missing, {key} says more of it")
        return None
    if wishes.passive or min(wishes.rise, wishes.fall) < math.inf:
        raise SceneError(
            f"{where}.dynamics: passive, rise and fall are for frames one by one; with dynamics "
            "fibres have their passive force, and activations their rates"
        )
    given = [one if value is None else value for one, value in zip(DEFAULTS, more, strict=True)]
    return MuscleDynamics(kind, *given)


def _reserves(scene: Scene, given: Any, where: str, folder: Path) -> Sequence[Reserve]:
    """A number for all coordinates, numbers by joint, or a file of OpenSim."""
    robot, couplings = scene.robot, scene.couplings
    if given is None:
        return ()
    if isinstance(given, str):
        from mbd_ros.features.muscles.osim_reserves import read_reserves  # reads XML

        return read_reserves(find_file(folder, given, where), robot, couplings)
    if isinstance(given, Mapping):
        numbers = {n: schema.value(v, Positive, f"{where}.{n}") for n, v in given.items()}
        try:
            return [reserve_on(robot, couplings, name, n) for name, n in numbers.items()]
        except ModelError as error:
            raise SceneError(f"{where}: {error}") from error
    return coordinate_reserves(robot, couplings, schema.value(given, Positive, where))


def _inputs(scene: Scene) -> list[Reserve]:
    """Inputs of actuators and forces that share with the muscles; not of states of their own."""
    found: list[Reserve] = []
    for part in (*scene.actuators, *(force for force in scene.forces if force.inputs)):
        if part.internal:
            continue
        names = [part.name] if len(part.inputs) == 1 else input_names(part)
        found += [InputReserve(n.replace(".", "_"), part, i) for i, n in enumerate(names)]
    return found


def _refuse_repeated(scene: Scene, helping: Sequence[Reserve], where: str) -> None:
    seen = {muscle.name for muscle in scene.muscles}
    for reserve in helping:
        if reserve.name in seen:
            raise SceneError(f"{where}: the name {reserve.name} of a reserve is taken")
        seen.add(reserve.name)
