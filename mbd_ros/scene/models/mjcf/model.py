"""A model of MuJoCo -> a robot description and the sections of a scene."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

from mbd_ros.core.model.xml_tree import MAX_DEPTH
from mbd_ros.errors import SceneError
from mbd_ros.scene.models.imported_model import (
    NO_PLACE,
    Imported,
    LeftOut,
    parse_document,
    read_text,
)
from mbd_ros.scene.models.mjcf.actuators import add_rotors, read_actuators, read_tendons
from mbd_ros.scene.models.mjcf.bodies import WORLD, Bodies
from mbd_ros.scene.models.mjcf.equalities import read_closures, read_couplings
from mbd_ros.scene.models.mjcf.inertia import Meshes, body_inertia, geom_type, mass_of
from mbd_ros.scene.models.mjcf.item import Compiler, Defaults, compiler_of
from mbd_ros.scene.models.mjcf.mechanism import Tree, passive, unexpressed
from mbd_ros.scene.models.mjcf.reading import Reading
from mbd_ros.scene.models.urdf_text import Mass, joint_titles, plain, urdf_text, xyz_rpy

SECTIONS = (
    *("compiler", "option", "size", "statistic", "visual", "default", "custom", "asset"),
    *("worldbody", "contact", "equality", "tendon", "actuator", "sensor", "keyframe"),
    *("extension", "deformable"),
)
MAX_FILES = 100
_GRAVITY = (0.0, 0.0, -9.81)  # m/s^2, MuJoCo's default
_MEDIUM = ("density", "viscosity", "wind")


def import_mjcf(path: Path, locked: Mapping[str, float | None] | None = None) -> Imported:
    """Read a model of MuJoCo.

    Args:
        locked: Joint -> position [rad or m] where it is to be locked, or None where one that an
            equality holds still is to move.

    Raises:
        SceneError: Names file, element and what is wrong.
    """
    source, root = str(path), read_document(path)
    defaults, compiler = Defaults(root, source), compiler_of(root, source)
    bodies = Bodies(root, defaults, compiler, source)
    tree = Tree(bodies, compiler)
    reading = Reading(root, source, defaults, compiler, tree)
    masses = _masses(tree, compiler, Meshes(root, defaults, path))
    wanted = {name: value for name, value in (locked or {}).items() if value is not None}
    reading.fixed |= wanted
    couplings = read_couplings(reading)
    for name in (locked or {}).keys() - wanted.keys():
        reading.fixed.pop(name, None)
    sections = _sections(reading, couplings)
    _leave_out_others(reading)
    name = root.get("model") or "model"
    titles = joint_titles(tree.links, tree.joints)
    text = urdf_text(plain(name) or "model", tree.links, tree.joints, masses, titles)
    robot = _robot(reading, masses, titles)
    return Imported(name, text, robot, sections, tuple(reading.left_out))


def read_document(path: Path) -> Element:
    """The element `<mujoco>` with what it includes.

    Raises:
        SceneError: Missing, no XML, another format, an unknown section, or an include that leads
            in a circle; names the file.
    """
    root = parse_document(read_text(path), str(path))
    if root.tag != "mujoco":
        raise SceneError(f"{path}: expected <mujoco>, found <{root.tag}>")
    _include(root, path, path.parent, [path.resolve()], 0)
    for section in root:
        if section.tag not in SECTIONS:
            raise SceneError(
                f"{path}: unknown element <{section.tag}> in <mujoco>, accepted: "
                f"{', '.join(SECTIONS)}"
            )
    return root


def _include(element: Element, path: Path, folder: Path, seen: list[Path], depth: int) -> None:
    """Put the elements of included files in the places of `<include>`.

    Args:
        element: What may include.
        folder: That of the model, from which names of files start.
        seen: All files so far; MuJoCo takes each once.
        depth: Elements around this one, in all files.
    """
    if depth > MAX_DEPTH:
        raise SceneError(f"{path}: elements are nested deeper than {MAX_DEPTH} with includes")
    for child in list(element):
        if child.tag != "include":
            _include(child, path, folder, seen, depth + 1)
            continue
        file = _file(child, path, folder)
        if file.resolve() in seen:
            raise SceneError(f"{path}: <include file='{file}'> is included before")
        if len(seen) == MAX_FILES:
            raise SceneError(f"{path}: more than {MAX_FILES} files")
        seen.append(file.resolve())
        inner = parse_document(read_text(file), str(file))
        _include(inner, file, folder, seen, depth)
        at = list(element).index(child)
        element[at : at + 1] = list(inner)


def _file(include: Element, path: Path, folder: Path) -> Path:
    """The included file: from the folder of the model, else from that of the including file."""
    name = include.get("file", "")
    if not name:
        raise SceneError(f"{path}: <include> has no file")
    for file in (folder / name, path.parent / name):
        if file.exists():
            return file
    raise SceneError(f"{path}: <include file='{name}'>: there is no file {folder / name}")


def _masses(tree: Tree, compiler: Compiler, meshes: Meshes) -> dict[str, Mass]:
    """Masses of the links that move."""
    moving = {
        body.name: body_inertia(
            body.inertial[0].item if body.inertial else None,
            [(one.item, one.at) for one in body.geoms],
            compiler,
            meshes,
        )
        for body in tree.bodies.all.values()
        if tree.moves(body.name) or (compiler.total > 0.0 and body.name != WORLD)
    }
    total = sum(inertia.mass for inertia in moving.values())
    scale = compiler.total / total if compiler.total > 0.0 and total > 0.0 else 1.0
    return {name: mass_of(inertia, scale) for name, inertia in moving.items() if tree.moves(name)}


def _sections(reading: Reading, couplings: dict[str, Any]) -> dict[str, Any]:
    hinges = reading.tree.hinges
    sections: dict[str, Any] = {"couplings": couplings, "paths": reading.paths}
    sections |= {"forces": read_tendons(reading), "actuators": [], "constraints": []}
    for hinge in hinges.values():
        if (
            reading.tree.joint_names.get(hinge.name) == [hinge.name]
            and hinge.name not in reading.fixed
        ):
            for entry in passive(hinge):
                kind = entry["type"].removeprefix("joint_")
                name = reading.names.part(f"{hinge.name}_{kind}", kind)
                sections["forces"].append({"name": name, **entry})
    read_actuators(reading, sections)
    add_rotors(reading, sections)
    sections["constraints"] = read_closures(reading)
    sections["sensors"] = _markers(reading)
    start = {
        name: hinge.ref
        for name, hinge in hinges.items()
        if hinge.ref and name not in reading.fixed and name not in couplings
    }
    sections["initial"] = {"position": start} if start else {}
    return {key: entries for key, entries in sections.items() if entries}


def _markers(reading: Reading) -> dict[str, dict[str, Any]]:
    """Named sites of bodies that move, those of tendons apart."""
    markers = dict[str, dict[str, Any]]()
    held = {one.text("site") for item in reading.items("tendon") for one in reading.inner(item)}
    for body, (item, at) in reading.tree.bodies.elements("sites"):
        if not item.name or item.name in held or not reading.tree.moves(body.name):
            continue
        title = reading.names.part(item.name, "site")
        entry: dict[str, Any] = {"type": "marker", "frame": body.name}
        entry["xyz"] = at.translation.tolist()
        markers[title] = entry if title == item.name else {**entry, "label": item.name}
    return markers


def _leave_out_others(reading: Reading) -> None:
    bodies, touching = reading.tree.bodies, 0
    for _, (item, _at) in bodies.elements("joints"):
        if missing := unexpressed(item):
            reading.leave_out(item, f"without its {missing}")
    for body in bodies.all.values():
        for item in body.others:
            reading.leave_out(item, NO_PLACE)
        if "gravcomp" in body.item and body.item.number("gravcomp", 0.0):
            reading.leave_out(body.item, "without its gravcomp")
    for _, (item, _at) in bodies.elements("geoms"):
        geom_type(item)
        masks = [item.number(key, 1.0) for key in ("contype", "conaffinity")]
        touching += any(masks)
    if touching:
        reading.left_out.append(LeftOut("geom", f"{touching} that touch", "write `contacts`"))
    for section in ("sensor", "keyframe", "contact", "extension", "deformable"):
        for item in reading.items(section):
            reading.leave_out(item, NO_PLACE)


def _robot(
    reading: Reading, masses: Mapping[str, Mass], titles: Mapping[str, str]
) -> dict[str, Any]:
    tree, option = reading.tree, reading.option()
    robot: dict[str, Any] = {"gravity": option.vector("gravity", _GRAVITY)}
    if reading.is_weightless():
        robot["gravity"] = [0.0, 0.0, 0.0]
    for key in _MEDIUM:
        if key in option and any(option.numbers(key, 1, 3)):
            reading.left_out.append(LeftOut("option", key, NO_PLACE))
    if tree.base:
        robot["base"] = "floating"
        pose = xyz_rpy(tree.bodies.all[tree.base].world)
        robot |= {"pose": pose} if pose else {}
    if any(mass.is_impossible for mass in masses.values()):
        robot["any_inertias"] = True
    if reading.fixed:
        robot["locked"] = dict(reading.fixed)
    if titles:
        robot["rename"] = {title: name for name, title in titles.items()}
    return robot
