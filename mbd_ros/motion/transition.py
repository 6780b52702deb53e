"""Double supports of a motion in which the load passes smoothly from foot to foot."""

from collections.abc import Callable, Iterator, Sequence

import numpy as np
import pinocchio as pin

from mbd_ros.core.inverse_dynamics.bounded_split import Wish
from mbd_ros.core.inverse_dynamics.closed_loop import ClosedLoopInverseDynamics
from mbd_ros.core.inverse_dynamics.torques import Torques
from mbd_ros.core.inverse_dynamics.unknowns import Mask
from mbd_ros.core.state import Array, State
from mbd_ros.errors import SolveError
from mbd_ros.motion.double_support import (
    DoubleSupport,
    direction_of_way,
    double_supports,
    kept_force,
    possible_force,
)

Solve = Callable[[int, Wish | None], Torques]


def smooth_transitions(
    inverse: ClosedLoopInverseDynamics,
    states: Sequence[tuple[State, Array]],
    standing: Mask,
    solved: list[Torques],
    solve: Solve,
) -> str:
    """Solve double supports again, so that the load passes on smoothly.

    Args:
        inverse: The solver.
        states: Motion and accelerations.
        standing: Which features stand, shape (n, features).
        solved: Results, some of which are replaced.
        solve: Number of a sample and a wish -> its result.

    Returns:
        How many there are, in words.
    """
    transition = _Transition(inverse, states, standing, solved)
    refused = 0
    for support in transition.supports:
        for i, wish in transition.wishes(support):
            try:
                solved[i] = solve(i, wish)
            except SolveError:
                refused += 1
    passed = f"smooth transition in {len(transition.supports)} double supports"
    return passed + (f", without {refused} samples where cones forbid it" if refused else "")


class _Transition:
    """Double supports of a motion that was solved with the least efforts.

    Args:
        inverse: The solver.
        states: Motion and accelerations.
        standing: Which features stand, shape (n, features).
        solved: Their results.

    Attributes:
        supports: Those that begin in the motion.
    """

    def __init__(
        self,
        inverse: ClosedLoopInverseDynamics,
        states: Sequence[tuple[State, Array]],
        standing: Mask,
        solved: Sequence[Torques],
    ) -> None:
        assert inverse.standing is not None
        self._feet, self._model = inverse.standing, inverse.robot.model
        self._states, self._standing = states, standing
        cones = inverse.constraints.cones
        slots = np.concatenate([np.r_[cone.slots] for cone in cones])
        self._forces = [each.multipliers[slots] for each in solved]
        self._mu = min(cone.mu for cone in cones)
        self._times = np.array([x.t for x, _ in states])
        stands = np.array([self._feet.standing_feet(row) for row in standing])
        self.supports = list(double_supports(self._times, stands))

    def wishes(self, support: DoubleSupport) -> Iterator[tuple[int, Wish]]:
        """The force of the trailing foot in each sample of a double support."""
        (before, samples, foot, end), times = support, self._times
        at_first = self._feet.forces(self._states[before][0])[foot].dot(self._forces[before])
        data, ends = pin.Data(self._model), (before, samples[-1])
        centres = [pin.centerOfMass(self._model, data, self._states[i][0].q).copy() for i in ends]
        way = direction_of_way(centres, self._model.gravity.linear)
        for i in samples:
            share = float((times[i] - times[before]) / (end - times[before]))
            forces = self._feet.forces(self._states[i][0])
            total = forces.sum(axis=0).dot(self._forces[i])
            others = np.delete(forces, foot, axis=0).sum(axis=0)[:, ::3]
            normal = others.dot(self._standing[i])
            normal /= np.linalg.norm(normal)
            kept = kept_force(at_first, way, min(share, 1.0))
            yield i, Wish(forces[foot], possible_force(kept, total, normal, self._mu))
