"""The matrix Riccati equations of linear quadratic regulators: along a motion, and at rest."""

import math

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.errors import SolveError

_STEP = 0.1  # length of a step times the size of the Hamiltonian matrix: errors of 1e-7
_RESIDUAL = 1.0e-6  # share of the Hamiltonian matrix that the steady equation may leave
_MOST_STEPS = 100_000


def riccati_backwards(times: Array, A: Array, B: Array, Q: Array, R: Array, S_end: Array) -> Array:
    """Cost to go of a linear motion, from its end to its begin.

        -S' = A' S + S A - S B R^-1 B' S + Q,   S(end) = S_end

    of x' = A x + B u, straight lines between samples, with the cost x'Q x + u'R u. S = Y X^-1
    where X and Y follow the linear Hamiltonian system, so that large S need no short steps.
    Source: H. Kwakernaak, R. Sivan, Linear Optimal Control Systems, 1972, sec. 3.3.

    Args:
        times: [s], increasing, shape (n,).
        A: Shape (n, m, m).
        B: Shape (n, m, k).
        Q: Cost of states, symmetric, shape (m, m).
        R: Cost of inputs, symmetric, positive definite, shape (k, k).
        S_end: Cost of the last state, shape (m, m).

    Returns:
        S, symmetric, shape (n, m, m).

    Raises:
        SolveError: It takes too many steps.
    """
    scale = _balance(B, Q, R)
    H = np.stack([_hamiltonian(a, b, Q, R, scale) for a, b in zip(A, B, strict=True)])
    S = np.empty_like(A)
    S[-1] = 0.5 * (S_end + S_end.T)
    m = A.shape[1]
    for i in range(len(times) - 1, 0, -1):
        begin = np.concatenate([np.eye(m), S[i] / scale])
        Z = _carried(begin, H[i], H[i - 1], float(times[i] - times[i - 1]))
        found = scale * np.linalg.solve(Z[:m].T, Z[m:].T)
        S[i - 1] = 0.5 * (found + found.T)
    return S


def riccati_steady(A: Array, B: Array, Q: Array, R: Array) -> Array | None:
    """The S of A' S + S A - S B R^-1 B' S + Q = 0 that makes the loop stable.

    From the stable subspace of the Hamiltonian matrix. Source: J. E. Potter, SIAM J. Appl. Math.
    14, 1966, 496-501.

    Args:
        A: Shape (m, m).
        B: Shape (m, k).
        Q: Cost of states, symmetric, shape (m, m).
        R: Cost of inputs, symmetric, positive definite, shape (k, k).

    Returns:
        Shape (m, m); None where the inputs cannot make the motion stable.
    """
    m, scale = len(A), _balance(B[None], Q, R)
    H = _hamiltonian(A, B, Q, R, scale)
    values, vectors = np.linalg.eig(H)
    stable = vectors[:, np.argsort(values.real)[:m]]
    try:
        S = np.real(np.linalg.solve(stable[:m].T, stable[m:].T))
    except np.linalg.LinAlgError:
        return None
    S = 0.5 * scale * (S + S.T)
    gain = np.linalg.solve(R, B.T.dot(S))
    left = A.T.dot(S) + S.dot(A) - gain.T.dot(R).dot(gain) + Q
    is_closed = np.abs(left).max() <= _RESIDUAL * (np.abs(A.T.dot(S)).max() + np.abs(Q).max())
    is_stable = bool((np.linalg.eigvals(A - B.dot(gain)).real < 0.0).all())
    return S if is_closed and is_stable and np.linalg.eigvalsh(S)[0] >= 0.0 else None


def _carried(Z: Array, H_late: Array, H_early: Array, length: float) -> Array:
    """Z' = H Z by the classical Runge-Kutta method, backwards through an interval.

    Raises:
        SolveError: It takes too many steps.
    """
    size = max(np.abs(H_late).sum(axis=1).max(), np.abs(H_early).sum(axis=1).max())
    count = max(1, math.ceil(length * size / _STEP))
    if count > _MOST_STEPS:
        raise SolveError(f"the Riccati equation changes too fast: {count} steps in {length:g} s")
    h, slope = -length / count, (H_early - H_late) / count
    m = Z.shape[1]
    for j in range(count):
        begin = H_late + j * slope
        middle, end = begin + 0.5 * slope, begin + slope
        k1 = begin.dot(Z)
        k2 = middle.dot(Z + 0.5 * h * k1)
        k3 = middle.dot(Z + 0.5 * h * k2)
        k4 = end.dot(Z + h * k3)
        Z = Z + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)
        Z = Z / np.abs(Z[:m]).max()  # S = Y X^-1 does not depend on the length of Z
    return Z


def _balance(B: Array, Q: Array, R: Array) -> float:
    """Unit of costates in which both parts of the Hamiltonian matrix are of one size."""
    pushes = np.abs(B @ np.linalg.solve(R, np.swapaxes(B, 1, 2))).max()
    return math.sqrt(float(np.abs(Q).max() / pushes)) if pushes > 0.0 else 1.0


def _hamiltonian(A: Array, B: Array, Q: Array, R: Array, scale: float) -> Array:
    pushes = B.dot(np.linalg.solve(R, B.T))
    return np.block([[A, -scale * pushes], [-Q / scale, -A.T]])
