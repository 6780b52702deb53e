"""Other packages on the same scenes: ratios of CPU time at equal error."""

import importlib
import importlib.util
from collections.abc import Iterator, Sequence
from typing import Any

from mbd_ros.applications.report.items import Item, Outcome, Section, Spec
from mbd_ros.applications.report.peers.contenders import Contender, Ours, compete
from mbd_ros.applications.report.peers.text import compose
from mbd_ros.applications.report.peers.translation import common_ground, task_of
from mbd_ros.applications.report.precision.converged import (
    COMPILED,
    Choice,
    compiles,
    motion_of,
    stabilizations,
)
from mbd_ros.applications.report.subjects import failures, is_own, subjects
from mbd_ros.errors import MbdError, SceneError
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.reader import load_scene

PEERS = {
    "mujoco": "mbd_ros.applications.report.peers.mujoco_peer",
    "pydrake": "mbd_ros.applications.report.peers.drake_peer",
    "exudyn": "mbd_ros.applications.report.peers.exudyn_peer",
}
_SHOWN = {"mujoco": "MuJoCo", "pydrake": "Drake", "exudyn": "Exudyn"}
_SCENES = (
    "arm7_swing",
    "arm7_release",
    "arm7_swing_coupled",
    "x02_four_bar_1e-2",
    "a02_four_bars_2",
)
_QUICK = ("arm7_swing_coupled",)
_STEPS = (
    0.05,
    0.025,
    0.02,
    0.0125,
    0.01,
    8e-3,
    5e-3,
    2.5e-3,
    2e-3,
    1.6e-3,
    1.25e-3,
    1e-3,
    8e-4,
    5e-4,
    2.5e-4,
)  # s
_LARGEST = {"dop853": 0.05, "rk4": 0.01, "adams": 0.01}
_SMALLEST = {"dop853": 2e-3, "rk4": 5e-4, "adams": 2.5e-4}
_SECONDS, _SECONDS_QUICK = 40.0, 8.0
_SPAN = 1.0  # s


def installed() -> list[str]:
    """Those of `PEERS` that can be imported."""
    return [name for name in PEERS if importlib.util.find_spec(name) is not None]


def items(scenes: Sequence[str], quick: bool) -> list[Item]:
    """One item a scene; none without peers."""
    names = installed()
    if not names:
        return []
    seconds, found = (_SECONDS_QUICK if quick else _SECONDS), []
    for subject in subjects(scenes, quick):
        if scenes or subject.name in (_QUICK if quick else _SCENES):
            spec = {
                "scene": subject.path,
                "times": [t for t in subject.times if t <= _SPAN],
                "peers": names,
                "quick": quick,
            }
            found.append(Item("peers", subject.name, spec, seconds, True))
    return found


def run(spec: Spec) -> Outcome:
    """All contenders on one scene, in turn."""
    ground, times = common_ground(load_scene(spec["scene"])), tuple(spec["times"])
    missing = [name for name in spec["peers"] if name not in installed()]
    if missing:
        return {"failed": f"not installed on this worker: {', '.join(missing)}"}
    try:
        motion = motion_of(ground.scene, times)
    except MbdError as error:
        return {"failed": f"{type(error).__name__}: {error}"}
    contenders: list[Contender] = []
    facts: dict[str, Any] = {"left": list(ground.left), "refused": [], "setups": []}
    for name in spec["peers"]:
        module = importlib.import_module(PEERS[name])
        try:
            contenders += list(module.runs(task_of(ground, motion.states), spec["quick"]))
            facts["setups"].append(module.SETUP)
        except SceneError as error:
            facts["refused"].append(f"{_SHOWN[name]}: {error}")
    if contenders:
        contenders = [*_ours(ground.scene, spec["quick"]), *contenders]
    records = compete(ground.scene, contenders, motion, 2 if spec["quick"] else 3)
    agreement = motion.agreement if motion.check else None
    facts |= {"span": times[-1], "quick": spec["quick"], "own": is_own(spec["scene"])}
    return {"runs": records, "agreement": agreement, "check": motion.check, **facts}


def section(outcomes: Sequence[tuple[Item, Outcome]]) -> Section:
    """Ratios first, then one plot a scene."""
    missing = [name for name in PEERS if name not in installed()]
    made = compose([(item.name, outcome) for item, outcome in outcomes], missing)
    return made._replace(wrong=[*failures(outcomes), *made.wrong])


def _ours(scene: Scene, quick: bool) -> Iterator[Ours]:
    for choice in _choices(scene, quick):
        yield Ours(scene, choice)
    if compiles(scene, {"type": "dop853"}):
        for choice in _native_choices(scene, quick):
            yield Ours(scene, choice)


def _choices(scene: Scene, quick: bool) -> Iterator[Choice]:
    """Choices that `precision` found on the front of such scenes."""
    least = 5e-4 if scene.has_loops else 0.0  # s; below it a loop takes seconds
    for stabilization in stabilizations(scene, "plain", "dop853")[: 1 if quick else 3 : 2]:
        for exponent in range(3, 13, 2 if quick else 1):
            entry = {"type": "dop853", "tolerance": float(f"1e-{exponent}")}
            yield Choice("plain", stabilization, entry, 1e-2)
        for kind, order in (("dop853", 0), ("rk4", 0), *(("adams", k) for k in (6, 7, 8))):
            for dt in _STEPS[:: 2 if quick else 1]:
                if max(_SMALLEST[kind], least) <= dt <= _LARGEST[kind]:
                    entry = {"type": kind} | ({"order": order} if order else {})
                    yield Choice("plain", stabilization, entry, dt)


def _native_choices(scene: Scene, quick: bool) -> Iterator[Choice]:
    """Choices for native code, where an evaluation costs little and a call from Python much."""
    for stabilization in stabilizations(scene, "plain", "dop853")[: 1 if quick else 3 : 2]:
        for kind in ("dop853",) if quick else ("dopri5", "dop853"):
            for exponent in range(2, 13, 2 if quick else 1):
                entry = {"type": kind, "tolerance": float(f"1e-{exponent}")}
                yield Choice(COMPILED, stabilization, entry, 5e-2)
        for order in () if quick else (4, 6, 8):
            for dt in _STEPS[4:]:
                yield Choice(COMPILED, stabilization, {"type": "adams", "order": order}, dt)
