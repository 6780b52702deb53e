"""Scene file -> parts. An absent section is an absent feature: not built, not imported."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.parts import Actuator
from mbd_ros.core.ranges import Unlimited
from mbd_ros.core.simulation.safe_command import SafeCommand
from mbd_ros.errors import ModelError, SceneError
from mbd_ros.scene import schema
from mbd_ros.scene.built_scene import Scene, refuse_dt
from mbd_ros.scene.code_permission import code_of_others, require_permission
from mbd_ros.scene.coupling_entries import coupling_functions
from mbd_ros.scene.locate import find_scene
from mbd_ros.scene.part_entries import (
    Solver,
    build_constraints,
    build_part,
    build_parts,
    build_wrenches,
    initial_state,
)
from mbd_ros.scene.robot_entry import build_robot, read_entry
from mbd_ros.scene.strict_yaml import read_mapping

SECTIONS = (
    "robot",
    "couplings",
    "external_wrenches",
    "constraints",
    "forces",
    "actuators",
    "stabilization",
    "solver",
    "integrator",
    "dt",
    "initial",
    "safe",
)
DEFAULT_DT = 1.0e-3  # s


def load_scene(path: str | Path, description: str | None = None) -> Scene:
    """Read and build a scene.

    Args:
        path: Scene file, `package://<package>/<path>`, or the name of an embedded scene.
        description: URDF that arrived on the `description_topic` of the scene.

    Raises:
        SceneError: Names file, key, what is wrong and what is accepted; or code of others that
            `permitting` does not allow.
    """
    path = find_scene(path)
    given = _read_sections(path)
    code = code_of_others(given)
    require_permission(str(path), code)
    robot, source = build_robot(path, read_entry(path, given["robot"]), description)
    couplings, kinds = _build_couplings(path, robot, given.get("couplings", {}))
    actuators = build_parts(path, "actuators", robot, given.get("actuators", []))
    robot = _with_armature(robot, actuators)
    return Scene(
        path=path,
        source=source,
        robot=robot,
        couplings=couplings,
        coupling_kinds=kinds,
        wrenches=build_wrenches(path, robot, given.get("external_wrenches", {})),
        constraints=build_constraints(path, robot, given.get("constraints", [])),
        forces=build_parts(path, "forces", robot, given.get("forces", [])),
        actuators=actuators,
        stabilization=_single(path, "stabilization", "stabilization", given),
        solver=schema.call(Solver, given.get("solver", {}), f"{path}: solver"),
        integrator=_single(path, "integrator", "integrators", given),
        integrator_entry=given.get("integrator", {}),
        dt=_step(path, given.get("dt", DEFAULT_DT)),
        initial=initial_state(path, robot, couplings, given.get("initial", {})),
        safe=schema.call(SafeCommand, given.get("safe", {}), f"{path}: safe"),
        code=code,
        absent=tuple(section for section in SECTIONS if not given.get(section)),
    )


def description_topic(path: str | Path) -> str | None:
    """Topic from which the scene takes its robot description; None where it names a file.

    Raises:
        SceneError: The file cannot be read, or its robot section is wrong.
    """
    path = find_scene(path)
    return read_entry(path, _read_sections(path)["robot"]).description_topic


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


def _build_couplings(
    path: Path, robot: Robot, section: Any
) -> tuple[Couplings, Mapping[str, str]]:
    functions = coupling_functions(path, section)
    try:
        couplings = Couplings(robot, {name: coupling for name, (coupling, _) in functions.items()})
    except ModelError as error:
        raise SceneError(f"{path}: couplings: {error}") from error
    kinds = {mimic.joint: "URDF mimic" for mimic in robot.mimics}
    kinds |= {name: kind for name, (_, kind) in functions.items()}
    return couplings, {n: f"{couplings.parents[n]} ({kinds[n]})" for n in couplings.dependent}


def _single(path: Path, key: str, section: str, given: Mapping[str, Any]) -> Any:
    return build_part(section, given[key], f"{path}: {key}") if key in given else None


def _step(path: Path, given: Any) -> float:
    dt: float = schema.value(given, Unlimited, f"{path}: dt")
    refuse_dt(dt, f"{path}: dt", SceneError)
    return dt


def _with_armature(robot: Robot, actuators: Sequence[Actuator]) -> Robot:
    """The robot with the inertia that its drives add to the joints."""
    added = sum(actuator.armature() for actuator in actuators)
    if not actuators or not added.any():
        return robot
    model = robot.model.copy()
    model.armature = model.armature + added
    return replace(robot, model=model)
