"""Moving horizon estimation: the motion of the last samples that physics allows."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated, Any, Literal

import numpy as np

from mbd_ros.core.ranges import NotNegative, Positive, Unit, Within
from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import TINY
from mbd_ros.errors import ModelError, SolveError
from mbd_ros.methods.estimation.horizon_chain import Answer, Arrival, HorizonChain, Node
from mbd_ros.methods.estimation.horizon_window import HorizonProgram
from mbd_ros.methods.estimation.kalman_update import Innovation, Update, updated
from mbd_ros.methods.estimation.process import Belief, Estimator, Measurement, Observation, Process


class MovingHorizon(Estimator):
    """The most likely motion of a window of samples, see `methods/estimation/horizon_window.py`.

    A sample that leaves the window leaves its arrival cost behind: the estimate that was made of
    its successor then, with the covariance of the Kalman filter. A correction takes up to
    `iterations` of Gauss and Newton's method and begins from the last window.

    Args:
        samples: Measurements in the window; 0 for all (full information).
        arrival: `filter`, or `none`: only the prior counts, and only while it is in the window.
        iterations: Linearisations a measurement, at most.
        settled: Step of the newest estimate after which there is no other iteration, in standard
            deviations.
        relinearize: Step of a node after which it is linearised again [m, rad and rates]; the
            error is of the order of its square.
        lower: Smallest disturbances, shape (nw,); one number for all; none by default.
        upper: Largest disturbances.
        keep_bounds: Whether states keep their bounds.

    Raises:
        ModelError: Bounds of another size, or a lower one above the upper one.
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
                f"bounds of disturbances: accepted are {process.nw} numbers"
            ) from error
        if not (low <= high).all():
            raise ModelError("a lower bound of a disturbance is above its upper one")
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
        self.answer: Answer | None = None
        self._offsets = np.zeros((0, self.process.n))
        self._chain.released = set()
        return self.belief

    def predict(self, u: Array | None, t: float) -> Belief:
        """The belief at a later time, by the motion from the newest node."""
        process, belief = self.process, self.belief
        going = process.advance(belief.x, u, t)
        ahead = going.x
        push = np.clip(0.0, self._low, self._high)
        if push.any():
            ahead = process.plus(ahead, going.G.dot(push))
        if self._nodes:
            last = self._nodes[-1] = replace(self._nodes[-1], u=u, going=going)
            P = self._chain.ahead(last, going) if last.link is not None else None
        else:
            P = None
        if P is None:
            P = going.F.dot(self._filtered).dot(going.F.T) + going.noise
            P = 0.5 * (P + P.T)
        self._predicted = Arrival(ahead, P)
        self.belief = belief._replace(t=t, x=ahead, P=self._predicted.P)
        return self.belief

    def correct(self, measurement: Measurement, seen: Observation | None = None) -> Belief:
        """The belief by a measurement; with `is_late` by a step of the filter alone."""
        process, x = self.process, self.belief.x
        values = np.asarray(measurement.values, dtype=np.float64)
        if measurement.used is not None:
            values = np.where(measurement.used, values, np.nan)
        if seen is None:
            seen = process.observe(x, self._nodes[-1].u if self._nodes else None)
        assert self._predicted.P is not None
        judged = updated(self._predicted.P, seen.H, seen.R, values - seen.y)
        self._filtered, used = judged.P, judged.innovation.used
        node = Node(measurement.t, x, np.where(used, values, np.nan), seen=seen)
        node.bounded = process.bounded(x) if self.keep_bounds else None
        self._nodes.append(node)
        self._arrivals.append(self._predicted)
        self._shorten()
        if self.is_late:
            self.belief = self._filtered_alone(judged)
        else:
            self.belief = self._solved(judged.innovation)
        return self.belief

    @property
    def given_up(self) -> list[int]:
        """Bounds of states that measurements contradict, by their place in `Process.bounded`."""
        return sorted(self._chain.released)

    def window(self) -> list[Any]:
        """States of the process at the samples of the window, by all of its measurements."""
        pairs = zip(self._nodes, self._offsets, strict=True)
        return [self.process.plus(node.x, offset) for node, offset in pairs]

    def _filtered_alone(self, judged: Update) -> Belief:
        """The belief of a sample for which there is no time to solve the window."""
        newest = len(self._nodes) - 1
        self._offsets = np.zeros((newest + 1, self.process.n))
        self._linearize(newest, self.process.plus(self._nodes[newest].x, judged.step))
        t, x = self._nodes[newest].t, self._nodes[newest].x
        return Belief(t, x, judged.P, judged.innovation, False, "late: filter alone")

    def remember(self) -> Any:
        """The window and what was released of its bounds, to be taken up again."""
        kept = self.belief, self._filtered, self._predicted, list(self._arrivals)
        released = set(self._chain.released)
        return kept, list(self._nodes), self._has_prior, self.answer, released

    def recall(self, memory: Any) -> None:
        """Take up a window."""
        kept, nodes, self._has_prior, self.answer, released = memory
        self._chain.released = set(released)
        self.belief, self._filtered, self._predicted, arrivals = kept
        self._arrivals, self._nodes = list(arrivals), list(nodes)

    def _shorten(self) -> None:
        """Let the oldest sample go; what was believed of its successor is the arrival cost."""
        if self.samples and len(self._nodes) > self.samples:
            gone = self._nodes.pop(0).link
            del self._arrivals[0]
            if gone is not None and gone.next_x is self._nodes[0].x:
                self._arrivals[0] = self._arrivals[0]._replace(P=gone.ahead_turned)
            self._has_prior = False

    def _first(self) -> Arrival:
        known = self._arrivals[0]
        if self.arrival == "filter" or self._has_prior:
            return known
        return Arrival(known.x, None)

    def _solved(self, innovation: Innovation) -> Belief:
        belief, nodes = self.belief, self._nodes
        arrival = self._first()
        try:
            for _ in range(self.iterations):
                solver = self._program if arrival.P is None else self._chain
                answer = solver.solve(nodes, arrival)
                if self._follow(answer):
                    break
        except SolveError as error:
            return belief._replace(
                innovation=innovation, is_trusted=False, remark=f"no estimate: {error}"
            )
        self.answer = answer
        return Belief(nodes[-1].t, nodes[-1].x, answer.P, innovation)

    def _follow(self, answer: Answer) -> bool:
        """Move nodes to the answer, linearise those that moved far; whether the newest did not."""
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
        """Move a node to a state, and linearise it there."""
        process, nodes, node = self.process, self._nodes, self._nodes[i]
        going = None
        if i + 1 < len(nodes):
            going = process.advance(x, node.u, nodes[i + 1].t)
        nodes[i] = replace(
            node,
            x=x,
            seen=process.observe(x, nodes[i - 1].u if i else node.u),
            bounded=process.bounded(x) if self.keep_bounds else None,
            going=going,
        )
