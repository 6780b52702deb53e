"""Many contacts with friction from event to event, against closed forms."""

import numpy as np
import pytest
from mechanisms import link, scene_of, urdf
from test_point_contact import block

from mbd_ros.core.state import State

GRAVITY = 9.81


def box_on_an_incline(degrees, mu, *, mass=2.0, half=(0.2, 0.15, 0.1), method="dopri5", dt=0.1):
    """Scene of a free box on its four lower corners, and axes uphill, across and out of it."""
    s, c = np.sin(np.radians(degrees)), np.cos(np.radians(degrees))
    a, b, h = half
    feet = [[x, y, -h] for x, y in ((a, b), (-a, b), (-a, -b), (a, -b))]
    moments = tuple(mass / 3.0 * n for n in (b * b + h * h, a * a + h * h, a * a + b * b))
    plane = {"half_space": [float(-s), 0.0, float(c)]}
    between = [{"frame": "box", "points": feet}, plane]
    contact = {"type": "rigid", "between": between, "friction": mu}
    text = str(contact).replace("'", "")
    text = (
        f"robot: {{base: floating}}\ncontacts: [{text}]\ndt: {dt}\nintegrator: {{type: {method}}}"
    )
    scene = scene_of(text + "\n", urdf(link("box", mass, moments=moments)))
    return scene, np.array(((c, 0.0, s), (0.0, 1.0, 0.0), (-s, 0.0, c)))


def lying(axes, degrees, height, velocity):
    """State of a box on its plane; velocities stand in axes of the body."""
    half = -np.radians(degrees) / 2.0
    turn = (0.0, np.sin(half), 0.0, np.cos(half))
    return State(0.0, np.array((*(height * axes[2]), *turn)), np.array((*velocity, 0, 0, 0.0)))


@pytest.mark.parametrize("method", ["dopri5", "dop853", "rk4", "gauss_legendre"])
@pytest.mark.parametrize(
    ("degrees", "mu", "v"),
    [(15, 0.3, 0.0), (30, 0.3, 0.0), (20, 0.5, 3.0), (30, 0.3, 3.0), (15, 0.3, -0.5)],
)
def test_a_box_on_four_corners_slips_stops_and_sticks_as_in_closed_form(degrees, mu, v, method):
    """All corners stop at once; the forces that they share have no solution of their own."""
    scene, axes = box_on_an_incline(degrees, mu, method=method)
    simulation = scene.simulation()
    states = list(simulation.run(lying(axes, degrees, 0.1, (v, 0.0, 0.0)), 2.0))
    t, q = np.array([x.t for x in states]), np.array([axes @ x.q[:3] for x in states])
    assert q[:, 0] == pytest.approx(block(t, degrees, mu, v), abs=1e-10)
    assert np.abs(q[:, 1:] - (0.0, 0.1)).max() <= 1e-12
    assert np.abs(states[-1].q[3:] - states[0].q[3:]).max() <= 1e-10
