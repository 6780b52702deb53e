"""Systems for the tests of integrators: bilateral rows written by hand, and free ones."""

import numpy as np
import pinocchio as pin
from places import ROOT
from scipy.integrate import solve_ivp
from systems import acceleration, free_system

from mbd_ros.core.dynamics.tiers import build_system
from mbd_ros.core.loads.loads import Loads
from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.model.robot_reader import read_robot
from mbd_ros.core.rows.constraint import Constraint, Row
from mbd_ros.core.state import State
from mbd_ros.parts.constraints.distance import Distance

LEG = (ROOT / "config/robots/prosthetic_leg.urdf").read_text(encoding="utf-8")
GRAVITY = 9.81


def link(name, mass=0.0, com="0 0 0", inertia=(1.0, 1.0, 1.0)):
    if not mass:
        return f'<link name="{name}"/>'
    ixx, iyy, izz = inertia
    return (
        f'<link name="{name}"><inertial><origin xyz="{com}"/><mass value="{mass}"/><inertia '
        f'ixx="{ixx}" iyy="{iyy}" izz="{izz}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )


def joint(name, kind, parent, child, axis):
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<axis xyz="{axis}"/><limit lower="-99" upper="99" effort="0" velocity="0"/></joint>'
    )


def robot(*elements, **options):
    return read_robot(f"<robot name='r'>{''.join(elements)}</robot>", **options)


POINT = robot(
    *(link("world"), link("a"), link("b"), link("bob", 1.0)),
    joint("x", "prismatic", "world", "a", "1 0 0"),
    joint("y", "prismatic", "a", "b", "0 1 0"),
    joint("z", "prismatic", "b", "bob", "0 0 1"),
)
BAR = robot(
    *(link("world"), link("a"), link("b"), link("bar", 2.0, inertia=(0.5, 0.3, 0.5))),
    joint("x", "prismatic", "world", "a", "1 0 0"),
    joint("z", "prismatic", "a", "b", "0 0 1"),
    joint("turn", "revolute", "b", "bar", "0 -1 0"),
)
BODY = (
    link("trunk", 3.0, "0.1 0 0.05", (0.2, 0.3, 0.4)),
    link("arm", 1.0, "0 0 -0.3", (0.03, 0.03, 0.01)),
    joint("swing", "revolute", "trunk", "arm", "0 1 0"),
)


class MovingLength(Constraint):
    """A point at a distance from the origin that changes: |q| = 1 + 0.1 sin(3 t)."""

    rows = (Row("length", "N"),)

    def residual(self, k, x):
        return np.array([np.sqrt(x.q.dot(x.q)) - 1.0 - 0.1 * np.sin(3.0 * x.t)])

    def jacobian(self, k, x):
        return (x.q / np.sqrt(x.q.dot(x.q)))[None]

    def rate(self, k, x):
        return np.array([-0.3 * np.cos(3.0 * x.t)])

    def drift(self, k, x):
        along = float(self.jacobian(k, x)[0].dot(x.v))
        bent = (x.v.dot(x.v) - along**2) / np.sqrt(x.q.dot(x.q))
        return np.array([bent + 0.9 * np.sin(3.0 * x.t)])


class Pin(Constraint):
    """Holds a bar in the x-z plane, x, z and angle free, 0.8 m from its centre at the origin."""

    rows = (Row("pin.x", "N"), Row("pin.z", "N"))
    arm, mass_times_arm, inertia = 0.8, 1.6, 0.3 + 2.0 * 0.8**2

    def residual(self, k, x):
        return x.q[:2] - self.at(x.q[2])[:2]

    def jacobian(self, k, x):
        c, s = np.cos(x.q[2]), np.sin(x.q[2])
        return np.array([[1.0, 0.0, -self.arm * c], [0.0, 1.0, -self.arm * s]])

    def drift(self, k, x):
        return self.arm * x.v[2] ** 2 * np.array([np.sin(x.q[2]), -np.cos(x.q[2])])

    def at(self, angle):
        """Configuration of the bar at an angle."""
        return np.array([self.arm * np.sin(angle), -self.arm * np.cos(angle), angle])


PIN = Pin()


def pinned_bar():
    return build_system(BAR, Couplings(BAR), [PIN], Loads(3))


def moving_sphere():
    return build_system(POINT, Couplings(POINT), [MovingLength()], Loads(3))


def leg():
    """The prosthetic leg on a fixed base in fast motion, and its state."""
    rng = np.random.default_rng(1)
    chain = read_robot(LEG)
    return free_system(chain), State(0.0, rng.uniform(-0.5, 0.5, 5), rng.uniform(-3, 3, 5))


def floating():
    """A free body with an arm, tumbling."""
    rng, free = np.random.default_rng(2), robot(*BODY, base="floating")
    system = free_system(free)
    q = system.chart.integrate(pin.neutral(free.model), rng.uniform(-0.5, 0.5, 7))
    return system, State(0.0, q, rng.uniform(-3, 3, 7))


def spherical_pendulum(copies=1, forces=()):
    """A point of 1 kg at distance 1 m from the origin; `copies` rows that say the same."""
    bars = [Distance(POINT, frame_a="world", frame_b="bob", distance=1.0) for _ in range(copies)]
    return build_system(POINT, Couplings(POINT), bars, Loads(3, forces))


def sphere():
    """Problem P01_SPHERE."""
    q = np.array([0.8660254037844386, 0.0, -0.5])
    return spherical_pendulum(), State(0.0, q, np.array([0.25, 1.2, 0.4330127018922193]))


def advance(stepper, x, duration):
    end = x.t + duration
    while x.t < end:
        x = stepper.step(x, None, end)
    return x


def away(system, x, y):
    """Largest difference of two states in q [rad or m] and v [rad/s or m/s]."""
    return max(np.abs(system.chart.difference(x.q, y.q)).max(), np.abs(x.v - y.v).max())


def reference(system, x, duration):
    """SciPy's DOP853 at 1e-13 in a chart at x.q."""

    def slope(t, y):
        dq, v = np.split(y, 2)
        q = system.chart.integrate(x.q, dq)
        return np.concatenate([system.chart.rate(dq, v), acceleration(system, x.t + t, q, v)])

    start = np.concatenate([np.zeros(system.nv), x.v])
    y = solve_ivp(slope, (0, duration), start, "DOP853", rtol=1e-13, atol=1e-13).y[:, -1]
    dq, v = np.split(y, 2)
    return State(x.t + duration, system.chart.integrate(x.q, dq), v)


def returned(method, system, x, dt, steps):
    """How far off x the motion ends that is stopped, reversed and run back."""
    stepper = method.prepare(system, dt)
    y = x
    for _ in range(steps):
        y = stepper.step(y, None)
    stepper.restart()
    y = State(y.t, y.q, -y.v)
    for _ in range(steps):
        y = stepper.step(y, None)
    return away(system, x, State(y.t, y.q, -y.v))


def flow_derivative(method, system, x, dt):
    """Derivative of one step in (q, p = M v), by central differences."""
    n, step = system.nv, 1e-4

    def flow(z):
        v = np.linalg.solve(system.mass(z[:n]).dense, z[n:])
        y = method.prepare(system, dt).step(State(0.0, z[:n].copy(), v), None)
        return np.concatenate([y.q, system.mass(y.q).dot(y.v)])

    z = np.concatenate([x.q, system.mass(x.q).dot(x.v)])
    moved = step * np.eye(2 * n)
    return np.array([(flow(z + d) - flow(z - d)) / (2 * step) for d in moved]).T


def symplectic_defect(S):
    """Largest entry of S' Omega S - Omega."""
    n = len(S) // 2
    omega = np.block([[np.zeros((n, n)), np.eye(n)], [-np.eye(n), np.zeros((n, n))]])
    return np.abs(S.T.dot(omega).dot(S) - omega).max()
