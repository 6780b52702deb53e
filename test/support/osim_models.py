"""Small models of OpenSim as text."""

import numpy as np
import pinocchio as pin
import pytest

from mbd_ros.api import load_scene

X, Y, Z = np.eye(3)
Q = (0.3, -0.7, 1.1, 0.2, -0.4, 0.5)

SPLINE = {"x": [-1.0, 0.0, 0.5, 1.5, 2.0], "y": [0.1, 0.0, 0.2, -0.1, 0.3]}
SIMM = '<SimmSpline name="function"><x>-1 0 0.5 1.5 2</x><y>0.1 0 0.2 -0.1 0.3</y></SimmSpline>'


def body(name, mass=1.0, inside=""):
    return (
        f'<Body name="{name}"><mass>{mass}</mass><mass_center>0 0.5 0</mass_center>'
        f"<inertia>0.2 0.1 0.3 0 0 0</inertia>{inside}</Body>"
    )


def coordinate(name, inside=""):
    return f'<Coordinate name="{name}">{inside}</Coordinate>'


def frame(name, parent, at="0 0 0", turned="0 0 0"):
    return (
        f'<PhysicalOffsetFrame name="{name}"><socket_parent>/bodyset/{parent}</socket_parent>'
        f"<translation>{at}</translation><orientation>{turned}</orientation></PhysicalOffsetFrame>"
    )


def joint(kind, name, parent, child, coordinates="", inside="", frames=""):
    return (
        f'<{kind} name="{name}"><socket_parent_frame>{parent}</socket_parent_frame>'
        f"<socket_child_frame>{child}</socket_child_frame>"
        f"<coordinates>{coordinates}</coordinates><frames>{frames}</frames>{inside}</{kind}>"
    )


def axis(name, direction, coordinates="", function=""):
    return (
        f'<TransformAxis name="{name}"><coordinates>{coordinates}</coordinates>'
        f"<axis>{direction}</axis>{function}</TransformAxis>"
    )


def linear(slope, offset=0.0):
    return (
        f'<LinearFunction name="function"><coefficients>{slope} {offset}</coefficients>'
        "</LinearFunction>"
    )


def model(bodies, joints, **sets):
    """A document; `sets` are texts by tag, such as ForceSet."""
    more = "".join(f"<{tag}><objects>{text}</objects></{tag}>" for tag, text in sets.items())
    return (
        '<?xml version="1.0" encoding="UTF-8" ?><OpenSimDocument Version="40000">'
        f'<Model name="small"><BodySet><objects>{"".join(bodies)}</objects></BodySet>'
        f"<JointSet><objects>{''.join(joints)}</objects></JointSet>{more}</Model>"
        "</OpenSimDocument>"
    )


def chain(*more, locked="", **sets):
    joints = [
        joint("PinJoint", "first", "/ground", "/bodyset/a", coordinate("q1", locked)),
        joint("PinJoint", "second", "/bodyset/a", "/bodyset/b", coordinate("q2")),
        joint("PinJoint", "third", "/bodyset/b", "/bodyset/c", coordinate("q3")),
        *more,
    ]
    return model([body("a"), body("b"), body("c")], joints, **sets)


def coupler(child, parent, function):
    return (
        f'<CoordinateCouplerConstraint name="{child}_by_{parent}"><coupled_coordinates_function>'
        f"{function}</coupled_coordinates_function><independent_coordinate_names>{parent}"
        f"</independent_coordinate_names><dependent_coordinate_name>{child}"
        "</dependent_coordinate_name></CoordinateCouplerConstraint>"
    )


COUPLERS = coupler("q2", "q1", linear(2.0, 0.1)) + coupler("q3", "q2", SIMM)


def loaded(text, folder, name="small.osim"):
    file = folder / name
    file.write_text(text, encoding="utf-8")
    return load_scene(file)


def placed(scene, positions, link):
    """Where a link is, `pinocchio.SE3`; coupled joints follow."""
    model, q = scene.robot.model, np.array(scene.robot.neutral())
    for name, value in positions.items():
        q[scene.robot.joint(name).q] = value
    scene.couplings.expand(q, np.zeros(model.nv), np.zeros(model.nv))
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    return data.oMf[scene.robot.frame(link)]


def turn(axis, angle):
    axis = np.array(axis, dtype=float)
    return pin.AngleAxis(angle, axis / np.linalg.norm(axis)).toRotationMatrix()


def same(found, rotation, translation):
    assert found.rotation == pytest.approx(rotation, abs=1e-14)
    assert found.translation == pytest.approx(np.array(translation), abs=1e-14)
