"""Impacts of one to four contacts with friction: balance, energy, cones, direction of friction."""

from typing import NamedTuple

import numpy as np
import pinocchio as pin
import pytest
from cone_contact import FRICTIONS, touch_down
from velocity_level import consistent, inertia, keeps, robot_of, system_of

import mbd_ros as mbd
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.nonsmooth.impact_map import Impact, ImpactMap
from mbd_ros.core.state import State
from mbd_ros.parts.constraints.joint_stop import JointStop

LINKS = {
    "arm": ("link3", "link5", "flange"),
    "coupled": ("link3", "link5", "flange"),
    "free": ("left", "right"),
    "loop": ("coupler_link",),
}


class Struck(NamedTuple):
    """An impact: J of all rows, mass matrix, velocity before, contacts, bilateral rows, answer."""

    J: np.ndarray
    M: np.ndarray
    v: np.ndarray
    cones: tuple
    hold: np.ndarray
    e: list
    found: Impact


def contacts_of(robot, kind, rng, elastic):
    for _ in range(int(rng.integers(1, 5))):
        normal = rng.normal(size=3)
        if kind == "loop":
            normal[2] = 0.0
        friction, e = float(rng.choice(FRICTIONS[:-1])), float(rng.uniform()) if elastic else 0.0
        tip, link = 0.2 * rng.normal(size=3), rng.choice(LINKS[kind])
        yield touch_down(robot, link, normal, tip, friction=friction, restitution=e)


def impacts(count, seed):
    """Random impacts of robots of all kinds; every third is without restitution."""
    rng = np.random.default_rng(seed)
    for i in range(count):
        kind = tuple(LINKS)[i % 4]
        robot, coupled, parts = robot_of(kind)
        parts = [*parts, *contacts_of(robot, kind, rng, i % 3)]
        if i % 5 == 0 and kind != "loop":
            parts.append(JointStop(robot, joint=robot.joints[-1].name, lower=-9.0, upper=9.0))
        system = system_of(robot, parts, coupled)
        level, hold, layout = ImpactMap(system), keeps(system), system.layout
        first = len(layout.rows) - sum(len(block.rows) for block in layout.yielding)
        for _ in range(4):
            q = pin.integrate(robot.model, robot.neutral(), rng.uniform(-1, 1, robot.model.nv))
            M, held = inertia(robot, q), hold(q)
            v = consistent(M, held, rng.normal(size=robot.model.nv))
            found = level.impact(State(0.0, q, v), list(range(first, len(layout.rows))))
            J, e = rows_at(system, q, v), [cone.e for cone in layout.cones]
            yield Struck(J, M, v, layout.cones, held, e, found)


def rows_at(system, q, v):
    """J of all rows, in the order of their multipliers."""
    k, x = Kinematics(system.robot), State(0.0, q, v)
    k.refresh(x.q, x.v)
    return np.concatenate([block.part.jacobian(k, x) for block in system.layout.blocks])


def check_impacts(count, seed):
    """How many contacts pushed, and how many impacts gave back less than they should."""
    pushed = limited = 0
    for J, M, v, cones, hold, e, found in impacts(count, seed):
        p, after = found.p, found.v
        size = np.abs(M @ v).max() + (np.abs(J).T @ np.abs(p)).max()
        assert M @ (after - v) == pytest.approx(J.T @ p, abs=1e-12 * size)
        assert np.abs(hold @ after).max(initial=0.0) <= 1e-9
        assert after @ M @ after - v @ M @ v <= 1e-12 * (v @ M @ v)
        for cone in cones:
            own, push = J[cone.slots], p[cone.slots]
            fast = np.abs(own).sum(axis=1).max() * max(np.abs(v).max(), np.abs(after).max())
            w, normal, friction = own @ after, push[0], np.linalg.norm(push[1:])
            assert normal >= 0.0 and w[0] >= -1e-9 * fast
            assert friction <= cone.mu * normal * (1.0 + 1e-9)
            slip = np.linalg.norm(w[1:])
            if not any(e) and slip > 1e-6 * fast and cone.mu * normal > 1e-6 * size:
                assert w[0] <= 1e-9 * fast
                assert push[1:] / (cone.mu * normal) == pytest.approx(-w[1:] / slip, abs=1e-7)
            pushed += bool(normal > 0.0)
        limited += found.share < 1.0
        assert any(e) or found.share == 1.0
    return pushed, limited


def test_impacts_with_friction_gain_no_energy_and_keep_their_balance():
    """Arms, couplings, a free body and a loop, each with a restitution and friction of its own."""
    pushed, _ = check_impacts(60, 7)
    assert pushed >= 200


@pytest.mark.soak
def test_ten_thousand_impacts_with_friction_gain_no_energy():
    pushed, limited = check_impacts(2500, 9)
    assert pushed >= 8000 and 0 < limited <= 100


def test_events_say_how_much_restitution_was_given_back(monkeypatch):
    """An impact of which a third was given back is a row of the table that says so."""
    scene = mbd.load_scene("bouncing_ball")
    whole = ImpactMap.impact
    monkeypatch.setattr(
        ImpactMap, "impact", lambda *args, **more: whole(*args, **more)._replace(share=1 / 3)
    )
    events = scene.simulate(0.6)["events"]
    assert set(events["contacts.restitution_share"]) == {1 / 3}
