"""Accelerations and multipliers at a state, as people see them beside a motion.

A method that solves for accelerations has them. One that solves for velocities knows which
contacts press, stick and slip in a step; at the end of it gaps and slips are 0 to the order of the
method only, so that the state alone does not say it. Accelerations follow from equations with the
modes of the step. Where there are none (Painlevé's paradox), the mean forces of the step are seen.

Source: F. Génot, B. Brogliato, New results on Painlevé paradoxes, European Journal of Mechanics
A/Solids 18, 1999, sec. 2.
"""

from typing import TYPE_CHECKING, NamedTuple

from mbd_ros.core.state import Array, State
from mbd_ros.errors import SolveError

if TYPE_CHECKING:
    from mbd_ros.core.simulation.simulation import Simulation


class Seen(NamedTuple):
    """What the equations of motion say at a state.

    Attributes:
        a: Accelerations of all joints, shape (nv,).
        lam: Multipliers of all rows, shape (m,).
        is_mean: Whether no accelerations exist there: these belong to the mean forces of a step.
    """

    a: Array
    lam: Array
    is_mean: bool = False


def seen_at(
    simulation: "Simulation", x: State, u: Array | None = None, forces: Array | None = None
) -> Seen:
    """Accelerations and multipliers of a simulation at a state of all joints.

    Args:
        simulation: The simulation; its next step is the same afterwards, to the bit.
        x: The state.
        u: Inputs there; None for those of the sources.
        forces: `Stepper.forces` of the step that led to the state; None where there was none.

    Raises:
        SolveError: There are none, and the method solves for accelerations.
    """
    if forces is not None:
        from mbd_ros.core.simulation.step_forces import seen_with

        return seen_with(simulation, x, u, forces)
    try:
        _, a, _, lam, _ = simulation.system.evaluate(x, u)
    except SolveError:
        if not (simulation.integrator.at_velocity_level and simulation.system.layout.cones):
            raise
        from mbd_ros.core.simulation.step_forces import seen_ahead

        return seen_ahead(simulation, x, u)
    return Seen(a, lam)
