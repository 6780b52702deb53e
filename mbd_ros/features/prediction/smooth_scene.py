"""Replacement of wrapping paths by polynomials, and of muscles by differentiable ones."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.kinematics.paths.paths import PathBatch
from mbd_ros.core.kinematics.paths.polynomial_path import Fit, fitted
from mbd_ros.core.state import Array
from mbd_ros.errors import SceneError, SolveError
from mbd_ros.optimal_control.problem import Range
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.reading.path_entries import path_of
from mbd_ros.scene.runs.path_search import QuickestSearch
from mbd_ros.scene.variants import with_sections

_SECTIONS = ("muscles", "forces", "actuators", "constraints")
_SAMPLES = 40  # random poses that show which joints change a path
_STILL = 1.0e-9  # m per rad or m: smaller moment arms count as zero
_LOST = 0.2  # share of the poses that may have no path
SMOOTH = "degroote_fregly"
_SHARED_KEYS = (
    "path",
    "max_isometric_force",
    "optimal_fiber_length",
    "tendon_slack_length",
    "pennation_angle",
    "maximum_pennation_angle",
    "max_contraction_velocity",
    "activation_time",
    "deactivation_time",
    "minimum_activation",
    "tendon",
    "tendon_strain",
    "passive_strain",
)
_NOTHING: Mapping[str, Any] = {}


def with_smooth_muscles(scene: Scene, more: Mapping[str, Any] = _NOTHING) -> tuple[Scene, str]:
    """Replace all muscles by `degroote_fregly` muscles with the same sizes and time constants.

    Args:
        more: Additional arguments of all muscles, such as `tendon`.

    Returns:
        The scene, and a line for people about the change.

    Raises:
        SceneError: There are no muscles, or they do not accept these arguments.
    """
    if not scene.muscles:
        raise SceneError(f"{scene.name}: muscles: the scene has no muscles")
    types = sorted({str(entry["type"]) for entry in scene.entries["muscles"]})
    options = ", ".join(f"{key} {value}" for key, value in more.items())
    line = f"muscles: {', '.join(types)} -> {SMOOTH}" + (f" with {options}" if options else "")
    return with_sections(scene, muscles=smooth_entries(scene, more)), line


def smooth_entries(scene: Scene, more: Mapping[str, Any] = _NOTHING) -> list[dict[str, Any]]:
    """Return entries of smooth muscles for those of a scene, with `more` added to all."""
    given = zip(scene.muscles, scene.entries["muscles"], strict=True)
    return [_smooth(muscle, entry, more) for muscle, entry in given]


def _smooth(muscle: Any, entry: Mapping[str, Any], more: Mapping[str, Any]) -> dict[str, Any]:
    """Return the entry of a smooth muscle, with defaults of the type of the original one."""
    if entry["type"] == SMOOTH:
        return {**entry, **more}
    accepted = inspect.signature(type(muscle).__init__).parameters
    shared = {k: entry.get(k, accepted[k].default) for k in _SHARED_KEYS if k in accepted}
    return {"type": SMOOTH, "name": muscle.name, **shared, **more}


def with_fitted_paths(
    scene: Scene, limits: Mapping[str, Range]
) -> tuple[Scene, list[str], set[str]]:
    """Replace wrapping paths by polynomials of joints, fitted within ranges of these joints.

    Args:
        limits: Independent joint -> its range.

    Returns:
        The scene, a line with the error of each path, and the joints that change these paths.

    Raises:
        SceneError: A path depends on a free body, or does not exist in most poses.
    """
    places, joints = wrapping_paths(scene), set[str]()
    if not places:
        return scene, [], joints
    sections = {place.section for place in places}
    changed = {key: _copied(scene.entries[key]) for key in sections}
    fitter, lines = _Fitter(scene, limits), list[str]()
    for place in places:
        section = changed[place.section]
        holder = section[place.at]
        entry = holder if place.section == "paths" else holder["path"]
        name = str(place.at) if isinstance(place.at, str) else f"{place.section}[{place.at}]"
        polynomial, fit = fitter.polynomial(name, entry)
        joints.update(polynomial["joints"])
        lines.append(
            f"path {name}: a polynomial of {', '.join(polynomial['joints'])}, degree "
            f"{fit.degree}, in place of its wraps; RMS error of the length "
            f"{fit.length_error:.1e} m, of moment arms {fit.arm_error:.1e} m"
        )
        if place.section == "paths":
            section[place.at] = {"polynomial": polynomial}
        else:
            holder["path"] = {"polynomial": polynomial}
    return with_sections(scene, **changed), lines, joints


def _copied(section: Any) -> Any:
    if isinstance(section, Mapping):
        return dict(section)
    return [dict(entry) for entry in section]


class _Fitter:
    """Fits polynomials to wrapping paths of a scene.

    Args:
        limits: Independent joint -> its range.
    """

    def __init__(self, scene: Scene, limits: Mapping[str, Range]) -> None:
        self._scene = scene
        self._search = QuickestSearch()
        robot, couplings = scene.robot, scene.couplings
        joints = {joint.q: joint for joint in robot.joints}
        self._start = scene.initial.q[couplings.q_index]
        self._columns = list[tuple[str, int, int, Range]]()  # name, index in y and in v, limits
        places = {int(v): i for i, v in enumerate(couplings.v_index)}
        for i, q in enumerate(couplings.q_index):
            joint = joints.get(int(q))
            if joint is not None:
                self._columns.append((joint.name, i, places[int(joint.v)], limits[joint.name]))

    def polynomial(self, name: str, entry: Mapping[str, Any]) -> tuple[dict[str, Any], Fit]:
        """Return the `polynomial` of an entry, and its fit."""
        scene = self._scene
        path = path_of(scene.robot, dict(entry), f"{scene.name}: {name}")
        batch = PathBatch(scene.robot, scene.couplings, {name: path}, self._search)
        cheapest_start = self._changing(name, batch)
        limits = np.array([limits for _, _, _, limits in cheapest_start])
        columns = [i for _, i, _, _ in cheapest_start]
        places = [index for _, _, index, _ in cheapest_start]

        def measure(positions: Array) -> tuple[Array, Array, Array]:
            y = np.tile(self._start, (len(positions), 1))
            y[:, columns] = positions
            exists, lengths, arms = _evaluate_paths(batch, y)
            if exists.mean() < 1.0 - _LOST:
                raise SceneError(
                    f"{scene.name}: path {name}: there is no path in many poses of its joints; "
                    "narrow the bounds of these joints"
                )
            return positions[exists], lengths, -arms[:, places]

        fit = fitted(limits, measure)
        joints = {joint: list(map(float, range_)) for joint, _, _, range_ in cheapest_start}
        return {"joints": joints, "terms": fit.terms}, fit

    def _changing(self, name: str, batch: PathBatch) -> list[tuple[str, int, int, Range]]:
        """Return the joints that change the length."""
        random = np.random.default_rng(0)
        y = np.tile(self._start, (_SAMPLES, 1))
        for _, i, _, (low, high) in self._columns:
            y[:, i] = random.uniform(low, high, size=_SAMPLES)
        _, _, arms = _evaluate_paths(batch, y)
        has_arm = np.abs(arms).max(axis=0, initial=0.0) > _STILL
        changing = [column for column in self._columns if has_arm[column[2]]]
        where = f"{self._scene.name}: path {name}"
        if has_arm.sum() > len(changing):
            raise SceneError(
                f"{where}: a path that wraps must depend on joints only, not on free bodies"
            )
        if not changing:
            raise SceneError(f"{where}: the path wraps, but no joint changes it; remove its wraps")
        return changing


def _evaluate_paths(batch: PathBatch, y: Array) -> tuple[Any, Array, Array]:
    """Return which poses have a path, and its lengths and moment arms there."""
    try:
        paths = batch.evaluate(y)
    except SolveError:
        if len(y) == 1:
            return np.zeros(1, dtype=np.bool_), np.zeros(0), np.zeros((0, batch.width))
        parts = [_evaluate_paths(batch, half) for half in np.array_split(y, 2)]
        exists, lengths, arms = (np.concatenate(values) for values in zip(*parts, strict=True))
        return exists, lengths, arms
    return np.ones(len(y), dtype=np.bool_), paths.lengths[:, 0], paths.arms[:, 0]


def wrapping_paths(scene: Scene) -> list[Place]:
    """Return the places of entries of paths that wrap."""
    paths = scene.entries.get("paths") or {}
    places = [Place("paths", name) for name, entry in paths.items() if entry.get("wraps")]
    for section in _SECTIONS:
        for i, entry in enumerate(scene.entries.get(section) or ()):
            path = entry.get("path")
            if isinstance(path, Mapping) and path.get("wraps"):
                places.append(Place(section, i))
    return places


class Place(NamedTuple):
    """Place of the entry of a path: section, and index or key there."""

    section: str
    at: int | str
