"""Cases that several tests share: part contracts."""

import numpy as np
import parts_of_pages
import pinocchio as pin

from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.state import State
from mbd_ros.scene.schema.registry import resolve

OUTSIDE = parts_of_pages.OUTSIDE


OF_A_ROBOT = ("actuators", "constraints", "contacts", "forces", "muscles", "sensors")


NAMED = ("sensors",)  # by name; the others are lists


def kind_of(section, name):
    return resolve(section, name, "here")


def arguments(section, name):
    """Arguments with which a part can be built on the leg."""
    given = OUTSIDE.get(section, {}).get(name)
    return dict(kind_of(section, name).example if given is None else given)


def part_in(scene):
    keys = [key for key in OF_A_ROBOT if key in scene.parts]
    ((part,),) = [parts_in_section(scene, key) for key in keys]
    return part


def parts_in_section(scene, key):
    held = scene.parts.get(key, ())
    return list(held.values()) if key in NAMED and held else list(held)


def moments(scene, count=5):
    """Kinematics at random states of the leg, and the states."""
    robot, rng = scene.robot, np.random.default_rng(3)
    model, k, nz = robot.model, Kinematics(robot), scene.internals.nz
    for t in rng.uniform(0.1, 0.8, count):
        q = pin.integrate(model, robot.neutral(), rng.uniform(-1.0, 1.0, model.nv))
        v, z = rng.normal(size=model.nv), scene.internals.inside(rng.normal(size=nz))
        yield refreshed(k, State(t, q, v, z))


def refreshed(k, x):
    k.refresh(x.q, x.v)
    return k, x
