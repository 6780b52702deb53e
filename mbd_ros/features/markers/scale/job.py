"""A scene of a person's size: `mbd-ros scale`."""

from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.state import Array
from mbd_ros.errors import DataError, ModelError, SceneError
from mbd_ros.features.markers.marker_kinematics import markers_of
from mbd_ros.features.markers.scale.scaled_scene import (
    ScaledUrdf,
    left_as_they_are,
    scaled_sections,
)
from mbd_ros.features.markers.scale.task import ScaleTask
from mbd_ros.files.output_file import replacing
from mbd_ros.jobs.progress import Say
from mbd_ros.motion.recordings import Capture, Source, read_capture
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.from_python import scene_from
from mbd_ros.scene.schema.nearest import nearest
from mbd_ros.scene.task_reader import read_task

_SANE = (0.2, 5.0)  # factors that a person may have
_AXES = "xyz"
_LENGTHS = ("optimal_fiber_length", "tendon_slack_length")
_WIDTH = 140


def scaled(
    scene: Scene, static: Source, task: ScaleTask | str | Path, say: Say | None = None
) -> Scene:
    """The scene with segments of the size that a static trial shows, and its total mass.

    Args:
        scene: The scene, of one robot with markers.
        static: Result or file of markers of a person who stands still.
        task: What is measured, or the file of it.
        say: Is called with each line for people.

    Raises:
        DataError: Markers that cannot be read or measured.
        SceneError: A task or a scene that this does not serve.
    """
    asked = task if isinstance(task, ScaleTask) else _read(scene, task)
    entries, text = scaled_entries(scene, static, asked, say or (lambda line: None))
    return scene_from(entries, urdf=text)


def scale_to(scene: Scene, static: Path, task: Path, folder: Path, say: Say) -> None:
    """Write <name>.urdf and <name>.yaml of a scaled scene; both, or none.

    Raises:
        MbdError: As `scaled`, or a place that cannot be written to.
    """
    asked = _read(scene, task)
    entries, text = scaled_entries(scene, static, asked, say)
    scene_from(entries, urdf=text)
    robot = {"urdf": f"{asked.name}.urdf", **entries["robot"]}
    body = yaml.safe_dump(
        {**entries, "robot": robot}, sort_keys=False, default_flow_style=None, width=_WIDTH
    )
    head = f"# {asked.name}: {Path(scene.name).name}, scaled by {static.name}.\n"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DataError(f"{folder}: cannot be made ({error.strerror})") from error
    with ExitStack() as stack:  # each takes its place when both are written
        for name, content in ((f"{asked.name}.urdf", text), (f"{asked.name}.yaml", head + body)):
            file = stack.enter_context(replacing(folder / name))
            file.write(content.encode())
    say(f"{folder / f'{asked.name}.yaml'}")


def scaled_entries(
    scene: Scene, static: Source, task: ScaleTask, say: Say
) -> tuple[dict[str, Any], str]:
    """Entries of the scaled scene without its description, and the description."""
    robot = scene.robot
    if len(robot.recipes) != 1 or robot.recipes[0].name or robot.recipes[0].shape:
        raise SceneError(f"{scene.name}: scale serves scenes with one robot")
    capture = read_capture(static, task.unit).between(task.begin, task.end)
    factors = factors_of(scene, capture, task)
    recipe = robot.recipes[0]
    urdf = ScaledUrdf(recipe.text, factors, task.mass, task.by_volume)
    stretch = {(recipe.rename or {}).get(n, n): f for n, f in urdf.stretch.items()}
    entries = scaled_sections(scene.entries, factors, stretch)
    given = entries.get("robot") or {}
    entries["robot"] = {k: v for k, v in given.items() if k not in ("urdf", "osim", "mjcf")}
    if entries.get("muscles"):
        entries["muscles"] = _scaled_muscles(scene, scene_from(_without(entries), urdf=urdf.text))
    for line in factor_lines(factors):
        say(line)
    say(f"mass {urdf.mass:.6g} kg -> {urdf.mass if task.mass is None else task.mass:.6g} kg")
    for key in left_as_they_are(scene.entries):
        say(f"warning: section {key} is left as it is")
    return entries, urdf.text


def _read(scene: Scene, path: str | Path) -> ScaleTask:
    parts = read_task(path, scene).parts
    if "scale" not in parts:
        raise SceneError(f"{path}: no section 'scale'")
    task: ScaleTask = parts["scale"]
    return task


def factors_of(scene: Scene, capture: Capture, task: ScaleTask) -> dict[str, Array]:
    """Link -> factors along its axes, shape (3,).

    Args:
        scene: The scene; distances of its markers are those at its start.
        capture: The static trial; distances are means over its frames.
        task: What is measured.

    Raises:
        DataError: An unknown link or marker, a marker that was not seen, or a factor that no
            person has.
    """
    shown, seen = _shown(scene), _seen(capture)
    factors = {}
    for link, measurements in task.segments.items():
        try:
            scene.robot.frame(link)
        except ModelError as error:
            raise DataError(f"scale: {error}") from error
        factor = np.ones(3)
        for one in measurements:
            value = one.factor
            if value is None:
                ratios = [_ratio(capture.where, shown, seen, *pair) for pair in one.pairs]
                value = float(np.mean(ratios))
            if not _SANE[0] <= value <= _SANE[1]:
                raise DataError(
                    f"{capture.where}: {link} would be scaled by {value:.4g}, accepted: "
                    f"{_SANE[0]:g} .. {_SANE[1]:g}; is the unit right?"
                )
            factor[[_AXES.index(axis) for axis in one.axes]] = value
        factors[link] = factor
    return factors


def factor_lines(factors: Mapping[str, Array]) -> Iterator[str]:
    """A line a link, for people."""
    for link, (x, y, z) in factors.items():
        yield f"{link}: x {x:.6g}, y {y:.6g}, z {z:.6g}"


def _shown(scene: Scene) -> dict[str, Array]:
    """Label -> place in the model at the start."""
    k, x = Kinematics(scene.robot), scene.initial
    k.refresh(x.q, x.v)
    return {m.title: np.array(k.position(m.point)) for m in markers_of(scene)}


def _seen(capture: Capture) -> dict[str, Array]:
    """Label -> places, shape (N, 3)."""
    return {label: capture.places[:, i] for i, label in enumerate(capture.labels)}


def _ratio(
    where: str, shown: Mapping[str, Array], seen: Mapping[str, Array], a: str, b: str
) -> float:
    for label in (a, b):
        for known, what in ((shown, "the scene"), (seen, where)):
            if label not in known:
                close = nearest(label, known, 1)
                hint = f"; the nearest is {close[0]}" if close else ""
                raise DataError(f"scale: no marker {label} in {what}{hint}")
    apart = np.linalg.norm(seen[a] - seen[b], axis=1)
    apart = apart[np.isfinite(apart)]
    own = float(np.linalg.norm(shown[a] - shown[b]))
    if not len(apart) or own < 1.0e-6:
        why = "are never seen together" if not len(apart) else "are at one place in the scene"
        raise DataError(f"{where}: markers {a} and {b} {why}")
    return float(apart.mean()) / own


def _scaled_muscles(scene: Scene, new: Scene) -> list[dict[str, Any]]:
    """Muscles whose lengths follow those of their paths at the start."""
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
