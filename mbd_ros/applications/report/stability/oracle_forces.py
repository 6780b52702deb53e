"""Forces and energies from the scene file, beside the parts that they check."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from mbd_ros.applications.report.stability.scene_text import Entry, LoadedScene
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.loads.loads import Loads
from mbd_ros.core.state import NONE, Array, State


class OracleForces:
    """Generalized forces of a scene without commands.

    Types that are not known here fall back on the part itself.

    Args:
        loaded: The scene.
    """

    def __init__(self, loaded: LoadedScene) -> None:
        scene = loaded.scene
        entries: Sequence[Entry] = loaded.entries.get("forces") or []
        self._model, self._data = scene.robot.model, scene.robot.model.createData()
        self._zero = np.zeros(self._model.nv)
        self._known = [
            (e["type"], scene.robot.joint(e["joint"]), e) for e in entries if e["type"] in _RESIST
        ]
        pairs = zip(entries, scene.forces, strict=True)
        self._others = [part for entry, part in pairs if entry["type"] not in _RESIST]
        self._drives = Loads(scene.robot.model.nv, (), scene.actuators)
        self._k = Kinematics(scene.robot, self._data)

    def total(self, x: State) -> Array:
        """All of them, shape (nv,)."""
        tau = self.not_stored(x)
        for kind, joint, entry in self._known:
            if kind == "joint_spring":
                stretch = float(x.q[joint.q]) - entry.get("rest", 0.0)
                tau[joint.v] -= entry["stiffness"] * stretch
        return tau

    def not_stored(self, x: State) -> Array:
        """Those that `stored` leaves out, shape (nv,)."""
        tau = self._zero.copy()
        for kind, joint, entry in self._known:
            tau[joint.v] += _RESIST[kind](entry, float(x.v[joint.v]))
        if self._others:
            self._k.refresh(x.q, x.v)
            tau += sum(part.force(self._k, x, NONE) for part in self._others)
        return tau + self._drives.actuator_torque(self._k, x, None)

    def stored(self, x: State) -> tuple[float, float]:
        """Kinetic energy, and potential energy of masses and joint springs [J]."""
        model, data = self._model, self._data
        kinetic = float(pin.computeKineticEnergy(model, data, x.q, x.v))
        potential = float(pin.computePotentialEnergy(model, data, x.q))
        for kind, joint, entry in self._known:
            if kind == "joint_spring":
                stretch = float(x.q[joint.q]) - entry.get("rest", 0.0)
                potential += 0.5 * entry["stiffness"] * stretch**2
        return kinetic, potential


def _friction(entry: Entry, v: float) -> float:
    dry = entry.get("coulomb", 0.0) * np.tanh(v / entry.get("smoothing", 1.0e-2))
    return float(-dry - entry.get("viscous", 0.0) * v)


_RESIST: Mapping[str, Any] = {
    "joint_spring": lambda entry, v: -entry.get("damping", 0.0) * v,
    "joint_friction": _friction,
    "joint_torque": lambda entry, v: entry["torque"],
}
