"""How the joints of a recording move."""

import numpy as np

from mbd_ros.features.identification.factors import triangle_of
from mbd_ros.features.identification.problem import Problem

_AS_ONE = 1.0e-2  # of the velocities: what is left of them where joints move as one


def movement(problem: Problem) -> list[tuple[str, float, str]]:
    """Of each driven joint: name, how far it moves [rad or m], the body it moves first."""
    far, mine = np.zeros(len(problem.rows)), problem.maker.coordinates
    for piece in problem.pieces:
        step = float(np.median(np.diff(piece.times)))
        far = np.maximum(far, np.ptp(np.cumsum(piece.v[:, mine], axis=0), axis=0) * step)
    model, at = problem.scene.robot.model, problem.scene.couplings.v_index
    first = {int(model.joints[body.joint].idx_v): body.name for body in problem.bodies}
    names = [first.get(int(at[i]), n) for i, n in zip(mine, problem.labels, strict=True)]
    every = zip(problem.labels, far.tolist(), names, strict=True)
    return [one for one, joint in zip(every, problem.joints, strict=True) if joint >= 0]


def moves_as_one(problem: Problem) -> bool:
    """Whether all driven joints move in one phase, each by its own factor."""
    mine = problem.maker.coordinates[problem.joints >= 0]
    if len(mine) < 2:
        return False
    v = triangle_of(np.concatenate([piece.v for piece in problem.pieces])[:, mine])
    size = np.linalg.norm(v, axis=0)
    s = np.linalg.svd(v / np.where(size > 0.0, size, 1.0), compute_uv=False)
    return bool(s[1] < _AS_ONE * s[0])
