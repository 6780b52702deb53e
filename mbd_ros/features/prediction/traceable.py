"""A scene and a task -> those that are solved: smooth muscles, no paths that are searched for."""

from collections.abc import Iterator
from dataclasses import replace
from fnmatch import fnmatchcase

import numpy as np

from mbd_ros.core.projection.independent_limits import independent_limits
from mbd_ros.features.prediction.recording import Recording
from mbd_ros.features.prediction.task import PredictTask
from mbd_ros.features.prediction.wrapping_entries import wrapping
from mbd_ros.optimal_control.problem import Range
from mbd_ros.scene.built_scene import Scene

_SHARES = np.linspace(0.0, 1.0, 200)
_BESIDE = 0.5  # rad or m beyond what a task names of a joint without limits

Changed = tuple[Scene, PredictTask, tuple[str, ...]]


def traceable(scene: Scene, task: PredictTask, recording: Recording | None = None) -> Changed:
    """The scene with the muscles of the task, and polynomials in place of paths that wrap.

    Args:
        scene: The scene.
        task: The task.
        recording: Of the motion; None without one.

    Returns:
        Scene, task with bounds of joints within which polynomials hold, and a line a change.

    Raises:
        SceneError: Muscles or paths that cannot be replaced.
    """
    lines = list[str]()
    if task.muscles is not None:
        from mbd_ros.features.prediction.smooth_muscles import with_smooth_muscles

        scene, line = with_smooth_muscles(scene, task.muscles)
        lines.append(line)
    if not wrapping(scene):
        return scene, task, tuple(lines)
    from mbd_ros.features.prediction.fitted_paths import with_fitted_paths

    limits = dict(_limits(scene, task, recording))
    scene, more, joints = with_fitted_paths(scene, limits)
    held = {f"{name}.position": limits[name] for name in sorted(joints)}
    phases = tuple(replace(one, bounds={**one.bounds, **held}) for one in task.phases)
    return scene, replace(task, phases=phases), (*lines, *more)


def _limits(
    scene: Scene, task: PredictTask, recording: Recording | None
) -> Iterator[tuple[str, Range]]:
    """Ranges of independent joints: bounds of the task, else limits, else near what is named."""
    q = np.atleast_2d(scene.initial.q)
    if recording is not None:
        q = recording.motion(recording.begin + recording.duration * _SHARES)[0]
    lower, upper = independent_limits(scene.robot, scene.couplings)
    places = {int(v): i for i, v in enumerate(scene.couplings.v_index)}
    for joint in scene.robot.joints:
        if joint.v not in places:
            continue
        at, name = places[joint.v], f"{joint.name}.position"
        named = [*q[:, joint.q].tolist(), *_named(task, name)]
        near = min(named) - _BESIDE, max(named) + _BESIDE
        low, high = lower[at], upper[at]
        for phase in task.phases:
            for key, (least, most) in phase.bounds.items():
                if fnmatchcase(name, key):
                    low, high = least, most
        yield (
            joint.name,
            (
                float(low) if np.isfinite(low) else near[0],
                float(high) if np.isfinite(high) else near[1],
            ),
        )


def _named(task: PredictTask, name: str) -> Iterator[float]:
    """Values that a task has of a quantity, at ends and in its guess."""
    for phase in task.phases:
        for given in (phase.start, phase.end):
            for key, values in given.items():
                if fnmatchcase(name, key):
                    yield from (one for one in values if np.isfinite(one))
    for key, lines in task.guess.items():
        if fnmatchcase(name, key):
            yield from lines
