"""The Moreau-Jean time step on one page, and the steps of the integrator that do more."""

import numpy as np
import pytest
from mechanisms import double_pendulum, joint, link, scene_of, urdf

from mbd_ros.core.dynamics.mechanism import Mechanism
from mbd_ros.core.nonsmooth.implicit_loads import ImplicitLoads
from mbd_ros.core.nonsmooth.time_step import time_step
from mbd_ros.core.rows.constraint_rows import ConstraintRows
from mbd_ros.core.state import State

ROUNDING = 1.0e-12
SLIDER = urdf(
    link("world"), link("box", 2.0), joint("slide", "prismatic", "world", "box", (1, 0, 0))
)
RAILS = urdf(
    *(link("world"), link("cart"), link("bob", 1.0)),
    joint("x", "prismatic", "world", "cart", (1, 0, 0)),
    joint("z", "prismatic", "cart", "bob", (0, 0, 1)),
)
POINT = urdf(
    *(link("world"), link("a"), link("b"), link("bob", 2.5)),
    joint("x", "prismatic", "world", "a", (1, 0, 0)),
    joint("y", "prismatic", "a", "b", (0, 1, 0)),
    joint("z", "prismatic", "b", "bob", (0, 0, 1)),
)
SPRUNG = "forces: [{type: joint_spring, joint: joint_2, stiffness: 3.0e4, damping: 40.0}]"
BAR = "constraints: [{type: distance, frame_a: world, frame_b: bob, distance: 1.0}]"
FRICTION = "constraints: [{type: dry_friction, joint: slide, limit: 5.0}]"
STOP = "constraints: [{type: joint_stop, joint: slide, upper: 0.1}]"
PUSHED = (
    "forces: [{type: prescribed_torque, joints: [slide], times: [-1, 9], torque: [[%g], [%g]]}]"
)
SLOPE = (
    "contacts: [{type: rigid, between: [{frame: bob, sphere: 0.1}, "
    "{half_space: [%g, 0.0, 1.0]}], friction: 0.3}]"
)
SCENES = {
    "a stiff spring": (SPRUNG, double_pendulum(), [0.3, 0.5], [2.0, -1.0], (0.5, 0.7, 1.0)),
    "a bar": (BAR, RAILS, [0.6, -0.8], [0.8, 0.6], (0.5, 1.0)),
    "friction that slides": (FRICTION, SLIDER, [0.0], [1.0], (0.5, 1.0)),
    "friction that holds": (f"{FRICTION}\n{PUSHED % (3, 3)}", SLIDER, [0.0], [0.0], (0.5, 1.0)),
    "a stop that is pushed": (f"{STOP}\n{PUSHED % (7, 7)}", SLIDER, [0.1], [0.0], (0.5, 1.0)),
    "a stop that is left": (f"{STOP}\n{PUSHED % (-7, -7)}", SLIDER, [0.1], [0.0], (0.5, 1.0)),
    "a contact that sticks": (SLOPE % 0.2, POINT, None, [0.0, 0.0, 0.0], (0.5, 1.0)),
    "a contact that slides": (SLOPE % 0.6, POINT, None, [-1.0, 0.2, 0.6], (1.0,)),
}
CASES = [(name, theta) for name, (*_, thetas) in SCENES.items() for theta in thetas]


def slope_start(scene):
    """The centre of a sphere of 0.1 m on the slope."""
    x, _, z = scene
    return 0.1 * np.array([x, 0.0, z]) / np.hypot(x, z)


@pytest.mark.parametrize(("name", "theta"), CASES)
def test_the_integrator_takes_the_step(name, theta):
    text, description, q, v, _ = SCENES[name]
    if q is None:
        q = slope_start((0.6 if "slides" in name else 0.2, 0.0, 1.0))
    scene = scene_of(f"integrator: {{type: moreau_jean, theta: {theta}}}\n{text}", description)
    h = 0.01
    simulation = scene.simulation(dt=h)
    system, stepper = simulation.system, simulation.stepper
    x = simulation.start(State(0.0, np.array(q, dtype=float), np.array(v, dtype=float)))
    mechanism = Mechanism(system.robot, system.loads)
    loads = ImplicitLoads(mechanism, system.internals)
    rows = ConstraintRows(system.layout.blocks, system.model.nv)
    for _ in range(3):
        expected = time_step(mechanism, loads, rows, x, None, h, theta)
        after = stepper.step(x, None, x.t + h)
        size = 1.0 + np.abs(expected.v).max()
        assert np.abs(after.v - expected.v).max() <= ROUNDING * size
        assert np.abs(after.q - expected.q).max() <= ROUNDING * size
        x = after
    if "holds" in name or "sticks" in name or "pushed" in name:
        assert np.abs(x.v).max() <= 1e-12
