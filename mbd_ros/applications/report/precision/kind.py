"""Error against run time of every way to integrate a scene."""

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

from mbd_ros.applications.report.items import Item, Outcome, Section, Spec
from mbd_ros.applications.report.precision.converged import (
    COMPILED,
    WANTED,
    Choice,
    Known,
    Record,
    approach,
    compiles,
    formulations,
    known,
    measure,
    of_record,
    stabilizations,
)
from mbd_ros.applications.report.precision.text import compose
from mbd_ros.applications.report.subjects import Subject, failures, is_own, subjects
from mbd_ros.errors import MbdError
from mbd_ros.methods.events.switching_surfaces import DiscontinuousForce
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.reader import load_scene

# Runs of a work-precision diagram: integrators, and steps from coarse to fine.

_SERIES = (1.0, 2.0, 5.0)
_FINER = (1.0, 1.25, 1.6, 2.0, 2.5, 3.2, 4.0, 5.0, 6.4, 8.0)
_TOLERANCES = tuple(10.0**-k for k in range(3, 13))


class Ladder(NamedTuple):
    """One integrator from coarse to fine.

    Attributes:
        integrator: Its entry, without tolerance.
        coarsest: Steps of the scene that the longest step has; None: tolerances.
        rungs: How many steps are tried.
        evaluations: About how many a step takes.
    """

    integrator: Mapping[str, Any]
    coarsest: float | None
    rungs: int
    evaluations: float


def _of(kind: str, coarsest: float | None, rungs: int, cost: float, **more: int) -> Ladder:
    return Ladder({"type": kind, **more}, coarsest, rungs, cost)


FAMILIES: Mapping[str, tuple[Ladder, ...]] = {
    "semi_implicit_euler": (_of("semi_implicit_euler", 1.0, 6, 1),),
    "rk4": (_of("rk4", 20.0, 9, 4),),
    "adams": tuple(_of("adams", 5.0, 8, 1, order=order) for order in (4, 6, 7, 8)),
    "dopri5": (_of("dopri5", None, 10, 6), _of("dopri5", 20.0, 8, 6)),
    "dop853": (_of("dop853", None, 10, 12), _of("dop853", 50.0, 8, 12)),
    "gauss_legendre": tuple(
        _of("gauss_legendre", 50.0, 8, 5 * stages, stages=stages) for stages in (1, 2, 3)
    ),
    "generalized_alpha": (_of("generalized_alpha", 5.0, 7, 5),),
    "verlet": (_of("rattle", 5.0, 7, 3), _of("shake", 5.0, 7, 3)),
    "filippov": (_of("filippov", None, 10, 12), _of("filippov", 10.0, 6, 12)),
}
REFINED = ("adams", "dop853")  # steps are finer where these reach what is wanted
CROSSED = "rk4"  # with it every formulation meets every stabilization


def families(scene: Scene, quick: bool) -> list[str]:
    """Families that are informative for a scene."""
    switches = any(isinstance(force, DiscontinuousForce) for force in scene.forces)
    if switches:
        return ["semi_implicit_euler", "rk4", "dopri5", "filippov"]
    return [name for name in FAMILIES if name != "filippov" and not (quick and name == "verlet")]


def climb(scene: Scene, family: str, motion: Known, quick: bool) -> list[Record]:
    """All runs of a family, every formulation and stabilization among them.

    A ladder ends where rounding is reached, where the next run would take too many evaluations,
    or where the scene refuses the method. None of that depends on a clock, so that a second
    report has the same runs.
    """
    records = []
    for solver, stabilization, is_main in _variants(scene, family, quick):
        for ladder in FAMILIES[family]:
            if solver == COMPILED and not compiles(scene, ladder.integrator):
                continue
            thin = 1 if is_main and not quick else 2
            climbed = _climb(scene, ladder, (solver, stabilization), motion, thin, quick)
            records += climbed
            if thin == 1 and family in REFINED and ladder.coarsest is not None:
                most = 3.0 * _budget(scene, solver, thin, quick)
                records += [measure(scene, c, motion, 2, most) for c in between(climbed)]
    return records


def between(climbed: Sequence[Record]) -> list[Choice]:
    """Choices between the first rung that reaches a wanted error and the one before.

    Args:
        climbed: Rungs of one ladder of steps, from coarse to fine.
    """
    rungs = [run for run in climbed if "left_out" not in run]
    steps: dict[float, Choice] = {}
    for error in WANTED:
        for coarse, fine in pairwise(rungs):
            if fine.get("position", math.inf) <= error:
                if not coarse.get("position", math.inf) <= error:
                    for dt in _inside(fine["dt"], coarse["dt"]):
                        steps[dt] = of_record(fine)._replace(dt=dt)
                break
    return list(steps.values())


def _inside(low: float, high: float) -> list[float]:
    """Round steps between two [s]."""
    tens = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    steps = [float(f"{digits * 10.0**k:.6g}") for k in tens for digits in _FINER]
    return [dt for dt in steps if low < dt < high]


def _variants(scene: Scene, family: str, quick: bool) -> Iterator[tuple[str, Any, bool]]:
    """Formulations and stabilizations; the first is what a scene has by itself, then compiled."""
    kind = FAMILIES[family][0].integrator["type"]
    for i, solver in enumerate(formulations(scene)):
        for k, stabilization in enumerate(stabilizations(scene, solver, kind)):
            if family == CROSSED or i == 0 or k == 0:
                yield solver, stabilization, i == k == 0
    if not quick or family in REFINED:
        for k, stabilization in enumerate(stabilizations(scene, "plain", kind)[::2]):
            yield COMPILED, stabilization, k == 0


def _climb(
    scene: Scene, ladder: Ladder, variant: tuple[str, Any], motion: Known, thin: int, quick: bool
) -> list[Record]:
    """One ladder; with `thin` 2 every other rung and a quarter of the time."""
    records: list[Record] = []
    budget = _budget(scene, variant[0], thin, quick)
    predicted, misses, best = 0.0, 0, math.inf
    for choice, ratio in _rungs(scene, ladder, variant, thin):
        if choice.integrator.get("tolerance") is None:
            per_step = ladder.evaluations + (2.0 if variant[1] else 0.0)
            predicted = motion.times[-1] / choice.dt * per_step
        if predicted > budget:
            records.append(dict(choice._asdict()) | {"left_out": f"{predicted:.2g} evaluations"})
            break
        repeats = _repeats(predicted / budget)
        record = measure(scene, choice, motion, repeats, 3.0 * budget)
        records.append(record)
        if "stopped" in record:
            if "ModelError" in record["stopped"] or "more than" in record["stopped"]:
                break
            continue
        steps = record["steps"] * ladder.evaluations  # native code does not count evaluations
        predicted = ratio * (steps if variant[0] == COMPILED else record["evaluations"])
        misses = 0 if record["configuration"] < 0.5 * best else misses + 1
        best = min(best, record["configuration"])
        if misses == 2 or best < 1e-13:
            break
    return records


def _rungs(
    scene: Scene, ladder: Ladder, variant: tuple[str, Any], thin: int
) -> Iterator[tuple[Choice, float]]:
    """Choices from coarse to fine, and how many times more evaluations the next takes."""
    solver, stabilization = variant
    if ladder.coarsest is None:
        order = 8.0 if ladder.evaluations > 6 else 5.0
        for tolerance in _TOLERANCES[::thin]:
            integrator = {**ladder.integrator, "tolerance": float(f"{tolerance:.0e}")}
            yield Choice(solver, stabilization, integrator, scene.dt), 10.0 ** (thin / order)
        return
    place = math.floor(3.0 * math.log10(ladder.coarsest * scene.dt) + 1e-9)
    for i in range(0, ladder.rungs, thin):
        tens, digit = divmod(place - i, 3)
        dt = float(f"{_SERIES[digit] * 10.0**tens:.6g}")
        yield Choice(solver, stabilization, ladder.integrator, dt), 2.2**thin


def _repeats(share: float) -> int:
    """How often a run is made that takes a share of what it may: noise is small in long ones."""
    return 3 if share < 0.1 else 2 if share < 0.3 else 1


def _budget(scene: Scene, solver: str, thin: int, quick: bool) -> float:
    """Evaluations that a run may take."""
    return (0.05 if quick else 0.2 / thin**2) / _evaluation(scene, solver)


def _evaluation(scene: Scene, solver: str) -> float:
    """About what one evaluation takes [s]; only to plan with."""
    system = scene.system(solver={"type": solver})
    rows, nv = len(system.multiplier_rows), system.model.nv
    seconds = 2e-6 + 3e-7 * nv + 8e-6 * len(scene.forces)
    if rows:
        seconds += 1e-5 + 4e-6 * rows + 1.2e-7 * rows * nv
    return seconds * {"qp": 3.0, COMPILED: 0.1}.get(solver, 1.0)


def planned(scene: Scene, family: str, quick: bool) -> float:
    """About how long `climb` takes [s]."""
    per_run = 0.05 if quick else 0.2
    main, others = len(FAMILIES[family]), len(list(_variants(scene, family, quick))) - 1
    rungs = 4.0 if family in REFINED and not quick else 2.5
    return per_run * (rungs * main + 0.4 * others * main) + 1.0


_REFERENCE = "reference"


def items(scenes: Sequence[str], quick: bool) -> list[Item]:
    """One item a scene and family of integrators, and one for the motion itself."""
    entries = []
    for subject in subjects(scenes, quick):
        scene = load_scene(subject.path)
        entries.append(_item(scene, subject, _REFERENCE, quick))
        entries += [_item(scene, subject, name, quick) for name in families(scene, quick)]
    return entries


def run(spec: Spec) -> Outcome:
    """The runs of one family on one scene, or how well its motion is known."""
    scene, times = load_scene(spec["scene"]), tuple(spec["times"])
    try:
        motion = known(spec["scene"], times)
        if spec["family"] != _REFERENCE:
            return {"runs": climb(scene, spec["family"], motion, spec["quick"])}
        checked = approach(scene, motion)
    except MbdError as error:
        return {"failed": f"{type(error).__name__}: {error}"}
    return {
        "method": motion.method,
        "check": motion.check,
        "agreement": motion.agreement if motion.check else None,
        "published": motion.published,
        "rattle": checked.text,
        "wrong": _wrong(motion.is_wrong, motion.published, checked.is_wrong, checked.text),
    }


def section(outcomes: Sequence[tuple[Item, Outcome]]) -> Section:
    """One plot, table and choice a scene."""
    scenes: dict[str, dict[str, Any]] = {}
    for item, outcome in outcomes:
        entry = scenes.setdefault(
            item.name.split(".")[0],
            {"times": item.spec["times"], "runs": [], "own": is_own(item.spec["scene"])},
        )
        if item.spec["family"] == _REFERENCE:
            entry["reference"] = outcome
        elif "failed" in outcome:
            entry["failed"] = outcome["failed"]
        else:
            entry["runs"] += outcome["runs"]
    section = compose(scenes)
    return section._replace(wrong=[*failures(outcomes), *section.wrong])


def _item(scene: Scene, subject: Subject, family: str, quick: bool) -> Item:
    spec: Mapping[str, Any] = {
        "scene": subject.path,
        "times": list(subject.times),
        "family": family,
        "quick": quick,
    }
    name = f"{subject.name.replace('.', '_')}.{family}"
    is_timed = family != _REFERENCE
    seconds = planned(scene, family, quick) if is_timed else 3.0
    return Item("precision", name, spec, seconds, is_timed)


def _wrong(is_off: bool, published: float | None, is_astray: bool, text: str) -> list[str]:
    lines = []
    if is_off:
        lines.append(f"converged motion is {published:.1e} off the published one")
    if is_astray:
        lines.append(f"accelerations lead to another motion than impulses: {text}")
    return lines
