"""Joints of OpenSim on an ellipsoid, against where they are defined to be."""

import numpy as np
import pinocchio as pin
import pytest
from osim_models import Q, X, Y, Z, body, coordinate, joint, loaded, model, placed, same, turn


def on_ellipsoid(radii, q):
    """Turns, and the point whose normal is the z axis that they give."""
    rotation = turn(X, q[0]) @ turn(Y, q[1]) @ turn(Z, q[2])
    return pin.SE3(rotation, np.array(radii) * rotation[:, 2])


@pytest.mark.parametrize("radii", [(0.3, 0.5, 0.8), (0.3, 0.5, 0.5)])
def test_a_joint_on_an_ellipsoid_keeps_to_it(radii, tmp_path):
    given = "".join(map(coordinate, ("c0", "c1", "c2")))
    inside = f"<radii_x_y_z>{' '.join(map(str, radii))}</radii_x_y_z>"
    each = joint("EllipsoidJoint", "j", "/ground", "/bodyset/a", given, inside)
    scene = loaded(model([body("a")], [each]), tmp_path)
    whole = on_ellipsoid(radii, Q)
    found = placed(scene, dict(zip(("c0", "c1", "c2"), Q, strict=False)), "a")
    same(found, whole.rotation, whole.translation)


def test_a_scapula_slides_on_the_thorax_and_wings(tmp_path):
    names = ("abduction", "elevation", "rotation", "winging")
    inside = (
        "<thoracic_ellipsoid_radii_x_y_z>0.3 0.5 0.8</thoracic_ellipsoid_radii_x_y_z>"
        "<scapula_winging_axis_origin>0.05 0.07</scapula_winging_axis_origin>"
        "<scapula_winging_axis_direction>0.4</scapula_winging_axis_direction>"
    )
    given = "".join(map(coordinate, names))
    each = joint("ScapulothoracicJoint", "j", "/ground", "/bodyset/a", given, inside)
    scene = loaded(model([body("a")], [each]), tmp_path)
    quarter = pin.SE3(turn(Z, np.pi / 2.0), np.zeros(3))
    origin = pin.SE3(np.eye(3), np.array([0.05, 0.07, 0.0]))
    wing = pin.SE3(turn((-np.sin(0.4), np.cos(0.4), 0.0), Q[3]), np.zeros(3))
    whole = quarter * on_ellipsoid((0.5, 0.3, 0.8), Q) * quarter.inverse()
    whole = whole * origin * wing * origin.inverse()
    found = placed(scene, dict(zip(names, Q, strict=False)), "a")
    same(found, whole.rotation, whole.translation)
