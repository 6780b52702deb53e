"""A press with one noisy encoder, and its twin, as a page: `mbd-ros demo twin`.

A fault is planted in the press, and the twin must name it. No topic, no ROS.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.api import Scene, load_scene
from mbd_ros.applications.demo import panels
from mbd_ros.applications.demo.files import KNOWN, TWIN_TABLE, replacing_folder
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
from mbd_ros.applications.demo.panels import BLACK, BLUE, ORANGE, line, name, picture
from mbd_ros.applications.demo.task import TWIN
from mbd_ros.core.state import Array, State
from mbd_ros.features.estimation.estimation import (
    EFFORTS,
    Estimation,
    build_estimation,
    prepare_scene,
)
from mbd_ros.features.estimation.faults import FaultNaming
from mbd_ros.features.estimation.state_reconstruction import Determinations
from mbd_ros.features.estimation.task import EstimateTask
from mbd_ros.features.estimation.tracker import Tracker
from mbd_ros.files.table import MAIN, Column, Result, Table
from mbd_ros.methods.simulation.simulation import Simulation
from mbd_ros.scene.runs.simulation import build_simulation
from mbd_ros.scene.variants import with_numbers

SCENE = "press"
DURATION, STEP = 4.0, 0.005  # s: of a run, of the samples
FAULT, NAMED = 2.0, 1.5  # s: when it is planted, how long the twin may take to name it
WINDOW = 1.0  # s, over which hypotheses are compared
SPEED, GAIN = 6.28, 0.3  # rad/s and N·m s/rad of the drive that turns the crank
SEED = 7
HYPOTHESES: Mapping[str, Mapping[str, float]] = {
    "friction doubles": {"bearing.coulomb": 0.4, "bearing.viscous": 0.1},
    "spring loses a fifth": {"spring.stiffness": 3.2},
}
_SETTLED = 0.5  # s after which the twin knows the speed
_POSITION, _FORCE = 1.0e-3, 1.0  # rad, N: accepted errors before the fault
_JOINTS = ("crank", "coupler", "rocker")
_CLOSURE = "rocker_loop_closure"
_CLOSURE_X = f"{_CLOSURE}.x"
TITLE, _SLOWER = "Demo: a press and its twin", 2.0


def twin(out: Path) -> Iterator[str]:
    """Simulate the press, follow it, write page, picture and table.

    Args:
        out: Folder, see `replacing_folder`.

    Yields:
        What happens, then the summary.

    Raises:
        DataError: A place that is not accepted.
        Failed: A check is not met; the page is kept.
    """
    with replacing_folder(out, KNOWN) as folder:
        yield f"{TWIN} ..."
        numbers = TwinNumbers()
        checks = numbers.checks()
        summary = [_faults(numbers), check_table(checks)]
        failed = [f"{c.what}: {c.value}" for c in checks if not c.is_met]
        _samples(numbers).to(folder / f"{TWIN_TABLE}.csv")
        content = _content(numbers, summary, failed)
        write_page(folder, overview(numbers), content)
    yield from conclusion(content, "table", out)


def _faults(numbers: TwinNumbers) -> SummaryTable:
    rows = []
    for run in numbers.runs:
        said = [f"{what} at {t:.2f} s" for t, what in run.named if what]
        late = numbers.delay(run)
        rows.append((run.fault or "none", "; ".join(said) or "-", f"{late:.2f}" if late else "-"))
    heads = ("planted fault", "what the twin says", "after [s]")
    return SummaryTable(f"Faults, planted at {FAULT:g} s", heads, rows)


def _samples(numbers: TwinNumbers) -> Result:
    return Result({MAIN: numbers.runs[-1].samples}, {"job": "demo"})


def _content(numbers: TwinNumbers, summary: list[SummaryTable], failed: list[str]) -> Content:
    noise = numbers.scene.sensors[0].noise  # type: ignore[attr-defined]
    text = [
        "A motor turns the crank of a four-bar; its rocker works against a spring and friction of "
        f"its bearing. One encoder sees the crank, with noise of {1e3 * noise:g} mrad, and the "
        "torque of the motor is known. The twin, an extended Kalman filter on the loop, finds all "
        "other joints and the forces in the loop.",
        "What moves the press and is not in the model is estimated as an effort on the joint that "
        "shows it best. Each hypothesis says which effort would be lacking if it were true; over "
        f"the last {WINDOW:g} s the twin compares, and names what explains the lacking effort.",
    ]
    made = {
        "Hypotheses": "; ".join(
            f"{name}: {', '.join(f'{k} = {v:g}' for k, v in numbers_.items())}"
            for name, numbers_ in HYPOTHESES.items()
        ),
        "Accepted": f"a fault is named within {NAMED:g} s",
        **machine(("numpy", "pin")),
    }
    moves = moving_result(numbers.scene, _samples(numbers), TITLE, _SLOWER)
    caption = f"The press with the last fault, {_SLOWER:g} times slower."
    facts = f"{len(numbers.runs)} runs of {DURATION:g} s, {1 / STEP:g} samples a second."
    shown = pictures(numbers)
    return Content(TITLE, facts, failed, text, (moves, caption), shown, summary, made)


class TwinNumbers:
    """Runs of the press: as it should be, and with each fault."""

    def __init__(self) -> None:
        self.scene: Scene = load_scene(SCENE)
        self.runs = [_run(self.scene, fault) for fault in ("", *HYPOTHESES)]

    def checks(self) -> list[Check]:
        """Return the checks of the demonstration."""
        sound = self.runs[0]
        named = ", ".join(what for _, what in sound.named) or "nothing"
        results = [
            Check(
                "joints that nothing measures, largest error [mrad]",
                self.error("position") <= _POSITION,
                f"{1e3 * self.error('position'):.3f}",
            ),
            Check(
                "force that closes the loop, largest error [N]",
                self.error("force") <= _FORCE,
                f"{self.error('force'):.3f}",
            ),
            Check("nothing is named without a fault", not sound.named, named),
        ]
        for run in self.runs[1:]:
            late = self.delay(run)
            said = "never" if late is None else f"after {late:.2f} s"
            results.append(
                Check(f"'{run.fault}' is named", late is not None and late <= NAMED, said)
            )
        return results

    def error(self, what: str) -> float:
        """Return the error without a fault, once the twin knows the speed [rad or N]."""
        samples = self.runs[0].samples
        after = samples["time"] > _SETTLED
        if what == "position":
            pairs = [(f"{j}.position", f"{j}.estimate") for j in _JOINTS[1:]]
        else:
            pairs = [(f"{_CLOSURE}.{axis}", f"{_CLOSURE}.{axis}_estimate") for axis in "xz"]
        return max(float(np.abs(samples[a] - samples[b])[after].max()) for a, b in pairs)

    @staticmethod
    def delay(run: Run) -> float | None:
        """From a fault until it, and nothing else, is named [s]; None if that never happens."""
        wrong = [t for t, what in run.named if what and what != run.fault]
        right = [t for t, what in run.named if what == run.fault]
        return right[0] - FAULT if right and not wrong else None


def _run(scene: Scene, fault: str) -> Run:
    task = EstimateTask(disturbance=None)
    estimation = build_estimation(scene, task, ["crank"], ())
    system, rng = estimation.process.simulation.system, np.random.default_rng(SEED)
    press, tracker = _Press(scene, fault), _tracker(estimation)
    naming = _naming(scene, estimation)
    ahead, slot = Determinations(system, ["crank"]), estimation.scene.inputs.slots[EFFORTS]
    rows, named, closest, u = [], [(0.0, "")], np.inf, estimation.scene.inputs.safe
    for k in range(1, round(DURATION / STEP) + 1):
        x, torque, force = press.advance(k * STEP)
        u = u.copy()
        u[slot] = [torque[0], 0.0, 0.0]
        noise = scene.sensors[0].noise  # type: ignore[attr-defined]
        tracker.add_sample(k * STEP, x.q[:1] + noise * rng.standard_normal(1), u)
        belief = tracker.belief
        state = system.expand(belief.x)
        now = system.evaluate(state, u)
        closest = min(closest, ahead.at(belief.x, system.integrated(now.a)).time)
        lacking = estimation.unknown_efforts(state)
        naming.add(state, u, lacking, np.sqrt(belief.P.diagonal()[-len(lacking) :]))
        what = naming.diagnose().name
        if what != named[-1][1]:
            named.append((k * STEP, what))
        rows.append([k * STEP, *x.q, *state.q, *force, *now.lam[:2], lacking[0], torque[0]])
    return Run(fault, _table(np.array(rows)), named[1:], closest)


class Run(NamedTuple):
    """One run; arrays have one row a sample.

    Attributes:
        fault: What was planted; empty for nothing.
        samples: `time`, true and estimated positions, unknown effort, force of the closure.
        named: (time, what) whenever the twin names something else than before.
        closest: Least time to a singular configuration that the twin foresaw [s].
    """

    fault: str
    samples: Table
    named: list[tuple[float, str]]
    closest: float


class _Press:
    """The machine: a simulation whose drive keeps the speed of the crank."""

    def __init__(self, scene: Scene, fault: str) -> None:
        self._sound = build_simulation(scene)
        self._faulty = (
            build_simulation(with_numbers(scene, dict(HYPOTHESES[fault]))) if fault else None
        )
        self.at: Simulation = self._sound
        self._y = self.at.start(scene.initial, np.zeros(1))

    def advance(self, t: float) -> tuple[State, Array, Array]:
        """State of all joints at a time, torque until then, force of the closure."""
        if self._faulty is not None and self.at is self._sound and t > FAULT:
            x = self.at.system.expand(self._y)
            self.at = self._faulty
            self._y = self.at.start(x, np.zeros(1))
        torque = np.array([GAIN * (SPEED - self._y.v[0])]).clip(-5.0, 5.0)
        self._y = self.at.advance(self._y, torque, t)
        x = self.at.system.expand(self._y)
        return x, torque, self.at.system.evaluate(x, torque).lam[:2]


def _tracker(estimation: Estimation) -> Tracker:
    process, first = estimation.process, estimation.scene.initial
    y = process.fit_state(process.consistent(first), np.array([first.q[0]]), estimation.prior)
    estimation.estimator.begin(y, estimation.prior, 0.0)
    return Tracker(estimation.estimator, process.sensors)


def _naming(scene: Scene, estimation: Estimation) -> FaultNaming:
    systems = {
        name: prepare_scene(
            with_numbers(scene, dict(numbers)), estimation.task, estimation.disturbed
        ).system()
        for name, numbers in HYPOTHESES.items()
    }
    at = np.array([scene.robot.joint(name).v for name in estimation.disturbed], dtype=np.intp)
    return FaultNaming(estimation.process.simulation.system, systems, at, WINDOW)


def _table(rows: Array) -> Table:
    names = ["time", *(f"{j}.position" for j in _JOINTS), *(f"{j}.estimate" for j in _JOINTS)]
    names += [f"{_CLOSURE}.{axis}{end}" for end in ("", "_estimate") for axis in "xz"]
    names += ["unknown_effort", "torque"]
    units = ["s", *["rad"] * 6, *["N"] * 4, "N·m", "N·m"]
    return Table([Column(n, c, unit) for n, c, unit in zip(names, rows.T, units, strict=True)])


def pictures(numbers: TwinNumbers) -> dict[str, bytes]:
    """PNG by title."""
    return {
        "What nothing measures": picture(partial(_draw_sound, numbers), 3),
        "What the model lacks": picture(partial(_draw_lacking, numbers), 1 + len(HYPOTHESES)),
    }


def _draw_sound(numbers: TwinNumbers, panel: Any, i: int) -> None:
    samples = numbers.runs[0].samples
    true, estimated, text = (
        ("rocker.position", "rocker.estimate", "rocker [rad]"),
        ("coupler.position", "coupler.estimate", "coupler [rad]"),
        (_CLOSURE_X, f"{_CLOSURE_X}_estimate", "force of the closure, x [N]"),
    )[i]
    line(panel, samples["time"], samples[true], BLACK, "press")
    line(panel, samples["time"], samples[estimated], BLUE, "twin", "--")
    name(panel, text)
    panel.legend(fontsize=7, loc="upper right")


def _draw_lacking(numbers: TwinNumbers, panel: Any, i: int) -> None:
    run = numbers.runs[i]
    line(panel, run.samples["time"], run.samples["unknown_effort"], BLUE, "unknown effort")
    name(panel, f"{run.fault or 'no fault'}: unknown effort [N·m]")
    if run.fault:
        panel.axvline(FAULT, color=BLACK, lw=0.8)
    for t, what in run.named:
        if what:
            panel.axvline(t, color=ORANGE, lw=1.0)


def overview(numbers: TwinNumbers) -> bytes:
    """One PNG with both side by side."""
    return panels.overview([partial(_draw_sound, numbers), partial(_draw_lacking, numbers)], 3)
