"""Cases that several tests share: velocity level."""

from types import SimpleNamespace

import mechanisms
import numpy as np
import pinocchio as pin
from places import ROOT

from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.loads.loads import Loads
from mbd_ros.core.model.coupling_functions import Linear
from mbd_ros.core.model.couplings import Coupling, Couplings
from mbd_ros.core.model.robot_reader import read_robot
from mbd_ros.core.rows.constraint_rows import CouplingRows, RowLayout
from mbd_ros.core.state import State
from mbd_ros.parts.constraints.loop_closure import LoopClosure

ARM = (ROOT / "config/robots/arm7.urdf").read_text(encoding="utf-8")


def robot_of(kind):
    """A robot, its couplings and the rows that it keeps."""
    if kind == "free":
        return read_robot(mechanisms.floating_body(), base="floating"), {}, []
    if kind == "loop":
        robot = read_robot(mechanisms.four_bar())
        return robot, {}, [LoopClosure(robot, **mechanisms.four_bar_closure())]
    coupled = {"joint4": Coupling("joint2", Linear(0.5))} if kind == "coupled" else {}
    return read_robot(ARM), coupled, []


def system_of(robot, parts, coupled=None):
    """What the velocity level reads of a system."""
    couplings = Couplings(robot, coupled or None)
    layout = RowLayout([*([CouplingRows(robot, couplings)] if coupled else []), *parts])
    loads = Loads(robot.model.nv)
    return SimpleNamespace(robot=robot, model=robot.model, loads=loads, layout=layout)


def inertia(robot, q):
    return np.array(pin.crba(robot.model, pin.Data(robot.model), q))


def keeps(system):
    """The function from q to the Jacobian of the bilateral rows."""
    k, none = Kinematics(system.robot), np.zeros((0, system.model.nv))

    def jacobian(q):
        x = State(0.0, q, np.zeros(system.model.nv))
        k.refresh(q, x.v)
        return np.concatenate([none, *(b.part.jacobian(k, x) for b in system.layout.rigid)])

    return jacobian


def consistent(M, hold, v):
    """The nearest velocity that keeps the bilateral rows."""
    X = np.linalg.solve(M, hold.T)
    return v - X @ np.linalg.solve(hold @ X, hold @ v)
