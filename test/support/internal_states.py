"""Cases that several tests share: internal states."""

import math

import numpy as np

from mbd_ros.api import scene_from
from mbd_ros.core.loads.inputs import HeldTable

DRIVE = {
    **{"type": "series_elastic_drive", "joint": "hinge", "name": "drive", "stiffness": 40.0},
    **{"rotor_inertia": 2e-3, "ratio": 5.0, "damping": 0.3, "viscous": 1e-3, "limit": 2.0},
}


INERTIA, WEIGHT = 0.0833583 + 0.25, 9.81 * 0.5  # of the rod about its hinge


def pendulum(**sections):
    first = {"position": {"hinge": 0.7}, "internal": {"drive": {"angle": 3.0, "speed": 8.0}}}
    given = {"actuators": [DRIVE], "initial": first, **sections}
    return scene_from(given, urdf="pendulum")


def driven(scene, u, **options):
    """A simulation whose drive has one torque from the start on."""
    held = HeldTable(np.zeros(1), np.full((1, 1), u))
    return scene.simulation(sources={"drive": held}, **options)


def rates_by_hand(y, u, drive=DRIVE):
    """q', v', theta', omega' of the rod, and power and loss."""
    q, v, theta, omega = y[:4]
    n = drive["ratio"]
    rate = omega / n - v
    tau = drive["stiffness"] * (theta / n - q) + drive["damping"] * rate
    u = max(min(u, drive["limit"]), -drive["limit"])
    speed = (u - drive["viscous"] * omega - tau / n) / drive["rotor_inertia"]
    loss = drive["damping"] * rate**2 + drive["viscous"] * omega**2
    return [v, (tau - WEIGHT * math.sin(q)) / INERTIA, omega, speed, u * omega, loss]


def numbers(x):
    return np.concatenate((x.q, x.v, x.z))
