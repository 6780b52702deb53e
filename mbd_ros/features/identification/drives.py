"""Drives: gains, motors that turn two joints, torques as they were measured.

Coupled motors: the friction of a motor that turns two joints changes its sign with a sum or a
difference of two speeds. Where that explains what is left of the torque of a joint better than its
own speed does, each way in which two motors can drive two joints one behind the other is fitted,
for efforts of joints and of motors, and the best by Schwarz's information criterion is taken.

Gains: efforts i may be in other units than torques, such as motor currents,

    i_j = k_j (X_j b + known_j) + F_j f,    gain_j = 1 / k_j

Bodies b and all k can grow together without a trace in i, unless something is known: a load, a
link, a spring, a measured wrench. Which gains that fixes is what their deviations say.

Torques as they were measured: the controller of a drive damps what it takes for motion, noise
included,

    tau = model(q, v, a) - feedback (v_measured - v)

with v the velocity behind the zero-phase low-pass that the motion asks for. That part of the
torque moves nothing, and no model of bodies has it.

Sources: G. Schwarz, Ann. Stat. 6, 1978, 461 (the criterion). M. Gautier, S. Briot, J. Dyn. Syst.
Meas. Control 136, 2014, 051025 (drive gains of all joints from a known load). L. Ljung, System
Identification, 1999, section 13.4 (noise in a closed loop).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.model.inertial_parameters import parameters_of
from mbd_ros.core.state import Array
from mbd_ros.errors import DataError
from mbd_ros.features.identification.least_squares import (
    Fit,
    Joint,
    Triangle,
    noise_of,
    solved,
    usual_choice,
)
from mbd_ros.features.identification.problem import Block, Motors, Problem, regressor_of
from mbd_ros.features.identification.regression import (
    Search,
    delay_of,
    first_fit,
    residual,
    residuals,
)
from mbd_ros.features.identification.regressor import Column, columns_of
from mbd_ros.features.identification.samples import Filter, Piece, grid_step
from mbd_ros.jobs.progress import Say
from mbd_ros.scene.built_scene import Scene

_SIGNS = (1.0, -1.0)
_SMOOTHINGS = (0.02, 0.05, 0.2)  # of the usual speed
_LEAST_WORTH = 2.0  # times the price of a parameter: the least that coupled motors have to gain
_LEAST_SHRINK = 0.98  # of the power that is left: what coupled motors leave at most
_MOST_ROWS = 20_000  # that tell whether a speed is worth a look
_UNFIXED = 0.1  # relative deviation of a gain that nothing fixes
_GAIN_STEPS = 200  # of the search for gains, at most
_GAIN_REACH = 5.0  # of log k: how far from what the description says
_MOST_COMPARED = 20_000  # samples of a piece that are compared, evenly taken
_ENOUGH_FOR_FEEDBACK = 10_000  # samples that tell a feedback
_OUTLIER = 4.5  # times the median size: such samples, as at a start, tell no feedback
_ROUNDING = 1.0e-9  # of the largest velocity: no noise
_FEWEST_SAMPLES = 20  # samples that tell one at all


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
        less = _LEAST_WORTH * self._price - float(self._effective.mean()) * np.log(_LEAST_SHRINK)
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
        if rows >= _MOST_ROWS:
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
        return (found if low is None else low.passed(found))[:_MOST_ROWS]

    return left[:_MOST_ROWS], v, friction


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


def estimate_gains(problem: Problem, allowed: Sequence[str], say: Say) -> None:
    """Find the gains that are not given, and take efforts for torques from now on.

    Raises:
        DataError: Names the joints whose gains nothing fixes.
    """
    if (problem.joints < 0).any():
        raise DataError(f"{problem.where}: --currents needs an effort of every joint")
    open_ = np.array([name not in problem.gains for name in problem.labels])
    parts = _parts(problem, allowed)
    start = np.array([_slope(part, problem) for part in parts])
    start[~open_] = 1.0  # their efforts are torques already
    share = 1.0 / (1.0 + 2.0 * float(np.sum(np.square(problem.correlation[1:]))))
    k, deviation = _fitted(parts, problem, start, open_, share)
    names = [n for n, s in zip(problem.labels, deviation, strict=True) if not s < _UNFIXED]
    if names:
        raise DataError(
            f"{problem.where}: nothing that is known fixes the gains of {', '.join(names)}: "
            "masses and gains are told as ratios only. Record the motion with a known load, too "
            "(--held RECORDING --payload LINK=MASS,CX,CY,CZ), name links that the description "
            "has right (--known LINK ..), or give gains (--gain JOINT=VALUE ..)"
        )
    found = dict(zip(problem.labels, 1.0 / k, strict=True))
    problem.gain({name: found[name] for name in np.array(problem.labels)[open_]})
    problem.gain_deviation = np.abs(deviation / k)
    every = zip(problem.labels, 1.0 / k, problem.gain_deviation, strict=True)
    texts = (f"{name} {gain:.4g} +- {s:.2g}" for name, gain, s in every)
    say(f"torque for a unit of effort: {', '.join(texts)}")


def _parts(problem: Problem, allowed: Sequence[str]) -> list[tuple[Array, ...]]:
    """Of each joint rows of X, F, known and i, as triangles, over the size of what is left."""
    r, triangles = len(problem.base.chosen), list[Triangle]()
    for block in problem.blocks(np.zeros(1)):
        triangles = triangles or [Triangle(r + len(own) + 2) for own in problem.columns]
        for j, triangle in enumerate(triangles):
            known = block.known[:, j, None]
            rows = np.hstack([block.X[:, j], block.F[j], known, block.Y[:, j] + known])
            triangle.add(rows[block.kept[:, j]])
    parts = []
    for triangle, columns in zip(triangles, problem.columns, strict=True):
        R = triangle.close().R
        taken = usual_choice(Joint(R, triangle.rows, 1.0, columns, 1.0), allowed)
        F = R[:, [r + i for i in taken]]
        every = np.hstack([R[:, :r], F, R[:, -2:-1]])
        left = R[:, -1] - every @ solved(every, R[:, -1])[0]
        size = np.linalg.norm(left) / np.sqrt(max(triangle.rows, 1))
        size = max(size, 1e-9 * np.linalg.norm(R[:, -1]) / np.sqrt(max(triangle.rows, 1)), 1e-300)
        parts.append((R[:, :r] / size, F / size, R[:, -2] / size, R[:, -1] / size))
    return parts


def _slope(part: tuple[Array, ...], problem: Problem) -> float:
    """Effort over the torque of the given robot."""
    X, F, known, i = part
    model = X @ problem.base.values(problem.given.ravel()) + known
    found = solved(np.column_stack([model, F]), i)[0]
    return float(found[0]) or 1.0


def _fitted(
    parts: Sequence[tuple[Array, ...]],
    problem: Problem,
    start: Array,
    is_open: Array,
    share: float,
) -> tuple[Array, Array]:
    """The k, and the relative deviation of each that is open."""
    from scipy.optimize import least_squares

    r, m = len(problem.base.chosen), len(parts)
    at = r + m + np.cumsum([0, *(F.shape[1] for _, F, _, _ in parts)])

    def off(x: Array) -> Array:
        k = start * np.exp(x[r : r + m])
        each = zip(parts, k, at, strict=False)
        return np.concatenate(
            [kj * (X @ x[:r] + n) + F @ x[a : a + F.shape[1]] - i for (X, F, n, i), kj, a in each]
        )

    def slopes(x: Array) -> Array:
        k, rows = start * np.exp(x[r : r + m]), []
        for j, ((X, F, n, _), kj, a) in enumerate(zip(parts, k, at, strict=False)):
            row = np.zeros((len(X), len(x)))
            row[:, :r], row[:, a : a + F.shape[1]] = kj * X, F
            row[:, r + j] = is_open[j] * kj * (X @ x[:r] + n)
            rows.append(row)
        return np.concatenate(rows)

    x0 = np.concatenate([problem.base.values(problem.given.ravel()), np.zeros(at[-1] - r)])
    size = 1.0 / np.maximum(np.linalg.norm(slopes(x0), axis=0), 1e-12)
    reach = np.full(len(x0), np.inf)
    reach[r : r + m] = _GAIN_REACH
    found = least_squares(
        off, x0, slopes, bounds=(-reach, reach), x_scale=size, max_nfev=_GAIN_STEPS
    )
    places = r + np.flatnonzero(is_open)
    s = _deviations(slopes(found.x), places) / np.sqrt(share)
    deviation = np.zeros(m)
    deviation[is_open] = s
    return start * np.exp(found.x[r : r + m]), deviation


def _deviations(J: Array, places: Array) -> Array:
    """Standard deviations of some of the unknowns, inf of those that nothing fixes."""
    norm = np.linalg.norm(J, axis=0)
    kept = np.flatnonzero(norm > 0.0)
    _, s, V = np.linalg.svd(J[:, kept] / norm[kept], full_matrices=False)
    s = np.maximum(s, 1e-9 * s.max(initial=1.0))
    every = np.full(J.shape[1], np.inf)
    every[kept] = np.sqrt(np.sum(np.square(V.T / s), axis=1)) / norm[kept]
    return np.asarray(every[places])


def as_measured(
    problem: Problem, scenes: Sequence[Scene], pieces: Sequence[Piece], delay: float
) -> Measured | None:
    """All samples of pieces, or evenly some; None without any."""
    found = [_of_piece(problem, scenes, piece, delay, _MOST_COMPARED) for piece in pieces]
    return _joined(found) if found else None


class Measured(NamedTuple):
    """Samples of the rows of a problem.

    Attributes:
        times: [s], shape (n,).
        effort: Measured [N·m or N], shape (n, m).
        predictions: What each scene says of it, shape (n, m) each.
        noise: Measured velocity less that of the motion [rad/s or m/s], shape (n, m).
    """

    times: Array
    effort: Array
    predictions: list[Array]
    noise: Array


def _of_piece(
    problem: Problem, scenes: Sequence[Scene], piece: Piece, delay: float, most: int
) -> Measured:
    grid = np.arange(0, len(piece.times), max(len(piece.times) // most, 1))
    times, at = piece.times[grid], problem.joints
    motion = piece.y[grid], piece.v[grid], piece.a[grid]
    loads = [load[grid] for load in piece.loads]
    said = [torques(scene, problem, motion, loads, piece.carried) for scene in scenes]
    noise = np.zeros((len(grid), len(problem.rows)))
    own = problem.maker.coordinates
    noise[:, at >= 0] = (piece.rate[grid][:, at] - motion[1][:, own])[:, at >= 0]
    is_rounding = np.abs(noise) < _ROUNDING * np.abs(motion[1][:, own]).max(axis=0)
    noise[~np.isfinite(noise) | is_rounding] = 0.0
    effort = efforts(problem, piece, piece.measured, grid, 0.0)
    predictions = [_later(times, values, delay) for values in said]
    return Measured(times, effort, predictions, _later(times, noise, delay))


def torques(
    scene: Scene,
    problem: Problem,
    motion: tuple[Array, Array, Array],
    loads: list[Array],
    carried: Array | None,
) -> Array:
    """What a scene says of the efforts of the rows, shape (n, m)."""
    regressor = regressor_of(scene, problem.learned)
    W = regressor.rows(*motion)
    inertial = parameters_of(scene.robot.model).ravel()
    moved = inertial if carried is None else inertial + carried
    found: Array = (W @ moved + regressor.known(W, *motion, loads))[:, problem.rows]
    return problem.motors.measured(found)


def efforts(
    problem: Problem, piece: Piece, values: Array, grid: NDArray[np.intp], delay: float
) -> Array:
    """Efforts of the rows at the times of the motion, 0 of rows without any, shape (n, m)."""
    found = np.zeros((len(grid), len(problem.rows)))
    for k, joint in enumerate(problem.joints):
        if joint >= 0 and delay:
            found[:, k] = np.interp(piece.times[grid] + delay, piece.times, values[:, joint])
        elif joint >= 0:
            found[:, k] = values[grid, joint]
    return found


def _later(times: Array, values: Array, delay: float) -> Array:
    """What is measured of values that arrive later; efforts keep their noise so."""
    if not delay:
        return values
    return np.transpose([np.interp(times - delay, times, column) for column in values.T])


def _joined(found: Sequence[Measured]) -> Measured:
    """Samples of several pieces, one after the other."""
    count = len(found[0].predictions)
    return Measured(
        np.concatenate([one.times for one in found]),
        np.concatenate([one.effort for one in found]),
        [np.concatenate([one.predictions[k] for one in found]) for k in range(count)],
        np.concatenate([one.noise for one in found]),
    )


def feedback_of(
    problem: Problem, scene: Scene, pieces: Sequence[Piece], delay: float
) -> tuple[Array, Array]:
    """What each row answers to a unit of noise, >= 0, and its standard deviation, shape (m,).

    It counts where it is worth its price by Schwarz's information criterion.

    Args:
        scene: What was found.
        pieces: Those that were learned from.
        delay: Of efforts against motion [s].
    """
    found = _joined([_of_piece(problem, [scene], p, delay, _ENOUGH_FOR_FEEDBACK) for p in pieces])
    left = found.effort - found.predictions[0]
    slopes = [_feedback_slope(noise, y) for noise, y in zip(found.noise.T, left.T, strict=True)]
    return np.array([s for s, _ in slopes]), np.array([d for _, d in slopes])


def _feedback_slope(noise: Array, left: Array) -> tuple[float, float]:
    """Of - left over noise, and its deviation; 0 where it is none."""
    usual = left - np.median(left)
    kept = np.abs(usual) <= _OUTLIER * np.median(np.abs(usual))
    x, y, n = noise[kept], usual[kept], int(kept.sum())
    power = float(x @ x)
    if n < _FEWEST_SAMPLES or power == 0.0:
        return 0.0, 0.0
    slope = float(-(x @ y)) / power
    rest = float(np.sum(np.square(y + slope * x)))
    is_worth = n * np.log(max(float(y @ y), 1e-300) / max(rest, 1e-300)) > np.log(n)
    if slope <= 0.0 or not is_worth:
        return 0.0, 0.0
    return slope, float(np.sqrt(rest / n / power))


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


def also_of(problem: Problem) -> list[dict[str, Any]]:
    """Of each row the other joints that turn its motor, by name."""
    return [
        {problem.labels[j]: ratio for j, ratio in others.items()}
        for others in problem.motors.others
    ]
