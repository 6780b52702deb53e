"""`mbd-ros predict` on mechanisms whose best motions are known."""

import math

import numpy as np
import pytest

import mbd_ros as mbd
from mbd_ros.cli import main
from mbd_ros.errors import OK
from mbd_ros.files.formats import read_result


def link(name, m, com="0 0 0", inertia=0.0):
    moments = " ".join(f"i{axis}='{inertia}'" for axis in ("xx", "yy", "zz"))
    return (
        f"<link name='{name}'><inertial><origin xyz='{com}'/><mass value='{m}'/>"
        f"<inertia {moments} ixy='0' ixz='0' iyz='0'/></inertial></link>"
    )


def joint(name, kind, parent, child, axis, origin="0 0 0"):
    return (
        f"<joint name='{name}' type='{kind}'><parent link='{parent}'/><child link='{child}'/>"
        f"<origin xyz='{origin}'/><axis xyz='{axis}'/>"
        "<limit lower='-100' upper='100' effort='1000' velocity='1000'/></joint>"
    )


def urdf(*parts):
    return f"<robot name='r'><link name='ground'/>{''.join(parts)}</robot>"


def drives(*joints, limit=math.inf):
    entry = {"type": "ideal", "joints": list(joints)}
    return [entry | ({"limit": limit} if limit < math.inf else {})]


def cart_pole():
    """Kelly's: a cart of 1 kg and a pendulum of 0.3 kg at 0.5 m, which hangs at 0."""
    robot = urdf(
        link("cart", 1.0),
        link("pole", 0.3, "0 0 -0.5"),
        joint("slide", "prismatic", "ground", "cart", "1 0 0"),
        joint("swing", "continuous", "cart", "pole", "0 -1 0"),
    )
    return mbd.scene_from({"actuators": drives("slide", limit=20.0)}, urdf=robot)


SWING_UP = {
    "duration": 2.0,
    "bounds": {"slide.position": [-2.0, 2.0]},
    "end": {"slide.position": 1.0, "swing.position": math.pi, "*.velocity": 0.0},
    "goals": [{"type": "effort"}],
}
PUBLISHED = 58.80766745817  # M. Kelly, SIAM Review 59, 2017, sec. 6; digits by two other methods


@pytest.mark.parametrize("scheme", ["gauss", "radau", "hermite_simpson"])
def test_the_cart_pole_swings_up(scheme):
    """The published minimum, from the published guess, on meshes that it chooses by itself."""
    tolerance = 1.0e-4 if scheme == "hermite_simpson" else 1.0e-7
    mesh = {"scheme": scheme, "intervals": 10}
    result = cart_pole().predict(SWING_UP | {"mesh": mesh, "tolerance": tolerance})
    accepted = 1.0e-4 if scheme == "hermite_simpson" else 1.0e-8
    assert result.metadata["cost"] == pytest.approx(PUBLISHED, rel=accepted)
    assert result.metadata["replay"] < 10.0 * tolerance
    peak = np.abs(result["samples"]["slide.effort"]).max()
    assert peak == pytest.approx(13.9839012, rel=1.0e-3)


def test_a_motion_is_written_and_read_again(tmp_path, capsys):
    """From files, as the command line takes them."""
    task = tmp_path / "task.yaml"
    task.write_text(
        "predict: {duration: 1.0, end: {shoulder_flexion.position: 0.8, '*.velocity': 0.0},\n"
        "  goals: [{type: effort}], tolerance: 1.0e-5}\n"
    )
    out = tmp_path / "motion.npz"
    assert main(["predict", "prosthetic_arm", str(task), "-o", str(out)]) == OK
    assert "integrated again" in capsys.readouterr().out
    result = read_result(out)
    assert result.metadata["converged"] is True
    assert result["samples"]["shoulder_flexion.position"][-1] == pytest.approx(0.8, abs=1e-9)
