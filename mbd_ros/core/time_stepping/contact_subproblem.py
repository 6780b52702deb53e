"""One problem of a step with contacts, and what its impulses mean."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.complementarity.contact_problem import ContactProblem, Residuals
from mbd_ros.core.state import Array
from mbd_ros.core.time_stepping.slip_ends import WORK, dots
from mbd_ros.core.time_stepping.step_problem import StepProblem
from mbd_ros.core.time_stepping.unilateral_rows import Acting

OF_ONE = 3  # rows of one contact
_ACCEPTED = 1.0e-9  # of the rates that impulses of a step end: what may be left of them
_SAME = 1.0e-14  # of rates: what rounding leaves of them


class AskedContacts(NamedTuple):
    """One problem with contacts.

    Attributes:
        problem: That of the step.
        chosen: The rows that are on.
        on: Their places in the problem of the step.
        A: Rates that their impulses add, shape (m, m).
        solver: Of their laws.
        b: Their rates without impulses, shape (m,).
        bend: What of these comes from the change of J, shape (m,).
        known: Bounds of the impulses, and a velocity.
        warm: Impulses to begin with, shape (m,).
        shared: Whether contacts that depend on one another share with the least norm: those of
            the end of a step do, the next one begins with them.
    """

    problem: StepProblem
    chosen: Acting
    on: NDArray[np.intp]
    A: Array
    solver: ContactProblem
    b: Array
    bend: Array
    known: tuple[Array, Array, float]
    warm: Array
    shared: bool

    def solve(self, late: Array | None = None) -> Array:
        """The impulses, shape (m,); arguments as for `ContactProblem`."""
        known = *self.known, late, self.warm
        return self.solver.solve(self.b, *known, shared=self.shared, accepted=_ACCEPTED)

    def sticks(self) -> bool:
        """Whether those to begin with, if within the cones, leave all contacts at rest."""
        if len(self.b) != OF_ONE * len(self.chosen.cones):
            return False
        size = float(np.abs(self.b).max())
        return float(np.abs(self.A.dot(self.warm) + self.b).max()) <= _SAME * size

    def takes_energy(self, p: Array, before: Array) -> bool:
        """Whether friction does no work in all, with slips before the step, shape (n, 2)."""
        at = self.chosen.tangents
        end = (self.A[at].dot(p) + self.b[at] - self.bend[at]).reshape(-1, 2)
        work = float(dots(before + end, p[at].reshape(-1, 2)).sum())
        return work <= WORK * self.known[2] ** 2

    def left(self, p: Array) -> Residuals:
        """What impulses leave of the laws where all contacts are at rest."""
        w, parts = self.A.dot(p) + self.b, p.reshape(-1, 3)
        slips = w.reshape(-1, 3)[:, 1:]
        mu = np.array([cone.mu for cone in self.chosen.cones])
        over = float((np.hypot(parts[:, 1], parts[:, 2]) - mu * parts[:, 0]).max())
        slip = math.sqrt(float(dots(slips, slips).max()))
        return Residuals(float(np.abs(w[::3]).max()), 0.0, max(over, 0.0), slip)
