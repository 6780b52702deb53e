"""Moving horizon estimation: the most likely motion over a window of recent samples."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated, Any, Literal

import numpy as np

from mbd_ros.core.ranges import NotNegative, Positive, Unit, Within
from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import TINY
from mbd_ros.errors import ModelError, SolveError
from mbd_ros.methods.estimation.horizon_chain import Arrival, HorizonChain, Node, WindowSolution
from mbd_ros.methods.estimation.horizon_window import HorizonProgram
from mbd_ros.methods.estimation.kalman_update import Innovation, Update, compute_update
from mbd_ros.methods.estimation.process import Belief, Estimator, Measurement, Observation, Process


class MovingHorizon(Estimator):
    """Moving horizon estimator: maximum-likelihood motion over a window of samples.

    A sample that leaves the window is replaced by an arrival cost: the earlier prediction of its
    successor, with the covariance of the Kalman filter. Each correction does up to `iterations`
    Gauss-Newton steps, starting from the previous window. The program is stated in
    `mbd_ros.methods.estimation.horizon_window`.

    Args:
        samples: Number of measurements in the window; 0 keeps all of them (full information).
        arrival: `filter` for the arrival cost above; `none` uses the prior only, and only while
            the first sample is in the window.
        iterations: Largest number of linearisations per measurement.
        settled: Step of the newest estimate below which the iteration stops [standard
            deviations].
        relinearize: Step of a node above which it is linearised again [m, rad and their rates];
            the error of a stale linearisation is of the order of its square.
        lower: Lower bounds of the disturbances, shape (nw,), or one number for all; none by
            default.
        upper: Upper bounds of the disturbances.
        keep_bounds: Whether the bounds of states are respected.

    Raises:
        ModelError: The bounds have another size, or a lower one is above the upper one.
    """

    example = {"samples": 20}

    def __init__(
        self,
        process: Process,
        *,
        samples: Annotated[int, Within(0, 10_000), Unit("-")] = 20,
        arrival: Literal["filter", "none"] = "filter",
        iterations: Annotated[int, Within(1, 50), Unit("-")] = 3,
        settled: Annotated[Positive, Unit("-")] = 1.0e-3,
        relinearize: Annotated[NotNegative, Unit("-")] = 1.0e-2,
        lower: float | Sequence[float] = -math.inf,
        upper: float | Sequence[float] = math.inf,
        keep_bounds: bool = True,
    ) -> None:
        super().__init__(process)
        self.samples = samples
        self.arrival = arrival
        self.keep_bounds = keep_bounds
        self.iterations = iterations
        self.settled = settled
        self.relinearize = relinearize
        try:
            low, high = (np.broadcast_to(np.asarray(b, float), process.nw) for b in (lower, upper))
        except ValueError as error:
            raise ModelError(
                f"lower and upper must be one number or {process.nw} numbers, one per disturbance"
            ) from error
        if not (low <= high).all():
            raise ModelError("lower has an entry above that of upper")
        self._program = HorizonProgram(process, low, high)
        self._chain = HorizonChain(process, low, high)
        self._low = low
        self._high = high

    def begin(self, x: Any, P: Array, t: float = 0.0) -> Belief:
        """Start from a prior, which is the arrival cost of an empty window."""
        super().begin(x, P, t)
        self._nodes = list[Node]()
        self._filtered = self.belief.P
        self._predicted = Arrival(x, self.belief.P)
        self._arrivals = list[Arrival]()
        self._has_prior = True
        self.answer: WindowSolution | None = None
        self._offsets = np.zeros((0, self.process.n))
        self._chain.released = set()
        return self.belief

    def predict(self, u: Array | None, t: float) -> Belief:
        """Predict the belief at a later time by the motion from the newest node."""
        process, belief = self.process, self.belief
        motion = process.advance(belief.x, u, t)
        x = motion.x
        disturbance = np.clip(0.0, self._low, self._high)  # the smallest within the bounds
        if disturbance.any():
            x = process.plus(x, motion.G.dot(disturbance))
        if self._nodes:
            newest = self._nodes[-1] = replace(self._nodes[-1], u=u, transition=motion)
            P = self._chain.predict_covariance(newest, motion) if newest.link is not None else None
        else:
            P = None
        if P is None:
            P = motion.F.dot(self._filtered).dot(motion.F.T) + motion.noise
            P = 0.5 * (P + P.T)
        self._predicted = Arrival(x, P)
        self.belief = belief._replace(t=t, x=x, P=self._predicted.P)
        return self.belief

    def correct(self, measurement: Measurement, observation: Observation | None = None) -> Belief:
        """Correct the belief by a measurement; if `is_late`, by the Kalman filter alone."""
        process, x = self.process, self.belief.x
        values = np.asarray(measurement.values, dtype=np.float64)
        if measurement.used is not None:
            values = np.where(measurement.used, values, np.nan)
        if observation is None:
            observation = process.observe(x, self._nodes[-1].u if self._nodes else None)
        assert self._predicted.P is not None
        update = compute_update(
            self._predicted.P, observation.H, observation.R, values - observation.y
        )
        self._filtered = update.P
        used = update.innovation.used
        node = Node(measurement.t, x, np.where(used, values, np.nan), observation=observation)
        node.bounds = process.bounds(x) if self.keep_bounds else None
        self._nodes.append(node)
        self._arrivals.append(self._predicted)
        self._shorten()
        if self.is_late:
            self.belief = self._filter_only(update)
        else:
            self.belief = self._solve_window(update.innovation)
        return self.belief

    @property
    def given_up(self) -> list[int]:
        """Indices, in `Process.bounds`, of the bounds that measurements contradict."""
        return sorted(self._chain.released)

    def window(self) -> list[Any]:
        """Return the estimated states at the samples of the window."""
        pairs = zip(self._nodes, self._offsets, strict=True)
        return [self.process.plus(node.x, offset) for node, offset in pairs]

    def _filter_only(self, update: Update) -> Belief:
        """Return the belief of the Kalman filter, when there is no time to solve the window."""
        newest = len(self._nodes) - 1
        self._offsets = np.zeros((newest + 1, self.process.n))
        self._linearize(newest, self.process.plus(self._nodes[newest].x, update.step))
        t, x = self._nodes[newest].t, self._nodes[newest].x
        return Belief(t, x, update.P, update.innovation, False, "late: filter alone")

    def checkpoint(self) -> Any:
        """Return a checkpoint of the window and of its released bounds."""
        beliefs = self.belief, self._filtered, self._predicted, list(self._arrivals)
        released = set(self._chain.released)
        return beliefs, list(self._nodes), self._has_prior, self.answer, released

    def restore(self, checkpoint: Any) -> None:
        """Restore a checkpoint."""
        beliefs, nodes, self._has_prior, self.answer, released = checkpoint
        self._chain.released = set(released)
        self.belief, self._filtered, self._predicted, arrivals = beliefs
        self._arrivals = list(arrivals)
        self._nodes = list(nodes)

    def _shorten(self) -> None:
        """Drop the oldest sample; the prediction of its successor becomes the arrival cost."""
        if self.samples and len(self._nodes) > self.samples:
            link = self._nodes.pop(0).link
            del self._arrivals[0]
            if link is not None and link.next_x is self._nodes[0].x:
                self._arrivals[0] = self._arrivals[0]._replace(P=link.prior)
            self._has_prior = False

    def _arrival_cost(self) -> Arrival:
        """Return the arrival cost of the window; its P is None where nothing is known."""
        oldest = self._arrivals[0]
        if self.arrival == "filter" or self._has_prior:
            return oldest
        return Arrival(oldest.x, None)

    def _solve_window(self, innovation: Innovation) -> Belief:
        """Return the belief by the most likely motion over the window."""
        belief, nodes = self.belief, self._nodes
        arrival = self._arrival_cost()
        try:
            for _ in range(self.iterations):
                solver = self._program if arrival.P is None else self._chain
                answer = solver.solve(nodes, arrival)
                if self._take_step(answer):
                    break
        except SolveError as error:
            return belief._replace(
                innovation=innovation, is_trusted=False, remark=f"no estimate: {error}"
            )
        self.answer = answer
        return Belief(nodes[-1].t, nodes[-1].x, answer.P, innovation)

    def _take_step(self, answer: WindowSolution) -> bool:
        """Move the nodes to a solution and linearise those that moved far.

        Returns:
            Whether the step of the newest node is small enough to stop.
        """
        steps = answer.steps
        sizes = np.sqrt(np.maximum(answer.P.diagonal(), TINY))
        is_settled = bool((np.abs(steps[-1]) <= self.settled * sizes).all())
        far = (np.abs(steps) > self.relinearize * self.process.sizes).any(axis=1)
        far[-1] = True
        self._offsets = np.where(far[:, None], 0.0, steps)
        for i in far.nonzero()[0].tolist():
            self._linearize(i, self.process.plus(self._nodes[i].x, steps[i]))
        return is_settled

    def _linearize(self, i: int, x: Any) -> None:
        """Move a node to a state and linearise the process there."""
        process, nodes, node = self.process, self._nodes, self._nodes[i]
        motion = None
        if i + 1 < len(nodes):
            motion = process.advance(x, node.u, nodes[i + 1].t)
        nodes[i] = replace(
            node,
            x=x,
            observation=process.observe(x, nodes[i - 1].u if i else node.u),
            bounds=process.bounds(x) if self.keep_bounds else None,
            transition=motion,
        )
