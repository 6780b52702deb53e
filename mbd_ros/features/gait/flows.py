"""A scene as a motion with events, at any value of a parameter."""

import math
from collections.abc import Callable

import numpy as np

from mbd_ros.core.contracts import label
from mbd_ros.core.dynamics.phased_system import PhasedSystem
from mbd_ros.errors import SceneError
from mbd_ros.features.gait.periodic import ReturnMap
from mbd_ros.features.gait.task import GaitTask
from mbd_ros.methods.sensitivities.flow import Segment
from mbd_ros.methods.sensitivities.simulated_flow import EndsCycle, SimulatedFlow
from mbd_ros.methods.sensitivities.travel import Travel
from mbd_ros.methods.simulation.simulation import Simulation
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.runs.simulation import build_simulation
from mbd_ros.scene.schema.nearest import nearest
from mbd_ros.scene.variants import with_inertias, with_numbers, with_sections

SLOPE = "slope"
_KEPT = 8  # flows: those of a step of a continuation


class SceneFamily:
    """The return maps of a scene along a parameter.

    Args:
        task: What is asked.
        parameter: `slope`, a name as `Scene.with_` takes them, or empty without one.
    """

    def __init__(self, scene: Scene, task: GaitTask, parameter: str = "") -> None:
        self.scene, self.task, self._parameter = scene, task, parameter
        self._flows: dict[float, SimulatedFlow] = {}
        self._flow: SimulatedFlow | None = None

    def scene_at(self, value: float) -> Scene:
        """The scene at a value of the parameter.

        Raises:
            SceneError: Nothing has that name, or the value is out of range.
        """
        if self._parameter == SLOPE:
            return self._sloping(self._gravity(value))
        return with_numbers(self.scene, {self._parameter: value})

    def flow(self, value: float | None = None) -> SimulatedFlow:
        """The motion at a value of the parameter; None for the scene as it is."""
        if value is None or not self._parameter:
            self._flow = self._flow or flow_of(self.scene, self.task)
            return self._flow
        if value not in self._flows:
            if len(self._flows) > _KEPT:
                self._flows.pop(next(iter(self._flows)))
            self._flows[value] = flow_of(self.scene_at(value), self.task)
        return self._flows[value]

    def of(self, section: Segment, travel: Travel) -> Callable[[float], ReturnMap]:
        """The return maps by the value of the parameter."""

        def at(value: float) -> ReturnMap:
            flow = self.flow(value)
            return ReturnMap(flow, flow.own(section), travel, self.task.cycles)

        return at

    def value(self) -> float | None:
        """The value that the scene has; None where only a search tells."""
        if self._parameter == SLOPE:
            x, _, z = self._turned()
            return math.atan2(x, -z)
        return None

    def _sloping(self, gravity: list[float]) -> Scene:
        """The scene with another gravity, where it states its own one, and the same inertias."""
        robot = self.scene.entries.get("robot") or {}
        if "gravity" in robot:
            scene = with_sections(self.scene, robot={**robot, "gravity": gravity})
        else:
            scene = with_sections(self.scene, gravity=gravity)
        changed = any(recipe.inertias for recipe in self.scene.robot.recipes)
        return with_inertias(scene, self.scene.robot.inertias()) if changed else scene

    def _turned(self) -> tuple[float, float, float]:
        """Gravity along the downhill direction, 0, and along the normal [m/s^2]."""
        x, y, z = (float(g) for g in self.scene.robot.model.gravity.linear)
        return math.hypot(x, y) * (1.0 if (x, y) >= (0.0, 0.0) else -1.0), 0.0, z

    def _gravity(self, slope: float) -> list[float]:
        """Gravity on ground that falls by an angle along x, or along gravity where it has one."""
        x, y, z = (float(g) for g in self.scene.robot.model.gravity.linear)
        size, flat = math.sqrt(x * x + y * y + z * z), math.hypot(x, y)
        along = (x / flat, y / flat) if flat > 0.0 else (1.0, 0.0)
        if along < (0.0, 0.0):
            along = (-along[0], -along[1])
        down = size * math.sin(slope)
        return [down * along[0], down * along[1], -size * math.cos(slope)]


def flow_of(scene: Scene, task: GaitTask) -> SimulatedFlow:
    """The motion of a scene, cycle by cycle.

    Args:
        scene: The scene.
        task: Event of the section, longest cycle and integrator count.

    Raises:
        SceneError: Nothing in it ends a cycle; names what there is.
    """
    solver = {"type": scene.solver.tier, "backend": scene.solver.backend}
    plain = build_simulation(scene, integrator=task.integrator, solver=solver)
    parts = plain.system, plain.integrator, plain.stabilization, plain.dt
    joints = [joint.v for joint in scene.robot.joints if joint.kind != "prismatic"]
    numbers = plain.system.integrated(np.arange(float(scene.robot.model.nv)))
    turning = np.flatnonzero(np.isin(numbers, joints))
    return SimulatedFlow(*parts, _end_of_cycle(scene, plain, task), task.longest, turning)


def _end_of_cycle(scene: Scene, plain: Simulation, task: GaitTask) -> EndsCycle:
    """What ends a cycle: an event by its name, or a way back into the first phase."""
    if not plain.guards:
        raise SceneError(
            f"{scene.name}: nothing happens in it that could end a cycle; accepted: a scene with "
            "phases, contacts or stops"
        )
    if task.event is not None:
        found = [g for g in plain.guards if task.event in (g, g.partition(".")[2])]
        if not found:
            there = ", ".join(nearest(task.event, plain.guards) or plain.guards)
            raise SceneError(
                f"{task.source or scene.name}: gait.event: no event is called '{task.event}', "
                f"there are: {there}"
            )
        return lambda segment: bool(set(found) & set(segment.event))
    system = plain.system
    if not isinstance(system, PhasedSystem):
        there = ", ".join(plain.guards)
        raise SceneError(
            f"{task.source or scene.name}: gait.event: is missing: which event ends a cycle? "
            f"There are: {there}"
        )
    exits = {label(phase, e.name) for phase in system.phases for e in phase.exits}
    return lambda s: s.after.mode[0] == system.first and bool(exits & set(s.event))
