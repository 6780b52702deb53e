"""Along which coordinates a gait may begin anywhere: what moves on from cycle to cycle.

A translation is a travel where moving the motion along it changes neither rates nor guards nor
resets. The travels are the null space of these changes, by central differences.
"""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from mbd_ros.core.state import Array, State
from mbd_ros.errors import SceneError
from mbd_ros.features.gait.task import GaitTask
from mbd_ros.methods.sensitivities.flow import Segment
from mbd_ros.methods.sensitivities.simulated_flow import SimulatedFlow
from mbd_ros.methods.sensitivities.travel import Travel, TravelCoordinate

_ASIDE = 1.0e-3  # m: how far a motion is moved to see whether it changes
_SAME = 1.0e-7  # change of rates and guards a metre, over the largest entry


def travel_for(flow: SimulatedFlow, segments: Sequence[Segment], task: GaitTask) -> Travel:
    """The travel of a gait: as named, or found.

    Raises:
        SceneError: A name of nothing that travels.
    """
    known = {one.name: one for one in candidates(flow.system)}
    if task.travel is None:
        return travel_of(flow, segments, tuple(known.values()))
    for name in task.travel:
        if name not in known:
            there = ", ".join(known) or "none"
            raise SceneError(
                f"{task.source}: gait.travel: '{name}' does not travel, there are: {there}"
            )
    return Travel(tuple(known[name] for name in task.travel))


def travel_of(
    flow: Any, segments: Sequence[Segment], coordinates: Sequence[TravelCoordinate]
) -> Travel:
    """The directions along which neither rates nor rows nor guards nor resets change.

    Args:
        flow: The motion.
        segments: A cycle of it.
        coordinates: Those that may be such directions.
    """
    if not coordinates:
        return Travel()
    changes, sizes = [], [1.0]
    for x, seen in _places(flow, segments):
        along = Travel(coordinates).tangents(x, flow.size)
        near = seen(x)
        sizes.append(float(np.abs(near).max(initial=0.0)))
        sides = [
            [seen(flow.plus(x, sign * _ASIDE * one)) for one in along.T] for sign in (1.0, -1.0)
        ]
        changes.append((np.array(sides[0]) - np.array(sides[1])).T / (2.0 * _ASIDE))
    every = np.vstack(changes)
    _, found, right = np.linalg.svd(every, full_matrices=True)
    count = int(np.sum(found > _SAME * max(sizes)))
    return Travel(coordinates, right[count:])


def _places(flow: Any, segments: Sequence[Segment]) -> Iterator[tuple[State, Any]]:
    """States, and what must not change there."""

    def within(x: State) -> Array:
        return np.concatenate((flow.rate(x), flow.open(x)))

    for segment in segments:
        yield segment.begin, within

        def at_end(x: State, segment: Segment = segment) -> Array:
            after = flow.minus(flow.reset(segment, x), x)
            return np.concatenate((within(x), [flow.value(segment, x)], after))

        yield segment.end, at_end


def candidates(system: Any) -> tuple[TravelCoordinate, ...]:
    """Translations of free bodies, and of slides between the world and a robot."""
    robot, model = system.robot, system.model
    kept = {int(v): i for i, v in enumerate(system.integrated(np.arange(float(model.nv))))}
    chart = system.chart.model
    q_of = {int(j.idx_v): int(j.idx_q) for j in chart.joints if j.nv}
    found = [
        TravelCoordinate(f"{base.name}.position.{axis}", q_of[kept[base.v.start]], v, number)
        for base in robot.bases
        if (v := kept.get(base.v.start)) is not None
        for number, axis in enumerate("xyz")
    ]
    carried = {0}
    for joint in robot.joints:
        index = next(i for i, j in enumerate(model.joints) if j.nv and j.idx_v == joint.v)
        if joint.kind != "prismatic" or int(model.parents[index]) not in carried:
            continue
        carried.add(index)
        if joint.v in kept:
            v = kept[joint.v]
            found.append(TravelCoordinate(joint.name, q_of[v], v))
    return tuple(found)
