"""A scene and a description whose segments have a person's size and mass: `mbd-ros scale`."""

from collections.abc import Iterator, Mapping
from copy import deepcopy
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import yaml

from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.model.points import rotation_matrix
from mbd_ros.core.model.xml_tree import xml_tree
from mbd_ros.core.state import Array
from mbd_ros.errors import DataError, ModelError, SceneError
from mbd_ros.features.markers.marker_kinematics import markers_of
from mbd_ros.features.markers.scale.task import ScaleTask
from mbd_ros.files.output_folder import comment_line, file_stem, write_files
from mbd_ros.jobs.arguments import about
from mbd_ros.jobs.progress import Say
from mbd_ros.motion.recordings import Capture, Source, read_capture
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.from_python import scene_from
from mbd_ros.scene.schema.nearest import nearest
from mbd_ros.scene.task_reader import read_task

_UNSCALED = ("constraints", "contacts", "forces", "actuators", "external_wrenches")
Entries = dict[str, Any]
Element = ElementTree.Element
_MOMENTS = {
    "ixx": (0, 0),
    "ixy": (0, 1),
    "ixz": (0, 2),
    "iyy": (1, 1),
    "iyz": (1, 2),
    "izz": (2, 2),
}
_SANE = (0.2, 5.0)  # factors that a person may have
_AXES = "xyz"
_LENGTHS = ("optimal_fiber_length", "tendon_slack_length")
_WIDTH = 140


def scaled(
    scene: Scene, static: Source, task: ScaleTask | str | Path, say: Say | None = None
) -> Scene:
    """Scale the segments and the mass of a scene to a person, from a static trial.

    Args:
        scene: The scene, with one robot and its markers.
        static: Result or file of markers of a person who stands still.
        task: Measurements of the segments, or their task file.
        say: Called with each line for people.

    Raises:
        DataError: The markers cannot be read, or a measurement is not possible.
        SceneError: The task or the scene cannot be used.
    """
    measurements = task if isinstance(task, ScaleTask) else _read(scene, task)
    entries, text = scaled_entries(scene, static, measurements, say or (lambda line: None))
    return scene_from(entries, urdf=text)


def _read(scene: Scene, path: str | Path) -> ScaleTask:
    parts = read_task(path, scene).parts
    if "scale" not in parts:
        raise SceneError(f"{path}: has no section 'scale'")
    task: ScaleTask = parts["scale"]
    return task


def scale_to(scene: Scene, static: Path, task: Path, folder: Path, say: Say) -> None:
    """Write <name>.urdf and <name>.yaml of a scaled scene; both, or none.

    Raises:
        MbdError: An error of `scaled`, or a file that cannot be written.
    """
    measurements = _read(scene, task)
    with about(task):
        entries, text = scaled_entries(scene, static, measurements, say)
    scene_from(entries, urdf=text)
    name = file_stem(measurements.name)
    robot = {"urdf": f"{name}.urdf", **entries["robot"]}
    body = yaml.safe_dump(
        {**entries, "robot": robot}, sort_keys=False, default_flow_style=None, width=_WIDTH
    )
    head = comment_line(f"{measurements.name}: {Path(scene.name).name}, scaled by {static.name}.")
    write_files(folder, {f"{name}.urdf": text.encode(), f"{name}.yaml": (head + body).encode()})
    say(f"{folder / f'{name}.yaml'}")


def scaled_entries(
    scene: Scene, static: Source, task: ScaleTask, say: Say
) -> tuple[dict[str, Any], str]:
    """Return the entries of the scaled scene without its description, and the description."""
    robot = scene.robot
    if (
        len(robot.model_sources) != 1
        or robot.model_sources[0].name
        or robot.model_sources[0].shape
    ):
        raise SceneError(f"{scene.name}: scale accepts scenes with one robot only")
    capture = read_capture(static, task.unit).between(task.begin, task.end)
    factors = factors_of(scene, capture, task)
    model_source = robot.model_sources[0]
    urdf = ScaledUrdf(model_source.text, factors, task.mass, task.by_volume)
    stretch = {(model_source.rename or {}).get(n, n): f for n, f in urdf.stretch.items()}
    entries = scaled_sections(scene.entries, factors, stretch)
    robot_entry = entries.get("robot") or {}
    entries["robot"] = {k: v for k, v in robot_entry.items() if k not in ("urdf", "osim", "mjcf")}
    if entries.get("muscles"):
        entries["muscles"] = _scaled_muscles(scene, scene_from(_without(entries), urdf=urdf.text))
    for line in factor_lines(factors):
        say(line)
    say(f"mass {urdf.mass:.6g} kg -> {urdf.mass if task.mass is None else task.mass:.6g} kg")
    for key in left_as_they_are(scene.entries):
        say(f"warning: section {key} is not scaled")
    return entries, urdf.text


def _scaled_muscles(scene: Scene, new: Scene) -> list[dict[str, Any]]:
    """Return muscles whose lengths scale with those of their paths at the start."""
    before, after = _lengths(scene), _lengths(new)
    muscles = []
    for entry in scene.entries["muscles"]:
        path = entry.get("path")
        ratio = after[path] / before[path] if path in after and before[path] else 1.0
        lengths = {key: ratio * entry[key] for key in _LENGTHS if key in entry}
        muscles.append({**entry, **lengths})
    return muscles


def _lengths(scene: Scene) -> dict[str, float]:
    k, x = Kinematics(scene.robot), scene.initial
    k.refresh(x.q, x.v)
    return {name: float(path.length(k, x)) for name, path in scene.parts["paths"].items()}


def _without(entries: Mapping[str, Any]) -> dict[str, Any]:
    return {key: entry for key, entry in entries.items() if key != "muscles"}


def factor_lines(factors: Mapping[str, Array]) -> Iterator[str]:
    """Yield a line for each link."""
    for link, (x, y, z) in factors.items():
        yield f"{link}: x {x:.6g}, y {y:.6g}, z {z:.6g}"


def factors_of(scene: Scene, capture: Capture, task: ScaleTask) -> dict[str, Array]:
    """Compute the scale factors along the axes of each link, shape (3,).

    Args:
        scene: The scene, with the distances of its markers at its start.
        capture: The static trial, with distances averaged over its frames.
        task: Measurements of the segments.

    Raises:
        DataError: A link or marker is unknown, a marker was not seen, or a factor is implausible.
    """
    model, seen = _model_markers(scene), _seen(capture)
    factors = {}
    for link, measurements in task.segments.items():
        try:
            scene.robot.frame(link)
        except ModelError as error:
            raise DataError(f"scale: {error}") from error
        factor = np.ones(3)
        for measurement in measurements:
            value = measurement.factor
            if value is None:
                ratios = [_ratio(capture.where, model, seen, *pair) for pair in measurement.pairs]
                value = float(np.mean(ratios))
            if not _SANE[0] <= value <= _SANE[1]:
                raise DataError(
                    f"{capture.where}: {link} would be scaled by {value:.4g}, accepted: "
                    f"{_SANE[0]:g} .. {_SANE[1]:g}; check the unit of the markers"
                )
            factor[[_AXES.index(axis) for axis in measurement.axes]] = value
        factors[link] = factor
    return factors


def _model_markers(scene: Scene) -> dict[str, Array]:
    """Return the positions of markers in the model at the start, by label."""
    k, x = Kinematics(scene.robot), scene.initial
    k.refresh(x.q, x.v)
    return {m.title: np.array(k.position(m.point)) for m in markers_of(scene)}


def _seen(capture: Capture) -> dict[str, Array]:
    """Return the recorded positions of markers by label, shape (N, 3)."""
    return {label: capture.places[:, i] for i, label in enumerate(capture.labels)}


def _ratio(
    where: str, model: Mapping[str, Array], seen: Mapping[str, Array], a: str, b: str
) -> float:
    for label in (a, b):
        for known, source in ((model, "the scene"), (seen, where)):
            if label not in known:
                close = nearest(label, known, 1)
                hint = f"; the nearest is {close[0]}" if close else ""
                raise DataError(f"scale: no marker {label} in {source}{hint}")
    measured = np.linalg.norm(seen[a] - seen[b], axis=1)
    measured = measured[np.isfinite(measured)]
    in_model = float(np.linalg.norm(model[a] - model[b]))
    if not len(measured) or in_model < 1.0e-6:
        why = "are never seen together" if not len(measured) else "coincide in the scene"
        raise DataError(f"{where}: markers {a} and {b} {why}")
    return float(measured.mean()) / in_model


def scaled_sections(
    entries: Mapping[str, Any], factors: Mapping[str, Array], stretch: Mapping[str, float]
) -> Entries:
    """Return sections with scaled positions; muscles are scaled by the lengths of their paths.

    Args:
        entries: Sections of the scene.
        factors: Factors along the axes of each link, shape (3,).
        stretch: Factor of the position of each prismatic joint.

    Raises:
        DataError: A coupling follows a joint that is stretched itself.
    """
    scaled = deepcopy(dict(entries))
    for entry in scaled.get("sensors", {}).values():
        _scale_place(entry, "xyz", factors.get(entry.get("frame")))
    for path in scaled.get("paths", {}).values():
        for point in path.get("points", []):
            factor = factors.get(point.get("frame"))
            _scale_place(point, "xyz", factor)
            _scale_moves(point.get("moves"), factor)
        for wrap in path.get("wraps", []):
            _scale_wrap(wrap, factors.get(wrap.get("frame")))
    for joint, entry in scaled.get("couplings", {}).items():
        if stretch.get(entry["parent"], 1.0) != 1.0:
            raise DataError(
                f"scale: coupling {joint} follows {entry['parent']}, a sliding joint of a scaled "
                "segment, which is not served"
            )
        _scale_function(entry, stretch.get(joint, 1.0))
    return scaled


def _scale_place(entry: Entries, key: str, factor: Array | None) -> None:
    if factor is not None and key in entry:
        entry[key] = (factor * np.array(entry[key], dtype=np.float64)).tolist()


def _scale_moves(moves: Entries | None, factor: Array | None) -> None:
    if moves is None or factor is None:
        return
    for i, axis in enumerate(_AXES):
        if isinstance(moves.get(axis), dict):
            _scale_function(moves[axis], float(factor[i]))


def _scale_function(entry: Entries, factor: float) -> None:
    """Values of a coupling function, wherever its kind keeps them."""
    if factor == 1.0:
        return
    for key in ("factor", "offset", "polynomial"):
        if key in entry:
            entry[key] = _times(entry[key], factor)
    if not {"factor", "polynomial"} & entry.keys() and "offset" in entry:
        entry["factor"] = factor
    for key in ("spline", "simm_spline", "linear"):
        if isinstance(entry.get(key), dict):
            entry[key]["y"] = _times(entry[key]["y"], factor)
    if "piecewise_polynomial" in entry:
        pieces = entry["piecewise_polynomial"]
        pieces["coefficients"] = _times(pieces["coefficients"], factor)


def _times(value: Any, factor: float) -> Any:
    if isinstance(value, dict):
        return {key: _times(one, factor) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_times(one, factor) for one in value]
    return factor * value


def _scale_wrap(wrap: Entries, factor: Array | None) -> None:
    """Place by axes; radii and lengths by the mean of the factors."""
    if factor is None:
        return
    if isinstance(wrap.get("pose"), dict):
        _scale_place(wrap["pose"], "xyz", factor)
    mean = float(factor.mean())
    for key in ("cylinder", "sphere", "ellipsoid", "torus"):
        if key in wrap:
            wrap[key] = _times(wrap[key], mean)


class ScaledUrdf:
    """A scaled description.

    Args:
        factors: Link -> factors along its axes, shape (3,).
        mass: Of all links [kg]; None keeps it.
        by_volume: Whether masses follow volumes; else each keeps its share.

    Attributes:
        text: URDF, scaled.
        stretch: Sliding joint -> factor of its position.
        mass: Of all links before [kg].
    """

    def __init__(
        self, text: str, factors: Mapping[str, Array], mass: float | None, by_volume: bool
    ) -> None:
        tree = xml_tree(text)
        self._factors, self.stretch = dict(factors), dict[str, float]()
        self._links = {link.get("name", ""): link for link in tree.findall("link")}
        above = {_child(joint): joint for joint in tree.findall("joint")}
        for name in self._links:
            if name not in above:
                self._place(name, self._factors.get(name, np.ones(3)), np.eye(3), tree)
        self.mass = self._scale_masses(mass, by_volume)
        self.text = ElementTree.tostring(tree, encoding="unicode")

    def _place(self, link: str, factor: Array, turn: Array, tree: Element) -> None:
        """Scale the joints that hang on a link.

        Args:
            factor: Of the segment that it belongs to.
            turn: From its axes to those of that segment, shape (3, 3).
        """
        for joint in tree.findall("joint"):
            if _parent(joint) != link:
                continue
            child, origin = _child(joint), _origin(joint)
            R = rotation_matrix(_numbers(origin, "rpy"))
            xyz = np.array(_numbers(origin, "xyz"))
            begins = self._is_segment(child)
            factors = self._factors.get(child, np.ones(3)) if begins else factor
            if begins and not self._is_segment(link):  # the place of the joint in the child
                xyz = R @ (factors * (R.T @ xyz))
            else:
                xyz = turn.T @ (factor * (turn @ xyz))
            origin.set("xyz", " ".join(map(repr, xyz.tolist())))
            if joint.get("type") == "prismatic":
                axis = joint.find("axis")
                along = turn @ R @ np.array(_numbers(axis, "xyz", (1.0, 0.0, 0.0)))
                along /= np.linalg.norm(along)
                self.stretch[joint.get("name", "")] = float(np.linalg.norm(factor * along))
            self._place(child, factors, np.eye(3) if begins else turn @ R, tree)

    def _is_segment(self, link: str) -> bool:
        return link in self._factors or self._links[link].find("inertial") is not None

    def _scale_masses(self, mass: float | None, by_volume: bool) -> float:
        bodies = {
            n: e for n, link in self._links.items() if (e := link.find("inertial")) is not None
        }
        before = {name: _value(e, "mass", "value") for name, e in bodies.items()}
        factors = {name: self._factors.get(name, np.ones(3)) for name in bodies}
        volumes = {n: float(factors[n].prod()) if by_volume else 1.0 for n in bodies}
        total = sum(before.values())
        new = sum(before[name] * volumes[name] for name in bodies)
        share = (total if mass is None else mass) / new if new else 1.0
        for name, element in bodies.items():
            after = before[name] * volumes[name] * share
            _scale_inertia(element, factors[name], before[name], after)
        return total


def _child(joint: Element) -> str:
    found = joint.find("child")
    return "" if found is None else found.get("link", "")


def _parent(joint: Element) -> str:
    found = joint.find("parent")
    return "" if found is None else found.get("link", "")


def _origin(element: Element) -> Element:
    found = element.find("origin")
    return ElementTree.SubElement(element, "origin") if found is None else found


def _numbers(
    element: Element | None, key: str, default: tuple[float, ...] = (0.0, 0.0, 0.0)
) -> list[float]:
    text = "" if element is None else element.get(key, "")
    return [float(word) for word in text.split()] or list(default)


def _value(element: Element, tag: str, key: str) -> float:
    found = element.find(tag)
    return 0.0 if found is None else float(found.get(key, "0"))


def _scale_inertia(element: Element, factor: Array, before: float, after: float) -> None:
    origin = _origin(element)
    centre = factor * np.array(_numbers(origin, "xyz"))
    origin.set("xyz", " ".join(map(repr, centre.tolist())))
    mass, moments = element.find("mass"), element.find("inertia")
    if mass is None or moments is None:
        raise DataError("an <inertial> lacks <mass> or <inertia>")
    mass.set("value", repr(after))
    tensor = np.zeros((3, 3))
    for key, (i, j) in _MOMENTS.items():
        tensor[i, j] = tensor[j, i] = float(moments.get(key, "0"))
    R = rotation_matrix(_numbers(origin, "rpy"))
    stretch = R.T @ np.diag(factor) @ R
    spread = 0.5 * np.trace(tensor) * np.eye(3) - tensor
    spread = (after / before if before else 1.0) * stretch @ spread @ stretch.T
    tensor = np.trace(spread) * np.eye(3) - spread
    for key, (i, j) in _MOMENTS.items():
        moments.set(key, repr(float(tensor[i, j])))


def left_as_they_are(entries: Mapping[str, Any]) -> list[str]:
    """Keys of sections with places or sizes that are not scaled."""
    return [key for key in _UNSCALED if entries.get(key)]
