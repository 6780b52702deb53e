"""The Kalman filter on the manifold of consistent states."""

from typing import Any

from mbd_ros.core.estimation.estimator import Belief, Estimator, Measurement
from mbd_ros.core.estimation.kalman_update import Update, updated
from mbd_ros.core.estimation.process import Observation, Process, Transition, moved
from mbd_ros.core.estimation.smoother import Filtered
from mbd_ros.core.state import Array


class KalmanFilter(Estimator):
    """x goes on as the process does; its covariance by F P F' + G Q G', then `kalman_update`.

    Corrections are steps of the tangent, so that couplings and loops stay closed; P lies in it.
    With `iterations` the measurement is linearised again about what it says: Gauss and Newton's
    method for the maximum of the posterior. Source: B. M. Bell, F. W. Cathey, IEEE Trans. Autom.
    Control 38(2) (1993).

    Args:
        process: The process.
        iterations: Linearisations a measurement.

    Attributes:
        going: The interval that was predicted last; None before the first one.
        predicted: What was believed at its end, before the measurement.
    """

    def __init__(self, process: Process, iterations: int = 1) -> None:
        super().__init__(process)
        self.iterations = iterations
        self._u: Array | None = None
        self.going: Transition | None = None

    def predict(self, u: Array | None, t: float) -> Belief:
        """As `Estimator.predict`."""
        going = self.process.advance(self.belief.x, u, t)
        P = going.F.dot(self.belief.P).dot(going.F.T) + going.noise
        self.going, self._u = going, u
        self.belief = self.predicted = self.belief._replace(t=t, x=going.x, P=0.5 * (P + P.T))
        return self.belief

    def correct(self, measurement: Measurement, seen: Observation | None = None) -> Belief:
        """As `Estimator.correct`."""
        process, prior = self.process, self.belief
        x, found, first = prior.x, None, None
        for _ in range(self.iterations):
            here = seen if seen is not None and x is prior.x else process.observe(x, self._u)
            found = self._update(x, measurement, here)
            first = found.innovation if first is None else first
            x = process.plus(prior.x, found.step)
        assert found is not None
        P = moved(process, found.P, prior.x, x)
        self.belief = prior._replace(x=x, P=P, innovation=first)
        return self.belief

    def begin(self, x: Any, P: Array, t: float = 0.0) -> Belief:
        """As `Estimator.begin`."""
        self._u = self.going = None
        self.predicted = super().begin(x, P, t)
        return self.predicted

    @property
    def sample(self) -> Filtered:
        """The newest sample, for smoothers."""
        F = None if self.going is None else self.going.F
        return Filtered(F, self.predicted, self.belief)

    def remember(self) -> Any:
        """As `Estimator.remember`."""
        return self.belief, self._u

    def recall(self, memory: Any) -> None:
        """As `Estimator.recall`."""
        self.belief, self._u = memory

    def _update(self, x: Any, measurement: Measurement, seen: Observation) -> Update:
        """The update of the prior by a measurement that is linearised at x."""
        prior = self.belief
        error = measurement.values - seen.y
        if x is not prior.x:
            error = error + seen.H.dot(self.process.minus(x, prior.x))
        return updated(prior.P, seen.H, seen.R, error, measurement.used)
