"""An excitation as trajectory_msgs/JointTrajectory, in YAML and in a bag, and as a table."""

from pathlib import Path
from typing import Any

import numpy as np
import yaml

from mbd_ros.core.state import NANOSECOND
from mbd_ros.errors import DataError
from mbd_ros.features.identification.excite.job import Excitation, excite, points_of
from mbd_ros.files.bags.bag_types import new_message
from mbd_ros.files.bags.bag_writer import BagWriter
from mbd_ros.files.output_folder import make_folder
from mbd_ros.files.text_file import replacing
from mbd_ros.jobs.progress import Say
from mbd_ros.scene.built_scene import Scene

_TYPE = "trajectory_msgs/msg/JointTrajectory"
_TOPIC = "/joint_trajectory"
_MOST = 2850  # points that controllers take
_NAMES = ("positions", "velocities", "accelerations")


def excite_to(scene: Scene, out: Path, rate: float, options: dict[str, Any], say: Say) -> None:
    """Write `trajectory.yaml`, `trajectory.mcap` and `trajectory.csv` into a folder.

    Args:
        rate: Points a second [Hz].
        options: Of `excite`.
        say: Is told what was done.
    """
    count = rate * options["period"]
    if not 4 <= count <= _MOST:
        raise DataError(f"--rate {rate:g}: {count:g} points, controllers take 4 .. {_MOST}")
    make_folder(out)
    found = excite(scene, **options, say=say, progress=True)
    samples = found.samples(rate)
    points = [
        (t, {name: values.tolist() for name, values in zip(_NAMES, each, strict=True)})
        for t, each in points_of(samples, found.joints)
    ]
    with replacing(out / "trajectory.yaml") as file:
        file.write(_yaml(found, points).encode())
    with BagWriter(out / "trajectory.mcap") as bag:
        bag.write(_TOPIC, _TYPE, 0, _message(found, points))
    samples.to(out / "trajectory.csv")
    say(f"{out}: trajectory.yaml, trajectory.mcap, trajectory.csv")


def _yaml(found: Excitation, points: list[tuple[float, dict[str, list[float]]]]) -> str:
    """The message as `ros2 topic pub` takes it."""
    message = {
        "joint_names": list(found.joints),
        "points": [{**values, "time_from_start": _duration(t)} for t, values in points],
    }
    return yaml.safe_dump(message, sort_keys=False, default_flow_style=None, width=10_000)


def _message(found: Excitation, points: list[tuple[float, dict[str, list[float]]]]) -> Any:
    message = new_message(_TYPE)
    message.joint_names = list(found.joints)
    message.points = []
    for t, values in points:
        point = new_message("trajectory_msgs/msg/JointTrajectoryPoint")
        for name, numbers in values.items():
            setattr(point, name, np.array(numbers))
        point.time_from_start.sec, point.time_from_start.nanosec = _duration(t).values()
        message.points.append(point)
    return message


def _duration(t: float) -> dict[str, int]:
    whole = round(t / NANOSECOND)
    return {"sec": whole // 10**9, "nanosec": whole % 10**9}
