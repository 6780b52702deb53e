"""Semi-implicit Euler with dampers at the old and at the new velocity."""

import numpy as np
import pytest

from mbd_ros.api import scene_from
from mbd_ros.applications.report.stability.scenes import mechanism, rods
from mbd_ros.errors import DivergedError, SceneError
from mbd_ros.methods.integration.linear_motion import LinearMotion
from mbd_ros.parts.integrators.semi_implicit_euler import SemiImplicitEuler

DT = 1.0e-3
BALL = """<robot name="ball"><link name="world"/><link name="ball"><inertial><mass value="2"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="rail" type="prismatic"><parent link="world"/><child link="ball"/><axis xyz="1 0 0"/>
<limit lower="-9" upper="9" effort="1" velocity="1"/></joint></robot>"""


def positions(a, b, damping, steps):
    """Positions after each step, of a mass of 2 kg with k dt^2/m = a and c dt/m = b."""
    spring = {"type": "joint_spring", "joint": "rail", "stiffness": 2.0 * a / DT**2}
    scene = scene_from(
        {
            "gravity": [0.0, 0.0, 0.0],
            "forces": [{**spring, "damping": 2.0 * b / DT}],
            "integrator": {"type": "semi_implicit_euler", "damping": damping},
            "dt": DT,
            "initial": {"position": {"rail": 1.0}},
        },
        urdf=BALL,
    )
    return np.array([x.q[0] for x in scene.simulation().run(scene.initial, steps * DT)])


@pytest.mark.parametrize("a", [0.5, 2.0, 3.9, 4.1, 6.0])
@pytest.mark.parametrize("b", [0.0, 0.04, 0.3, 1.4, 3.0])
def test_stability_is_that_of_the_textbook(a, b):
    """Reference X04: a + 2 b < 4 with explicit damping, a < 4 + 2 b with implicit damping."""
    motion = LinearMotion(np.array([[-a / DT**2]]), np.array([[-b / DT]]))
    for damping, margin in (("explicit", 4.0 - a - 2.0 * b), ("implicit", 4.0 + 2.0 * b - a)):
        is_stable = margin > 0.0
        growth = SemiImplicitEuler(damping=damping).growth(motion, DT)
        assert (growth <= 1.0 + 1e-9) == is_stable, (damping, growth)
        try:
            with np.errstate(all="ignore"):
                found = np.abs(positions(a, b, damping, 400))
        except DivergedError:
            found = np.array([np.inf])
        assert (found.max() <= 100.0) == is_stable, (damping, found.max())


def test_a_step_is_the_one_written_by_hand():
    """v+ = (v - dt k x/m) / (1 + dt c/m), x+ = x + dt v+; the slope c is a difference quotient."""
    a, b, x, v = 1.3, 0.7, 1.0, 0.0
    by_hand = [x]
    for _ in range(50):
        v = (v - a * x / DT) / (1.0 + b)
        x += DT * v
        by_hand.append(x)
    assert np.abs(positions(a, b, "implicit", 50) - by_hand).max() < 1e-5


def test_dampers_of_internal_states_are_implicit_too():
    """A motor whose friction decays within a hundredth of a step."""
    drive = {"type": "series_elastic_drive", "joint": "j0", "stiffness": 1.0}
    more = {"rotor_inertia": 1e-4, "viscous": 10.0}
    scene = mechanism({"actuators": [{**drive, **more}]}, *rods((3.0,)))().scene
    y = scene.initial._replace(z=np.array([0.0, 1.0]))
    speeds = {}
    for damping in ("implicit", "explicit"):
        entry = {"type": "semi_implicit_euler", "damping": damping}
        run = scene.simulation(integrator=entry, dt=1e-3).run(y, 0.02)
        speeds[damping] = max(abs(x.z[1]) for x in list(run)[1:])
    assert speeds["implicit"] < 0.02 < 1e20 < speeds["explicit"]


def test_an_unknown_damping_is_refused():
    with pytest.raises(SceneError, match="damping: expected one of explicit, implicit"):
        positions(1.0, 0.0, "none", 1)
