"""Contract of estimators: from what is measured to what is believed."""

from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.estimation.kalman_update import Bools, Innovation
from mbd_ros.core.estimation.process import Observation, Process, refuse_no_covariance
from mbd_ros.core.state import Array
from mbd_ros.errors import ModelError


class Measurement(NamedTuple):
    """What sensors said at one time.

    Attributes:
        t: Time [s].
        values: Of all sensors of the process, NaN where nothing came, shape (m,).
        used: Which of them count, shape (m,); None for all that are finite.
    """

    t: float
    values: Array
    used: Bools | None = None


class Belief(NamedTuple):
    """What an estimator believes.

    Attributes:
        t: Time [s].
        x: State of the process.
        P: Covariance of the step of its tangent from x to the true state, shape (n, n).
        innovation: Of the newest measurement; None before the first one.
        is_trusted: Whether the estimator stands by it; why not is in `remark`.
        remark: Empty while it is trusted.
    """

    t: float
    x: Any
    P: Array
    innovation: Innovation | None = None
    is_trusted: bool = True
    remark: str = ""


class Estimator:
    """Follows a process by measurements: `begin`, then `predict` and `correct` in turn.

    Args:
        process: The process.

    Attributes:
        process: As given.
        belief: The newest one.
        is_late: Whether there is no time for more than the least; who asks sets it.
    """

    belief: Belief
    is_late: bool = False

    def __init__(self, process: Process) -> None:
        self.process = process

    def begin(self, x: Any, P: Array, t: float = 0.0) -> Belief:
        """Begin with a prior.

        Args:
            x: State of the process.
            P: Its covariance, shape (n, n).
            t: Time [s].

        Raises:
            ModelError: P is no covariance of that size.
        """
        n = self.process.n
        if np.shape(P) != (n, n):
            raise ModelError(f"P has shape {np.shape(P)}, accepted: {(n, n)}")
        refuse_no_covariance("P", np.asarray(P))
        self.belief = Belief(t, x, np.array(P, dtype=np.float64))
        return self.belief

    def predict(self, u: Array | None, t: float) -> Belief:
        """Go to a later time [s] under inputs that were held since the last one, (nu,) or None."""
        raise NotImplementedError

    def correct(self, measurement: Measurement, seen: Observation | None = None) -> Belief:
        """Take what was measured at the time of the newest belief.

        Args:
            measurement: What was measured.
            seen: What should be seen there, where that is known already.
        """
        raise NotImplementedError

    def remember(self) -> Any:
        """All that later answers depend on, as a value for `recall`."""
        return self.belief

    def recall(self, memory: Any) -> None:
        """Go back to what `remember` gave."""
        self.belief = memory
