"""Drives: motors that are coupled to two joints, gains of currents, and velocity feedback.

Coupled motors: the friction of a motor that turns two joints changes its sign with a sum or a
difference of two speeds. Where that explains the residual torque of a joint better than its own
speed, all couplings of two neighbouring joints with two motors are fitted, both for efforts of
joints and for efforts of motors. Schwarz's information criterion selects the best one.

Gains: efforts i may be in other units than torques, such as motor currents,

    i_j = k_j (X_j b + known_j) + F_j f,    gain_j = 1 / k_j

Scaling the inertias b and all k together leaves i unchanged, unless something is known: a load, a
link, a spring, a measured wrench. The standard deviations of the gains tell which of them that
determines.

Velocity feedback: the controller of a drive also damps the noise of its velocity measurement,

    tau = model(q, v, a) - feedback (v_measured - v)

with v the velocity behind the zero-phase low-pass of the motion. That part of the measured torque
causes no motion, so no model of bodies predicts it.

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
    TriangularFactor,
    default_columns,
    estimate_noise,
    solve_scaled,
)
from mbd_ros.features.identification.problem import Block, Motors, Problem, regressor_of
from mbd_ros.features.identification.regression import (
    DelaySearch,
    estimate_delay,
    fit_default_friction,
    residual,
    residuals,
)
from mbd_ros.features.identification.regressor import Column, columns_of
from mbd_ros.features.identification.samples import Filter, Piece, grid_step
from mbd_ros.jobs.progress import Say
from mbd_ros.scene.built_scene import Scene

_SIGNS = (1.0, -1.0)
_SMOOTHINGS = (0.02, 0.05, 0.2)  # of the RMS speed
_LEAST_WORTH = 2.0  # prices of a parameter that coupled motors must gain at least
_LEAST_SHRINK = 0.98  # factor by which coupled motors must reduce the residual power at least
_MOST_ROWS = 20_000  # rows from which pairs of joints are chosen
_UNFIXED = 0.1  # relative deviation from which a gain counts as undetermined
_GAIN_STEPS = 200  # evaluations in the search for gains, at most
_GAIN_REACH = 5.0  # bound of log k relative to the description
_MOST_COMPARED = 20_000  # samples of a piece that are compared, evenly spaced
_ENOUGH_FOR_FEEDBACK = 10_000  # samples from which a feedback is estimated
_OUTLIER = 4.5  # times the median size: such samples, as at a start, are left out
_ROUNDING = 1.0e-9  # of the largest velocity: smaller differences are no noise
_FEWEST_SAMPLES = 20  # samples for an estimate of a feedback, at least


def choose_motors(
    problem: Problem, nominal: Motors | None, allowed: Sequence[str], search: DelaySearch, say: Say
) -> None:
    """Couple the rows of a problem to motors as the scene or the measured friction says.

    Args:
        problem: Problem whose rows are not coupled yet.
        nominal: Motors of the scene; None if it does not tell.
        allowed: Terms of friction that may be used.
        search: Range of the delay of efforts.
        say: Receives a line for each coupled motor.
    """
    if (problem.joints < 0).any() or len(problem.rows) < 2 or problem.scene.has_loops:
        return
    r, blocks = len(problem.base.chosen), problem.blocks
    arguments = problem.columns, r, allowed
    delay = estimate_delay(blocks, *arguments, search, problem.correlation)
    first = fit_default_friction(blocks, *arguments, delay)
    errors = residuals(blocks(np.array([delay])), first)
    noise = [estimate_noise(e, problem.correlation) for e in errors]
    rows = [n.share * len(e) for n, e in zip(noise, errors, strict=True)]
    motor_search = _MotorSearch(problem, allowed, delay, np.array(rows))
    if nominal is not None:
        options = [nominal._replace(are_measured=of_motors) for of_motors in (False, True)]
        best = min(options, key=motor_search.cost)
    else:
        best = motor_search.best(first)
    problem.set_motors(best)
    for line in _lines(problem, best):
        say(line)


class _MotorSearch:
    """Compares couplings of motors and joints.

    Args:
        allowed: Terms of friction that may be used.
        delay: Delay of efforts against motion [s].
        effective: Number of independent rows of each joint, shape (m,).
    """

    def __init__(
        self, problem: Problem, allowed: Sequence[str], delay: float, effective: Array
    ) -> None:
        self._problem = problem
        self._allowed = allowed
        self._delay = delay
        self._effective = effective
        self._price = float(np.log(effective.sum()))

    def best(self, first: Fit) -> Motors:
        """Return the best coupling; neighbouring joints are coupled pair by pair."""
        best = Motors.of_joints(len(self._problem.rows))
        cheapest = self.cost(best)
        less = _LEAST_WORTH * self._price - float(self._effective.mean()) * np.log(_LEAST_SHRINK)
        for i in self._suspects(first):
            if not best.alone[[i, i + 1]].all():
                continue
            options = list(_couplings_of(best, i))
            costs = [self.cost(motors) for motors in options]
            if min(costs) < cheapest - less:
                cheapest, best = min(costs), options[int(np.argmin(costs))]
        return best

    def cost(self, motors: Motors) -> float:
        """Return the information criterion of a coupling, for the efforts as measured."""
        problem = self._problem
        problem.set_motors(motors)
        r = len(problem.base.chosen)
        fit = fit_default_friction(problem.blocks, problem.columns, r, self._allowed, self._delay)
        size = 0.0 if motors.are_measured else np.log(abs(np.linalg.det(motors.ratios)))
        misfit = float(self._effective @ np.log(np.square(fit.deviation)))
        price = self._price * sum(map(len, fit.selection))
        return misfit + 2.0 * float(self._effective.mean()) * float(size) + price

    def _suspects(self, first: Fit) -> list[int]:
        """Return pairs i, i + 1 whose friction follows a sum of speeds, the clearest first."""
        m, gains = len(self._problem.rows), dict[int, float]()
        self._problem.set_motors(Motors.of_joints(m))
        torque, speeds, friction = _joint_friction(self._problem, first, self._delay)
        for j in range(m):
            uncoupled = _residual_power(torque[:, j], friction(speeds[:, j]))
            for k in (j - 1, j + 1):
                if not 0 <= k < m or not uncoupled > 0.0:
                    continue
                sides = [friction(speeds[:, j] + c * speeds[:, k]) for c in _SIGNS]
                alone = min(_residual_power(torque[:, j], side) for side in sides)
                both = _residual_power(torque[:, j], np.hstack(sides))
                more = self._price * sides[0].shape[1] / self._effective[j]
                least = max(min(alone, both * float(np.exp(more))), 1e-300)
                gain = self._effective[j] * float(np.log(uncoupled / least))
                if gain > self._price:
                    gains[min(j, k)] = max(gain, gains.get(min(j, k), 0.0))
        return sorted(gains, key=lambda pair: -gains[pair])


def _couplings_of(before: Motors, i: int) -> Iterator[Motors]:
    """Yield the couplings of two motors with joints i and i + 1."""
    for are_measured in {before.are_measured, True}:
        for first, second in ((0, 1), (0, -1), (1, 0), (-1, 0), (1, -1), (-1, 1)):
            ratios = before.ratios.copy()
            ratios[i, i + 1], ratios[i + 1, i] = first, second
            yield Motors(ratios, are_measured)


def _joint_friction(
    problem: Problem, first: Fit, delay: float
) -> tuple[Array, Array, Callable[[Array], Array]]:
    """Return the filtered friction torques of joints, their speeds, and friction columns.

    Returns:
        Torques without those of bodies, shape (n, m); speeds [rad/s or m/s]; and a function that
        returns the filtered friction columns of a speed.
    """
    piece = max(problem.pieces, key=lambda piece: len(piece.times))
    blocks, rows = list[Block](), 0
    for block in problem.maker.blocks(piece, problem.band, np.array([delay])):
        blocks, rows = [*blocks, block], rows + len(block.X)
        if rows >= _MOST_ROWS:
            break
    torque = np.concatenate([residual(block, first) for block in blocks])
    for i, (columns, values) in enumerate(zip(first.selection, first.friction, strict=True)):
        torque[:, i] += np.concatenate([block.F[i][:, columns] for block in blocks]) @ values
    rate = 1.0 / float(np.median(np.diff(piece.times)))
    step = 1 if problem.band is None else grid_step(rate, problem.band)
    v = piece.v[::step, problem.maker.coordinates]
    low = None if problem.band is None else Filter.of(rate / step, problem.band)

    def friction(speed: Array) -> Array:
        rms = float(np.sqrt(np.mean(np.square(speed))))
        dry = [Column("coulomb", s * rms + 1e-300) for s in _SMOOTHINGS]
        columns = [Column("viscous"), Column("offset"), *dry]
        values = columns_of(columns, speed, speed, speed)
        return (values if low is None else low.apply(values))[:_MOST_ROWS]

    return torque[:_MOST_ROWS], v, friction


def _residual_power(torque: Array, columns: Array) -> float:
    """Return the sum of squares of a torque after the least-squares fit of columns to it."""
    n = min(len(torque), len(columns))
    size = np.linalg.norm(columns[:n], axis=0) + 1e-300
    x = np.linalg.lstsq(columns[:n] / size, torque[:n], rcond=1e-9)[0]
    return float(np.sum(np.square(torque[:n] - columns[:n] / size @ x)))


def _lines(problem: Problem, motors: Motors) -> Iterator[str]:
    """Yield lines for people about coupled motors."""
    for name, others in zip(problem.labels, motors.others, strict=True):
        if others:
            sums = " ".join(
                f"{'+' if r > 0 else '-'} {abs(r):g} {problem.labels[j]}"
                for j, r in others.items()
            )
            yield f"the motor of {name} turns with {name} {sums}"
    if motors.are_measured:
        yield "efforts are those of the motors; the scene that is written has those of the joints"


def estimate_gains(problem: Problem, allowed: Sequence[str], say: Say) -> None:
    """Estimate the gains that are not given, and use efforts as torques from now on.

    Raises:
        DataError: Nothing determines the gains of some joints; the message names them.
    """
    if (problem.joints < 0).any():
        raise DataError(
            f"{problem.where}: --currents needs an effort of every joint; record them, or give "
            "gains (--gain JOINT=VALUE ..)"
        )
    open_ = np.array([name not in problem.gains for name in problem.labels])
    parts = _joint_equations(problem, allowed)
    start = np.array([_initial_k(part, problem) for part in parts])
    start[~open_] = 1.0  # their efforts are torques already
    share = 1.0 / (1.0 + 2.0 * float(np.sum(np.square(problem.correlation[1:]))))
    k, deviation = _solve_gains(parts, problem, start, open_, share)
    names = [n for n, s in zip(problem.labels, deviation, strict=True) if not s < _UNFIXED]
    if names:
        raise DataError(
            f"{problem.where}: nothing determines the gains of {', '.join(names)}, because masses "
            "and gains are known as ratios only; also record the motion with a known load (--held "
            "RECORDING --payload LINK=MASS,CX,CY,CZ), name links with a correct description "
            "(--known LINK ..), or give gains (--gain JOINT=VALUE ..)"
        )
    gains = dict(zip(problem.labels, 1.0 / k, strict=True))
    problem.set_gains({name: gains[name] for name in np.array(problem.labels)[open_]})
    problem.gain_deviation = np.abs(deviation / k)
    values = zip(problem.labels, 1.0 / k, problem.gain_deviation, strict=True)
    texts = (f"{name} {gain:.4g} +- {s:.2g}" for name, gain, s in values)
    say(f"torque for a unit of effort: {', '.join(texts)}")


def _joint_equations(problem: Problem, allowed: Sequence[str]) -> list[tuple[Array, ...]]:
    """Return X, F, known and i of each joint as triangular factors, over the residual size."""
    r, factors = len(problem.base.chosen), list[TriangularFactor]()
    for block in problem.blocks(np.zeros(1)):
        factors = factors or [
            TriangularFactor(r + len(columns) + 2) for columns in problem.columns
        ]
        for j, factor in enumerate(factors):
            known = block.known[:, j, None]
            rows = np.hstack([block.X[:, j], block.F[j], known, block.Y[:, j] + known])
            factor.add(rows[block.mask[:, j]])
    parts = []
    for factor, columns in zip(factors, problem.columns, strict=True):
        R = factor.close().R
        selected = default_columns(Joint(R, factor.rows, 1.0, columns, 1.0), allowed)
        F = R[:, [r + i for i in selected]]
        A = np.hstack([R[:, :r], F, R[:, -2:-1]])
        error = R[:, -1] - A @ solve_scaled(A, R[:, -1])[0]
        size = np.linalg.norm(error) / np.sqrt(max(factor.rows, 1))
        size = max(size, 1e-9 * np.linalg.norm(R[:, -1]) / np.sqrt(max(factor.rows, 1)), 1e-300)
        parts.append((R[:, :r] / size, F / size, R[:, -2] / size, R[:, -1] / size))
    return parts


def _initial_k(part: tuple[Array, ...], problem: Problem) -> float:
    """Return the ratio of the effort to the torque of the given robot."""
    X, F, known, i = part
    model = X @ problem.base.values(problem.nominal.ravel()) + known
    x = solve_scaled(np.column_stack([model, F]), i)[0]
    return float(x[0]) or 1.0


def _solve_gains(
    parts: Sequence[tuple[Array, ...]],
    problem: Problem,
    start: Array,
    is_open: Array,
    share: float,
) -> tuple[Array, Array]:
    """Solve for k by nonlinear least squares.

    Args:
        start: Initial k, shape (m,).
        is_open: Which k are unknown, shape (m,).
        share: Number of independent rows per row.

    Returns:
        k, and the relative standard deviation of each unknown one, shape (m,) each.
    """
    from scipy.optimize import least_squares

    r, m = len(problem.base.chosen), len(parts)
    first = r + m + np.cumsum([0, *(F.shape[1] for _, F, _, _ in parts)])

    def error(x: Array) -> Array:
        k = start * np.exp(x[r : r + m])
        joints = zip(parts, k, first, strict=False)
        return np.concatenate(
            [
                kj * (X @ x[:r] + n) + F @ x[a : a + F.shape[1]] - i
                for (X, F, n, i), kj, a in joints
            ]
        )

    def jacobian(x: Array) -> Array:
        k, rows = start * np.exp(x[r : r + m]), []
        for j, ((X, F, n, _), kj, a) in enumerate(zip(parts, k, first, strict=False)):
            row = np.zeros((len(X), len(x)))
            row[:, :r], row[:, a : a + F.shape[1]] = kj * X, F
            row[:, r + j] = is_open[j] * kj * (X @ x[:r] + n)
            rows.append(row)
        return np.concatenate(rows)

    x0 = np.concatenate([problem.base.values(problem.nominal.ravel()), np.zeros(first[-1] - r)])
    size = 1.0 / np.maximum(np.linalg.norm(jacobian(x0), axis=0), 1e-12)
    reach = np.full(len(x0), np.inf)
    reach[r : r + m] = _GAIN_REACH
    solution = least_squares(
        error, x0, jacobian, bounds=(-reach, reach), x_scale=size, max_nfev=_GAIN_STEPS
    )
    places = r + np.flatnonzero(is_open)
    deviation = np.zeros(m)
    deviation[is_open] = _deviations(jacobian(solution.x), places) / np.sqrt(share)
    return start * np.exp(solution.x[r : r + m]), deviation


def _deviations(J: Array, places: Array) -> Array:
    """Return standard deviations of some unknowns, inf where nothing determines them."""
    norm = np.linalg.norm(J, axis=0)
    visible = np.flatnonzero(norm > 0.0)
    _, s, V = np.linalg.svd(J[:, visible] / norm[visible], full_matrices=False)
    s = np.maximum(s, 1e-9 * s.max(initial=1.0))
    deviations = np.full(J.shape[1], np.inf)
    deviations[visible] = np.sqrt(np.sum(np.square(V.T / s), axis=1)) / norm[visible]
    return np.asarray(deviations[places])


def compare_with_measured(
    problem: Problem, scenes: Sequence[Scene], pieces: Sequence[Piece], delay: float
) -> Measured | None:
    """Return measured efforts of pieces beside the predictions of scenes; None without pieces.

    Long pieces are thinned out evenly.
    """
    parts = [_compare_piece(problem, scenes, piece, delay, _MOST_COMPARED) for piece in pieces]
    return _concatenate(parts) if parts else None


class Measured(NamedTuple):
    """Measured efforts of the rows of a problem, and their predictions.

    Attributes:
        times: Times [s], shape (n,).
        effort: Measured efforts [N·m or N], shape (n, m).
        predictions: Predicted efforts of each scene [N·m or N], shape (n, m) each.
        noise: Measured velocity less that of the motion [rad/s or m/s], shape (n, m).
    """

    times: Array
    effort: Array
    predictions: list[Array]
    noise: Array


def _compare_piece(
    problem: Problem, scenes: Sequence[Scene], piece: Piece, delay: float, most: int
) -> Measured:
    grid = np.arange(0, len(piece.times), max(len(piece.times) // most, 1))
    times, joints = piece.times[grid], problem.joints
    motion = piece.y[grid], piece.v[grid], piece.a[grid]
    loads = [load[grid] for load in piece.loads]
    predictions = [
        predicted_efforts(scene, problem, motion, loads, piece.payload) for scene in scenes
    ]
    noise = np.zeros((len(grid), len(problem.rows)))
    v = motion[1][:, problem.maker.coordinates]
    noise[:, joints >= 0] = (piece.rate[grid][:, joints] - v)[:, joints >= 0]
    is_rounding = np.abs(noise) < _ROUNDING * np.abs(v).max(axis=0)
    noise[~np.isfinite(noise) | is_rounding] = 0.0
    effort = efforts_of_rows(problem, piece, piece.measured, grid, 0.0)
    delayed = [_delayed(times, values, delay) for values in predictions]
    return Measured(times, effort, delayed, _delayed(times, noise, delay))


def predicted_efforts(
    scene: Scene,
    problem: Problem,
    motion: tuple[Array, Array, Array],
    loads: list[Array],
    payload: Array | None,
) -> Array:
    """Return the efforts of the rows that a scene predicts, shape (n, m).

    Args:
        motion: Independent coordinates, velocities and accelerations.
        loads: Measured wrenches, shape (n, 6) each.
        payload: Inertial parameters of a known load, shape (10 bodies,); None without.
    """
    regressor = regressor_of(scene, problem.training)
    W = regressor.rows(*motion)
    inertial = parameters_of(scene.robot.model).ravel()
    total = inertial if payload is None else inertial + payload
    torque: Array = (W @ total + regressor.known(W, *motion, loads))[:, problem.rows]
    return problem.motors.measured(torque)


def efforts_of_rows(
    problem: Problem, piece: Piece, values: Array, grid: NDArray[np.intp], delay: float
) -> Array:
    """Return efforts of the rows at times of the motion, 0 for rows without, shape (n, m)."""
    columns = np.zeros((len(grid), len(problem.rows)))
    for k, joint in enumerate(problem.joints):
        if joint >= 0 and delay:
            columns[:, k] = np.interp(piece.times[grid] + delay, piece.times, values[:, joint])
        elif joint >= 0:
            columns[:, k] = values[grid, joint]
    return columns


def _delayed(times: Array, values: Array, delay: float) -> Array:
    """Delay predictions, so that measured efforts keep their noise without interpolation."""
    if not delay:
        return values
    return np.transpose([np.interp(times - delay, times, column) for column in values.T])


def _concatenate(parts: Sequence[Measured]) -> Measured:
    """Concatenate the samples of several pieces."""
    count = len(parts[0].predictions)
    return Measured(
        np.concatenate([part.times for part in parts]),
        np.concatenate([part.effort for part in parts]),
        [np.concatenate([part.predictions[k] for part in parts]) for k in range(count)],
        np.concatenate([part.noise for part in parts]),
    )


def estimate_feedback(
    problem: Problem, scene: Scene, pieces: Sequence[Piece], delay: float
) -> tuple[Array, Array]:
    """Return the velocity feedback of each row, >= 0, and its standard deviation, shape (m,).

    A feedback counts where it is worth a parameter by Schwarz's information criterion.

    Args:
        scene: The identified scene.
        pieces: Pieces of the training parts.
        delay: Delay of efforts against motion [s].
    """
    parts = [_compare_piece(problem, [scene], p, delay, _ENOUGH_FOR_FEEDBACK) for p in pieces]
    samples = _concatenate(parts)
    error = samples.effort - samples.predictions[0]
    slopes = [_feedback_slope(noise, e) for noise, e in zip(samples.noise.T, error.T, strict=True)]
    return np.array([s for s, _ in slopes]), np.array([d for _, d in slopes])


def _feedback_slope(noise: Array, error: Array) -> tuple[float, float]:
    """Return the slope of -error over noise and its standard deviation; zeros for no feedback."""
    centred = error - np.median(error)
    is_regular = np.abs(centred) <= _OUTLIER * np.median(np.abs(centred))
    x, y, n = noise[is_regular], centred[is_regular], int(is_regular.sum())
    power = float(x @ x)
    if n < _FEWEST_SAMPLES or power == 0.0:
        return 0.0, 0.0
    slope = float(-(x @ y)) / power
    remainder = float(np.sum(np.square(y + slope * x)))
    is_worth = n * np.log(max(float(y @ y), 1e-300) / max(remainder, 1e-300)) > np.log(n)
    if slope <= 0.0 or not is_worth:
        return 0.0, 0.0
    return slope, float(np.sqrt(remainder / n / power))


def scene_motors(scene: Scene, labels: Sequence[str]) -> Motors | None:
    """Return the motors of the `gear_friction` of a scene; None if each turns with one joint.

    Raises:
        DataError: The motors do not determine the torques of the joints.
    """
    motors, ratios = Motors.of_joints(len(labels)), np.eye(len(labels))
    for entry in scene.entries.get("forces") or []:
        also: Mapping[str, float] = entry.get("also") or {}
        for name, ratio in also.items():
            if entry.get("joint") in labels and name in labels:
                ratios[labels.index(entry["joint"]), labels.index(name)] = ratio
    if abs(np.linalg.det(ratios)) < 1e-6:
        raise DataError(f"{scene.name}: forces: `also` couples motors so that they turn as one")
    motors = motors._replace(ratios=ratios)
    return motors if motors.are_coupled else None


def coupled_joints(problem: Problem) -> list[dict[str, Any]]:
    """Return the other joints that turn the motor of each row: name -> ratio."""
    return [
        {problem.labels[j]: ratio for j, ratio in others.items()}
        for others in problem.motors.others
    ]
