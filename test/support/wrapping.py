"""Cases that several tests share: wrapping."""

import math

import mbd_ros as mbd

POINTS = [
    {"frame": "link1", "xyz": [0.1, 0.0, 0.05]},
    {"frame": "link4", "xyz": [0.3, 0.0, 0.1]},
    {"frame": "flange", "xyz": [0.1, 0.0, 0.1]},
]


POSE = {"xyz": [0.05, 0.0, 0.1], "rpy": [0.3, 0.2, 0.1]}


WRAPS = {
    "cylinder": [{"frame": "link2", "cylinder": {"radius": 0.08, "length": 0.6}, "pose": POSE}],
    "side": [{"frame": "link2", "cylinder": {"radius": 0.05, "length": 2.0}, "side": "x"}],
    "sphere": [{"frame": "link3", "sphere": 0.12, "side": "-y"}],
    "ellipsoid": [{"frame": "link3", "ellipsoid": [0.15, 0.1, 0.2]}],
    "torus": [{"frame": "link3", "torus": {"inner": 0.05, "outer": 0.2}}],
    "several": [
        {"frame": "link3", "sphere": 0.1, "between": [0, 1]},
        {"frame": "link2", "ellipsoid": [0.1, 0.12, 0.08]},
        {"frame": "link5", "cylinder": {"radius": 0.06, "length": 0.5}},
    ],
}


def swing(**more):
    """A pendulum whose cable is taut, and wraps over a bar below the hinge on the way."""
    bar = {"frame": "world", "cylinder": {"radius": 0.05, "length": 1.0}}
    points = [
        {"frame": "world", "xyz": [0.2, 0.0, 0.2]},
        {"frame": "rod", "xyz": [0.0, 0.0, -0.8]},
    ]
    path = {"points": points, "wraps": [{**bar, "pose": {"rpy": [math.pi / 2.0, 0.0, 0.0]}}]}
    cable = {"type": "cable", "path": "over", "stiffness": 50.0, "slack_length": 0.5}
    method = {"type": "dop853", "tolerance": 1e-11}
    start = {"position": {"hinge": -0.9}}
    entries = {"paths": {"over": path}, "forces": [cable], "integrator": method, "initial": start}
    return mbd.scene_from({**entries, "dt": 0.01, **more}, urdf="pendulum")
