"""Live simulations of the embedded scenes with contacts are their runs, to the bit."""

import numpy as np
import pytest

import mbd_ros as mbd
from mbd_ros.core.contracts import Kind, Load, Output
from mbd_ros.methods.simulation.live_simulation import LiveSimulation
from mbd_ros.methods.simulation.safe_command import CommandWatch
from mbd_ros.nodes.shell.contact_topics import contact_details, contacts_of

TICKS = 25


@pytest.mark.parametrize("method", ["rk4", "moreau_jean"])
@pytest.mark.parametrize(
    "name",
    ["block_on_incline", "bouncing_ball", "sphere_on_plane", "four_legged_table", "gripper"],
)
def test_ticks_show_what_samples_do(name, method):
    """Positions, velocities, multipliers, and all that contacts show, with fixed steps."""
    scene = mbd.load_scene(name).with_(integrator={"type": method})
    table = scene.simulate(TICKS * scene.dt)["samples"]
    watch = CommandWatch(1e6, 1e6)
    live = LiveSimulation(scene.simulation, scene.initial, scene.dt, watch, scene.safe)
    names, joints = [one.name for one in live.showing.numbers], scene.robot.joints
    assert any(column.endswith(".centre_of_pressure_z") for column in names)
    for k in range(1, TICKS + 1):
        now = live.tick()
        assert now.shown.tolist() == [table[column][k] for column in names]
        assert now.position.tolist() == [table[f"{joint.name}.position"][k] for joint in joints]
        assert now.velocity.tolist() == [table[f"{joint.name}.velocity"][k] for joint in joints]
        for base, pose in zip(scene.robot.bases, now.poses, strict=True):
            assert pose[:3].tolist() == [table[f"{base.name}.position.{i}"][k] for i in "xyz"]


class Cone(Load):
    """A part of somebody else that shows a friction cone, and is no contact."""

    outputs = (Output("reach", "N", Kind.FRICTION_CONE),)

    def __init__(self, robot, *, joint: str):
        self.nv = robot.model.nv

    def force(self, k, x, u):
        return np.zeros(self.nv)

    def show(self, k, x, u, now):
        return (np.ones(7),)


def test_a_cone_alone_is_no_contact():
    entry = {"type": Cone, "joint": "ankle"}
    scene = mbd.scene_from({"forces": [entry]}, urdf="prosthetic_leg", allow_code=True)
    watch = CommandWatch(1e6, 1e6)
    live = LiveSimulation(scene.simulation, scene.initial, 0.01, watch, scene.safe)
    assert live.showing.cones == ("ankle_cone.reach",)
    assert live.cones()[0].mu == 1.0
    assert not contacts_of(live.showing) and not contact_details(live)


def test_diagnostics_name_contacts_and_residuals():
    scene = mbd.load_scene("four_legged_table").with_(integrator={"type": "moreau_jean"})
    watch = CommandWatch(1e6, 1e6)
    live = LiveSimulation(scene.simulation, scene.initial, scene.dt, watch, scene.safe)
    live.tick()
    (contact,) = contacts_of(live.showing)
    details = contact_details(live)
    assert details["contacts"].startswith(f"{contact} stick, gap ")
    assert details["smallest gap"].endswith(f" m, {contact}")
    residuals = details["contact residuals"].split(", ")
    assert details["worst contact residual"] == residuals[0]
    assert {one.split()[0] for one in residuals} == {"primal", "dual", "cone", "correction"}
    assert all(float(one.split()[1]) <= 1e-8 for one in residuals)
    fresh = contact_details(live)["contact residuals"]  # since the last report
    assert all(float(one.split()[1]) == 0.0 for one in fresh.split(", "))


def test_what_stands_still_is_no_step_too_long():
    """Velocities of a table at rest are rounding, however much they change."""
    remarks = mbd.load_scene("four_legged_table").simulate(0.4).metadata["remarks"]
    assert not [text for text in remarks if "warning" in text]
