"""The systems of the phases of a motion, what links them and what drives them."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mbd_ros.core.dynamics.phased_system import PhasedSystem
from mbd_ros.core.dynamics.system import System
from mbd_ros.core.state import Array, Mode, State
from mbd_ros.errors import ModelError, SceneError
from mbd_ros.features.prediction.smooth_scene import smooth_entries
from mbd_ros.features.prediction.task import DrivenBy, PredictTask
from mbd_ros.methods.events.phases import Check, Exit
from mbd_ros.methods.simulation.simulation import Simulation
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.phased_systems import build_phased_system
from mbd_ros.scene.runs.simulation import build_simulation
from mbd_ros.scene.schema.nearest import nearest
from mbd_ros.scene.variants import with_sections

if TYPE_CHECKING:
    from mbd_ros.optimal_control.motion_phase import MotionPhase
    from mbd_ros.optimal_control.motion_program import Linkage

_OFF = 1  # a row that gives way, at its lower bound
DRIVES = "drives"  # ideal ones in all independent joints
_RESIDUAL = "_residual"


def modes_of(scene: Scene, task: PredictTask) -> list[PhaseMode]:
    """The systems of the phases of a task.

    Raises:
        ModelError: A phase that the scene does not have.
    """
    names = list(scene.phases)
    if not names:
        for one in task.phases:
            if one.phase:
                raise ModelError(f"phase '{one.phase}': the scene has no phases")
        system = scene.system()
        return [PhaseMode(0, system, _mode(system)) for _ in task.phases]
    phased, found = build_phased_system(scene), list[PhaseMode]()
    for one in task.phases:
        if one.phase and one.phase not in names:
            close = nearest(one.phase, names, 1)
            hint = f", the nearest is '{close[0]}'" if close else ""
            raise ModelError(f"no phase '{one.phase}'{hint}; there are {', '.join(names)}")
        number = names.index(one.phase) if one.phase else phased.first
        system = phased.systems[number]
        found.append(PhaseMode(number, system, _mode(system), phased))
    return found


def _mode(system: System) -> Mode:
    return (_OFF,) * len(system.event_rows.names) if system.event_rows is not None else ()


class PhaseMode(NamedTuple):
    """The system of a phase.

    Attributes:
        number: Of the phase in the scene.
        mode: Of rows that give way: all of them are off.
        phased: The systems of all phases; None where a scene has none.
    """

    number: int
    system: System
    mode: Mode
    phased: PhasedSystem | None = None

    @property
    def demands(self) -> tuple[Check, ...]:
        """What contacts that the phase holds have to keep."""
        if self.phased is None:
            return ()
        found: tuple[Check, ...] = self.phased.phases[self.number].demands
        return found


def started(scene: Scene, mode: PhaseMode) -> State:
    """The consistent state near that in which the scene starts, in what is integrated.

    Forces of contacts that its phase holds are those of inputs that nobody knows yet.
    """
    simulation, x = build_simulation(scene), scene.initial
    if mode.phased is None:
        return mode.system.reduce(simulation.system.expand(simulation.start(x)))
    system = mode.phased.during(x)
    alone = simulation_of_phase(simulation, system, simulation.dt)
    return mode.system.reduce(system.expand(alone.start(mode.phased.inward(x))))


def simulation_of_phase(whole: Simulation, system: System, dt: float) -> Simulation:
    """A simulation of one phase, without its guards."""
    free = system.with_loads(system.loads.watched_by(()))
    return Simulation(free, whole.integrator, whole.stabilization, dt)


def linkages_of(
    scene: Scene,
    task: PredictTask,
    modes: Sequence[PhaseMode],
    phases: Sequence[MotionPhase],
) -> list[Linkage]:
    """What links the phases, and the end of the last one with the beginning.

    Raises:
        ModelError: A phase that does not lead to the next one.
    """
    found = list["Linkage"]()
    for i in range(len(phases) - 1):
        found.append(_linkage(scene, modes, phases, (i, i + 1), (), task))
    is_cyclic = bool(task.periodic or task.symmetric)
    travel = [scene.robot.joint(name).q for name in task.travel]
    if is_cyclic and modes[-1].phased is not None:
        ends = len(phases) - 1, 0
        found.append(_linkage(scene, modes, phases, ends, travel, task))
    elif is_cyclic:
        found.append(_equal_ends(task, phases))
    return found


def _linkage(
    scene: Scene,
    modes: Sequence[PhaseMode],
    phases: Sequence[MotionPhase],
    numbers: tuple[int, int],
    travel: Sequence[int],
    task: PredictTask,
) -> Any:
    from mbd_ros.optimal_control.linkages import ResetLinkage
    from mbd_ros.optimal_control.phase_equations import PhaseEquations, independent
    from mbd_ros.scene.runs.compiling import traced

    one, other = (modes[i] for i in numbers)
    if one.phased is None:
        raise ModelError("several phases of a scene without phases; accepted: section phases")
    way = _exit(one.phased, one.number, other.number)
    joined = phases[numbers[0]], phases[numbers[1]]
    striking, equations = way.reset.striking, None
    if striking is not None:
        names = list(phases[0].equations.equations.parameters)
        plain = PhaseEquations(traced(scene, striking, names, _mode(striking)).equations)
        equations = independent(plain, striking.reduce(scene.initial), middles(task))
    return ResetLinkage(*joined, numbers, way, equations, travel, grip=task.grip)


def _exit(phased: PhasedSystem, number: int, following: int) -> Exit:
    phase = phased.phases[number]
    for way in phase.exits:
        if way.then == following:
            found: Exit = way
            return found
    names = ", ".join(phased.phases[way.then].name for way in phase.exits) or "nothing"
    raise ModelError(
        f"phase {phase.name} does not lead to {phased.phases[following].name}, but to {names}"
    )


def _equal_ends(task: PredictTask, phases: Sequence[MotionPhase]) -> Any:
    from mbd_ros.optimal_control.linkages import EqualEnds

    last, first = phases[-1].quantities, phases[0].quantities
    pairs, signs = list[Any](), list[float]()
    skipped = {f"{name}.position" for name in task.travel} | set(task.symmetric)
    for name in task.periodic:
        for end in last.find(name):
            if end.name not in skipped:
                pairs.append((end, first.find(end.name)[0]))
                signs.append(1.0)
    for name, source in task.symmetric.items():
        sign = -1.0 if source.startswith("-") else 1.0
        pairs.append((last.find(name)[0], first.find(source.lstrip("-"))[0]))
        signs.append(sign)
    return EqualEnds(phases[-1], phases[0], pairs, signs)


def middles(task: PredictTask) -> Array:
    """Values of the unknown numbers with which a motion begins."""
    return np.array([sum(one) / 2.0 for one in task.parameters.values()])


def driven(scene: Scene, by: DrivenBy = "scene", bounded: Iterable[str] = ()) -> Driven:
    """The scene with what drives it.

    Args:
        by: `scene`: what it has; without any input an ideal drive in every independent joint.
            `joints`: these drives, and wrenches on free bases, in place of muscles and actuators.
            `muscles`: the same beside its muscles, with smooth curves and rigid tendons.
        bounded: Names of quantities with bounds; external wrenches among them drive the scene.

    Raises:
        SceneError: There are no muscles, or nothing that drives.
    """
    own = [name for name in scene.inputs.slots if name not in scene.wrenches]
    if by == "scene" and (own or driving_wrenches(scene, bounded)):
        return Driven(scene)
    names = [one.name for one in scene.robot.joints if one.name in scene.couplings.independent]
    drives = [{"type": "ideal", "joints": names, "name": DRIVES}] if names else []
    if by == "scene" and not drives:
        raise SceneError(
            f"{scene.name}: nothing drives it; accepted: actuators, external_wrenches that have "
            "bounds in the task, or driven_by: joints"
        )
    if by == "scene":
        return Driven(with_sections(scene, actuators=drives))
    if by == "muscles" and not scene.muscles:
        raise SceneError(f"{scene.name}: driven_by: muscles: the scene has none")
    muscles = smooth_entries(scene, {"tendon": "rigid"}) if by == "muscles" else None
    given = scene.entries.get("external_wrenches") or {}
    wrenches = {
        _untaken(f"{one.name}{_RESIDUAL}", given): {"frame": one.frame}
        for one in scene.robot.bases
    }
    found = with_sections(
        scene,
        muscles=muscles,
        actuators=drives,
        external_wrenches={**given, **wrenches} or None,
    )
    return Driven(found, tuple(wrenches))


def _untaken(name: str, taken: Mapping[str, Any]) -> str:
    """The name, numbered where a wrench of the scene has it."""
    numbered = (f"{name}_{number}" for number in itertools.count(2))
    return next(one for one in itertools.chain([name], numbered) if one not in taken)


class Driven(NamedTuple):
    """A scene with what drives it.

    Attributes:
        residuals: Names of the wrenches that drive its free bases.
    """

    scene: Scene
    residuals: tuple[str, ...] = ()


def driving_wrenches(scene: Scene, bounded: Iterable[str]) -> tuple[str, ...]:
    """Components of external wrenches that have bounds, as inputs are called."""
    names, patterns = scene.inputs.names, tuple(bounded)
    slots = (scene.inputs.slots[name] for name in scene.wrenches)
    every = (name for one in slots for name in names[one.start : one.stop])
    return tuple(name for name in every if any(fnmatchcase(name, key) for key in patterns))
