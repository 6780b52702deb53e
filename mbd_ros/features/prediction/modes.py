"""Systems of the phases of a motion, the linkages between phases, and the drives of a scene."""

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

_OFF = 1  # mode of a unilateral row at its lower bound
DRIVES = "drives"  # name of the ideal drives in all independent joints
_RESIDUAL = "_residual"


def build_phase_modes(scene: Scene, task: PredictTask) -> list[PhaseMode]:
    """Build the systems of the phases of a task.

    Raises:
        ModelError: The scene does not have a phase of the task.
    """
    names = list(scene.phases)
    if not names:
        for phase in task.phases:
            if phase.phase:
                raise ModelError(f"phase '{phase.phase}': the scene has no phases")
        system = scene.system()
        return [PhaseMode(0, system, _mode(system)) for _ in task.phases]
    phased, modes = build_phased_system(scene), list[PhaseMode]()
    for phase in task.phases:
        if phase.phase and phase.phase not in names:
            close = nearest(phase.phase, names, 1)
            hint = f", the nearest is '{close[0]}'" if close else ""
            raise ModelError(f"no phase '{phase.phase}'{hint}; there are {', '.join(names)}")
        number = names.index(phase.phase) if phase.phase else phased.first
        system = phased.systems[number]
        modes.append(PhaseMode(number, system, _mode(system), phased))
    return modes


def _mode(system: System) -> Mode:
    return (_OFF,) * len(system.event_rows.names) if system.event_rows is not None else ()


class PhaseMode(NamedTuple):
    """The system of a phase.

    Attributes:
        number: Index of the phase in the scene.
        system: System of the phase.
        mode: Mode of the unilateral rows, all of which are inactive.
        phased: Systems of all phases; None where a scene has none.
    """

    number: int
    system: System
    mode: Mode
    phased: PhasedSystem | None = None

    @property
    def demands(self) -> tuple[Check, ...]:
        """Conditions that contacts held by the phase must satisfy."""
        if self.phased is None:
            return ()
        demands: tuple[Check, ...] = self.phased.phases[self.number].demands
        return demands


def consistent_start(scene: Scene, mode: PhaseMode) -> State:
    """Return the consistent state nearest to the initial state of the scene, as integrated.

    Forces of contacts that its phase holds are not checked, since they depend on unknown inputs.
    """
    simulation, x = build_simulation(scene), scene.initial
    if mode.phased is None:
        return mode.system.reduce(simulation.system.expand(simulation.start(x)))
    system = mode.phased.during(x)
    alone = simulation_of_phase(simulation, system, simulation.dt)
    return mode.system.reduce(system.expand(alone.start(mode.phased.inward(x))))


def simulation_of_phase(simulation: Simulation, system: System, dt: float) -> Simulation:
    """Return a simulation of one phase, without its guards."""
    free = system.with_loads(system.loads.watched_by(()))
    return Simulation(free, simulation.integrator, simulation.stabilization, dt)


def build_linkages(
    scene: Scene,
    task: PredictTask,
    modes: Sequence[PhaseMode],
    phases: Sequence[MotionPhase],
) -> list[Linkage]:
    """Build the linkages between phases, and of the last phase with the first one.

    Raises:
        ModelError: A phase does not lead to the next one.
    """
    linkages = list["Linkage"]()
    for i in range(len(phases) - 1):
        linkages.append(_build_linkage(scene, modes, phases, (i, i + 1), (), task))
    is_cyclic = bool(task.periodic or task.symmetric)
    travel = [scene.robot.joint(name).q for name in task.travel]
    if is_cyclic and modes[-1].phased is not None:
        ends = len(phases) - 1, 0
        linkages.append(_build_linkage(scene, modes, phases, ends, travel, task))
    elif is_cyclic:
        linkages.append(_equal_ends(task, phases))
    return linkages


def _build_linkage(
    scene: Scene,
    modes: Sequence[PhaseMode],
    phases: Sequence[MotionPhase],
    numbers: tuple[int, int],
    travel: Sequence[int],
    task: PredictTask,
) -> Any:
    from mbd_ros.optimal_control.linkages import ResetLinkage
    from mbd_ros.optimal_control.phase_equations import PhaseEquations, without_redundant_rows
    from mbd_ros.scene.runs.compiling import traced

    before, after = (modes[i] for i in numbers)
    if before.phased is None:
        raise ModelError("the task has several phases, but the scene has no section phases")
    exit_ = _find_exit(before.phased, before.number, after.number)
    joined = phases[numbers[0]], phases[numbers[1]]
    striking, equations = exit_.reset.striking, None
    if striking is not None:
        names = list(phases[0].equations.equations.parameters)
        plain = PhaseEquations(traced(scene, striking, names, _mode(striking)).equations)
        equations = without_redundant_rows(plain, striking.reduce(scene.initial), midpoints(task))
    return ResetLinkage(*joined, numbers, exit_, equations, travel, grip=task.grip)


def _find_exit(phased: PhasedSystem, number: int, following: int) -> Exit:
    phase = phased.phases[number]
    for exit_ in phase.exits:
        if exit_.then == following:
            return exit_
    names = ", ".join(phased.phases[exit_.then].name for exit_ in phase.exits) or "nothing"
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


def midpoints(task: PredictTask) -> Array:
    """Return the initial values of the parameters: the middles of their ranges."""
    return np.array([sum(limits) / 2.0 for limits in task.parameters.values()])


def add_drives(scene: Scene, by: DrivenBy = "scene", bounded: Iterable[str] = ()) -> DrivenScene:
    """Return the scene with inputs that drive it.

    Args:
        by: `scene`: its own inputs; if it has none, an ideal drive in every independent joint.
            `joints`: these drives, and wrenches on free bases, in place of muscles and actuators.
            `muscles`: the same in addition to its muscles, with smooth curves and rigid tendons.
        bounded: Names of quantities with bounds; external wrenches among them are inputs.

    Raises:
        SceneError: There are no muscles, or nothing drives the scene.
    """
    inputs = [name for name in scene.inputs.slots if name not in scene.wrenches]
    if by == "scene" and (inputs or driving_wrenches(scene, bounded)):
        return DrivenScene(scene)
    independent = scene.couplings.independent
    names = [joint.name for joint in scene.robot.joints if joint.name in independent]
    drives = [{"type": "ideal", "joints": names, "name": DRIVES}] if names else []
    if by == "scene" and not drives:
        raise SceneError(
            f"{scene.name}: nothing drives the scene; give actuators, or external_wrenches with "
            "bounds in the task, or driven_by: joints"
        )
    if by == "scene":
        return DrivenScene(with_sections(scene, actuators=drives))
    if by == "muscles" and not scene.muscles:
        raise SceneError(f"{scene.name}: driven_by: muscles: the scene has no muscles")
    muscles = smooth_entries(scene, {"tendon": "rigid"}) if by == "muscles" else None
    scene_wrenches = scene.entries.get("external_wrenches") or {}
    wrenches = {
        _unique_name(f"{base.name}{_RESIDUAL}", scene_wrenches): {"frame": base.frame}
        for base in scene.robot.bases
    }
    with_drives = with_sections(
        scene,
        muscles=muscles,
        actuators=drives,
        external_wrenches={**scene_wrenches, **wrenches} or None,
    )
    return DrivenScene(with_drives, tuple(wrenches))


def _unique_name(name: str, names: Mapping[str, Any]) -> str:
    """Return a name, with a number if a wrench of the scene already has it."""
    numbered = (f"{name}_{number}" for number in itertools.count(2))
    return next(n for n in itertools.chain([name], numbered) if n not in names)


class DrivenScene(NamedTuple):
    """A scene with inputs that drive it.

    Attributes:
        scene: The scene.
        residuals: Names of the wrenches that drive its free bases.
    """

    scene: Scene
    residuals: tuple[str, ...] = ()


def driving_wrenches(scene: Scene, bounded: Iterable[str]) -> tuple[str, ...]:
    """Return the names of the components of external wrenches that have bounds."""
    names, patterns = scene.inputs.names, tuple(bounded)
    slots = (scene.inputs.slots[name] for name in scene.wrenches)
    components = (name for slot in slots for name in names[slot.start : slot.stop])
    return tuple(name for name in components if any(fnmatchcase(name, key) for key in patterns))
