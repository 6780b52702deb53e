"""Multipliers stand in one order, couplings first, then as the scene lists its constraints."""

import itertools

import numpy as np
import pinocchio as pin
import pytest
from mechanisms import scene_of, wrenches_of
from places import ROOT

from mbd_ros.core.dynamics.tiers import tier_of
from mbd_ros.core.state import State
from mbd_ros.scene.reader import load_scene

CONFIG = ROOT / "config"
LEG = (CONFIG / "scenes/four_bar_leg.yaml").read_text(encoding="utf-8")
HEAD, LOOP = LEG.replace("../robots", str(CONFIG / "robots")).split("constraints:\n")
LOOP, TAIL = LOOP.split("dt:")
STOP = (
    "- {type: joint_stop, joint: hip_flexion, upper: 0.2, smoothed: true}\n"  # passed at the start
)
FRICTION = "- {type: dry_friction, joint: ankle, limit: 0.7}\n"
ARM = (CONFIG / "scenes/prosthetic_arm.yaml").read_text(encoding="utf-8")


def leg(parts, solver="plain"):
    """The four-bar leg with these constraints, and its state in motion."""
    text = f"{HEAD}constraints:\n{''.join(parts)}dt:{TAIL}solver: {{type: {solver}}}\n"
    scene = scene_of(text)
    return scene, State(0.0, scene.initial.q, scene.initial.v)


def exerted(system, x, wrenches):
    """Generalized force of wrenches at a state, shape (nv,)."""
    total, model = np.zeros(system.model.nv), system.model
    data = model.createData()
    pin.computeJointJacobians(model, data, x.q)
    for frame, point, force, torque in wrenches:
        body = model.frames[system.robot.frame(frame)].parentJoint
        place = pin.SE3(np.eye(3), data.oMi[body].actInv(point))
        axes = pin.LOCAL_WORLD_ALIGNED
        at_point = pin.getFrameJacobian(model, data, body, place, axes)
        total += at_point.T @ np.concatenate([force, torque])
    return total


@pytest.mark.parametrize("solver", ["plain", "qp"])
@pytest.mark.parametrize("parts", list(itertools.permutations([LOOP, STOP, FRICTION])))
def test_wrenches_and_multipliers_do_not_depend_on_order_or_solver(parts, solver):
    expected_scene, x = leg([LOOP, STOP, FRICTION])
    known = expected_scene.system()
    _, a, _, lam, _ = known.evaluate(x)
    by_name = dict(zip([row.name for row in known.multiplier_rows], lam, strict=True))
    pull = [w.force for w in wrenches_of(known, x, lam)]
    assert by_name["hip_flexion_joint_stop.torque"] > 1.0
    assert abs(by_name["ankle_dry_friction.torque"]) > 0.1
    assert max(np.abs(force).max() for force in pull) > 1.0
    scene, x = leg(parts, solver)
    system = scene.system()
    found = system.evaluate(x)
    listed = [f"{p.name}.{row.name}" for p in scene.constraints for row in p.rows]
    assert [row.name for row in system.multiplier_rows] == listed
    wanted = np.array([by_name[name] for name in listed])
    assert found.a == pytest.approx(a, rel=1e-9)
    assert found.lam == pytest.approx(wanted, rel=1e-8)
    forces = [w.force for w in wrenches_of(system, x, found.lam)]
    assert np.concatenate(forces) == pytest.approx(np.concatenate(pull), rel=1e-8)
    J = system.jacobian(x.t, x.q)
    bars = found.lam[system.constraints.slots]
    whole = exerted(system, x, wrenches_of(system, x, found.lam))
    assert whole == pytest.approx(J.T @ bars, abs=1e-9 * np.abs(lam).max())


def test_couplings_come_first_under_every_solver():
    joint = load_scene(CONFIG / "scenes/prosthetic_arm.yaml").couplings.independent[0]
    stop = f"constraints:\n- {{type: joint_stop, joint: {joint}, upper: 0.1}}\n"
    rub = f"- {{type: dry_friction, joint: {joint}, limit: 1.0}}\n"
    text = ARM.replace("../robots", str(CONFIG / "robots")) + stop + rub
    scene = scene_of(text)
    reduced, rows = scene.system(), scene.system(solver={"type": "qp"})
    y = State(0.0, np.full(reduced.nq, 0.2), np.ones(reduced.nv))
    names = [row.name for row in reduced.multiplier_rows]
    assert tier_of(reduced) != tier_of(rows)
    assert names == [row.name for row in rows.multiplier_rows]
    assert names == [
        *(f"{name}.multiplier" for name in scene.couplings.dependent),
        f"{joint}_joint_stop.torque",
        f"{joint}_dry_friction.torque",
    ]
    x = reduced.expand(y)
    lam = reduced.evaluate(x).lam
    assert rows.evaluate(x).lam == pytest.approx(lam, rel=1e-8, abs=1e-8)


def test_rows_of_one_name_are_told_apart_over_bounded_and_free_ones(tmp_path):
    """One drive with a limit and one without on the same joint: two columns, two names."""
    motion = "- {type: prescribed_motion, joint: hip_flexion, polynomial: [0.3]%s}\n"
    limited, free = motion % ", limit: 5.0", motion % ""
    for solver in ("plain", "qp"):
        scene, _ = leg([limited, LOOP, free], solver)
        names = [row.name for row in scene.system().multiplier_rows]
        assert names[0] == "hip_flexion_prescribed_motion.torque"
        assert names[-1] == "hip_flexion_prescribed_motion_2.torque"
    assert [row.name for row in scene.closed_loop().constraints.rows] == names
