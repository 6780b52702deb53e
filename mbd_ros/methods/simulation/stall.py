"""Detection of stalled simulations: the pace of their steps, and the likely cause."""

from collections.abc import Callable

import numpy as np

from mbd_ros.core.dynamics.system import System
from mbd_ros.core.state import Array, State
from mbd_ros.core.thresholds import TINY
from mbd_ros.errors import DivergedError, SolveError
from mbd_ros.methods.integration.linear_motion import linear_motion

Notice = Callable[[str], None]
WINDOW = 10_000  # steps between two checks
_SHORTENED = 0.05  # mean step relative to dt, below which the method has shortened it
_SHORT = 5.0e-5  # mean step relative to dt, below which it is far too short
_LONG = 3.0e6  # remaining steps that take minutes
_HOPELESS = 3.0e7  # remaining steps that take hours
PATIENCE = 3  # hopeless windows in a row before an error
_AT_THE_LIMIT = 0.3  # rate times step above which stiffness explains the short steps


class StallWatch:
    """Checks the pace of a simulation every `WINDOW` steps.

    A run is slow if the method has shortened its steps and millions of them remain; one notice
    reports it. A run is hopeless if it takes more than 20 000 steps for an interval of the output
    and tens of millions remain, in three checks in a row; this is an error. A stiff scene that can
    still reach its end continues, and so does one that is only temporarily slow.

    Args:
        dt: Interval of the output [s].
        notice: Function that is called for a slow run; None for no notice.
    """

    def __init__(self, system: System, dt: float, notice: Notice | None = None) -> None:
        self._system = system
        self._dt = dt
        self._notice = notice
        self._hopeless = 0
        self._t = 0.0

    def begin(self, t: float) -> None:
        """Begin to watch at a time [s]."""
        self._hopeless, self._t = 0, t

    def check(self, x: State, u: Array | None, end: float) -> None:
        """Judge the last `WINDOW` steps.

        Args:
            x: Current state of the integrated coordinates.
            u: Current inputs.
            end: End of the run [s].

        Raises:
            DivergedError: The run is hopeless; the message names joint, time and likely cause.
        """
        step, self._t = (x.t - self._t) / WINDOW, x.t
        left = (end - x.t) / max(step, TINY)
        if step > _SHORTENED * self._dt or left < _LONG:
            self._hopeless = 0
            return
        is_hopeless = step < _SHORT * self._dt and left > _HOPELESS
        self._hopeless = self._hopeless + 1 if is_hopeless else 0
        if self._hopeless < PATIENCE and self._notice is None:
            return
        text = _described(self._system, x, u, step, end)
        if self._hopeless >= PATIENCE:
            raise DivergedError(f"stalled: {text}")
        if self._notice is not None:
            self._notice(text)
            self._notice = None


def _described(system: System, x: State, u: Array | None, step: float, end: float) -> str:
    return (
        f"steps of {step:.2g} s at t = {x.t:.9g} s: {(end - x.t) / max(step, TINY):.2g} of them "
        f"to the end at {end:g} s; {_cause(system, x, u, step)}"
    )


def _cause(system: System, x: State, u: Array | None, step: float) -> str:
    """Name the joint that requires the short steps, with the likely cause and a remedy."""
    full = system.expand(x)
    system.k.refresh(full.q, full.v, system.loads.reads)
    if system.loads.beside(system.k, full) is not system.loads:
        return (
            f"{_hardest(system, full, u)}; a switching force chatters at its surface, which "
            "integrator filippov follows"
        )
    try:
        motion = linear_motion(system, x)
    except SolveError:
        return "no acceleration nearby"
    n = system.nv + system.internals.nz
    if motion.rate * step > _AT_THE_LIMIT and np.isfinite(motion.rate):
        first = np.block(
            [[np.zeros((n, n)), np.eye(n)], [motion.stiffness[:n, :n], motion.damping[:n, :n]]]
        )
        values, vectors = np.linalg.eig(first)
        mode = np.abs(vectors[:, int(np.abs(values).argmax())])
        return (
            f"{_mover(system, mode[:n] + mode[n:])} is stiff with a rate of {motion.rate:.3g} "
            "1/s; soften its force, raise the tolerance or try integrator gauss_legendre"
        )
    return (
        f"{_hardest(system, full, u)}; its force is not smooth, or the mechanism is near a "
        "singular configuration; raise the tolerance, or smooth the force"
    )


def _hardest(system: System, full: State, u: Array | None) -> str:
    a = np.abs(system.integrated(system.evaluate(full, u).a))
    return f"{_joint(system, a)} has the largest acceleration"


def _joint(system: System, share: Array) -> str:
    at = int(system.integrated(np.arange(float(system.model.nv)))[int(share.argmax())])
    names = {joint.v: f"joint {joint.name}" for joint in system.robot.joints}
    return (names | system.robot.base_titles)[at]


def _mover(system: System, share: Array) -> str:
    """Return the joint or internal state with the largest share."""
    beyond = int(share.argmax()) - system.nv
    return _joint(system, share[: system.nv]) if beyond < 0 else system.internals.names[beyond]


def check_pace(
    system: System, x: State, u: Array | None, step: float, dt: float, end: float
) -> None:
    """Check the pace within a tick that has taken `PATIENCE` windows of steps.

    Args:
        x: Current state of the integrated coordinates.
        u: Current inputs.
        step: Mean step in this tick [s].
        dt: Interval of the output [s].
        end: End of the tick [s].

    Raises:
        DivergedError: Steps are far too short; the message names joint, time and likely cause.
    """
    if step < _SHORT * dt:
        raise DivergedError(f"stalled: {_described(system, x, u, step, end)}")
