"""Columns, topics, arrows and plots of what parts show."""

import numpy as np
import pytest
from rclpy.serialization import deserialize_message
from simulator_plant import plant
from std_msgs.msg import Float64MultiArray
from strap import Strap

import mbd_ros as mbd
from mbd_ros.core.contracts import Load, Output, exerted_on
from mbd_ros.core.kinematics.kinematics import Reads
from mbd_ros.errors import DataError, ModelError
from mbd_ros.files.table import read_result
from mbd_ros.methods.simulation.live_simulation import LiveSimulation
from mbd_ros.methods.simulation.safe_command import CommandWatch
from mbd_ros.scene.schema.code_permission import permitting
from mbd_ros.scene.schema.renamed import renamed

BAR = {"type": "distance", "frame_a": "world", "frame_b": "shank", "distance": 0.7}


def scene(urdf="four_bar_leg", kind=Strap, **sections):
    entries = {"forces": [{"type": kind, "joint": "ankle"}], **sections}
    return mbd.scene_from(entries, urdf=urdf, allow_code=True)


@pytest.fixture(scope="module")
def leg():
    return scene(constraints=[BAR], initial={"position": {"ankle": 0.3}})


@pytest.fixture(scope="module")
def swing(leg):
    return leg.simulate(0.02)


def test_columns_come_from_the_outputs_of_parts(swing):
    table = swing["samples"]
    assert table.column("shank_distance.force").unit == "N"
    assert (table["ankle_strap.stretch"] == table["ankle.position"]).all()
    assert (table["ankle_strap.way_z"] == table["ankle.acceleration"]).all()
    assert (table["ankle_strap.way_y"] == 2.0).all()
    way = table.column("ankle_strap.way_x")
    assert (way.unit, way.frame) == ("m", "world")


def test_inverse_dynamics_shows_the_same(leg, swing):
    found, table = leg.inverse(swing)["samples"], swing["samples"]
    np.testing.assert_allclose(found["ankle_strap.stretch"], table["ankle.position"], atol=1e-9)
    assert (found["ankle_strap.way_z"] == found["ankle.acceleration"]).all()


def test_inverse_dynamics_of_an_open_chain_shows_the_same():
    arm = scene("prosthetic_leg", couplings={"knee": {"parent": "hip_flexion", "factor": 0.5}})
    swing = arm.simulate(0.02)
    found, table = arm.inverse(swing)["samples"], swing["samples"]
    assert found.column("knee.multiplier").unit == "N·m"
    np.testing.assert_allclose(found["ankle_strap.stretch"], table["ankle.position"], atol=1e-9)
    assert (found["ankle_strap.way_z"] == found["ankle.acceleration"]).all()


def test_a_bag_holds_outputs(swing, tmp_path):
    swing.to(tmp_path / "swing.mcap")
    assert read_result(tmp_path / "swing.mcap") == swing


def test_a_plot_draws_outputs(swing):
    labels = [axes.get_ylabel() for axes in swing.plot().axes]
    assert {"stretch\n[rad]", "way\n[m]", "force\n[N]"} <= {*labels}
    (panel,) = swing.plot(columns=["way"]).axes
    curves = [text.get_text() for text in panel.get_legend().get_texts()]
    assert curves == ["ankle_strap x", "ankle_strap y", "ankle_strap z"]


class Pull(Load):
    """Pulls the shank up and shows that as an arrow."""

    reads = Reads.POSITION

    def __init__(self, robot, *, joint: str, somewhere: bool = True):
        self.point, self.zero = robot.point("shank"), np.zeros(robot.model.nv)
        arrow = exerted_on(self.point, self.point)
        self.outputs = (Output("pull", "N"), arrow._replace(at=self.point if somewhere else None))

    def force(self, k, x, u):
        return self.zero

    def show(self, k, x, u, now):
        return 5.0, [0.0, 0.0, 5.0, 0.0, 0.0, 0.0]


def live(scene):
    watch = CommandWatch(0.1, 0.1)
    return LiveSimulation(scene.simulation, scene.initial, 0.01, watch, scene.safe)


def test_a_live_simulation_shows_numbers_and_arrows():
    there = live(scene(kind=Pull, constraints=[BAR]))
    there.tick()
    names = [output.name for output in there.showing.numbers]
    assert names == ["shank_distance.force", "ankle_pull.pull"]
    (tension, pull), arrows = there.now.shown, there.wrenches()
    assert pull == 5.0
    assert [output.name for output in there.showing.arrows] == [
        "shank_distance.on_world",
        "shank_distance.on_shank",
        "ankle_pull.on_shank",
    ]
    assert arrows[2].force.tolist() == [0.0, 0.0, 5.0]
    assert np.linalg.norm(arrows[1].force) == pytest.approx(abs(tension), rel=1e-12)
    np.testing.assert_allclose(arrows[1].point, arrows[2].point, atol=1e-12)


def test_the_simulator_publishes_what_parts_show(tmp_path):
    text = "forces: [{type: 'strap:Strap', joint: ankle}]\ninitial: {position: {ankle: 0.3}}"
    robot = "robot: {urdf: 'package://mbd_ros/config/robots/prosthetic_leg.urdf'}"
    (tmp_path / "scene.yaml").write_text(f"{robot}\n{text}\n", encoding="utf-8")
    with permitting(True):
        there = plant(tmp_path / "scene.yaml", rate=100.0)
    message = deserialize_message(there.outputs(), Float64MultiArray)
    assert [one.label for one in message.layout.dim] == there.shown
    assert there.shown == ["ankle_strap.stretch", *(f"ankle_strap.way_{i}" for i in "xyz")]
    assert message.data[:3].tolist() == [0.3, 1.0, 2.0] and not there.rows


def test_a_wrench_needs_a_place():
    entry = {"type": Pull, "joint": "ankle", "somewhere": False}
    there = mbd.scene_from({"forces": [entry]}, urdf="four_bar_leg", allow_code=True)
    with pytest.raises(ModelError, match="ankle_pull.on_shank: a wrench needs `at`, a point"):
        live(there)


class Short(Strap):
    """Shows one value for two outputs."""

    def show(self, k, x, u, now):
        return (1.0,)


class Wide(Strap):
    """Shows two numbers for a vector."""

    def show(self, k, x, u, now):
        return 1.0, np.zeros(2)


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        (Short, "ankle_short shows 1 values, outputs: 2"),
        (Wide, "ankle_wide.way: shows 2 numbers, a vector has 3"),
    ],
)
def test_a_part_shows_what_it_declares(kind, message):
    with pytest.raises(ModelError, match=message):
        scene(kind=kind).simulate(0.01)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("world-shank.distance.multiplier", "shank_distance.force"),
        ("shank.stop.multiplier", None),
        ("multiplier", None),
    ],
)
def test_an_old_column_is_told_by_its_new_name(swing, old, new):
    called = new or "<part>.<quantity>, such as bar_distance.force,"
    with pytest.raises(DataError, match=f"no column {old}; {old} is called {called} now"):
        swing["samples"].column(old)


@pytest.mark.parametrize(
    ("old", "columns", "new"),
    [
        ("a-b.x.multiplier", ["b_loop_closure.force_x"], "b_loop_closure.force_x"),
        ("a-b.rz.multiplier", ["cuff.torque_z", "cuff.torque_x"], "cuff.torque_z"),
        (
            "b.stop.multiplier",
            ["joint_stop.torque_a", "joint_stop.torque_b"],
            "joint_stop.torque_b",
        ),
        ("a.motion#2.multiplier", ["a_prescribed_motion.force"], "a_prescribed_motion.force"),
        ("a-b.x.multiplier", ["c.force_x", "d.force_x"], "one of c.force_x, d.force_x"),
        (
            "a-b.x.multiplier",
            ["a_frame_anchor.force_x", "d_loop_closure.force_x"],
            "a_frame_anchor.force_x",
        ),
    ],
)
def test_the_new_name_is_found_among_the_columns(old, columns, new):
    assert renamed("column", old, columns) == f"; {old} is called {new} now"
