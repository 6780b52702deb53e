"""Forward dynamics with linearly dependent joints as mimic joints of the model."""

from collections.abc import Callable
from functools import partial
from typing import Any

import eigenpy
import numpy as np
import pinocchio as pin

from mbd_ros.core.dynamics.free_motion import writing
from mbd_ros.core.dynamics.independent_joints import IndependentJoints
from mbd_ros.core.dynamics.mechanism import Mechanism
from mbd_ros.core.dynamics.reduced import coupled_solution
from mbd_ros.core.dynamics.system import Accelerator
from mbd_ros.core.model.coupling_functions import Linear
from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import Array, State

_SAME = 1.0e-12


class Mimic:
    """Accelerations of independent joints, from M and h that Pinocchio makes for them at once.

    Args:
        mechanism: What moves.
        couplings: Its dependent joints.
        model: What `mimic_model` makes of them.

    Attributes:
        mechanism: As given.
        coordinates: The independent joints.
    """

    tier = "reduced"

    def __init__(self, mechanism: Mechanism, couplings: Couplings, model: Any) -> None:
        self.mechanism, self.coordinates = mechanism, IndependentJoints(mechanism, couplings)
        self._cholesky = eigenpy.LLT(self.coordinates.chart.nv)
        self._bias = partial(pin.nonLinearEffects, model, pin.Data(model))
        self._mass = mass_matrix(model)

    def accelerate(self, t: float, q: Array, v: Array, u: Array | None) -> Array:
        """The y'' [rad/s^2 or m/s^2], shape (nv,), fresh."""
        mechanism, joints = self.mechanism, self.coordinates
        mechanism.evaluations += 1
        bias = self._bias(q, v)
        self._cholesky.compute(self._mass(q))
        if mechanism.loads.is_empty:
            return np.negative(self._cholesky.solve(bias))
        joints.at(q, v)
        tau = mechanism.tau(t, joints.q, joints.v, u)
        return self._cholesky.solve(joints.G.T.dot(tau) - bias)

    def accelerator(self) -> Accelerator:
        """The function that writes what `accelerate` returns; without loads at once."""
        mechanism, bias, mass = self.mechanism, self._bias, self._mass
        factorise, solve = self._cholesky.compute, self._cholesky.solve
        if not mechanism.loads.is_empty:
            return writing(self.accelerate)

        def accelerate(t: float, q: Array, v: Array, u: Array | None, out: Array) -> None:
            mechanism.evaluations += 1
            h = bias(q, v)
            factorise(mass(q))
            np.negative(solve(h), out)

        return accelerate

    def joint_motion(self, q: Array, v: Array, a: Array) -> tuple[Array, Array, Array]:
        """q, v and a of all joints at the state of the last `accelerate`."""
        self.coordinates.at(q, v)
        return self.coordinates.joint_motion(a)

    def respond(self, q: Array, forces: Array) -> Array:
        """G (G' M G)^-1 G' forces, shape as `forces`."""
        G = self.coordinates.G
        reduced = G.T.dot(forces)
        return G.dot(self._cholesky.solve(reduced).reshape(reduced.shape))

    def solution(
        self, y: State, u: Array | None, a: Array, force: Array | None
    ) -> tuple[Array, Array]:
        """Accelerations of all joints, and multipliers of the couplings."""
        return coupled_solution(self.coordinates, y, u, a, force)


def mimic_model(robot: Robot, couplings: Couplings) -> Any:
    """A model with mimic joints for dependent ones, or None where Pinocchio does not have them.

    Pinocchio has them for linear couplings on a fixed base, to joints that come earlier in the
    model. Where the links beyond a mimic joint branch, `crba` of Pinocchio 4.1 is wrong: hence a
    check. One remaining coordinate gains nothing, and eigenpy gives it other shapes.
    """
    if robot.floating or len(couplings.v_index) == 1:
        return None
    joint_at = {joint.idx_v: joint.id for joint in robot.model.joints if joint.nv == 1}
    follows: dict[int, tuple[int, Linear]] = {}
    model, armature = robot.model, robot.model.armature.copy()
    for pair in couplings.pairs:
        first, function = pair.parent_v, pair.function
        if not isinstance(function, Linear):
            return None
        ancestor, up = follows.get(first, (first, Linear(1.0)))
        factor = function.factor
        function = Linear(factor * up.factor, factor * up.offset + function.offset)
        follows[pair.child_v] = ancestor, function
        parent, child = joint_at[ancestor], joint_at[pair.child_v]
        if parent > child:
            return None
        model = pin.transformJointIntoMimic(model, parent, child, function.factor, function.offset)
        armature[ancestor] += function.factor**2 * armature[pair.child_v]
    model.armature = armature[couplings.v_index]  # Pinocchio leaves that of mimic joints out
    return model if _is_right(model, robot.model, couplings) else None


def mass_matrix(mimic: Any) -> Callable[[Array], Array]:
    """The function from y to the mass matrix of a model with mimic joints, local convention.

    `crba` of Pinocchio 4.1 adds to the forces that its last call left on parents of mimic
    joints: they are set to zero before each call.
    """
    data = pin.Data(mimic)
    parents = {int(mimic.parents[i]) for i in mimic.mimicking_joints}
    left = [data.Fcrb[parent] for parent in sorted(parents)]
    crba = partial(pin.crba, mimic, data)

    def mass(y: Array) -> Array:
        for forces in left:
            forces.fill(0.0)
        return crba(y)

    return mass


def _is_right(mimic: Any, full: Any, couplings: Couplings) -> bool:
    """Whether both models have the same reduced mass matrix at some configuration."""
    y = np.linspace(0.3, 1.1, len(couplings.q_index))
    q = couplings.positions(y)
    G, M = couplings.jacobian(q), pin.crba(full, pin.Data(full), q)
    expected, mass = G.T.dot(M).dot(G), mass_matrix(mimic)
    mass(-y)  # the second call of Pinocchio is the one that may go wrong
    return bool(np.abs(mass(y) - expected).max() <= _SAME * np.abs(expected).max())
