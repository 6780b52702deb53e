"""Power that flows through the segments of a mechanism.

What a joint passes on, the force F at its origin and the moment M about it, works at both of its
ends: F . v + M . omega with the motion of the segment there. The child takes in one at its
proximal end, the parent the opposite of it at its distal end. Both together are what acts in the
joint; what leaves them equal goes through it, from segment to segment, and is nobody's work.
Source: D. G. E. Robertson, D. A. Winter, J. Biomechanics 13 (1980) 845,
doi:10.1016/0021-9290(80)90172-4.
"""

from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from mbd_ros.core.contracts.outputs import Output
from mbd_ros.core.loads.body_loads import BodyLoads
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import Array, State
from mbd_ros.core.vectors import cross

WATT = "W"
PROXIMAL, DISTAL = "proximal_power", "distal_power"
QUANTITIES = "gravity_power", "load_power", "kinetic_energy_rate"


class Bodies(NamedTuple):
    """Powers of all bodies of a model, the world as the first of them [W], shape (n,) each.

    Attributes:
        taken: What the joint of a body gives to it.
        given: What the same joint gives to the parent.
        gravity: Power of its weight.
        load: Power of all wrenches on it.
        rate: Rate of its kinetic energy.
        energy: Its kinetic energy [J].
    """

    taken: Array
    given: Array
    gravity: Array
    load: Array
    rate: Array
    energy: Array


class SegmentPower:
    """Powers of segments: bodies, and the joints between them.

    Bodies without mass between two joints are no segments: what goes in goes out. A free body is
    joined to the world by what nothing carries of it.

    One instance owns its Pinocchio data: not for two threads.

    Args:
        robot: The robot.

    Attributes:
        outputs: `<link>.proximal_power`, `<link>.distal_power_<link>` of what each next link
            gives to it, `<link>.gravity_power`, `.load_power` and `.kinetic_energy_rate`, in the
            order of `values`; all five but the last sum up to the last.
    """

    def __init__(self, robot: Robot) -> None:
        model = robot.model
        self._model, self._data, n = model, pin.Data(model), int(model.njoints)
        self._mass = np.array([float(inertia.mass) for inertia in model.inertias])
        self._lever = np.array([inertia.lever for inertia in model.inertias])
        self._inertia = np.array([inertia.inertia for inertia in model.inertias])
        self._g = np.array(model.gravity.linear)
        self._every, self._parents = range(n), np.array(model.parents, dtype=np.intp)
        chains = _chains(model, self._mass)
        names = _names(robot)
        self._at: NDArray[np.intp] = np.array([chain[-1] for chain in chains], dtype=np.intp)
        ends = [(int(model.parents[chain[0]]), chain) for chain in chains]
        self._distal = np.array([chain[0] for parent, chain in ends if parent], dtype=np.intp)
        outputs = [f"{names[i]}.{PROXIMAL}" for i in self._at]
        outputs += [f"{names[p]}.{DISTAL}_{names[chain[-1]]}" for p, chain in ends if p]
        outputs += [f"{names[i]}.{quantity}" for quantity in QUANTITIES for i in self._at]
        self.outputs = tuple(Output(name, WATT) for name in outputs)

    def bodies(self, x: State, a: Array, loads: BodyLoads) -> Bodies:
        """Powers of all bodies.

        Args:
            x: State of all joints.
            a: Acceleration of all joints [rad/s^2 or m/s^2], shape (nv,).
            loads: Wrenches on bodies.
        """
        model, data = self._model, self._data
        pin.rnea(model, data, x.q, x.v, a, loads.forces)
        pin.forwardKinematics(model, data, x.q, x.v, a)
        f, v, acc, load = (
            np.array([field[i].vector for i in self._every])
            for field in (data.f, data.v, data.a, loads.forces)
        )
        f[0] = 0.0
        v_mass = v[:, :3] + cross(v[:, 3:], self._lever)
        a_mass = acc[:, :3] + cross(acc[:, 3:], self._lever)  # less what is across v_mass
        turned = _turned(self._inertia, v[:, 3:])
        speed = np.einsum("ij,ij->i", v_mass, v_mass)
        weight = self._g @ np.array([pose.rotation for pose in data.oMi])
        return Bodies(
            _products(f, v),
            self._given(f, v),
            self._mass * _products(weight, v_mass),
            _products(load, v),
            self._mass * _products(v_mass, a_mass) + _products(turned, acc[:, 3:]),
            0.5 * (self._mass * speed + _products(turned, v[:, 3:])),
        )

    def values(self, of: Bodies) -> Array:
        """Values of `outputs`, shape (len(outputs),)."""
        at = self._at
        parts = of.taken[at], of.given[self._distal], of.gravity[at], of.load[at], of.rate[at]
        return np.concatenate(parts)

    def _given(self, f: Array, v: Array) -> Array:
        """What each joint gives to the parent: minus what it passes on, at the parent's motion."""
        poses = self._data.liMi
        turn = np.array([pose.rotation for pose in poses])
        place = np.array([pose.translation for pose in poses])
        force, moment = _turned(turn, f[:, :3]), _turned(turn, f[:, 3:])
        parent = v[self._parents]
        moment += cross(place, force)
        given: Array = -_products(force, parent[:, :3]) - _products(moment, parent[:, 3:])
        return given


def _products(a: Array, b: Array) -> Array:
    products: Array = np.einsum("ij,ij->i", a, b)
    return products


def _turned(A: Array, b: Array) -> Array:
    turned: Array = np.einsum("nij,nj->ni", A, b)
    return turned


def _chains(model: Any, mass: Array) -> list[list[int]]:
    """Joints from segment to segment: those of bodies without mass, then that of the segment."""
    children = np.bincount(np.array(model.parents)[1:], minlength=model.njoints)
    passes = (mass == 0.0) & (children == 1)
    chains = []
    for i in range(1, model.njoints):
        if passes[i]:
            continue
        chain = [i]
        while (above := int(model.parents[chain[0]])) and passes[above]:
            chain.insert(0, above)
        chains.append(chain)
    return chains


def _names(robot: Robot) -> dict[int, str]:
    """Joint of the model -> the link that it carries, the heaviest of several."""
    names: dict[int, str] = {}
    heaviest: dict[int, float] = {}
    for frame in robot.model.frames:
        if frame.type == pin.FrameType.BODY:
            names.setdefault(int(frame.parentJoint), frame.name)
    for name, inertia in robot.inertias().items():
        joint = int(robot.model.frames[robot.frame(name)].parentJoint)
        if float(inertia.mass) > heaviest.get(joint, 0.0):
            names[joint], heaviest[joint] = name, float(inertia.mass)
    return names
