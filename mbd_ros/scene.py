"""Scene file -> parts. An absent section is an absent feature: not built, not imported."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mbd_ros import schema
from mbd_ros.core.couplings import Couplings
from mbd_ros.core.inverse_dynamics import InverseDynamics
from mbd_ros.core.parts import ForceTerm
from mbd_ros.core.robot import Robot
from mbd_ros.core.robot_reader import EARTH_GRAVITY, read_robot
from mbd_ros.core.urdf import MAX_CHARACTERS
from mbd_ros.core.wrenches import ExternalWrench
from mbd_ros.coupling_entries import coupling_laws
from mbd_ros.errors import ModelError, SceneError
from mbd_ros.locate import find_file
from mbd_ros.registry import resolve
from mbd_ros.strict_yaml import read_mapping, read_text

SECTIONS = ("robot", "couplings", "external_wrenches", "forces")


@dataclass(frozen=True)
class MeasuredWrench:
    """An external load and the topic that carries it; None stands for `~/wrench/<name>`."""

    load: ExternalWrench
    topic: str | None


@dataclass(frozen=True)
class Scene:
    """What a scene file describes, built.

    Attributes:
        path: The file.
        source: File or topic of the robot description.
        robot: The robot.
        couplings: Its dependent joints.
        laws: Dependent joint -> parent and kind of law, for people.
        wrenches: External loads by name.
        forces: Force terms.
        absent: Sections that the file leaves out.
    """

    path: Path
    source: str
    robot: Robot
    couplings: Couplings
    laws: Mapping[str, str]
    wrenches: Mapping[str, MeasuredWrench]
    forces: tuple[ForceTerm, ...]
    absent: tuple[str, ...]

    def inverse_dynamics(self) -> InverseDynamics:
        """A solver with its own Pinocchio data."""
        loads = [wrench.load for wrench in self.wrenches.values()]
        return InverseDynamics(self.robot, self.couplings, loads, self.forces)


@dataclass(frozen=True)
class _RobotEntry:
    """The `robot` section."""

    urdf: str | None = None
    description_topic: str | None = None
    gravity: Sequence[float] = EARTH_GRAVITY
    base: str = "fixed"
    locked: Mapping[str, float] | None = None
    rename: Mapping[str, str] | None = None


def load_scene(path: str | Path, description: str | None = None) -> Scene:
    """Read and build a scene.

    Args:
        path: Scene file, or `package://<package>/<path>`.
        description: URDF that arrived on the `description_topic` of the scene.

    Raises:
        SceneError: Names file, key, what is wrong and what is accepted.
    """
    path = find_file(Path(), str(path), "scene")
    sections = _read_sections(path)
    entry = _robot_entry(path, sections)
    robot, source = _build_robot(path, entry, description)
    laws = coupling_laws(path, sections.get("couplings", {}))
    try:
        couplings = Couplings(robot, {name: coupling for name, (coupling, _) in laws.items()})
    except ModelError as error:
        raise SceneError(f"{path}: couplings: {error}") from error
    kinds = {m.joint: "URDF mimic" for m in robot.mimics} | {n: k for n, (_, k) in laws.items()}
    return Scene(
        path=path,
        source=source,
        robot=robot,
        couplings=couplings,
        laws={n: f"{couplings.parents[n]} ({kinds[n]})" for n in couplings.dependent},
        wrenches=_build_wrenches(path, robot, sections.get("external_wrenches", {})),
        forces=_build_parts(path, "forces", robot, sections.get("forces", [])),
        absent=tuple(section for section in SECTIONS if not sections.get(section)),
    )


def description_topic(path: str | Path) -> str | None:
    """Topic from which the scene takes its robot description; None where it names a file.

    Raises:
        SceneError: The file cannot be read, or its robot section is wrong.
    """
    path = find_file(Path(), str(path), "scene")
    return _robot_entry(path, _read_sections(path)).description_topic


def _read_sections(path: Path) -> dict[str, Any]:
    sections = read_mapping(path)
    for key in sections:
        if key not in SECTIONS:
            raise SceneError(f"{path}: unknown key '{key}', accepted: {', '.join(SECTIONS)}")
    if "robot" not in sections:
        raise SceneError(f"{path}: key 'robot' is missing")
    return {
        key: section for key, section in sections.items() if section is not None or key == "robot"
    }


def _robot_entry(path: Path, sections: Mapping[str, Any]) -> _RobotEntry:
    entry: _RobotEntry = schema.call(_RobotEntry, sections["robot"], f"{path}: robot")
    if (entry.urdf is None) == (entry.description_topic is None):
        raise SceneError(f"{path}: robot: give either 'urdf' or 'description_topic'")
    if len(entry.gravity) != 3:
        raise SceneError(f"{path}: robot.gravity: expected 3 numbers, got {entry.gravity}")
    return entry


def _build_robot(path: Path, entry: _RobotEntry, description: str | None) -> tuple[Robot, str]:
    if entry.urdf is not None:
        source, text = _read_urdf(path, entry.urdf)
    elif description is not None:
        source, text = f"topic {entry.description_topic}", description
    else:
        raise SceneError(
            f"{path}: robot: the description comes from topic {entry.description_topic}, which "
            "only a node can read; give 'urdf' to use the scene offline"
        )
    try:
        robot = read_robot(
            text,
            source=source,
            gravity=entry.gravity,
            base=entry.base,
            locked=entry.locked,
            rename=entry.rename,
        )
    except ModelError as error:
        raise SceneError(f"{path}: robot: {error}") from error
    return robot, source


def _read_urdf(path: Path, name: str) -> tuple[str, str]:
    where = f"{path}: robot.urdf"
    file = find_file(path.parent, name, where)
    try:
        return str(file), read_text(file, MAX_CHARACTERS, "robot description")
    except SceneError as error:
        raise SceneError(f"{where}: {error}") from error


def _build_wrenches(path: Path, robot: Robot, entries: Any) -> dict[str, MeasuredWrench]:
    entries = schema.value(entries, Mapping[str, Any], f"{path}: external_wrenches")
    wrenches = {}
    for name, entry in entries.items():
        where = f"{path}: external_wrenches.{name}"
        entry = dict(schema.value(entry, Mapping[str, Any], where))
        topic = schema.value(entry.pop("topic", None), str | None, f"{where}.topic")
        wrenches[name] = MeasuredWrench(schema.call(ExternalWrench, entry, where, robot), topic)
    return wrenches


def _build_parts(path: Path, section: str, robot: Robot, entries: Any) -> tuple[Any, ...]:
    parts = []
    for i, given in enumerate(schema.value(entries, Sequence[Any], f"{path}: {section}")):
        where = f"{path}: {section}[{i}]"
        entry = dict(schema.value(given, Mapping[str, Any], where))
        name = schema.value(entry.pop("type", None), str, f"{where}.type")
        parts.append(schema.call(resolve(section, name, f"{where}.type"), entry, where, robot))
    return tuple(parts)
