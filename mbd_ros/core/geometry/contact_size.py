"""The size of the bodies of a contact, by which a depth is large or small."""

import numpy as np

from mbd_ros.core.geometry.contact_pair import ContactPair
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.model.robot import Robot


def distance_to_mass(robot: Robot, pair: ContactPair) -> float:
    """Farthest way of a feature to the nearer mass centre of the moving bodies [m].

    It is that of the neutral configuration: the radius of a ball, half the diagonal of a box.

    Args:
        robot: The robot.
        pair: Features of two bodies.
    """
    k = Kinematics(robot)
    k.refresh(robot.neutral(), np.zeros(robot.model.nv), Reads.POSITION)
    touching, ways = pair.places(k).point, []
    for point in pair.points:
        joint = robot.places.points[point.number].joint
        if joint:
            carrier = robot.carrier(point.frame)
            lever = np.asarray(robot.model.inertias[joint].lever)
            centre = k.position(carrier) + k.rotation(carrier).dot(lever)
            ways.append(np.linalg.norm(touching - centre, axis=1))
    return float(np.min(ways, axis=0).max())
