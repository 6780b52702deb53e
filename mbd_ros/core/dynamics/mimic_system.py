"""Forward dynamics with linearly dependent joints as mimic joints of the model."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin

from mbd_ros.core.dynamics.loads import Loads
from mbd_ros.core.dynamics.reduced_system import ReducedSystem
from mbd_ros.core.dynamics.system import Accelerator
from mbd_ros.core.model.coupling_functions import Linear
from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.optimization.bounded_rows import BoundedRows
from mbd_ros.core.state import Array

_SAME = 1.0e-12


class MimicSystem(ReducedSystem):
    """A `ReducedSystem` whose M and h Pinocchio makes in the independent coordinates at once.

    Args:
        robot: The robot.
        loads: What acts on its joints.
        couplings: Its dependent joints.
        mimic_model: What `mimic_model` makes of them.
        bounded: Rows with bounded multipliers.
    """

    def __init__(
        self,
        robot: Robot,
        loads: Loads,
        couplings: Couplings,
        mimic_model: Any,
        bounded: BoundedRows | None = None,
    ) -> None:
        super().__init__(robot, loads, couplings, bounded)
        self._own_bias = partial(pin.nonLinearEffects, mimic_model, pin.Data(mimic_model))
        self._own_mass = mass_matrix(mimic_model)
        self._accelerate = self._free_accelerator()

    def acceleration(self, t: float, q: Array, v: Array, u: Array | None = None) -> Array:
        """Acceleration z'' [rad/s^2 or m/s^2], shape (nv,)."""
        if self._is_free:
            a = np.empty(self.nv)
            self._accelerate(t, q, v, u, a)
            return a
        self.evaluations += 1
        bias = self._own_bias(q, v)
        self._cholesky.compute(self._own_mass(q))
        self._expand(q, v)
        a = self._cholesky.solve(self._GT.dot(self._tau(t, self._q, self._v, u)) - bias)
        return a if self.bounded is None else self.bounded.accelerate(self, t, q, v, a)

    def accelerator(self) -> Accelerator:
        """Without loads the function behind `acceleration`: a step takes a tenth less."""
        return self._accelerate if self._is_free else super().accelerator()

    def _free_accelerator(self) -> Accelerator:
        """-M⁻¹ h, written at once."""
        bias, mass = self._own_bias, self._own_mass
        factorise, solve = self._cholesky.compute, self._cholesky.solve

        def accelerate(t: float, q: Array, v: Array, u: Array | None, out: Array) -> None:
            self.evaluations += 1
            h = bias(q, v)
            factorise(mass(q))
            np.negative(solve(h), out)

        return accelerate

    def joint_motion(self, q: Array, v: Array, a: Array) -> tuple[Array, Array, Array]:
        """q, v and a of all joints at the state of the last evaluation."""
        self._expand(q, v)
        return super().joint_motion(q, v, a)


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
    """The function from z to the mass matrix of a model with mimic joints, local convention.

    `crba` of Pinocchio 4.1 adds to the forces that its last call left on parents of mimic
    joints: they are set to zero before each call.
    """
    data = pin.Data(mimic)
    parents = {int(mimic.parents[i]) for i in mimic.mimicking_joints}
    left = [data.Fcrb[parent] for parent in sorted(parents)]
    crba = partial(pin.crba, mimic, data)

    def mass(z: Array) -> Array:
        for forces in left:
            forces.fill(0.0)
        return crba(z)

    return mass


def _is_right(mimic: Any, full: Any, couplings: Couplings) -> bool:
    """Whether both models have the same reduced mass matrix at some configuration."""
    z = np.linspace(0.3, 1.1, len(couplings.q_index))
    q = couplings.positions(z)
    G, M = couplings.jacobian(q), pin.crba(full, pin.Data(full), q)
    expected, mass = G.T.dot(M).dot(G), mass_matrix(mimic)
    mass(-z)  # the second call of Pinocchio is the one that may go wrong
    return bool(np.abs(mass(z) - expected).max() <= _SAME * np.abs(expected).max())
