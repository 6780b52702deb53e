"""Files of an excitation: a JointTrajectory message in YAML and in a bag, and a table."""

from pathlib import Path
from typing import Any

import numpy as np
import yaml

from mbd_ros.core.state import NANOSECOND
from mbd_ros.errors import DataError
from mbd_ros.features.identification.excite.job import Excitation, excite, trajectory_points
from mbd_ros.files.bags.bag_types import new_message
from mbd_ros.files.bags.bag_writer import BagWriter
from mbd_ros.files.output_folder import make_folder
from mbd_ros.files.text_file import replacing
from mbd_ros.jobs.progress import Say
from mbd_ros.scene.built_scene import Scene

_TYPE = "trajectory_msgs/msg/JointTrajectory"
_TOPIC = "/joint_trajectory"
_MOST_POINTS = 2850  # points that controllers accept in a trajectory
_FIELDS = ("positions", "velocities", "accelerations")


def excite_to(
    scene: Scene, out: Path, options: dict[str, Any], say: Say, *, rate: float = 50.0
) -> None:
    """Search an excitation and write `trajectory.yaml`, `trajectory.mcap` and `trajectory.csv`.

    Args:
        options: Options of `excite`.
        say: Receives lines for people.
        rate: Points of the trajectory per second [Hz].
    """
    count = rate * options["period"]
    if not 4 <= count <= _MOST_POINTS:
        raise DataError(
            f"--rate {rate:g}: the trajectory would have {count:g} points, but controllers accept "
            f"4 .. {_MOST_POINTS}; change --rate or --period"
        )
    make_folder(out)
    excitation = excite(scene, **options, say=say, progress=True)
    samples = excitation.samples(rate)
    points = [
        (t, {name: values.tolist() for name, values in zip(_FIELDS, fields, strict=True)})
        for t, fields in trajectory_points(samples, excitation.joints)
    ]
    with replacing(out / "trajectory.yaml") as file:
        file.write(_yaml(excitation, points).encode())
    with BagWriter(out / "trajectory.mcap") as bag:
        bag.write(_TOPIC, _TYPE, 0, _message(excitation, points))
    samples.to(out / "trajectory.csv")
    say(f"{out}: trajectory.yaml, trajectory.mcap, trajectory.csv")


def _yaml(excitation: Excitation, points: list[tuple[float, dict[str, list[float]]]]) -> str:
    """Return the message in the format of `ros2 topic pub`."""
    message = {
        "joint_names": list(excitation.joints),
        "points": [{**values, "time_from_start": _duration(t)} for t, values in points],
    }
    return yaml.safe_dump(message, sort_keys=False, default_flow_style=None, width=10_000)


def _message(excitation: Excitation, points: list[tuple[float, dict[str, list[float]]]]) -> Any:
    message = new_message(_TYPE)
    message.joint_names = list(excitation.joints)
    message.points = []
    for t, values in points:
        point = new_message("trajectory_msgs/msg/JointTrajectoryPoint")
        for name, numbers in values.items():
            setattr(point, name, np.array(numbers))
        point.time_from_start.sec, point.time_from_start.nanosec = _duration(t).values()
        message.points.append(point)
    return message


def _duration(t: float) -> dict[str, int]:
    nanoseconds = round(t / NANOSECOND)
    return {"sec": nanoseconds // 10**9, "nanosec": nanoseconds % 10**9}
