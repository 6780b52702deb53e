"""Files of a demo, in a folder that takes its place as a whole."""

import os
import shutil
import tempfile
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import yaml

from mbd_ros.applications.demo.task import LAWS, DemoRobot, Disturbance
from mbd_ros.errors import DataError
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.schema.locate import find_file
from mbd_ros.scene.schema.strict_yaml import read_mapping

RATE = 500  # Hz of simulated time: ticks, joint states and commands
MASS_SCALE = 0.7  # of all masses and inertias in the controller's model
BAG, PICTURE, PAGE = "bag", "demo.png", "demo.html"
PLANT, MODEL, DESCRIPTION, GAINS = "plant.yaml", "model.yaml", "model.urdf", "controller.yaml"
OF_LOOP = (BAG, PICTURE, PAGE, PLANT, MODEL, DESCRIPTION, GAINS)
TABLES = ("swing", "markers", "motion", "moments", "forces")  # of the walking leg, as CSV
TWIN_TABLE = "samples"  # of the press, as CSV
# What a new demo may replace.
KNOWN = (*OF_LOOP, *(f"{table}.csv" for table in (*TABLES, TWIN_TABLE)))
_ROBOTS = "package://mbd_ros/config/robots"
_BANDWIDTH = 20.0  # 1/s
_LAYER = 1.3  # times gain x period: a model up to 1.3 times too heavy does not chatter either
_HAND_OVER = 0.05  # s in which the control takes over from the safe command: the robot sags
_SOFTNESS = 10.0  # rad/s, natural frequency of gravity_compensation
_MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


def write_scenes(
    folder: Path, robot: DemoRobot, joints: tuple[str, ...], added: Disturbance
) -> None:
    """Write the simulated scene (`PLANT`) and that of the controller (`MODEL`).

    Args:
        robot: Its scene is the source of both.
        joints: Where the disturbance acts.
        added: The disturbance, of which only the plant knows.
    """
    original = find_file(Path(), robot.scene, "demo")
    sections = read_mapping(original)
    urdf = f"{_ROBOTS}/{Path(sections['robot']['urdf']).name}"
    force = {
        "type": "prescribed_torque",
        "joints": list(joints),
        "times": added.times.round(9).tolist(),
        "torque": added.torque.round(9).tolist(),
    }
    plant = {
        **sections,
        "robot": {**sections["robot"], "urdf": urdf},
        "forces": [*sections.get("forces", []), force],
        "dt": 1.0 / RATE,
    }
    model = {**sections, "robot": {**sections["robot"], "urdf": DESCRIPTION}}
    _write_yaml(folder / PLANT, f"The plant of the demo: {robot.title}, disturbed.", plant)
    text = f"What the controller believes: all masses and inertias are {MASS_SCALE:g} of the true."
    _write_yaml(folder / MODEL, text, model)
    _write_scaled(find_file(Path(), urdf, "demo"), folder / DESCRIPTION)


def _write_yaml(path: Path, comment: str, content: dict[str, Any]) -> None:
    text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=110)
    path.write_text(f"# {comment}\n{text}", encoding="utf-8")


def _write_scaled(source: Path, target: Path) -> None:
    """Copy a robot description with all masses and inertias scaled."""
    tree = ElementTree.parse(source)
    attributes = [(e, "value") for e in tree.iter("mass")]
    attributes += [(e, name) for e in tree.iter("inertia") for name in _MOMENTS]
    for element, name in attributes:
        element.set(name, repr(MASS_SCALE * float(element.get(name, "0"))))
    tree.write(target, encoding="utf-8", xml_declaration=True)


def write_gains(folder: Path, robot: DemoRobot, law: str, scene: Scene) -> dict[str, Any]:
    """Write the parameter file of the controller; its parameters."""
    parameters: dict[str, Any] = {"safe_ramp": _HAND_OVER}
    parameters |= {f"gains.{name}": gain for name, gain in _gains(robot, law, scene).items()}
    if LAWS[law] == "sliding_mode_controller":
        parameters["controller"] = law
    file = {"/**": {"ros__parameters": parameters}}
    _write_yaml(folder / GAINS, f"Parameters of the node {LAWS[law]} in the demo.", file)
    return parameters


def _gains(robot: DemoRobot, law: str, scene: Scene) -> dict[str, Any]:
    if law == "sliding_mode":
        layer = [round(_LAYER * gain / RATE, 9) for gain in robot.gain]
        return {"bandwidth": [_BANDWIDTH], "gain": list(robot.gain), "boundary_layer": layer}
    if law == "super_twisting":
        rate = list(robot.disturbance_rate)
        return {"bandwidth": [_BANDWIDTH], "disturbance_rate": rate}
    if law == "gravity_compensation":
        mobility = scene.controlled_joints().response(scene.initial).mobility
        inertia = 1.0 / np.diag(mobility)
        stiffness, damping = _SOFTNESS**2 * inertia, 2.0 * _SOFTNESS * inertia
        return {"stiffness": stiffness.round(6).tolist(), "damping": damping.round(6).tolist()}
    return {"kp": [_BANDWIDTH**2], "kd": [2.0 * _BANDWIDTH]}


@contextmanager
def replacing_folder(path: Path, known: Collection[str]) -> Iterator[Path]:
    """A new folder to fill that becomes `path` when the `with` block ends well.

    Args:
        path: A folder, which need not exist; only one that holds nothing but `known` is replaced.
        known: Names of what may be there from the last time.

    Raises:
        DataError: The place is taken, or cannot be written to.
    """
    path = Path(os.path.abspath(path))
    _check(path, known)
    try:
        room = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=path.parent))
    except OSError as error:
        raise DataError(f"{path}: cannot be written ({error.strerror})") from error
    try:
        new = room / path.name
        new.mkdir()
        yield new
        _check(path, known)
        _put(new, path, room / "old")
    finally:
        shutil.rmtree(room, ignore_errors=True)


def _check(path: Path, known: Collection[str]) -> None:
    if not path.parent.is_dir():
        raise DataError(f"{path}: directory {path.parent} does not exist")
    if not (path.exists() or path.is_symlink()):
        return
    if path.is_symlink() or not path.is_dir():
        raise DataError(f"{path}: exists and is no folder, not replaced")
    if strange := sorted({entry.name for entry in path.iterdir()} - set(known)):
        raise DataError(f"{path}: holds {strange[0]}, which is not of a demo; not replaced")


def _put(new: Path, path: Path, old: Path) -> None:
    try:
        if path.exists():
            os.rename(path, old)
        os.rename(new, path)
    except OSError as error:
        with suppress(OSError):
            os.rename(old, path)
        raise DataError(f"{path}: cannot be written ({error.strerror})") from error
