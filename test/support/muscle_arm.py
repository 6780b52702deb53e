"""A planar arm of two links with six muscles, in a scene from Python, and a motion of it."""

import numpy as np

from mbd_ros.files.table import Column, Result, Table

URDF = """<robot name="arm">
<link name="trunk"/>
<link name="upper"><inertial><origin xyz="0 0 -0.15"/><mass value="2"/>
<inertia ixx="0.02" iyy="0.02" izz="0.003" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="lower"><inertial><origin xyz="0 0 -0.12"/><mass value="1.5"/>
<inertia ixx="0.015" iyy="0.015" izz="0.002" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="shoulder" type="revolute"><parent link="trunk"/><child link="upper"/>
<axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="100" velocity="10"/></joint>
<joint name="elbow" type="revolute"><parent link="upper"/><child link="lower"/>
<origin xyz="0 0 -0.3"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="2" effort="100" velocity="10"/></joint>
</robot>"""
_TRUNK, _UPPER, _LOWER = "trunk", "upper", "lower"
_POINTS = {  # from where to where; x is in front
    "front": [(_TRUNK, (0.05, 0.0, 0.04)), (_UPPER, (0.03, 0.0, -0.12))],
    "back": [(_TRUNK, (-0.05, 0.0, 0.04)), (_UPPER, (-0.03, 0.0, -0.12))],
    "flexor": [(_UPPER, (0.03, 0.0, -0.1)), (_LOWER, (0.03, 0.0, -0.06))],
    "extensor": [(_UPPER, (-0.03, 0.0, -0.1)), (_LOWER, (-0.03, 0.0, -0.06))],
    "long_front": [(_TRUNK, (0.05, 0.0, 0.02)), (_LOWER, (0.035, 0.0, -0.05))],
    "long_back": [(_TRUNK, (-0.05, 0.0, 0.02)), (_LOWER, (-0.035, 0.0, -0.05))],
}
_FIBERS = {"front": 0.1, "back": 0.1, "flexor": 0.16, "extensor": 0.16}
SCENE = {
    "paths": {
        name: {"points": [{"frame": frame, "xyz": list(xyz)} for frame, xyz in points]}
        for name, points in _POINTS.items()
    },
    "muscles": [
        {
            "type": "thelen",
            "name": name,
            "path": name,
            "max_isometric_force": 600.0,
            "optimal_fiber_length": _FIBERS.get(name, 0.25),
            "tendon_slack_length": 0.08,
            "tendon": "rigid",
        }
        for name in _POINTS
    ],
}
NAMES = list(_POINTS)


def motion(frames=40, size=0.6):
    """A swing of both joints, with its exact derivatives."""
    t = np.linspace(0.0, 1.0, frames)
    columns = [Column("time", t, "s")]
    for name, phase in (("shoulder", 0.0), ("elbow", 0.8)):
        angle = 4.0 * t + phase
        columns.append(Column(f"{name}.position", size * np.sin(angle), "rad"))
        columns.append(Column(f"{name}.velocity", 4.0 * size * np.cos(angle), "rad/s"))
        columns.append(Column(f"{name}.acceleration", -16.0 * size * np.sin(angle), "rad/s^2"))
    return Result({"samples": Table(columns)})
