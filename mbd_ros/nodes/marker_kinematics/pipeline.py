"""From places of markers to messages with the joint states that fit them best."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.state import NANOSECOND, Array
from mbd_ros.errors import ModelError, SolveError
from mbd_ros.features.markers.marker_fit import Fit
from mbd_ros.features.markers.marker_kinematics import live_solver
from mbd_ros.methods.signals.differentiation import CausalDifferentiator, SampleStatus
from mbd_ros.scene.reader import load_scene
from msg_adapters.diagnostics import OK, WARN
from msg_adapters.joint_state_cdr import JointStateCdrWriter
from msg_adapters.markers import MarkerPlaceReader
from msg_adapters.multi_array import MultiArrayCdrWriter

RESIDUALS = ("rms", "max", "objective")  # in the layout of the message
_SEEK = 64  # frames that miss by too much, at most, between two searches from nothing
_UNUSED = (SampleStatus.OLD, SampleStatus.JUMP, SampleStatus.NOT_FINITE)


class MarkerPipeline:
    """Scene and solver of a configured node `marker_kinematics`.

    Args:
        description: URDF, where the scene takes it from a topic.

    Attributes:
        solver: Fits the joints.
        joints: Labels of the newest message; reads messages.
    """

    def __init__(self, values: Any, description: str | None) -> None:
        self.scene = scene = load_scene(values.scene, description)
        if scene.robot.bases:
            free = ", ".join(base.title for base in scene.robot.bases)
            raise ModelError(f"marker_kinematics gives joint states alone, and no poses of {free}")
        self.solver, self._targets = live_solver(scene, values.task, limits=values.limits)
        self.joints = MarkerPlaceReader(self.solver.labels)
        self._at = [joint.q for joint in scene.robot.joints]
        names = [joint.name for joint in scene.robot.joints]
        self._states = JointStateCdrWriter(names, ("position", "velocity"))
        self._residuals = MultiArrayCdrWriter(len(RESIDUALS), RESIDUALS)
        self._unmeasured = np.full(len(names), np.nan)
        self.tune(values)

    def tune(self, values: Any) -> None:
        """Other filters; they start again."""
        n = len(self._at)
        self._tolerance = values.residual_tolerance
        self._rates = CausalDifferentiator(
            cutoff=values.cutoff,
            velocity_limit=np.full(n, np.inf),
            wraps=np.zeros(n, dtype=np.bool_),
            rewind=values.rewind,
        )
        self.forget()

    def forget(self) -> None:
        """Forget the past: the next frame is sought from the default pose."""
        self._rates.reset()
        self._q: Array | None = None
        self._poor = 0
        self._newest: Fit | None = None
        self._apart = np.zeros(len(self.solver.labels))
        self._rms = 0.0

    def answer(self, stamp: int, places: Array) -> MarkerMessages | SampleStatus:
        """Messages for the places of markers, or why they cannot be used.

        Args:
            stamp: Time [ns].
            places: In the world [m], NaN where not seen, shape (n, 3).

        Raises:
            SolveError: No marker was seen, or nothing fits.
        """
        fit = self._fitted(stamp, places)
        position = fit.q[0][self._at]
        status = self._rates.update(stamp, position, self._unmeasured)
        if status in _UNUSED:
            return status
        self._q = fit.q
        self._newest = fit
        numbers = self._rms, float(self._apart.max(initial=0.0)), float(fit.objective[0])
        states = self._states.write(stamp, position=position, velocity=self._rates.velocity)
        return MarkerMessages(states, self._residuals.write(numbers))

    def _fitted(self, stamp: int, places: Array) -> Fit:
        times = np.array([stamp * NANOSECOND])
        seen = self.solver.seen(places[None], times, self._targets)
        if not (seen.weights > 0.0).any():
            raise SolveError("no marker of the scene was seen")
        if self._q is None:
            fit = self.solver.first(self.scene.initial.q, seen)
        else:
            fit = self.solver.solver.fit(self._q, seen)
        self._measure(fit, seen.weights[0] > 0.0)
        if self._rms > self._tolerance and self._q is not None:
            if self._seeks():
                again = self.solver.first(self.scene.initial.q, seen)
                fit = again if again.objective[0] < fit.objective[0] else fit
                self._measure(fit, seen.weights[0] > 0.0)
            self._poor += 1
        else:
            self._poor = 0
        if not fit.settled[0]:
            raise SolveError(f"the fit does not settle: last step {fit.remainder[0]:.3g} rad or m")
        return fit

    def _seeks(self) -> bool:
        """Whether to search from nothing: after 0, 1, 2, 4, .. poor frames, then regularly."""
        return self._poor & (self._poor - 1) == 0 or self._poor % _SEEK == 0

    def _measure(self, fit: Fit, shown: Array) -> None:
        self._apart = np.linalg.norm(fit.misses[0], axis=1) * shown
        self._rms = float(np.sqrt((self._apart**2).sum() / max(int(shown.sum()), 1)))

    def health(self) -> tuple[int, str]:
        """WARN where markers are far from where they should be."""
        if self._rms <= self._tolerance:
            return OK, "joint states published"
        return WARN, f"markers miss by {self._rms:.4g} m rms, most {self._worst()}"

    def held_joints(self) -> Sequence[str]:
        """Joints that nothing gives: none, all follow from a fit."""
        return ()

    def details(self) -> dict[str, str]:
        """Return figures of the newest frame, for diagnostics."""
        newest = self._newest
        return {
            "markers": str(len(self.solver.labels)),
            "markers not seen": ", ".join(self.joints.missing) or "none",
            "markers ignored": ", ".join(self.joints.extra) or "none",
            "frame of the markers": self.joints.frame or "none",
            "rms of the distances": f"{self._rms:.6g}",
            "largest distance": self._worst(),
            "steps of the last frame": str(int(newest.steps[0]) if newest else 0),
            "last step": f"{newest.remainder[0]:.3g}" if newest else "none yet",
        }

    def _worst(self) -> str:
        if not self._apart.any():
            return "none"
        i = int(np.argmax(self._apart))
        return f"{self.solver.labels[i]} by {self._apart[i]:.6g} m"


class MarkerMessages(NamedTuple):
    """Messages that answer markers.

    Attributes:
        states: All joints, serialized.
        residuals: Float64MultiArray of `RESIDUALS`, serialized.
    """

    states: bytes
    residuals: bytes
