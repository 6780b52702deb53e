"""Force parts against their closed forms and by what they do to energy."""

import math
from pathlib import Path

import numpy as np
import pytest

from mbd_ros.core.couplings import Coupling, Couplings
from mbd_ros.core.inverse_dynamics import InverseDynamics
from mbd_ros.core.laws import Polynomial
from mbd_ros.core.robot_reader import read_robot
from mbd_ros.core.state import State
from mbd_ros.errors import ModelError
from mbd_ros.forces.joint_friction import JointFriction
from mbd_ros.forces.joint_spring import JointSpring

LEG = (Path(__file__).parents[1] / "config/robots/prosthetic_leg.urdf").read_text(encoding="utf-8")
ROBOT = read_robot(LEG)


def force(part, q=0.0, v=0.0, joint="ankle"):
    """Force of a part with one joint away from rest; all other joints must stay free of it."""
    x, index = State(0.0, np.zeros(5), np.zeros(5)), ROBOT.joint(joint).v
    x.q[index], x.v[index] = q, v
    tau = part.force(None, x)
    assert not np.delete(tau, index).any()
    return tau[index]


@pytest.mark.parametrize(
    ("q", "v", "expected"), [(0.1, 0.0, 0.0), (0.3, 0.0, -6.0), (0.0, 0.0, 3.0), (0.1, 2.0, -1.0)]
)
def test_spring_pulls_back_to_rest_and_damps(q, v, expected):
    spring = JointSpring(ROBOT, joint="ankle", stiffness=30.0, rest=0.1, damping=0.5)
    assert force(spring, q, v) == pytest.approx(expected, abs=1e-12)


def test_spring_is_the_slope_of_its_energy():
    spring, h = JointSpring(ROBOT, joint="knee", stiffness=12.0, rest=-0.2), 1e-4

    def energy(q):
        return 0.5 * 12.0 * (q + 0.2) ** 2

    for q in (-1.0, -0.2, 0.7):
        slope = (energy(q + h) - energy(q - h)) / (2 * h)
        assert force(spring, q, joint="knee") == pytest.approx(-slope, abs=1e-8)


def test_friction_opposes_motion_saturates_and_vanishes_at_rest():
    friction = JointFriction(ROBOT, joint="ankle", coulomb=0.4, viscous=0.05, smoothing=0.01)
    assert force(friction) == 0.0
    assert force(friction, v=0.01) == pytest.approx(-0.4 * math.tanh(1) - 0.0005)
    assert 0.4 * math.tanh(1) == pytest.approx(0.76 * 0.4, abs=1e-3)
    for v in (-3.0, 3.0):
        assert force(friction, v=v) == pytest.approx(-math.copysign(0.4, v) - 0.05 * v)
    assert all(force(friction, v=v) * v < 0 for v in (-1.0, -1e-6, 1e-6, 50.0))


def test_force_on_a_dependent_joint_reaches_its_parent_through_the_slope():
    """knee_slide_x = 0.01 knee: 100 N on the slide is 1 N·m about the knee."""
    couplings = Couplings(ROBOT, {"knee_slide_x": Coupling("knee", Polynomial([0.0, 0.01]))})
    spring = JointSpring(ROBOT, joint="knee_slide_x", stiffness=1e4, rest=0.01)
    zero = np.zeros(4)
    free, sprung = (
        InverseDynamics(ROBOT, couplings, forces=forces).solve(zero, zero, zero)
        for forces in ((), (spring,))
    )
    knee = couplings.independent.index("knee")
    assert sprung.tau - free.tau == pytest.approx(-1.0 * np.eye(4)[knee], abs=1e-12)
    assert sprung.multipliers - free.multipliers == pytest.approx([-100.0], abs=1e-10)


@pytest.mark.parametrize(
    ("part", "values", "message"),
    [
        (JointSpring, {"stiffness": -1.0}, "stiffness -1 and damping 0 must be >= 0"),
        (JointSpring, {"stiffness": 1.0, "damping": -2.0}, "damping -2 must be >= 0"),
        (JointFriction, {"coulomb": -1.0}, "coulomb -1 and viscous 0 must be >= 0"),
        (JointFriction, {"viscous": -1.0}, "viscous -1 must be >= 0"),
        (JointFriction, {"smoothing": 0.0}, "smoothing 0 > 0"),
        (JointSpring, {"stiffness": 1.0, "joint": "nose"}, "no joint 'nose'; the robot has hip"),
        (JointSpring, {"stiffness": 1.0, "joint": "socket_fix"}, "joint 'socket_fix' is fixed"),
    ],
)
def test_values_that_make_no_sense_are_refused(part, values, message):
    with pytest.raises(ModelError) as caught:
        part(ROBOT, **{"joint": "ankle", **values})
    assert message in str(caught.value)
