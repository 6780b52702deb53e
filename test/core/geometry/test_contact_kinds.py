"""Contacts of robots of many kinds, from event to event: the laws hold in every sample."""

import pickle

import numpy as np
import pytest
from mechanisms import floating_body, four_bar, four_bar_closure, joint, link, scene_of, urdf

from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.state import is_same

FINGERS = urdf(
    *(link("world"), link("a", 1.0, (0, 0, 0), (0.1, 0.1, 0.1))),
    link("b", 1.0, (0.2, 0, -0.3), (0.02, 0.02, 0.01)),
    link("c", 0.5, (0.0, 0, -0.2), (0.02, 0.02, 0.01)),
    joint("slide", "prismatic", "world", "a"),
    joint("j1", "revolute", "a", "b", (0, 1, 0)),
    joint("j2", "revolute", "b", "c", (0, 1, 0), (0.3, 0, -0.4)),
)
CLOSURE = str({"type": "loop_closure", "kind": "point", **four_bar_closure()}).replace("'", "")


def rigid(frame, points, plane, friction=0.4, restitution=0.1):
    return (
        f"{{type: rigid, between: [{{frame: {frame}, points: {points}}}, {plane}], "
        f"friction: {friction}, restitution: {restitution}}}"
    )


def ground(height):
    return f"{{half_space: [0, 0, 1], xyz: [0, 0, {height}]}}"


def box(scale=1.0, mass=1.0, away=0.0):
    """A box that is thrown on its four lower corners."""
    corners = [[a * 0.3 * scale, b * 0.2 * scale, -0.1 * scale] for a in (1, -1) for b in (1, -1)]
    speed = np.sqrt(scale)
    return (
        f"bodies: {{b: {{shape: {{box: [{0.6 * scale}, {0.4 * scale}, {0.2 * scale}]}}, "
        f"mass: {mass}}}}}\ninitial: {{pose: {{b: {{xyz: [{away}, {away}, {0.2 * scale}], "
        f"rpy: [0.1, 0.2, 0.3]}}}}, twist: {{b: {{linear: [{speed}, 0, 0]}}}}}}\n"
        f"contacts: [{rigid('b', corners, ground(0.0))}]\ndt: {0.004 * speed}\n"
    )


SCENES = {
    "coupled": (
        "couplings: {j2: {parent: j1, factor: -1.5}}\ninitial: {position: {j1: 0.3}}\n"
        f"contacts: [{rigid('c', '[[0, 0, -0.4], [0.1, 0, -0.4]]', ground(-1.2))}]\ndt: 0.01\n",
        FINGERS,
        0.5,
    ),
    "loop": (
        f"constraints: [{CLOSURE}]\ngravity: [0, -9.81, 0]\n"
        "initial: {position: {crank: 1.2, coupler: -0.9, rocker: 1.7}}\ncontacts: ["
        + rigid("coupler_link", "[[1, 0, 0.1]]", "{half_space: [0, 1, 0], xyz: [0, 0.9, 0]}")
        + "]\ndt: 0.005\n",
        four_bar(),
        0.9,
    ),
    "floating": (
        "robot: {base: floating}\ndt: 0.004\ncontacts: ["
        + rigid("left", "[[0, 0.1, -0.6]]", ground(-0.9))
        + ", "
        + rigid("right", "[[0.1, 0, -0.4]]", ground(-0.9))
        + "]\n",
        floating_body(),
        0.34,
    ),
    "small": (box(1e-3, 1e-6), None, 0.012),
    "heavy": (box(1.0, 1e6), None, 0.15),
    "far": (box(away=100.0), None, 0.15),
}


def laws(simulation, scene, x):
    """Gap, push, excess over the cone, and friction not against the slip, by their own scales."""
    k, now = Kinematics(scene.robot), simulation.system.evaluate(x)
    k.refresh(x.q, x.v)
    for block in simulation.system.layout.blocks:
        if not block.cones():
            continue
        lam, mu = now.lam[block.slots].reshape(-1, 3), block.law.mu
        gap = block.part.residual(k, x)[::3]
        slip = (block.part.jacobian(k, x) @ x.v).reshape(-1, 3)[:, 1:]
        most, fast = np.abs(now.lam).max() + 1e-300, np.linalg.norm(slip, axis=1)
        friction = np.linalg.norm(lam[:, 1:], axis=1)
        assert gap.min() >= -1e-9 * (1.0 + np.abs(x.q).max())
        assert lam[:, 0].min() >= -1e-9 * most
        assert (friction - mu * lam[:, 0]).max() <= 1e-9 * most
        slips = (lam[:, 0] > 1e-6 * most) & (fast > 1e-6)
        against = -mu * lam[slips, :1] * slip[slips] / fast[slips, None]
        assert lam[slips, 1:] == pytest.approx(against, abs=1e-7 * most)
    return now.lam


@pytest.mark.parametrize("kind", SCENES)
def test_the_laws_of_contact_hold_and_no_energy_is_gained(kind):
    text, robot, duration = SCENES[kind]
    scene = scene_of(text + "integrator: {type: dop853}\n", robot)
    simulation, energy, touched = scene.simulation(), [], 0
    for x in simulation.run(scene.initial, duration):
        touched += bool(laws(simulation, scene, x).any())
        energy.append(simulation.system.energy(simulation.system.reduce(x)))
    assert touched and any(event.impulse.any() for event in simulation.events)
    assert np.diff(energy).max() <= 1e-6 * np.ptp(energy)


def test_two_runs_and_checkpoints_through_events_have_the_same_bits():
    scene = scene_of(box() + "integrator: {type: rk4}\n")
    made, states, kept = scene.simulation(), [], []
    for x in made.run(scene.initial, 0.14):
        kept.append(pickle.dumps(made.checkpoint()))
        states.append(x)
    assert sum(event.impulse.any() for event in made.events) >= 2
    assert len({x.mode for x in states}) >= 4
    again = scene.simulation()
    assert all(is_same(a, b) for a, b in zip(states, again.run(scene.initial, 0.14), strict=True))
    for start in (len(states) // 3, len(states) // 2):
        other = scene.simulation()
        rest = list(other.run(pickle.loads(kept[start]), 0.14))
        assert all(is_same(a, b) for a, b in zip(states[start + 1 :], rest, strict=True))
        assert [event.t for event in other.events] == [event.t for event in made.events]
