"""From muscles to markers and back, as a page: `mbd-ros demo walking`.

Muscles swing a leg, a laboratory sees its markers, and the chain of a laboratory finds what the
simulation knows. No topic, no ROS.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.api import Scene, load_scene
from mbd_ros.applications.demo import panels
from mbd_ros.applications.demo.files import KNOWN, TABLES, replacing_folder
from mbd_ros.applications.demo.page import (
    Check,
    Content,
    check_table,
    conclusion,
    machine,
    moving_result,
    write_page,
)
from mbd_ros.applications.demo.page import Table as SummaryTable
from mbd_ros.applications.demo.panels import BLACK, BLUE, ORANGE, Draw, line, name, picture
from mbd_ros.applications.demo.task import WALKING
from mbd_ros.core.state import Array, State
from mbd_ros.features.muscles.task import muscles_task
from mbd_ros.files.table import MAIN, Column, Result, Table
from mbd_ros.scene.variants import with_sections

SCENE = "muscle_leg"
DURATION, STEP = 0.42, 0.005  # s: of a swing in walking; of the cameras
NOISE = 0.001  # m, standard deviation of each component of a marker
SEED = 20
BODY_MASS = 75.16  # kg, of the person whose leg this is: gait2354, docs/models.md
JOINTS = ("hip", "knee", "ankle")
_LEAST = 0.01  # excitation
_START = {  # rad, rad/s: as the toes leave the ground, chosen here
    "position": {"hip": -0.2, "knee": -0.75, "ankle": -0.35},
    "velocity": {"hip": 3.0, "knee": -5.0, "ankle": 1.0},
}


class Burst(NamedTuple):
    """A muscle that is excited for a time, chosen here so that the leg swings as in walking."""

    muscle: str
    begin: float
    end: float
    excitation: float


BURSTS = (
    Burst("iliopsoas", 0.0, 0.15, 0.40),  # pulls the thigh forward
    Burst("rectus_femoris", 0.0, 0.12, 0.06),  # keeps the heel from rising too far
    Burst("tibialis_anterior", 0.0, 0.30, 0.12),  # lifts the toes
    Burst("hamstrings", 0.27, 0.42, 0.20),  # brake the shank
    Burst("gluteus_maximus", 0.35, 0.42, 0.04),  # brakes the thigh
)
MARKERS = {  # places on the surface of the links, chosen here
    "thigh_front": ("femur", [0.07, 0.0, -0.15]),
    "thigh_side": ("femur", [0.0, -0.08, -0.25]),
    "knee_side": ("femur", [0.0, -0.06, -0.39]),
    "shank_front": ("tibia", [0.05, 0.0, -0.12]),
    "shank_side": ("tibia", [0.0, -0.05, -0.25]),
    "ankle_side": ("tibia", [0.0, -0.05, -0.41]),
    "heel": ("calcaneus", [-0.02, 0.0, 0.03]),
    "midfoot": ("calcaneus", [0.12, 0.0, 0.07]),
    "toe": ("toes", [0.04, 0.0, 0.02]),
}
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
_FOUND, _TRUE = "from markers", "simulated"
_SLOWER = 8.0  # than life: 0.4 s are too short to be seen
_PACKAGES = ("numpy", "pin", "scipy")


def walking(out: Path) -> Iterator[str]:
    """Simulate the swing, analyse its markers, write page, picture and tables.

    Args:
        out: Folder, see `replacing_folder`.

    Yields:
        What happens, then the summary.

    Raises:
        DataError: A place that is not accepted.
        Failed: A check is not met; the page is kept.
    """
    with replacing_folder(out, KNOWN) as folder:
        yield f"{WALKING} ..."
        numbers = WalkingNumbers()
        summary = tables(numbers)
        failed = [f"{c.what}: {c.value}" for c in numbers.checks() if not c.is_met]
        for name in TABLES:
            getattr(numbers, name).to(folder / f"{name}.csv")
        content = _content(numbers, summary, failed)
        write_page(folder, overview(numbers), content)
    yield from conclusion(content, "tables", out)


def marked_leg() -> Scene:
    """The leg with markers, as the toes leave the ground."""
    sensors = {
        name: {"type": "marker", "frame": frame, "xyz": xyz, "noise": NOISE}
        for name, (frame, xyz) in MARKERS.items()
    }
    return with_sections(load_scene(SCENE), sensors=sensors, initial=_START)


def excitations(scene: Scene) -> Result:
    """Excitations of all muscles, each held until the next row."""
    time = np.arange(round(DURATION / STEP) + 1) * STEP
    columns = [Column("time", time, "s")]
    bursts = {burst.muscle: burst for burst in BURSTS}
    for muscle in scene.muscles:
        values = np.full(len(time), _LEAST)
        if burst := bursts.get(muscle.name):
            inside = (time >= burst.begin - 1e-9) & (time < burst.end - 1e-9)
            values[inside] = burst.excitation
        columns.append(Column(f"{muscle.name}.excitation", values))
    return Result({MAIN: Table(columns)})


def columns(result: Result, names: Sequence[str], *kinds: str) -> Array:
    """Columns `<name>.<kind>` side by side, one row a frame."""
    table = result[MAIN]
    return np.column_stack([table[f"{name}.{kind}"] for name in names for kind in kinds])


def recorded(swing: Result) -> Result:
    """Markers of a simulated swing with the noise of cameras: what a laboratory has."""
    samples, random = swing[MAIN], np.random.default_rng(SEED)
    columns = [samples.column("time")]
    for marker in MARKERS:
        for axis in "xyz":
            seen = samples[f"{marker}.position_{axis}"]
            noisy = seen + random.normal(0.0, NOISE, len(seen))
            columns.append(Column(f"{marker}.{axis}", noisy, "m"))
    return Result({MAIN: Table(columns)})


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
        """Weight of the person [N]."""
        return BODY_MASS * float(np.linalg.norm(self.scene.robot.model.gravity.linear))

    @cached_property
    def load(self) -> Array:
        """Simulated load of the knee with all muscles, in axes of the shank [N], shape (n, 3)."""
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
        """Return the load of the knee by static optimisation [N], shape (n, 3)."""
        return columns(result, [f"{LINK}.load"], *(f"force_{axis}" for axis in _AXES))

    @cached_property
    def angle_errors(self) -> Array:
        """Errors of marker kinematics after the low-pass filter [rad], shape (n, 3)."""
        return columns(self.moments, JOINTS, "position") - columns(self.swing, JOINTS, "position")

    @cached_property
    def moment_errors(self) -> Array:
        """Errors of inverse dynamics [N·m], shape (n, 3)."""
        return columns(self.moments, JOINTS, "effort") - columns(self.known, JOINTS, "effort")

    @cached_property
    def moment_ranges(self) -> Array:
        """Ranges of the true moments [N·m], shape (3,)."""
        return np.ptp(self.inner(columns(self.known, JOINTS, "effort")), axis=0)

    @cached_property
    def balance(self) -> Array:
        """Moments that muscles and reserves do not explain [N·m], shape (n, 3)."""
        arms = self.scene.moment_arms(self.forces)[MAIN]
        tension, none = columns(self.forces, self.muscles, "force"), np.zeros(len(self.time))
        arm = np.array([[arms.get(f"{m}.{j}", none) for m in self.muscles] for j in JOINTS])
        exerted = np.einsum("jmn,nm->nj", arm, tension)
        return exerted + self.reserves - columns(self.forces, JOINTS, "effort")

    @property
    def reserves(self) -> Array:
        """Reserves of the joints [N·m], shape (n, 3)."""
        return columns(self.forces, [f"{joint}_reserve" for joint in JOINTS], "force")

    def load_errors(self, result: Result) -> Array:
        """Lengths of the errors of the load of the knee [body weights], shape (n,)."""
        return np.linalg.norm(self.load_of(result) - self.load, axis=1) / self.weight

    def inner(self, values: Array) -> Array:
        """The rows of frames that count."""
        time = self.time
        return values[(time >= END - 1e-9) & (time <= time[-1] - END + 1e-9)]

    def checks(self) -> list[Check]:
        """Return the checks of the demonstration."""
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


def rms(values: Array) -> Array:
    """Root mean square of every column."""
    return np.sqrt(np.mean(values**2, axis=0))


def _expected_rms() -> float:
    """Return the expected root mean square distance of markers [m].

    Each joint takes up one of their components.
    """
    count = len(MARKERS)
    return NOISE * float(np.sqrt((3 * count - len(JOINTS)) / count))


def _at_most(what: str, values: Array, bound: float) -> Check:
    largest = float(np.abs(values).max())
    return Check(f"{what} <= {bound:g}", largest <= bound, f"{largest:.3g}")


def tables(numbers: WalkingNumbers) -> list[SummaryTable]:
    """The whole summary."""
    found = [_joints(numbers), _knee(numbers), _muscles(numbers), _residuals(numbers)]
    return [*found, check_table(numbers.checks())]


def _joints(numbers: WalkingNumbers) -> SummaryTable:
    angle = 1e3 * rms(numbers.inner(numbers.angle_errors))
    moment, span = rms(numbers.inner(numbers.moment_errors)), numbers.moment_ranges
    rows = [
        (joint, f"{a:.2f}", f"{r:.3g}", f"{m:.3g} ({100 * m / r:.1f} %)")
        for joint, a, r, m in zip(JOINTS, angle, span, moment, strict=True)
    ]
    heads = ("joint", "angle, error [mrad]", "range of the moment [N·m]", "its error [N·m]")
    return SummaryTable(f"Joints: RMS errors, {END:g} s at both ends left out", heads, rows)


def _knee(numbers: WalkingNumbers) -> SummaryTable:
    peak = np.linalg.norm(numbers.load, axis=1).max() / numbers.weight
    rows = [("simulated", f"{peak:.2f}", "-", "-")]
    for text, result in (("from markers", numbers.forces), ("of the true motion", numbers.shared)):
        largest = np.linalg.norm(numbers.load_of(result), axis=1).max() / numbers.weight
        error = numbers.inner(numbers.load_errors(result))
        rows.append((text, f"{largest:.2f}", f"{rms(error):.3f}", f"{error.max():.3f}"))
    heads = ("", "peak", "error, RMS", "error, largest")
    return SummaryTable(f"Load of the knee in body weights of {numbers.weight:.0f} N", heads, rows)


def _muscles(numbers: WalkingNumbers) -> SummaryTable:
    swing, computed, names = numbers.swing[MAIN], numbers.forces, numbers.muscles
    tension = columns(numbers.swing, names, "tension")
    error = rms(numbers.inner(columns(computed, names, "force") - tension))
    rows = [
        (
            name,
            f"{swing[f'{name}.activation'].max():.3f}",
            f"{computed[MAIN][f'{name}.activation'].max():.3f}",
            f"{tension[:, i].max():.0f}",
            f"{computed[MAIN][f'{name}.force'].max():.0f}",
            f"{error[i]:.0f}",
        )
        for i, name in enumerate(names)
    ]
    heads = ("muscle", "activation", "found", "force [N]", "found", "error, RMS")
    return SummaryTable(
        "Muscles: largest activations and forces, simulated and found", heads, rows
    )


def _residuals(numbers: WalkingNumbers) -> SummaryTable:
    seen, shares = numbers.motion["residuals"], numbers.forces[MAIN]
    rows = [
        ("markers, RMS", f"{1e3 * rms(seen['rms']):.3f} mm"),
        ("markers, largest", f"{1e3 * seen['max'].max():.2f} mm"),
        ("reserves, largest", f"{1e3 * np.abs(numbers.reserves).max():.3g} mN·m"),
        ("conditions of the optimum, largest", f"{shares['muscles.residual'].max():.2g}"),
    ]
    return SummaryTable("Residuals", ("", "value"), rows)


def _content(numbers: WalkingNumbers, summary: list[SummaryTable], failed: list[str]) -> Content:
    text = [
        "Bursts of excitation move a leg of nine muscles with elastic tendons, from the moment at "
        "which the toes leave the ground. The pelvis rests and nothing touches the foot: this is "
        "the swing alone, not stance, in which the knee carries several body weights.",
        f"Cameras see {len(MARKERS)} markers at {1 / STEP:g} Hz with noise of {1e3 * NOISE:g} mm. "
        "From them come the angles (marker kinematics), the moments (inverse dynamics behind a "
        f"low-pass of {CUTOFF:g} Hz), muscle forces (least sum of squared activations) and the "
        "load of the knee, each beside what the simulation knows.",
        "The optimum knows neither which muscles were excited, nor passive forces, nor that "
        "tendons give way: forces of muscles differ from the simulated ones also where the "
        "motion is exact (without noise).",
    ]
    made = {
        "Excitations": ", ".join(
            f"{b.muscle} {b.excitation:g} ({b.begin:g} to {b.end:g} s)" for b in BURSTS
        ),
        "Static optimisation": f"squares of activations, reserves of {RESERVE:g} N·m",
        "Load of the knee": "force on the shank, in its axes, with all muscles",
        **machine(_PACKAGES),
    }
    moving = moving_result(numbers.scene, numbers.swing, WALKING, _SLOWER)
    moves = (
        moving,
        f"The simulated swing, {_SLOWER:g} times slower; muscles are red at the largest tension.",
    )
    facts = f"{DURATION:g} s of simulated time, {len(numbers.time)} frames."
    return Content(
        f"Demo: {WALKING}", facts, failed, text, moves, pictures(numbers), summary, made
    )


def pictures(numbers: WalkingNumbers) -> dict[str, bytes]:
    """PNG by title."""
    muscles = len(numbers.muscles)
    kinds = {
        "Joint angles": (_draw_angles, len(JOINTS)),
        "Moments of joints": (_draw_moments, len(JOINTS)),
        "Load of the knee": (_draw_load, 3),
        "Residuals": (_draw_residuals, 3),
        "Activations": (_draw_activations, muscles),
        "Muscle forces": (_draw_forces, muscles),
    }
    return {title: picture(partial(draw, numbers), n) for title, (draw, n) in kinds.items()}


def _draw_angles(numbers: WalkingNumbers, panel: Any, i: int) -> None:
    found, true = (r[MAIN][f"{JOINTS[i]}.position"] for r in (numbers.motion, numbers.swing))
    _draw_pair(numbers, panel, np.degrees(found), np.degrees(true))
    name(panel, f"{JOINTS[i]} [deg]")


def _draw_pair(numbers: WalkingNumbers, panel: Any, computed: Any, true: Any) -> None:
    line(panel, numbers.time, computed, BLUE, _FOUND)
    line(panel, numbers.time, true, BLACK, _TRUE, "--")


def _draw_moments(numbers: WalkingNumbers, panel: Any, i: int) -> None:
    found, true = (r[MAIN][f"{JOINTS[i]}.effort"] for r in (numbers.moments, numbers.known))
    _draw_pair(numbers, panel, found, true)
    name(panel, f"{JOINTS[i]} [N·m]")


def _draw_load(numbers: WalkingNumbers, panel: Any, i: int) -> None:
    if i < 2:
        axis, sign, text = ((2, -1.0, "along the shank, pressing"), (0, 1.0, "forwards"))[i]
        found, shared = (numbers.load_of(r) for r in (numbers.forces, numbers.shared))
        to = sign / numbers.weight
        _draw_pair(numbers, panel, to * found[:, axis], to * numbers.load[:, axis])
        line(panel, numbers.time, to * shared[:, axis], ORANGE, "without noise")
    else:
        line(panel, numbers.time, numbers.load_errors(numbers.forces), BLUE, _FOUND)
        line(panel, numbers.time, numbers.load_errors(numbers.shared), ORANGE, "without noise")
        text = "error"
    name(panel, f"{text} [body weights]")


def _draw_residuals(numbers: WalkingNumbers, panel: Any, i: int) -> None:
    seen = numbers.motion["residuals"]
    if i == 0:
        line(panel, numbers.time, 1e3 * seen["rms"], BLUE, "rms")
        line(panel, numbers.time, 1e3 * seen["max"], ORANGE, "largest")
        name(panel, "markers [mm]")
    elif i == 1:
        for joint, values, colour in zip(
            JOINTS, numbers.reserves.T, (BLUE, ORANGE, BLACK), strict=True
        ):
            line(panel, numbers.time, 1e3 * values, colour, joint)
        panel.legend(fontsize=7, ncols=3, frameon=False)
        name(panel, "reserves [mN·m]")
    else:
        values = 1e15 * numbers.forces[MAIN]["muscles.residual"]
        line(panel, numbers.time, values, BLUE, "optimum")
        name(panel, "conditions of the optimum [1e-15]")


def _draw_activations(numbers: WalkingNumbers, panel: Any, i: int) -> None:
    column = f"{numbers.muscles[i]}.activation"
    _draw_pair(numbers, panel, numbers.forces[MAIN][column], numbers.swing[MAIN][column])
    name(panel, numbers.muscles[i].replace("_", " "))


def _draw_forces(numbers: WalkingNumbers, panel: Any, i: int) -> None:
    muscle = numbers.muscles[i]
    found, true = numbers.forces[MAIN][f"{muscle}.force"], numbers.swing[MAIN][f"{muscle}.tension"]
    _draw_pair(numbers, panel, found, true)
    name(panel, f"{muscle.replace('_', ' ')} [N]")


def overview(numbers: WalkingNumbers) -> bytes:
    """One PNG with angles, moments and the load of the knee side by side."""
    draws: list[Draw] = [
        partial(draw, numbers) for draw in (_draw_angles, _draw_moments, _draw_load)
    ]
    return panels.overview(draws, len(JOINTS))
