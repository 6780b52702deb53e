"""The chain of a laboratory on a simulated swing, beside what the simulation knows."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np

from mbd_ros.applications.demo.summary import Check, Table, check_table
from mbd_ros.applications.demo.walking.task import (
    BODY_MASS,
    DURATION,
    JOINTS,
    MARKERS,
    NOISE,
    STEP,
    excitations,
    marked_leg,
    recorded,
)
from mbd_ros.core.state import Array, State
from mbd_ros.features.muscles.task import muscles_task
from mbd_ros.files.table import MAIN, Result

CUTOFF = 10.0  # Hz
RESERVE = 1.0  # N·m, optimal effort on every coordinate
END = 0.05  # s at both ends, half a period of the cut-off, from which no error counts
LINK = "tibia"
_AXES = "xyz"
_ANGLE = 0.005  # rad: noise of a marker over its distance from the next, 1 mm over 0.2 m
_MOMENT = 0.1  # of the range of a moment: noise of 1 mm behind 10 Hz leaves 2 to 8 %
_SHARE = 0.01  # of what a coordinate needs, by reserves
_LOAD = 0.15  # body weights: sharing alone, without noise, leaves 0.08
_EXACT = 1.0e-8  # of conditions that rounding alone keeps from being met
_SPREAD = 0.05  # three standard deviations of the rms of 2000 numbers


class WalkingNumbers:
    """Results of the chain; arrays have one row a frame.

    Attributes:
        scene: The leg with its markers.
        swing: The simulated motion, which is the truth.
        markers: What cameras see of it.
        motion: Of marker kinematics.
        moments: Of inverse dynamics.
        forces: Of static optimisation, with the loads of the knee.
        known: Moments of the true motion.
        shared: Static optimisation of the true motion.
    """

    def __init__(self) -> None:
        self.scene = scene = marked_leg()
        self.swing = scene.simulate(DURATION, dt=STEP, efforts=excitations(scene))
        self.markers = recorded(self.swing)
        self.motion = scene.kinematics(self.markers)
        self.moments = scene.inverse(self.motion, derivatives="zero-phase", cutoff=CUTOFF)
        self.known = scene.inverse(self.swing)
        self.forces = self._forces(self.motion, derivatives="zero-phase", cutoff=CUTOFF)
        self.shared = self._forces(self.swing)
        self.muscles = tuple(muscle.name for muscle in scene.muscles)

    @property
    def time(self) -> Array:
        """Times of the frames [s]."""
        return self.swing[MAIN]["time"]

    @cached_property
    def weight(self) -> float:
        """Of the person [N]."""
        return BODY_MASS * float(np.linalg.norm(self.scene.robot.model.gravity.linear))

    @cached_property
    def load(self) -> Array:
        """Of the knee with all muscles as simulated, in axes of the shank [N], shape (n, 3)."""
        task = muscles_task(self.scene, {"reactions": "child", "links": [LINK]}, "walking")
        loads, samples = task.loads(self.scene), self.swing[MAIN]
        assert loads is not None
        joints = self.scene.robot.joints
        q, v, a = (
            np.column_stack([samples[f"{joint.name}.{kind}"] for joint in joints])
            for kind in ("position", "velocity", "acceleration")
        )
        tension, none = columns(self.swing, self.muscles, "tension"), np.zeros(0)
        rows = zip(q, v, a, tension, strict=True)
        found = [loads.solve(State(0.0, *row[:2]), *row[2:], none)[0][0, :3] for row in rows]
        return np.array(found)

    def load_of(self, result: Result) -> Array:
        """Of the knee by static optimisation [N], shape (n, 3)."""
        return columns(result, [f"{LINK}.load"], *(f"force_{axis}" for axis in _AXES))

    @cached_property
    def angle_errors(self) -> Array:
        """Of marker kinematics behind the low-pass [rad], shape (n, 3)."""
        return columns(self.moments, JOINTS, "position") - columns(self.swing, JOINTS, "position")

    @cached_property
    def moment_errors(self) -> Array:
        """Of inverse dynamics [N·m], shape (n, 3)."""
        return columns(self.moments, JOINTS, "effort") - columns(self.known, JOINTS, "effort")

    @cached_property
    def moment_ranges(self) -> Array:
        """Of the true moments [N·m], shape (3,)."""
        return np.ptp(self.inner(columns(self.known, JOINTS, "effort")), axis=0)

    @cached_property
    def balance(self) -> Array:
        """What muscles by their arms, and reserves, leave of the moments [N·m], shape (n, 3)."""
        arms = self.scene.moment_arms(self.forces)[MAIN]
        tension, none = columns(self.forces, self.muscles, "force"), np.zeros(len(self.time))
        arm = np.array([[arms.get(f"{m}.{j}", none) for m in self.muscles] for j in JOINTS])
        exerted = np.einsum("jmn,nm->nj", arm, tension)
        return exerted + self.reserves - columns(self.forces, JOINTS, "effort")

    @property
    def reserves(self) -> Array:
        """Of the joints [N·m], shape (n, 3)."""
        return columns(self.forces, [f"{joint}_reserve" for joint in JOINTS], "force")

    def load_errors(self, result: Result) -> Array:
        """Lengths of the errors of the load of the knee [body weights], shape (n,)."""
        return np.linalg.norm(self.load_of(result) - self.load, axis=1) / self.weight

    def inner(self, values: Array) -> Array:
        """The rows of frames that count."""
        time = self.time
        return values[(time >= END - 1e-9) & (time <= time[-1] - END + 1e-9)]

    def checks(self) -> list[Check]:
        """What must hold."""
        seen, expected = float(rms(self.motion["residuals"]["rms"])), _expected_rms()
        angle, moment = rms(self.inner(self.angle_errors)), rms(self.inner(self.moment_errors))
        share = rms(self.reserves) / rms(columns(self.forces, JOINTS, "effort"))
        off = rms(self.inner(self.load_errors(self.forces)))
        frames, table = len(self.time), self.forces[MAIN]
        activation = columns(self.forces, self.muscles, "activation")
        return [
            Check("every number is finite", self._is_finite(), f"{frames} frames"),
            Check(
                "markers miss by their noise",
                abs(seen / expected - 1.0) <= _SPREAD,
                f"{1e3 * seen:.3f} mm rms, expected {1e3 * expected:.3f} mm",
            ),
            _at_most("errors of angles [rad rms]", angle, _ANGLE),
            _at_most("errors of moments, of their range", moment / self.moment_ranges, _MOMENT),
            Check(
                "muscles and reserves can do it in every frame",
                bool(table["muscles.is_feasible"].all()),
                f"{int(table['muscles.is_feasible'].sum())} of {frames}",
            ),
            Check(
                "activations are in 0 .. 1",
                bool((activation >= 0.0).all() and (activation <= 1.0).all()),
                f"{activation.min():.3g} .. {activation.max():.3g}",
            ),
            _at_most("conditions of the optimum", table["muscles.residual"], _EXACT),
            _at_most("arms x forces + reserves - moments [N·m]", self.balance, _EXACT),
            _at_most("reserves, of what their joint needs", share, _SHARE),
            _at_most("error of the knee load [body weights rms]", off, _LOAD),
        ]

    def _forces(self, motion: Result, **derivatives: Any) -> Result:
        options: dict[str, Any] = {
            "reserves": RESERVE,
            "reactions": "child",
            "links": [LINK],
            **derivatives,
        }
        return self.scene.muscle_forces(motion, **options)

    def _is_finite(self) -> bool:
        results = (self.swing, self.motion, self.moments, self.forces, self.shared)
        return all(np.isfinite(values).all() for r in results for values in r[MAIN].values())


def columns(result: Result, names: Sequence[str], *kinds: str) -> Array:
    """Columns `<name>.<kind>` side by side, one row a frame."""
    table = result[MAIN]
    return np.column_stack([table[f"{name}.{kind}"] for name in names for kind in kinds])


def rms(values: Array) -> Array:
    """Root mean square of every column."""
    return np.sqrt(np.mean(values**2, axis=0))


def _expected_rms() -> float:
    """Of distances of markers [m]: each joint takes one of their components with it."""
    count = len(MARKERS)
    return NOISE * float(np.sqrt((3 * count - len(JOINTS)) / count))


def _at_most(what: str, values: Array, bound: float) -> Check:
    largest = float(np.abs(values).max())
    return Check(f"{what} <= {bound:g}", largest <= bound, f"{largest:.3g}")


def tables(numbers: WalkingNumbers) -> list[Table]:
    """The whole summary."""
    found = [_joints(numbers), _knee(numbers), _muscles(numbers), _residuals(numbers)]
    return [*found, check_table(numbers.checks())]


def _joints(numbers: WalkingNumbers) -> Table:
    angle = 1e3 * rms(numbers.inner(numbers.angle_errors))
    moment, span = rms(numbers.inner(numbers.moment_errors)), numbers.moment_ranges
    rows = [
        (joint, f"{a:.2f}", f"{r:.3g}", f"{m:.3g} ({100 * m / r:.1f} %)")
        for joint, a, r, m in zip(JOINTS, angle, span, moment, strict=True)
    ]
    heads = ("joint", "angle, error [mrad]", "range of the moment [N·m]", "its error [N·m]")
    return Table(f"Joints: RMS errors, {END:g} s at both ends left out", heads, rows)


def _knee(numbers: WalkingNumbers) -> Table:
    peak = np.linalg.norm(numbers.load, axis=1).max() / numbers.weight
    rows = [("simulated", f"{peak:.2f}", "-", "-")]
    for text, result in (("from markers", numbers.forces), ("of the true motion", numbers.shared)):
        largest = np.linalg.norm(numbers.load_of(result), axis=1).max() / numbers.weight
        error = numbers.inner(numbers.load_errors(result))
        rows.append((text, f"{largest:.2f}", f"{rms(error):.3f}", f"{error.max():.3f}"))
    heads = ("", "peak", "error, RMS", "error, largest")
    return Table(f"Load of the knee in body weights of {numbers.weight:.0f} N", heads, rows)


def _muscles(numbers: WalkingNumbers) -> Table:
    swing, found, names = numbers.swing[MAIN], numbers.forces, numbers.muscles
    tension = columns(numbers.swing, names, "tension")
    error = rms(numbers.inner(columns(found, names, "force") - tension))
    rows = [
        (
            name,
            f"{swing[f'{name}.activation'].max():.3f}",
            f"{found[MAIN][f'{name}.activation'].max():.3f}",
            f"{tension[:, i].max():.0f}",
            f"{found[MAIN][f'{name}.force'].max():.0f}",
            f"{error[i]:.0f}",
        )
        for i, name in enumerate(names)
    ]
    heads = ("muscle", "activation", "found", "force [N]", "found", "error, RMS")
    return Table("Muscles: largest activations and forces, simulated and found", heads, rows)


def _residuals(numbers: WalkingNumbers) -> Table:
    seen, shares = numbers.motion["residuals"], numbers.forces[MAIN]
    rows = [
        ("markers, RMS", f"{1e3 * rms(seen['rms']):.3f} mm"),
        ("markers, largest", f"{1e3 * seen['max'].max():.2f} mm"),
        ("reserves, largest", f"{1e3 * np.abs(numbers.reserves).max():.3g} mN·m"),
        ("conditions of the optimum, largest", f"{shares['muscles.residual'].max():.2g}"),
    ]
    return Table("Residuals", ("", "value"), rows)
