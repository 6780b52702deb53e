"""A press with one noisy encoder, its twin, and a fault that is planted in the press."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from mbd_ros.api import Scene, load_scene
from mbd_ros.applications.demo.summary import Check
from mbd_ros.core.state import Array, State
from mbd_ros.features.estimation.estimation import EFFORTS, Estimation, estimation_of, made_ready
from mbd_ros.features.estimation.faults import FaultNaming
from mbd_ros.features.estimation.state_reconstruction import Determinations
from mbd_ros.features.estimation.task import EstimateTask
from mbd_ros.features.estimation.tracker import Tracker
from mbd_ros.files.table import Column, Table
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


class TwinNumbers:
    """Runs of the press: as it should be, and with each fault."""

    def __init__(self) -> None:
        self.scene: Scene = load_scene(SCENE)
        self.runs = [_run(self.scene, fault) for fault in ("", *HYPOTHESES)]

    def checks(self) -> list[Check]:
        """What must hold."""
        sound = self.runs[0]
        named = ", ".join(what for _, what in sound.named) or "nothing"
        found = [
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
            found.append(
                Check(f"'{run.fault}' is named", late is not None and late <= NAMED, said)
            )
        return found

    def error(self, what: str) -> float:
        """Of the run without a fault, once the twin knows the speed [rad or N]."""
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


def _run(scene: Scene, fault: str) -> Run:
    task = EstimateTask(disturbance=None)
    estimation = estimation_of(scene, task, ["crank"], ())
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
        tracker.take(k * STEP, x.q[:1] + noise * rng.standard_normal(1), u)
        belief = tracker.belief
        found = system.expand(belief.x)
        now = system.evaluate(found, u)
        closest = min(closest, ahead.at(belief.x, system.integrated(now.a)).time)
        lacking = estimation.unknown_efforts(found)
        naming.add(found, u, lacking, np.sqrt(belief.P.diagonal()[-len(lacking) :]))
        what = naming.named().name
        if what != named[-1][1]:
            named.append((k * STEP, what))
        rows.append([k * STEP, *x.q, *found.q, *force, *now.lam[:2], lacking[0], torque[0]])
    return Run(fault, _table(np.array(rows)), named[1:], closest)


def _tracker(estimation: Estimation) -> Tracker:
    process, first = estimation.process, estimation.scene.initial
    y = process.near(process.consistent(first), np.array([first.q[0]]), estimation.prior)
    estimation.estimator.begin(y, estimation.prior, 0.0)
    return Tracker(estimation.estimator, process.sensors)


def _naming(scene: Scene, found: Estimation) -> FaultNaming:
    systems = {
        name: made_ready(with_numbers(scene, dict(numbers)), found.task, found.disturbed).system()
        for name, numbers in HYPOTHESES.items()
    }
    at = np.array([scene.robot.joint(name).v for name in found.disturbed], dtype=np.intp)
    return FaultNaming(found.process.simulation.system, systems, at, WINDOW)


def _table(rows: Array) -> Table:
    names = ["time", *(f"{j}.position" for j in _JOINTS), *(f"{j}.estimate" for j in _JOINTS)]
    names += [f"{_CLOSURE}.{axis}{end}" for end in ("", "_estimate") for axis in "xz"]
    names += ["unknown_effort", "torque"]
    units = ["s", *["rad"] * 6, *["N"] * 4, "N·m", "N·m"]
    return Table([Column(n, c, unit) for n, c, unit in zip(names, rows.T, units, strict=True)])
