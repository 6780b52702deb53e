"""Cases that several tests share: contact pairs."""

import numpy as np
import pinocchio as pin

from mbd_ros.core.state import State

BODIES = """
bodies:
  box: {shape: {box: [0.2, 0.3, 0.4]}, mass: 2.0, pose: {xyz: [0.1, 0.2, 0.9]}}
  ball: {shape: {sphere: 0.1}, mass: 1.0, pose: {xyz: [0.5, -0.4, 0.3]}}
  pill: {shape: {capsule: {radius: 0.05, length: 0.3}}, mass: 1.0}
  drum: {shape: {cylinder: {radius: 0.2, length: 0.3}}, mass: 1.0, pose: {xyz: [1, 0, 0.5]}}
  wedge: {shape: {box: [1, 1, 1]}, mass: 7.0, pose: {xyz: [0.0, 0.0, -1.0]}}
"""


PLANE = "{frame: wedge, half_space: [0.2, -0.1, 1.0], xyz: [0.1, 0.0, 0.5], rpy: [0.1, 0.2, 0.3]}"


POINTS = "{frame: pill, points: [[0.1, 0, 0], [0, 0.2, 0.1], [0.1, 0.1, 0.3]], rpy: [1, 0, 0]}"


SMOOTH = {  # a, b and the names of the features
    "sphere over plane": ("ball", PLANE, 1),
    "plane over sphere": (PLANE, "ball", 1),
    "points over plane": (POINTS, PLANE, 3),
    "plane over points": (PLANE, POINTS, 3),
    "capsule over plane": ("pill", PLANE, 2),
    "box over plane": ("box", PLANE, 8),
    "box over ground": ("box", "ground", 8),
    "ground over box": ("ground", "box", 8),
    "ball over ball": ("ball", "{frame: box, sphere: 0.3, xyz: [0.1, 0, 0]}", 1),
    "points over ball": (POINTS, "ball", 3),
}


OTHERS = {  # whose gaps have kinks
    "cylinder over plane": ("drum", PLANE, 8),
    "plane over cylinder": (PLANE, "drum", 8),
    "ball over box": ("ball", "box", 1),
    "box over points": ("box", POINTS, 3),
    "ball over capsule": ("ball", "pill", 1),
    "points over cylinder": (POINTS, "drum", 3),
    "box over box": ("box", "wedge", 24),
    "cylinder over box": ("drum", "wedge", 5),
    "cylinder over cylinder": ("drum", "{frame: box, cylinder: {radius: 0.1, length: 1}}", 5),
}


def random_states(scene, count, place=(0.0, 0.0, 0.0), seed=0):
    model, rng = scene.robot.model, np.random.default_rng(seed)
    for _ in range(count):
        q = scene.initial.q.copy()
        for base in scene.robot.bases:
            q[base.q][:3] += place
        yield State(
            0.0, pin.integrate(model, q, rng.uniform(-1, 1, model.nv)), rng.normal(size=model.nv)
        )
