"""Cases that several tests share: demo."""

import numpy as np

from mbd_ros.applications.demo.files import (
    MODEL,
    PLANT,
    write_gains,
    write_scenes,
)
from mbd_ros.applications.demo.task import ROBOTS, disturbance, trajectory
from mbd_ros.methods.control.contract import Reference
from mbd_ros.methods.control.sliding_mode import mismatch, sliding_variable
from mbd_ros.methods.projection.state_projection import ObservedState
from mbd_ros.scene.reader import load_scene

LAM = 20.0  # 1/s, bandwidth of the demo


class Task:
    """A robot of the demo, its files and what it has to do."""

    def __init__(self, name, folder, duration):
        self.robot, self.folder = ROBOTS[name], folder
        self.scene = load_scene(self.robot.scene)
        self.truth = self.scene.controlled_joints()
        self.start = self.truth.positions(self.scene.initial)
        self.trajectory = trajectory(self.robot, self.start, duration)
        self.added = disturbance(self.scene, self.trajectory)
        write_scenes(folder, self.robot, self.truth.names, self.added)
        self.gains = write_gains(folder, self.robot, "sliding_mode", self.scene)
        self.plant, model = load_scene(folder / PLANT), load_scene(folder / MODEL)
        self.model = model.controlled_joints()

    def mismatches(self):
        """What model error and disturbance leave of s' = -rho along the reference."""
        observed = ObservedState(self.truth.system, self.scene.couplings)
        z, w = self.scene.couplings.q_index, self.scene.couplings.v_index
        q, v = self.scene.initial.q.copy(), np.zeros(self.scene.robot.model.nv)
        for t, position, velocity, acceleration in zip(*self.trajectory, strict=True):
            q[[j.q for j in self.truth.joints]] = position
            v[[j.v for j in self.truth.joints]] = velocity
            x = observed.state(t, q[z], v[w])
            q = x.q.copy()  # the next sample closes its loops from here
            model, truth = self.model.response(x), self.truth.response(x)
            ref = Reference(model.q, model.v, acceleration)
            keep = sliding_variable(model, ref, np.full(len(position), LAM))[1]
            columns = self.added.torque.T
            added = np.array([np.interp(t, self.added.times, column) for column in columns])
            yield mismatch(truth, model, keep, added)
