"""A coupled robot on a free base: its independent coordinates are a pose and numbers."""

import numpy as np
import pinocchio as pin
import pytest

from mbd_ros.core.dynamics.tiers import build_system
from mbd_ros.core.loads.loads import Loads
from mbd_ros.core.model.coupling_functions import Linear
from mbd_ros.core.model.couplings import Coupling, Couplings
from mbd_ros.core.model.robot_reader import read_robot
from mbd_ros.core.state import State
from mbd_ros.methods.integration.linear_motion import linear_motion

BODY = (
    "<robot name='r'>"
    + "".join(
        f"<link name='{link}'><inertial><mass value='1'/><inertia ixx='.02' iyy='.02' izz='.01' "
        "ixy='0' ixz='0' iyz='0'/></inertial></link>"
        for link in ("trunk", "upper", "fore")
    )
    + "".join(
        f"<joint name='{name}' type='continuous'><parent link='{parent}'/><child link='{child}'/>"
        "<origin xyz='0 0 0.3'/><axis xyz='0 1 0'/></joint>"
        for name, parent, child in (("shoulder", "trunk", "upper"), ("elbow", "upper", "fore"))
    )
    + "</robot>"
)


def test_independent_coordinates_are_integrated_as_all_joints_are():
    """It was refused by Pinocchio: eight coordinates for a model of nine."""
    robot = read_robot(BODY, base="floating")
    couplings = Couplings(robot, {"elbow": Coupling("shoulder", Linear(0.5, 0.1))})
    system = build_system(robot, couplings, (), Loads(robot.model.nv))
    rng = np.random.default_rng(0)
    q = pin.integrate(robot.model, pin.neutral(robot.model), rng.normal(size=8))
    dq = rng.normal(size=system.nv)
    x = system.reduce(State(0.0, q, np.zeros(8)))
    moved = system.chart.integrate(x.q, dq)
    full = pin.integrate(robot.model, q, np.append(dq, 0.5 * dq[-1]))
    assert moved == pytest.approx(system.reduce(State(0.0, full, np.zeros(8))).q, abs=1e-14)
    assert system.chart.difference(x.q, moved) == pytest.approx(dq, abs=1e-12)
    assert np.isfinite(linear_motion(system, x).rate)
