"""What marker kinematics says of a fit, a line each."""

from collections.abc import Iterator

import numpy as np

from mbd_ros.features.markers.exchanged_labels import exchanged_labels
from mbd_ros.features.markers.marker_cost import Seen
from mbd_ros.features.markers.marker_fit import Fit
from mbd_ros.features.markers.marker_kinematics import MarkerKinematics
from mbd_ros.motion.marker_recording import Capture

_LOOSE = 1.0e-10  # of the largest eigenvalue of a Hessian: a direction that nothing tells of
_TAKES_PART = 0.3  # entry of such a direction
_ROUNDING = 1.0e-9  # rad or m from a limit


def remarks_of(solver: MarkerKinematics, capture: Capture, seen: Seen, fit: Fit) -> Iterator[str]:
    """Quality, the marker that misses most, limits, what is not determined, exchanged labels."""
    apart = np.linalg.norm(fit.misses, axis=2) * (seen.weights > 0.0)
    if apart.size:
        frame, marker = np.unravel_index(int(np.argmax(apart)), apart.shape)
        count = max(int((seen.weights > 0.0).sum()), 1)
        yield (
            f"markers miss by {1e3 * np.sqrt((apart**2).sum() / count):.4g} mm rms, most "
            f"{solver.labels[marker]} by {1e3 * apart[frame, marker]:.4g} mm at "
            f"t = {capture.times[frame]:.9g} s"
        )
    yield f"last steps at most {fit.remainder.max():.3g} rad or m (conditions of the optimum)"
    lost = np.flatnonzero(~fit.settled)
    if len(lost):
        yield (
            f"warning: {len(lost)} frames did not settle, the first at "
            f"t = {capture.times[lost[0]]:.9g} s"
        )
    yield from _at_limits(solver, fit)
    yield from _undetermined(solver, seen, fit)
    for one in exchanged_labels(solver.solver, fit, seen):
        begin, end = (capture.times[frame] for frame in one.frames)
        yield (
            f"warning: labels {solver.labels[one.first]} and {solver.labels[one.second]} seem "
            f"exchanged from {begin:.9g} to {end:.9g} s: the objective would fall from "
            f"{one.before:.3g} to {one.after:.3g} m^2"
        )


def _names(solver: MarkerKinematics) -> list[str]:
    """Of the independent coordinates."""
    robot, v = solver.robot, solver.solver.cost.couplings.v_index
    titles = {joint.v: joint.name for joint in robot.joints} | robot.base_titles
    return [titles[int(i)] for i in v]


def _at_limits(solver: MarkerKinematics, fit: Fit) -> Iterator[str]:
    y, names = fit.q[:, solver.solver.cost.y_of_q], _names(solver)
    for bound, what in ((solver.solver.lower, "lower"), (solver.solver.upper, "upper")):
        there = (np.abs(y - bound) <= _ROUNDING).sum(axis=0)
        for i in np.flatnonzero(there):
            yield f"{names[i]} is at its {what} limit of {bound[i]:.6g} in {there[i]} frames"


def _undetermined(solver: MarkerKinematics, seen: Seen, fit: Fit) -> Iterator[str]:
    """Coordinates that could move in the first frame without any effect."""
    first = slice(0, 1)
    hessian = solver.solver.cost.at(fit.q[first], seen.of(first), np.zeros(1)).hessian[0]
    if solver.solver.loops is not None or not len(hessian):
        return
    values, vectors = np.linalg.eigh(hessian)
    loose = vectors[:, values <= _LOOSE * max(values[-1], 0.0)]
    taking = np.flatnonzero((np.abs(loose) > _TAKES_PART).any(axis=1))
    names = dict.fromkeys(_names(solver)[i] for i in taking)
    if names:
        yield f"warning: markers do not determine {', '.join(names)}, which stay near the start"
