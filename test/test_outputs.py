"""Columns, topics, arrows and plots of what parts show."""

import numpy as np
import pytest

import mbd_ros as mbd
from mbd_ros.core.outputs import Kind, Output
from mbd_ros.core.parts import Load
from mbd_ros.errors import DataError, ModelError
from mbd_ros.files.formats import read_result
from mbd_ros.scene.renamed import renamed

BAR = {"type": "distance", "frame_a": "world", "frame_b": "shank", "distance": 0.7}


class Strap(Load):
    """A spring at a joint that shows its stretch and a direction."""

    outputs = (Output("stretch", "rad"), Output("way", "m", Kind.VECTOR, "world"))

    def __init__(self, robot, *, joint: str):
        self.joint, self.nv = robot.joint(joint), robot.model.nv

    def force(self, k, x, u):
        tau = np.zeros(self.nv)
        tau[self.joint.v] = -2.0 * x.q[self.joint.q]
        return tau

    def show(self, k, x, u, now):
        return x.q[self.joint.q], np.array([1.0, 2.0, now.a[self.joint.v]])


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


def test_a_bag_holds_outputs(swing, tmp_path):
    swing.to(tmp_path / "swing.mcap")
    assert read_result(tmp_path / "swing.mcap") == swing


def test_a_plot_draws_outputs(swing):
    labels = [axes.get_ylabel() for axes in swing.plot().axes]
    assert {"stretch\n[rad]", "way\n[m]", "force\n[N]"} <= {*labels}
    (panel,) = swing.plot(columns=["way"]).axes
    curves = [text.get_text() for text in panel.get_legend().get_texts()]
    assert curves == ["ankle_strap x", "ankle_strap y", "ankle_strap z"]


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
