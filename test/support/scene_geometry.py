"""Scene files read with Pinocchio alone: an independent view of their geometry."""

import math

import numpy as np
import pinocchio as pin

from mbd_ros.core.model.robot_reader import read_robot
from mbd_ros.scene.schema.strict_yaml import read_mapping


class Mechanism:
    """Robot and entries of a scene file, without the parts of the package."""

    def __init__(self, path):
        self.entries = read_mapping(path)
        entry = self.entries["robot"]
        urdf = (path.parent / entry["urdf"]).read_text(encoding="utf-8")
        self.robot = read_robot(urdf, gravity=entry.get("gravity", [0.0, 0.0, -9.81]))
        self.model, self.data = self.robot.model, self.robot.model.createData()

    def vector(self, values):
        x = np.zeros(self.model.nv)
        for name, value in values.items():
            x[self.robot.joint(name).v] = value
        return x

    def start(self):
        given = self.entries["initial"]
        return self.vector(given.get("position", {})), self.vector(given.get("velocity", {}))

    def place(self, q, frame, point):
        pin.framesForwardKinematics(self.model, self.data, q)
        return self.data.oMf[self.robot.frame(frame)].act(np.array(point, dtype=float))

    def end(self, q, entry, side):
        return self.place(q, entry[f"frame_{side}"], entry.get(f"point_{side}", [0.0] * 3))

    def gaps(self, t, q):
        """How far every constraint is from holding [m or rad]."""
        return [self.gap(entry, t, q) for entry in self.entries.get("constraints", [])]

    def gap(self, entry, t, q):
        if entry["type"] == "prescribed_motion":
            law = entry["harmonic"]
            wanted = law["amplitude"] * math.sin(law["angular_frequency"] * t)
            return abs(q[self.robot.joint(entry["joint"]).q] - wanted)
        if entry["type"] == "point_on_plane":
            here = self.place(q, entry["frame"], entry.get("point", [0.0] * 3))
            oMp = self.data.oMf[self.robot.frame(entry["plane_frame"])]
            return abs(oMp.actInv(here).dot(entry["normal"]))
        apart = self.end(q, entry, "b") - self.end(q, entry, "a")
        if entry["type"] == "distance":
            return abs(np.linalg.norm(apart) - entry["distance"])
        assert entry["type"] == "loop_closure"
        a, b = (self.data.oMf[self.robot.frame(entry[f"frame_{side}"])] for side in "ab")
        turn = pin.log3(a.rotation.T @ b.rotation) if entry["kind"] == "full" else np.zeros(3)
        return max(np.linalg.norm(apart), np.linalg.norm(turn))

    def energy(self, q, v):
        stored = pin.computeMechanicalEnergy(self.model, self.data, q, v)
        for entry in self.entries.get("forces", []):
            if entry["type"] == "point_spring":
                length = np.linalg.norm(self.end(q, entry, "b") - self.end(q, entry, "a"))
                stored += 0.5 * entry["stiffness"] * (length - entry["length"]) ** 2
        return stored

    def opening(self, loop, q, joints, dq):
        """Where the ends of a planar loop are apart (x, z) when some joints move on by dq [m]."""
        moved = q.copy()
        moved[joints] += dq
        return (self.end(moved, loop, "b") - self.end(moved, loop, "a"))[[0, 2]]

    def whole(self):
        """Inertia of everything that hangs on the first joint, at q = 0."""
        pin.crba(self.model, self.data, np.zeros(self.model.nv))
        return self.data.Ycrb[1]
