"""Feet on the ground without force plates: contacts whose forces are unknowns."""

import math

import numpy as np
import pytest
from mechanisms import joint, link, urdf

import mbd_ros as mbd
from mbd_ros.errors import DataError
from mbd_ros.files.table import Column, Result, Table

G = 9.81
SIDES = {"left": 0.15, "right": -0.15}


def slides(side, y):
    """A foot below the trunk on three slides."""
    names = [f"{side}_{axis}" for axis in "xyz"]
    bodies = [f"{side}_1", f"{side}_2", f"{side}_foot"]
    moments = (0.01, 0.01, 0.01)
    parts = [link(bodies[0], 1.0, (0, 0, 0), moments), link(bodies[1], 1.0, (0, 0, 0), moments)]
    parts.append(link(bodies[2], 2.0, (0.02, 0.0, 0.05), moments))
    places = (0.0, y, -0.9), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    axes, parents = np.eye(3), ("trunk", *bodies[:2])
    each = zip(names, parents, bodies, axes, places, strict=True)
    return [*parts, *(joint(n, "prismatic", p, c, axis, at) for n, p, c, axis, at in each)]


BIPED = urdf(
    link("trunk", 30.0, (0.0, 0.0, 0.1), (2.0, 2.0, 1.0)),
    *(part for side, y in SIDES.items() for part in slides(side, y)),
)
JOINTS = [f"{side}_{axis}" for side in SIDES for axis in "xyz"]
SOLE = [[0.15, 0.06, 0.0], [0.15, -0.06, 0.0], [-0.1, -0.06, 0.0], [-0.1, 0.06, 0.0]]


def biped(away=(0.0, 0.0, 0.0), sides=tuple(SIDES), **more):
    """A trunk on two feet that slide below it; nothing but the ground carries it."""
    ground = {"half_space": [0.0, 0.0, 1.0], "xyz": list(away)}
    contacts = [
        {
            "type": "rigid",
            "name": f"{side}_sole",
            "between": [{"frame": f"{side}_foot", "points": SOLE}, ground],
            "friction": 0.7,
        }
        for side in sides
    ]
    sections = {"robot": {"base": "floating"}, "contacts": contacts}
    return mbd.scene_from(sections | more, urdf=BIPED)


def sway(away=(0.0, 0.0, 0.0), lifted=0.05, reverse=False):
    """The trunk goes from over the left foot to over the right one, which step on and off.

    Feet do not turn and do not slip: joints are the way of the foot less that of the trunk.
    """
    t = np.linspace(0.0, 1.2, 61)
    s = 2.0 * np.pi / 1.2
    y, vy, ay = 0.15 * np.cos(s * t / 2), *(np.zeros_like(t),) * 2
    vy, ay = -0.15 * s / 2 * np.sin(s * t / 2), -0.15 * (s / 2) ** 2 * np.cos(s * t / 2)
    x, vx, ax = 0.1 * t, 0.1 + 0.0 * t, 0.0 * t
    trunk = {"x": (x, vx, ax), "y": (y, vy, ay), "z": (0.9 + 0 * t, 0 * t, 0 * t)}
    up = {side: np.maximum(sign * (t - at), 0.0) for side, sign, at in FEET}
    rows = {}
    for side, where in SIDES.items():
        del where
        height = lifted / 0.09 * up[side] ** 2
        rise = 2 * lifted / 0.09 * up[side] * (1 if side == "left" else -1)
        push = 2 * lifted / 0.09 * (up[side] > 0)
        for axis, foot in zip("xyz", ((0, 0, 0), (0, 0, 0), (height, rise, push)), strict=True):
            for field, f, b in zip(FIELDS, foot, trunk[axis], strict=True):
                shift = 0.9 if (axis, field) == ("z", "position") else 0.0
                rows[f"{side}_{axis}.{field}"] = f - b + shift
    bodies = "position", "linear_velocity", "linear_acceleration"
    for axis in "xyz":
        for field, value in zip(bodies, trunk[axis], strict=True):
            shift = away["xyz".index(axis)] if field == "position" else 0.0
            rows[f"base.{field}.{axis}"] = value + shift
        for field in ("angular_velocity", "angular_acceleration"):
            rows[f"base.{field}.{axis}"] = 0.0 * t
    for axis, value in zip("xyzw", (0, 0, 0, 1), strict=True):
        rows[f"base.orientation.{axis}"] = value + 0.0 * t
    names = list(rows)[:: -1 if reverse else 1]
    return Result({"samples": Table([Column(n, v) for n, v in (("time", t), *((n, rows[n]) for n in names))])})


FEET = (("left", 1, 0.8), ("right", -1, 0.4))  # the left one leaves at 0.8 s, the right comes at 0.4 s
FIELDS = ("position", "velocity", "acceleration")


def force(samples, side):
    return np.column_stack([samples[f"{side}_sole.force_{axis}"] for axis in "xyz"])


def residual(samples):
    words = [f"{kind}_{axis}" for kind in ("force", "torque") for axis in "xyz"]
    return np.column_stack([samples[f"base.residual.{word}"] for word in words])


for method in ("minimum-norm", "smooth"):
    for away, rev in (((0.0, 0.0, 0.0), False), ((100.0, -50.0, 20.0), True)):
        found = biped(away).inverse(sway(away, reverse=rev), stance=method, power=True)
        s = found["samples"]
        print(*found.metadata["remarks"], sep="\n")
        print(np.abs(residual(s)).max(), np.abs(s["power.residual"]).max())
        for i in range(0, 61, 3):
            print("%.2f"%s["time"][i], force(s, "left")[i].round(2), force(s, "right")[i].round(2), np.abs(residual(s)[i]).max().round(3))
