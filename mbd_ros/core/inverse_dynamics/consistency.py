"""Whether a motion is on the rows that it must keep."""

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.inverse_dynamics.force_split import ForceSplit
from mbd_ros.core.inverse_dynamics.loop_balance import LoopBalance
from mbd_ros.core.state import Array, State
from mbd_ros.core.thresholds import ASSEMBLED
from mbd_ros.errors import SolveError

_OFF = 1.0e-6  # of the terms that should cancel


def check_closed(balance: LoopBalance, x: State) -> None:
    """Check the position.

    Args:
        balance: The rows, placed at the state.
        x: State of all joints.

    Raises:
        SolveError: Names the row that is open.
    """
    g = np.abs(balance.residual(x))
    if g.size and not g.max() <= ASSEMBLED:
        row = balance.constraints.rows[int(np.argmax(g))].name
        raise SolveError(
            f"the motion is not consistent: row {row} is {g.max():.3g} m or rad open; make "
            "it consistent first"
        )


def check_rates(
    balance: LoopBalance,
    split: ForceSplit,
    inside: NDArray[np.intp],
    rows: tuple[Array, Array],
    x: State,
    a: Array,
) -> None:
    """Check velocity and acceleration, toggles apart.

    Args:
        balance: The rows, placed at the state.
        split: Factors of some rows.
        inside: Which rows these are.
        rows: J and drift of all rows, (m, nv) and (m,).
        x: State of all joints.
        a: Their acceleration [rad/s^2 or m/s^2], shape (nv,).

    Raises:
        SolveError: Names the row that either leaves.
    """
    held, (J, drift) = balance.is_held, rows
    if not held.any():
        return
    for what, of, fixed in (("velocity", x.v, balance.rate(x)), ("acceleration", a, drift)):
        off = np.where(held, J.dot(of) + fixed, 0.0)
        terms = np.where(held, np.abs(J).dot(np.abs(of)) + np.abs(fixed), 0.0)
        if not split.violation(off[inside], terms[inside]) <= _OFF:
            worst = int(np.argmax(np.abs(off)))
            raise SolveError(
                f"the motion is not consistent: its {what} leaves row "
                f"{balance.constraints.rows[worst].name} at {abs(off[worst]):.3g}; make it "
                "consistent first"
            )
