"""The mass matrix M of a configuration as an operator, and whether some force meets no resistance.

A robot can be simulated where x' M x > 0 in all directions x; `check_mass` looks for the direction
of least resistance, and names the joints or the free base without mass.
"""

from functools import cached_property
from typing import Any

import eigenpy
import numpy as np
import pinocchio as pin

from mbd_ros.core.state import Array, State
from mbd_ros.core.thresholds import MASSLESS, SINGULAR_MASS
from mbd_ros.errors import SolveError

_SHARE = 0.1  # of the base in the motion without mass, from which on the base is to blame
_NAMED = 0.3  # share of a joint in that motion, of the largest, to be named


class Mass:
    """M of what is integrated; a value, factorised when `solve` is first asked.

    Who needs no entries asks for products and solutions, which cost less than M where bodies move
    apart from one another.

    Args:
        dense: The matrix, symmetric, shape (nv, nv); it is copied.

    Attributes:
        dense: The matrix, not to be written to.
    """

    def __init__(self, dense: Array) -> None:
        self.dense: Array = np.array(dense)

    def dot(self, v: Array) -> Array:
        """Return M v, shape as v."""
        product: Array = self.dense.dot(v)
        return product

    def diagonal(self) -> Array:
        """Return entries of the diagonal, shape (nv,)."""
        return self.dense.diagonal()

    def solve(self, force: Array) -> Array:
        """Return M^-1 force, shape as `force`, (nv,) or (nv, k)."""
        a: Array = self._factor.solve(force).reshape(force.shape)  # eigenpy flattens one column
        return a

    @cached_property
    def _factor(self) -> Any:
        return eigenpy.LLT(self.dense)


def check_mass(system: Any, q: Array) -> None:
    """Refuse a configuration whose mass matrix is singular.

    The check takes the matrix of the solver, with couplings G' M G: a joint without mass of its
    own may be tied to one that has some. Another configuration may be regular.

    Args:
        system: A `System`.
        q: Configuration of its integrated coordinates.

    Raises:
        SolveError: Names the joints, or the free base.
    """
    M: Array = system.mass(q).dense
    diagonal = M.diagonal()
    largest = float(diagonal.max(initial=0.0))
    empty = diagonal <= MASSLESS * largest
    size = np.sqrt(np.where(empty, 1.0, diagonal))
    scaled = M / size[:, None] / size
    scaled[empty] = scaled[:, empty] = 0.0
    if len(M):
        resistance, motion = _least_resistance(scaled)
        if not resistance > SINGULAR_MASS * len(M):
            raise SolveError(_reason(system, np.abs(motion), bool(empty.any())))


def _least_resistance(M: Array) -> tuple[float, Array]:
    """Return about the smallest eigenvalue and its direction of length one, from pivots.

    With P M P' = L D L' and the smallest pivot d_k, the x of L' P x = e_k has x' M x = d_k. Where
    d_k is far below the other pivots, as in a singular matrix, x is the direction without mass.

    Source: N. J. Higham, Accuracy and Stability of Numerical Algorithms, 2002, ch. 8.3, 10.3.
    """
    factor = eigenpy.LDLT(M)
    pivots: Array = factor.vectorD()
    k = int(np.argmin(pivots))
    x = np.linalg.solve(factor.matrixL().T, np.eye(len(M))[k])
    direction: Array = factor.transpositionsP().T.dot(x)
    square = float(direction.dot(direction))
    return float(pivots[k]) / square, direction / np.sqrt(square)


def _reason(system: Any, free: Array, is_massless: bool) -> str:
    robot = system.robot
    titles = robot.base_titles
    names = {joint.v: f"joint '{joint.name}'" for joint in robot.joints} | titles
    at = system.integrated(np.arange(int(robot.model.nv)))
    chosen = [int(i) for i in np.argsort(-free, kind="stable") if free[i] > _NAMED * free.max()]
    movers = list(dict.fromkeys(names[int(at[i])] for i in chosen))
    loose = [
        titles[int(v)] for v, share in zip(at, free, strict=True) if v in titles and share > _SHARE
    ]
    movers = list(dict.fromkeys(loose)) or movers
    if is_massless and system.bilateral.rows:
        return (
            f"{movers[0]} moves nothing that has mass: tier {system.tier} starts from the mass "
            "matrix without the constraints, which is singular; give its link an <inertial> with "
            "mass and moments"
        )
    if is_massless or len(movers) == 1:
        return (
            f"{movers[0]} moves nothing that has mass: the mass matrix is singular, so forward "
            "dynamics has no answer; give its link an <inertial> with mass and moments"
        )
    return (
        f"{', '.join(movers)} can move against one another without resistance: the mass matrix "
        "is singular at this configuration (gimbal lock), so forward dynamics has no answer; "
        "start from another one"
    )


def check_mass_anywhere(system: Any) -> None:
    """Refuse a system whose mass matrix is singular at any configuration.

    Args:
        system: A `System`.
    """
    model = system.robot.model
    away = np.linspace(0.3, 1.1, int(model.nv))
    q = pin.integrate(model, system.robot.neutral(), away)
    check_mass(system, system.reduce(State(0.0, q, np.zeros_like(away))).q)
