"""Cases that several tests share: learned torque."""

from itertools import pairwise

import numpy as np

from mbd_ros.features.identification.learn.onnx_file import onnx_bytes
from mbd_ros.features.identification.learn.training_samples import CURVES, Scales
from mbd_ros.methods.learned_model import About, numbers_of
from mbd_ros.scene.reading.learned_entries import physics_beside

MEMBERS, HIDDEN = 3, 8


def layers(random, *sizes):
    found = {}
    for i, (before, after) in enumerate(pairwise(sizes), 1):
        found[f"W{i}"] = random.normal(size=(MEMBERS, after, before)) / np.sqrt(before)
        found[f"b{i}"] = 0.3 * random.normal(size=(MEMBERS, after))
    return found


def scales(m):
    return Scales(np.zeros(m), *(np.linspace(a, b, m) for a, b in ((1, 2), (1, 3), (0.1, 0.2))),
                  np.linspace(5, 9, m), np.linspace(2, 4, m))  # fmt: skip


def weights(kind, m, seed=0):
    random = np.random.default_rng(seed)
    if kind == "free":
        return layers(random, 3 * m, HIDDEN, HIDDEN, m)
    found = layers(random, 2 * m, HIDDEN, HIDDEN, m * (m + 1) // 2 + 1)
    found["friction"] = random.normal(size=(MEMBERS, m, len(CURVES) + 1)) - 2.0
    return found | {"offset": random.normal(size=(MEMBERS, m))}


def content(scene, kind="free", half=3.0, trust=1.0, **corrections):
    """A model with random weights; positions and velocities are trusted within a half span."""
    joints = scene.couplings.independent
    m = len(joints)
    wall = np.full(2 * m, half)
    said = About(kind, "arm7", joints, -wall, wall, numbers_of(scene.robot))
    said = said._replace(physics=physics_beside(scene, said), **corrections)
    return onnx_bytes(said, weights(kind, m), scales(m), np.full(m, trust))
