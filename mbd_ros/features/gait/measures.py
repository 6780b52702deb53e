"""Length, speed and energy of a gait."""

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from mbd_ros.core.contracts.parts import Load
from mbd_ros.core.sensitivities.simulated_flow import SimulatedFlow
from mbd_ros.core.sensitivities.travel import Travel
from mbd_ros.core.state import Array, State
from mbd_ros.features.gait.periodic import PeriodicMotion
from mbd_ros.features.gait.task import GaitTask
from mbd_ros.scene.built_scene import Scene

SAMPLES = 201  # a segment: odd, as Simpson's rule asks


class Measures(NamedTuple):
    """What a gait is like, over the cycles after which it repeats.

    Attributes:
        period: [s].
        travel: Displacement along the travel [m]; None where nothing travels.
        speed: Travel over period [m/s]; None likewise.
        energy_lost: What impacts and other events take [J].
        positive_work: Of actuators, where they give energy [J].
        negative_work: Where they take it [J], <= 0.
        cost_of_transport: Positive work over weight and travel; None without travel.
    """

    period: float
    travel: float | None
    speed: float | None
    energy_lost: float
    positive_work: float
    negative_work: float
    cost_of_transport: float | None


def measures_of(
    scene: Scene, task: GaitTask, flow: SimulatedFlow, travel: Travel, motion: PeriodicMotion
) -> Measures:
    """Measures of a gait; see `Measures`."""
    passage, system = motion.passage, flow.system
    period = passage.period
    moved = travel.place(passage.segments[-1].end) - travel.place(passage.begin)
    length = float(np.linalg.norm(moved)) if len(moved) else None
    if task.step_between:
        length = _distance(scene, flow, passage.segments[-1].end, task.step_between)
    lost = sum(system.energy(s.end) - system.energy(s.after) for s in passage.segments)
    positive, negative = _work(flow, motion)
    weight = pin.computeTotalMass(scene.robot.model) * float(
        np.linalg.norm(scene.robot.model.gravity.linear)
    )
    is_known = length is not None and length > 0.0 and weight > 0.0
    return Measures(
        period,
        length,
        None if length is None else length / period,
        float(lost),
        positive,
        negative,
        positive / (weight * float(length or 1.0)) if is_known else None,
    )


def _work(flow: SimulatedFlow, motion: PeriodicMotion) -> tuple[float, float]:
    """Positive and negative work of the actuators, by Simpson's rule."""
    if not _working(flow):
        return 0.0, 0.0
    positive = negative = 0.0
    for segment in motion.passage.segments:
        duration = segment.end.t - segment.begin.t
        if duration <= 0.0:
            continue
        powers = np.array([_powers(flow, x) for x in flow.states(segment, SAMPLES)])
        weights = np.full(SAMPLES, 2.0)
        weights[1::2], weights[[0, -1]] = 4.0, 1.0
        weights *= duration / (3.0 * (SAMPLES - 1))
        positive += float(weights.dot(np.maximum(powers, 0.0)).sum())
        negative += float(weights.dot(np.minimum(powers, 0.0)).sum())
    return positive, negative


def _working(flow: SimulatedFlow) -> list[Load]:
    loads = flow.system.loads
    return [one for one in (*loads.actuators, *loads.forces) if one.gives_work]


def _powers(flow: SimulatedFlow, y: State) -> Array:
    """Power of each actuator [W], shape (n,)."""
    system = flow.system
    x = system.expand(y)
    loads, k = system.loads, system.k
    u, found = loads.inputs(x, None), []
    for actuator in _working(flow):
        k.refresh(x.q, x.v, actuator.reads)
        found.append(float(actuator.force(k, x, u).dot(x.v)))
    return np.array(found)


def _distance(scene: Scene, flow: SimulatedFlow, y: State, frames: tuple[str, ...]) -> float:
    """Distance of two frames [m]."""
    robot, x = scene.robot, flow.system.expand(y)
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, x.q)
    one, other = (data.oMf[robot.frame(name)].translation for name in frames)
    return float(np.linalg.norm(one - other))
