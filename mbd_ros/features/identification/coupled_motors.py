"""Motors that turn with two joints: as the scene says, or as friction tells.

The friction of such a motor changes its sign with a sum or a difference of two speeds. Where that
explains what is left of the torque of a joint better than its own speed does, each way in which
two motors can drive two joints one behind the other is fitted, for efforts of joints and of
motors, and the best by Schwarz's information criterion is taken.

Source: G. Schwarz, Ann. Stat. 6, 1978, 461.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.errors import DataError
from mbd_ros.features.identification.band import Filter, grid_step
from mbd_ros.features.identification.friction import Column, columns_of
from mbd_ros.features.identification.least_squares import Fit
from mbd_ros.features.identification.motors import Motors
from mbd_ros.features.identification.noise import noise_of
from mbd_ros.features.identification.problem import Problem
from mbd_ros.features.identification.regression import (
    Search,
    delay_of,
    first_fit,
    residual,
    residuals,
)
from mbd_ros.features.identification.rows import Block
from mbd_ros.jobs.lines import Say
from mbd_ros.scene.built_scene import Scene

_SIGNS = (1.0, -1.0)
_SMOOTHINGS = (0.02, 0.05, 0.2)  # of the usual speed
_WORTH = 2.0  # times the price of a parameter: the least that coupled motors have to gain
_LESS = 0.98  # of the power that is left: what coupled motors leave at most
_ROWS = 20_000  # that tell whether a speed is worth a look


def coupled_in(scene: Scene, labels: Sequence[str]) -> Motors | None:
    """Motors as the `gear_friction` of the scene has them; None if each turns with one joint.

    Raises:
        DataError: They do not determine the torques of the joints.
    """
    motors, ratios = Motors.of_joints(len(labels)), np.eye(len(labels))
    for entry in scene.entries.get("forces") or []:
        also: Mapping[str, float] = entry.get("also") or {}
        for name, ratio in also.items():
            if entry.get("joint") in labels and name in labels:
                ratios[labels.index(entry["joint"]), labels.index(name)] = ratio
    if abs(np.linalg.det(ratios)) < 1e-6:
        raise DataError(f"{scene.name}: forces: `also` couples motors that turn as one")
    motors = motors._replace(ratios=ratios)
    return motors if motors.are_coupled else None


def choose_motors(
    problem: Problem, given: Motors | None, allowed: Sequence[str], search: Search, say: Say
) -> None:
    """Couple the rows of a problem as the scene or the friction says.

    Args:
        problem: The rows, not coupled.
        given: What the scene says.
        allowed: Terms of friction that may be taken.
        search: For the delay of efforts.
        say: Is told of coupled motors.
    """
    if (problem.joints < 0).any() or len(problem.rows) < 2 or problem.scene.has_loops:
        return
    r, blocks = len(problem.base.chosen), problem.blocks
    plain = problem.columns, r, allowed
    delay = delay_of(blocks, *plain, search, problem.correlation)
    first = first_fit(blocks, *plain, delay)
    left = residuals(blocks(np.array([delay])), first)
    noise = [noise_of(own, problem.correlation) for own in left]
    rows = [n.share * len(own) for n, own in zip(noise, left, strict=True)]
    found = _Choice(problem, allowed, delay, np.array(rows))
    if given is not None:
        ways = [given._replace(are_measured=way) for way in (False, True)]
        best = min(ways, key=found.cost)
    else:
        best = found.best(first)
    problem.couple(best)
    for line in _lines(problem, best):
        say(line)


class _Choice:
    """Compares ways to couple motors.

    Args:
        problem: The rows.
        allowed: Terms of friction.
        delay: Of efforts against motion [s].
        effective: Independent rows of each joint, shape (m,).
    """

    def __init__(
        self, problem: Problem, allowed: Sequence[str], delay: float, effective: Array
    ) -> None:
        self._problem, self._allowed, self._delay = problem, allowed, delay
        self._effective, self._price = effective, float(np.log(effective.sum()))

    def best(self, first: Fit) -> Motors:
        """The best way, pair by pair of joints one behind the other."""
        best = Motors.of_joints(len(self._problem.rows))
        cheapest = self.cost(best)
        less = _WORTH * self._price - float(self._effective.mean()) * np.log(_LESS)
        for i in self._suspects(first):
            if not best.alone[[i, i + 1]].all():
                continue
            ways = list(_ways(best, i))
            costs = [self.cost(way) for way in ways]
            if min(costs) < cheapest - less:
                cheapest, best = min(costs), ways[int(np.argmin(costs))]
        return best

    def cost(self, motors: Motors) -> float:
        """Criterion of a way, for efforts as they are measured."""
        problem = self._problem
        problem.couple(motors)
        r = len(problem.base.chosen)
        found = first_fit(problem.blocks, problem.columns, r, self._allowed, self._delay)
        size = 0.0 if motors.are_measured else np.log(abs(np.linalg.det(motors.ratios)))
        fits = float(self._effective @ np.log(np.square(found.deviation)))
        price = self._price * sum(map(len, found.taken))
        return fits + 2.0 * float(self._effective.mean()) * float(size) + price

    def _suspects(self, first: Fit) -> list[int]:
        """Pairs i, i + 1 in which a sum or difference of speeds rubs, the clearest first."""
        m, gains = len(self._problem.rows), dict[int, float]()
        self._problem.couple(Motors.of_joints(m))
        left, speeds, friction = _left_and_speeds(self._problem, first, self._delay)
        for j in range(m):
            own = _power(left[:, j], friction(speeds[:, j]))
            for k in (j - 1, j + 1):
                if not 0 <= k < m or not own > 0.0:
                    continue
                sides = [friction(speeds[:, j] + c * speeds[:, k]) for c in _SIGNS]
                alone = min(_power(left[:, j], side) for side in sides)
                both = _power(left[:, j], np.hstack(sides))
                more = self._price * sides[0].shape[1] / self._effective[j]
                least = max(min(alone, both * float(np.exp(more))), 1e-300)
                gain = self._effective[j] * float(np.log(own / least))
                if gain > self._price:
                    gains[min(j, k)] = max(gain, gains.get(min(j, k), 0.0))
        return sorted(gains, key=lambda pair: -gains[pair])


def _ways(before: Motors, i: int) -> Iterator[Motors]:
    """How two motors can drive joints i and i + 1."""
    for are_measured in {before.are_measured, True}:
        for first, second in ((0, 1), (0, -1), (1, 0), (-1, 0), (1, -1), (-1, 1)):
            ratios = before.ratios.copy()
            ratios[i, i + 1], ratios[i + 1, i] = first, second
            yield Motors(ratios, are_measured)


def _left_and_speeds(
    problem: Problem, first: Fit, delay: float
) -> tuple[Array, Array, Callable[[Array], Array]]:
    """Filtered torques without bodies, speeds, and what makes filtered friction of a speed."""
    piece = max(problem.pieces, key=lambda one: len(one.times))
    blocks, rows = list[Block](), 0
    for block in problem.maker.blocks(piece, problem.band, np.array([delay])):
        blocks, rows = [*blocks, block], rows + len(block.X)
        if rows >= _ROWS:
            break
    left = np.concatenate([residual(block, first) for block in blocks])
    for i, (own, values) in enumerate(zip(first.taken, first.friction, strict=True)):
        left[:, i] += np.concatenate([block.F[i][:, own] for block in blocks]) @ values
    rate = 1.0 / float(np.median(np.diff(piece.times)))
    step = 1 if problem.band is None else grid_step(rate, problem.band)
    v = piece.v[::step, problem.maker.coordinates]
    low = None if problem.band is None else Filter.of(rate / step, problem.band)

    def friction(speed: Array) -> Array:
        usual = float(np.sqrt(np.mean(np.square(speed))))
        dry = [Column("coulomb", s * usual + 1e-300) for s in _SMOOTHINGS]
        every = [Column("viscous"), Column("offset"), *dry]
        found = columns_of(every, speed, speed, speed)
        return (found if low is None else low.passed(found))[:_ROWS]

    return left[:_ROWS], v, friction


def _power(left: Array, columns: Array) -> float:
    """What columns leave of a torque."""
    n = min(len(left), len(columns))
    size = np.linalg.norm(columns[:n], axis=0) + 1e-300
    x = np.linalg.lstsq(columns[:n] / size, left[:n], rcond=1e-9)[0]
    return float(np.sum(np.square(left[:n] - columns[:n] / size @ x)))


def _lines(problem: Problem, motors: Motors) -> Iterator[str]:
    """What is said of coupled motors."""
    for name, others in zip(problem.labels, motors.others, strict=True):
        if others:
            sums = " ".join(
                f"{'+' if r > 0 else '-'} {abs(r):g} {problem.labels[j]}"
                for j, r in others.items()
            )
            yield f"the motor of {name} turns with {name} {sums}"
    if motors.are_measured:
        yield "efforts are those of the motors, not of the joints: the scene says those of joints"


def also_of(problem: Problem) -> list[dict[str, Any]]:
    """Of each row the other joints that turn its motor, by name."""
    return [
        {problem.labels[j]: ratio for j, ratio in others.items()}
        for others in problem.motors.others
    ]
