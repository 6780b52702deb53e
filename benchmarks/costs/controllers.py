"""Cost of control laws as ratios to a bare `pin.aba`, of the QP to its tier where no limit acts.

python benchmarks/costs/controllers.py [--states 2000]
"""

import argparse
import gc
import json
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from mbd_ros.core.dynamics.tiers import build_system
from mbd_ros.core.loads.loads import Loads
from mbd_ros.core.rows.constraint_rows import rigid
from mbd_ros.core.state import Array, State
from mbd_ros.errors import SolveError
from mbd_ros.methods.control.contract import ControlledJoints, Controller, EffortBox, Reference
from mbd_ros.methods.projection.assembly import assemble
from mbd_ros.parts.controllers.qp_tracking import QpTracking
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.reader import load_scene
from mbd_ros.scene.schema.locate import find_file
from mbd_ros.scene.schema.registry import PARTS, resolve

_SCENES = "package://mbd_ros/config/scenes"
_NO_MEMORY = np.zeros(0)
_PASSES = 3
MECHANISMS: dict[str, tuple[str, ...]] = {
    "prosthetic_arm": (),
    "four_bar_leg": ("hip_flexion", "knee_anterior", "ankle"),
    "arm7": (),
}
RATES = {"torque": np.inf, "rate": 0.05, "any_rate": 0.2}


class Snapshot(NamedTuple):
    """A state with a reference and the efforts that the next command may have."""

    x: State
    ref: Reference
    box: EffortBox


def main() -> int:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--states", type=int, default=2000)
    count = parser.parse_args().states
    result = {"laws_over_aba": _laws(count), "qp_tracking": {m: _qp(m, count) for m in MECHANISMS}}
    json.dump(result, sys.stdout, indent=2)
    print()
    return 0


def mechanism(name: str) -> tuple[Scene, ControlledJoints]:
    """A scene and its controlled joints."""
    scene = load_scene(find_file(Path(), f"{_SCENES}/{name}.yaml", "benchmark"))
    loads = Loads(scene.robot.model.nv, scene.forces)
    system = build_system(scene.robot, scene.couplings, rigid(scene.constraints), loads)
    return scene, ControlledJoints(system, MECHANISMS[name] or scene.actuated)


def situations(
    scene: Scene, joints: ControlledJoints, rng: Any, count: int, kind: str
) -> Iterator[Snapshot]:
    """States within the limits of all joints, some faster, and references that ask for more.

    Args:
        scene: The scene.
        joints: Its controlled joints.
        rng: Random numbers.
        count: How many.
        kind: `torque`: torque limits. `rate`: as well no more than 5 % of them away from a
            command near the one without limits. `any_rate`: no more than 20 % away from any one.
    """
    n, limit = len(joints), np.array([joint.max_effort for joint in joints.joints])
    free = QpTracking(joints, position_limits=False, velocity_limits=False)
    none = EffortBox(np.full(n, -np.inf), np.full(n, np.inf))
    for x in _states(scene, joints, rng, count):
        q, v, a = rng.normal(size=(3, n))
        ref = Reference(joints.positions(x) + 0.3 * q, v, 3.0 * a)
        sent = rng.uniform(-limit, limit)
        if kind == "rate":
            near = free.effort(x, ref, _NO_MEMORY, none).effort + 0.1 * limit * rng.normal(size=n)
            sent = np.clip(near, -limit, limit)
        reach = RATES[kind] * limit
        yield Snapshot(
            x, ref, EffortBox(np.maximum(-limit, sent - reach), np.minimum(limit, sent + reach))
        )


def _states(scene: Scene, joints: ControlledJoints, rng: Any, count: int) -> Iterator[State]:
    robot, system = scene.robot, joints.system
    lower, upper, fastest = (
        np.array([getattr(joint, name) for joint in robot.joints])
        for name in ("lower", "upper", "max_velocity")
    )
    while count:
        q, v = rng.uniform(lower, upper), rng.uniform(-fastest, fastest)
        if system.rows:
            q = scene.initial.q + 0.5 * rng.normal(size=len(q))
        try:
            x = system.expand(assemble(system, system.reduce(State(0.0, q, v))))
        except SolveError:
            continue
        if (x.q < lower).any() or (x.q > upper).any():
            continue
        too_fast = float((np.abs(x.v) / fastest).max()) / rng.uniform(0.5, 1.02)
        yield x._replace(v=x.v / max(too_fast, 1.0))
        count -= 1


def timed(controller: Controller, given: Sequence[Snapshot]) -> Array:
    """CPU time of each call [us], shape (len(given),); a collection would take longer."""
    spent, memory = np.zeros(len(given)), controller.begin()
    gc.disable()
    try:
        for i, (x, ref, box) in enumerate(given):
            begin = time.thread_time()
            controller.effort(x, ref, memory, box)
            spent[i] = time.thread_time() - begin
    finally:
        gc.enable()
    return 1.0e6 * spent


def with_and_without_limits(
    joints: ControlledJoints, given: Sequence[Snapshot]
) -> tuple[Array, Array, QpTracking]:
    """Cost of calls of `qp_tracking`.

    Other work may run beside it: compared passes follow one another, and a call counts with the
    least of three equal passes.

    Returns:
        CPU time of each call [us], and of one where no limit acts, shape (len(given),), and the
        controller after a pass.
    """
    n = len(joints)
    still, none = np.zeros(n), EffortBox(np.full(n, -np.inf), np.full(n, np.inf))
    at_rest = []
    for x, _, _ in given:
        x = x._replace(v=np.zeros(len(x.v)))
        at_rest.append(Snapshot(x, Reference(joints.positions(x), still, still), none))
    spent, without = [], []
    for _ in range(_PASSES):
        controller = QpTracking(joints)
        without.append(timed(controller, at_rest))
        assert not controller.counts.solves
        spent.append(timed(controller, given))
    return np.min(spent, axis=0), np.min(without, axis=0), controller


def _qp(name: str, count: int) -> dict[str, Any]:
    scene, joints = mechanism(name)
    rng, result = np.random.default_rng(1), dict[str, Any]()
    for kind in RATES:
        given = list(situations(scene, joints, rng, count, kind))
        spent, without, controller = with_and_without_limits(joints, given)
        p50, p99 = np.percentile(spent, (50.0, 99.0)).tolist()
        tier = float(np.median(without))
        result[kind] = {
            "no_limit_us": tier,
            "p50_us": p50,
            "p99_us": p99,
            "p50_ratio": p50 / tier,
            "p99_ratio": p99 / tier,
            "states": count,
            **controller.counts._asdict(),
        }
    return result


def _laws(count: int) -> dict[str, float]:
    """Median over one bare aba of the 7-joint arm; without effort limits, and without plans."""
    scene, joints = mechanism("arm7")
    rng, n, model = np.random.default_rng(2), len(joints), scene.robot.model
    none = EffortBox(np.full(n, -np.inf), np.full(n, np.inf))
    given = [m._replace(box=none) for m in situations(scene, joints, rng, count, "torque")]
    data, spent = model.createData(), np.zeros(count)
    for i, (x, _, _) in enumerate(given):
        begin = time.thread_time()
        for _ in range(20):
            pin.aba(model, data, x.q, x.v, x.v)
        spent[i] = 1.0e6 * (time.thread_time() - begin) / 20
    aba = float(np.median(spent))
    laws = {name: resolve("controllers", name, "benchmark") for name in PARTS["controllers"]}
    return {
        name: float(np.median(timed(law(joints, **law.example), given))) / aba
        for name, law in laws.items()
        if not law.files
    }


if __name__ == "__main__":
    sys.exit(main())
