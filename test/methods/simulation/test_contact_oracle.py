"""The oracle of contacts itself: it agrees with coal on shapes, and it sees what is wrong."""

import coal
import numpy as np
import pinocchio as pin
import pytest
from contact_geometry import Placed, touches, turned
from contact_oracle import Oracle, Pair, Side

from mbd_ros.core.state import State

GRAVITY, DT = 9.81, 1e-3
PLANE = Side("world", "half_space", [0.0, 0.0, 1.0])
SHAPES = {
    "sphere": (0.3, coal.Sphere(0.3)),
    "box": ([0.3, 0.5, 0.8], coal.Box(0.3, 0.5, 0.8)),
    "capsule": ({"radius": 0.2, "length": 0.6}, coal.Capsule(0.2, 0.6)),
    "cylinder": ({"radius": 0.3, "length": 0.5}, coal.Cylinder(0.3, 0.5)),
}


@pytest.mark.parametrize(
    ("one", "other"),
    [
        *(("sphere", kind) for kind in SHAPES),
        *(("capsule", kind) for kind in ("box", "capsule", "cylinder")),
        ("box", "box"),
    ],
)
def test_gaps_are_those_of_coal(one, other):
    """Boxes apart from one another are left out: the oracle asks for their depth alone."""
    rng, counted = np.random.default_rng(3), 0
    for _ in range(100):
        placed, poses = [], []
        for kind in (one, other):
            R, p = turned(rng.uniform(-3, 3, 3)), rng.uniform(-0.6, 0.6, 3)
            placed.append(Placed(kind, SHAPES[kind][0], R, p))
            poses += [SHAPES[kind][1], coal.Transform3s(R, p)]
        expected = coal.distance(*poses, coal.DistanceRequest(), coal.DistanceResult())
        if (expected > 0.0) == (one == "box"):
            continue
        found = min(touch.gap for touch in touches(*placed))
        assert found == pytest.approx(expected, abs=2e-5)
        counted += 1
    assert counted > 10


def free_body():
    model = pin.Model()
    inertia = pin.Inertia(2.0, np.zeros(3), np.diag((0.02, 0.03, 0.04)))
    index = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "body")
    model.appendBodyToJoint(index, inertia, pin.SE3.Identity())
    model.addFrame(pin.Frame("body", index, 0, pin.SE3.Identity(), pin.FrameType.BODY))
    return model


def sliding(mu, height=0.1, steps=20):
    """States of a box of 0.2 m that brakes on a plane, its centre at a height."""
    for i in range(steps):
        t = i * DT
        q = np.array((t - 0.5 * mu * GRAVITY * t * t, 0.0, height, 0.0, 0.0, 0.0, 1.0))
        yield State(t, q, np.array((1.0 - mu * GRAVITY * t, 0.0, 0.0, 0.0, 0.0, 0.0)))


def worst(states, mu):
    pairs = [Pair("c", Side("body", "box", [0.4, 0.4, 0.2]), PLANE, mu)]
    return Oracle(free_body(), pairs).worst(list(states))


def test_a_block_that_slides_is_right():
    found = worst(sliding(0.4), 0.4)
    assert found.depth <= 1e-15 and found.gain == 0.0
    assert found.unlike <= 1e-9


def test_too_much_friction_depth_and_hovering_are_seen():
    assert worst(sliding(0.5), 0.4).unlike > 0.05
    assert worst(sliding(0.4, height=0.0999), 0.4).depth == pytest.approx(1e-4)
    assert worst(sliding(0.0, height=0.2), 0.0).unlike > 0.9


def test_friction_that_drives_is_seen():
    assert worst(sliding(-0.2), 0.4).gain > 1e-4
