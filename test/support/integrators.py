"""Cases that several tests share: integrators."""

import numpy as np
import pinocchio as pin
from places import ROOT
from scipy.integrate import solve_ivp
from systems import acceleration, free_system

from mbd_ros.core.contracts import Actuator, Channel
from mbd_ros.core.dynamics.chart import Chart
from mbd_ros.core.model.robot_reader import read_robot
from mbd_ros.core.state import State

ROBOTS = ROOT / "config/robots"


TORSO = """<link name="world"><inertial><origin xyz="0.02 0 0.1"/><mass value="4"/><inertia
 ixx="0.05" iyy="0.04" izz="0.03" ixy="0.002" ixz="0.001" iyz="-0.003"/></inertial></link>"""


def label(method):
    return f"{type(method).__name__}{method.order}" if hasattr(method, "order") else None


class Pusher(Actuator):
    """An actuator on the first joint."""

    joints = ("first",)
    inputs = (Channel("", "N·m"),)

    def __init__(self, nv):
        self.nv = nv

    def force(self, k, x, u):
        return np.concatenate([u[self.u], np.zeros(self.nv - 1)])


def robot_system(name, base="fixed", driven=False):
    text = (ROBOTS / f"{name}.urdf").read_text(encoding="utf-8")
    if base == "floating":
        text = text.replace('<link name="world"/>', TORSO)
    robot = read_robot(text, base=base)
    nv = int(robot.model.nv)
    return free_system(robot, (), [Pusher(nv)] if driven else ())


class Mass:
    """A point on a line with a given acceleration."""

    nq = nv = 1
    chart = Chart(pin.Model())

    def __init__(self, law):
        self.law, self.evaluations = law, 0

    def accelerator(self):
        def accelerate(t, q, v, u, out):
            self.evaluations += 1
            out[0] = self.law(t, q[0], v[0])

        return accelerate


def start(system, speed):
    rng = np.random.default_rng(1)
    q, v = rng.uniform(-1, 1, system.nq), speed * rng.uniform(-1, 1, system.nv)
    if not system.chart.is_flat:
        q[3:7] /= np.linalg.norm(q[3:7])
    return State(0.0, q, v)


def rates(system, t, y):
    """y' in the coordinates of Pinocchio; a floating base by its quaternion."""
    q, v = y[: system.nq].copy(), y[system.nq :]
    if system.chart.is_flat:
        return np.concatenate([v, acceleration(system, t, q, v)])
    q[3:7] /= np.linalg.norm(q[3:7])
    e, w, spin = q[3:6], q[6], v[3:6]
    rotated = v[:3] + 2 * np.cross(e, np.cross(e, v[:3]) + w * v[:3])
    turned = 0.5 * np.concatenate([w * spin + np.cross(e, spin), [-e.dot(spin)]])
    return np.concatenate([rotated, turned, v[6:], acceleration(system, t, q, v)])


def solved(system, x, t):
    """The state at t by SciPy's DOP853 at 1e-13."""
    y0 = np.concatenate([x.q, x.v])
    y = solve_ivp(
        lambda s, y: rates(system, s, y), (x.t, t), y0, method="DOP853", rtol=1e-13, atol=1e-13
    ).y[:, -1]
    return State(t, y[: system.nq], y[system.nq :])


def distance(system, x, y):
    return max(np.abs(system.chart.difference(x.q, y.q)).max(), np.abs(x.v - y.v).max())
