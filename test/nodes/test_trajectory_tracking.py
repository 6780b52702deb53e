"""A plan in a controller node: the pole of a cart swings up and stays up, over DDS."""

import cart_pole
import numpy as np
import pytest
from nodes.control_client import controlled
from nodes.simulation_client import NAME, simulated
from places import ROOT

from mbd_ros import scene_from
from mbd_ros.files.table import MAIN, Column, Result, Table

SCENE = (ROOT / "config/scenes/cart_pole.yaml").read_text(encoding="utf-8")
SCENE = SCENE.replace("../robots", str(ROOT / "config/robots")) + "dt: 0.004\n"
URDF = ROOT / "config/robots/cart_pole.urdf"


@pytest.fixture
def plan(tmp_path):
    """Written with a tube that no disturbance of this test leaves."""
    times, x, u = cart_pole.swing_up(200, 8)
    names = ("cart.position", "pole.position", "cart.velocity", "pole.velocity")
    columns = [Column(name, values) for name, values in zip(names, x.T, strict=True)]
    table = Table([Column("time", times, "s"), *columns, Column("cart.effort", u)])
    scene = scene_from({"actuators": [{"type": "ideal", "joints": ["cart"]}]}, urdf=URDF)
    result = scene.follow(Result({MAIN: table}), tube=0)
    result.metadata["plan"]["level"] = 0.5
    result.to(tmp_path / "plan.npz")
    return tmp_path / "plan.npz"


def test_a_disturbed_cart_pole_returns_to_its_plan_over_dds(domain, tmp_path, plan):
    """In lock step, so that the machine's pace does not matter; the pole begins 0.1 rad off."""
    (plant := tmp_path / "plant").mkdir()
    (folder := tmp_path / "controller").mkdir()
    given = {"controller": "trajectory_tracking", "gains__plan": str(plan), "safe_ramp": 0.0}
    off = SCENE + "initial: {position: {pole: 0.1}}\n"
    locked = {"lock_step": "true", "publish_clock": "true", "rate": 250.0}
    with simulated(domain, plant, off, **locked) as pole:
        pole.probe.node.destroy_publisher(pole._vectors)
        with controlled(
            domain, folder, SCENE, plant=NAME, use_sim_time="true", error_limit=0.0, **given
        ) as client:
            end = np.array(cart_pole.END[:2])

            def is_up():
                pole.probe.spin_for(0.02)
                return np.abs(np.array(pole.newest.position) - end).max() < 1e-3

            client.probe.spin_until(is_up)
            found = client.wait_health(lambda h: "time of the plan" in h.values)
            assert found.values["time of the plan"] == "2.001 of 2.001 s"
            assert "outside of the tube" not in found.message
