"""What holds a tracked motion up that no joint of a body could: forces on its base."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from mbd_ros.core.model.robot import Robot
from mbd_ros.features.prediction.solving import Found

_PLANAR = 3  # joints to the ground, from which on a body moves freely
_NO_MASS = 1.0e-6  # of all


class Residual(NamedTuple):
    """A force on a base.

    Attributes:
        name: Of its input.
        unit: N or N·m.
        rms: Over all points.
        largest: The largest size.
    """

    name: str
    unit: str
    rms: float
    largest: float

    @property
    def line(self) -> str:
        """For people."""
        return (
            f"  residual {self.name}: rms {self.rms:.3g} {self.unit}, "
            f"at most {self.largest:.3g} {self.unit}"
        )


def residuals_of(found: Found) -> Iterator[Residual]:
    """The forces on bases of a motion that was recorded; of any other there are none."""
    problem = found.problem
    if problem.recording is None:
        return
    scene, first = problem.scene, problem.program.phases[0]
    u = np.vstack([motion.points["u"] for motion in found.solution.motions])
    units = [channel.unit for channel in scene.inputs.channels]
    for joint in root_joints(scene.robot):
        name = f"{joint}.effort"
        if name in first.quantities.names and first.quantities.find(name)[0].letter == "u":
            at = first.quantities.find(name)[0].index
            yield _residual(name, "N" if joint in scene.robot.sliding else "N·m", u[:, at])
    for part in problem.residuals:
        slots = scene.inputs.slots[part]
        for at in range(slots.start, slots.stop):
            yield _residual(scene.inputs.names[at], units[at], u[:, at])


def _residual(name: str, unit: str, values: np.ndarray) -> Residual:
    rms = float(np.sqrt(np.mean(values**2)))
    return Residual(name, unit, rms, float(np.abs(values).max(initial=0.0)))


def root_joints(robot: Robot) -> list[str]:
    """Joints between the ground and the first link with mass, where they are three or more."""
    model = robot.model
    mass = [one.mass for one in model.inertias]
    children = [list(map(int, one)) for one in model.children]
    found, at = list[int](), 0
    while len(children[at]) == 1:
        at = children[at][0]
        found.append(at)
        if mass[at] > _NO_MASS * sum(mass):
            break
    places = {int(model.joints[i].idx_v) for i in found if model.joints[i].nv == 1}
    names = [joint.name for joint in robot.joints if joint.v in places]
    return names if len(names) >= _PLANAR else []
