"""Joints, constraints and odd files of OpenSim: closed forms, and errors that name the element."""

import numpy as np
import pinocchio as pin
import pytest
from osim_models import (
    COUPLERS,
    SIMM,
    SPLINE,
    Q,
    X,
    Y,
    Z,
    axis,
    body,
    chain,
    coordinate,
    frame,
    joint,
    linear,
    loaded,
    model,
    placed,
    same,
    turn,
)

from mbd_ros.api import scene_from
from mbd_ros.core.model.coupling_functions import simm_spline
from mbd_ros.scene.models.urdf_text import roll_pitch_yaw

KINDS = {
    "WeldJoint": (np.eye(3), (0, 0, 0)),
    "PinJoint": (turn(Z, Q[0]), (0, 0, 0)),
    "SliderJoint": (np.eye(3), (Q[0], 0, 0)),
    "UniversalJoint": (turn(X, Q[0]) @ turn(Y, Q[1]), (0, 0, 0)),
    "PlanarJoint": (turn(Z, Q[0]), (Q[1], Q[2], 0)),
    "GimbalJoint": (turn(X, Q[0]) @ turn(Y, Q[1]) @ turn(Z, Q[2]), (0, 0, 0)),
    "BallJoint": (turn(X, Q[0]) @ turn(Y, Q[1]) @ turn(Z, Q[2]), (0, 0, 0)),
    "FreeJoint": (turn(X, Q[0]) @ turn(Y, Q[1]) @ turn(Z, Q[2]), Q[3:]),
}
COUNTS = {"WeldJoint": 0, "PinJoint": 1, "SliderJoint": 1, "UniversalJoint": 2, "FreeJoint": 6}


@pytest.mark.parametrize("kind", KINDS)
def test_joints_move_as_opensim_says(kind, tmp_path):
    """Between frames that are moved and turned on both bodies; coordinates keep their names."""
    names = [f"c{i}" for i in range(COUNTS.get(kind, 3))]
    frames = frame("here", "ground", "1 2 3", "0.1 0.2 0.3") + frame(
        "there", "a", "0 0.4 0", "0 0 1"
    )
    given = "".join(map(coordinate, names))
    text = model([body("a")], [joint(kind, "j", "here", "there", given, frames=frames)])
    scene = loaded(text, tmp_path)
    assert sorted(scene.couplings.independent) == names
    rotation, translation = KINDS[kind]
    first = pin.SE3(turn(X, 0.1) @ turn(Y, 0.2) @ turn(Z, 0.3), np.array([1.0, 2.0, 3.0]))
    last = pin.SE3(turn(Z, 1.0), np.array([0.0, 0.4, 0.0]))
    whole = first * pin.SE3(rotation, np.array(translation, dtype=float)) * last.inverse()
    found = placed(scene, dict(zip(names, Q, strict=False)), "a")
    same(found, whole.rotation, whole.translation - scene.robot.origin)


def custom(tilted="1 0.5 0", coordinates=("q", "p")):
    axes = (
        axis("rotation1", "0 0 1", "q", linear(-1.0, 0.2))
        + axis("rotation2", tilted, "q", SIMM)
        + axis("rotation3", "0 1 0", "", '<Constant name="function"><value>0.4</value></Constant>')
        + axis(
            "translation1",
            "1 0 0",
            "p",
            '<MultiplierFunction name="function"><function><PolynomialFunction><coefficients>2 0 '
            "1</coefficients></PolynomialFunction></function><scale>0.5</scale></MultiplierFunction>",
        )
        + axis("translation2", "0 1 0", "p", linear(1.0))
        + axis("translation3", "0 0 1", "q", linear(2.0, 0.1))
    )
    given = "".join(map(coordinate, coordinates))
    inside = f"<SpatialTransform>{axes}</SpatialTransform>"
    return joint("CustomJoint", "j", "/ground", "/bodyset/a", given, inside)


def test_a_custom_joint_is_its_functions(tmp_path):
    """Backwards, offset, scaled, by spline and polynomial; axes that are not orthogonal."""
    scene = loaded(model([body("a")], [custom()]), tmp_path)
    assert scene.couplings.independent == ("p", "q")
    assert set(scene.couplings.parents) == {"j_r2", "j_tx", "j_tz"}
    q, p = 0.7, -0.3
    bent = simm_spline(**SPLINE)(q)[0]
    rotation = turn(Z, 0.2 - q) @ turn((1.0, 0.5, 0.0), bent) @ turn(Y, 0.4)
    same(placed(scene, {"q": q, "p": p}, "a"), rotation, (p * p + 0.5, p, 2.0 * q + 0.1))


def test_a_coordinate_that_no_axis_is_by_itself_keeps_its_joint(tmp_path):
    inside = f"<SpatialTransform>{axis('rotation1', '0 0 1', 'q', SIMM)}</SpatialTransform>"
    text = model(
        [body("a")],
        [joint("CustomJoint", "j", "/ground", "/bodyset/a", coordinate("q"), inside)],
    )
    scene = loaded(text, tmp_path)
    assert scene.couplings.parents == {"j_r1": "q"}
    angle = simm_spline(**SPLINE)(1.2)[0]
    same(placed(scene, {"q": 1.2}, "a"), turn(Z, angle), (0, 0, 0))
    M = scene.system().mass(np.array([1.2])).dense
    slope = simm_spline(**SPLINE)(1.2)[1]
    assert pytest.approx(np.array([[slope**2 * (0.3 + 0.25)]]), rel=1e-12) == M


def test_couplers_are_chained_couplings(tmp_path):
    scene = loaded(chain(ConstraintSet=COUPLERS), tmp_path)
    assert scene.couplings.parents == {"q2": "q1", "q3": "q2"}
    whole = 0.4 + 0.9 + simm_spline(**SPLINE)(0.9)[0]
    same(placed(scene, {"q1": 0.4}, "c"), turn(Z, whole), (0, 0, 0))


def test_what_follows_a_locked_coordinate_is_locked_and_can_be_set_free(tmp_path):
    locked = "<default_value>0.2</default_value><locked>true</locked>"
    scene = loaded(chain(locked=locked, ConstraintSet=COUPLERS), tmp_path)
    assert scene.robot.locked == {
        "q1": 0.2,
        "q2": 0.5,
        "q3": simm_spline(**SPLINE)(0.5)[0],
    }
    entry = {"osim": str(tmp_path / "small.osim"), "locked": {"q1": None}}
    assert scene_from({"robot": entry}).couplings.parents == {"q2": "q1", "q3": "q2"}


def test_a_coordinate_of_the_name_of_a_body_can_be_locked(tmp_path):
    text = model(
        [body("a"), body("b")],
        [
            joint("PinJoint", "first", "/ground", "/bodyset/a", coordinate("a")),
            joint("PinJoint", "second", "/bodyset/a", "/bodyset/b", coordinate("b")),
        ],
    )
    (tmp_path / "small.osim").write_text(text, encoding="utf-8")
    entry = {"osim": str(tmp_path / "small.osim"), "locked": {"a": 0.3}}
    scene = scene_from({"robot": entry})
    assert scene.couplings.independent == ("b",)
    same(placed(scene, {"b": 0.4}, "b"), turn(Z, 0.7), (0, 0, 0))


def test_a_loop_of_joints_is_closed_by_a_constraint(tmp_path):
    """A four-bar of equal bars keeps one freedom and its mass."""
    down = "<default_value>-1.5707963267948966</default_value>"
    at = ("0 1 0", "0 0 0")
    joints = [
        joint("PinJoint", "j1", "/ground", "/bodyset/a", coordinate("q1")),
        joint(
            "PinJoint",
            "j2",
            "a_end",
            "/bodyset/b",
            coordinate("q2", down),
            frames=frame("a_end", "a", at[0]),
        ),
        joint(
            "PinJoint",
            "j3",
            "g",
            "/bodyset/c",
            coordinate("q3"),
            frames=frame("g", "ground", "1 0 0"),
        ),
        joint(
            "PinJoint",
            "j4",
            "c_end",
            "b_end",
            coordinate("q4", down),
            frames=frame("c_end", "c", at[0]) + frame("b_end", "b", at[0]),
        ),
    ]
    scene = loaded(model([body("a"), body("b"), body("c")], joints), tmp_path)
    assert [part.name for part in scene.constraints] == ["j4_closure"]
    assert pin.computeTotalMass(scene.robot.model) == pytest.approx(3.0, rel=1e-15)
    assert "degrees of freedom 1\n" in scene.check()


def test_a_joint_that_hangs_its_parent_from_its_child_is_turned_round(tmp_path):
    text = model(
        [body("a")],
        [
            joint(
                "PinJoint",
                "j",
                "/bodyset/a",
                "g",
                coordinate("q"),
                frames=frame("g", "ground", "0 1 0"),
            )
        ],
    )
    same(placed(loaded(text, tmp_path), {"q": 0.6}, "a"), turn(Z, -0.6), (0, 1, 0))


def test_a_body_without_joint_moves_freely(tmp_path):
    scene = loaded(model([body("a")], []), tmp_path)
    assert sorted(scene.couplings.independent) == [f"free_a_coord_{i}" for i in range(6)]


def test_angles_of_any_rotation_give_it_back():
    rng, half = np.random.default_rng(0), np.pi / 2.0
    for angles in (*rng.uniform(-3.0, 3.0, (20, 3)), (0.3, half, 0.4), (1.0, -half, 2.0)):
        rotation = pin.rpy.rpyToMatrix(*angles)
        again = pin.rpy.rpyToMatrix(*roll_pitch_yaw(rotation))
        assert np.abs(again - rotation).max() < 1e-15
