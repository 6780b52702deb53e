"""A scene with derivatives of every order: polynomials in place of wraps, smooth muscles."""

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
_LOOKS = 40  # random poses that show which joints change a path
_STILL = 1.0e-9  # m per rad or m: an arm of none
_LOST = 0.2  # of the poses: so many may have no path
SMOOTH = "degroote_fregly"
_KEPT = (
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
    """A scene whose muscles are `degroote_fregly`, with sizes and times of those it had.

    Args:
        more: Arguments that all of them get besides, such as `tendon`.

    Returns:
        The scene, and what changed, for people.

    Raises:
        SceneError: It has no muscles, or they do not take these arguments.
    """
    if not scene.muscles:
        raise SceneError(f"{scene.name}: muscles: the scene has none")
    types = sorted({str(entry["type"]) for entry in scene.entries["muscles"]})
    words = ", ".join(f"{key} {value}" for key, value in more.items())
    line = f"muscles: {', '.join(types)} -> {SMOOTH}" + (f" with {words}" if words else "")
    return with_sections(scene, muscles=smooth_entries(scene, more)), line


def smooth_entries(scene: Scene, more: Mapping[str, Any] = _NOTHING) -> list[dict[str, Any]]:
    """Entries of smooth muscles in place of those of a scene; `more` for all of them."""
    given = zip(scene.muscles, scene.entries["muscles"], strict=True)
    return [_smooth(muscle, entry, more) for muscle, entry in given]


def _smooth(muscle: Any, entry: Mapping[str, Any], more: Mapping[str, Any]) -> dict[str, Any]:
    """The entry of a muscle with other curves; what its own left out is what its type says."""
    if entry["type"] == SMOOTH:
        return {**entry, **more}
    usual = inspect.signature(type(muscle).__init__).parameters
    kept = {key: entry.get(key, usual[key].default) for key in _KEPT if key in usual}
    return {"type": SMOOTH, "name": muscle.name, **kept, **more}


def with_fitted_paths(
    scene: Scene, limits: Mapping[str, Range]
) -> tuple[Scene, list[str], set[str]]:
    """A scene whose paths that wrap are polynomials of joints, fitted between limits of joints.

    Args:
        limits: Independent joint -> its range.

    Returns:
        The scene, a line a path with its error, and the joints that change these paths.

    Raises:
        SceneError: A path changes with a free body, or is not there in most poses.
    """
    places, joints = wrapping(scene), set[str]()
    if not places:
        return scene, [], joints
    changed = {key: _copied(scene.entries[key]) for key in {one.section for one in places}}
    fitter, lines = _Fitter(scene, limits), list[str]()
    for place in places:
        whole = changed[place.section]
        holder = whole[place.at]
        entry = holder if place.section == "paths" else holder["path"]
        name = str(place.at) if isinstance(place.at, str) else f"{place.section}[{place.at}]"
        polynomial, fit = fitter.polynomial(name, entry)
        joints.update(polynomial["joints"])
        lines.append(
            f"path {name}: a polynomial of {', '.join(polynomial['joints'])}, degree "
            f"{fit.degree}, in place of its wraps; length off by {fit.length_error:.1e} m, "
            f"moment arms by {fit.arm_error:.1e} m (root mean square)"
        )
        if place.section == "paths":
            whole[place.at] = {"polynomial": polynomial}
        else:
            holder["path"] = {"polynomial": polynomial}
    return with_sections(scene, **changed), lines, joints


def _copied(section: Any) -> Any:
    if isinstance(section, Mapping):
        return dict(section)
    return [dict(one) for one in section]


class _Fitter:
    """Fits paths of a scene.

    Args:
        limits: As for `with_fitted_paths`.
    """

    def __init__(self, scene: Scene, limits: Mapping[str, Range]) -> None:
        self._scene = scene
        self._search = QuickestSearch()
        robot, couplings = scene.robot, scene.couplings
        joints = {joint.q: joint for joint in robot.joints}
        self._start = scene.initial.q[couplings.q_index]
        self._columns = list[tuple[str, int, int, Range]]()  # name, place in y and in v, limits
        places = {int(v): i for i, v in enumerate(couplings.v_index)}
        for i, q in enumerate(couplings.q_index):
            joint = joints.get(int(q))
            if joint is not None:
                self._columns.append((joint.name, i, places[int(joint.v)], limits[joint.name]))

    def polynomial(self, name: str, entry: Mapping[str, Any]) -> tuple[dict[str, Any], Fit]:
        """The `polynomial` of an entry, and how good it is."""
        scene = self._scene
        path = path_of(scene.robot, dict(entry), f"{scene.name}: {name}")
        batch = PathBatch(scene.robot, scene.couplings, {name: path}, self._search)
        chosen = self._changing(name, batch)
        limits = np.array([limits for _, _, _, limits in chosen])
        columns = [i for _, i, _, _ in chosen]
        places = [at for _, _, at, _ in chosen]

        def measure(positions: Array) -> tuple[Array, Array, Array]:
            y = np.tile(self._start, (len(positions), 1))
            y[:, columns] = positions
            kept, lengths, arms = _found(batch, y)
            if kept.mean() < 1.0 - _LOST:
                raise SceneError(f"{scene.name}: path {name}: no path in most poses of its joints")
            return positions[kept], lengths, -arms[:, places]

        fit = fitted(limits, measure)
        joints = {one[0]: list(map(float, one[3])) for one in chosen}
        return {"joints": joints, "terms": fit.terms}, fit

    def _changing(self, name: str, batch: PathBatch) -> list[tuple[str, int, int, Range]]:
        """Joints that change the length."""
        random = np.random.default_rng(0)
        y = np.tile(self._start, (_LOOKS, 1))
        for _, i, _, (low, high) in self._columns:
            y[:, i] = random.uniform(low, high, size=_LOOKS)
        _, _, arms = _found(batch, y)
        moved = np.abs(arms).max(axis=0, initial=0.0) > _STILL
        found = [one for one in self._columns if moved[one[2]]]
        where = f"{self._scene.name}: path {name}"
        if moved.sum() > len(found):
            raise SceneError(f"{where}: it wraps, and free bodies change it; accepted: joints")
        if not found:
            raise SceneError(f"{where}: it wraps, and no joint changes it")
        return found


def _found(batch: PathBatch, y: Array) -> tuple[Any, Array, Array]:
    """Which poses have a path, its lengths and moment arms there."""
    try:
        found = batch.evaluate(y)
    except SolveError:
        if len(y) == 1:
            return np.zeros(1, dtype=np.bool_), np.zeros(0), np.zeros((0, batch.width))
        parts = [_found(batch, half) for half in np.array_split(y, 2)]
        kept, lengths, arms = (np.concatenate(one) for one in zip(*parts, strict=True))
        return kept, lengths, arms
    return np.ones(len(y), dtype=np.bool_), found.lengths[:, 0], found.arms[:, 0]


def wrapping(scene: Scene) -> list[Place]:
    """Entries of paths that wrap."""
    paths = scene.entries.get("paths") or {}
    found = [Place("paths", name) for name, one in paths.items() if one.get("wraps")]
    for section in _SECTIONS:
        for i, one in enumerate(scene.entries.get(section) or ()):
            path = one.get("path")
            if isinstance(path, Mapping) and path.get("wraps"):
                found.append(Place(section, i))
    return found


class Place(NamedTuple):
    """Where the entry of a path stands: section, and place or key there."""

    section: str
    at: int | str
