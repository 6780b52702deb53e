"""Sections of parts -> parts; what they import is what the scene names."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mbd_ros.core.dynamics.tiers import TIERS
from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.model.wrenches import ExternalWrench
from mbd_ros.core.optimization.qp import check_backend
from mbd_ros.core.state import State
from mbd_ros.errors import ModelError, SceneError
from mbd_ros.scene import schema
from mbd_ros.scene.registry import PARTS, resolve

MAX_PARTS = 1000  # in one section
MAX_ROWS = 600  # of all constraints: a solve costs their number cubed
_WORD = "[A-Za-z_][A-Za-z0-9_]*"  # of a ROS 2 name
_NAME, _TOPIC = re.compile(_WORD), re.compile(f"(~?/)?{_WORD}(/{_WORD})*")


@dataclass(frozen=True)
class MeasuredWrench:
    """An external load and the topic that carries it; None stands for `~/wrench/<name>`."""

    load: ExternalWrench
    topic: str | None


@dataclass(frozen=True)
class Solver:
    """The `solver` section.

    Attributes:
        type: A tier of `mbd_ros.core.dynamics.tiers`.
        backend: Solver of the QP: proxqp, or one that qpsolvers knows.
    """

    type: str = "auto"
    backend: str = "proxqp"

    def __post_init__(self) -> None:
        if self.type not in TIERS:
            raise ModelError(f"unknown solver type '{self.type}', accepted: {', '.join(TIERS)}")
        check_backend(self.backend)


@dataclass(frozen=True)
class _Initial:
    """The `initial` section; joints that it leaves out start at 0."""

    position: Mapping[str, float] | None = None
    velocity: Mapping[str, float] | None = None


def build_wrenches(path: Path, robot: Robot, entries: Any) -> dict[str, MeasuredWrench]:
    """The `external_wrenches` section.

    Raises:
        SceneError: Names key, what is wrong and what is accepted.
    """
    entries = schema.value(entries, Mapping[str, Any], f"{path}: external_wrenches")
    if len(entries) > MAX_PARTS:
        what = f"{path}: external_wrenches"
        raise SceneError(f"{what}: {len(entries)} entries, accepted are {MAX_PARTS}")
    wrenches = {}
    for name, entry in entries.items():
        where = f"{path}: external_wrenches.{name}"
        if not _NAME.fullmatch(str(name)):
            raise SceneError(
                f"{where}: is no ROS name, accepted: letters, digits and _, no digit first"
            )
        entry = dict(schema.value(entry, Mapping[str, Any], where))
        topic = schema.value(entry.pop("topic", None), str | None, f"{where}.topic")
        if topic is not None and not _TOPIC.fullmatch(topic):
            raise SceneError(
                f"{where}.topic: '{topic}' is no ROS topic, accepted: words of letters, digits "
                "and _, no digit first, joined by single /, perhaps after / or ~/"
            )
        wrenches[name] = MeasuredWrench(schema.call(ExternalWrench, entry, where, robot), topic)
    return wrenches


def build_parts(path: Path, section: str, robot: Robot, entries: Any) -> tuple[Any, ...]:
    """A section that lists parts of a robot."""
    entries = schema.value(entries, Sequence[Any], f"{path}: {section}")
    if len(entries) > MAX_PARTS:
        raise SceneError(f"{path}: {section}: {len(entries)} entries, accepted are {MAX_PARTS}")
    return tuple(
        build_part(section, entry, f"{path}: {section}[{i}]", robot)
        for i, entry in enumerate(entries)
    )


def build_constraints(path: Path, robot: Robot, entries: Any) -> tuple[Any, ...]:
    """The `constraints` section.

    Raises:
        SceneError: Names key, what is wrong and what is accepted.
    """
    parts = build_parts(path, "constraints", robot, entries)
    rows = sum(len(part.rows) for part in parts)
    if rows > MAX_ROWS:
        raise SceneError(f"{path}: constraints: {rows} rows, accepted are {MAX_ROWS}")
    return parts


def build_part(section: str, given: Any, where: str, *context: Any) -> Any:
    """The part of an entry with `type`.

    Args:
        section: Key of the registry.
        given: The entry.
        where: File and key, for the messages.
        *context: First arguments of the part, which do not come from the YAML.

    Raises:
        SceneError: Names key, what is wrong and what is accepted.
    """
    if isinstance(given, str) and given in PARTS[section]:
        raise SceneError(f"{where}: expected a mapping, got '{given}': write {{type: {given}}}")
    entry = dict(schema.value(given, Mapping[str, Any], where))
    if entry.get("type") is None:
        accepted = ", ".join(PARTS[section])
        raise SceneError(
            f"{where}: key 'type' is missing, accepted: {accepted}, or package.module:Class"
        )
    name = schema.value(entry.pop("type"), str, f"{where}.type")
    return schema.call(resolve(section, name, f"{where}.type"), entry, where, *context)


def initial_state(path: Path, robot: Robot, couplings: Couplings, section: Any) -> State:
    """The `initial` section as a state of all joints; dependent joints follow."""
    where = f"{path}: initial"
    initial: _Initial = schema.call(_Initial, section, where)
    q, v = np.array(robot.neutral()), np.zeros(robot.model.nv)
    for key, values, index in (
        ("position", initial.position, "q"),
        ("velocity", initial.velocity, "v"),
    ):
        for name, number in (values or {}).items():
            if name in couplings.dependent:
                raise SceneError(
                    f"{where}.{key}.{name}: follows {couplings.parents[name]}, leave it out"
                )
            try:
                joint = robot.joint(name)
            except ModelError as error:
                raise SceneError(f"{where}.{key}: {error}") from error
            (q if index == "q" else v)[getattr(joint, index)] = number
    couplings.expand(q, v, np.zeros(robot.model.nv))
    return State(0.0, q, v)
